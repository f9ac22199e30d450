"""Joint adaptation of Q and R: a fuzzy neural network fed with the evidence of neighbours.

Two learners each move four log scales theta (forward, heading, position, yaw; 0 is the start):

    explained  u = I^-1 d                 what the last measurement asks for, in log variance
    network    -u is N -> theta I(ncrease), Z -> M(aintain), P -> D(ecrease)
               theta <- theta + sum beta_k z_k(-u)                              (20)-(22)
    memory     I <- (1 - 1/N) I + i + 1/N I_0,  N grows with the measurements up to the longest;
               each scale fades, and its N grows, with the measurements that inform it: one that
               follows the last one after a part p < 1 of a nominal period counts for sqrt(p) of
               one, as R shows in each reading, and Q in the time over which it acts

d and i are the score and information of `evidence`. The *settled* learner has a long memory and
looks at forecasts of the measurement after next: noise that is coloured from one fix to the next
cannot fool it. The *fast* one looks at the next measurement and forgets soon.

Four hypotheses about the noise are weighed by what they predict, and the filter runs on the
log scales' weighted mean:

    the start's noise (theta = 0)   the guard: without evidence against it, it stays
    the settled learner's           takes over from the start by their odds
    the fast learner's              where it explains the last measurements better by far
    the settled one's, wheels x 50  slip; likewise: it is there before any learner could be

Every hypothesis and every neighbour is a filter of the bank, which takes every reading at its own
time; they learn from those that are scored (`pace`), which is once in about a nominal period, or
with every fix where these come faster. A forecast skips a fix, however often the compass speaks,
and looks ahead three quarters of a nominal period at the least, however fast the fixes come.
"""

from typing import NamedTuple

import numpy as np

from fnn_ekf_ros.core.arrays import BoolArray, Constant, FloatArray, Row
from fnn_ekf_ros.core.bounds import NoiseBounds
from fnn_ekf_ros.core.evidence import (
    SCALE_COUNT,
    STAR_SIZE,
    Evidence,
    star_evidence,
)
from fnn_ekf_ros.core.fuzzy import FuzzySets, infer
from fnn_ekf_ros.core.joint_filters import (
    FAST,
    FORESEEN_STAR,
    FORESEEN_START,
    LEARNER_COUNT,
    ROW_SCALE,
    SETTLED,
    SETTLED_STAR,
    SLIP,
    STARS,
    START,
    SUDDEN,
)
from fnn_ekf_ros.core.rows import Rows

HYPOTHESES = ("start", "settled", "fast", "slip")
SHORTEST_MEMORY = 15.0
"""N of a learner that has seen nothing yet [measurements]."""
LONGEST_MEMORY: FloatArray = np.array([200.0, 20.0])
"""N of the settled and of the fast learner at the most; 200 nominal periods are 75 s."""
MEMORY_GROWTH = 0.5
"""By how much N grows with a measurement: the part that was learned far off is forgotten."""
PRIOR_INFORMATION: FloatArray = 0.2 * np.eye(SCALE_COUNT) + 5.0 * np.array(
    [[1.0, -1.0, 0.0, 0.0], [-1.0, 1.0, 0.0, 0.0], [0.0] * 4, [0.0] * 4]
)
"""I_0: keeps u finite; the wheels' two scales move together until told apart."""
START_WEIGHT = 0.5
"""Weight of the start's noise against the settled learner's before anything is known."""
SWITCHING_RATE = 1e-4
"""Part of the odds that is drawn anew in a nominal period, so that they can turn again
(Herbster and Warmuth 1998, fixed share)."""
ALARM_MEMORY = 0.9
"""Part of a sudden hypothesis' lead that is left after a nominal period."""
ALARM_LEAD = 6.0
"""Lead [nats] at which a sudden hypothesis (fast, slip) has half of the say; without a lead it
has none."""
LONGEST_LEAD = 2.0 * ALARM_LEAD
"""No lead grows further: seven nominal periods after its reason has gone it has half of the say."""
LARGEST_GAIN = 50.0
"""No measurement says more for one hypothesis against another [nats]."""
STANDSTILL = (1e-3, 1e-3)
"""A nominal period with less way and turn teaches nothing: fixes are too quiet then (m, rad)."""


_LOG_SLIP = Constant(SLIP)
_PRIOR = Constant(PRIOR_INFORMATION)
_LONGEST = Constant(LONGEST_MEMORY)
_STANDSTILL = Constant(STANDSTILL)


class JointState(NamedTuple):
    """What joint adaptation remembers beside its filters.

    Attributes:
        process_noise: `(2, *batch)` Q that theta = 0 stands for (m^2, rad^2).
        measurement_noise: `(4, *batch)` R that theta = 0 stands for.
        log_scale: `(4, 2, *batch)` theta of the settled and the fast learner.
        information: `(4, 4, 2, *batch)` I.
        memory: `(4, 2, *batch)` N of each scale [measurements].
        since_informed: `(4, *batch)` since a scale was informed [nominal periods].
        way: `(2, *batch)` that the wheels went since readings were scored, [dS, dtheta] (m, rad).
        start_weight: `(*batch)` weight of the start's noise against the settled learner's.
        lead: `(2, *batch)` by how much the fast learner and slip have predicted better of late
            than the calm hypotheses [nats].
        forecast_count: `(*batch)` how many of the two forecasts there are, the newest last.
    """

    process_noise: FloatArray
    measurement_noise: FloatArray
    log_scale: FloatArray
    information: FloatArray
    memory: FloatArray
    since_informed: FloatArray
    way: FloatArray
    start_weight: FloatArray
    lead: FloatArray
    forecast_count: FloatArray


class JointReport(NamedTuple):
    """What joint adaptation believes, and why.

    Attributes:
        log_scale: `(4, *batch)` theta in use, in log variance; 0 is the start's noise.
        explained: `(4, *batch)` u of the settled learner; 0 where nothing was learned.
        firing_strength: `(3, 4, *batch)` alpha of its rules I, M, D; 0 where nothing was learned.
        weights: `(4, *batch)` of the hypotheses, in the order of `HYPOTHESES`; they sum to 1.
    """

    log_scale: FloatArray
    explained: FloatArray
    firing_strength: FloatArray
    weights: FloatArray


class Lesson(NamedTuple):
    """What readings say to the filters of joint adaptation, before these were corrected.

    Attributes:
        innovation: `(4, JOINT_COUNT, *batch)` r, 0 where not available.
        variance: `(4, JOINT_COUNT, *batch)` diagonal of S.
        likelihood: `(JOINT_COUNT, *batch)` log likelihood of the rows that teach.
        taught: which rows these are.
        scored: these and those that the gate keeps from teaching.
        since_scored: `(*batch)` since any were scored before [nominal periods].
    """

    innovation: FloatArray
    variance: FloatArray
    likelihood: FloatArray
    taught: Rows
    scored: Rows
    since_scored: FloatArray


class Learned(NamedTuple):
    """What was learned from readings.

    Attributes:
        state: after them.
        explained: `(4, *batch)` u of the settled learner.
        firing_strength: `(3, 4, *batch)` of its rules.
    """

    state: JointState
    explained: FloatArray
    firing_strength: FloatArray


def start_joint(process_noise: FloatArray, measurement_noise: FloatArray) -> JointState:
    """Return the state that has learned nothing, with Q `(2, *batch)` and R `(4, *batch)`."""
    batch = process_noise.shape[1:]
    prior = _PRIOR.behind(1 + len(batch))
    return JointState(
        process_noise=process_noise,
        measurement_noise=measurement_noise,
        log_scale=np.zeros((SCALE_COUNT, LEARNER_COUNT, *batch)),
        information=np.broadcast_to(prior, (SCALE_COUNT, SCALE_COUNT, LEARNER_COUNT, *batch)),
        memory=np.full((SCALE_COUNT, LEARNER_COUNT, *batch), SHORTEST_MEMORY),
        since_informed=np.ones((SCALE_COUNT, *batch)),
        way=np.zeros((2, *batch)),
        start_weight=np.full(batch, START_WEIGHT),
        lead=np.zeros((2, *batch)),
        forecast_count=np.zeros(batch),
    )


def without_forecasts(state: JointState) -> JointState:
    """Return the state of filters that were moved to another pose; what was learned is kept."""
    return state._replace(forecast_count=np.zeros_like(state.forecast_count))


def noise_in_use(state: JointState, bounds: NoiseBounds) -> tuple[FloatArray, FloatArray]:
    """Return Q `(2, *batch)` and R `(4, *batch)` that the published filter runs on."""
    return _scaled(state, _log_scale_in_use(state, _weights(state)), bounds)


def calm_noise(state: JointState, bounds: NoiseBounds) -> tuple[FloatArray, FloatArray]:
    """Return Q `(2, *batch)` and R `(4, *batch)` of the calm hypotheses: what outlives an alarm."""
    return _scaled(state, state.log_scale[:, SETTLED] * (1.0 - state.start_weight), bounds)


def _scaled(
    state: JointState, theta: FloatArray, bounds: NoiseBounds
) -> tuple[FloatArray, FloatArray]:
    """Return Q and R for log scales `(4, *batch)`, within the bounds."""
    factor = np.exp(theta)
    return bounds.within(
        state.process_noise * factor[:2], state.measurement_noise * factor[ROW_SCALE]
    )


def report(state: JointState, learned: Learned | None) -> JointReport:
    """Return what is believed; u and alpha are 0 where nothing was learned."""
    weights = _weights(state)
    in_use = _log_scale_in_use(state, weights)
    if learned is None:
        return JointReport(in_use, np.zeros_like(in_use), np.zeros((3, *in_use.shape)), weights)
    return JointReport(in_use, learned.explained, learned.firing_strength, weights)


def fading(state: JointState, control: FloatArray, elapsed: float) -> JointState:
    """Return the state after a step of the wheels; the alarms fade.

    Args:
        state: before it.
        control: `(2, *batch)` [dS, dtheta] (m, rad).
        elapsed: how long it took [nominal periods].
    """
    return state._replace(
        lead=ALARM_MEMORY**elapsed * state.lead,
        since_informed=state.since_informed + elapsed,
        way=state.way + control,
    )


def learn(
    state: JointState, sets: FuzzySets, bounds: NoiseBounds, lesson: Lesson, *, learning: bool
) -> Learned:
    """Learn from what the filters predicted.

    Args:
        state: the state at the readings' instant; not changed.
        sets: the network's membership functions, in log variance.
        bounds: what the noise cannot leave.
        lesson: what the readings say; all rows that are accepted teach, and those that the gate
            rejects because the noise is wrong.
        learning: False leaves what was learned as it is.
    """
    measured = lesson.taught.some
    still = np.abs(state.way) <= _STANDSTILL.behind(measured.ndim) * lesson.since_scored
    learns = measured & ~still.all(axis=0) & learning
    foreseen = learns & (state.forecast_count >= 2.0)
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

    odds = likelihood[FORESEEN_START] - likelihood[FORESEEN_STAR]
    w = state.start_weight
    w = w / (w + (1.0 - w) * np.exp(-np.minimum(np.maximum(odds, -LARGEST_GAIN), LARGEST_GAIN)))
    drawn = np.minimum(SWITCHING_RATE * lesson.since_scored, 1.0)
    w = np.where(foreseen, (1.0 - drawn) * w + drawn * START_WEIGHT, state.start_weight)

    calm = _log_mean(w, likelihood[START], likelihood[SETTLED_STAR])
    gained = np.minimum(np.maximum(likelihood[SUDDEN] - calm, -LARGEST_GAIN), LARGEST_GAIN)
    lead = np.where(learns, np.minimum(state.lead + gained, LONGEST_LEAD), state.lead)
    after = learned.state._replace(
        start_weight=w,
        lead=lead,
        since_informed=np.where(informed & measured, 0.0, state.since_informed),
    )
    return learned._replace(state=after)


def stepped(state: JointState, steps: BoolArray) -> JointState:
    """Return the state after readings that were a step of the forecasts where `(*batch)` says."""
    count = np.where(steps, np.minimum(state.forecast_count + 1.0, 2.0), state.forecast_count)
    return state._replace(forecast_count=count)


def _informed(scored: BoolArray) -> BoolArray:
    """Return which scales `(4, *batch)` are informed by rows `(4, *batch)` that are scored."""
    fix = scored[Row.X] | scored[Row.Y]
    yaw = scored[Row.COMPASS_YAW] | scored[Row.LRF_YAW]
    informed = np.empty_like(scored)  # in the order of `SCALES`
    informed[0], informed[1], informed[2], informed[3] = fix, fix | yaw, fix, yaw
    return informed


def _move_learners(
    state: JointState,
    sets: FuzzySets,
    bounds: NoiseBounds,
    evidence: Evidence,
    informed: BoolArray,
    teaches: BoolArray,
) -> Learned:
    """Return the state with the learners moved.

    Args:
        state: before.
        sets: the membership functions.
        bounds: of the noise.
        evidence: of both learners.
        informed: `(4, *batch)` which scales the readings inform.
        teaches: `(2, *batch)` whether each learner learns.
    """
    N = state.memory
    counts = np.where(informed, np.sqrt(np.minimum(state.since_informed, 1.0)), 0.0)[:, None]
    root = np.sqrt(1.0 - counts / N)
    kept = root[:, None] * root[None]
    prior = _PRIOR.behind(N.ndim - 1)
    information = kept * (state.information - prior) + prior + evidence.information
    u = _solve(information, evidence.score)
    inference = infer(sets, -u)  # the sets' argument is the opposite of a mismatch
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
    # Transposed, the batch comes first, and symmetric matrices stay what they are.
    u = np.asarray(np.linalg.solve(information.T, score.T[..., None]), dtype=np.float64)
    return u[..., 0].T


def _log_mean(w: FloatArray, one: FloatArray, other: FloatArray) -> FloatArray:
    """Return log(w e^one + (1 - w) e^other)."""
    best = np.maximum(one, other)
    return best + np.log(w * np.exp(one - best) + (1.0 - w) * np.exp(other - best))


def _log_scale_in_use(state: JointState, weights: FloatArray) -> FloatArray:
    _, settled, fast, slip = weights
    theta = (settled + slip) * state.log_scale[:, SETTLED] + fast * state.log_scale[:, FAST]
    theta += slip * _LOG_SLIP.behind(theta.ndim - 1)
    return np.asarray(theta)


def _weights(state: JointState) -> FloatArray:
    """Return the weights `(4, *batch)`: the calm hypotheses by their odds, the sudden by lead."""
    w = state.start_weight
    weights = np.empty((len(HYPOTHESES), *w.shape))
    weights[0] = w
    weights[1] = 1.0 - w
    np.expm1(np.maximum(state.lead, 0.0), out=weights[2:])
    weights[2:] /= np.exp(ALARM_LEAD)
    weights /= 1.0 + weights[2] + weights[3]
    return weights


def _log_limits(state: JointState, bounds: NoiseBounds) -> tuple[FloatArray, FloatArray]:
    """Return the smallest and largest theta `(4, 1, *batch)` that the bounds leave."""
    base = np.concatenate([state.process_noise, state.measurement_noise])
    smallest, largest = bounds.all_limits()
    low = np.log(smallest.behind(base.ndim - 1) / base)
    high = np.log(largest.behind(base.ndim - 1) / base)
    low[2], high[2] = np.maximum(low[2], low[3]), np.minimum(high[2], high[3])
    low[3], high[3] = np.maximum(low[4], low[5]), np.minimum(high[4], high[5])
    return low[:SCALE_COUNT, None], high[:SCALE_COUNT, None]
