# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""One period of the localizer: the filter's step, its start, and poses set from outside.

A filter that starts within a period uses its later readings; a pose that is set counts from
its stamp on, and the readings after it correct it.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from fnn_ekf_ros.core.arrays import Constant, FloatArray
from fnn_ekf_ros.core.bank import Bank
from fnn_ekf_ros.core.filter import step
from fnn_ekf_ros.core.results import Epoch, StepResult
from fnn_ekf_ros.core.state import FilterModel, FilterState, reset_pose, start_filter
from fnn_ekf_ros.timeline.events import PoseReset
from fnn_ekf_ros.timeline.initialization import AwaitingStart, wait
from fnn_ekf_ros.timeline.inputs import PeriodInputs

FAILURES = (ArithmeticError, np.linalg.LinAlgError)
"""Exceptions of a period whose numbers do not stay finite."""


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
    before: FilterState | AwaitingStart
    after: FilterState | AwaitingStart


def run_period(
    model: FilterModel, before: FilterState | AwaitingStart, inputs: PeriodInputs
) -> tuple[FilterState | AwaitingStart, StepResult | None]:
    """Take the localizer over one period.

    Args:
        model: the filter.
        before: the state at the period's begin; not changed.
        inputs: of the period; a batch of filters needs them for each of its robots.

    Returns:
        The state at the period's end; the result of the step, None if no filter ran from its begin.
    """
    after = state_at_begin(model, before, inputs)
    result: StepResult | None = None
    if isinstance(after, AwaitingStart):
        epochs = inputs.epochs if inputs.wheels_known else ()
        after = _wait(model, after, epochs)
    else:
        after, result = step(model, after, inputs.epochs)
    if inputs.reset is not None:
        after = _set_pose(model, after, inputs.reset)
        if inputs.epochs_after_reset:
            after, _ = step(model, after, inputs.epochs_after_reset)
    return after, result


def _wait(
    model: FilterModel, waiting: AwaitingStart, epochs: Sequence[Epoch]
) -> FilterState | AwaitingStart:
    """Return the filter that starts in one of the epochs and continues, or what still waits."""
    for place, epoch in enumerate(epochs):
        state = wait(model, waiting, epoch)
        if isinstance(state, FilterState):
            rest = epochs[place + 1 :]
            return step(model, state, rest)[0] if rest else state
        waiting = state
    return waiting


def state_at_begin(
    model: FilterModel, before: FilterState | AwaitingStart, inputs: PeriodInputs
) -> FilterState | AwaitingStart:
    """Return the filter that starts with a period from the pose that was given, if it does."""
    if (
        isinstance(before, AwaitingStart)
        and before.given_pose is not None
        and inputs.wheels_known_at_end
    ):
        return start_at(model, before, before.given_pose, before.given_covariance)
    return before


def start_at(
    model: FilterModel, waiting: AwaitingStart, mean: FloatArray, covariance: FloatArray
) -> FilterState:
    """Return the filter that starts at a pose `(3,)` with what it has waited with."""
    return start_filter(
        model,
        mean,
        covariance,
        waiting.process_noise,
        waiting.measurement_noise,
        log_weight=waiting.log_weight,
    )


def without_measurements(inputs: PeriodInputs) -> PeriodInputs:
    """Return the same period with the readings of the wheels only."""
    return inputs._replace(
        epochs=tuple(map(blind, inputs.epochs)),
        epochs_after_reset=tuple(map(blind, inputs.epochs_after_reset)),
    )


def blind(epoch: Epoch) -> Epoch:
    """Return the same epoch without readings."""
    return epoch._replace(available=np.zeros_like(epoch.available), fix_covariance=None)


def check_finite(state: FilterState) -> None:
    """Check the numbers of a filter.

    Raises:
        ArithmeticError: they are not finite, or the covariance is not positive definite.
    """
    if not np.all(np.isfinite(state.mean)):
        raise ArithmeticError("the pose is not finite")
    if not np.all(np.isfinite([*state.process_noise, *state.measurement_noise])):
        raise ArithmeticError("the noise is not finite")
    if not _is_finite(state.bank):
        raise ArithmeticError("a filter beside the published one is not finite")
    if state.lasting is not None and not (
        _is_finite(state.lasting.bank) and np.isfinite(state.lasting.outages.log_weight).all()
    ):
        raise ArithmeticError("a filter of lasting errors is not finite")
    if not np.linalg.eigvalsh(state.covariance)[0] > 0.0:
        raise ArithmeticError("the covariance is not positive definite")


def _is_finite(bank: Bank) -> bool:
    return bool(np.isfinite(bank.mean).all() and np.isfinite(bank.covariance).all())


def _set_pose(
    model: FilterModel, state: FilterState | AwaitingStart, reset: PoseReset
) -> FilterState:
    """Return the filter at a pose that was set from outside."""
    if isinstance(state, AwaitingStart):
        return start_at(model, state, reset.pose, reset.covariance)
    batch = state.mean.shape[1:]
    mean, covariance = Constant(reset.pose), Constant(reset.covariance)
    return reset_pose(
        model,
        state,
        np.broadcast_to(mean.behind(len(batch)), (3, *batch)),
        np.broadcast_to(covariance.behind(len(batch)), (3, 3, *batch)),
    )
