# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Relocation: rejected readings that agree with each other show where a carried robot is.

The *relocation hypothesis* is a filter of its own. It starts at the pose that the first rejected
reading shows, takes the components that this reading does not measure from the published filter,
and follows wheels and readings. A reading that the gate rejects and the hypothesis predicts
confirms it; a rejected reading that it does not predict starts it again. After enough
confirmations over a long enough time the published filter is moved to it.

Fixes alone suffice. A confirmation by the compass needs accepted fixes beside it, and their NIS
against the hypothesis must not exceed that against the published filter by much; otherwise a magnet
would turn the pose.
"""

import math
from typing import NamedTuple

import numpy as np

from fnn_ekf_ros.core.arrays import BoolArray, FloatArray, Row
from fnn_ekf_ros.core.bank import Bank, Correction, Innovations, Noise, Readings, correct, wrapped
from fnn_ekf_ros.core.gate import Gate, GateDecision, GateState, limits, rows_of
from fnn_ekf_ros.core.rows import COMPASS, LRF_POSE, SENSOR_COUNT

CONFIRMATIONS = 8
"""Consecutive readings that have to confirm a hypothesis. Two outliers that agree by chance are
common, eight are not."""
CONFIRMATION_S = 3.0
"""Shortest time over which they confirm it [s]: eight readings of a fast sensor can have one
cause."""
FEWEST_SUPPORTS = 2.0
"""Accepted fixes that a confirmation by the compass needs beside it: a single one can fit by
chance."""
LARGEST_DISAGREEMENT = 6.0
"""Largest sum of the accepted fixes' NIS against the hypothesis minus that against the published
filter, for a confirmation by the compass: noise alone rarely exceeds it."""

LASTING_CONFIRMATION_S = 30.0
"""Time that fixes whose errors last have to confirm it [s]: three time constants of such errors."""

LONGEST_CONFIRMATION_S = 60.0
"""Longest time that fixes have to confirm it [s]: a robot that was carried off twice is found."""
RECENT_S = 300.0
"""Time constant with which earlier relocations are forgotten [s]. Each of them doubles the time of
confirmation, unless fixes return to where they were before the last one: fixes that jump and come
back are followed once, and a robot is not carried off twice in a minute."""

ROUNDING_S = 1e-3
"""Tolerance on `CONFIRMATION_S` for the rounding of stamps [s]."""
LARGEST_LOSS = 10.0
"""Largest ratio of the hypothesis's position standard deviation to the published filter's. With a
larger one the rejected readings show a large noise rather than another place."""
CLEARLY_LESS = 1.0 / 9.0
"""Ratio of NIS (hypothesis to published filter) below which the hypothesis explains a reading:
noise alone rarely gives so small a ratio."""


class RelocationHypothesis(NamedTuple):
    """The memory of the hypothesis that the robot is where rejected readings show it.

    Its filter is the last one of the bank, which has it while any robot of the batch has a
    hypothesis. The filter keeps the Q and R that were in use when the rejections began: noise that
    is learned from rejected readings must not make them agree.

    Attributes:
        active: `(*batch)` whether there is a hypothesis; the other values are meaningless if not.
        confirmations: `(2, *batch)` number of rejected readings of each sensor that confirmed it.
        age_s: `(2, *batch)` time since its start, or since the sensor's last reading that did not
            confirm it [s].
        supports: `(*batch)` number of fixes that the gate accepted since its start.
        disagreement: `(*batch)` sum of these fixes' NIS against the hypothesis minus that against
            the published filter.
        spread: `(2, *batch)` the gate's spread when the rejections began.
        recent: `(*batch)` number of recent relocations, which fade with `RECENT_S`.
        displacement: `(2, *batch)` of the last relocation [m]; 0 if it undid the one before.
    """

    active: BoolArray
    confirmations: FloatArray
    age_s: FloatArray
    supports: FloatArray
    disagreement: FloatArray
    spread: FloatArray
    recent: FloatArray
    displacement: FloatArray


class HypothesisPrediction(NamedTuple):
    """The hypothesis's filter at an instant before its readings; everything of one filter.

    Attributes:
        predicted: the filter at the instant.
        seen: innovations of the readings.
        noise: Q and R of the filter.
        nis: `(2, *batch)` NIS of each sensor.
    """

    predicted: Bank
    seen: Innovations
    noise: Noise
    nis: FloatArray


class HypothesisUpdate(NamedTuple):
    """The hypothesis after the readings of an instant.

    Attributes:
        hypothesis: its memory.
        corrected: its filter.
        agrees: `(2, *batch)` whether the hypothesis predicts each sensor's reading.
        explains: `(2, *batch)` whether it does so far better than the published filter.
        confirmed: `(*batch)` whether the published filter is to be moved to it.
    """

    hypothesis: RelocationHypothesis
    corrected: Bank
    agrees: BoolArray
    explains: BoolArray
    confirmed: BoolArray


def no_hypothesis(batch: tuple[int, ...]) -> RelocationHypothesis:
    """Return the memory without a hypothesis."""
    none = np.zeros(batch)
    of_sensors = np.zeros((SENSOR_COUNT, *batch))
    return RelocationHypothesis(
        active=np.zeros(batch, dtype=np.bool_),
        confirmations=of_sensors,
        age_s=of_sensors,
        supports=none,
        disagreement=none,
        spread=of_sensors,
        recent=none,
        displacement=np.zeros((2, *batch)),
    )


def later_hypothesis(hypothesis: RelocationHypothesis, duration_s: float) -> RelocationHypothesis:
    """Return the memory after a duration [s]."""
    return hypothesis._replace(
        age_s=hypothesis.age_s + duration_s,
        recent=math.exp(-duration_s / RECENT_S) * hypothesis.recent,
    )


def nis_by_sensor(seen: Innovations, corrected: Correction, which: int) -> FloatArray:
    """Return the NIS of each sensor, `(2, *batch)`, against one filter of a bank."""
    r, S = seen.innovation[Row.COMPASS_YAW, which], seen.variance[Row.COMPASS_YAW, which]
    nis = np.empty((SENSOR_COUNT, *r.shape))
    nis[COMPASS] = r * r / S
    nis[LRF_POSE] = corrected.fix_nis[which]
    return nis


def update_hypothesis(
    gate: Gate,
    gate_state: GateState,
    hypothesis: RelocationHypothesis,
    prediction: HypothesisPrediction,
    published: Bank,
    readings: Readings,
    decision: GateDecision,
    one_cause: FloatArray | float,
) -> HypothesisUpdate:
    """Take the hypothesis over the readings of an instant, or start one.

    Args:
        gate: its thresholds say how large the NIS of a reading that agrees may be.
        gate_state: the gate's memory before the readings.
        hypothesis: before the readings; not changed.
        prediction: of its filter; meaningless for robots that have no hypothesis.
        published: the published filter after the readings.
        readings: of the instant.
        decision: of the gate.
        one_cause: `(*batch)` how much rejected fixes that agree may have one cause, 0 to 1.
    """
    rejected, rows, nis = decision.rejected, decision.degrees_of_freedom, prediction.nis
    measured = rows > 0.0
    spread = np.where(hypothesis.active, hypothesis.spread, gate_state.spread)
    hypothesis = hypothesis._replace(spread=spread)
    agrees = hypothesis.active & measured & (nis <= limits(gate, rows) * spread)
    used = readings.available & rows_of(agrees)
    corrected = correct(prediction.predicted, prediction.seen, prediction.noise, used).bank

    starts = np.any(rejected & ~agrees, axis=0)
    started = _start(published, prediction.noise, readings, rejected)
    after = _memory_after(hypothesis, gate_state, decision, nis, agrees, starts)
    bank = wrapped(
        Bank(
            np.where(starts, started.mean, corrected.mean),
            np.where(starts, started.covariance, corrected.covariance),
        )
    )
    needed_s = CONFIRMATION_S + (LASTING_CONFIRMATION_S - CONFIRMATION_S) * one_cause
    again = np.where(undoes_last(hypothesis, bank, published), 1.0, 2.0**hypothesis.recent)
    needed_s = np.minimum(needed_s * again, LONGEST_CONFIRMATION_S)
    known = _position_variance(bank) <= LARGEST_LOSS**2 * _position_variance(published)
    return HypothesisUpdate(
        after,
        bank,
        agrees,
        explains=agrees & (nis < CLEARLY_LESS * decision.nis),
        confirmed=_is_confirmed(after, rejected, agrees, known, needed_s),
    )


def _memory_after(
    hypothesis: RelocationHypothesis,
    gate_state: GateState,
    decision: GateDecision,
    nis: FloatArray,
    agrees: BoolArray,
    starts: BoolArray,
) -> RelocationHypothesis:
    """Return the memory after the readings of an instant.

    Args:
        hypothesis: before the readings.
        gate_state: the gate's memory before the readings.
        decision: of the gate.
        nis: `(2, *batch)` NIS of each sensor against the hypothesis.
        agrees: `(2, *batch)` whether the hypothesis predicts each sensor's reading.
        starts: `(*batch)` whether a hypothesis starts with these readings.
    """
    rejected, measured = decision.rejected, decision.degrees_of_freedom > 0.0
    confirms = rejected & agrees
    confirmations = np.where(
        confirms,
        hypothesis.confirmations + 1.0,
        np.where(measured, 0.0, hypothesis.confirmations),
    )
    rejects_on = np.where(measured, rejected, gate_state.rejections > 0.0)
    accepted_fix = (measured & ~rejected)[LRF_POSE]
    against = np.where(accepted_fix, (nis - decision.nis)[LRF_POSE], 0.0)
    return hypothesis._replace(
        active=starts | (hypothesis.active & np.any(rejects_on, axis=0)),
        confirmations=np.where(starts, 0.0, confirmations),
        age_s=np.where(starts | (measured & ~confirms), 0.0, hypothesis.age_s),
        supports=np.where(starts, 0.0, hypothesis.supports + accepted_fix),
        disagreement=np.where(starts, 0.0, hypothesis.disagreement + against),
    )


def _is_confirmed(
    hypothesis: RelocationHypothesis,
    rejected: BoolArray,
    agrees: BoolArray,
    known: BoolArray,
    needed_s: FloatArray,
) -> BoolArray:
    """Return whether the published filter is to be moved to the hypothesis, `(*batch)`.

    Args:
        hypothesis: after the readings of the instant.
        rejected: `(2, *batch)` whether the gate rejected each sensor's reading.
        agrees: `(2, *batch)` whether the hypothesis predicts it.
        known: `(*batch)` whether the hypothesis's position is known well enough.
        needed_s: `(*batch)` time over which readings have to confirm it [s].
    """
    lasts = hypothesis.age_s > needed_s - ROUNDING_S
    often = hypothesis.confirmations >= CONFIRMATIONS
    enough = rejected & agrees & often & lasts & known
    confirmed: BoolArray = enough[LRF_POSE] | (
        enough[COMPASS]
        & ~rejected[LRF_POSE]
        & (hypothesis.supports >= FEWEST_SUPPORTS)
        & (hypothesis.disagreement <= LARGEST_DISAGREEMENT)
    )
    return confirmed


def undoes_last(hypothesis: RelocationHypothesis, place: Bank, published: Bank) -> BoolArray:
    """Return whether a place undoes the last relocation by more than half, `(*batch)`."""
    back = place.mean[:2, 0] - published.mean[:2, 0] + hypothesis.displacement
    left, last = np.hypot(*back), np.hypot(*hypothesis.displacement)
    return np.asarray((last > 0.0) & (left < 0.5 * last))


def _position_variance(bank: Bank) -> FloatArray:
    """Return the variance of x plus that of y, `(*batch)`, of a bank's first filter [m^2]."""
    return np.asarray(bank.covariance[0, 0, 0] + bank.covariance[1, 1, 0])


def _start(published: Bank, noise: Noise, readings: Readings, rejected: BoolArray) -> Bank:
    """Return the published filter with what the rejected readings measure in its place."""
    z, R = readings.values[:, None], noise.measurement
    measured = (readings.available & rows_of(rejected))[:, None]
    by_compass = measured[Row.COMPASS_YAW]
    replaced = np.stack([measured[Row.X], measured[Row.Y], by_compass | measured[Row.LRF_YAW]])
    yaw = np.where(by_compass, z[Row.COMPASS_YAW], z[Row.LRF_YAW])
    pose = np.stack([z[Row.X], z[Row.Y], yaw])

    P = np.zeros_like(published.covariance)
    P[0, 0], P[1, 1] = R[Row.X], R[Row.Y]
    P[2, 2] = np.where(by_compass, R[Row.COMPASS_YAW], R[Row.LRF_YAW])
    if noise.coupling is not None:
        P[0, 1] = P[1, 0] = -noise.coupling.y_x * R[Row.X]
    both = replaced[:, None] & replaced[None]
    neither = ~replaced[:, None] & ~replaced[None]
    return Bank(
        np.where(replaced, pose, published.mean),
        np.where(both, P, np.where(neither, published.covariance, 0.0)),
    )
