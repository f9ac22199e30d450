# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Inputs and outputs of the localizer."""

from enum import IntEnum, StrEnum
from typing import NamedTuple

from fnn_ekf_ros.core.arrays import FloatArray
from fnn_ekf_ros.core.results import StepResult
from fnn_ekf_ros.core.state import FilterState

STALE_NS = 3 * 10**9
"""Silence from which on a sensor, the other half of a transform or the counter of a wheel that
should turn is reported [ns]: well above the time between two readings of the slowest sensors, and
soon enough to act."""


class Sensor(StrEnum):
    """The sensors, by their names in diagnostics."""

    ENCODERS = "encoders"
    COMPASS = "compass"
    LRF_POSE = "lrf_pose"


class Wheel(IntEnum):
    """The two wheels."""

    LEFT = 0
    RIGHT = 1


class WheelCount(NamedTuple):
    """A reading of one encoder.

    Attributes:
        stamp_ns: ROS time [ns].
        wheel: which wheel.
        reading: counts of a wrapping counter (int), or the wheel's position [rad] (float).
    """

    stamp_ns: int
    wheel: Wheel
    reading: int | float


class CompassYaw(NamedTuple):
    """A reading of the compass.

    Attributes:
        stamp_ns: ROS time [ns].
        yaw: counter-clockwise from x (ENU), as the sensor gave it [rad].
    """

    stamp_ns: int
    yaw: float


class PoseFix(NamedTuple):
    """A pose measured by the laser range finder.

    Attributes:
        stamp_ns: ROS time [ns].
        pose: `(3,)` [x, y, yaw] in the map frame (m, m, rad).
        covariance: `(3, 3)` as the sensor reported it; checked where it is used.
    """

    stamp_ns: int
    pose: FloatArray
    covariance: FloatArray


class PoseReset(NamedTuple):
    """A pose that is set from outside.

    Attributes:
        stamp_ns: ROS time [ns].
        pose: `(3,)` [x, y, yaw] in the map frame (m, m, rad).
        covariance: `(3, 3)`, symmetric positive definite.
    """

    stamp_ns: int
    pose: FloatArray
    covariance: FloatArray


class InputCheck(StrEnum):
    """The checks that an input message has to pass, each as the fault that it finds."""

    NO_POSITION = "joint_states has no position of a wheel's joint"
    JOINT_RANGE = "joint position out of range or not a number"
    ORIENTATION = "orientation is no unit quaternion"
    FRAME = "frame_id differs from the parameter frame_id"
    POSITION_RANGE = "position out of range or not a number"
    COVARIANCE = "covariance is not symmetric, not positive definite or out of range"


class Rejected(NamedTuple):
    """An input that was refused.

    Attributes:
        sensor: under which diagnostics count it.
        check: the check that it failed, as /diagnostics has it; one of a finite set.
        reason: one clause with the value and what was expected.
    """

    sensor: Sensor
    check: InputCheck
    reason: str


class PassedOver(NamedTuple):
    """An input that is right, but says nothing that the localizer could use.

    Attributes:
        sensor: under which diagnostics say so, until it has a reading.
        reason: one clause with what it says and what was expected.
    """

    sensor: Sensor
    reason: str


Event = WheelCount | CompassYaw | PoseFix | PoseReset
"""Content of a message, with its stamp in ROS time."""


class Level(IntEnum):
    """Level of a status, as in diagnostic_msgs/DiagnosticStatus."""

    OK = 0
    WARN = 1
    ERROR = 2


class Status(NamedTuple):
    """The status of one part on /diagnostics.

    Attributes:
        name: the part.
        level: OK, WARN or ERROR.
        message: one of a finite set, or several of them joined by "; "; without changing numbers.
        values: keys and values: the numbers behind the message.
    """

    name: str
    level: Level
    message: str
    values: tuple[tuple[str, str], ...]


class Move(NamedTuple):
    """A pose that was moved to where the fixes agree.

    Attributes:
        stamp_ns: when [ns].
        distance: how far it was moved [m].
        rotation: by what angle it was turned [rad].
    """

    stamp_ns: int
    distance: float
    rotation: float


class Estimate(NamedTuple):
    """The localizer's output for one period.

    Attributes:
        stamp_ns: the period's end, ROS time [ns].
        state: the filter after the period.
        twist: `(2,)` mean over the period: [linear x, angular z] (m/s, rad/s).
        twist_variance: `(2,)` its variances.
        result: of the filter's step; None for the period that started the filter.
    """

    stamp_ns: int
    state: FilterState
    twist: FloatArray
    twist_variance: FloatArray
    result: StepResult | None


class Output(NamedTuple):
    """The result of closing one period.

    Attributes:
        stamp_ns: the period's end, ROS time [ns].
        estimate: of the period; None while the filter waits for its start.
        statuses: of diagnostics, about once a second of ROS time; otherwise None.
        moved: a move of the pose that is new with the period; otherwise None.
    """

    stamp_ns: int
    estimate: Estimate | None
    statuses: tuple[Status, ...] | None
    moved: Move | None = None
