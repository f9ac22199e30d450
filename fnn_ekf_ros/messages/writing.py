# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""From estimates to messages: trees of type names and fields, which rclpy and bags build from."""

import math
from typing import Any, NamedTuple

import numpy as np

from fnn_ekf_ros.core.arrays import FloatArray
from fnn_ekf_ros.core.evidence import SCALES
from fnn_ekf_ros.core.joint_state import HYPOTHESES
from fnn_ekf_ros.core.lasting.report import LastingReport
from fnn_ekf_ros.messages.names import (
    COMPASS_TYPE,
    DIAGNOSTICS_TYPE,
    LASTING_TOPICS,
    NIS_TOPICS,
    NOISE,
    NOISE_FIELDS,
    NOISE_TYPE,
    NUMBER_TYPE,
    ODOM,
    ODOMETRY_TYPE,
    STD_TOPICS,
    TF_TYPE,
    TWIST_TYPE,
)
from fnn_ekf_ros.timeline.events import Estimate, Status

UNUSED_VARIANCE = 1e-9
"""Variance published for what a planar robot does not do: z, roll, pitch, sideways."""
_JOINT_NUMBERS = len(SCALES) + len(HYPOTHESES)
"""Number of fields of `~/noise` that only mode joint has."""
PLANAR = np.ix_([0, 1, 5], [0, 1, 5])
"""Places of x, y and yaw in a 6x6 covariance."""


_UNUSED = np.diag(np.full(6, UNUSED_VARIANCE))
"""Covariance before what a planar robot does is filled in, 6x6 (m^2, rad^2)."""


class Message(NamedTuple):
    """A message to be built.

    Attributes:
        type_name: such as `nav_msgs/msg/Odometry`.
        fields: values by field; messages and lists of messages as `Message`.
    """

    type_name: str
    fields: dict[str, Any]


_NOISE_LAYOUT = Message(
    "std_msgs/msg/MultiArrayLayout",
    {
        "dim": [
            Message(
                "std_msgs/msg/MultiArrayDimension",
                {
                    "label": ",".join(NOISE_FIELDS),
                    "size": len(NOISE_FIELDS),
                    "stride": len(NOISE_FIELDS),
                },
            )
        ],
        "data_offset": 0,
    },
)
"""Layout of `~/noise`: one dimension, labeled by the names of its numbers."""


def odometry(estimate: Estimate, frame_id: str, base_frame: str) -> Message:
    """Return the nav_msgs/Odometry of an estimate."""
    linear, angular = estimate.twist_variance
    return odometry_message(
        estimate.stamp_ns,
        frame_id,
        base_frame,
        estimate.state.mean,
        estimate.twist,
        planar_covariance(estimate.state.covariance),
        planar_covariance(np.diag([linear, UNUSED_VARIANCE, angular])),
    )


def odometry_message(
    stamp_ns: int,
    frame_id: str,
    base_frame: str,
    pose: FloatArray,
    twist: FloatArray,
    pose_covariance: FloatArray,
    twist_covariance: FloatArray,
) -> Message:
    """Return a planar nav_msgs/Odometry.

    Args:
        stamp_ns: ROS time [ns].
        frame_id: frame of the pose.
        base_frame: frame of the twist.
        pose: `(3,)` [x, y, yaw] (m, m, rad).
        twist: `(2,)` [linear x, angular z] (m/s, rad/s).
        pose_covariance: `(6, 6)` in the message's order.
        twist_covariance: `(6, 6)` in the message's order.
    """
    return Message(
        ODOMETRY_TYPE,
        {
            "header": header(stamp_ns, frame_id),
            "child_frame_id": base_frame,
            "pose": pose_with_covariance(pose, pose_covariance),
            "twist": Message(
                "geometry_msgs/msg/TwistWithCovariance",
                {
                    "twist": Message(
                        TWIST_TYPE,
                        {
                            "linear": _vector(float(twist[0]), 0.0, 0.0),
                            "angular": _vector(0.0, 0.0, float(twist[1])),
                        },
                    ),
                    "covariance": np.ravel(twist_covariance),
                },
            ),
        },
    )


def compass_message(stamp_ns: int, base_frame: str, yaw: float, yaw_std: float) -> Message:
    """Return a sensor_msgs/Imu that knows a yaw [rad] and nothing else.

    Args:
        stamp_ns: ROS time [ns].
        base_frame: frame of the sensor.
        yaw: counter-clockwise from the map's x axis [rad].
        yaw_std: its standard deviation [rad]; 0 for unknown.
    """
    variances = [UNUSED_VARIANCE, UNUSED_VARIANCE, max(yaw_std**2, UNUSED_VARIANCE)]
    unknown = np.array([-1.0] + [0.0] * 8)
    return Message(
        COMPASS_TYPE,
        {
            "header": header(stamp_ns, base_frame),
            "orientation": quaternion(yaw),
            "orientation_covariance": np.diag(variances if yaw_std > 0.0 else [0.0] * 3).ravel(),
            "angular_velocity": _vector(0.0, 0.0, 0.0),
            "angular_velocity_covariance": unknown,
            "linear_acceleration": _vector(0.0, 0.0, 0.0),
            "linear_acceleration_covariance": unknown,
        },
    )


def transform_message(stamp_ns: int, parent: str, child: str, pose: FloatArray) -> Message:
    """Return the tf2_msgs/TFMessage of one planar transform.

    Args:
        stamp_ns: ROS time [ns].
        parent: the frame that the pose is in.
        child: the frame whose pose it is.
        pose: `(3,)` [x, y, yaw] (m, m, rad).
    """
    x, y, yaw = (float(value) for value in pose)
    transform = Message(
        "geometry_msgs/msg/Transform",
        {"translation": _vector(x, y, 0.0), "rotation": quaternion(yaw)},
    )
    stamped = Message(
        "geometry_msgs/msg/TransformStamped",
        {"header": header(stamp_ns, parent), "child_frame_id": child, "transform": transform},
    )
    return Message(TF_TYPE, {"transforms": [stamped]})


def noise(estimate: Estimate) -> Message:
    """Return the numbers of `~/noise`; `NOISE_FIELDS` names them."""
    state, result = estimate.state, estimate.result
    data = [*state.measurement_noise, *state.process_noise]
    if result is not None:
        data += [
            result.nis,
            result.degrees_of_freedom,
            *result.innovation,
            *result.innovation_variance,
            *result.mismatch,
            *np.ravel(result.firing_strength.T),
        ]
        joint = result.joint
        data += [0.0] * _JOINT_NUMBERS if joint is None else [*joint.log_scale, *joint.weights]
        data += [*result.sensor_nis, *result.rejected, result.relocated]
        data += [*np.ravel(result.process_firing_strength.T)]
        if result.lasting is not None:
            data += [*result.lasting.weights, *_lasting_numbers(result.lasting).values()]
            data += [result.lasting.believed, result.lasting.doubted]
    data += [0.0] * (len(NOISE_FIELDS) - len(data))
    return Message(NOISE_TYPE, {"layout": _NOISE_LAYOUT, "data": np.array(list(map(float, data)))})


def numbers(estimate: Estimate) -> dict[str, Message]:
    """Return what is published beside `~/noise` to be plotted by name, by private topic.

    The standard deviations are square roots of the adapted R and of Q for 375 ms (m, rad). A NIS
    is summed over the period's readings of its sensor and divided by their degrees of freedom; a
    sensor that measured nothing has none. Numbers about lasting errors come where these are
    followed.
    """
    state, result = estimate.state, estimate.result
    variances = dict(
        zip(NOISE_FIELDS, [*state.measurement_noise, *state.process_noise], strict=False)
    )
    values = {topic: math.sqrt(variances[field]) for field, topic in STD_TOPICS.items()}
    if result is not None:
        by_sensor = zip(
            NIS_TOPICS, result.sensor_nis, result.sensor_degrees_of_freedom, strict=True
        )
        values |= {topic: nis / count for topic, nis, count in by_sensor if count > 0}
        if result.lasting is not None:
            lasting = _lasting_numbers(result.lasting)
            values |= {topic: lasting[field] for field, topic in LASTING_TOPICS.items()}
    return {topic: Message(NUMBER_TYPE, {"data": float(value)}) for topic, value in values.items()}


def _lasting_numbers(report: LastingReport) -> dict[str, float]:
    """Return the numbers about lasting errors, by their fields of `~/noise`, in their order."""
    return {
        "lasting_fix_std": float(report.fix_std),
        "lasting_time_constant": report.time_constant_s,
        "lasting_yaw_std": float(report.yaw_std),
        "compass_offset": float(report.offset),
        "compass_offset_std": float(report.offset_std),
    }


def estimate_messages(estimate: Estimate, frame_id: str, base_frame: str) -> dict[str, Message]:
    """Return all that is published with an estimate, by topic as in `output_topics`."""
    private = {NOISE: noise(estimate), **numbers(estimate)}
    return {
        ODOM: odometry(estimate, frame_id, base_frame),
        **{f"~/{topic}": message for topic, message in private.items()},
    }


def diagnostics(stamp_ns: int, node_name: str, statuses: tuple[Status, ...]) -> Message:
    """Return the diagnostic_msgs/DiagnosticArray of the statuses of a report."""
    return Message(
        DIAGNOSTICS_TYPE,
        {
            "header": header(stamp_ns, ""),
            "status": [
                Message(
                    "diagnostic_msgs/msg/DiagnosticStatus",
                    {
                        "level": int(status.level),
                        "name": f"{node_name}: {status.name}",
                        "message": str(status.message),
                        "hardware_id": node_name,
                        "values": [
                            Message("diagnostic_msgs/msg/KeyValue", {"key": key, "value": value})
                            for key, value in status.values
                        ],
                    },
                )
                for status in statuses
            ],
        },
    )


def header(stamp_ns: int, frame_id: str) -> Message:
    """Return a std_msgs/Header."""
    return Message("std_msgs/msg/Header", {"stamp": time(stamp_ns), "frame_id": frame_id})


def time(stamp_ns: int) -> Message:
    """Return a builtin_interfaces/Time."""
    return Message(
        "builtin_interfaces/msg/Time",
        {"sec": stamp_ns // 10**9, "nanosec": stamp_ns % 10**9},
    )


def pose_with_covariance(pose: FloatArray, covariance: FloatArray) -> Message:
    """Return a geometry_msgs/PoseWithCovariance of [x, y, yaw] and a `(6, 6)` covariance."""
    x, y, yaw = (float(value) for value in pose)
    return Message(
        "geometry_msgs/msg/PoseWithCovariance",
        {
            "pose": Message(
                "geometry_msgs/msg/Pose",
                {
                    "position": Message("geometry_msgs/msg/Point", {"x": x, "y": y, "z": 0.0}),
                    "orientation": quaternion(yaw),
                },
            ),
            "covariance": np.ravel(covariance),
        },
    )


def quaternion(yaw: float) -> Message:
    """Return the geometry_msgs/Quaternion of a rotation about z [rad]; all zero for NaN, no yaw."""
    if math.isnan(yaw):
        return Message("geometry_msgs/msg/Quaternion", dict.fromkeys("xyzw", 0.0))
    return Message(
        "geometry_msgs/msg/Quaternion",
        {"x": 0.0, "y": 0.0, "z": math.sin(0.5 * yaw), "w": math.cos(0.5 * yaw)},
    )


def planar_covariance(covariance: FloatArray) -> FloatArray:
    """Return the `(6, 6)` covariance of a planar pose from that of [x, y, yaw], `(3, 3)`."""
    full = _UNUSED.copy()
    full[PLANAR] = covariance
    return full


def _vector(x: float, y: float, z: float) -> Message:
    return Message("geometry_msgs/msg/Vector3", {"x": x, "y": y, "z": z})
