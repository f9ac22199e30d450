"""How long ago what was read, and which readings are scored.

Every reading corrects the filters. What the noise is learned from, and who is suspected by, are the
readings that are scored: all fixes, and of the compass one after each fix, or a few a second
without any. Errors of a fast compass last for many readings; as so many independent ones they would
outweigh the fixes, and say nothing that those few do not.

Times are counted in nominal periods. Alarms fade with time; the gate opens and closes with time
where sensors are fast, and with readings where they are slow: a reading that follows the last one
after less than a nominal period counts for that part of one.
"""

from typing import NamedTuple

import numpy as np

from fnn_ekf_ros.core.arrays import BoolArray, FloatArray, Row
from fnn_ekf_ros.core.rows import LRF_POSE, SENSOR_COUNT, Rows, rows_where

NOMINAL_PERIOD_S = 0.375
"""The paper's period [s]; process noise is given for one step of this length."""
COMPASS_INTERVAL = 0.75
"""A compass is scored so often where no fixes come [nominal periods]: each reading of one that is
read once a period, whatever its jitter."""
NO_FIXES = 0.999
"""No fixes come where none was read for so long [nominal periods]; else the next is waited for."""
STEP_INTERVAL = 0.75
"""No fix is a step of the forecasts sooner after one [nominal periods]: they look as far ahead with
fast fixes as with the paper's, or errors that last from one to the next would fool them."""
_COMPASS_SCORED, _ANY_SCORED = SENSOR_COUNT, SENSOR_COUNT + 1
_FIX_STEP = _ANY_SCORED + 1
_TIMES = _FIX_STEP + 1


class Pace(NamedTuple):
    """Times since the last readings.

    Attributes:
        since: `(5, *batch)` since the compass and since a fix was read, since a reading of the
            compass was scored and since any was, and since a fix was a step of the forecasts
            [nominal periods].
    """

    since: FloatArray

    @property
    def sensors(self) -> FloatArray:
        """`(2, *batch)` since the last reading of each sensor, in the order of `gate`."""
        return self.since[:SENSOR_COUNT]

    @property
    def scored(self) -> FloatArray:
        """`(*batch)` since the last reading that was scored."""
        return np.asarray(self.since[_ANY_SCORED])

    @property
    def compass_follows_a_fix(self) -> BoolArray:
        """`(*batch)` whether a fix was read since the compass was scored last."""
        return np.asarray(self.since[LRF_POSE] < self.since[_COMPASS_SCORED])


def start_pace(batch: tuple[int, ...]) -> Pace:
    """Return the pace at a start: the first readings count in full."""
    return Pace(np.ones((_TIMES, *batch)))


def later(pace: Pace, elapsed: float) -> Pace:
    """Return the pace after some time [nominal periods]."""
    return Pace(pace.since + elapsed)


def scored_rows(pace: Pace, rows: Rows) -> Rows:
    """Return which of the rows that were measured are scored.

    Args:
        pace: of the readings before.
        rows: that were measured.
    """
    since = pace.since
    by_time = (since[LRF_POSE] >= NO_FIXES) & (since[_COMPASS_SCORED] >= COMPASS_INTERVAL)
    due = rows.fix | pace.compass_follows_a_fix | by_time
    if due.all():
        return rows
    scored = rows.each.copy()
    scored[Row.COMPASS_YAW] &= due
    return rows_where(scored)


def is_step(pace: Pace, scored: Rows) -> BoolArray:
    """Return whether scored readings are a step of the forecasts, `(*batch)`.

    A compass that is scored because a fix came before it belongs to that fix's step, and a fix that
    follows soon belongs to it, too.
    """
    by_time = scored.each[Row.COMPASS_YAW] & ~pace.compass_follows_a_fix
    by_fix = pace.since[_FIX_STEP] >= STEP_INTERVAL
    return np.asarray(np.where(scored.fix, by_fix, by_time))


def after_readings(pace: Pace, rows: Rows, scored: Rows, steps: BoolArray) -> Pace:
    """Return the pace after readings.

    Args:
        pace: of the readings before.
        rows: that were measured.
        scored: those of them that were scored.
        steps: `(*batch)` whether they are a step of the forecasts.
    """
    now = np.empty(pace.since.shape, dtype=np.bool_)
    np.greater(rows.of_sensor, 0.0, out=now[:SENSOR_COUNT])
    now[_COMPASS_SCORED] = scored.each[Row.COMPASS_YAW]
    now[_ANY_SCORED] = scored.some
    now[_FIX_STEP] = steps & scored.fix
    return Pace(np.where(now, 0.0, pace.since))
