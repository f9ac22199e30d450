"""The gate: readings that cannot be are kept from the filter, sensor by sensor.

A reading is rejected if its normalised innovation squared NIS = r' S^-1 r exceeds what a right
one exceeds with a small chance, times the sensor's *spread*. Nothing can be locked out:

    spread      s <- max(1, 0.7 s + 0.3 NIS/n) with a reading that is accepted,
                s <- 1.65 s with one that is rejected and that agrees with none before it;
                a sensor faster than the nominal period gets there in the same time
    learning    where R is learned, readings that are rejected and agree with nothing teach, too,
                that it was too small; the spread stays smaller there, or together they would
                take a fix in millimeters for one in meters
    relocation  readings that are rejected but agree with each other are another place
                (`relocation`): the pose moves there after some seconds

A reading that is rejected teaches the adaptation nothing, unless the one before it or several of
late were rejected, too, and no other place of the robot explains it: that is noise, and noise is
to be learned. So a single outlier has exactly the effect of a missing reading, except on which
compass readings are scored (`pace`) and, in mode joint, on how fast what was learned fades.
"""

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from fnn_ekf_ros.core.arrays import BoolArray, FloatArray
from fnn_ekf_ros.core.chi_square import exceeded_with
from fnn_ekf_ros.core.rows import LRF_POSE, SENSOR_COUNT, SENSOR_OF_ROW

SPREAD_MEMORY = 0.7
"""Part of the spread that an accepted reading of a slow sensor leaves."""
SPREAD_GROWTH = 1.65
"""With e^(1/2) a rejected reading, a gate that is too tight by 25 in variance opens after six."""

LARGEST_SPREAD = 1e5
"""Noise is never told too small by more than 300 in std: a fix in millimeters stays rejected."""
LARGEST_SPREAD_LEARNING = 100.0
"""Where R is learned; 10 in std are bridged at once, what is more is learned."""
SHARE_MEMORY = 0.9
"""Part of the share of rejected readings that is remembered from one to the next."""
NOISY_SHARE = 0.095
"""A share that the reading before leaves, or several lately: a rejected one is noise then."""


class Gate(NamedTuple):
    """How wild a reading must be to be rejected.

    Attributes:
        thresholds: for each sensor the largest NIS by its number of rows, 0 to 3.
    """

    thresholds: tuple[tuple[float, ...], tuple[float, ...]]

    @property
    def is_open(self) -> bool:
        """Whether it rejects nothing."""
        return _rejects_nothing(self)


@lru_cache(maxsize=16)
def _rejects_nothing(gate: Gate) -> bool:
    return all(math.isinf(limit) for limits in gate.thresholds for limit in limits[1:])


class GateState(NamedTuple):
    """What the gate remembers.

    Attributes:
        spread: `(2, *batch)` s of each sensor, 1 or more.
        rejections: `(2, *batch)` how many readings of each sensor were rejected in a row.
        rejected_share: `(2, *batch)` how many were lately, as a part of all.
    """

    spread: FloatArray
    rejections: FloatArray
    rejected_share: FloatArray


class Verdict(NamedTuple):
    """What the gate says about the readings of an instant.

    Attributes:
        nis: `(2, *batch)` of each sensor; 0 where it did not speak.
        degrees_of_freedom: `(2, *batch)` n, how many rows it measured.
        rejected: `(2, *batch)` whether it was rejected.
    """

    nis: FloatArray
    degrees_of_freedom: FloatArray
    rejected: BoolArray


def gate_for(compass_chance: float, lrf_pose_chance: float) -> Gate:
    """Return the gate that rejects right readings with these chances; 0 for none at all."""
    compass, lrf_pose = (
        (math.inf, *(exceeded_with(chance, rows) for rows in (1, 2, 3)))
        for chance in (compass_chance, lrf_pose_chance)
    )
    return Gate((compass, lrf_pose))


OPEN_GATE = gate_for(0.0, 0.0)


def start_gate(batch: tuple[int, ...] = ()) -> GateState:
    """Return the state of a gate that has seen nothing."""
    none = np.zeros((SENSOR_COUNT, *batch))
    return GateState(np.ones_like(none), none, none)


def judge(gate: Gate, state: GateState, nis: FloatArray, rows: FloatArray) -> Verdict:
    """Return which sensors' readings are rejected.

    Args:
        gate: the thresholds.
        state: what was before.
        nis: `(2, *batch)` of each sensor against the filter's prediction.
        rows: `(2, *batch)` how many rows it measured.
    """
    return Verdict(nis, rows, nis > limits(gate, rows) * state.spread)


def limits(gate: Gate, rows: FloatArray) -> FloatArray:
    """Return the largest NIS `(2, *batch)` for numbers of rows `(2, *batch)`."""
    table = _table(gate)
    place = rows.astype(np.intp)
    place[LRF_POSE] += len(table) // SENSOR_COUNT
    return table[place]


@lru_cache(maxsize=16)
def _table(gate: Gate) -> FloatArray:
    """Return the thresholds of one sensor after the other's."""
    return np.ravel(gate.thresholds)


def rows_of(sensors: BoolArray) -> BoolArray:
    """Return `(4, *batch)` for rows what `(2, *batch)` says for their sensors."""
    found: BoolArray = sensors[SENSOR_OF_ROW]
    return found


def after_verdict(
    state: GateState,
    verdict: Verdict,
    agrees: BoolArray,
    elapsed: FloatArray,
    *,
    learns: bool,
) -> GateState:
    """Return the state after an instant.

    Args:
        state: before it.
        verdict: what was said in it.
        agrees: `(2, *batch)` whether a reading agrees with those that were rejected before it.
        elapsed: `(2, *batch)` since the sensor's last reading [nominal periods]; from 1 on a
            reading is worth a whole one.
        learns: whether R is learned from what is rejected.
    """
    spoke = verdict.degrees_of_freedom > 0.0
    largest = LARGEST_SPREAD_LEARNING if learns else LARGEST_SPREAD
    kept, growth = _rates(elapsed)
    mean_nis = verdict.nis / np.maximum(verdict.degrees_of_freedom, 1.0)
    spread = kept * state.spread + (1.0 - kept) * mean_nis
    spread = np.minimum(np.maximum(spread, 1.0), largest)
    share = SHARE_MEMORY * state.rejected_share
    rejections = state.rejections
    if verdict.rejected.any():
        grown = np.minimum(growth * state.spread, largest)
        spread = np.where(verdict.rejected, np.where(agrees, state.spread, grown), spread)
        share += (1.0 - SHARE_MEMORY) * verdict.rejected
    return GateState(
        np.where(spoke, spread, state.spread),
        np.where(spoke, (rejections + 1.0) * verdict.rejected, rejections),
        np.where(spoke, share, state.rejected_share),
    )


def _rates(elapsed: FloatArray) -> tuple[FloatArray | float, FloatArray | float]:
    """Return what a reading leaves of the spread, and by how much it widens it."""
    if (elapsed >= 1.0).all():
        return SPREAD_MEMORY, SPREAD_GROWTH
    part = np.minimum(elapsed, 1.0)
    return SPREAD_MEMORY**part, SPREAD_GROWTH**part


def teaching(state: GateState, verdict: Verdict, explained: BoolArray) -> BoolArray:
    """Return whose readings `(2, *batch)` the adaptation is to learn from.

    Args:
        state: before the instant.
        verdict: what was said in it.
        explained: `(2, *batch)` whether another place of the robot explains a reading.
    """
    noisy = state.rejected_share >= NOISY_SHARE
    return ~verdict.rejected | (noisy & ~explained)
