# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Effects of faults on a message: functions from message to message, which change nothing in place.

A rotation is a product of quaternions, so that one that is no rotation stays none, whatever other
faults add to it.
"""

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from fnn_ekf_ros import messages
from fnn_ekf_ros.core.arrays import FloatArray
from fnn_ekf_ros.messages import Message
from fnn_ekf_ros.parameters.faults import (
    BadCovariance,
    Bias,
    Fault,
    Misplaced,
    NotANumber,
    Outliers,
    WrongFrame,
    WrongStamp,
    WrongUnit,
    ZeroQuaternion,
)

LATEST_STAMP_NS = 2_100_000_000 * 10**9
"""Largest ROS time to which a fault sets a clock [ns]: seconds have 32 bits in ROS."""


def with_stamp(message: Message, stamp: Message) -> Message:
    """Return a message with another builtin_interfaces/Time in its header."""
    return _with(message, header=_with(message.fields["header"], stamp=stamp))


def shifted(message: Message, error: FloatArray) -> Message:
    """Return a message with an error.

    Args:
        message: a fix, or a message of the compass.
        error: `(2,)` of the fix's x and y [m], or of the compass's yaw, which is the first [rad].
    """
    if message.type_name == messages.COMPASS_TYPE:
        return _turned(message, float(error[0]))
    return _moved(message, *map(float, error))


def jittered(message: Message, std: float, rng: np.random.Generator) -> Message:
    """Return a fix with noise on x and y, or a message of the compass with noise on its yaw.

    Args:
        message: the fix, or that of the compass.
        std: standard deviation of the noise [m or rad].
        rng: source of the noise.
    """
    if message.type_name == messages.COMPASS_TYPE:
        return _turned(message, std * rng.standard_normal())
    return _moved(message, *(std * rng.standard_normal(2)))


def spoiled(fault: Fault, message: Message, rng: np.random.Generator) -> Message:
    """Return what a fault makes of a message.

    Args:
        fault: one of `SPOILERS`.
        message: of one of the fault's topics.
        rng: source of what is random about it.
    """
    return SPOILERS[type(fault)](fault, message, rng)


def _outlier(fault: Outliers, message: Message, rng: np.random.Generator) -> Message:
    direction = rng.uniform(-math.pi, math.pi)
    if message.type_name == messages.COMPASS_TYPE:
        return _turned(message, math.copysign(fault.size, direction))
    return _moved(message, fault.size * math.cos(direction), fault.size * math.sin(direction))


def _misplaced(fault: Misplaced, message: Message, rng: np.random.Generator) -> Message:
    x, y = np.asarray(fault.place) + fault.spread * rng.standard_normal(2)
    return _placed(message, x=float(x), y=float(y))


def _bias(fault: Bias, message: Message, _: np.random.Generator) -> Message:
    x, y, yaw = fault.size
    if message.type_name == messages.COMPASS_TYPE:
        return _turned(message, yaw)
    return _turned(_moved(message, x, y), yaw)


def _not_a_number(_: NotANumber, message: Message, __: np.random.Generator) -> Message:
    if message.type_name == messages.COMPASS_TYPE:
        nan = dict.fromkeys("xyzw", math.nan)
        return _oriented(message, Message("geometry_msgs/msg/Quaternion", nan))
    if message.type_name == messages.JOINT_STATES_TYPE:
        return _with(message, position=np.full_like(message.fields["position"], math.nan))
    return _placed(message, x=math.nan)


def _zero_quaternion(_: ZeroQuaternion, message: Message, __: np.random.Generator) -> Message:
    return _oriented(message, messages.quaternion(math.nan))


def _wrong_frame(fault: WrongFrame, message: Message, _: np.random.Generator) -> Message:
    return _with(message, header=_with(message.fields["header"], frame_id=fault.frame))


def _wrong_stamp(fault: WrongStamp, message: Message, _: np.random.Generator) -> Message:
    stamp = message.fields["header"].fields["stamp"].fields
    wrong_ns = stamp["sec"] * 10**9 + stamp["nanosec"] + round(fault.size * 1e9)
    return with_stamp(message, messages.time(min(max(wrong_ns, 0), LATEST_STAMP_NS)))


def _wrong_unit(fault: WrongUnit, message: Message, _: np.random.Generator) -> Message:
    if message.type_name == messages.COMPASS_TYPE:
        q = message.fields["orientation"].fields
        yaw = 2.0 * math.atan2(q["z"], q["w"])
        return _turned(message, math.remainder(yaw * fault.factor - yaw, 2.0 * math.tau))
    if message.type_name == messages.JOINT_STATES_TYPE:
        return _with(message, position=message.fields["position"] * fault.factor)
    place = _pose(message).fields["position"].fields
    return _placed(message, x=place["x"] * fault.factor, y=place["y"] * fault.factor)


def _bad_covariance(fault: BadCovariance, message: Message, _: np.random.Generator) -> Message:
    if message.type_name == messages.COMPASS_TYPE:
        return _with(message, orientation_covariance=np.diag([fault.variance] * 3).ravel())
    covariance = np.diag([fault.variance] * 6).ravel()
    return _with(message, pose=_with(message.fields["pose"], covariance=covariance))


SPOILERS: dict[type[Fault], Callable[[Any, Message, np.random.Generator], Message]] = {
    Outliers: _outlier,
    Misplaced: _misplaced,
    Bias: _bias,
    NotANumber: _not_a_number,
    ZeroQuaternion: _zero_quaternion,
    WrongFrame: _wrong_frame,
    WrongStamp: _wrong_stamp,
    WrongUnit: _wrong_unit,
    BadCovariance: _bad_covariance,
}
"""Functions of the faults that change the content of a message."""


def _with(message: Message, **changes: Any) -> Message:
    return message._replace(fields=message.fields | changes)


def _pose(message: Message) -> Message:
    """Return the geometry_msgs/Pose of a fix."""
    pose: Message = message.fields["pose"].fields["pose"]
    return pose


def _with_pose(message: Message, **changes: Any) -> Message:
    pose = _with(_pose(message), **changes)
    return _with(message, pose=_with(message.fields["pose"], pose=pose))


def _placed(message: Message, **coordinates: float) -> Message:
    return _with_pose(message, position=_with(_pose(message).fields["position"], **coordinates))


def _moved(message: Message, x: float, y: float) -> Message:
    place = _pose(message).fields["position"].fields
    return _placed(message, x=place["x"] + x, y=place["y"] + y)


def _oriented(message: Message, orientation: Message) -> Message:
    if message.type_name == messages.COMPASS_TYPE:
        return _with(message, orientation=orientation)
    return _with_pose(message, orientation=orientation)


def _turned(message: Message, yaw: float) -> Message:
    compass = message.type_name == messages.COMPASS_TYPE
    orientation = (message if compass else _pose(message)).fields["orientation"]
    q, s, c = orientation.fields, math.sin(0.5 * yaw), math.cos(0.5 * yaw)
    turned = _with(orientation, z=q["z"] * c + q["w"] * s, w=q["w"] * c - q["z"] * s)
    return _oriented(message, turned)
