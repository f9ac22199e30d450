# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The gate: it keeps outliers from the filter, separately for each sensor.

A reading of n rows is rejected if its normalized innovation squared NIS = r' S^-1 r exceeds the
threshold x(n) times the sensor's *spread* s. A correct reading exceeds x(n) with a small, given
probability. Three mechanisms keep the gate from rejecting a sensor forever:

    spread      s <- max(1, 0.7 s + 0.3 NIS/n)    after an accepted reading,
                s <- 1.65 s                       after a rejected reading that does not agree
                                                  with the rejected readings before it;
                readings less than a nominal period apart change s by less, so that a fast
                sensor's gate opens and closes in the same time as a slow one's
    learning    Where R is adapted, it is learned also from rejected readings that agree with no
                other pose. There the limit of the spread is lower: with a high one, R would be
                adapted to fixes in millimeters instead of meters.
    relocation  Rejected readings that agree with each other show another pose (`relocation`); the
                pose is moved there after some seconds.

The noise is learned from a rejected reading only if half of the recent ones were rejected, too, and
no other pose explains it: then the assumed noise is too small. So a single
outlier has the same effect as a missing reading, except on which compass readings are scored
(`pace`) and, in mode joint, on how fast what was learned fades.
"""

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from fnn_ekf_ros.core.arrays import BoolArray, FloatArray
from fnn_ekf_ros.core.chi_square import exceeded_with
from fnn_ekf_ros.core.rows import LRF_POSE, SENSOR_COUNT, SENSOR_OF_ROW

SPREAD_MEMORY = 0.7
"""Factor on the spread per accepted reading that comes a nominal period or more after the last:
the spread decays faster than one outlier in three readings widens it."""
SPREAD_GROWTH = 1.65
"""Factor on the spread per rejected reading, about e^(1/2): a gate that is too tight by a factor of
25 in variance opens after six rejections."""

LARGEST_SPREAD = 1e5
"""Largest spread where R is not adapted. The configured noise may be too small by a factor of 300
in standard deviation; fixes in millimeters instead of meters stay rejected."""
LARGEST_SPREAD_LEARNING = 100.0
"""Largest spread where R is adapted: the gate bridges a factor of 10 in standard deviation, the
adaptation of R the rest."""
SHARE_MEMORY = 0.9
"""Factor on the share of rejected readings per reading; the share covers about ten readings."""
NOISY_SHARE = 0.5
"""Share of rejected readings from which on the noise is learned from rejected ones: a noise
that is assumed too small by far gets there in seven readings; a third of outliers, scattered or all
at one place, hardly ever does."""


class Gate(NamedTuple):
    """The NIS from which on readings are rejected.

    Attributes:
        thresholds: x(n) of each sensor (compass, fixes), for n = 0 to 3 rows; infinite: none is
            rejected.
    """

    thresholds: tuple[tuple[float, ...], tuple[float, ...]]

    @property
    def is_open(self) -> bool:
        """Whether no reading is ever rejected."""
        return _rejects_nothing(self)


@lru_cache(maxsize=16)
def _rejects_nothing(gate: Gate) -> bool:
    return all(math.isinf(limit) for limits in gate.thresholds for limit in limits[1:])


class GateState(NamedTuple):
    """The gate's memory of earlier readings.

    Attributes:
        spread: `(2, *batch)` s of each sensor, at least 1.
        rejections: `(2, *batch)` number of consecutive rejected readings of each sensor.
        rejected_share: `(2, *batch)` share of rejected readings of each sensor, with the memory
            `SHARE_MEMORY`.
    """

    spread: FloatArray
    rejections: FloatArray
    rejected_share: FloatArray


class GateDecision(NamedTuple):
    """Decision of the gate on the readings of an instant.

    Attributes:
        nis: `(2, *batch)` NIS of each sensor; 0 where it measured nothing.
        degrees_of_freedom: `(2, *batch)` n, number of rows that each sensor measured.
        rejected: `(2, *batch)` whether each sensor's reading is rejected.
    """

    nis: FloatArray
    degrees_of_freedom: FloatArray
    rejected: BoolArray


def gate_for(compass_chance: float, lrf_pose_chance: float) -> Gate:
    """Return the gate that rejects correct readings with given probabilities; 0: rejects none."""
    compass, lrf_pose = (
        (math.inf, *(exceeded_with(chance, rows) for rows in (1, 2, 3)))
        for chance in (compass_chance, lrf_pose_chance)
    )
    return Gate((compass, lrf_pose))


OPEN_GATE = gate_for(0.0, 0.0)
"""The gate that rejects nothing."""


def start_gate(batch: tuple[int, ...] = ()) -> GateState:
    """Return the memory before the first reading."""
    none = np.zeros((SENSOR_COUNT, *batch))
    return GateState(np.ones_like(none), none, none)


def judge(gate: Gate, state: GateState, nis: FloatArray, rows: FloatArray) -> GateDecision:
    """Return which sensors' readings are rejected.

    Args:
        gate: the thresholds.
        state: before the readings.
        nis: `(2, *batch)` NIS of each sensor against the filter's prediction.
        rows: `(2, *batch)` number of rows that each sensor measured.
    """
    return GateDecision(nis, rows, nis > limits(gate, rows) * state.spread)


def limits(gate: Gate, rows: FloatArray) -> FloatArray:
    """Return the thresholds x(n), `(2, *batch)`, for numbers of rows `(2, *batch)`."""
    table = _table(gate)
    place = rows.astype(np.intp)
    place[LRF_POSE] += len(table) // SENSOR_COUNT
    return table[place]


@lru_cache(maxsize=16)
def _table(gate: Gate) -> FloatArray:
    """Return the thresholds of one sensor after the other's."""
    return np.ravel(gate.thresholds)


def rows_of(sensors: BoolArray) -> BoolArray:
    """Return values `(2, *batch)` of the sensors for each of their rows, `(4, *batch)`."""
    found: BoolArray = sensors[SENSOR_OF_ROW]
    return found


def after_decision(
    state: GateState,
    decision: GateDecision,
    agrees: BoolArray,
    elapsed: FloatArray,
    *,
    learns: bool,
) -> GateState:
    """Return the gate's memory after an instant's readings.

    Args:
        state: before them.
        decision: which of them are rejected.
        agrees: `(2, *batch)` whether a reading agrees with those that were rejected before it.
        elapsed: `(2, *batch)` time since the sensor's last reading [nominal periods]; more than 1
            counts as 1.
        learns: whether R is adapted.
    """
    measured = decision.degrees_of_freedom > 0.0
    largest = LARGEST_SPREAD_LEARNING if learns else LARGEST_SPREAD
    kept, growth = _rates(elapsed)
    mean_nis = decision.nis / np.maximum(decision.degrees_of_freedom, 1.0)
    spread = kept * state.spread + (1.0 - kept) * mean_nis
    spread = np.minimum(np.maximum(spread, 1.0), largest)
    share = SHARE_MEMORY * state.rejected_share
    rejections = state.rejections
    if decision.rejected.any():
        grown = np.minimum(growth * state.spread, largest)
        spread = np.where(decision.rejected, np.where(agrees, state.spread, grown), spread)
        share += (1.0 - SHARE_MEMORY) * decision.rejected
    return GateState(
        np.where(measured, spread, state.spread),
        np.where(measured, (rejections + 1.0) * decision.rejected, rejections),
        np.where(measured, share, state.rejected_share),
    )


def _rates(elapsed: FloatArray) -> tuple[FloatArray | float, FloatArray | float]:
    """Return the factors on the spread of an accepted and of a rejected reading."""
    if (elapsed >= 1.0).all():
        return SPREAD_MEMORY, SPREAD_GROWTH
    part = np.minimum(elapsed, 1.0)
    return SPREAD_MEMORY**part, SPREAD_GROWTH**part


def teaching(state: GateState, decision: GateDecision, explained: BoolArray) -> BoolArray:
    """Return from which sensors' readings, `(2, *batch)`, the noise may be learned.

    Args:
        state: before the readings.
        decision: which of them are rejected.
        explained: `(2, *batch)` whether another pose of the robot explains a reading.
    """
    noisy = state.rejected_share >= NOISY_SHARE
    return ~decision.rejected | (noisy & ~explained)
