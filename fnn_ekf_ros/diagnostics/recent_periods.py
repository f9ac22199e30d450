# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The last readings and periods, by which diagnostics judge the sensors.

They never affect the estimate. `RecentPeriods` is a value like the filter's state and is kept
beside it, so that a period that is run again for late measurements is not counted twice.
"""

from typing import NamedTuple

import numpy as np

from fnn_ekf_ros.core.angles import wrap_angle
from fnn_ekf_ros.core.arrays import FloatArray
from fnn_ekf_ros.core.joint import STANDSTILL
from fnn_ekf_ros.core.motion import move
from fnn_ekf_ros.core.pace import NOMINAL_PERIOD_S
from fnn_ekf_ros.core.results import Shown, StepResult
from fnn_ekf_ros.core.rows import COMPASS, LRF_POSE, SENSOR_OF_ROW
from fnn_ekf_ros.core.sensor_lag import Lags, at_another_pose, lags_after
from fnn_ekf_ros.core.state import FilterModel, FilterState, persistent_noise
from fnn_ekf_ros.core.suspects import SUSPECTS
from fnn_ekf_ros.diagnostics.wheel_sizes import PeriodCorrection, with_correction
from fnn_ekf_ros.timeline.events import Move
from fnn_ekf_ros.timeline.initialization import AwaitingStart
from fnn_ekf_ros.timeline.inputs import PeriodInputs

READINGS = 20
"""Number of the last readings of a sensor that are evaluated: few enough to show a fault within
seconds. Of a fast sensor not every reading counts (`APART_NS`)."""
LASTING = 10
"""Number of readings by which a second, earlier set of `READINGS` ends before the last: a lasting
scatter shows in both sets."""
APART_NS = round(0.75 * NOMINAL_PERIOD_S * 1e9)
"""Least time between two readings that are evaluated [ns]: of a sensor with one reading a period
each counts, whatever its jitter, and some of a faster sensor, whose errors are correlated."""
LEAD_LASTS_NS = 1_500_000_000
"""Time for which a suspect's lead has to last [ns]: fixes and compass may need some readings to
distinguish wheel slip from an outlier."""


class Readings(NamedTuple):
    """The last readings of a sensor, the newest last.

    Attributes:
        nis: of the last `READINGS` + `LASTING` that were accepted.
        rows: number of rows of each of these.
        rejected: whether the gate rejected them, of the last `READINGS` of all.
        last_ns: stamp of the newest one [ns].
    """

    nis: tuple[float, ...] = ()
    rows: tuple[int, ...] = ()
    rejected: tuple[bool, ...] = ()
    last_ns: int = -(2**63)


class Leads(NamedTuple):
    """The suspects' leads at the end of a period.

    Attributes:
        stamp_ns: its end [ns].
        leads: of `SUSPECTS` [nats].
    """

    stamp_ns: int
    leads: tuple[float, ...]


class SensorReadings(NamedTuple):
    """The last readings of the two measuring sensors, in the order of `core.rows`."""

    compass: Readings = Readings()
    lrf_pose: Readings = Readings()


class RecentPeriods(NamedTuple):
    """History of the last periods of a filter.

    Attributes:
        readings: of the compass and of the fixes.
        start_ns: end of the period in which the filter started [ns].
        fix_ns: end of the period in which a fix was accepted last, or the filter started, later by
            the time that the robot has stood since [ns].
        yaw_ns: likewise of a yaw [ns].
        moved: the last move of the pose by the gate; None: there was none.
        moves: number of these moves.
        agreeing: consecutive rejected fixes that agree with each other and the wheels.
        leads: the suspects' leads of the last `LEAD_LASTS_NS`, the newest last.
        corrections: of the last periods, which show the wheels' sizes, the newest last.
        lags: what is known of the lags of compass and fixes.
    """

    readings: SensorReadings
    start_ns: int
    fix_ns: int
    yaw_ns: int
    moved: Move | None = None
    moves: int = 0
    agreeing: int = 0
    leads: tuple[Leads, ...] = ()
    corrections: tuple[PeriodCorrection, ...] = ()
    lags: Lags = Lags()


def begin_recent(end_ns: int) -> RecentPeriods:
    """Return what is kept when a filter starts, or its pose is set, at an instant [ns]."""
    return RecentPeriods(
        readings=SensorReadings(),
        start_ns=end_ns,
        fix_ns=end_ns,
        yaw_ns=end_ns,
        leads=(Leads(end_ns, (0.0,) * len(SUSPECTS)),),
    )


def stands(control: FloatArray, period_s: float) -> bool:
    """Return whether the robot stood, by the wheels' [distance, rotation] of a period `(2,)`.

    A localizer like AMCL sends no fixes then, which is no fault.
    """
    largest = np.asarray(STANDSTILL) * (period_s / NOMINAL_PERIOD_S)
    return bool(np.all(np.abs(control) < largest))


def last_move(recent: RecentPeriods | None) -> Move | None:
    """Return the last move of the pose by the gate, if there was one."""
    return None if recent is None else recent.moved


def new_move(known: Move | None, recent: RecentPeriods | None) -> Move | None:
    """Return the last move of the pose if it is another one than the known one."""
    moved = last_move(recent)
    if moved is None or (known is not None and moved.stamp_ns == known.stamp_ns):
        return None
    return moved


def recent_after(
    model: FilterModel,
    recent: RecentPeriods | None,
    before: FilterState | AwaitingStart,
    after: FilterState | AwaitingStart,
    inputs: PeriodInputs,
    result: StepResult | None,
    end_ns: int,
) -> RecentPeriods | None:
    """Return what is kept after a period; None while no filter runs.

    Args:
        model: the filter.
        recent: before the period; not changed.
        before: the localizer at its begin.
        after: the localizer at its end.
        inputs: of the period.
        result: what the period showed; None if no filter ran.
        end_ns: its end [ns].
    """
    if isinstance(after, AwaitingStart):
        return None
    begun = begin_recent(end_ns)
    if recent is None:
        return begun
    if isinstance(before, AwaitingStart) or result is None or inputs.reset is not None:
        return begun._replace(
            start_ns=recent.start_ns,
            moved=recent.moved,
            moves=recent.moves,
            lags=at_another_pose(recent.lags),
        )
    return _after_running(model, recent, before, after, inputs, result, end_ns)


def _after_running(
    model: FilterModel,
    recent: RecentPeriods,
    before: FilterState,
    after: FilterState,
    inputs: PeriodInputs,
    result: StepResult,
    end_ns: int,
) -> RecentPeriods:
    """Return what is kept after a period of a filter that ran all the time."""
    stood_ns = round(model.period_s * 1e9) if stands(inputs.control, model.period_s) else 0
    leads = Leads(end_ns, tuple(float(lead) for lead in after.lead))
    recent = recent._replace(
        readings=_with_readings(recent.readings, inputs, result, end_ns),
        fix_ns=end_ns if result.accepted_position else recent.fix_ns + stood_ns,
        yaw_ns=end_ns if result.accepted_yaw else recent.yaw_ns + stood_ns,
        lags=_lags_after(recent.lags, inputs, result),
    )
    expected = move(model.motion_model, before.mean, inputs.control).mean
    if result.relocated:  # another place explains it all
        distance = float(np.hypot(*(after.mean - expected)[:2]))
        rotation = float(wrap_angle(after.mean[2] - expected[2]))
        return recent._replace(
            moved=Move(end_ns, distance, rotation),
            moves=recent.moves + 1,
            agreeing=0,
            leads=(leads,),
            corrections=(),
            lags=at_another_pose(recent.lags),
        )
    if _offset_changed(before, after):  # the filters start again from another pose
        return recent._replace(
            agreeing=0, leads=(leads,), corrections=(), lags=at_another_pose(recent.lags)
        )
    hypothesis = after.relocation_hypothesis
    still_counted = tuple(old for old in recent.leads if end_ns - old.stamp_ns <= LEAD_LASTS_NS)
    correction = _correction(model, before, after, inputs.control, expected, end_ns)
    return recent._replace(
        agreeing=int(hypothesis.confirmations[LRF_POSE]) if hypothesis.active else 0,
        leads=(*still_counted, leads),
        corrections=with_correction(recent.corrections, correction),
    )


def _offset_changed(before: FilterState, after: FilterState) -> bool:
    """Return whether the compass's offset was found, given up, or found again."""
    if before.lasting is None or after.lasting is None:
        return False
    then, now = before.lasting.offset, after.lasting.offset
    return bool(now.believed != then.believed or (then.doubted and not now.doubted))


def _correction(
    model: FilterModel,
    before: FilterState,
    after: FilterState,
    control: FloatArray,
    expected: FloatArray,
    end_ns: int,
) -> PeriodCorrection:
    """Return the measurements' correction of the pose that the wheels let `expected` be."""
    Q, _ = persistent_noise(model, before.process_noise, before.measurement_noise, before.joint)
    noise = Q * (model.period_s / NOMINAL_PERIOD_S)
    yaw = float(after.mean[2])
    ahead = np.array([np.cos(yaw), np.sin(yaw)])
    return PeriodCorrection(
        stamp_ns=end_ns,
        distance=float(control[0]),
        rotation=float(control[1]),
        distance_correction=float(ahead @ (after.mean - expected)[:2]),
        rotation_correction=float(wrap_angle(after.mean[2] - expected[2])),
        distance_noise=float(noise[0]),
        rotation_noise=float(noise[1]),
        position_variance=float(np.max(np.diagonal(after.covariance)[:2])),
        yaw_variance=float(after.covariance[2, 2]),
    )


def _lags_after(lags: Lags, inputs: PeriodInputs, result: StepResult) -> Lags:
    """Return what is known of the lags after a period."""
    shown = iter(result.shown)
    for epoch in inputs.epochs:
        if not epoch.available.any():
            lags = lags_after(lags, epoch)
            continue
        seen = next(shown)
        accepted = seen.available & ~seen.rejected[SENSOR_OF_ROW]
        lags = lags_after(lags, epoch, float(seen.heading), accepted)
    return lags


def _with_readings(
    readings: SensorReadings, inputs: PeriodInputs, result: StepResult, end_ns: int
) -> SensorReadings:
    """Return the readings of both sensors with those of a period."""
    left_s = sum(epoch.duration_s for epoch in inputs.epochs)
    compass, fixes = readings
    shown = iter(result.shown)
    for epoch in inputs.epochs:
        left_s -= epoch.duration_s
        if epoch.available.any():
            seen = next(shown)
            stamp_ns = end_ns - round(left_s * 1e9)
            compass = _with_reading(compass, seen, COMPASS, stamp_ns)
            fixes = _with_reading(fixes, seen, LRF_POSE, stamp_ns)
    return SensorReadings(compass, fixes)


def _with_reading(readings: Readings, shown: Shown, sensor: int, stamp_ns: int) -> Readings:
    rows = int(shown.sensor_degrees_of_freedom[sensor])
    if not rows or stamp_ns - readings.last_ns < APART_NS:
        return readings
    rejected = bool(shown.rejected[sensor])
    known = readings._replace(rejected=(*readings.rejected, rejected)[-READINGS:], last_ns=stamp_ns)
    if rejected:
        return known
    return known._replace(
        nis=(*readings.nis, float(shown.sensor_nis[sensor]))[-READINGS - LASTING :],
        rows=(*readings.rows, rows)[-READINGS - LASTING :],
    )
