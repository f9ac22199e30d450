"""Relocation: where readings that the gate rejects agree with each other, the robot may be there.

A filter of its own, the candidate, starts where the first rejected reading says the robot is, takes
from the published one what that reading does not say, and follows wheels and readings. As long as
it predicts the readings that the gate rejects it is confirmed; a reading that it does not predict
starts it anew. Confirmed often and long enough, it is where the robot is.

Fixes decide alone. A compass that is confirmed needs fixes that agree with it, too: some, and they
must not fit the candidate worse than the published filter, or a magnet would turn the robot round.
"""

from typing import NamedTuple

import numpy as np

from fnn_ekf_ros.core.arrays import BoolArray, FloatArray, Row
from fnn_ekf_ros.core.bank import Bank, Correction, Innovations, Noise, Readings, correct, wrapped
from fnn_ekf_ros.core.gate import Gate, GateState, Verdict, limits, rows_of
from fnn_ekf_ros.core.rows import COMPASS, LRF_POSE, SENSOR_COUNT

CONFIRMATIONS = 8
"""So many readings in a row have to confirm a candidate."""
CONFIRMATION_S = 3.0
"""And so long they have to: eight of a fast sensor are one and the same mistake [s]."""
FEWEST_SUPPORTS = 2.0
"""So many accepted fixes a compass needs beside it."""
LARGEST_DISAGREEMENT = 6.0
"""By so much NIS the other readings may speak for the published filter, and no more."""

ROUNDING_S = 1e-3
"""Stamps are so exact [s]."""
LARGEST_LOSS = 10.0
"""No pose is moved to where it would be known worse by more, in std: that is noise, not a place."""
CLEARLY_LESS = 1.0 / 9.0
"""A candidate explains a reading if its NIS is so much smaller; noise alone seldom does that."""


class Candidate(NamedTuple):
    """What is remembered of the place where rejected readings say the robot is.

    Its filter is the last one of the bank, which has it while any robot of the batch has one. That
    filter keeps the Q and R that were in use when readings began to be rejected: what is learned
    from rejected readings must not make them agree.

    Attributes:
        active: `(*batch)` whether there is one; the rest means nothing where not.
        confirmations: `(2, *batch)` how often the rejected readings of each sensor confirmed it.
        age_s: `(2, *batch)` since the reading it started with, or the last one of the sensor that
            did not confirm it [s].
        supports: `(*batch)` how many fixes the gate accepted meanwhile.
        disagreement: `(*batch)` sum of NIS against the candidate minus that against the published
            filter, of fixes that the gate accepted.
        spread: `(2, *batch)` the gate's when readings began to be rejected.
    """

    active: BoolArray
    confirmations: FloatArray
    age_s: FloatArray
    supports: FloatArray
    disagreement: FloatArray
    spread: FloatArray


class Relocation(NamedTuple):
    """What an instant said about the candidate.

    Attributes:
        agrees: `(2, *batch)` whether each sensor's reading agrees with the candidate.
        explains: `(2, *batch)` whether it agrees far better than with the published filter.
        confirmed: `(*batch)` whether the robot is at the candidate from now on.
    """

    agrees: BoolArray
    explains: BoolArray
    confirmed: BoolArray


class Followed(NamedTuple):
    """The candidate after an instant.

    Attributes:
        candidate: what is remembered of it.
        place: its filter.
        relocation: what the instant said about it.
    """

    candidate: Candidate
    place: Bank
    relocation: Relocation


class Beside(NamedTuple):
    """The candidate's filter at an instant, before its readings; each of these is one filter.

    Attributes:
        predicted: `(1, *batch)` filter.
        seen: what the readings say against it.
        noise: that it is run with.
        nis: `(2, *batch)` of each sensor.
    """

    predicted: Bank
    seen: Innovations
    noise: Noise
    nis: FloatArray


def no_candidate(batch: tuple[int, ...]) -> Candidate:
    """Return the state without a candidate."""
    none = np.zeros(batch)
    of_sensors = np.zeros((SENSOR_COUNT, *batch))
    return Candidate(
        np.zeros(batch, dtype=np.bool_), of_sensors, of_sensors, none, none, of_sensors
    )


def nis_by_sensor(seen: Innovations, corrected: Correction, which: int) -> FloatArray:
    """Return the NIS of each sensor, `(2, *batch)`, against one filter of a bank."""
    r, S = seen.innovation[Row.COMPASS_YAW, which], seen.variance[Row.COMPASS_YAW, which]
    nis = np.empty((SENSOR_COUNT, *r.shape))
    nis[COMPASS] = r * r / S
    nis[LRF_POSE] = corrected.fix_nis[which]
    return nis


def follow(
    gate: Gate,
    remembered: GateState,
    candidate: Candidate,
    beside: Beside,
    published: Bank,
    readings: Readings,
    verdict: Verdict,
) -> Followed:
    """Take the candidate over an instant, or start one.

    Args:
        gate: how far a reading may be off to agree.
        remembered: by the gate, before the instant.
        candidate: before the readings; not changed.
        beside: its filter; it means nothing for robots that have no candidate.
        published: `(1, *batch)` the published filter after the readings.
        readings: of the instant.
        verdict: what the gate says about them.
    """
    rejected, rows, nis = verdict.rejected, verdict.degrees_of_freedom, beside.nis
    spoke = rows > 0.0
    tolerance = np.where(candidate.active, candidate.spread, remembered.spread)
    agrees = candidate.active & spoke & (nis <= limits(gate, rows) * tolerance)
    used = readings.available & rows_of(agrees)
    followed = correct(beside.predicted, beside.seen, beside.noise, used).bank

    confirms = rejected & agrees
    confirmations = np.where(
        confirms,
        candidate.confirmations + 1.0,
        np.where(spoke, 0.0, candidate.confirmations),
    )
    starts = np.any(rejected & ~agrees, axis=0)
    started = _start(published, beside.noise, readings, rejected)
    in_a_row = np.where(spoke, rejected, remembered.rejections > 0.0)
    accepted_fix = (spoke & ~rejected)[LRF_POSE]
    against = np.where(accepted_fix, (nis - verdict.nis)[LRF_POSE], 0.0)
    after = Candidate(
        active=starts | (candidate.active & np.any(in_a_row, axis=0)),
        confirmations=np.where(starts, 0.0, confirmations),
        age_s=np.where(starts | (spoke & ~confirms), 0.0, candidate.age_s),
        supports=np.where(starts, 0.0, candidate.supports + accepted_fix),
        disagreement=np.where(starts, 0.0, candidate.disagreement + against),
        spread=tolerance,
    )
    place = wrapped(
        Bank(
            np.where(starts, started.mean, followed.mean),
            np.where(starts, started.covariance, followed.covariance),
        )
    )
    known = _position_variance(place) <= LARGEST_LOSS**2 * _position_variance(published)
    long = after.age_s > CONFIRMATION_S - ROUNDING_S
    enough = confirms & (after.confirmations >= CONFIRMATIONS) & long & known
    confirmed = enough[LRF_POSE] | (
        enough[COMPASS]
        & ~rejected[LRF_POSE]
        & (after.supports >= FEWEST_SUPPORTS)
        & (after.disagreement <= LARGEST_DISAGREEMENT)
    )
    explains = agrees & (nis < CLEARLY_LESS * verdict.nis)
    return Followed(after, place, Relocation(agrees, explains, confirmed))


def _position_variance(bank: Bank) -> FloatArray:
    return np.asarray(bank.covariance[0, 0, 0] + bank.covariance[1, 1, 0])


def _start(published: Bank, noise: Noise, readings: Readings, rejected: BoolArray) -> Bank:
    """Return the published filter with what the rejected readings say in its place."""
    z, R = readings.values[:, None], noise.measurement
    says = (readings.available & rows_of(rejected))[:, None]
    by_compass = says[Row.COMPASS_YAW]
    replaced = np.stack([says[Row.X], says[Row.Y], by_compass | says[Row.LRF_YAW]])
    told = np.stack([z[Row.X], z[Row.Y], np.where(by_compass, z[Row.COMPASS_YAW], z[Row.LRF_YAW])])

    told_P = np.zeros_like(published.covariance)
    told_P[0, 0], told_P[1, 1] = R[Row.X], R[Row.Y]
    told_P[2, 2] = np.where(by_compass, R[Row.COMPASS_YAW], R[Row.LRF_YAW])
    if noise.coupling is not None:
        told_P[0, 1] = told_P[1, 0] = -noise.coupling.y_x * R[Row.X]
    both = replaced[:, None] & replaced[None]
    neither = ~replaced[:, None] & ~replaced[None]
    return Bank(
        np.where(replaced, told, published.mean),
        np.where(both, told_P, np.where(neither, published.covariance, 0.0)),
    )
