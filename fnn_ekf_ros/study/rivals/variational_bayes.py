# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""R by variational Bayes: the VB-AKF of Sarkka and Nummenmaa (2009).

The variances of a diagonal R are inverse gamma distributed, independent of the state and of each
other. With m, P the state's mean and covariance, each step

    alpha- = rho alpha,   beta- = rho beta              forgetting, R's mean stays
    alpha = alpha- + 1/2,   beta = beta-                then, `iterations` times:
        R = diag(beta / alpha)
        m, P = Kalman correction of m-, P- with R
        beta = beta- + ((z - H m)^2 + diag(H P H')) / 2

(IEEE Transactions on Automatic Control 54(3), pp. 596-600.) Q is taken to be known: the paper
estimates R only. Its linear prediction is the extended Kalman filter's here.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from fnn_ekf_ros.core.arrays import BoolArray, FloatArray
from fnn_ekf_ros.core.bank import (
    Bank,
    Correction,
    Innovations,
    Noise,
    Readings,
    correct,
    innovate,
    predict,
    wrapped,
)
from fnn_ekf_ros.core.motion import MotionModel
from fnn_ekf_ros.core.results import Epoch
from fnn_ekf_ros.study.blocks import NUMBERS_OF_A_FILTER, BlockStart, StepEstimate
from fnn_ekf_ros.study.rivals.shared import (
    Rival,
    estimate_of,
    one_filter,
    period_scale,
    pose_difference,
    row_values,
    row_variances,
)


@dataclass(frozen=True, slots=True)
class VariationalBayesSettings:
    """Settings of the VB-AKF.

    Attributes:
        forgetting: rho, over 0 and up to 1; 1 / (1 - rho) innovations are remembered. Longer
            memories gain at most 1 % where the noise is constant and follow changes later.
        iterations: how often the fixed point is iterated, at least 1; 3 are as good as 10.
        start_confidence: alpha of the start; it weighs as much as twice as many innovations.
    """

    forgetting: float = 0.99
    iterations: int = 3
    start_confidence: float = 1.0

    def __post_init__(self) -> None:
        """Refuse what the method is not defined for."""
        if not 0.0 < self.forgetting <= 1.0:
            raise ValueError(f"forgetting is over 0 and at most 1, not {self.forgetting}")
        if self.iterations < 1:
            raise ValueError(f"iterations is at least 1, not {self.iterations}")
        if not self.start_confidence > 0.0:
            raise ValueError(f"start_confidence is over 0, not {self.start_confidence}")

    @property
    def numbers(self) -> int:
        """Number of floating-point numbers that the filter keeps of a robot."""
        return NUMBERS_OF_A_FILTER


def _filter(
    motion_model: MotionModel,
    settings: VariationalBayesSettings,
    start: BlockStart,
    epochs: Iterator[Epoch],
) -> Iterator[StepEstimate]:
    """Take some robots over all steps."""
    bank, noise = one_filter(start)
    Q = noise.process * period_scale(start)
    alpha = np.full(noise.measurement.shape, settings.start_confidence)
    beta = alpha * noise.measurement
    for epoch in epochs:
        predicted = predict(motion_model, bank, epoch.control, Q)
        R = beta / alpha
        seen = innovate(predicted, Readings(epoch.measurement, epoch.available), R)
        before = correct(predicted, seen, Noise(Q, R), epoch.available)
        # A row that was not measured keeps what it knows, whether or not time passes.
        available = epoch.available[:, None]
        forgetting = np.where(available, settings.forgetting, 1.0)
        alpha = forgetting * alpha + 0.5 * available
        corrected, beta = _fixed_point(
            predicted, seen, Q, available, alpha, forgetting * beta, settings.iterations
        )
        bank = wrapped(corrected.bank)
        yield estimate_of(bank, before.nis)


run = Rival(_filter)
"""The VB-AKF, for any recording and start. The NIS is with R as it was before the step's own
innovation."""


def _fixed_point(
    predicted: Bank,
    seen: Innovations,
    process_noise: FloatArray,
    available: BoolArray,
    alpha: FloatArray,
    beta_before: FloatArray,
    iterations: int,
) -> tuple[Correction, FloatArray]:
    """Return the correction and beta after so many iterations.

    Args:
        predicted: m-, P-.
        seen: the innovations; they are the same in all iterations.
        process_noise: `(2, 1, *batch)` Q, which does not change.
        available: `(4, 1, *batch)` which rows were measured.
        alpha: `(4, 1, *batch)` after the step.
        beta_before: `(4, 1, *batch)` beta-.
        iterations: one at the least.
    """
    beta = beta_before
    for _ in range(iterations):
        corrected = correct(predicted, seen, Noise(process_noise, beta / alpha), available[:, 0])
        # H is linear, so z - H m is the innovation less what the state moved.
        moved = row_values(pose_difference(corrected.bank.mean, predicted.mean))
        square = (seen.innovation - moved) ** 2 + row_variances(corrected.bank.covariance)
        beta = beta_before + 0.5 * np.where(available, square, 0.0)
    return corrected, beta
