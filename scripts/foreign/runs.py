# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Simulated drives through the localizer in simulated time: odom beside the truth, and diagnostics.

The localizer has the shipped defaults and the geometry of the simulated robot, whose noise is
the one that the defaults assume.
"""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from fnn_ekf_ros import messages
from fnn_ekf_ros.core.arrays import FloatArray
from fnn_ekf_ros.core.rows import LRF_POSE
from fnn_ekf_ros.localizer.localizer import Localizer
from fnn_ekf_ros.membership.files import networks_for
from fnn_ekf_ros.parameters.fake_robot import FakeRobotParameters
from fnn_ekf_ros.parameters.faults import Fault
from fnn_ekf_ros.parameters.localizer import LocalizerParameters
from fnn_ekf_ros.parameters.schema import build
from fnn_ekf_ros.simulation.delivery import STEP_NS
from fnn_ekf_ros.simulation.fake_robot import FakeRobot
from fnn_ekf_ros.simulation.listening import Heard, as_object
from fnn_ekf_ros.timeline.events import Level, Output
from fnn_ekf_ros.timeline.trajectory import pose_errors

START_NS = 300 * 10**9
"""ROS time at which the drives begin [ns], so that a clock can be set back."""
PATH = "round"
"""Path that is driven: that of the fault matrix."""
LARGEST_GOOD_M, LARGEST_GOOD_RAD = 0.3, 0.2
"""Largest errors of a pose that has recovered (m, rad): twice those of a run without a fault."""
HELD_S = 5.0
"""Time for which a pose has to stay good to have recovered [s]."""
LONGEST_GAP_S = 1.0
"""Longest time between two odom messages that is no gap [s]; a period is 0.375 s, and one whose
wheels are missing waits for 0.5 s more."""

NO_SHIFT = (0.0, 0.0, 0.0)
"""Shift of a map that stays where it is (m, m, rad)."""

Spoil = Callable[[str, Any], None]
"""Changes a message of a topic in place, in ways that the faults of the simulation do not have."""


class Remark(NamedTuple):
    """A part's message on /diagnostics that is not OK, at a time since the start [s]."""

    time_s: float
    status: str
    level: Level
    message: str


class Odom(NamedTuple):
    """One period of a run.

    Attributes:
        time_s: when it was published, since the robot's start by a clock that is right [s].
        stamp_ns: its stamp [ns].
        pose: `(3,)` of the map; NaN while there is none (m, m, rad).
        truth: `(3,)` the true pose at its stamp (m, m, rad).
        finite: whether pose and covariance are, or there is no pose.
    """

    time_s: float
    stamp_ns: int
    pose: FloatArray
    truth: FloatArray
    finite: bool


class Drive(NamedTuple):
    """A run: its odom, what diagnostics reported, and which fixes the gate rejected, in order."""

    odom: tuple[Odom, ...]
    remarks: tuple[Remark, ...]
    rejected: tuple[bool, ...]


class Recovery(NamedTuple):
    """What a fault does to a run.

    Attributes:
        time_s: from a given time until the pose had recovered, as `time_to_recover` [s].
        largest_m: largest position error from the onset on [m].
        largest_rad: largest yaw error from the onset on [rad].
        finite: whether every number was.
        rejected: longest row of fixes that the gate rejected.
        said: how long after the onset each part said what was new [s], by part and message.
    """

    time_s: float
    largest_m: float
    largest_rad: float
    finite: bool
    rejected: int
    said: Mapping[tuple[str, str], float]


class Measured(NamedTuple):
    """What a run of a scenario shows.

    Attributes:
        recovery: from what goes wrong.
        apart_m: largest distance from the run that it should equal [m]; NaN where there is none.
    """

    recovery: Recovery
    apart_m: float = math.nan


def robot_of(seed: int) -> FakeRobotParameters:
    """Return the simulated robot of a seed."""
    return FakeRobotParameters(path=PATH, seed=seed)


def localizer_of(robot: FakeRobotParameters, **changes: Any) -> LocalizerParameters:
    """Return the localizer's defaults with a robot's geometry, and with changes."""
    geometry = {
        name: getattr(robot, name)
        for name in ("wheel_radius", "wheel_separation", "encoder_counts_per_revolution")
    }
    return build(LocalizerParameters, geometry | changes)


def drive(
    seed: int,
    duration_s: float,
    faults: Sequence[Fault] = (),
    *,
    localizer: Mapping[str, Any] = {},
    spoil: Spoil | None = None,
    own_clock: bool = False,
    start_ns: int = START_NS,
) -> Drive:
    """Drive a simulated robot and localize it.

    Args:
        seed: of the robot.
        duration_s: of the drive [s].
        faults: what goes wrong.
        localizer: parameters that differ from the defaults.
        spoil: changes messages.
        own_clock: whether the localizer runs on the robot's computer: a clock that is set is its
            own.
        start_ns: ROS time of the start [ns].
    """
    robot = robot_of(seed)
    parameters = localizer_of(robot, **localizer)
    fake = FakeRobot(robot, start_ns, faults)
    return listened(parameters, heard(fake, duration_s, spoil, own_clock))


def listened(parameters: LocalizerParameters, arrivals: Iterable[tuple[Heard, float]]) -> Drive:
    """Let a localizer with given parameters listen; the ground truth is among what is heard.

    Args:
        parameters: of the localizer.
        arrivals: messages, each with the time since the robot's start by a clock that is right [s].
    """
    localizer = Localizer(parameters, networks_for(parameters))
    topics = set(messages.input_topics(parameters))
    truth: dict[int, FloatArray] = {}
    odom: list[Odom] = []
    remarks: list[Remark] = []
    rejected: list[bool] = []
    started = False
    for (topic, message, now_ns), time_s in arrivals:
        if topic == messages.GROUND_TRUTH:
            truth[messages.stamp_ns(message)] = messages.planar_pose(message)
        if topic not in topics:
            continue
        for output in localizer.receive(topic, message, now_ns).outputs:
            odom.append(_odom(output, time_s, truth))
            started = started or output.estimate is not None
            if started:
                remarks += _remarks(output, time_s)
            rejected += _rejected_fixes(output)
    return Drive(odom=tuple(odom), remarks=tuple(remarks), rejected=tuple(rejected))


def recovery(
    run: Drive, onset_s: float, since_s: float, shift: Sequence[float] = NO_SHIFT
) -> Recovery:
    """Return what a fault did to a run.

    Args:
        run: the run.
        onset_s: when the fault began [s]; errors and messages count from then on.
        since_s: the time from which on the recovery is counted [s].
        shift: what is added to the true pose from the onset on (m, m, rad).
    """
    later = [odom for odom in run.odom if odom.time_s >= onset_s]
    pose = np.array([odom.pose for odom in later])
    truth = np.array([odom.truth for odom in later]) + np.asarray(shift)
    error = pose_errors(pose, truth)
    distance, rotation = np.hypot(error[:, 0], error[:, 1]), np.abs(error[:, 2])
    share = np.fmax(distance / LARGEST_GOOD_M, rotation / LARGEST_GOOD_RAD)
    times_s, share = with_gaps(np.array([odom.time_s for odom in later]), share)
    return Recovery(
        time_s=time_to_recover(times_s, share, since_s),
        largest_m=float(np.nanmax(distance)),
        largest_rad=float(np.nanmax(rotation)),
        finite=all(odom.finite for odom in later),
        rejected=longest_row(run.rejected),
        said=_news(run.remarks, onset_s),
    )


def with_gaps(times_s: FloatArray, share: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return times and errors `(n,)` with a missing pose, NaN, in each gap."""
    gaps = np.flatnonzero(np.diff(times_s) > LONGEST_GAP_S) + 1
    return (
        np.insert(times_s, gaps, times_s[gaps - 1] + LONGEST_GAP_S),
        np.insert(share, gaps, math.nan),
    )


def time_to_recover(times_s: FloatArray, share: FloatArray, since_s: float) -> float:
    """Return how long after a time the pose had recovered from its largest error [s].

    It has when it is good, from then on for `HELD_S`: the noise alone exceeds the bounds now and
    then where a sensor is missing.

    Args:
        times_s: `(n,)` increasing [s].
        share: `(n,)` errors over the largest ones of a good pose; NaN where there is no pose.
        since_s: the time [s].

    Returns:
        0 if the pose was always good, NaN if it had not recovered `HELD_S` before the end.
    """
    good = share <= 1.0
    if np.all(good):
        return 0.0
    worst = int(np.argmax(np.where(np.isnan(share), 0.0, share)))
    from_s = max(since_s, float(times_s[worst])) if not good[worst] else since_s
    for place in np.flatnonzero(good & (times_s >= from_s)):
        held = (times_s >= times_s[place]) & (times_s < times_s[place] + HELD_S)
        if times_s[-1] >= times_s[place] + HELD_S and np.all(good[held]):
            return max(float(times_s[place]) - since_s, 0.0)
    return math.nan


def longest_row(flags: Iterable[bool]) -> int:
    """Return the largest number of flags in a row that are set."""
    longest = row = 0
    for flag in flags:
        row = row + 1 if flag else 0
        longest = max(longest, row)
    return longest


def largest_difference(one: Sequence[Odom], other: Sequence[Odom]) -> float:
    """Return the largest distance of the positions of two runs at the same stamps [m].

    It is infinite where only one of them has a pose.
    """
    first, second = ({odom.stamp_ns: odom.pose[:2] for odom in run} for run in (one, other))
    if not first or first.keys() != second.keys():
        return math.inf
    return max(_apart(first[stamp], second[stamp]) for stamp in first)


def _apart(one: FloatArray, other: FloatArray) -> float:
    missing = [bool(np.any(np.isnan(position))) for position in (one, other)]
    if any(missing):
        return 0.0 if all(missing) else math.inf
    return float(np.hypot(*(one - other)))


def heard(
    fake: FakeRobot, duration_s: float, spoil: Spoil | None = None, own_clock: bool = False
) -> Iterator[tuple[Heard, float]]:
    """Yield what a robot sends, each message with the time since its start [s].

    Args:
        fake: the robot, before its first step.
        duration_s: how long it drives [s].
        spoil: changes messages.
        own_clock: whether the listener has the robot's clock.
    """
    start_ns = fake.time_ns
    for _ in range(round(duration_s * 1e9) // STEP_NS):
        for sent in fake.step():
            message = as_object(sent.message)
            if spoil is not None:
                spoil(sent.topic, message)
            now_ns = fake.stamp_ns if own_clock else fake.time_ns
            arrival = Heard(topic=sent.topic, message=message, now_ns=now_ns)
            yield arrival, (fake.time_ns - start_ns) * 1e-9


def _odom(output: Output, time_s: float, truth: Mapping[int, FloatArray]) -> Odom:
    unknown = np.full(3, math.nan)
    estimate = output.estimate
    pose = unknown if estimate is None else np.asarray(estimate.state.mean)
    finite = estimate is None or bool(
        np.all(np.isfinite(pose)) and np.all(np.isfinite(estimate.state.covariance))
    )
    true = truth.get(output.stamp_ns, unknown)
    return Odom(time_s=time_s, stamp_ns=output.stamp_ns, pose=pose, truth=true, finite=finite)


def _remarks(output: Output, time_s: float) -> list[Remark]:
    return [
        Remark(time_s=time_s, status=status.name, level=status.level, message=message)
        for status in output.statuses or ()
        if status.level > Level.OK
        for message in status.message.split("; ")
    ]


def _rejected_fixes(output: Output) -> list[bool]:
    if output.estimate is None or output.estimate.result is None:
        return []
    return [
        bool(shown.rejected[LRF_POSE])
        for shown in output.estimate.result.shown
        if shown.sensor_degrees_of_freedom[LRF_POSE]
    ]


def _news(remarks: Iterable[Remark], onset_s: float) -> dict[tuple[str, str], float]:
    """Return what was said from the onset on and not in the time before it."""
    known: set[tuple[str, str]] = set()
    found: dict[tuple[str, str], float] = {}
    for time_s, status, level, message in remarks:
        key = (f"{status} {level.name}", message)
        if time_s < onset_s:
            known.add(key)
        elif key not in known:
            found.setdefault(key, time_s - onset_s)
    return found


def fix_variance(value: float, entries: Sequence[int], from_s: float, until_s: float) -> Spoil:
    """Return a change of the fixes: entries of the covariance's diagonal get a value.

    Args:
        value: the variance (m^2, rad^2).
        entries: of x, y, z, roll, pitch, yaw: 0 to 5.
        from_s: since the robot's start, by the fixes' stamps [s].
        until_s: likewise [s].
    """
    window_ns = range(START_NS + round(from_s * 1e9), START_NS + round(until_s * 1e9))

    def spoil(topic: str, message: Any) -> None:
        if topic == messages.LRF_POSE and messages.stamp_ns(message) in window_ns:
            covariance = np.array(message.pose.covariance).reshape(6, 6)
            covariance[entries, entries] = value
            message.pose.covariance = covariance.ravel()

    return spoil
