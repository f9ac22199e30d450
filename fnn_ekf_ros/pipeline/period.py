"""One period of the localizer: the filter's step, its start, and poses set from outside."""

from typing import NamedTuple

import numpy as np

from fnn_ekf_ros.core.arrays import FloatArray
from fnn_ekf_ros.core.filter import (
    FilterModel,
    FilterState,
    StepResult,
    reset_pose,
    start_filter,
    step,
)
from fnn_ekf_ros.core.motion import move
from fnn_ekf_ros.pipeline.inputs import PeriodInputs
from fnn_ekf_ros.pipeline.start import Waiting, wait

FAILURES = (ArithmeticError, np.linalg.LinAlgError)
"""What a period raises that leaves the finite numbers."""


class Period(NamedTuple):
    """A period that was run.

    Attributes:
        end_ns: its end, ROS time [ns].
        inputs: what it was run with.
        before: the localizer at its begin.
        after: the localizer at its end.
    """

    end_ns: int
    inputs: PeriodInputs
    before: FilterState | Waiting
    after: FilterState | Waiting


def run_period(
    model: FilterModel, before: FilterState | Waiting, inputs: PeriodInputs
) -> tuple[FilterState | Waiting, StepResult | None]:
    """Take the localizer over one period; a filter that runs may be a batch.

    Args:
        model: the filter.
        before: the state at the period's begin; not changed.
        inputs: of the period.

    Returns:
        The state at the period's end; what the period showed, None if no filter ran.
    """
    before = state_at_begin(model, before, inputs)
    after: FilterState | Waiting = before
    result: StepResult | None = None
    if not isinstance(before, Waiting):
        after, result = step(model, before, inputs.step)
    elif inputs.wheels_known:
        after = wait(model, before, inputs.step)
    return _set_pose(model, after, inputs), result


def state_at_begin(
    model: FilterModel, before: FilterState | Waiting, inputs: PeriodInputs
) -> FilterState | Waiting:
    """Return the filter that starts with a period from the pose that was given, if it does."""
    if isinstance(before, Waiting) and before.given_pose is not None and inputs.wheels_known_at_end:
        return start_at(model, before, before.given_pose, before.given_covariance)
    return before


def start_at(
    model: FilterModel, waiting: Waiting, mean: FloatArray, covariance: FloatArray
) -> FilterState:
    """Return the filter that starts at a pose `(3,)` with the noise it has waited with."""
    return start_filter(model, mean, covariance, waiting.process_noise, waiting.measurement_noise)


def without_measurements(inputs: PeriodInputs) -> PeriodInputs:
    """Return the same period as if only the wheels had spoken in it."""
    blind = inputs.step._replace(
        available=np.zeros_like(inputs.step.available), measurement_covariance=None
    )
    return inputs._replace(step=blind)


def check_finite(state: FilterState) -> None:
    """Check that a filter is still one.

    Raises:
        ArithmeticError: its numbers are not finite, or its covariance is none.
    """
    if not np.all(np.isfinite(state.mean)):
        raise ArithmeticError("the pose is not finite")
    if not np.all(np.isfinite([*state.process_noise, *state.measurement_noise])):
        raise ArithmeticError("the noise is not finite")
    if not np.linalg.eigvalsh(state.covariance)[0] > 0.0:
        raise ArithmeticError("the covariance is not positive definite")


def _set_pose(
    model: FilterModel, state: FilterState | Waiting, inputs: PeriodInputs
) -> FilterState | Waiting:
    """Return the state after a pose that was set from outside, if one was."""
    if inputs.reset is None:
        return state
    mean = move(model.motion_model, inputs.reset.pose, inputs.control_since_reset).mean
    covariance = inputs.reset.covariance
    if isinstance(state, Waiting):
        return start_at(model, state, mean, covariance)
    return reset_pose(
        state,
        np.broadcast_to(mean, state.mean.shape),
        np.broadcast_to(covariance, state.covariance.shape),
    )
