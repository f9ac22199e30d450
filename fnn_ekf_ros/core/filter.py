"""The whole filter as one immutable value and one pure function.

`step` reads as the method: predict by the wheels, carry the measurements to the period's end,
judge them, correct, remember the innovation, adapt the noise. A `FilterState` is never changed,
so keeping an old one is all it takes to go back in time. Every array may have leading batch
dimensions.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from fnn_ekf_ros.core.adaptation import Adaptation, AdaptationMode, Scales, adapt
from fnn_ekf_ros.core.arrays import STATE_SIZE, BoolArray, FloatArray, select
from fnn_ekf_ros.core.gate import (
    OPEN_GATE,
    Gate,
    GateState,
    after_verdict,
    judge,
    rows_of,
    start_gate,
    teaching,
)
from fnn_ekf_ros.core.joint import (
    JointReport,
    JointState,
    adapt_jointly,
    at_pose,
    calm_noise,
    noise_in_use,
    start_joint,
)
from fnn_ekf_ros.core.kalman import innovate, update
from fnn_ekf_ros.core.motion import MotionModel
from fnn_ekf_ros.core.plant import (
    NOMINAL_PERIOD_S,
    Plant,
    StepInput,
    carry_to_end,
    noise_matrix,
    predict,
    reported_scale,
)
from fnn_ekf_ros.core.relocation import Candidate, Published, follow, no_candidate
from fnn_ekf_ros.core.window import InnovationWindow, empty_window, push

__all__ = [
    "NOMINAL_PERIOD_S",
    "FilterModel",
    "FilterState",
    "StepInput",
    "StepResult",
    "for_mode",
    "lasting_noise",
    "reset_pose",
    "start_filter",
    "step",
]


@dataclass(frozen=True, slots=True)
class FilterModel:
    """What a filter is told once.

    Attributes:
        motion_model: f(x, u).
        period_s: length of one step [s]; Q is scaled in proportion to it.
        process_noise: diagonal of Q for `NOMINAL_PERIOD_S` at the start (m^2, rad^2).
        measurement_noise: diagonal of R at the start, rows as in `Row`.
        adaptation: how Q and R change.
        gate: which readings are too wild to be right.
    """

    motion_model: MotionModel
    period_s: float
    process_noise: tuple[float, float]
    measurement_noise: tuple[float, float, float, float]
    adaptation: Adaptation
    gate: Gate = OPEN_GATE

    @property
    def plant(self) -> Plant:
        """What all filters of the robot share."""
        scale = self.period_s / NOMINAL_PERIOD_S
        return Plant(self.motion_model, scale, self.measurement_noise)


class FilterState(NamedTuple):
    """Everything a filter remembers.

    Attributes:
        mean: `(..., 3)` [x, y, theta] in the map frame (m, m, rad).
        covariance: `(..., 3, 3)` P.
        process_noise: `(..., 2)` diagonal of Q for `NOMINAL_PERIOD_S` (m^2, rad^2).
        measurement_noise: `(..., 4)` diagonal of R, rows as in `Row`.
        window: the last innovations.
        joint: what joint adaptation remembers; None in the other modes.
        gate: what the gate remembers.
        candidate: where rejected readings say the robot is.
    """

    mean: FloatArray
    covariance: FloatArray
    process_noise: FloatArray
    measurement_noise: FloatArray
    window: InnovationWindow
    joint: JointState | None
    gate: GateState
    candidate: Candidate


class StepResult(NamedTuple):
    """What one period showed; for diagnostics and statistics.

    Attributes:
        innovation: `(..., 4)` r, 0 where not available (m, m, rad, rad).
        innovation_variance: `(..., 4)` diagonal of S.
        available: `(..., 4)` which rows were measured.
        nis: `(...)` normalized innovation squared of the available rows.
        degrees_of_freedom: `(...)` how many rows that were.
        mismatch: `(..., 4)` D = S - C_hat.
        firing_strength: `(..., 4, 3)` alpha of the rules I, M, D for the rows of R; in mode `q`
            those of Q, in the rows of x and compass yaw; in mode `joint` of the four log scales.
        process_firing_strength: `(..., 2, 3)` the same for Q's distance and rotation, modes `q`
            and `rq`.
        joint: what joint adaptation believes; None in the other modes.
        sensor_nis: `(..., 2)` NIS of each sensor's rows, in the order of `gate`.
        sensor_degrees_of_freedom: `(..., 2)` how many rows it measured.
        rejected: `(..., 2)` whether the gate rejected it.
        relocated: `(...)` whether the pose was moved to where rejected readings agree.
    """

    innovation: FloatArray
    innovation_variance: FloatArray
    available: BoolArray
    nis: FloatArray
    degrees_of_freedom: FloatArray
    mismatch: FloatArray
    firing_strength: FloatArray
    process_firing_strength: FloatArray
    joint: JointReport | None
    sensor_nis: FloatArray
    sensor_degrees_of_freedom: FloatArray
    rejected: BoolArray
    relocated: BoolArray


def start_filter(
    model: FilterModel,
    mean: FloatArray,
    covariance: FloatArray,
    process_noise: FloatArray | None = None,
    measurement_noise: FloatArray | None = None,
) -> FilterState:
    """Return the state of a filter that has seen nothing but its start.

    Args:
        model: the filter.
        mean: `(..., 3)` start (m, m, rad); its leading dimensions are the batch's.
        covariance: `(..., 3, 3)` covariance of the start.
        process_noise: `(..., 2)` Q to start from instead of the model's (m^2, rad^2).
        measurement_noise: `(..., 4)` R to start from instead of the model's.
    """
    batch = mean.shape[:-1]
    covariance = np.broadcast_to(covariance, (*batch, STATE_SIZE, STATE_SIZE))
    Q = np.asarray(model.process_noise if process_noise is None else process_noise)
    R = np.asarray(model.measurement_noise if measurement_noise is None else measurement_noise)
    Q = np.broadcast_to(Q, (*batch, Q.shape[-1]))
    R = np.broadcast_to(R, (*batch, R.shape[-1]))
    joint = model.adaptation.mode is AdaptationMode.JOINT
    return FilterState(
        mean=mean,
        covariance=covariance,
        process_noise=Q,
        measurement_noise=R,
        window=empty_window(model.adaptation.window_length, batch),
        joint=start_joint(mean, covariance, Q, R) if joint else None,
        gate=start_gate(batch),
        candidate=no_candidate(mean, covariance, Q, R),
    )


def reset_pose(state: FilterState, mean: FloatArray, covariance: FloatArray) -> FilterState:
    """Return the state at another pose; the adapted noise is kept, old innovations are not."""
    length = state.window.squares.shape[-2]
    return state._replace(
        mean=mean,
        covariance=covariance,
        window=empty_window(length, mean.shape[:-1]),
        joint=None if state.joint is None else at_pose(state.joint, mean, covariance),
        gate=start_gate(mean.shape[:-1]),
        candidate=no_candidate(mean, covariance, state.process_noise, state.measurement_noise),
    )


def for_mode(model: FilterModel, state: FilterState) -> FilterState:
    """Return the state as the model's mode of adaptation needs it; itself where it does already.

    The noise stays when the mode changes: what an alarm of mode joint adds for a moment does not.
    Into mode joint that noise is its start, with nothing learned yet.
    """
    joint = model.adaptation.mode is AdaptationMode.JOINT
    if joint == (state.joint is not None):
        return state
    if state.joint is None:
        Q, R = state.process_noise, state.measurement_noise
        return state._replace(joint=start_joint(state.mean, state.covariance, Q, R))
    Q, R = lasting_noise(model, state.process_noise, state.measurement_noise, state.joint)
    return state._replace(process_noise=Q, measurement_noise=R, joint=None)


def lasting_noise(
    model: FilterModel, Q: FloatArray, R: FloatArray, joint: JointState | None
) -> tuple[FloatArray, FloatArray]:
    """Return noise without what an alarm adds for a moment, and within the bounds.

    Args:
        model: has the bounds.
        Q: `(..., 2)` in use (m^2, rad^2).
        R: `(..., 4)` in use.
        joint: what joint adaptation remembers; None in the other modes, which have no alarms.
    """
    bounds = model.adaptation.bounds
    if joint is not None:
        Q, R = calm_noise(joint)
    return (
        np.clip(Q, bounds.process_min, bounds.process_max),
        np.clip(R, bounds.measurement_min, bounds.measurement_max),
    )


def step(
    model: FilterModel, state: FilterState, period: StepInput
) -> tuple[FilterState, StepResult]:
    """Take the filter over one period.

    Args:
        model: the filter.
        state: its state at the period's begin; not changed.
        period: controls and measurements of the period.

    Returns:
        The state at the period's end, and what the period showed.
    """
    plant = model.plant
    noise = state.process_noise, state.measurement_noise
    mean, covariance = predict(plant, state.mean, state.covariance, noise[0], period.control)
    z = carry_to_end(plant, state.mean[..., 2], period)
    R_full = noise_matrix(plant, noise[1], period)
    seen = innovate(mean, covariance, z, R_full, period.available)

    verdict = judge(model.gate, state.gate, seen, period.available)
    accepted = period.available & ~rows_of(verdict.rejected)
    used = seen
    if np.any(verdict.rejected):
        used = innovate(mean, covariance, z, R_full, accepted)
    corrected, corrected_P = update(mean, covariance, R_full, accepted, used)
    candidate, relocation = follow(
        plant,
        model.gate,
        state.gate,
        state.candidate,
        Published(state.mean[..., 2], corrected, corrected_P, *noise),
        period,
        verdict,
    )
    teaches = period.available & rows_of(teaching(state.gate, verdict, relocation.explains))

    window = push(state.window, seen.innovation, teaches)
    variance = np.diagonal(covariance, axis1=-2, axis2=-1)[..., [0, 1, 2, 2]]
    innovation_variance = variance + np.diagonal(R_full, axis1=-2, axis2=-1)
    adapted = adapt(
        model.adaptation,
        *noise,
        window,
        innovation_variance,
        teaches,
        mean[..., 2],
        Scales(process=plant.period_scale, measurement=reported_scale(plant, period)),
    )
    Q, R, alpha = adapted.process_noise, adapted.measurement_noise, adapted.firing_strength
    joint, report = state.joint, None
    if joint is not None:
        how = model.adaptation
        joint, report = adapt_jointly(
            plant,
            how.networks.joint.sets,
            how.bounds,
            joint,
            period,
            accepted,
            teaches,
            how.learning,
        )
        Q, R = noise_in_use(joint, how.bounds)
        alpha = report.firing_strength
    after = FilterState(
        corrected,
        corrected_P,
        Q,
        R,
        window,
        joint,
        after_verdict(
            state.gate,
            verdict,
            relocation.agrees,
            learns=model.adaptation.learns_measurement_noise,
        ),
        candidate,
    )
    result = StepResult(
        seen.innovation,
        innovation_variance,
        period.available,
        seen.nis,
        seen.degrees_of_freedom,
        adapted.mismatch,
        alpha,
        adapted.process_firing_strength,
        report,
        verdict.nis,
        verdict.degrees_of_freedom,
        verdict.rejected,
        relocation.confirmed,
    )
    return _relocated(after, relocation.confirmed), result


def _relocated(state: FilterState, confirmed: BoolArray) -> FilterState:
    """Return the filters that a candidate was confirmed for at its pose."""
    if not np.any(confirmed):
        return state
    moved = reset_pose(state, state.candidate.mean, state.candidate.covariance)
    chosen: FilterState = select(confirmed, moved, state)
    return chosen
