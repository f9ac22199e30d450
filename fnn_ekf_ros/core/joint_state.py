# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The state of joint adaptation: what it has learned, its hypotheses, and the noise in use."""

from enum import IntEnum
from typing import NamedTuple

import numpy as np

from fnn_ekf_ros.core.arrays import BoolArray, Constant, FloatArray
from fnn_ekf_ros.core.bounds import NoiseBounds
from fnn_ekf_ros.core.evidence import (
    SCALE_COUNT,
)
from fnn_ekf_ros.core.joint_filters import (
    FAST,
    LEARNER_COUNT,
    PROCESS_SCALES,
    ROW_SCALE,
    SETTLED,
    SLIP,
)


class Hypothesis(IntEnum):
    """Noise hypotheses, in the order of their weights."""

    START = 0
    SETTLED = 1
    FAST = 2
    SLIP = 3


HYPOTHESES = tuple(hypothesis.name.lower() for hypothesis in Hypothesis)
"""Names of the noise hypotheses in messages."""
SHORTEST_MEMORY = 15.0
"""N of a learner at its start [measurements]: the start may be far off, which needs large steps."""
PRIOR_INFORMATION: FloatArray = 0.2 * np.eye(SCALE_COUNT) + 5.0 * np.array(
    [[1.0, -1.0, 0.0, 0.0], [-1.0, 1.0, 0.0, 0.0], [0.0] * 4, [0.0] * 4]
)
"""I_0, information per squared log variance: 0.2 on each scale keeps u finite where nothing was
measured; 5 on the difference of distance and rotation moves these two together until measurements
distinguish them."""
START_WEIGHT = 0.5
"""Initial weight of the start's noise against the settled learner's: neither is known to be
better."""
ALARM_MEMORY = 0.9
"""Factor on the lead of a sudden hypothesis (fast, slip) per nominal period: a memory of about four
seconds."""
ALARM_LEAD = 6.0
"""Lead at which a sudden hypothesis has half of the weight [nats]: odds of 400 to 1, which chance
rarely reaches; the fast learner is noisy."""
_LOG_SLIP = Constant(SLIP)
"""`SLIP`, for any batch."""
_PRIOR = Constant(PRIOR_INFORMATION)
"""`PRIOR_INFORMATION`, for any batch."""
_SUDDEN_WEIGHTS = slice(Hypothesis.FAST, Hypothesis.SLIP + 1)
"""Weights of the sudden hypotheses, fast and slip."""


class JointState(NamedTuple):
    """The state of joint adaptation, without its filters.

    Attributes:
        process_noise: `(2, *batch)` Q at theta = 0 (m^2, rad^2).
        measurement_noise: `(4, *batch)` R at theta = 0 (m^2, m^2, rad^2, rad^2).
        log_scale: `(4, 2, *batch)` theta of the settled and of the fast learner.
        information: `(4, 4, 2, *batch)` I of the learners.
        memory: `(4, 2, *batch)` N of each scale [measurements].
        since_informed: `(4, *batch)` time since a measurement informed each scale
            [nominal periods].
        control_since_scored: `(2, *batch)` [dS, dtheta] of the wheels since readings were scored
            (m, rad).
        start_weight: `(*batch)` weight of the start's noise against the settled learner's.
        lead: `(2, *batch)` recent log likelihood ratio of fast and of slip to the mixture of start
            and settled [nats].
        forecast_count: `(*batch)` number of forecasts that exist, 0 to 2; the newer one exists
            first.
    """

    process_noise: FloatArray
    measurement_noise: FloatArray
    log_scale: FloatArray
    information: FloatArray
    memory: FloatArray
    since_informed: FloatArray
    control_since_scored: FloatArray
    start_weight: FloatArray
    lead: FloatArray
    forecast_count: FloatArray


class JointReport(NamedTuple):
    """The noise that joint adaptation uses, and the reasons.

    Attributes:
        log_scale: `(4, *batch)` theta in use, in log variance; 0 is the start's noise.
        explained: `(4, *batch)` u of the settled learner; 0 where nothing was learned.
        firing_strength: `(3, 4, *batch)` alpha of its rules I, M, D; 0 where nothing was learned.
        weights: `(4, *batch)` of the hypotheses, in the order of `HYPOTHESES`; their sum is 1.
    """

    log_scale: FloatArray
    explained: FloatArray
    firing_strength: FloatArray
    weights: FloatArray


class Learned(NamedTuple):
    """The result of learning from readings.

    Attributes:
        state: after them.
        explained: `(4, *batch)` u of the settled learner, in log variance.
        firing_strength: `(3, 4, *batch)` alpha of its rules.
    """

    state: JointState
    explained: FloatArray
    firing_strength: FloatArray


def start_joint(process_noise: FloatArray, measurement_noise: FloatArray) -> JointState:
    """Return the state before learning, with Q `(2, *batch)` and R `(4, *batch)` at theta = 0."""
    batch = process_noise.shape[1:]
    prior = _PRIOR.behind(1 + len(batch))
    return JointState(
        process_noise=process_noise,
        measurement_noise=measurement_noise,
        log_scale=np.zeros((SCALE_COUNT, LEARNER_COUNT, *batch)),
        information=np.broadcast_to(prior, (SCALE_COUNT, SCALE_COUNT, LEARNER_COUNT, *batch)),
        memory=np.full((SCALE_COUNT, LEARNER_COUNT, *batch), SHORTEST_MEMORY),
        since_informed=np.ones((SCALE_COUNT, *batch)),
        control_since_scored=np.zeros((2, *batch)),
        start_weight=np.full(batch, START_WEIGHT),
        lead=np.zeros((2, *batch)),
        forecast_count=np.zeros(batch),
    )


def without_forecasts(state: JointState) -> JointState:
    """Return the state after a move to another pose: without forecasts, with what was learned."""
    return state._replace(forecast_count=np.zeros_like(state.forecast_count))


def noise_in_use(state: JointState, bounds: NoiseBounds) -> tuple[FloatArray, FloatArray]:
    """Return Q `(2, *batch)` and R `(4, *batch)` of the published filter."""
    return _scaled(state, _log_scale_in_use(state, _weights(state)), bounds)


def noise_without_alarms(state: JointState, bounds: NoiseBounds) -> tuple[FloatArray, FloatArray]:
    """Return Q `(2, *batch)` and R `(4, *batch)` of the hypotheses start and settled alone."""
    return _scaled(state, state.log_scale[:, SETTLED] * (1.0 - state.start_weight), bounds)


def noise_with_part_of_alarms(
    state: JointState, bounds: NoiseBounds, part: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return Q and R with a part `(*batch)` of the increase by alarms, in log variance."""
    persistent = state.log_scale[:, SETTLED] * (1.0 - state.start_weight)
    in_use = _log_scale_in_use(state, _weights(state))
    return _scaled(state, persistent + part * (in_use - persistent), bounds)


def _scaled(
    state: JointState, theta: FloatArray, bounds: NoiseBounds
) -> tuple[FloatArray, FloatArray]:
    """Return Q and R for log scales `(4, *batch)`, within the bounds."""
    factor = np.exp(theta)
    return bounds.within(
        state.process_noise * factor[PROCESS_SCALES], state.measurement_noise * factor[ROW_SCALE]
    )


def report(state: JointState, learned: Learned | None) -> JointReport:
    """Return the noise in use and the reasons; u and alpha are 0 where nothing was learned."""
    weights = _weights(state)
    in_use = _log_scale_in_use(state, weights)
    if learned is None:
        return JointReport(
            log_scale=in_use,
            explained=np.zeros_like(in_use),
            firing_strength=np.zeros((3, *in_use.shape)),
            weights=weights,
        )
    return JointReport(
        log_scale=in_use,
        explained=learned.explained,
        firing_strength=learned.firing_strength,
        weights=weights,
    )


def fading(state: JointState, control: FloatArray, elapsed: float) -> JointState:
    """Return the state after a step of the wheels, by which the leads fade.

    Args:
        state: before it.
        control: `(2, *batch)` [dS, dtheta] (m, rad).
        elapsed: its duration [nominal periods].
    """
    return state._replace(
        lead=ALARM_MEMORY**elapsed * state.lead,
        since_informed=state.since_informed + elapsed,
        control_since_scored=state.control_since_scored + control,
    )


def stepped(state: JointState, steps: BoolArray) -> JointState:
    """Return the state after readings; `steps`, `(*batch)`: whether the forecasts took a step."""
    count = np.where(steps, np.minimum(state.forecast_count + 1.0, 2.0), state.forecast_count)
    return state._replace(forecast_count=count)


def _log_scale_in_use(state: JointState, weights: FloatArray) -> FloatArray:
    """Return the mean of the hypotheses' theta, `(4, *batch)`, by their weights `(4, *batch)`."""
    slip = weights[Hypothesis.SLIP]
    settled = weights[Hypothesis.SETTLED] + slip  # slip is relative to the settled noise
    fast = weights[Hypothesis.FAST]
    theta = settled * state.log_scale[:, SETTLED] + fast * state.log_scale[:, FAST]
    theta += slip * _LOG_SLIP.behind(theta.ndim - 1)
    return np.asarray(theta)


def _weights(state: JointState) -> FloatArray:
    """Return the hypotheses' weights `(4, *batch)`: start and settled by odds, others by lead."""
    w = state.start_weight
    weights = np.empty((len(Hypothesis), *w.shape))
    weights[Hypothesis.START] = w
    weights[Hypothesis.SETTLED] = 1.0 - w
    sudden = weights[_SUDDEN_WEIGHTS]
    np.expm1(np.maximum(state.lead, 0.0), out=sudden)
    sudden /= np.exp(ALARM_LEAD)
    weights /= 1.0 + weights[Hypothesis.FAST] + weights[Hypothesis.SLIP]
    return weights
