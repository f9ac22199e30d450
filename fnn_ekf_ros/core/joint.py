# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Joint adaptation of Q and R: a fuzzy neural network fed by the likelihoods of neighbor filters.

Two learners each adapt four log scales theta (of the wheels' distance and rotation, of positions
and of yaws); theta = 0 is the start's noise:

    step      u = I^-1 d                  the change that the last measurement indicates, in log
                                          variance
    network   -u is N -> theta I(ncrease), Z -> M(aintain), P -> D(ecrease)
              theta <- theta + sum beta_k z_k(-u)                              (20)-(22)
    memory    I <- (1 - 1/N) I + i + 1/N I_0;  N grows with the measurements up to a limit.
              A scale's information fades, and its N grows, only with measurements that inform it.
              One that follows the last after a part p < 1 of a nominal period counts as sqrt(p):
              R shows in each reading, Q in the time over which it acts.

d and i are the score and information of `evidence`. The *settled* learner has a long memory and
uses forecasts of the measurement after next, which noise that is correlated from one fix to the
next does not bias. The *fast* learner uses predictions of the next measurement and has a short
memory.

Four noise hypotheses are weighted by their likelihoods, and the published filter runs on the
weighted mean of their log scales:

    start     theta = 0                             keeps its weight unless there is evidence
                                                    against it
    settled   theta of the settled learner          replaces the start by their odds
    fast      theta of the fast learner             if it predicts the last measurements far better
    slip      settled, wheels' variances times 50   likewise; needs no time to learn

Every hypothesis and every neighbor is a filter of the bank, which takes every reading at its own
time. The noise is learned from the readings that are scored (`pace`): about one in a nominal
period, or every fix where fixes come faster. A forecast skips one fix, whatever the rate of the
compass, and looks ahead at least three quarters of a nominal period, whatever the rate of the
fixes.
"""

from typing import NamedTuple

import numpy as np

from fnn_ekf_ros.core.arrays import BoolArray, Constant, FloatArray, Row
from fnn_ekf_ros.core.bounds import NoiseBounds
from fnn_ekf_ros.core.evidence import (
    SCALE_COUNT,
    STAR_SIZE,
    Evidence,
    Scale,
    star_evidence,
)
from fnn_ekf_ros.core.fuzzy import FuzzySets, infer
from fnn_ekf_ros.core.joint_filters import (
    FAST,
    FORESEEN_STAR,
    FORESEEN_START,
    LEARNER_COUNT,
    PROCESS_SCALES,
    SETTLED,
    SETTLED_STAR,
    STARS,
    START,
    SUDDEN,
)
from fnn_ekf_ros.core.joint_state import (
    ALARM_LEAD,
    PRIOR_INFORMATION,
    START_WEIGHT,
    JointState,
    Learned,
)
from fnn_ekf_ros.core.rows import Rows

LONGEST_MEMORY: FloatArray = np.array([200.0, 20.0])
"""Largest N of the settled and of the fast learner [measurements]. 200 nominal periods are 75 s and
give little scatter; 20 follow a change."""
MEMORY_GROWTH = 0.5
"""Growth of N per measurement: half of what was learned far from the right noise is forgotten
before it is reached."""
SWITCHING_RATE = 1e-4
"""Part of the weight that is reset per nominal period, so that the odds can turn again (Herbster
and Warmuth 1998, fixed share); in between they decide clearly."""
LARGEST_ALARM_LEAD = 2.0 * ALARM_LEAD
"""Upper limit of a lead [nats]: with it the weight is down to a half seven nominal periods after
the cause has ended."""
LARGEST_LIKELIHOOD_RATIO = 50.0
"""Largest log likelihood ratio of two hypotheses per measurement [nats]: no overflow, and no
measurement decides for good."""
STANDSTILL = (1e-3, 1e-3)
"""Distance and rotation per nominal period below which nothing is learned (m, rad): fixes of a
standing robot have too little noise."""
_PRIOR = Constant(PRIOR_INFORMATION)
"""`PRIOR_INFORMATION`, for any batch."""
_LONGEST = Constant(LONGEST_MEMORY)
"""`LONGEST_MEMORY`, for any batch."""
_STANDSTILL = Constant(STANDSTILL)
"""`STANDSTILL`, for any batch."""
_R = PROCESS_SCALES.stop
"""Number of components of Q: the rows of R stand behind them."""
_SHARED_SCALES = (
    (Scale.POSITION, _R + Row.X, _R + Row.Y),
    (Scale.YAW, _R + Row.COMPASS_YAW, _R + Row.LRF_YAW),
)
"""Scales of two rows each, with the places of these rows' R behind those of Q."""


class Lesson(NamedTuple):
    """Readings as the filters of joint adaptation see them before they are corrected.

    Attributes:
        innovation: `(4, JOINT_COUNT, *batch)` r (m, m, rad, rad); 0 where not available.
        variance: `(4, JOINT_COUNT, *batch)` diagonal of S (m^2, m^2, rad^2, rad^2).
        likelihood: `(JOINT_COUNT, *batch)` log likelihood of the rows that are learned from.
        taught: the rows that are learned from.
        scored: these, and the scored rows that the gate excludes from learning.
        since_scored: `(*batch)` time since readings were scored before [nominal periods].
    """

    innovation: FloatArray
    variance: FloatArray
    likelihood: FloatArray
    taught: Rows
    scored: Rows
    since_scored: FloatArray


def learn(
    state: JointState,
    sets: FuzzySets,
    bounds: NoiseBounds,
    lesson: Lesson,
    *,
    learning: bool,
    settles: BoolArray | None = None,
) -> Learned:
    """Learn from the filters' predictions of readings.

    Args:
        state: before the readings; not changed.
        sets: the network's membership functions, in log variance.
        bounds: limits of the noise.
        lesson: the readings; learned from are those that the gate accepts, and those that it
            rejects because the assumed noise is too small.
        learning: False keeps what was learned as it is.
        settles: `(*batch)` where the settled learner learns; None: everywhere.
    """
    measured = lesson.taught.some
    smallest = _STANDSTILL.behind(measured.ndim) * lesson.since_scored
    stands = np.abs(state.control_since_scored) <= smallest
    learns = measured & ~stands.all(axis=0) & learning
    foreseen = learns & (state.forecast_count >= 2.0)
    if settles is not None:
        foreseen &= settles
    informed = _informed(lesson.scored.each)
    likelihood = lesson.likelihood
    evidence = star_evidence(
        lesson.innovation[:, STARS].reshape(4, STAR_SIZE, LEARNER_COUNT, *measured.shape),
        lesson.variance[:, STARS].reshape(4, STAR_SIZE, LEARNER_COUNT, *measured.shape),
        likelihood[STARS].reshape(STAR_SIZE, LEARNER_COUNT, *measured.shape),
        lesson.taught,
    )
    teaches = np.empty((LEARNER_COUNT, *measured.shape), dtype=np.bool_)
    teaches[SETTLED], teaches[FAST] = foreseen, learns
    learned = _move_learners(state, sets, bounds, evidence, informed, teaches)
    start_weight = _start_weight_after(state, lesson, foreseen)
    after = learned.state._replace(
        start_weight=start_weight,
        lead=_lead_after(state, start_weight, likelihood, learns),
        since_informed=np.where(informed & measured, 0.0, state.since_informed),
    )
    return learned._replace(state=after)


def _start_weight_after(state: JointState, lesson: Lesson, foreseen: BoolArray) -> FloatArray:
    """Return the start's weight against the settled learner, `(*batch)`, after forecasts."""
    odds = lesson.likelihood[FORESEEN_START] - lesson.likelihood[FORESEEN_STAR]
    w = state.start_weight
    w = w / (w + (1.0 - w) * np.exp(-_limited(odds)))
    drawn = np.minimum(SWITCHING_RATE * lesson.since_scored, 1.0)
    return np.where(foreseen, (1.0 - drawn) * w + drawn * START_WEIGHT, state.start_weight)


def _lead_after(
    state: JointState, start_weight: FloatArray, likelihood: FloatArray, learns: BoolArray
) -> FloatArray:
    """Return the leads `(2, *batch)` of fast and slip over the mixture of start and settled."""
    mixture = _log_mean(start_weight, likelihood[START], likelihood[SETTLED_STAR])
    gained = _limited(likelihood[SUDDEN] - mixture)
    return np.where(learns, np.minimum(state.lead + gained, LARGEST_ALARM_LEAD), state.lead)


def _limited(ratio: FloatArray) -> FloatArray:
    """Return log likelihood ratios within `LARGEST_LIKELIHOOD_RATIO`."""
    return np.minimum(np.maximum(ratio, -LARGEST_LIKELIHOOD_RATIO), LARGEST_LIKELIHOOD_RATIO)


def _informed(scored: BoolArray) -> BoolArray:
    """Return the scales, `(4, *batch)`, that scored rows `(4, *batch)` inform."""
    fix = scored[Row.X] | scored[Row.Y]
    yaw = scored[Row.COMPASS_YAW] | scored[Row.LRF_YAW]
    informed = np.empty_like(scored)
    informed[Scale.DISTANCE], informed[Scale.ROTATION] = fix, fix | yaw
    informed[Scale.POSITION], informed[Scale.YAW] = fix, yaw
    return informed


def _move_learners(
    state: JointState,
    sets: FuzzySets,
    bounds: NoiseBounds,
    evidence: Evidence,
    informed: BoolArray,
    teaches: BoolArray,
) -> Learned:
    """Take a step of both learners.

    Args:
        state: before the readings.
        sets: the network's membership functions, in log variance.
        bounds: limits of the noise.
        evidence: for both learners.
        informed: `(4, *batch)` scales that the readings inform.
        teaches: `(2, *batch)` whether the settled and the fast learner learn.
    """
    N = state.memory
    counts = np.where(informed, np.sqrt(np.minimum(state.since_informed, 1.0)), 0.0)[:, None]
    root = np.sqrt(1.0 - counts / N)
    kept = root[:, None] * root[None]
    prior = _PRIOR.behind(N.ndim - 1)
    information = kept * (state.information - prior) + prior + evidence.information
    u = _solve(information, evidence.score)
    inference = infer(sets, -u)  # -u takes the place of the mismatch D = S - C_hat
    low, high = _log_limits(state, bounds)
    theta = np.minimum(np.maximum(state.log_scale + inference.change, low), high)

    grown = np.minimum(N + MEMORY_GROWTH * counts, _LONGEST.behind(N.ndim - 2))
    after = state._replace(
        log_scale=np.where(teaches, theta, state.log_scale),
        information=np.where(teaches, information, state.information),
        memory=np.where(teaches, grown, N),
    )
    settled = teaches[SETTLED]
    return Learned(
        after,
        np.where(settled, u[:, SETTLED], 0.0),
        np.where(settled, inference.firing_strength[:, :, SETTLED], 0.0),
    )


def _solve(information: FloatArray, score: FloatArray) -> FloatArray:
    """Return u = I^-1 d, `(4, ...)`."""
    # Transposing puts the batch first; the matrices are symmetric, so they do not change.
    u = np.asarray(np.linalg.solve(information.T, score.T[..., None]), dtype=np.float64)
    return u[..., 0].T


def _log_mean(w: FloatArray, one: FloatArray, other: FloatArray) -> FloatArray:
    """Return log(w e^one + (1 - w) e^other)."""
    best = np.maximum(one, other)
    return best + np.log(w * np.exp(one - best) + (1.0 - w) * np.exp(other - best))


def _log_limits(state: JointState, bounds: NoiseBounds) -> tuple[FloatArray, FloatArray]:
    """Return the smallest and the largest theta, `(4, 1, *batch)`, within the bounds."""
    base = np.concatenate([state.process_noise, state.measurement_noise])
    limits = bounds.all_limits()
    low = np.log(limits.smallest.behind(base.ndim - 1) / base)
    high = np.log(limits.largest.behind(base.ndim - 1) / base)
    for scale, one, other in _SHARED_SCALES:
        low[scale] = np.maximum(low[one], low[other])
        high[scale] = np.minimum(high[one], high[other])
    return low[:SCALE_COUNT, None], high[:SCALE_COUNT, None]
