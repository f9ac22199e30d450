"""The gate: readings that cannot be are kept from the filter, sensor by sensor.

A reading is rejected if its normalised innovation squared NIS = r' S^-1 r exceeds what a right
one exceeds with a small chance, times the sensor's *spread*. Nothing can be locked out:

    spread      s <- max(1, 0.7 s + 0.3 NIS/n) with a reading that is accepted,
                s <- 1.65 s with one that is rejected and that agrees with none before it
    learning    where R is learned, readings that are rejected and agree with nothing teach, too,
                that it was too small; the spread stays smaller there, or together they would
                take a fix in millimeters for one in meters
    relocation  readings that are rejected but agree with each other are another place
                (`relocation`): the pose moves there after some seconds

A reading that is rejected teaches the adaptation nothing, unless the one before it or several of
late were rejected, too, and no other place of the robot explains it: that is noise, and noise is
to be learned. So a lone wild fix does to the filter exactly what a missing one does.
"""

import math
from typing import NamedTuple

import numpy as np

from fnn_ekf_ros.core.arrays import BoolArray, FloatArray, Row
from fnn_ekf_ros.core.chi_square import exceeded_with
from fnn_ekf_ros.core.kalman import Innovation

SENSOR_COUNT = 2
COMPASS, LRF_POSE = range(SENSOR_COUNT)
"""The gated sensors, in this order wherever an axis is the sensors'."""
SENSOR_OF_ROW = [LRF_POSE, LRF_POSE, COMPASS, LRF_POSE]
"""Whose each row is, rows as in `Row`."""
SPREAD_MEMORY = 0.7
"""Part of the spread that an accepted reading leaves."""
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

_LRF_ROWS = [Row.X, Row.Y, Row.LRF_YAW]


class Gate(NamedTuple):
    """How wild a reading must be to be rejected.

    Attributes:
        thresholds: for each sensor the largest NIS by its number of rows, 0 to 3.
    """

    thresholds: tuple[tuple[float, ...], tuple[float, ...]]

    @property
    def is_open(self) -> bool:
        """Whether it rejects nothing."""
        return all(math.isinf(limit) for limits in self.thresholds for limit in limits[1:])


class GateState(NamedTuple):
    """What the gate remembers.

    Attributes:
        spread: `(..., 2)` s of each sensor, 1 or more.
        rejections: `(..., 2)` how many readings of each sensor were rejected in a row.
        rejected_share: `(..., 2)` how many were lately, as a part of all.
    """

    spread: FloatArray
    rejections: FloatArray
    rejected_share: FloatArray


class Verdict(NamedTuple):
    """What the gate says about the readings of a period.

    Attributes:
        nis: `(..., 2)` of each sensor; 0 where it did not speak.
        degrees_of_freedom: `(..., 2)` n, how many rows it measured.
        rejected: `(..., 2)` whether it was rejected.
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
    none = np.zeros((*batch, SENSOR_COUNT))
    return GateState(np.ones_like(none), none, none)


def nis_by_sensor(seen: Innovation, available: BoolArray) -> tuple[FloatArray, FloatArray]:
    """Return NIS and number of rows of each sensor, `(..., 2)` both."""
    r, S = seen.innovation, seen.innovation_covariance
    compass = r[..., Row.COMPASS_YAW] ** 2 / S[..., Row.COMPASS_YAW, Row.COMPASS_YAW]
    block = S[..., _LRF_ROWS, :][..., _LRF_ROWS]
    of_lrf = r[..., _LRF_ROWS]
    whitened = np.linalg.solve(block, of_lrf[..., None])[..., 0]
    nis = np.stack([compass, np.sum(of_lrf * whitened, axis=-1)], axis=-1)
    rows = available.astype(np.float64)
    count = np.stack([rows[..., Row.COMPASS_YAW], np.sum(rows[..., _LRF_ROWS], axis=-1)], axis=-1)
    return nis, count


def judge(gate: Gate, state: GateState, seen: Innovation, available: BoolArray) -> Verdict:
    """Return which sensors' readings are rejected.

    Args:
        gate: the thresholds.
        state: what was before.
        seen: innovations against the filter's prediction.
        available: `(..., 4)` which rows were measured.
    """
    nis, count = nis_by_sensor(seen, available)
    return Verdict(nis, count, nis > limits(gate, count) * state.spread)


def limits(gate: Gate, count: FloatArray) -> FloatArray:
    """Return the largest NIS `(..., 2)` for numbers of rows `(..., 2)`."""
    rows = count.astype(np.int64)
    return np.stack(
        [np.asarray(of_sensor)[rows[..., i]] for i, of_sensor in enumerate(gate.thresholds)],
        axis=-1,
    )


def rows_of(sensors: BoolArray) -> BoolArray:
    """Return `(..., 4)` for rows what `(..., 2)` says for their sensors."""
    return sensors[..., SENSOR_OF_ROW]


def after_verdict(
    state: GateState, verdict: Verdict, agrees: BoolArray, *, learns: bool
) -> GateState:
    """Return the state after a period.

    Args:
        state: before it.
        verdict: what was said in it.
        agrees: `(..., 2)` whether a reading agrees with those that were rejected before it.
        learns: whether R is learned from what is rejected.
    """
    n = np.maximum(verdict.degrees_of_freedom, 1.0)
    remembered = SPREAD_MEMORY * state.spread + (1.0 - SPREAD_MEMORY) * verdict.nis / n
    largest = LARGEST_SPREAD_LEARNING if learns else LARGEST_SPREAD
    grown = np.minimum(SPREAD_GROWTH * state.spread, largest)
    grown = np.where(agrees, state.spread, grown)
    spread = np.where(verdict.rejected, grown, np.clip(remembered, 1.0, largest))
    spoke = verdict.degrees_of_freedom > 0.0
    rejections = np.where(verdict.rejected, state.rejections + 1.0, 0.0)
    share = SHARE_MEMORY * state.rejected_share + (1.0 - SHARE_MEMORY) * verdict.rejected
    return GateState(
        np.where(spoke, spread, state.spread),
        np.where(spoke, rejections, state.rejections),
        np.where(spoke, share, state.rejected_share),
    )


def teaching(state: GateState, verdict: Verdict, explained: BoolArray) -> BoolArray:
    """Return whose readings `(..., 2)` the adaptation is to learn from.

    Args:
        state: before the period.
        verdict: what was said in it.
        explained: `(..., 2)` whether another place of the robot explains a reading.
    """
    noisy = state.rejected_share >= NOISY_SHARE
    return ~verdict.rejected | (noisy & ~explained)
