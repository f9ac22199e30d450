# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Naming of the sensor that fails, by diagnostics: faults of one sensor at a time.

The list was drawn up by what fails on robots, before anything was measured.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import numpy as np

from fnn_ekf_ros.core.adaptation import Networks
from fnn_ekf_ros.localizer.localizer import Localizer
from fnn_ekf_ros.parameters.fake_robot import FakeRobotParameters
from fnn_ekf_ros.parameters.faults import (
    BadCovariance,
    Bias,
    Delay,
    Dropout,
    Fault,
    Frozen,
    Misplaced,
    Noise,
    NotANumber,
    Outliers,
    SilentWheel,
    Slip,
    StuckWheel,
    TickGlitch,
    TickReset,
    UnequalWheels,
    Wander,
    WrongFrame,
    WrongStamp,
    WrongUnit,
    ZeroQuaternion,
)
from fnn_ekf_ros.parameters.localizer import LocalizerParameters
from fnn_ekf_ros.simulation.listening import listen
from fnn_ekf_ros.timeline.events import Level, Sensor, Status

PATHS = ("sim1", "sim2", "square", "round")
"""Paths that the runs with a fault take turns on."""
QUIET_PATHS = ("sim1", "sim2")
"""Paths of the runs without a fault."""
ONSET_S = (40.0, 60.0)
"""Range from which the onset of a fault is drawn [s]: the filter has settled."""
NAMED_WITHIN_S = 30.0
"""Longest time from the onset until the sensor is named that counts as in time [s]."""
START_NS = 3 * 10**9
"""ROS time at which a run begins [ns]: ROS time 0 means no time."""

C, L = "compass", "lrf_pose"
"""Topics of the compass and of the fixes."""


class FaultCase(NamedTuple):
    """A fault of one sensor.

    Attributes:
        name: in tables and on the command line.
        about: what it is.
        sensor: who is to be named.
        faults: makes it, from its time of onset [s].
        from_start: whether it is there from the first reading on.
    """

    name: str
    about: str
    sensor: Sensor
    faults: Callable[[float], tuple[Fault, ...]]
    from_start: bool = False


def _case(
    name: str, about: str, *makers: Callable[[float], Fault], from_start: bool = False
) -> FaultCase:
    sensor = next((s for s in Sensor if name.startswith(f"{s}_")), Sensor.ENCODERS)
    return FaultCase(name, about, sensor, lambda t: tuple(make(t) for make in makers), from_start)


def _turned_compass(angle: float) -> Callable[[float], Fault]:
    return lambda t: Bias(start=t, topic=C, size=(0.0, 0.0, angle))


NAMING_CASES: tuple[FaultCase, ...] = (
    _case("stuck_wheel", "the left wheel's counter stands still",
          lambda t: StuckWheel(start=t, wheel="left")),
    _case("stuck_wheels", "both counters stand still",
          lambda t: StuckWheel(start=t, wheel="both")),
    _case("silent_wheel", "no more messages of the left wheel",
          lambda t: SilentWheel(start=t, wheel="left")),
    _case("slip", "ten times the slip, in std", lambda t: Slip(start=t, factor=10.0)),
    _case("flat_tyre", "the left wheel is 20 % smaller",
          lambda t: UnequalWheels(start=t, wheel="left", factor=0.8)),
    _case("tick_reset", "both counters jump to 0", lambda t: TickReset(start=t, wheel="both")),
    _case("tick_glitch", "one reading is off by 100000 counts",
          lambda t: TickGlitch(start=t, wheel="right")),
    _case("compass_outliers", "20 % are off by 1 rad",
          lambda t: Outliers(start=t, topic=C, size=1.0, rate=0.2)),
    _case("compass_noise", "five times the noise, in std",
          lambda t: Noise(start=t, topic=C, factor=5.0)),
    _case("compass_frozen", "the same yaw again and again", lambda t: Frozen(start=t, topic=C)),
    _case("compass_frozen_jitter", "likewise, with 1 mrad of noise",
          lambda t: Frozen(start=t, topic=C, jitter=1e-3)),
    _case("compass_bias", "off by 1.5 rad",
          lambda t: Bias(start=t, topic=C, size=(0.0, 0.0, 1.5))),
    *(
        _case(f"compass_turned_{name}", f"turned by {name} rad", _turned_compass(angle))
        for name, angle in (("pi/2", math.pi / 2.0), ("3", 3.0))
    ),
    *(
        _case(f"compass_off_{name}", f"off by {name} rad from the first reading on",
              _turned_compass(angle), from_start=True)
        for name, angle in (("0.3", 0.3), ("0.8", 0.8), ("pi/2", math.pi / 2.0), ("pi", math.pi))
    ),
    _case("compass_dropout", "no more messages", lambda t: Dropout(start=t, topic=C)),
    _case("compass_zero_quaternion", "all zero", lambda t: ZeroQuaternion(start=t, topic=C)),
    _case("compass_nan", "not a number", lambda t: NotANumber(start=t, topic=C)),
    _case("compass_unit", "degrees taken for radians",
          lambda t: WrongUnit(start=t, topic=C, factor=57.29578)),
    _case("compass_no_yaw", "says that it has no orientation",
          lambda t: BadCovariance(start=t, topic=C, variance=-1.0)),
    _case("compass_late", "2 s late and stamped on arrival",
          lambda t: Delay(start=t, topic=C, size=2.0),
          lambda t: WrongStamp(start=t, topic=C, size=2.0)),
    _case("compass_stamp", "stamped 1.5 s too early",
          lambda t: WrongStamp(start=t, topic=C, size=-1.5)),
    _case("lrf_pose_outliers", "20 % are off by 20 m",
          lambda t: Outliers(start=t, topic=L, size=20.0, rate=0.2)),
    _case("lrf_pose_noise", "five times the noise, in std",
          lambda t: Noise(start=t, topic=L, factor=5.0)),
    _case("lrf_pose_frozen", "the same pose again and again", lambda t: Frozen(start=t, topic=L)),
    _case("lrf_pose_frozen_jitter", "likewise, with 1 mm of noise",
          lambda t: Frozen(start=t, topic=L, jitter=1e-3)),
    _case("lrf_pose_bias", "off by 2 m", lambda t: Bias(start=t, topic=L, size=(2.0, 0.0, 0.0))),
    _case("lrf_pose_dropout", "no more messages", lambda t: Dropout(start=t, topic=L)),
    _case("lrf_pose_nan", "not a number", lambda t: NotANumber(start=t, topic=L)),
    _case("lrf_pose_frame", "in another frame", lambda t: WrongFrame(start=t, topic=L)),
    _case("lrf_pose_unit", "millimeters taken for meters",
          lambda t: WrongUnit(start=t, topic=L, factor=1000.0)),
    _case("lrf_pose_scattered", "30 % are off by 3 m",
          lambda t: Outliers(start=t, topic=L, size=3.0, rate=0.3)),
    _case("lrf_pose_one_place", "25 % lie about one place",
          lambda t: Misplaced(start=t, topic=L, place=(1.0, 1.0), rate=0.25)),
    _case("lrf_pose_two_sources", "every other one, at random, is off by 0.5 m",
          lambda t: Bias(start=t, topic=L, size=(0.5, 0.0, 0.0), rate=0.5)),
    _case("lrf_pose_jump", "off by 1.8 m for 10 s",
          lambda t: Bias(start=t, topic=L, size=(1.5, -1.0, 0.0), duration=10.0)),
    _case("lrf_pose_wander", "an error of 1 m that lasts a minute",
          lambda t: Wander(start=t, topic=L, std=1.0, time_constant=60.0)),
    _case("lrf_pose_late", "2 s late and stamped on arrival",
          lambda t: Delay(start=t, topic=L, size=2.0),
          lambda t: WrongStamp(start=t, topic=L, size=2.0)),
    _case("lrf_pose_stamp", "stamped 1.5 s too early",
          lambda t: WrongStamp(start=t, topic=L, size=-1.5)),
)  # fmt: skip
"""Faults of one sensor at a time, with their sizes."""


class Report(NamedTuple):
    """One report of diagnostics.

    Attributes:
        time_s: since the robot's start [s].
        statuses: one for each part.
    """

    time_s: float
    statuses: tuple[Status, ...]

    def named(self) -> set[str]:
        """Return the sensors whose status is not OK."""
        return {s.name for s in self.statuses if s.level > Level.OK and s.name in tuple(Sensor)}

    @property
    def level(self) -> Level:
        """The worst of all."""
        return max(status.level for status in self.statuses)


class Naming(NamedTuple):
    """Sensors that diagnostics named after a fault.

    Attributes:
        case: which.
        path: what was driven.
        onset_s: when the fault began [s].
        named_s: how long after that the sensor was named; NaN: it was not in time [s].
        first: whether no other was named before it.
        alone: whether no other was named at all in that time.
        others: who was, with the first message.
    """

    case: FaultCase
    path: str
    onset_s: float
    named_s: float
    first: bool
    alone: bool
    others: dict[str, str]

    @property
    def named(self) -> bool:
        """Whether it was named in time."""
        return bool(np.isfinite(self.named_s))

    @property
    def named_first(self) -> bool:
        """Whether it was named in time, and nobody else before it."""
        return self.named and self.first

    @property
    def right(self) -> bool:
        """Whether it was named in time, and nobody else."""
        return self.named and self.alone


class Quiet(NamedTuple):
    """Reports of diagnostics on a run without a fault.

    Attributes:
        path: what was driven.
        reports: how many there were once the filter ran.
        warned: how many of them had a status that was not OK.
        words: their messages, each with how often it was there.
    """

    path: str
    reports: int
    warned: int
    words: dict[str, int]


class Setting(NamedTuple):
    """A robot and its localizer.

    Attributes:
        robot: drives a scripted path.
        localizer: has its noise, right or wrong.
        networks: membership functions.
    """

    robot: FakeRobotParameters
    localizer: LocalizerParameters
    networks: Networks


def reports(setting: Setting, duration_s: float, faults: Sequence[Fault] = ()) -> Iterator[Report]:
    """Yield what diagnostics say about a run, from when the filter runs."""
    localizer = Localizer(setting.localizer, setting.networks)
    for heard in listen(setting.robot, setting.localizer, START_NS, duration_s, faults):
        for output in localizer.receive(heard.topic, heard.message, heard.now_ns).outputs:
            if output.statuses is not None and output.estimate is not None:
                yield Report((output.stamp_ns - START_NS) * 1e-9, output.statuses)


def name_fault(case: FaultCase, setting: Setting, rng: np.random.Generator) -> Naming:
    """Return what diagnostics say of a fault; `rng` draws its onset."""
    onset_s = 0.0 if case.from_start else float(rng.uniform(*ONSET_S))
    found = [
        report
        for report in reports(setting, onset_s + NAMED_WITHIN_S, case.faults(onset_s))
        if report.time_s >= onset_s
    ]
    named = [report.time_s - onset_s for report in found if case.sensor in report.named()]
    others: dict[str, str] = {}
    first = True
    for report in found:
        for status in report.statuses:
            if status.name in report.named() - {case.sensor}:
                others.setdefault(status.name, f"{report.time_s - onset_s:.1f} s: {status.message}")
        if not named or report.time_s - onset_s <= named[0]:
            first = first and not others
    return Naming(
        case=case,
        path=setting.robot.path,
        onset_s=onset_s,
        named_s=named[0] if named else float("nan"),
        first=first,
        alone=not others,
        others=others,
    )


def quiet_run(setting: Setting, duration_s: float) -> Quiet:
    """Return what diagnostics say of a run without faults."""
    count = warned = 0
    words: dict[str, int] = {}
    for report in reports(setting, duration_s):
        count += 1
        warned += report.level > Level.OK
        for status in report.statuses:
            if status.level > Level.OK:
                what = f"{status.name}: {status.message}"
                words[what] = words.get(what, 0) + 1
    return Quiet(path=setting.robot.path, reports=count, warned=warned, words=words)
