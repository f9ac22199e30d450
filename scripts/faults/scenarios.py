# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Runs of the fault matrix, as they were recorded.

All times are robot times: seconds since the fake robot's start, which its own clock shows
but for a fault `clock_jump`.
"""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fnn_ekf_ros import messages
from fnn_ekf_ros.diagnostics.messages import TimeMessage
from fnn_ekf_ros.errors import FnnEkfError
from fnn_ekf_ros.parameters.fault_files import faults_from
from fnn_ekf_ros.parameters.faults import ClockJump, Fault
from fnn_ekf_ros.recordings.bag_files import BagReader
from fnn_ekf_ros.timeline.events import Level
from fnn_ekf_ros.timeline.trajectory import Trajectory

SWITCHED_ON_S, ONSET_S, LASTS_S, END_S = 5.0, 30.0, 20.0, 90.0
"""Robot times at which the sensors begin, so that all runs begin alike however soon their processes
have met, and the fault begins; duration of a fault that lasts; end of the run [s]."""
LATEST_ODOM_S, LATEST_WITHOUT_WHEELS_S = 0.5, 1.0
"""Largest delay of odom after a period's end, and the largest one where a wheel may be missing
[s]: the localizer publishes at once, or encoder_timeout after the end; a later one was too slow for
the clock."""
ON_TIME = ("compass", "lrf_pose")
"""Topics on which no odom waits."""
TRUTH_INTERVAL_NS = 125_000_000
"""Interval of the ground truth [ns]."""
RECORDED = {
    "/odom": messages.ODOMETRY_TYPE,
    "/ground_truth": messages.ODOMETRY_TYPE,
    "/localizer/noise": messages.NOISE_TYPE,
    "/diagnostics": messages.DIAGNOSTICS_TYPE,
}
"""Recorded topics of a run, each with the type name of its messages."""


class FaultScenario(NamedTuple):
    """A run of the matrix.

    Attributes:
        name: of a few words.
        meaning: what it stands for on a real robot.
        timeline: the faults, as a faults_file holds them.
        localizer: parameters of the localizer, as `name:=value`.
        robot: parameters of the fake robot.
        without: name of the row that shows what the run would be without the fault; empty for the
            one without any.
        ticks: whether the encoders are `left_ticks` and `right_ticks`; otherwise `joint_states`.
    """

    name: str
    meaning: str
    timeline: tuple[Mapping[str, Any], ...] = ()
    localizer: tuple[str, ...] = ()
    robot: tuple[str, ...] = ()
    without: str = ""
    ticks: bool = False

    @property
    def faults(self) -> tuple[Fault, ...]:
        """Return the timeline, checked."""
        return faults_from(self.timeline, self.name)

    @property
    def latest_odom_s(self) -> float:
        """Return how late odom may come [s]."""
        waits = any(set(fault.targets()) - set(ON_TIME) for fault in self.faults)
        return LATEST_WITHOUT_WHEELS_S if waits or self.localizer else LATEST_ODOM_S

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

    odom: Trajectory
    truth: Trajectory
    remarks: tuple[Remark, ...]
    finite: bool


def read_run(path: Path, row: FaultScenario) -> Run:
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
    if late_s > row.latest_odom_s:
        raise FnnEkfError(
            f"{row.name}: odom came up to {late_s:.1f} s late, expected {row.latest_odom_s:g} s at "
            "most: the machine is too busy"
        )
    heard_ns = _stamps_ns(found["/ground_truth"])
    if jump is None and len(set(heard_ns)) < len(heard_ns):
        raise FnnEkfError(f"{row.name}: more than one robot was heard")
    statuses = found["/diagnostics"]
    times = robot_times(_stamps_ns(statuses), jump)
    remarks = tuple(
        Remark(
            time_s=float(time),
            status=status.name.split(": ", 1)[-1],
            level=Level(int(status.level)),
            message=status.message,
        )
        for time, message in zip(times, statuses, strict=True)
        for status in message.status
        # The machine, not the robot, is the cause of an overrun.
        if time <= END_S and status.message != TimeMessage.OVERRUN
    )
    finite = all(map(_all_finite, found["/odom"])) and all(
        np.all(np.isfinite(message.data)) for message in found["/localizer/noise"]
    )
    return Run(odom=odom, truth=truth, remarks=remarks, finite=finite)


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


def _stamps_ns(found: Sequence[Any]) -> list[int]:
    return [messages.stamp_ns(message) for message in found]


def _track(found: Sequence[Any], jump: ClockJump | None) -> Trajectory:
    """Return nav_msgs/Odometry messages by robot time; of equal times the first."""
    times = robot_times(_stamps_ns(found), jump)
    inside = np.flatnonzero(times <= END_S)  # NaN is not
    time_ns, first = np.unique(np.round(times[inside] * 1e9).astype(np.int64), return_index=True)
    kept = [found[place] for place in inside[first]]
    return Trajectory(
        time_ns=time_ns,
        pose=np.array([messages.planar_pose(message) for message in kept]).reshape(-1, 3),
        covariance=np.array(
            [messages.planar_block(message.pose.covariance) for message in kept]
        ).reshape(-1, 3, 3),
    )


def _check_whole(row: FaultScenario, truth: Trajectory, odom: Trajectory) -> None:
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
