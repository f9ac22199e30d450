# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Q and R from the last innovations: IAE, Mohamed and Schwarz (1999).

With C_hat the mean of r r' over the last N innovations r = z - H x-,

    R = C_hat - H P- H'
    Q = K C_hat K'                  in a steady state; here Q of W Q W'

(Journal of Geodesy 73(4), pp. 193-203.) R as a difference can be negative and is then held at a
share of C_hat. Only diagonals are adapted. R + H P- H' = C_hat whatever Q is: the pair on which the
filter settles need not be the true one. R alone would be as good as the EKF where Q is right, but
cannot correct a wrong Q.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from fnn_ekf_ros.core.arrays import (
    MEASUREMENT_SIZE,
    STATES_OF_ROWS,
    BoolArray,
    FloatArray,
    diagonal_of,
    transpose,
)
from fnn_ekf_ros.core.bank import Noise
from fnn_ekf_ros.core.motion import MotionModel
from fnn_ekf_ros.core.results import Epoch
from fnn_ekf_ros.study.blocks import NUMBERS_OF_A_FILTER, BlockStart, StepEstimate
from fnn_ekf_ros.study.rivals.shared import (
    Rival,
    ekf_step,
    estimate_of,
    matmul,
    one_filter,
    period_scale,
    row_variances,
    shows_wheel_noise,
    wheel_noise,
    within_limits,
)


@dataclass(frozen=True, slots=True)
class InnovationBasedSettings:
    """Settings of the IAE filter.

    Attributes:
        window_length: N; with fewer Q and R chase each other's noise, with more nothing is gained
            and a wrong start is remembered for longer.
        first_use: how many innovations a row has before it teaches, 1 to `window_length`; waiting
            for a full window costs more than the noise of a short one.
        smallest_share: R is at least this share of C_hat, over 0 and up to 1; a small share lets
            the filter follow every measurement for as long as Q is too large.
    """

    window_length: int = 200
    first_use: int = 10
    smallest_share: float = 0.2

    def __post_init__(self) -> None:
        """Refuse windows that never teach and a floor that is none."""
        if not 1 <= self.first_use <= self.window_length:
            raise ValueError(
                f"first_use is 1 to window_length ({self.window_length}), not {self.first_use}"
            )
        if not 0.0 < self.smallest_share <= 1.0:
            raise ValueError(f"smallest_share is over 0 and at most 1, not {self.smallest_share}")

    @property
    def numbers(self) -> int:
        """Number of floating-point numbers that the filter keeps of a robot."""
        return NUMBERS_OF_A_FILTER + MEASUREMENT_SIZE * self.window_length


class _Window(NamedTuple):
    """Each row's own last N innovations.

    Attributes:
        innovations: `(N, 4, 1, *batch)`, newest last, 0 where not filled.
        counts: `(4, 1, *batch)` how many are filled.
    """

    innovations: FloatArray
    counts: FloatArray


def _filter(
    motion_model: MotionModel,
    settings: InnovationBasedSettings,
    start: BlockStart,
    epochs: Iterator[Epoch],
) -> Iterator[StepEstimate]:
    """Take some robots over all steps."""
    bank, (Q, R, _) = one_filter(start)
    scale = period_scale(start)
    window = _Window(np.zeros((settings.window_length, *R.shape)), np.zeros(R.shape))
    for epoch in epochs:
        predicted, innovation, available, bank, nis = ekf_step(
            motion_model, bank, Noise(Q, R), scale, epoch
        )
        yield estimate_of(bank, nis)

        window = _push(window, innovation, available)
        C = _innovation_covariance(window)
        teaches = available & (window.counts >= settings.first_use)
        K = _gain(bank.covariance, R, available)  # this step's, before R changes
        state_noise = matmul(matmul(K, C), transpose(K))
        sample = wheel_noise(predicted.motion, state_noise) / scale
        Q = np.where(shows_wheel_noise(teaches), within_limits(sample), Q)
        variance = diagonal_of(C)
        sample = np.maximum(
            variance - row_variances(predicted.bank.covariance),
            settings.smallest_share * variance,
        )
        R = np.where(teaches, within_limits(sample), R)


run = Rival(_filter)
"""The IAE filter, for any recording and start."""


def _push(window: _Window, innovation: FloatArray, available: BoolArray) -> _Window:
    """Return the window with one more innovation in the rows that have one."""
    shifted = np.concatenate([window.innovations[1:], innovation[None]])
    length = float(len(window.innovations))
    return _Window(
        np.where(available, shifted, window.innovations),
        np.minimum(window.counts + available, length),
    )


def _innovation_covariance(window: _Window) -> FloatArray:
    """Return C_hat, `(4, 4, 1, *batch)`: positive semidefinite however the rows are filled."""
    r, root = window.innovations, np.sqrt(np.maximum(window.counts, 1.0))
    C: FloatArray = np.einsum("ni...,nj...->ij...", r, r) / (root[:, None] * root[None])
    return C


def _gain(
    covariance: FloatArray, measurement_noise: FloatArray, available: BoolArray
) -> FloatArray:
    """Return K = P H' R^-1, `(3, 4, 1, *batch)`; columns of rows not measured are 0."""
    K: FloatArray = covariance[:, STATES_OF_ROWS] * (available / measurement_noise)
    return K
