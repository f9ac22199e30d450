"""The whole filter as one immutable value and one pure function.

`step` reads as the method: predict by the wheels, carry the measurements to the period's end,
correct, remember the innovation, adapt the noise. A `FilterState` is never changed, so keeping
an old one is all it takes to go back in time. Every array may have leading batch dimensions.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from fnn_ekf_ros.core.adaptation import Adaptation, Scales, adapt
from fnn_ekf_ros.core.arrays import (
    STATE_SIZE,
    BoolArray,
    FloatArray,
    diagonal_matrix,
)
from fnn_ekf_ros.core.covariance import limit_uncertainty
from fnn_ekf_ros.core.kalman import correct, predict_covariance
from fnn_ekf_ros.core.motion import MotionModel, displacement, move
from fnn_ekf_ros.core.window import InnovationWindow, empty_window, push

NOMINAL_PERIOD_S = 0.375
"""The paper's period [s]; process noise is given for one step of this length."""


@dataclass(frozen=True, slots=True)
class FilterModel:
    """What a filter is told once.

    Attributes:
        motion_model: f(x, u).
        period_s: length of one step [s]; Q is scaled in proportion to it.
        process_noise: diagonal of Q for `NOMINAL_PERIOD_S` at the start (m^2, rad^2).
        measurement_noise: diagonal of R at the start, rows as in `Row`.
        adaptation: how Q and R change.
    """

    motion_model: MotionModel
    period_s: float
    process_noise: tuple[float, float]
    measurement_noise: tuple[float, float, float, float]
    adaptation: Adaptation


class FilterState(NamedTuple):
    """Everything a filter remembers.

    Attributes:
        mean: `(..., 3)` [x, y, theta] in the map frame (m, m, rad).
        covariance: `(..., 3, 3)` P.
        process_noise: `(..., 2)` diagonal of Q for `NOMINAL_PERIOD_S` (m^2, rad^2).
        measurement_noise: `(..., 4)` diagonal of R, rows as in `Row`.
        window: the last innovations.
    """

    mean: FloatArray
    covariance: FloatArray
    process_noise: FloatArray
    measurement_noise: FloatArray
    window: InnovationWindow


class StepInput(NamedTuple):
    """What one period brought.

    Attributes:
        control: `(..., 2)` [dS, dtheta] of the whole period (m, rad).
        measurement: `(..., 4)` the latest measurement of each row (m, m, rad, rad).
        available: `(..., 4)` which rows were measured.
        control_at_measurement: `(..., 4, 2)` [dS, dtheta] from the period's begin to the
            instant each row was measured at (m, rad); None where all were measured at its end.
        measurement_covariance: `(..., 4, 4)` R as the sensors reported it, to be multiplied by
            the adapted scale; None to use the filter's own R.
    """

    control: FloatArray
    measurement: FloatArray
    available: BoolArray
    control_at_measurement: FloatArray | None = None
    measurement_covariance: FloatArray | None = None


class StepResult(NamedTuple):
    """What one period showed; for diagnostics and statistics.

    Attributes:
        innovation: `(..., 4)` r, 0 where not available (m, m, rad, rad).
        innovation_variance: `(..., 4)` diagonal of S.
        available: `(..., 4)` which rows were measured.
        nis: `(...)` normalised innovation squared of the available rows.
        degrees_of_freedom: `(...)` how many rows that were.
        mismatch: `(..., 4)` D = S - C_hat.
        firing_strength: `(..., 4, 3)` alpha of the rules I, M, D.
    """

    innovation: FloatArray
    innovation_variance: FloatArray
    available: BoolArray
    nis: FloatArray
    degrees_of_freedom: FloatArray
    mismatch: FloatArray
    firing_strength: FloatArray


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
    Q = np.asarray(model.process_noise if process_noise is None else process_noise)
    R = np.asarray(model.measurement_noise if measurement_noise is None else measurement_noise)
    return FilterState(
        mean=mean,
        covariance=np.broadcast_to(covariance, (*batch, STATE_SIZE, STATE_SIZE)),
        process_noise=np.broadcast_to(Q, (*batch, Q.shape[-1])),
        measurement_noise=np.broadcast_to(R, (*batch, R.shape[-1])),
        window=empty_window(model.adaptation.window_length, batch),
    )


def reset_pose(state: FilterState, mean: FloatArray, covariance: FloatArray) -> FilterState:
    """Return the state at another pose; the adapted noise is kept, old innovations are not."""
    length = state.window.squares.shape[-2]
    return state._replace(
        mean=mean, covariance=covariance, window=empty_window(length, mean.shape[:-1])
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
    motion = move(model.motion_model, state.mean, period.control)
    period_scale = model.period_s / NOMINAL_PERIOD_S
    covariance = limit_uncertainty(
        predict_covariance(state.covariance, motion, state.process_noise * period_scale)
    )

    corrected = correct(
        motion.mean,
        covariance,
        _carry(model, state, period),
        _noise_matrix(model, state, period),
        period.available,
    )

    window = push(state.window, corrected.innovation, period.available)
    adapted = adapt(
        model.adaptation,
        state.process_noise,
        state.measurement_noise,
        window,
        corrected.innovation_variance,
        period.available,
        motion.mean[..., 2],
        Scales(process=period_scale, measurement=_reported_scale(model, period)),
    )
    after = FilterState(
        corrected.mean,
        corrected.covariance,
        adapted.process_noise,
        adapted.measurement_noise,
        window,
    )
    result = StepResult(
        corrected.innovation,
        corrected.innovation_variance,
        period.available,
        corrected.nis,
        corrected.degrees_of_freedom,
        adapted.mismatch,
        adapted.firing_strength,
    )
    return after, result


def _carry(model: FilterModel, state: FilterState, period: StepInput) -> FloatArray:
    """Carry the measurements from the instants they were taken at to the period's end."""
    if period.control_at_measurement is None:
        return period.measurement
    heading = state.mean[..., 2, None]
    end = displacement(model.motion_model, heading, period.control[..., None, :])
    since = end - displacement(model.motion_model, heading, period.control_at_measurement)
    # Row i takes the component it measures: x from row 0, y from row 1, yaw from rows 2 and 3.
    moved = np.stack(
        [since[..., 0, 0], since[..., 1, 1], since[..., 2, 2], since[..., 3, 2]], axis=-1
    )
    return period.measurement + moved


def _noise_matrix(model: FilterModel, state: FilterState, period: StepInput) -> FloatArray:
    """Return R: the filter's own, or what the sensors reported times the adapted scale."""
    own = diagonal_matrix(state.measurement_noise)
    if period.measurement_covariance is None:
        return own
    scale: FloatArray = np.sqrt(state.measurement_noise / np.asarray(model.measurement_noise))
    reported = period.measurement_covariance * scale[..., :, None] * scale[..., None, :]
    both = period.available[..., :, None] & period.available[..., None, :]
    return np.where(both, reported, own)


def _reported_scale(model: FilterModel, period: StepInput) -> FloatArray:
    """Return by how much the R in use moves when the filter's own R moves by one, `(..., 4)`."""
    own = np.asarray(model.measurement_noise)
    if period.measurement_covariance is None:
        return np.ones_like(own)
    reported = np.diagonal(period.measurement_covariance, axis1=-2, axis2=-1)
    return np.where(period.available, reported / own, 1.0)
