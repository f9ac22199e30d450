"""Relocation: where readings that the gate rejects agree with each other, the robot may be there.

A second filter, the candidate, starts where the first rejected reading says the robot is, takes
from the published one what that reading does not say, and follows wheels and readings. As long as
it predicts the readings that the gate rejects it is confirmed; a reading that it does not predict
starts it anew. Confirmed often and long enough, it is where the robot is.

Fixes decide alone. A compass that is confirmed needs fixes that agree with it, too: some, and they
must not fit the candidate worse than the published filter, or a magnet would turn the robot round.
"""

from typing import NamedTuple

import numpy as np

from fnn_ekf_ros.core.arrays import BoolArray, FloatArray, Row
from fnn_ekf_ros.core.gate import (
    COMPASS,
    LRF_POSE,
    SENSOR_COUNT,
    Gate,
    GateState,
    Verdict,
    limits,
    nis_by_sensor,
    rows_of,
)
from fnn_ekf_ros.core.kalman import innovate, update
from fnn_ekf_ros.core.plant import (
    NOMINAL_PERIOD_S,
    Plant,
    StepInput,
    carry_to_end,
    noise_matrix,
    predict,
)

CONFIRMATIONS = 8
"""So many readings in a row have to confirm a candidate."""
CONFIRMATION_S = 3.0
"""And so long they have to: eight of a fast sensor are one and the same mistake [s]."""
FEWEST_SUPPORTS = 2.0
"""So many accepted fixes a compass needs beside it."""
LARGEST_DISAGREEMENT = 6.0
"""By so much NIS the other readings may speak for the published filter, and no more."""

LARGEST_LOSS = 10.0
"""No pose is moved to where it would be known worse by more, in std: that is noise, not a place."""
CLEARLY_LESS = 1.0 / 9.0
"""A candidate explains a reading if its NIS is so much smaller; noise alone seldom does that."""


class Candidate(NamedTuple):
    """Where rejected readings say the robot is.

    Attributes:
        active: `(...)` whether there is one; the rest means nothing where not.
        mean: `(..., 3)` (m, m, rad).
        covariance: `(..., 3, 3)`.
        confirmations: `(..., 2)` how often the rejected readings of each sensor confirmed it.
        age_s: `(...)` since the reading it started with [s].
        supports: `(...)` how many readings the gate accepted meanwhile.
        disagreement: `(...)` sum of NIS against the candidate minus that against the published
            filter, of readings that the gate accepted.
        process_noise: `(..., 2)` Q that was in use when readings began to be rejected.
        measurement_noise: `(..., 4)` R, likewise: what is learned from rejected readings must not
            make them agree.
        spread: `(..., 2)` the gate's, likewise.
    """

    active: BoolArray
    mean: FloatArray
    covariance: FloatArray
    confirmations: FloatArray
    age_s: FloatArray
    supports: FloatArray
    disagreement: FloatArray
    process_noise: FloatArray
    measurement_noise: FloatArray
    spread: FloatArray


class Published(NamedTuple):
    """The filter that the candidate stands beside.

    Attributes:
        heading: `(...)` at the period's begin [rad].
        mean: `(..., 3)` at its end (m, m, rad).
        covariance: `(..., 3, 3)` at its end.
        process_noise: `(..., 2)` diagonal of Q in use (m^2, rad^2).
        measurement_noise: `(..., 4)` diagonal of R in use.
    """

    heading: FloatArray
    mean: FloatArray
    covariance: FloatArray
    process_noise: FloatArray
    measurement_noise: FloatArray


class Relocation(NamedTuple):
    """What a period said about the candidate.

    Attributes:
        agrees: `(..., 2)` whether each sensor's reading agrees with the candidate.
        explains: `(..., 2)` whether it agrees far better than with the published filter.
        confirmed: `(...)` whether the robot is at the candidate from now on.
    """

    agrees: BoolArray
    explains: BoolArray
    confirmed: BoolArray


def no_candidate(
    mean: FloatArray,
    covariance: FloatArray,
    process_noise: FloatArray,
    measurement_noise: FloatArray,
) -> Candidate:
    """Return the state without a candidate, for filters with their Q and R."""
    batch = mean.shape[:-1]
    return Candidate(
        active=np.zeros(batch, dtype=np.bool_),
        mean=mean,
        covariance=covariance,
        confirmations=np.zeros((*batch, SENSOR_COUNT)),
        age_s=np.zeros(batch),
        supports=np.zeros(batch),
        disagreement=np.zeros(batch),
        process_noise=process_noise,
        measurement_noise=measurement_noise,
        spread=np.ones((*batch, SENSOR_COUNT)),
    )


def follow(
    plant: Plant,
    gate: Gate,
    remembered: GateState,
    candidate: Candidate,
    published: Published,
    period: StepInput,
    verdict: Verdict,
) -> tuple[Candidate, Relocation]:
    """Take the candidate over a period, or start one.

    Args:
        plant: the robot.
        gate: how far a reading may be off to agree.
        remembered: by the gate, before the period.
        candidate: before the period; not changed.
        published: the filter it stands beside.
        period: what it brought.
        verdict: what the gate says about it.
    """
    if not np.any(candidate.active) and not np.any(verdict.rejected):
        nowhere = np.zeros(verdict.rejected.shape, dtype=np.bool_)
        return candidate, Relocation(nowhere, nowhere, nowhere[..., 0])
    available, rejected = period.available, verdict.rejected
    spoke = verdict.degrees_of_freedom > 0.0

    active = candidate.active[..., None]
    Q = np.where(active, candidate.process_noise, published.process_noise)
    R = np.where(active, candidate.measurement_noise, published.measurement_noise)
    tolerance = np.where(active, candidate.spread, remembered.spread)
    ahead, ahead_P = predict(plant, candidate.mean, candidate.covariance, Q, period.control)
    z = carry_to_end(plant, candidate.mean[..., 2], period)
    R_full = noise_matrix(plant, R, period)
    nis, count = nis_by_sensor(innovate(ahead, ahead_P, z, R_full, available), available)
    agrees = active & spoke & (nis <= limits(gate, count) * tolerance)
    confirmed_by = rejected & agrees

    used = available & rows_of(agrees)
    seen = innovate(ahead, ahead_P, z, R_full, used)
    followed, followed_P = update(ahead, ahead_P, R_full, used, seen)
    other = np.where(spoke & ~rejected, nis - verdict.nis, 0.0)
    confirmations = np.where(
        confirmed_by,
        candidate.confirmations + 1.0,
        np.where(spoke, 0.0, candidate.confirmations),
    )
    disagreement = candidate.disagreement + np.sum(other, axis=-1)

    starts = np.any(rejected & ~agrees, axis=-1)
    started, started_P = _start(plant, published, R_full, period, rejected)
    in_a_row = np.where(spoke, rejected, remembered.rejections > 0.0)
    after = Candidate(
        active=starts | (candidate.active & np.any(in_a_row, axis=-1)),
        mean=np.where(starts[..., None], started, followed),
        covariance=np.where(starts[..., None, None], started_P, followed_P),
        confirmations=np.where(starts[..., None], 0.0, confirmations),
        age_s=np.where(starts, 0.0, candidate.age_s + plant.period_scale * NOMINAL_PERIOD_S),
        supports=np.where(starts, 0.0, candidate.supports + np.sum(spoke & ~rejected, axis=-1)),
        disagreement=np.where(starts, 0.0, disagreement),
        process_noise=Q,
        measurement_noise=R,
        spread=tolerance,
    )
    long = after.age_s > CONFIRMATION_S - 0.5 * plant.period_scale * NOMINAL_PERIOD_S
    known = _position_variance(after.covariance) <= LARGEST_LOSS**2 * _position_variance(
        published.covariance
    )
    enough = (after.confirmations >= CONFIRMATIONS) & (long & known)[..., None]
    confirmed = enough[..., LRF_POSE] | (
        enough[..., COMPASS]
        & ~rejected[..., LRF_POSE]
        & (after.supports >= FEWEST_SUPPORTS)
        & (after.disagreement <= LARGEST_DISAGREEMENT)
    )
    return after, Relocation(agrees, agrees & (nis < CLEARLY_LESS * verdict.nis), confirmed)


def _position_variance(covariance: FloatArray) -> FloatArray:
    return np.asarray(covariance[..., 0, 0] + covariance[..., 1, 1])


def _start(
    plant: Plant, published: Published, R_full: FloatArray, period: StepInput, rejected: BoolArray
) -> tuple[FloatArray, FloatArray]:
    """Return the published filter with what the rejected readings say in its place."""
    z = carry_to_end(plant, published.heading, period)
    says = period.available & rows_of(rejected)
    by_compass = says[..., Row.COMPASS_YAW]
    replaced = np.stack(
        [says[..., Row.X], says[..., Row.Y], by_compass | says[..., Row.LRF_YAW]], axis=-1
    )
    yaw = np.where(by_compass, z[..., Row.COMPASS_YAW], z[..., Row.LRF_YAW])
    told = np.stack(np.broadcast_arrays(z[..., Row.X], z[..., Row.Y], yaw), axis=-1)

    variance = np.diagonal(R_full, axis1=-2, axis2=-1)
    told_P = np.zeros_like(published.covariance)
    told_P[..., :2, :2] = R_full[..., :2, :2]
    told_P[..., 2, 2] = np.where(
        by_compass, variance[..., Row.COMPASS_YAW], variance[..., Row.LRF_YAW]
    )
    both = replaced[..., :, None] & replaced[..., None, :]
    neither = ~replaced[..., :, None] & ~replaced[..., None, :]
    started_P = np.where(both, told_P, np.where(neither, published.covariance, 0.0))
    return np.where(replaced, told, published.mean), started_P
