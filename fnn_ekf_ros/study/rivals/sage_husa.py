# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Q and R as averages that fade: Sage and Husa (1969), with a fading factor b as usual since.

Noise means are zero. For the k-th innovation r, with d = (1 - b) / (1 - b^(k+1)),

    R <- (1 - d) R + d (r r' - H P- H')
    Q <- (1 - d) Q + d (K r r' K' + P - A P A')

(Joint Automatic Control Conference, pp. 760-769.) Both samples can be negative, and so can their
averages, which no filter survives. The usual positive forms are taken instead,

    R <- (1 - d) R + d (e e' + H P H'),   e = z - H x       the same mean in a well-tuned filter
    Q <- (1 - d) Q + d K r r' K'                            the same mean in a steady state

Only diagonals are adapted; Q is that of W Q W'. With R left as it is, neither form of Q recovers
from an R that is far too large or small, and both together settle on a pair of Q and R that need
not be the true one: that is the method's nature.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from fnn_ekf_ros.core.arrays import FloatArray
from fnn_ekf_ros.core.bank import Noise
from fnn_ekf_ros.core.motion import MotionModel
from fnn_ekf_ros.core.results import Epoch
from fnn_ekf_ros.study.blocks import NUMBERS_OF_A_FILTER, BlockStart, StepEstimate
from fnn_ekf_ros.study.rivals.shared import (
    Rival,
    ekf_step,
    estimate_of,
    one_filter,
    outer,
    period_scale,
    pose_difference,
    row_values,
    row_variances,
    shows_wheel_noise,
    wheel_noise,
    within_limits,
)


@dataclass(frozen=True, slots=True)
class SageHusaSettings:
    """Settings of the Sage-Husa filter.

    Attributes:
        fading: b, over 0 and under 1; 1 / (1 - b) innovations are remembered. 0.93 to 0.98 differ
            little, longer memories carry the feedback of Q on itself for longer.
    """

    fading: float = 0.95

    def __post_init__(self) -> None:
        """Refuse what the method is not defined for."""
        if not 0.0 < self.fading < 1.0:
            raise ValueError(f"fading is over 0 and under 1, not {self.fading}")

    @property
    def numbers(self) -> int:
        """Number of floating-point numbers that the filter keeps of a robot."""
        return NUMBERS_OF_A_FILTER


def _filter(
    motion_model: MotionModel,
    settings: SageHusaSettings,
    start: BlockStart,
    epochs: Iterator[Epoch],
) -> Iterator[StepEstimate]:
    """Take some robots over all steps."""
    bank, (Q, R, _) = one_filter(start)
    scale = period_scale(start)
    Q_count, R_count = np.zeros(Q.shape), np.zeros(R.shape)
    for epoch in epochs:
        predicted, innovation, available, bank, nis = ekf_step(
            motion_model, bank, Noise(Q, R), scale, epoch
        )
        yield estimate_of(bank, nis)

        Kr = pose_difference(bank.mean, predicted.bank.mean)
        e = innovation - row_values(Kr)
        R_count = R_count + available
        d = np.where(available, _share(settings.fading, R_count), 0.0)
        R = within_limits((1.0 - d) * R + d * (e * e + row_variances(bank.covariance)))
        shown = shows_wheel_noise(available)
        Q_count = Q_count + shown
        d = np.where(shown, _share(settings.fading, Q_count), 0.0)
        sample = wheel_noise(predicted.motion, outer(Kr)) / scale
        Q = within_limits((1.0 - d) * Q + d * sample)


run = Rival(_filter)
"""The Sage-Husa filter, for any recording and start."""


def _share(fading: float, count: FloatArray) -> FloatArray:
    """Return d, the share of the k-th sample in the average; the start counts as one, k = 0."""
    share: FloatArray = (1.0 - fading) / (1.0 - fading ** (count + 1.0))
    return share
