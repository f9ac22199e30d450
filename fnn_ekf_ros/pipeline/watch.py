"""What is remembered of the last readings and periods to judge the sensors by.

It never touches the estimate. A `Watch` is a value like the filter's state and is kept beside it,
so that a period that is run again for late measurements is not counted twice.
"""

from typing import NamedTuple

import numpy as np

from fnn_ekf_ros.core.angles import wrap_angle
from fnn_ekf_ros.core.arrays import FloatArray, Row
from fnn_ekf_ros.core.gate import rows_of
from fnn_ekf_ros.core.joint import STANDSTILL
from fnn_ekf_ros.core.motion import move
from fnn_ekf_ros.core.pace import NOMINAL_PERIOD_S
from fnn_ekf_ros.core.results import Shown, StepResult
from fnn_ekf_ros.core.rows import COMPASS, LRF_POSE
from fnn_ekf_ros.core.state import FilterModel, FilterState, lasting_noise
from fnn_ekf_ros.core.suspects import SUSPECTS
from fnn_ekf_ros.pipeline.events import Move
from fnn_ekf_ros.pipeline.inputs import PeriodInputs
from fnn_ekf_ros.pipeline.start import Waiting
from fnn_ekf_ros.pipeline.wheel_sizes import Step, recent

READINGS = 20
"""So many readings of a sensor are looked back at, of a fast one not each."""
LASTING = 10
"""And at as many that end so many readings earlier: what lasts is in both."""
APART_NS = round(0.75 * NOMINAL_PERIOD_S * 1e9)
"""So long at least lies between them [ns]: each reading of a sensor that speaks once a period is
looked at, whatever its jitter, and of a faster one's, whose errors last, some."""
LEAD_LASTS_NS = 1_500_000_000
"""So long a suspect's lead has to last [ns]: fixes and compass may need some readings to tell a
wheel that slips from a wild reading."""


class Readings(NamedTuple):
    """The last readings of a sensor, the newest last.

    Attributes:
        nis: of the last `READINGS` + `LASTING` that were accepted.
        rows: how many rows each of these measured.
        rejected: of the last `READINGS` of all, whether the gate rejected them.
        last_ns: when the newest one was read [ns].
    """

    nis: tuple[float, ...] = ()
    rows: tuple[int, ...] = ()
    rejected: tuple[bool, ...] = ()
    last_ns: int = -(2**63)


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
        readings: of the compass and of the fixes, in the order of `core.gate`.
        fix_ns: end of the period in which a fix was accepted last, or the filter started, later by
            the time that the robot has stood since [ns].
        yaw_ns: likewise of a yaw [ns].
        moved: the last time that the gate moved the pose; None: it has not.
        moves: how often it has.
        agreeing: how many fixes in a row were rejected and agree with each other and the wheels.
        measured_ns: ends of the periods in which a position and a yaw was really accepted last
            [ns].
        leads: the suspects' leads of the last `LEAD_LASTS_NS`, the newest last.
        steps: the last periods, to judge the wheels' sizes by, the newest last.
    """

    readings: tuple[Readings, Readings]
    fix_ns: int
    yaw_ns: int
    moved: Move | None = None
    moves: int = 0
    agreeing: int = 0
    measured_ns: tuple[int, int] = (0, 0)
    leads: tuple[Leads, ...] = ()
    steps: tuple[Step, ...] = ()


def begin_watch(end_ns: int) -> Watch:
    """Return the watch over a filter that starts, or whose pose was set, at an instant [ns]."""
    return Watch(
        (Readings(), Readings()),
        end_ns,
        end_ns,
        leads=(Leads(end_ns, (0.0,) * len(SUSPECTS)),),
        measured_ns=(end_ns, end_ns),
    )


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
        begun = begin_watch(end_ns)
        return begun if watch is None else begun._replace(moved=watch.moved, moves=watch.moves)
    return _watch(model, watch, before, after, inputs, result, end_ns)


def _watch(
    model: FilterModel,
    watch: Watch,
    before: FilterState,
    after: FilterState,
    inputs: PeriodInputs,
    result: StepResult,
    end_ns: int,
) -> Watch:
    """Return the watch after a period of a filter that ran all the time."""
    accepted = [shown.available & ~rows_of(shown.rejected) for shown in result.shown]
    stood_ns = round(model.period_s * 1e9) if stands(inputs.control, model.period_s) else 0
    position = any(rows[Row.X] for rows in accepted) or bool(result.relocated)
    yaw = any(rows[Row.COMPASS_YAW] or rows[Row.LRF_YAW] for rows in accepted)
    fix_ns, yaw_ns = watch.measured_ns
    leads = Leads(end_ns, tuple(float(lead) for lead in after.lead))
    watch = watch._replace(
        readings=_with_readings(watch.readings, inputs, result, end_ns),
        fix_ns=end_ns if position else watch.fix_ns + stood_ns,
        yaw_ns=end_ns if yaw else watch.yaw_ns + stood_ns,
        measured_ns=(end_ns if position else fix_ns, end_ns if yaw else yaw_ns),
    )
    expected = move(model.motion_model, before.mean, inputs.control).mean
    if result.relocated:  # another place explains it all
        way = float(np.hypot(*(after.mean - expected)[:2]))
        turn = float(wrap_angle(after.mean[2] - expected[2]))
        return watch._replace(
            moved=Move(end_ns, way, turn),
            moves=watch.moves + 1,
            agreeing=0,
            leads=(leads,),
            steps=(),
        )
    recently = tuple(old for old in watch.leads if end_ns - old.stamp_ns <= LEAD_LASTS_NS)
    step = _step(model, before, after, inputs.control, expected, end_ns)
    return watch._replace(
        agreeing=int(after.candidate.confirmations[LRF_POSE]) if after.candidate.active else 0,
        leads=(*recently, leads),
        steps=recent(watch.steps, step),
    )


def _step(
    model: FilterModel,
    before: FilterState,
    after: FilterState,
    control: FloatArray,
    expected: FloatArray,
    end_ns: int,
) -> Step:
    """Return by how much measurements moved the filter from where the wheels `expected` it."""
    noise = lasting_noise(model, before)[0] * (model.period_s / NOMINAL_PERIOD_S)
    heading = float(after.mean[2])
    ahead = np.array([np.cos(heading), np.sin(heading)])
    return Step(
        stamp_ns=end_ns,
        way=float(control[0]),
        turn=float(control[1]),
        way_correction=float(ahead @ (after.mean - expected)[:2]),
        turn_correction=float(wrap_angle(after.mean[2] - expected[2])),
        way_noise=float(noise[0]),
        turn_noise=float(noise[1]),
        position_variance=float(np.max(np.diagonal(after.covariance)[:2])),
        yaw_variance=float(after.covariance[2, 2]),
    )


def _with_readings(
    readings: tuple[Readings, Readings], inputs: PeriodInputs, result: StepResult, end_ns: int
) -> tuple[Readings, Readings]:
    """Return the readings of both sensors with those of a period."""
    left_s = sum(epoch.duration_s for epoch in inputs.epochs)
    compass, fixes = readings[COMPASS], readings[LRF_POSE]
    shown = iter(result.shown)
    for epoch in inputs.epochs:
        left_s -= epoch.duration_s
        if epoch.available.any():
            seen = next(shown)
            stamp_ns = end_ns - round(left_s * 1e9)
            compass = _with_reading(compass, seen, COMPASS, stamp_ns)
            fixes = _with_reading(fixes, seen, LRF_POSE, stamp_ns)
    return compass, fixes


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
