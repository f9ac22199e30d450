# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Times since the last readings, and which readings are scored.

Every reading corrects the filters. The noise is learned, and suspects are found, from the readings
that are *scored*: all fixes, and of the compass one reading after each fix, or a few a second
without fixes. Errors of a fast compass last for many readings. Counted as independent ones these
would outweigh the fixes, although they carry no more information than a few of them.

Times are given in nominal periods. Alarms fade with time. The gate opens and closes with time where
sensors are fast, and with the number of readings where they are slow: a reading that follows the
last one after less than a nominal period counts as that part of a reading.
"""

from typing import NamedTuple

import numpy as np

from fnn_ekf_ros.core.arrays import BoolArray, FloatArray, Row
from fnn_ekf_ros.core.rows import LRF_POSE, SENSOR_COUNT, Rows, rows_where

NOMINAL_PERIOD_S = 0.375
"""The paper's period [s]; Q is given for a step of this duration."""
COMPASS_INTERVAL = 0.75
"""Shortest time between scored compass readings without fixes [nominal periods]: every reading of a
compass with one reading per period is scored, whatever its jitter."""
NO_FIXES = 0.999
"""Time since the last fix from which on compass readings are scored without fixes [nominal
periods]; with fixes once a period the next one comes before, but for rounding."""
STEP_INTERVAL = 0.75
"""Shortest time between two fixes that are steps of the forecasts [nominal periods]. Forecasts look
as far ahead with fast fixes as with the paper's; errors that last from one fast fix to the next
would bias shorter forecasts."""
_COMPASS_SCORED, _ANY_SCORED = SENSOR_COUNT, SENSOR_COUNT + 1
_FIX_STEP = _ANY_SCORED + 1
_TIMES = _FIX_STEP + 1
"""Indices of the times after those of the sensors, and their number; see `Pace`."""


class Pace(NamedTuple):
    """Times since the last readings.

    Attributes:
        since: `(5, *batch)` times since the last compass reading, the last fix, the last scored
            compass reading, the last scored reading, and the last fix that was a step of the
            forecasts [nominal periods].
    """

    since: FloatArray

    @property
    def sensors(self) -> FloatArray:
        """`(2, *batch)` time since the last reading of each sensor [nominal periods]."""
        return self.since[:SENSOR_COUNT]

    @property
    def scored(self) -> FloatArray:
        """`(*batch)` time since the last scored reading [nominal periods]."""
        return np.asarray(self.since[_ANY_SCORED])

    @property
    def compass_follows_a_fix(self) -> BoolArray:
        """`(*batch)` whether a fix came after the last scored compass reading."""
        return np.asarray(self.since[LRF_POSE] < self.since[_COMPASS_SCORED])


def start_pace(batch: tuple[int, ...]) -> Pace:
    """Return the times at a start, 1 each, so that the first readings count in full."""
    return Pace(np.ones((_TIMES, *batch)))


def later(pace: Pace, elapsed: float) -> Pace:
    """Return the times after a duration [nominal periods]."""
    return Pace(pace.since + elapsed)


def scored_rows(pace: Pace, rows: Rows) -> Rows:
    """Return the measured rows that are scored.

    Args:
        pace: times since earlier readings.
        rows: the measured rows.
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

    A compass reading that is scored because a fix came before it belongs to that fix's step, and so
    does a fix that follows within `STEP_INTERVAL`.
    """
    by_time = scored.each[Row.COMPASS_YAW] & ~pace.compass_follows_a_fix
    by_fix = pace.since[_FIX_STEP] >= STEP_INTERVAL
    return np.asarray(np.where(scored.fix, by_fix, by_time))


def after_readings(pace: Pace, rows: Rows, scored: Rows, steps: BoolArray) -> Pace:
    """Return the times after readings.

    Args:
        pace: before the readings.
        rows: the measured rows.
        scored: those of them that are scored.
        steps: `(*batch)` whether they are a step of the forecasts.
    """
    now = np.empty(pace.since.shape, dtype=np.bool_)
    np.greater(rows.of_sensor, 0.0, out=now[:SENSOR_COUNT])
    now[_COMPASS_SCORED] = scored.each[Row.COMPASS_YAW]
    now[_ANY_SCORED] = scored.some
    now[_FIX_STEP] = steps & scored.fix
    return Pace(np.where(now, 0.0, pace.since))
