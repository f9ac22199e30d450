"""What the ROS messages mean: into events, and out of estimates.

Reading goes by attribute names, so the same functions serve the messages of rclpy and those read
from a bag. Writing makes a tree of type names and fields, which either side builds its own
messages from.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from fnn_ekf_ros.core.arrays import FloatArray, Row
from fnn_ekf_ros.core.covariance import usable_covariance
from fnn_ekf_ros.core.limits import LARGEST_POSITION, LARGEST_STD, SMALLEST_STD
from fnn_ekf_ros.parameters.localizer import NODE_NAME, LocalizerParameters
from fnn_ekf_ros.pipeline.events import (
    CompassYaw,
    Estimate,
    Event,
    PoseFix,
    PoseReset,
    Rejected,
    Sensor,
    Status,
    Wheel,
    WheelCount,
)

LEFT_TICKS = "left_ticks"
RIGHT_TICKS = "right_ticks"
JOINT_STATES = "joint_states"
COMPASS = "compass"
LRF_POSE = "lrf_pose"
INITIAL_POSE = "initialpose"
ODOM = "odom"
NOISE = "noise"
DIAGNOSTICS = "/diagnostics"
GROUND_TRUTH = "ground_truth"
CMD_VEL = "cmd_vel"
CLOCK = "/clock"

ODOMETRY_TYPE = "nav_msgs/msg/Odometry"
DIAGNOSTICS_TYPE = "diagnostic_msgs/msg/DiagnosticArray"
NOISE_TYPE = "std_msgs/msg/Float64MultiArray"
TICKS_TYPE = "std_msgs/msg/Int32"
JOINT_STATES_TYPE = "sensor_msgs/msg/JointState"
COMPASS_TYPE = "sensor_msgs/msg/Imu"
POSE_TYPE = "geometry_msgs/msg/PoseWithCovarianceStamped"
CLOCK_TYPE = "rosgraph_msgs/msg/Clock"
TWIST_TYPE = "geometry_msgs/msg/Twist"

INPUT_TYPES = {
    LEFT_TICKS: TICKS_TYPE,
    RIGHT_TICKS: TICKS_TYPE,
    JOINT_STATES: JOINT_STATES_TYPE,
    COMPASS: COMPASS_TYPE,
    LRF_POSE: POSE_TYPE,
    INITIAL_POSE: POSE_TYPE,
}
"""Topics the localizer can listen to."""

UNUSED_VARIANCE = 1e-9
"""Variance published for what a planar robot does not do: z, roll, pitch, sideways."""
_A_COVARIANCE = (
    f"a symmetric, positive definite covariance with {SMALLEST_STD**2:g} to {LARGEST_STD**2:g} on "
    "its diagonal"
)
_PLANAR = np.ix_([0, 1, 5], [0, 1, 5])

NOISE_FIELDS = (
    "measurement_noise_x",
    "measurement_noise_y",
    "measurement_noise_compass_yaw",
    "measurement_noise_lrf_yaw",
    "process_noise_forward",
    "process_noise_heading",
    "nis",
    "degrees_of_freedom",
    *(f"innovation_{row.name.lower()}" for row in Row),
    *(f"innovation_variance_{row.name.lower()}" for row in Row),
    *(f"mismatch_{row.name.lower()}" for row in Row),
    *(
        f"firing_{rule}_{row.name.lower()}"
        for row in Row
        for rule in ("increase", "maintain", "decrease")
    ),
)
"""What each number of `~/noise` is; variances in m^2 and rad^2."""


class Message(NamedTuple):
    """A message to be built.

    Attributes:
        type_name: such as `nav_msgs/msg/Odometry`.
        fields: values by field; messages and lists of messages as `Message`.
    """

    type_name: str
    fields: dict[str, Any]


def input_topics(parameters: LocalizerParameters) -> tuple[str, ...]:
    """Return the topics that a localizer with these parameters listens to.

    The encoders come last: they close periods, and of messages that wait together those of the
    topics that were subscribed to first are taken first.
    """
    wheels = (JOINT_STATES,) if parameters.encoder_source == "joint_states" else (
        LEFT_TICKS, RIGHT_TICKS,
    )  # fmt: skip
    return (COMPASS, LRF_POSE, INITIAL_POSE, *wheels)


def absolute_name(topic: str) -> str:
    """Return a topic's name as it is recorded, without a namespace."""
    if topic.startswith("~/"):
        return f"/{NODE_NAME}/{topic[2:]}"
    return topic if topic.startswith("/") else f"/{topic}"


def read_input(
    topic: str, message: Any, receive_ns: int, parameters: LocalizerParameters
) -> list[Event] | Rejected:
    """Return the events in a message, or why it cannot be used.

    Args:
        topic: one of `input_topics`.
        message: of that topic's type, from rclpy or from a bag.
        receive_ns: ROS time of arrival, the stamp of messages that carry none [ns].
        parameters: frames, joints and sensors of the localizer.
    """
    if topic in (LEFT_TICKS, RIGHT_TICKS):
        wheel = Wheel.LEFT if topic == LEFT_TICKS else Wheel.RIGHT
        return [WheelCount(receive_ns, wheel, int(message.data))]
    if topic == JOINT_STATES:
        return _wheel_positions(message, parameters)
    if topic == COMPASS:
        return _compass_yaw(message)
    return _pose(topic, message, receive_ns, parameters)


def odometry(estimate: Estimate, frame_id: str, base_frame: str) -> Message:
    """Return the nav_msgs/Odometry of an estimate."""
    forward, turn = estimate.twist_variance
    return odometry_message(
        estimate.stamp_ns,
        frame_id,
        base_frame,
        estimate.state.mean,
        estimate.twist,
        planar_covariance(estimate.state.covariance),
        planar_covariance(np.diag([forward, UNUSED_VARIANCE, turn])),
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
            *np.ravel(result.firing_strength),
        ]
    data += [0.0] * (len(NOISE_FIELDS) - len(data))
    dimension = Message(
        "std_msgs/msg/MultiArrayDimension",
        {"label": ",".join(NOISE_FIELDS), "size": len(data), "stride": len(data)},
    )
    layout = Message("std_msgs/msg/MultiArrayLayout", {"dim": [dimension], "data_offset": 0})
    return Message(
        NOISE_TYPE, {"layout": layout, "data": np.array([float(value) for value in data])}
    )


def diagnostics(stamp_ns: int, node_name: str, statuses: tuple[Status, ...]) -> Message:
    """Return the diagnostic_msgs/DiagnosticArray of a health report."""
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
                        "message": status.message,
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
    """Return the geometry_msgs/Quaternion of a turn about z [rad]; all zero for NaN, no yaw."""
    if math.isnan(yaw):
        return Message("geometry_msgs/msg/Quaternion", dict.fromkeys("xyzw", 0.0))
    return Message(
        "geometry_msgs/msg/Quaternion",
        {"x": 0.0, "y": 0.0, "z": math.sin(0.5 * yaw), "w": math.cos(0.5 * yaw)},
    )


def planar_covariance(covariance: FloatArray) -> FloatArray:
    """Return the `(6, 6)` covariance of a planar pose from that of [x, y, yaw], `(3, 3)`."""
    full = np.diag(np.full(6, UNUSED_VARIANCE))
    full[_PLANAR] = covariance
    return full


def stamp_ns(message: Any) -> int:
    """Return the stamp of a message with a header [ns]."""
    stamp = message.header.stamp
    return int(stamp.sec) * 10**9 + int(stamp.nanosec)


def yaw_of(orientation: Any) -> float | None:
    """Return the yaw of a quaternion message [rad]; None if it is not a finite rotation.

    Quaternions that are off unit length by up to a tenth are taken for the rotation they mean.
    """
    q = [float(getattr(orientation, axis)) for axis in "xyzw"]
    norm = math.hypot(*q)
    if not math.isfinite(norm) or abs(norm - 1.0) > 0.1:
        return None
    x, y, z, w = (component / norm for component in q)
    return math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))


def planar_pose(message: Any) -> FloatArray:
    """Return [x, y, yaw] of a message with `pose.pose` (m, m, rad); NaN yaw if it has none."""
    pose = message.pose.pose
    yaw = yaw_of(pose.orientation)
    return np.array([pose.position.x, pose.position.y, math.nan if yaw is None else yaw])


def planar_block(covariance: Any) -> FloatArray:
    """Return the `(3, 3)` block of x, y, yaw of a message's 36 covariance numbers."""
    return np.array(covariance, dtype=np.float64).reshape(6, 6)[_PLANAR]


def _vector(x: float, y: float, z: float) -> Message:
    return Message("geometry_msgs/msg/Vector3", {"x": x, "y": y, "z": z})


def _wheel_positions(message: Any, parameters: LocalizerParameters) -> list[Event] | Rejected:
    names = list(message.name)
    events: list[Event] = []
    for wheel, joint in (
        (Wheel.LEFT, parameters.left_joint),
        (Wheel.RIGHT, parameters.right_joint),
    ):
        if joint not in names:
            continue  # joint_states is shared by everything on the robot that moves
        index = names.index(joint)
        if index >= len(message.position):
            return Rejected(Sensor.ENCODERS, f"joint_states has no position for '{joint}'")
        position = float(message.position[index])
        if not abs(position) < LARGEST_POSITION:
            return Rejected(
                Sensor.ENCODERS,
                f"joint '{joint}' is at {position:g} rad, expected less than "
                f"{LARGEST_POSITION:g} either way",
            )
        events.append(WheelCount(stamp_ns(message), wheel, position))
    return events


def _compass_yaw(message: Any) -> list[Event] | Rejected:
    if message.orientation_covariance[0] == -1.0:
        return []  # an IMU that says it has no orientation
    yaw = yaw_of(message.orientation)
    if yaw is None:
        return Rejected(Sensor.COMPASS, _bad_quaternion(message.orientation))
    return [CompassYaw(stamp_ns(message), yaw)]


def _pose(
    topic: str, message: Any, receive_ns: int, parameters: LocalizerParameters
) -> list[Event] | Rejected:
    if message.header.frame_id != parameters.frame_id:
        return Rejected(
            Sensor.LRF_POSE,
            f"{topic} in frame '{message.header.frame_id}', expected '{parameters.frame_id}'",
        )
    pose = planar_pose(message)
    if not np.all(np.abs(pose[:2]) < LARGEST_POSITION):
        return Rejected(
            Sensor.LRF_POSE,
            f"{topic} at ({pose[0]:g}, {pose[1]:g}) m, expected less than "
            f"{LARGEST_POSITION:g} m either way",
        )
    if math.isnan(pose[2]) and (topic == INITIAL_POSE or parameters.lrf_use_yaw):
        return Rejected(
            Sensor.LRF_POSE, f"{topic}: {_bad_quaternion(message.pose.pose.orientation)}"
        )
    covariance = planar_block(message.pose.covariance)
    if topic == INITIAL_POSE:
        return _pose_reset(message, pose, covariance, receive_ns, parameters)
    if parameters.lrf_use_message_covariance:
        rows = 3 if parameters.lrf_use_yaw else 2
        used = covariance[:rows, :rows]
        checked = usable_covariance(used)
        if checked is not None:
            covariance[:rows, :rows] = checked
        else:
            shown = ", ".join(f"{value:g}" for value in np.diag(used))
            return Rejected(
                Sensor.LRF_POSE,
                f"lrf_pose has the covariance diagonal [{shown}], expected "
                f"{_A_COVARIANCE} (lrf_use_message_covariance is true)",
            )
    return [PoseFix(stamp_ns(message), pose, covariance)]


def _pose_reset(
    message: Any,
    pose: FloatArray,
    covariance: FloatArray,
    receive_ns: int,
    parameters: LocalizerParameters,
) -> list[Event] | Rejected:
    """Return the event; somebody's word counts now at the latest, and without a stamp now."""
    unknown = np.diag(covariance) == 0.0
    if np.any(unknown):
        covariance[unknown, :] = covariance[:, unknown] = 0.0
        variances = np.square(parameters.initial_pose_std)
        covariance[unknown, unknown] = variances[unknown]
    checked = usable_covariance(covariance)
    if checked is None:
        shown = ", ".join(f"{value:g}" for value in np.diag(covariance))
        return Rejected(
            Sensor.LRF_POSE,
            f"{INITIAL_POSE} has the covariance diagonal [{shown}], expected {_A_COVARIANCE}, or 0 "
            "on its diagonal for initial_pose_std",
        )
    given_ns = stamp_ns(message)
    return [PoseReset(min(given_ns, receive_ns) if given_ns else receive_ns, pose, checked)]


def _bad_quaternion(orientation: Any) -> str:
    shown = ", ".join(f"{float(getattr(orientation, axis)):g}" for axis in "xyzw")
    return f"orientation ({shown}) is no unit quaternion"
