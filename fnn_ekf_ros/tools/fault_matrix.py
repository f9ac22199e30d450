"""What a fault did to a recorded run: errors before, during and after it, and what was said.

Everything is told by robot time: seconds since the fake robot's start, which its own clock shows
but for a fault `clock_jump`.
"""

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fnn_ekf_ros import messages
from fnn_ekf_ros.bag_files import BagReader
from fnn_ekf_ros.errors import FnnEkfError
from fnn_ekf_ros.parameters.fault_files import faults_from
from fnn_ekf_ros.parameters.faults import ClockJump, Fault
from fnn_ekf_ros.pipeline.events import Level
from fnn_ekf_ros.tools.scoring import Score, Track, interpolate, score

SETTLED_S, ONSET_S, LASTS_S, END_S = 15.0, 30.0, 20.0, 90.0
"""The time before a fault counts from the first, the fault begins at the second and lasts for the
third, and the run ends at the last [s]."""
SWITCHED_ON_S = 5.0
"""Nothing is measured before: all runs begin alike, however soon their processes have met [s]."""
LATEST_ODOM_S = 1.0
"""A localizer that gets its turn publishes encoder_timeout after a period's end at the latest; one
that is later was too slow for the clock [s]."""
PERIOD_S = 0.375
TRUTH_INTERVAL_NS = 125_000_000
SAME_M = 1e-3
"""Runs that differ by less before the fault can be compared pose by pose [m]."""
RECORDED = {
    "/odom": messages.ODOMETRY_TYPE,
    "/ground_truth": messages.ODOMETRY_TYPE,
    "/localizer/noise": messages.NOISE_TYPE,
    "/diagnostics": messages.DIAGNOSTICS_TYPE,
}
"""What a run is judged by: type name by topic."""
_OVERRUN = re.compile(r"^late by .* more than a period$")
"""What the status time says when the machine, not the robot, was late: not the fault's doing."""
_NUMBER = re.compile(r"[-+]?\b(?:\d+(?:\.\d*)?(?:[eE][-+]?\d+)?|nan|inf)\b")


class Row(NamedTuple):
    """A run of the matrix.

    Attributes:
        name: of a few words.
        meaning: what it stands for on a real robot.
        timeline: the faults, as a faults_file holds them.
        localizer: parameters of the localizer, as `name:=value`.
        robot: parameters of the fake robot.
        ticks: whether the encoders are `left_ticks` and `right_ticks`; otherwise `joint_states`.
    """

    name: str
    meaning: str
    timeline: tuple[Mapping[str, Any], ...] = ()
    localizer: tuple[str, ...] = ()
    robot: tuple[str, ...] = ()
    ticks: bool = False

    @property
    def faults(self) -> tuple[Fault, ...]:
        """Return the timeline, checked."""
        return faults_from(self.timeline, self.name)

    @property
    def over_s(self) -> float:
        """Return when the last fault is over; the onset where none is [s]."""
        return max([ONSET_S, *(fault.end for fault in self.faults)])


class Remark(NamedTuple):
    """A status of /diagnostics at a robot time [s]."""

    time_s: float
    status: str
    level: Level
    message: str


class Run(NamedTuple):
    """A recorded run in robot time.

    Attributes:
        odom: what the localizer published; its messages outside of robot time are left out.
        truth: where the robot was.
        remarks: all statuses, in order.
        finite: whether every number of odom and ~/noise was.
    """

    odom: Track
    truth: Track
    remarks: tuple[Remark, ...]
    finite: bool


class Said(NamedTuple):
    """What the node said first so long after the onset [s]; numbers aside it is new."""

    after_s: float
    status: str
    level: Level
    message: str


class Window(NamedTuple):
    """Errors in a part of a run; NaN without odom.

    Attributes:
        rmse: root mean square of the position error [m].
        largest: the largest position error [m].
        nees: mean of e' P^-1 e; its expectation is 3.
    """

    rmse: float
    largest: float
    nees: float


class Verdict(NamedTuple):
    """What came of a row.

    Attributes:
        before: from `SETTLED_S` to the onset.
        during: from the onset for `LASTS_S`, also where the fault is an instant.
        after: the rest.
        moved: the largest distance from the pose at the same time without the fault, from the
            onset on [m]; NaN where the robot moved otherwise or the runs differ from the start.
        missing: odom messages that did not come, from the onset on.
        finite: whether every number was.
        said: what was new on /diagnostics from the onset on.
        recovered_s: when the position error was back for good, after the fault's end [s]; 0 if it
            never was large then, NaN if it was large at the run's end.
        fine_s: when all statuses were OK for good, after the fault's end [s]; 0 if none was not
            OK then, NaN if one was not at the run's end.
    """

    before: Window
    during: Window
    after: Window
    moved: float
    missing: int
    finite: bool
    said: tuple[Said, ...]
    recovered_s: float
    fine_s: float


def robot_times(stamps_ns: Sequence[int], jump: ClockJump | None) -> NDArray[np.float64]:
    """Return the robot times of stamps [s]; NaN for what the clock jumped over.

    Args:
        stamps_ns: in the order of arrival [ns].
        jump: what happened to the clock.
    """
    stamps = np.asarray(stamps_ns, dtype=np.int64)
    if jump is None or not len(stamps):
        return stamps / 1e9
    start_ns, size_ns = round(jump.start * 1e9), round(jump.size * 1e9)
    went_back = np.concatenate([[False], np.cumsum(np.diff(stamps) < 0) > 0])
    since = went_back | (stamps > start_ns + max(size_ns, 0))
    times = np.where(since, stamps - size_ns, stamps) / 1e9
    times[~since & (stamps > start_ns)] = math.nan
    return times


def read_run(path: Path, row: Row) -> Run:
    """Return the recorded run of a row, up to `END_S`.

    Raises:
        FnnEkfError: the recording does not hold the whole run.
    """
    jumps = [fault for fault in row.faults if isinstance(fault, ClockJump)]
    if len(jumps) > 1:
        raise FnnEkfError(f"{row.name}: {len(jumps)} clock jumps, expected one at most")
    jump = jumps[0] if jumps else None
    found: dict[str, list[Any]] = {topic: [] for topic in RECORDED}
    arrived: dict[str, list[int]] = {topic: [] for topic in RECORDED}
    with BagReader(path) as bag:
        for record in bag.records(set(RECORDED)):
            found[record.topic].append(bag.message(record))
            arrived[record.topic].append(record.time_ns)
    truth, odom = (_track(found[topic], jump) for topic in ("/ground_truth", "/odom"))
    _check_whole(row, truth, odom)
    late_s = latency(
        robot_times(_stamps_ns(found["/odom"]), jump),
        robot_times(_stamps_ns(found["/ground_truth"]), jump),
        np.array(arrived["/odom"]),
        np.array(arrived["/ground_truth"]),
    )
    if late_s > LATEST_ODOM_S:
        raise FnnEkfError(
            f"{row.name}: odom came up to {late_s:.1f} s late, expected {LATEST_ODOM_S:g} s at "
            "most: the machine is too busy"
        )
    heard_ns = _stamps_ns(found["/ground_truth"])
    if jump is None and len(set(heard_ns)) < len(heard_ns):
        raise FnnEkfError(f"{row.name}: more than one robot was heard")
    statuses = found["/diagnostics"]
    times = robot_times(_stamps_ns(statuses), jump)
    remarks = tuple(
        Remark(
            float(time), status.name.split(": ", 1)[-1], Level(int(status.level)), status.message
        )
        for time, message in zip(times, statuses, strict=True)
        for status in message.status
        if time <= END_S and not _OVERRUN.search(status.message)
    )
    finite = all(map(_all_finite, found["/odom"])) and all(
        np.all(np.isfinite(message.data)) for message in found["/localizer/noise"]
    )
    return Run(odom, truth, remarks, finite)


def latency(
    odom_s: NDArray[np.float64],
    truth_s: NDArray[np.float64],
    odom_arrived: NDArray[np.int64],
    truth_arrived: NDArray[np.int64],
) -> float:
    """Return the longest robot time that had passed when an odom message arrived [s].

    Args:
        odom_s: robot times of the odom messages in the order of arrival [s].
        truth_s: those of the ground truth, which is sent without delay [s].
        odom_arrived: when the odom messages arrived, by any clock.
        truth_arrived: when the ground truth did, by the same clock.
    """
    latest = np.searchsorted(truth_arrived, odom_arrived, side="right") - 1
    late = truth_s[np.maximum(latest, 0)] - odom_s
    return float(np.nanmax(late[latest >= 0], initial=0.0))


def window(run: Run, begin_s: float, end_s: float) -> Window:
    """Return the errors of the odom in `[begin_s, end_s)` of robot time."""
    times = run.odom.time_ns / 1e9
    inside = (times >= begin_s) & (times < end_s)
    part = Track(run.odom.time_ns[inside], run.odom.pose[inside], run.odom.covariance[inside])
    found: Score | None = score(part, run.truth)
    if found is None:
        return Window(math.nan, math.nan, math.nan)
    largest = float(np.nanmax(position_error(part, run.truth)))
    return Window(found.rmse_position, largest, found.mean_nees)


def position_error(odom: Track, truth: Track) -> NDArray[np.float64]:
    """Return the distances `(n,)` from the truth [m]; NaN where that is not known."""
    error = odom.pose - interpolate(truth, odom.time_ns)
    return np.hypot(error[:, 0], error[:, 1])


def missing_odom(odom: Track, begin_s: float, end_s: float) -> int:
    """Return how many odom messages there should be between two times, but are not."""
    inside = (odom.time_ns >= begin_s * 1e9) & (odom.time_ns < end_s * 1e9)
    return max(round((end_s - begin_s) / PERIOD_S) - int(np.sum(inside)), 0)


def moved(run: Run, undisturbed: Run) -> float:
    """Return the largest distance between two runs' poses from the onset on [m].

    NaN if their robots do not drive the same way or the poses differ before.
    """
    common, mine, others = np.intersect1d(
        run.truth.time_ns, undisturbed.truth.time_ns, return_indices=True
    )
    if not len(common) or not np.array_equal(run.truth.pose[mine], undisturbed.truth.pose[others]):
        return math.nan
    common, mine, others = np.intersect1d(
        run.odom.time_ns, undisturbed.odom.time_ns, return_indices=True
    )
    apart = run.odom.pose[mine, :2] - undisturbed.odom.pose[others, :2]
    distance = np.hypot(apart[:, 0], apart[:, 1])
    seconds = common / 1e9
    earlier = distance[(seconds >= SETTLED_S) & (seconds < ONSET_S)]
    later = distance[seconds >= ONSET_S]
    if not len(earlier) or not len(later) or np.max(earlier) > SAME_M:
        return math.nan
    return float(np.max(later))


def news(remarks: Iterable[Remark]) -> tuple[Said, ...]:
    """Return what was said from the onset on and not before, each when it was said first.

    Remarks that differ in their numbers only are the same. What was said before `SETTLED_S` does
    not count: the start is as bad as a fault.
    """
    known: set[tuple[str, Level, str]] = set()
    found: list[Said] = []
    for time_s, status, level, message in remarks:
        key = (status, level, _NUMBER.sub("#", message))
        if time_s < SETTLED_S or key in known:
            continue
        known.add(key)
        if time_s >= ONSET_S:
            found.append(Said(time_s - ONSET_S, status, level, message))
    return tuple(found)


def back_after(times_s: Sequence[float], bad: Sequence[bool], since_s: float) -> float:
    """Return how long after a time things were bad for the last time [s]: until the next good one.

    Args:
        times_s: `(n,)` increasing [s].
        bad: `(n,)` whether they were at those times.
        since_s: the time [s].

    Returns:
        0 if nothing was bad later, NaN if the last one is.
    """
    later = [place for place, time in enumerate(times_s) if bad[place] and time >= since_s]
    if not later:
        return 0.0
    return math.nan if later[-1] + 1 == len(times_s) else times_s[later[-1] + 1] - since_s


def judge(row: Row, run: Run, undisturbed: Run) -> Verdict:
    """Return what came of a row.

    Args:
        row: what was injected.
        run: its run.
        undisturbed: the run without a fault and with the same encoders.
    """
    over_s = row.over_s
    seconds = run.odom.time_ns / 1e9
    bound = largest_usual_error(undisturbed)
    told = [remark for remark in run.remarks if remark.time_s >= ONSET_S]
    told_s = sorted({remark.time_s for remark in told})
    troubled = {remark.time_s for remark in told if remark.level is not Level.OK}
    return Verdict(
        before=window(run, SETTLED_S, ONSET_S),
        during=window(run, ONSET_S, ONSET_S + LASTS_S),
        after=window(run, ONSET_S + LASTS_S, END_S),
        moved=moved(run, undisturbed),
        missing=missing_odom(run.odom, ONSET_S, END_S - 3.0 * PERIOD_S),
        finite=run.finite,
        said=news(run.remarks),
        recovered_s=back_after(
            list(seconds), list(position_error(run.odom, run.truth) > bound), over_s
        ),
        fine_s=back_after(told_s, [time in troubled for time in told_s], over_s),
    )


def largest_usual_error(undisturbed: Run) -> float:
    """Return what a position error has to exceed to be called large [m].

    Half as much again as the largest one without a fault.
    """
    return 1.5 * window(undisturbed, SETTLED_S, END_S).largest


def _stamps_ns(found: Sequence[Any]) -> list[int]:
    return [messages.stamp_ns(message) for message in found]


def _track(found: Sequence[Any], jump: ClockJump | None) -> Track:
    """Return nav_msgs/Odometry messages by robot time; of equal times the first."""
    times = robot_times(_stamps_ns(found), jump)
    inside = np.flatnonzero(times <= END_S)  # NaN is not
    time_ns, first = np.unique(np.round(times[inside] * 1e9).astype(np.int64), return_index=True)
    kept = [found[place] for place in inside[first]]
    return Track(
        time_ns,
        np.array([messages.planar_pose(message) for message in kept]).reshape(-1, 3),
        np.array([messages.planar_block(message.pose.covariance) for message in kept]).reshape(
            -1, 3, 3
        ),
    )


def _check_whole(row: Row, truth: Track, odom: Track) -> None:
    """Refuse a recording that began too late, lost truth, or heard two robots."""
    steps = np.diff(truth.time_ns)
    first_s = [track.time_ns[0] / 1e9 if len(track.time_ns) else END_S for track in (truth, odom)]
    if first_s[0] > SWITCHED_ON_S or first_s[1] > SWITCHED_ON_S + 1.0:
        raise FnnEkfError(f"{row.name}: the nodes met too late, or there is no odom")
    if np.any(steps != TRUTH_INTERVAL_NS) or truth.time_ns[-1] < (END_S - 1.0) * 1e9:
        raise FnnEkfError(
            f"{row.name}: ground_truth has steps of {np.min(steps) * 1e-9:g} to "
            f"{np.max(steps) * 1e-9:g} s and ends at {truth.time_ns[-1] * 1e-9:g} s"
        )


def _all_finite(message: Any) -> bool:
    pose, twist = message.pose.pose, message.twist.twist
    numbers = [
        *(getattr(pose.position, axis) for axis in "xyz"),
        *(getattr(pose.orientation, axis) for axis in "xyzw"),
        *(getattr(twist.linear, axis) for axis in "xyz"),
        *(getattr(twist.angular, axis) for axis in "xyz"),
        *message.pose.covariance,
        *message.twist.covariance,
    ]
    return bool(np.all(np.isfinite(numbers)))
