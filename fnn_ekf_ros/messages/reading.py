# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""From messages to events; by attribute names, so rclpy's messages and bags' are read alike."""

import math
import reprlib
from typing import Any

import numpy as np

from fnn_ekf_ros.core.arrays import FloatArray
from fnn_ekf_ros.core.covariance import usable_covariance
from fnn_ekf_ros.core.limits import LARGEST_POSITION, LARGEST_STD, SMALLEST_STD
from fnn_ekf_ros.messages.names import (
    COMPASS,
    INITIAL_POSE,
    JOINT_STATES,
    LEFT_TICKS,
    LRF_POSE,
    RIGHT_TICKS,
)
from fnn_ekf_ros.messages.writing import PLANAR
from fnn_ekf_ros.parameters.localizer import LocalizerParameters
from fnn_ekf_ros.timeline.events import (
    CompassYaw,
    Event,
    InputCheck,
    PassedOver,
    PoseFix,
    PoseReset,
    Rejected,
    Sensor,
    Wheel,
    WheelCount,
)
from fnn_ekf_ros.timeline.frames import Transform

_TICKED = {LEFT_TICKS: Wheel.LEFT, RIGHT_TICKS: Wheel.RIGHT}
"""Wheels by the topic of their ticks."""
_A_COVARIANCE = (
    f"a symmetric, positive definite covariance with {SMALLEST_STD**2:g} to {LARGEST_STD**2:g} on "
    "its diagonal"
)
"""Condition on a covariance, in words; diagonals in m^2 and rad^2."""


MOST_NAMES = 16
"""Largest number of joints that are listed."""
_PLANAR_NUMBERS = np.arange(36).reshape(6, 6)[PLANAR]
"""Places of the covariances of x, y and yaw among 36 numbers, `(3, 3)`."""


def read_input(
    topic: str, message: Any, receive_ns: int, parameters: LocalizerParameters
) -> list[Event] | Rejected | PassedOver:
    """Return the events in a message, or why it has none.

    Args:
        topic: one of `input_topics`.
        message: of that topic's type, from rclpy or from a bag.
        receive_ns: ROS time of arrival, the stamp of messages that carry none [ns].
        parameters: frames, joints and sensors of the localizer.
    """
    wheel = _TICKED.get(topic)
    if wheel is not None:
        return [WheelCount(receive_ns, wheel, int(message.data))]
    if topic == JOINT_STATES:
        return _wheel_positions(message, parameters)
    if topic == COMPASS:
        return _compass_yaw(message, parameters)
    return _pose(topic, message, receive_ns, parameters)


def stamp_ns(message: Any) -> int:
    """Return the stamp of a message with a header [ns]."""
    stamp = message.header.stamp
    return int(stamp.sec) * 10**9 + int(stamp.nanosec)


def yaw_of(orientation: Any) -> float | None:
    """Return the yaw of a quaternion message [rad]; None if it is not a finite rotation.

    Quaternions that are off unit length by up to a tenth are taken for the rotation they mean.
    """
    x, y, z, w = (
        float(orientation.x), float(orientation.y), float(orientation.z), float(orientation.w),
    )  # fmt: skip
    norm = math.hypot(x, y, z, w)
    if not math.isfinite(norm) or abs(norm - 1.0) > 0.1:
        return None
    x, y, z, w = x / norm, y / norm, z / norm, w / norm
    return math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))


def read_transforms(message: Any, parent: str, child: str) -> list[Transform]:
    """Return what a tf2_msgs/TFMessage says of one transform; what is no rotation is left out.

    Args:
        message: tf2_msgs/TFMessage.
        parent: frame of the transform.
        child: its child frame. Height, roll and pitch are passed over.
    """
    found = []
    for entry in message.transforms:
        frames = entry.header.frame_id.lstrip("/"), entry.child_frame_id.lstrip("/")
        if frames != (parent, child):
            continue
        yaw = yaw_of(entry.transform.rotation)
        x, y = (float(getattr(entry.transform.translation, axis)) for axis in "xy")
        if yaw is not None and abs(x) < LARGEST_POSITION and abs(y) < LARGEST_POSITION:
            found.append(Transform(stamp_ns(entry), np.array([x, y, yaw])))
    return found


def planar_pose(message: Any) -> FloatArray:
    """Return [x, y, yaw] of a message with `pose.pose` (m, m, rad); NaN yaw if it has none."""
    pose = message.pose.pose
    yaw = yaw_of(pose.orientation)
    return np.array([pose.position.x, pose.position.y, math.nan if yaw is None else yaw])


def planar_block(covariance: Any) -> FloatArray:
    """Return the `(3, 3)` block of x, y, yaw of a message's 36 covariance numbers."""
    return np.asarray(covariance, dtype=np.float64)[_PLANAR_NUMBERS]


def _wheel_positions(
    message: Any, parameters: LocalizerParameters
) -> list[Event] | Rejected | PassedOver:
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
            return Rejected(
                Sensor.ENCODERS,
                InputCheck.NO_POSITION,
                f"joint_states has no position for '{joint}'",
            )
        position = float(message.position[index])
        if not abs(position) < LARGEST_POSITION:
            return Rejected(
                Sensor.ENCODERS,
                InputCheck.JOINT_RANGE,
                f"joint '{joint}' is at {position:g} rad, expected less than "
                f"{LARGEST_POSITION:g} either way",
            )
        events.append(WheelCount(stamp_ns(message), wheel, position))
    return events or PassedOver(
        Sensor.ENCODERS,
        f"joint_states has the joints {_listed(names)}, expected '{parameters.left_joint}' "
        f"(left_joint) and '{parameters.right_joint}' (right_joint)",
    )


def _measured_ns(message: Any, delay_s: float) -> int:
    """Return when a message was measured that is stamped later by a delay [ns]."""
    return stamp_ns(message) - round(delay_s * 1e9)


def _compass_yaw(
    message: Any, parameters: LocalizerParameters
) -> list[Event] | Rejected | PassedOver:
    if message.orientation_covariance[0] == -1.0:
        return PassedOver(
            Sensor.COMPASS, "the IMU says that it has no orientation (orientation_covariance is -1)"
        )
    yaw = yaw_of(message.orientation)
    if yaw is None:
        return Rejected(
            Sensor.COMPASS, InputCheck.ORIENTATION, _bad_quaternion(message.orientation)
        )
    return [CompassYaw(_measured_ns(message, parameters.compass_delay), yaw)]


def _pose(
    topic: str, message: Any, receive_ns: int, parameters: LocalizerParameters
) -> list[Event] | Rejected:
    if message.header.frame_id != parameters.frame_id:
        return Rejected(
            Sensor.LRF_POSE,
            InputCheck.FRAME,
            f"{topic} in frame {_short(message.header.frame_id)}, expected '{parameters.frame_id}' "
            "(frame_id)",
        )
    pose = planar_pose(message)
    covariance = planar_block(message.pose.covariance)
    if topic == LRF_POSE:
        scale = parameters.lrf_pose_scale
        units = np.array([scale, scale, 1.0])
        with np.errstate(over="ignore"):  # what becomes infinite is refused
            pose = pose * units + [0.0, 0.0, parameters.lrf_yaw_offset]
            covariance = covariance * np.outer(units, units)
    x, y, yaw = pose.tolist()
    if not (abs(x) < LARGEST_POSITION and abs(y) < LARGEST_POSITION):
        return Rejected(
            Sensor.LRF_POSE,
            InputCheck.POSITION_RANGE,
            f"{topic} at ({x:g}, {y:g}) m, expected less than {LARGEST_POSITION:g} m either way",
        )
    if math.isnan(yaw) and (topic == INITIAL_POSE or parameters.lrf_use_yaw):
        return Rejected(
            Sensor.LRF_POSE,
            InputCheck.ORIENTATION,
            f"{topic}: {_bad_quaternion(message.pose.pose.orientation)}",
        )
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
                InputCheck.COVARIANCE,
                f"lrf_pose has the covariance diagonal [{shown}], expected "
                f"{_A_COVARIANCE} (lrf_use_message_covariance is true)",
            )
    return [PoseFix(_measured_ns(message, parameters.lrf_pose_delay), pose, covariance)]


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
            InputCheck.COVARIANCE,
            f"{INITIAL_POSE} has the covariance diagonal [{shown}], expected {_A_COVARIANCE}, or 0 "
            "on its diagonal for initial_pose_std",
        )
    given_ns = stamp_ns(message)
    return [PoseReset(min(given_ns, receive_ns) if given_ns else receive_ns, pose, checked)]


def _listed(names: list[str]) -> str:
    """Return names that somebody gave, in one line and not too many for one."""
    shown = [_short(name) for name in names[:MOST_NAMES]]
    return ", ".join([*shown, "..."] if len(names) > MOST_NAMES else shown) or "(none)"


def _short(text: str) -> str:
    """Return somebody's text quoted, in one line and not too long for one."""
    quoted = reprlib.Repr()
    quoted.maxstring = 80
    return quoted.repr(text)


def _bad_quaternion(orientation: Any) -> str:
    shown = ", ".join(f"{float(getattr(orientation, axis)):g}" for axis in "xyzw")
    return f"orientation ({shown}) is no unit quaternion"
