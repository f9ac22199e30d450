# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Effect of a fault on a run: errors before, during and after it, and what the node said."""

import math
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from faults.scenarios import END_S, LASTS_S, ONSET_S, FaultScenario, Remark, Run
from fnn_ekf_ros.evaluation.evaluation import STATE_DEGREES, against_truth
from fnn_ekf_ros.timeline.events import Level
from fnn_ekf_ros.timeline.trajectory import Trajectory, interpolate

SETTLED_S = 15.0
"""Robot time from which on the time before a fault is evaluated [s]: the start is as bad as a
fault."""
PERIOD_S = 0.375
"""The filter's period [s]."""
SAME_M = 1e-3
"""Largest difference before the fault of two runs that are compared pose by pose [m]."""


class Said(NamedTuple):
    """A message that the node sent first so long after the onset [s]."""

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


class FaultEffect(NamedTuple):
    """Effect of a fault on a run.

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


def window(run: Run, begin_s: float, end_s: float) -> Window:
    """Return the errors of the odom in `[begin_s, end_s)` of robot time."""
    times = run.odom.time_ns / 1e9
    inside = (times >= begin_s) & (times < end_s)
    part = Trajectory(
        time_ns=run.odom.time_ns[inside],
        pose=run.odom.pose[inside],
        covariance=run.odom.covariance[inside],
    )
    found = against_truth(part, run.truth)
    if found is None:
        return Window(rmse=math.nan, largest=math.nan, nees=math.nan)
    largest = float(np.nanmax(position_error(part, run.truth)))
    nees = STATE_DEGREES * found.nees.ratio
    return Window(rmse=found.errors.position.rmse, largest=largest, nees=nees)


def position_error(odom: Trajectory, truth: Trajectory) -> NDArray[np.float64]:
    """Return the distances `(n,)` from the truth [m]; NaN where that is not known."""
    error = odom.pose - interpolate(truth, odom.time_ns)
    return np.hypot(error[:, 0], error[:, 1])


def missing_odom(odom: Trajectory, begin_s: float, end_s: float) -> int:
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

    What was said before `SETTLED_S` does not count.
    """
    known: set[tuple[str, Level, str]] = set()
    found: list[Said] = []
    for time_s, status, level, message in remarks:
        key = (status, level, message)
        if time_s < SETTLED_S or key in known:
            continue
        known.add(key)
        if time_s >= ONSET_S:
            found.append(
                Said(after_s=time_s - ONSET_S, status=status, level=level, message=message)
            )
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


def fault_effect(
    row: FaultScenario, run: Run, undisturbed: Run, without: Run | None = None
) -> FaultEffect:
    """Return the effect of a row's fault.

    Args:
        row: what was injected.
        run: its run.
        undisturbed: the run without a fault and with the same encoders.
        without: what `moved` compares it with, if not that one.
    """
    over_s = row.over_s
    seconds = run.odom.time_ns / 1e9
    bound = largest_usual_error(undisturbed)
    reported = [remark for remark in run.remarks if remark.time_s >= ONSET_S]
    reported_s = sorted({remark.time_s for remark in reported})
    troubled = {remark.time_s for remark in reported if remark.level is not Level.OK}
    return FaultEffect(
        before=window(run, SETTLED_S, ONSET_S),
        during=window(run, ONSET_S, ONSET_S + LASTS_S),
        after=window(run, ONSET_S + LASTS_S, END_S),
        moved=moved(run, without or undisturbed),
        missing=missing_odom(run.odom, ONSET_S, END_S - 3.0 * PERIOD_S),
        finite=run.finite,
        said=news(run.remarks),
        recovered_s=back_after(
            list(seconds), list(position_error(run.odom, run.truth) > bound), over_s
        ),
        fine_s=back_after(reported_s, [time in troubled for time in reported_s], over_s),
    )


def largest_usual_error(undisturbed: Run) -> float:
    """Return what a position error has to exceed to be called large [m].

    Half as much again as the largest one without a fault.
    """
    return 1.5 * window(undisturbed, SETTLED_S, END_S).largest
