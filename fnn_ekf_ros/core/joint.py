"""Joint adaptation of Q and R: a fuzzy neural network fed with the evidence of neighbours.

Two learners each move four log scales theta (forward, heading, position, yaw; 0 is the start):

    explained  u = I^-1 d                 what the last measurement asks for, in log variance
    network    -u is N -> theta I(ncrease), Z -> M(aintain), P -> D(ecrease)
               theta <- theta + sum beta_k z_k(-u)                              (20)-(22)
    memory     I <- (1 - 1/N) I + i + 1/N I_0,  N grows with the measurements up to the longest

d and i are the score and information of `evidence`. The *settled* learner has a long memory and
looks at forecasts of the measurement after next: noise that is coloured from one fix to the next
cannot fool it. The *fast* one looks at the next measurement and forgets soon.

Four hypotheses about the noise are weighed by what they predict, and the filter runs on the
log scales' weighted mean:

    the start's noise (theta = 0)   the guard: without evidence against it, it stays
    the settled learner's           takes over from the start by their odds
    the fast learner's              where it explains the last measurements better by far
    the settled one's, wheels x 50  slip; likewise: it is there before any learner could be

Every hypothesis and every neighbour is a filter of its own beside the one that is published.
"""

from typing import NamedTuple

import numpy as np

from fnn_ekf_ros.core.arrays import BoolArray, FloatArray, Row
from fnn_ekf_ros.core.bounds import NoiseBounds
from fnn_ekf_ros.core.evidence import (
    SCALE_COUNT,
    STAR,
    STAR_SIZE,
    Evidence,
    filters_of,
    log_likelihood,
    side_by_side,
    star_evidence,
)
from fnn_ekf_ros.core.fuzzy import FuzzySets, infer
from fnn_ekf_ros.core.kalman import Innovation, innovate, update
from fnn_ekf_ros.core.plant import (
    Plant,
    StepInput,
    carry_to_end,
    for_each,
    noise_matrix,
    predict,
)

HYPOTHESES = ("start", "settled", "fast", "slip")
SHORTEST_MEMORY = 15.0
"""N of a learner that has seen nothing yet [measurements]."""
LONGEST_MEMORY = (200.0, 20.0)
"""N of the settled and of the fast learner at the most; at 375 ms 200 are 75 s."""
MEMORY_GROWTH = 0.5
"""By how much N grows with a measurement: the part that was learned far off is forgotten."""
PRIOR_INFORMATION: FloatArray = 0.2 * np.eye(SCALE_COUNT) + 5.0 * np.array(
    [[1.0, -1.0, 0.0, 0.0], [-1.0, 1.0, 0.0, 0.0], [0.0] * 4, [0.0] * 4]
)
"""I_0: keeps u finite; the wheels' two scales move together until told apart."""
START_WEIGHT = 0.5
"""Weight of the start's noise against the settled learner's before anything is known."""
SWITCHING_RATE = 1e-4
"""Part of the odds that is drawn anew with each measurement, so that they can turn again
(Herbster and Warmuth 1998, fixed share)."""
SLIP: FloatArray = np.array([1.0, 1.0, 0.0, 0.0]) * np.log(50.0)
"""Log scales of wheels that slip, against the settled ones."""
ALARM_MEMORY = 0.9
"""Part of a sudden hypothesis' lead that is remembered from one period to the next."""
ALARM_LEAD = 6.0
"""Lead [nats] at which a sudden hypothesis (fast, slip) has half of the say; without a lead it
has none."""
LONGEST_LEAD = 2.0 * ALARM_LEAD
"""No lead grows further: seven periods after its reason has gone it has half of the say."""
LARGEST_GAIN = 50.0
"""No measurement says more for one hypothesis against another [nats]."""
STANDSTILL = (1e-3, 1e-3)
"""A nominal period with less way and turn teaches nothing: fixes are too quiet then (m, rad)."""

_SETTLED, _FAST = 0, 1
_FORECAST_FILTERS = 1 + STAR_SIZE
_FILTERS = 1 + len(LONGEST_MEMORY) * STAR_SIZE + 1
ROW_SCALE = [2, 2, 3, 3]
"""Which scale each row's R follows."""


class JointState(NamedTuple):
    """What joint adaptation remembers.

    Attributes:
        process_noise: `(..., 2)` Q that theta = 0 stands for (m^2, rad^2).
        measurement_noise: `(..., 4)` R that theta = 0 stands for.
        log_scale: `(..., 2, 4)` theta of the settled and the fast learner.
        information: `(..., 2, 4, 4)` I.
        memory: `(..., 2)` N [measurements].
        start_weight: `(...)` weight of the start's noise against the settled learner's.
        lead: `(..., 2)` by how much the fast learner and slip have predicted better of late
            than the calm hypotheses [nats].
        mean: `(..., 20, 3)` filters: the start's noise, the two learners' stars, slip.
        covariance: `(..., 20, 3, 3)` their covariances.
        forecast_mean: `(..., 2, 10, 3)` the first ten filters as they were after the last but
            one and after the last measurement, predicted to now.
        forecast_covariance: `(..., 2, 10, 3, 3)` their covariances.
        forecast_count: `(...)` how many of the two forecasts there are, the newest last.
    """

    process_noise: FloatArray
    measurement_noise: FloatArray
    log_scale: FloatArray
    information: FloatArray
    memory: FloatArray
    start_weight: FloatArray
    lead: FloatArray
    mean: FloatArray
    covariance: FloatArray
    forecast_mean: FloatArray
    forecast_covariance: FloatArray
    forecast_count: FloatArray


class JointReport(NamedTuple):
    """What joint adaptation believes, and why.

    Attributes:
        log_scale: `(..., 4)` theta in use, in log variance; 0 is the start's noise.
        explained: `(..., 4)` u of the settled learner; 0 where nothing was learned.
        firing_strength: `(..., 4, 3)` alpha of its rules I, M, D; 0 where nothing was learned.
        weights: `(..., 4)` of the hypotheses, in the order of `HYPOTHESES`; they sum to 1.
    """

    log_scale: FloatArray
    explained: FloatArray
    firing_strength: FloatArray
    weights: FloatArray


def start_joint(
    mean: FloatArray,
    covariance: FloatArray,
    process_noise: FloatArray,
    measurement_noise: FloatArray,
) -> JointState:
    """Return the state that has learned nothing.

    Args:
        mean: `(..., 3)` start (m, m, rad).
        covariance: `(..., 3, 3)` its covariance.
        process_noise: `(..., 2)` Q at the start (m^2, rad^2).
        measurement_noise: `(..., 4)` R at the start.
    """
    batch = mean.shape[:-1]
    learners = len(LONGEST_MEMORY)
    state = JointState(
        process_noise=process_noise,
        measurement_noise=measurement_noise,
        log_scale=np.zeros((*batch, learners, SCALE_COUNT)),
        information=np.broadcast_to(
            PRIOR_INFORMATION, (*batch, learners, SCALE_COUNT, SCALE_COUNT)
        ),
        memory=np.full((*batch, learners), SHORTEST_MEMORY),
        start_weight=np.full(batch, START_WEIGHT),
        lead=np.zeros((*batch, 2)),
        mean=mean,
        covariance=covariance,
        forecast_mean=mean,
        forecast_covariance=covariance,
        forecast_count=np.zeros(batch),
    )
    return at_pose(state, mean, covariance)


def at_pose(state: JointState, mean: FloatArray, covariance: FloatArray) -> JointState:
    """Return the state with all filters at another pose; what was learned is kept."""
    batch = mean.shape[:-1]
    return state._replace(
        mean=np.broadcast_to(mean[..., None, :], (*batch, _FILTERS, 3)),
        covariance=np.broadcast_to(covariance[..., None, :, :], (*batch, _FILTERS, 3, 3)),
        forecast_mean=np.broadcast_to(mean[..., None, None, :], (*batch, 2, _FORECAST_FILTERS, 3)),
        forecast_covariance=np.broadcast_to(
            covariance[..., None, None, :, :], (*batch, 2, _FORECAST_FILTERS, 3, 3)
        ),
        forecast_count=np.zeros(batch),
    )


def noise_in_use(state: JointState, bounds: NoiseBounds) -> tuple[FloatArray, FloatArray]:
    """Return Q `(..., 2)` and R `(..., 4)` that the published filter runs on."""
    theta = _log_scale_in_use(state)
    return (
        np.clip(
            state.process_noise * np.exp(theta[..., :2]), bounds.process_min, bounds.process_max
        ),
        np.clip(
            state.measurement_noise * np.exp(theta[..., ROW_SCALE]),
            bounds.measurement_min,
            bounds.measurement_max,
        ),
    )


def calm_noise(state: JointState) -> tuple[FloatArray, FloatArray]:
    """Return Q `(..., 2)` and R `(..., 4)` of the calm hypotheses: what outlives an alarm."""
    settled = state.log_scale[..., _SETTLED, :] * (1.0 - state.start_weight)[..., None]
    return (
        state.process_noise * np.exp(settled[..., :2]),
        state.measurement_noise * np.exp(settled[..., ROW_SCALE]),
    )


def adapt_jointly(
    plant: Plant,
    sets: FuzzySets,
    bounds: NoiseBounds,
    state: JointState,
    period: StepInput,
    accepted: BoolArray,
    teaching: BoolArray,
    learning: bool,
) -> tuple[JointState, JointReport]:
    """Take all filters over one period and learn from what they predicted.

    Args:
        plant: the robot.
        sets: the network's membership functions, in log variance.
        bounds: what the noise cannot leave.
        state: the state before; not changed.
        period: what the period brought.
        accepted: `(..., 4)` the rows that correct the filters.
        teaching: `(..., 4)` the rows that are learned from; all that are accepted, and those
            that the gate rejects because the noise is wrong.
        learning: False only moves the filters on; what was learned stays as it is, and what a
            sudden hypothesis has to say fades.
    """
    Q, R = _noise_of_filters(state)
    each = for_each(period)
    mean, covariance = predict(plant, state.mean, state.covariance, Q, each.control)
    z = carry_to_end(plant, state.mean[..., 2], each)
    noise = noise_matrix(plant, R, each)
    corrects, teaches = accepted[..., None, :], teaching[..., None, :]
    seen = used = innovate(mean, covariance, z, noise, teaches)
    if np.any(corrects != teaches):
        used = innovate(mean, covariance, z, noise, corrects)
    mean, covariance = update(mean, covariance, noise, corrects, used)

    first = slice(0, _FORECAST_FILTERS)
    ahead, spread = predict(
        plant,
        state.forecast_mean,
        state.forecast_covariance,
        Q[..., None, first, :],
        each.control[..., None, :],
    )
    forecast = innovate(
        ahead[..., 0, :, :],
        spread[..., 0, :, :, :],
        z[..., first, :],
        noise[..., first, :, :],
        teaches,
    )

    measured = np.any(teaching, axis=-1)
    still = np.abs(period.control) < np.asarray(STANDSTILL) * plant.period_scale
    learns = measured & ~np.all(still, axis=-1) & learning
    moved = state._replace(mean=mean, covariance=covariance)
    after, explained, alpha = _learn_all(moved, sets, bounds, seen, forecast, learns)
    faded = np.where(learns[..., None], after.lead, ALARM_MEMORY * after.lead)
    after = after._replace(lead=faded)
    after = _shift_forecasts(after, ahead, spread, measured)
    return after, JointReport(_log_scale_in_use(after), explained, alpha, _weights(after))


def _learn_all(
    state: JointState,
    sets: FuzzySets,
    bounds: NoiseBounds,
    seen: Innovation,
    forecast: Innovation,
    teaches: BoolArray,
) -> tuple[JointState, FloatArray, FloatArray]:
    """Return the state with learners and weights moved, and the settled learner's u and alpha."""
    foreseen = teaches & (state.forecast_count >= 2.0)
    evidence = star_evidence(
        side_by_side(
            filters_of(forecast, slice(1, None)),
            filters_of(seen, slice(1 + STAR_SIZE, 1 + 2 * STAR_SIZE)),
        )
    )
    learned, explained, alpha = _learn(
        state, sets, bounds, evidence, np.stack([foreseen, teaches], axis=-1)
    )
    of_settled, of_fast = np.moveaxis(evidence.log_likelihood, -1, 0)

    lead = log_likelihood(filters_of(forecast, slice(0, 1)))[..., 0] - of_settled
    w = state.start_weight
    w = w / (w + (1.0 - w) * np.exp(-np.clip(lead, -LARGEST_GAIN, LARGEST_GAIN)))
    w = (1.0 - SWITCHING_RATE) * w + SWITCHING_RATE * START_WEIGHT
    w = np.where(foreseen, w, state.start_weight)

    likelihood = log_likelihood(filters_of(seen, slice(0, 2)))
    best = np.max(likelihood, axis=-1)
    relative = np.exp(likelihood - best[..., None])
    calm = best + np.log(w * relative[..., 0] + (1.0 - w) * relative[..., 1])
    of_slip = log_likelihood(filters_of(seen, slice(_FILTERS - 1, None)))[..., 0]
    gained = np.stack([of_fast, of_slip], axis=-1) - calm[..., None]
    gained = np.clip(gained, -LARGEST_GAIN, LARGEST_GAIN)
    lead_now = np.minimum(ALARM_MEMORY * state.lead + gained, LONGEST_LEAD)
    lead_now = np.where(teaches[..., None], lead_now, state.lead)
    learned = learned._replace(start_weight=w, lead=lead_now)
    return learned, explained[..., _SETTLED, :], alpha[..., _SETTLED, :, :]


def _learn(
    state: JointState,
    sets: FuzzySets,
    bounds: NoiseBounds,
    evidence: Evidence,
    teaches: BoolArray,
) -> tuple[JointState, FloatArray, FloatArray]:
    """Return the state with the learners moved, their u `(..., 2, 4)` and alpha `(..., 2, 4, 3)`.

    Args:
        state: before.
        sets: the membership functions.
        bounds: of the noise.
        evidence: of both learners, with the axis `(..., 2)`.
        teaches: `(..., 2)` whether each learns.
    """
    N = state.memory
    fade = (1.0 / N)[..., None, None]
    information = (1.0 - fade) * state.information + evidence.information + fade * PRIOR_INFORMATION
    u = np.asarray(np.linalg.solve(information, evidence.score[..., None])[..., 0], np.float64)
    inference = infer(sets, -u)  # the sets' argument is the opposite of a mismatch
    low, high = (limit[..., None, :] for limit in _log_limits(state, bounds))
    theta = np.clip(state.log_scale + inference.change, low, high)

    of_scale, of_matrix = teaches[..., None], teaches[..., None, None]
    after = state._replace(
        log_scale=np.where(of_scale, theta, state.log_scale),
        information=np.where(of_matrix, information, state.information),
        memory=np.where(teaches, np.minimum(N + MEMORY_GROWTH, LONGEST_MEMORY), N),
    )
    return (
        after,
        np.where(of_scale, u, 0.0),
        np.where(of_matrix, inference.firing_strength, 0.0),
    )


def _shift_forecasts(
    state: JointState, ahead: FloatArray, spread: FloatArray, measured: BoolArray
) -> JointState:
    """Return the state with forecasts one step on; a measurement starts a new one."""
    first = slice(0, _FORECAST_FILTERS)
    newest = np.stack([ahead[..., 1, :, :], state.mean[..., first, :]], axis=-3)
    newest_spread = np.stack([spread[..., 1, :, :, :], state.covariance[..., first, :, :]], axis=-4)
    return state._replace(
        forecast_mean=np.where(measured[..., None, None, None], newest, ahead),
        forecast_covariance=np.where(measured[..., None, None, None, None], newest_spread, spread),
        forecast_count=np.where(
            measured, np.minimum(state.forecast_count + 1.0, 2.0), state.forecast_count
        ),
    )


def _noise_of_filters(state: JointState) -> tuple[FloatArray, FloatArray]:
    """Return Q `(..., 20, 2)` and R `(..., 20, 4)` of all filters."""
    stars = state.log_scale[..., None, :] + STAR
    batch = stars.shape[:-3]
    theta = np.concatenate(
        [
            np.zeros((*batch, 1, SCALE_COUNT)),
            stars.reshape(*batch, -1, SCALE_COUNT),
            state.log_scale[..., [_SETTLED], :] + SLIP,
        ],
        axis=-2,
    )
    return (
        state.process_noise[..., None, :] * np.exp(theta[..., :2]),
        state.measurement_noise[..., None, :] * np.exp(theta[..., ROW_SCALE]),
    )


def _log_scale_in_use(state: JointState) -> FloatArray:
    settled, fast = state.log_scale[..., _SETTLED, :], state.log_scale[..., _FAST, :]
    theta = np.stack([np.zeros_like(settled), settled, fast, settled + SLIP], axis=-2)
    return np.asarray(np.sum(_weights(state)[..., None] * theta, axis=-2))


def _weights(state: JointState) -> FloatArray:
    """Return the weights `(..., 4)`: the two calm hypotheses by their odds, the sudden by lead."""
    sudden = np.expm1(np.maximum(state.lead, 0.0)) / np.exp(ALARM_LEAD)
    calm = 1.0 / (1.0 + np.sum(sudden, axis=-1, keepdims=True))
    w = state.start_weight
    return np.concatenate([calm * np.stack([w, 1.0 - w], axis=-1), calm * sudden], axis=-1)


def _log_limits(state: JointState, bounds: NoiseBounds) -> tuple[FloatArray, FloatArray]:
    """Return the smallest and largest theta `(..., 4)` that the bounds leave."""
    Q, R = state.process_noise, state.measurement_noise
    yaw, position = slice(Row.COMPASS_YAW, None), slice(0, Row.COMPASS_YAW)
    low_Q, high_Q = np.log(bounds.process_min / Q), np.log(bounds.process_max / Q)
    low_R, high_R = np.log(bounds.measurement_min / R), np.log(bounds.measurement_max / R)
    low = [np.max(low_R[..., rows], axis=-1, keepdims=True) for rows in (position, yaw)]
    high = [np.min(high_R[..., rows], axis=-1, keepdims=True) for rows in (position, yaw)]
    return np.concatenate([low_Q, *low], axis=-1), np.concatenate([high_Q, *high], axis=-1)
