"""What the pipeline is fed with, and what it gives back."""

from enum import IntEnum, StrEnum
from typing import NamedTuple

from fnn_ekf_ros.core.arrays import FloatArray
from fnn_ekf_ros.core.results import StepResult
from fnn_ekf_ros.core.state import FilterState

STALE_NS = 3 * 10**9
"""What should speak, or change, and has not for longer is worth a word [ns]: a sensor, the other
half of a transform, the counter of a wheel that should turn."""


class Sensor(StrEnum):
    """What can be healthy or not; the names are the diagnostics' names."""

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
    """Somebody says where the robot is.

    Attributes:
        stamp_ns: ROS time [ns].
        pose: `(3,)` [x, y, yaw] in the map frame (m, m, rad).
        covariance: `(3, 3)`, symmetric positive definite.
    """

    stamp_ns: int
    pose: FloatArray
    covariance: FloatArray


class Rejected(NamedTuple):
    """An input that was quarantined.

    Attributes:
        sensor: whose it was.
        reason: one clause with the value and what was expected.
    """

    sensor: Sensor
    reason: str


Event = WheelCount | CompassYaw | PoseFix | PoseReset


class Level(IntEnum):
    """Level of a status, as in diagnostic_msgs/DiagnosticStatus."""

    OK = 0
    WARN = 1
    ERROR = 2


class Status(NamedTuple):
    """Health of one part.

    Attributes:
        name: the part.
        level: how it is.
        message: in a few words.
        values: what the verdict rests on, in words.
    """

    name: str
    level: Level
    message: str
    values: tuple[tuple[str, str], ...]


class Move(NamedTuple):
    """A pose that was moved to where the fixes agree.

    Attributes:
        stamp_ns: when [ns].
        way: how far [m].
        turn: and by what angle [rad].
    """

    stamp_ns: int
    way: float
    turn: float


class Estimate(NamedTuple):
    """The localizer's output for one period.

    Attributes:
        stamp_ns: the period's end, ROS time [ns].
        state: the filter after the period.
        twist: `(2,)` mean over the period: [linear x, angular z] (m/s, rad/s).
        twist_variance: `(2,)` its variances.
        result: what the period showed; None for the one that started the filter.
    """

    stamp_ns: int
    state: FilterState
    twist: FloatArray
    twist_variance: FloatArray
    result: StepResult | None


class Output(NamedTuple):
    """What came of closing one period.

    Attributes:
        stamp_ns: the period's end, ROS time [ns].
        estimate: None while the filter waits for its start.
        health: the statuses, about once a second of ROS time; otherwise None.
        moved: a move of the pose that came to light with the period; otherwise None.
    """

    stamp_ns: int
    estimate: Estimate | None
    health: tuple[Status, ...] | None
    moved: Move | None = None
