# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The faults of the simulated robot: each a parameter set of its own that validates itself.

All of them have a `start`. What lasts has a `duration`; what does not happens once, at `start`.
`size` is always how much is wrong, `rate` the part of the messages that is.
"""

import math
from dataclasses import dataclass, fields
from typing import Any

from fnn_ekf_ros.parameters.schema import Parameters, parameter, refusal

WHEELS = ("left", "right")
"""Wheels that a fault can concern, beside `both`."""
COUNTERS = ("left_ticks", "right_ticks")
"""Topics of the encoders that carry no stamp."""
JOINTS = ("joint_states",)
"""Topics of the encoders that carry a stamp."""
FIXES = ("compass", "lrf_pose")
"""Topics of the sensors that measure the pose or a part of it."""
STAMPED = (*JOINTS, *FIXES)
"""Topics whose messages carry a stamp."""
TOPICS = (*COUNTERS, *STAMPED)
"""Topics that a fault of the delivery can concern."""

SHORTEST_S = 0.0125
"""Smallest duration of a fault, one step of the simulation [s]."""
TO_THE_END_S = 1e9
"""Duration that stands for a fault that lasts to the end of the run [s]."""


def _duration() -> Any:
    return parameter(
        TO_THE_END_S, "How long it lasts; left out: to the end.", "s",
        at_least=SHORTEST_S, at_most=TO_THE_END_S,
    )  # fmt: skip


def _topic(choices: tuple[str, ...]) -> Any:
    return parameter("", "The topic with the fault.", choices=choices, required=True)


def _wheel(*choices: str) -> Any:
    return parameter("", "The wheel with the fault.", choices=choices, required=True)


def _rate(default: float = 1.0) -> Any:
    return parameter(
        default,
        "Share of the messages with the fault, drawn one by one.",
        at_least=0.0,
        at_most=1.0,
    )


@dataclass(frozen=True, slots=True)
class Fault(Parameters):
    """Something that goes wrong with the simulated robot."""

    start: float = parameter(
        math.nan, "When it begins, since the robot's start.", "s",
        at_least=0.0, at_most=TO_THE_END_S, required=True,
    )  # fmt: skip

    @property
    def end(self) -> float:
        """Return when it is over: `start` for what happens once [s]."""
        return self.start + float(getattr(self, "duration", 0.0))

    def targets(self) -> tuple[str, ...]:
        """Return what has the fault: topics, wheels, or the robot as a whole."""
        if "wheel" in {field.name for field in fields(self)}:
            wheel = str(getattr(self, "wheel"))  # noqa: B009 (only some have one)
            return WHEELS if wheel == "both" else (wheel,)
        return (str(getattr(self, "topic", "robot")),)


@dataclass(frozen=True, slots=True)
class Slip(Fault):
    """The wheels slip more, or less, than `slip_std` says; the ticks do not see it."""

    duration: float = _duration()
    factor: float = parameter(3.0, "Slip over slip_std.", at_least=0.0, at_most=1e3)
    std: tuple[float, float] = parameter(
        (math.nan, math.nan),
        "Instead of factor: slip per 375 ms in distance and rotation.",
        "[m, rad]",
        at_least=0.0,
        at_most=1e3,
        may_be_nan=True,
    )

    def check(self) -> None:
        """Refuse `factor` and `std` together."""
        if self.factor != 3.0 and not math.isnan(self.std[0]):
            raise refusal("factor", self.factor, "factor or std, not both")


@dataclass(frozen=True, slots=True)
class UnequalWheels(Fault):
    """One wheel's true radius differs from `wheel_radius`; the ticks do not see it."""

    wheel: str = _wheel(*WHEELS)
    duration: float = _duration()
    factor: float = parameter(1.02, "True radius over wheel_radius.", at_least=0.1, at_most=10.0)


@dataclass(frozen=True, slots=True)
class Kidnap(Fault):
    """The robot is carried elsewhere at an instant; its driver drives on from there."""

    move: tuple[float, float, float] = parameter(
        (math.nan, math.nan, math.nan),
        "Change of x, y and yaw, in the map's axes.",
        "[m, m, rad]",
        at_least=-1e4,
        at_most=1e4,
        required=True,
    )


@dataclass(frozen=True, slots=True)
class StuckWheel(Fault):
    """The counts stand still while the wheel turns, and go on from there after the fault."""

    wheel: str = _wheel(*WHEELS, "both")
    duration: float = _duration()


@dataclass(frozen=True, slots=True)
class SilentWheel(Fault):
    """The wheel's ticks cease, and joint_states comes without its joint."""

    wheel: str = _wheel(*WHEELS, "both")
    duration: float = _duration()


@dataclass(frozen=True, slots=True)
class TickReset(Fault):
    """The counter jumps to a count and counts on from there."""

    wheel: str = _wheel(*WHEELS, "both")
    count: int = parameter(0, "What it jumps to.", "counts", at_least=-(2**31), at_most=2**31 - 1)


@dataclass(frozen=True, slots=True)
class TickGlitch(Fault):
    """A single reading of the counter is wrong by `size`."""

    wheel: str = _wheel(*WHEELS, "both")
    size: int = parameter(
        100_000, "By how much it is wrong.", "counts", at_least=-(2**31), at_most=2**31 - 1
    )


@dataclass(frozen=True, slots=True)
class Dropout(Fault):
    """Messages are lost."""

    topic: str = _topic(TOPICS)
    duration: float = _duration()
    rate: float = _rate()


@dataclass(frozen=True, slots=True)
class Delay(Fault):
    """Messages are sent late; the stamp stays the time of measurement."""

    topic: str = _topic(TOPICS)
    duration: float = _duration()
    size: float = parameter(
        math.nan, "How late, rounded up to 12.5 ms.", "s",
        at_least=0.0, at_most=1e4, required=True,
    )  # fmt: skip
    rate: float = _rate()


@dataclass(frozen=True, slots=True)
class Burst(Fault):
    """Messages are held back and sent all at once at the end."""

    topic: str = _topic(TOPICS)
    duration: float = parameter(
        math.nan, "How long they are held back.", "s",
        at_least=SHORTEST_S, at_most=1e4, required=True,
    )  # fmt: skip


@dataclass(frozen=True, slots=True)
class Reordered(Fault):
    """Messages change places in pairs: the second is sent first."""

    topic: str = _topic(TOPICS)
    duration: float = _duration()


@dataclass(frozen=True, slots=True)
class Duplicates(Fault):
    """Messages are sent twice."""

    topic: str = _topic(TOPICS)
    duration: float = _duration()
    rate: float = _rate()


@dataclass(frozen=True, slots=True)
class Frozen(Fault):
    """The last value before the fault comes again and again, with new stamps."""

    topic: str = _topic(TOPICS)
    duration: float = _duration()
    jitter: float = parameter(
        0.0, "Std of noise on a fix's x and y or the compass's yaw; 0 for the encoders.",
        "m or rad", at_least=0.0, at_most=1e3,
    )  # fmt: skip

    def check(self) -> None:
        """Refuse a jitter of the encoders."""
        if self.jitter and self.topic not in FIXES:
            raise refusal("jitter", self.jitter, "0 for the encoders")


@dataclass(frozen=True, slots=True)
class Outliers(Fault):
    """Fixes lie off by `size` in a random direction, the compass by `size` to a random side."""

    topic: str = _topic(FIXES)
    duration: float = _duration()
    size: float = parameter(
        math.nan, "How far off.", "m or rad", at_least=0.0, at_most=1e6, required=True
    )
    rate: float = _rate(0.1)


@dataclass(frozen=True, slots=True)
class Misplaced(Fault):
    """Fixes lie about one place in the map, wherever the robot is: a scene that looks alike."""

    topic: str = _topic(("lrf_pose",))
    duration: float = _duration()
    place: tuple[float, float] = parameter(
        (math.nan, math.nan), "The place.", "[m, m]", at_least=-1e6, at_most=1e6, required=True
    )
    spread: float = parameter(0.1, "Std about it, of x and of y.", "m", at_least=0.0, at_most=1e3)
    rate: float = _rate(0.25)


@dataclass(frozen=True, slots=True)
class Wander(Fault):
    """Measurements have an error that wanders, as of GPS beside buildings (Gauss-Markov)."""

    topic: str = _topic(FIXES)
    duration: float = _duration()
    std: float = parameter(
        math.nan, "Std of the error in the long run: of a fix's x and y, or of the compass's yaw.",
        "m or rad", at_least=0.0, at_most=1e3, required=True,
    )  # fmt: skip
    time_constant: float = parameter(
        60.0, "Time over which it is lost; the error begins at 0.", "s", at_least=0.1, at_most=1e5
    )


@dataclass(frozen=True, slots=True)
class Bias(Fault):
    """Measurements lie off by the same; with a rate those of one of two sources that differ."""

    topic: str = _topic(FIXES)
    duration: float = _duration()
    size: tuple[float, float, float] = parameter(
        (math.nan, math.nan, math.nan),
        "How far off in x, y and yaw; the compass has yaw only.",
        "[m, m, rad]",
        at_least=-1e6,
        at_most=1e6,
        required=True,
    )
    rate: float = _rate()

    def check(self) -> None:
        """Refuse a place off which the compass cannot be."""
        if self.topic == "compass" and self.size[:2] != (0.0, 0.0):
            raise refusal("size", self.size, "[0, 0, yaw] for the compass")


@dataclass(frozen=True, slots=True)
class Noise(Fault):
    """Measurements are noisier, or quieter, than their std says."""

    topic: str = _topic(FIXES)
    duration: float = _duration()
    factor: float = parameter(3.0, "Noise over the sensor's std.", at_least=0.0, at_most=1e3)


@dataclass(frozen=True, slots=True)
class WrongStamp(Fault):
    """Stamps are off; never below 0, which says no time at all."""

    topic: str = _topic(STAMPED)
    duration: float = _duration()
    size: float = parameter(
        math.nan, "How far off; more than 0 is the future.", "s",
        at_least=-1e9, at_most=1e9, required=True,
    )  # fmt: skip
    rate: float = _rate()


@dataclass(frozen=True, slots=True)
class NotANumber(Fault):
    """A fix's x is NaN, as are the compass's quaternion and the joints' positions."""

    topic: str = _topic(STAMPED)
    duration: float = _duration()
    rate: float = _rate()


@dataclass(frozen=True, slots=True)
class ZeroQuaternion(Fault):
    """The orientation is all zero, which is no rotation."""

    topic: str = _topic(FIXES)
    duration: float = _duration()
    rate: float = _rate()


@dataclass(frozen=True, slots=True)
class WrongFrame(Fault):
    """Messages name another frame; what they measure stays."""

    topic: str = _topic(FIXES)
    duration: float = _duration()
    frame: str = parameter("odom", "The frame they name.")
    rate: float = _rate()


@dataclass(frozen=True, slots=True)
class WrongUnit(Fault):
    """Numbers in another unit: a fix's x and y, the compass's yaw, the joints' positions."""

    topic: str = _topic(STAMPED)
    duration: float = _duration()
    factor: float = parameter(
        1000.0, "New number over old; 1000: millimeters for meters.", at_least=-1e6, at_most=1e6
    )
    rate: float = _rate()


@dataclass(frozen=True, slots=True)
class BadCovariance(Fault):
    """The covariance's diagonal says 0 or less; a compass with -1 says that it has no yaw."""

    topic: str = _topic(FIXES)
    duration: float = _duration()
    variance: float = parameter(
        -0.01, "Every entry of the diagonal.", "m^2, rad^2", at_least=-1e6, at_most=0.0
    )
    rate: float = _rate()


@dataclass(frozen=True, slots=True)
class ClockJump(Fault):
    """The robot's clock is set: every stamp from then on jumps, ground truth's too.

    With `publish_clock` so does /clock. Otherwise the listeners' clock stays as it is, as on
    another computer; so do the times at which `simulate` records, since readers sort by them.
    """

    size: float = parameter(
        math.nan, "By how much; less than 0 is back, to time 0 at most.", "s",
        at_least=-1e9, at_most=1e9, required=True,
    )  # fmt: skip


GROUPS: dict[str, dict[str, type[Fault]]] = {
    "Robot": {"slip": Slip, "unequal_wheels": UnequalWheels, "kidnap": Kidnap},
    "Encoders": {
        "stuck_wheel": StuckWheel,
        "silent_wheel": SilentWheel,
        "tick_reset": TickReset,
        "tick_glitch": TickGlitch,
    },
    "What is measured": {
        "outliers": Outliers,
        "misplaced": Misplaced,
        "bias": Bias,
        "wander": Wander,
        "noise": Noise,
        "frozen": Frozen,
        "nan": NotANumber,
        "zero_quaternion": ZeroQuaternion,
        "wrong_frame": WrongFrame,
        "wrong_unit": WrongUnit,
        "wrong_stamp": WrongStamp,
        "bad_covariance": BadCovariance,
    },
    "When it is sent": {
        "dropout": Dropout,
        "delay": Delay,
        "burst": Burst,
        "reordered": Reordered,
        "duplicates": Duplicates,
    },
    "Clock": {"clock_jump": ClockJump},
}
"""The faults by their names in a timeline, grouped by what they act on."""

FAULTS = {name: kind for group in GROUPS.values() for name, kind in group.items()}
"""The faults by their names in a timeline."""
NAMES = {kind: name for name, kind in FAULTS.items()}
"""The names in a timeline by fault."""
