# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Simulated outages: the members' weights, by how well they predict fixes that come after a while.

A copy of each member is not corrected by x and y of the fixes for a horizon H; every yaw corrects
it. The fixes of age H to 1.5 H are scored by their Student-t log likelihood, averaged over this
window: errors that last make its fixes one measurement. For each horizon

    log w_k <- log w_k + max(l_k - max l, -3),  then 0.5 % of the weights are redrawn to the prior

    L_k   = mean over the horizons of log w_k
    lead  = log sum_(k != white) exp L_k - L_white
    L_white <- L_white + max(0, 2.5 - max(0, lead)),     weights in use: softmax of L

so that the white member keeps the say until others lead clearly; then white noise costs little.
"""

from typing import NamedTuple

import numpy as np

from fnn_ekf_ros.core.arrays import BoolArray, Constant, FloatArray
from fnn_ekf_ros.core.lasting.members import HORIZONS_S, MEMBER_COUNT, PHASES, PRIOR, WHITE

WINDOW = 0.5
"""Length of the window in which copies are scored, in horizons."""
LARGEST_LOSS = 3.0
"""Largest loss of log weight by one window [nats]: no window decides alone."""
REDRAWN = 0.005
"""Part of the weights that is reset to the prior per window, so that they can turn again (Herbster
and Warmuth 1998, fixed share)."""
WHITE_LEAD = 2.5
"""Head start of the white member while no other leads [nats]: it lets white noise cost less than
1 %, and delays what lasts by about one window."""
MEMORY_NEEDED = 100.0
"""Memory of the settled learner from which on windows count [measurements]: before, Q and R may be
so wrong that errors seem to last."""
_HORIZONS = Constant(np.array(HORIZONS_S)[:, None])
_ENDS = Constant((1.0 + WINDOW) * np.array(HORIZONS_S)[:, None])
_AGES = Constant(-np.outer((1.0 + WINDOW) * np.array(HORIZONS_S), np.arange(PHASES) / PHASES))


class Outages(NamedTuple):
    """Clocks and scores of the copies, and the weights that follow.

    Attributes:
        age_s: `(H, P, *batch)` time for which the robot has moved since each copy was made, by
            horizon and phase; negative before the first copy [s].
        score: `(H, P, M, *batch)` sum of the log likelihoods in the window so far [nats].
        fixes: `(H, P, *batch)` number of fixes in it.
        log_weight: `(H, M, *batch)` log weights of the members.
    """

    age_s: FloatArray
    score: FloatArray
    fixes: FloatArray
    log_weight: FloatArray


class Advanced(NamedTuple):
    """Outages after a duration.

    Attributes:
        outages: with the windows that have ended counted.
        renewed: `(H, P, *batch)` which copies have to be made anew.
        weighed: whether a window has changed the weights.
    """

    outages: Outages
    renewed: BoolArray
    weighed: bool


def start_outages(batch: tuple[int, ...], log_weight: FloatArray | None = None) -> Outages:
    """Return the outages before the first copies.

    Args:
        batch: its shape.
        log_weight: `(H, M, *batch)` weights to start with; None: the prior's.
    """
    shape = (len(HORIZONS_S), PHASES)
    if log_weight is None:
        prior = np.log(PRIOR.behind(len(batch)))
        log_weight = np.broadcast_to(prior, (len(HORIZONS_S), MEMBER_COUNT, *batch))
    return Outages(
        age_s=np.broadcast_to(_AGES.behind(len(batch)), (*shape, *batch)),
        score=np.zeros((*shape, MEMBER_COUNT, *batch)),
        fixes=np.zeros((*shape, *batch)),
        log_weight=log_weight,
    )


def scored(outages: Outages, likelihood: FloatArray, fixed: BoolArray) -> Outages:
    """Return the outages after a fix.

    Args:
        outages: before it.
        likelihood: `(H, P, M, *batch)` log likelihood of its x and y for each copy [nats].
        fixed: `(*batch)` whether there is a fix that the gate accepts.
    """
    counts = fixed & (outages.age_s >= _HORIZONS.behind(fixed.ndim))
    if not counts.any():
        return outages
    return outages._replace(
        score=outages.score + np.where(counts[:, :, None], likelihood, 0.0),
        fixes=outages.fixes + counts,
    )


def advanced(outages: Outages, duration_s: FloatArray, weighs: BoolArray) -> Advanced:
    """Return the outages after a duration.

    Args:
        outages: before it.
        duration_s: `(*batch)` its duration; 0 while the robot stands [s].
        weighs: `(*batch)` whether windows count.
    """
    before = outages.age_s
    age = before + duration_s
    ends = age >= _ENDS.behind(duration_s.ndim)
    renewed = ends | ((before < 0.0) & (age >= 0.0))
    if not renewed.any():
        return Advanced(outages._replace(age_s=age), renewed, weighed=False)
    counted = ends & (outages.fixes > 0.0) & weighs
    log_weight = outages.log_weight
    for horizon, phase in np.argwhere(counted.reshape(*counted.shape[:2], -1).any(axis=2)):
        window = horizon, phase
        weighed = _weighed(outages, log_weight[horizon], window)
        log_weight = log_weight.copy()
        log_weight[horizon] = np.where(counted[window], weighed, log_weight[horizon])
    after = Outages(
        age_s=np.where(ends, 0.0, age),
        score=np.where(renewed[:, :, None], 0.0, outages.score),
        fixes=np.where(renewed, 0.0, outages.fixes),
        log_weight=log_weight,
    )
    return Advanced(after, renewed, weighed=bool(counted.any()))


def _weighed(outages: Outages, log_weight: FloatArray, window: tuple[int, int]) -> FloatArray:
    """Return the log weights `(M, *batch)` of a horizon after one of its windows."""
    likelihood = outages.score[window] / np.maximum(outages.fixes[window], 1.0)
    led = log_weight + np.maximum(likelihood - likelihood.max(axis=0), -LARGEST_LOSS)
    weights = np.exp(led - led.max(axis=0))
    weights /= weights.sum(axis=0)
    prior = PRIOR.behind(weights.ndim - 1)
    return np.asarray(np.log((1.0 - REDRAWN) * weights + REDRAWN * prior))


def weights_of(log_weight: FloatArray) -> FloatArray:
    """Return the weights in use, `(M, *batch)`, for log weights `(H, M, *batch)`."""
    log_mean = log_weight.mean(axis=0)
    log_mean -= log_mean.max(axis=0)
    weights = np.exp(log_mean)
    others = np.log(weights.sum(axis=0) - weights[WHITE])
    lead = np.maximum(others - log_mean[WHITE], 0.0)
    weights[WHITE] *= np.exp(np.maximum(WHITE_LEAD - lead, 0.0))
    return np.asarray(weights / weights.sum(axis=0))
