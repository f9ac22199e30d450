"""What is remembered of the last periods to judge the sensors by; it never touches the estimate.

A `Watch` is a value like the filter's state and is kept beside it, so that a period that is run
again for late measurements is not counted twice.
"""

from typing import NamedTuple

import numpy as np

from fnn_ekf_ros.core.angles import wrap_angle
from fnn_ekf_ros.core.arrays import FloatArray, Row
from fnn_ekf_ros.core.filter import (
    NOMINAL_PERIOD_S,
    FilterModel,
    FilterState,
    StepInput,
    StepResult,
    lasting_noise,
)
from fnn_ekf_ros.core.gate import COMPASS, LRF_POSE, rows_of
from fnn_ekf_ros.core.joint import STANDSTILL
from fnn_ekf_ros.core.motion import move
from fnn_ekf_ros.core.suspects import SUSPECTS, SuspectState, no_suspects, suspect
from fnn_ekf_ros.pipeline.events import Move
from fnn_ekf_ros.pipeline.inputs import PeriodInputs
from fnn_ekf_ros.pipeline.period import FAILURES
from fnn_ekf_ros.pipeline.start import Waiting
from fnn_ekf_ros.pipeline.wheel_sizes import Step, recent

READINGS = 20
"""So many readings of a sensor are looked back at."""
LASTING = 10
"""And at as many that end so many readings earlier: what lasts is in both."""
LEAD_LASTS_NS = 1_500_000_000
"""So long a suspect's lead has to last [ns]: fixes and compass may need some periods to tell a
wheel that slips from a wild reading."""


class Readings(NamedTuple):
    """The last readings of a sensor, the newest last.

    Attributes:
        nis: of the last `READINGS` + `LASTING` that were accepted.
        rows: how many rows each of these measured.
        rejected: of the last `READINGS` of all, whether the gate rejected them.
    """

    nis: tuple[float, ...] = ()
    rows: tuple[int, ...] = ()
    rejected: tuple[bool, ...] = ()


class Leads(NamedTuple):
    """How the suspects were at the end of a period.

    Attributes:
        stamp_ns: its end [ns].
        leads: of `SUSPECTS` [nats].
    """

    stamp_ns: int
    leads: tuple[float, ...]


class Watch(NamedTuple):
    """What is remembered.

    Attributes:
        suspects: who does not fit the other two.
        readings: of the compass and of the fixes, in the order of `core.gate`.
        fix_ns: when a fix was accepted last, or the filter started, later by the time that the
            robot has stood since [ns].
        yaw_ns: likewise of a yaw [ns].
        moved: the last time that the gate moved the pose; None: it has not.
        moves: how often it has.
        agreeing: how many fixes in a row were rejected and agree with each other and the wheels.
        measured_ns: when a position and when a yaw was really accepted last [ns].
        leads: the suspects' leads of the last `LEAD_LASTS_NS`, the newest last.
        steps: the last periods, to judge the wheels' sizes by, the newest last.
    """

    suspects: SuspectState
    readings: tuple[Readings, Readings]
    fix_ns: int
    yaw_ns: int
    moved: Move | None = None
    moves: int = 0
    agreeing: int = 0
    measured_ns: tuple[int, int] = (0, 0)
    leads: tuple[Leads, ...] = ()
    steps: tuple[Step, ...] = ()


def begin_watch(state: FilterState, end_ns: int) -> Watch:
    """Return the watch over a filter that starts, or whose pose was set, at an instant [ns]."""
    nobody = no_suspects(state.mean, state.covariance)
    return Watch(
        nobody,
        (Readings(), Readings()),
        end_ns,
        end_ns,
        leads=(_no_leads(end_ns),),
        measured_ns=(end_ns, end_ns),
    )


def _no_leads(end_ns: int) -> Leads:
    return Leads(end_ns, (0.0,) * len(SUSPECTS))


def stands(control: FloatArray, period_s: float) -> bool:
    """Return whether the wheels say that the robot stood, by way and turn of a period `(2,)`.

    A localizer like AMCL sends no fixes then, and nothing is wrong.
    """
    largest = np.asarray(STANDSTILL) * (period_s / NOMINAL_PERIOD_S)
    return bool(np.all(np.abs(control) < largest))


def watch_after(
    model: FilterModel,
    watch: Watch | None,
    before: FilterState | Waiting,
    after: FilterState | Waiting,
    inputs: PeriodInputs,
    result: StepResult | None,
    end_ns: int,
) -> Watch | None:
    """Return the watch after a period; None while no filter runs.

    Args:
        model: the filter.
        watch: before the period; not changed.
        before: the localizer at its begin.
        after: the localizer at its end.
        inputs: of the period.
        result: what the period showed; None if no filter ran.
        end_ns: its end [ns].
    """
    if isinstance(after, Waiting):
        return None
    if watch is None or isinstance(before, Waiting) or result is None or inputs.reset is not None:
        begun = begin_watch(after, end_ns)
        return begun if watch is None else begun._replace(moved=watch.moved, moves=watch.moves)
    return _watch(model, watch, before, after, inputs.step, result, end_ns)


def _watch(
    model: FilterModel,
    watch: Watch,
    before: FilterState,
    after: FilterState,
    period: StepInput,
    result: StepResult,
    end_ns: int,
) -> Watch:
    """Return the watch after a period of a filter that ran all the time."""
    accepted = period.available & ~rows_of(result.rejected)
    stood_ns = round(model.period_s * 1e9) if stands(period.control, model.period_s) else 0
    readings = tuple(
        _with_reading(watch.readings[sensor], result, sensor) for sensor in (COMPASS, LRF_POSE)
    )
    position, yaw = bool(accepted[Row.X]), bool(accepted[Row.COMPASS_YAW] or accepted[Row.LRF_YAW])
    position |= bool(result.relocated)
    fix_ns, yaw_ns = watch.measured_ns
    watch = watch._replace(
        readings=(readings[COMPASS], readings[LRF_POSE]),
        fix_ns=end_ns if position else watch.fix_ns + stood_ns,
        yaw_ns=end_ns if yaw else watch.yaw_ns + stood_ns,
        measured_ns=(end_ns if position else fix_ns, end_ns if yaw else yaw_ns),
    )
    expected = move(model.motion_model, before.mean, period.control).mean
    if result.relocated:
        way = float(np.hypot(*(after.mean - expected)[:2]))
        turn = float(wrap_angle(after.mean[2] - expected[2]))
        return watch._replace(
            suspects=no_suspects(after.mean, after.covariance),  # another place explains it all
            moved=Move(end_ns, way, turn),
            moves=watch.moves + 1,
            agreeing=0,
            leads=(_no_leads(end_ns),),
            steps=(),
        )
    suspects = _suspects(model, watch.suspects, before, after, period)
    leads = Leads(end_ns, tuple(float(lead) for lead in suspects.lead))
    recently = tuple(old for old in watch.leads if end_ns - old.stamp_ns <= LEAD_LASTS_NS)
    step = _step(model, before, after, period, expected, end_ns)
    return watch._replace(
        suspects=suspects,
        agreeing=int(after.candidate.confirmations[LRF_POSE]) if after.candidate.active else 0,
        leads=(*recently, leads),
        steps=recent(watch.steps, step),
    )


def _step(
    model: FilterModel,
    before: FilterState,
    after: FilterState,
    period: StepInput,
    expected: FloatArray,
    end_ns: int,
) -> Step:
    """Return by how much measurements moved the filter from where the wheels `expected` it."""
    usual = lasting_noise(model, before.process_noise, before.measurement_noise, before.joint)
    noise = usual[0] * model.plant.period_scale
    heading = float(after.mean[2])
    ahead = np.array([np.cos(heading), np.sin(heading)])
    return Step(
        stamp_ns=end_ns,
        way=float(period.control[0]),
        turn=float(period.control[1]),
        way_correction=float(ahead @ (after.mean - expected)[:2]),
        turn_correction=float(wrap_angle(after.mean[2] - expected[2])),
        way_noise=float(noise[0]),
        turn_noise=float(noise[1]),
        position_variance=float(np.max(np.diagonal(after.covariance)[:2])),
        yaw_variance=float(after.covariance[2, 2]),
    )


def _with_reading(readings: Readings, result: StepResult, sensor: int) -> Readings:
    rows = int(result.sensor_degrees_of_freedom[sensor])
    if not rows:
        return readings
    rejected = bool(result.rejected[sensor])
    known = readings._replace(rejected=(*readings.rejected, rejected)[-READINGS:])
    if rejected:
        return known
    return known._replace(
        nis=(*readings.nis, float(result.sensor_nis[sensor]))[-READINGS - LASTING :],
        rows=(*readings.rows, rows)[-READINGS - LASTING :],
    )


def _suspects(
    model: FilterModel,
    suspects: SuspectState,
    before: FilterState,
    after: FilterState,
    period: StepInput,
) -> SuspectState:
    """Return the suspects after a period; none where their filters leave the finite numbers."""
    noise = lasting_noise(model, before.process_noise, before.measurement_noise, before.joint)
    published = after.mean, after.covariance
    try:
        found = suspect(model.plant, suspects, noise, period, published)
    except FAILURES:
        return no_suspects(*published)
    finite = np.all(np.isfinite(found.lead)) and np.all(np.isfinite(found.mean))
    return found if finite else no_suspects(*published)
