# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""A bank of filters with Bayesian weights: multiple model adaptive estimation, Magill (1965).

One extended Kalman filter for every pair of a scale of Q and a scale of R, each for itself; which
of them is right does not change with time. With the innovation r and its covariance S of each
filter, its weight goes with the likelihood of all it has seen so far,

    w <- w N(r; 0, S) / sum of the same over the bank

(IEEE Transactions on Automatic Control 10(4), pp. 434-439), and the bank's estimate is the
mixture's mean and covariance,

    x = sum w x_i,   P = sum w (P_i + (x_i - x)(x_i - x)')

The weight of a filter that is wrong falls exponentially and, where the noise changes, takes as
long to come back. A floor under the weights shortens that (Maybeck 1982, section 10.8).
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from fnn_ekf_ros.core.angles import wrap_angle
from fnn_ekf_ros.core.arrays import FloatArray
from fnn_ekf_ros.core.bank import (
    Bank,
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
    outer,
    period_scale,
    pose_difference,
)

NINE_SCALES = tuple(5.0 ** (half / 2.0) for half in range(-4, 5))
"""Factors on a variance, 1/25 to 25, evenly spaced in the logarithm."""


@dataclass(frozen=True, slots=True)
class MultipleModelSettings:
    """Settings of the bank.

    Attributes:
        process_scales: what the start's Q is multiplied by; each is paired with each of
        measurement_scales: what the start's R is multiplied by.
        smallest_weight: floor under every weight before they are made to sum to 1; 0 is none, and
            1 / number of filters too much. One part in a million costs nothing where the noise is
            constant, and the bank follows where it changes; 1e-3 costs 3 %.
    """

    process_scales: tuple[float, ...] = NINE_SCALES
    measurement_scales: tuple[float, ...] = NINE_SCALES
    smallest_weight: float = 1e-6

    def __post_init__(self) -> None:
        """Refuse banks that cannot be run."""
        scales = (*self.process_scales, *self.measurement_scales)
        if not self.process_scales or not self.measurement_scales or min(scales) <= 0.0:
            raise ValueError("a bank needs scales of Q and of R, all over 0")
        count = len(self.process_scales) * len(self.measurement_scales)
        if not 0.0 <= self.smallest_weight * count < 1.0:
            raise ValueError(f"{count} filters cannot each weigh {self.smallest_weight} or more")

    @property
    def numbers(self) -> int:
        """Number of floating-point numbers that the filter keeps of a robot."""
        return NUMBERS_OF_A_FILTER * len(self.process_scales) * len(self.measurement_scales)


def _filter(
    motion_model: MotionModel,
    settings: MultipleModelSettings,
    start: BlockStart,
    epochs: Iterator[Epoch],
) -> Iterator[StepEstimate]:
    """Take some robots over all steps."""
    one, noise_at_start = one_filter(start)
    noise = _bank_noise(noise_at_start, settings)
    Q = noise.process * period_scale(start)
    count = Q.shape[1]
    bank = Bank(*(np.repeat(part, count, axis=part.ndim - start.mean.ndim) for part in one))
    log_weight = np.full(Q.shape[1:], -np.log(count))
    for epoch in epochs:
        readings = Readings(epoch.measurement, epoch.available)
        predicted = predict(motion_model, bank, epoch.control, Q)
        seen = innovate(predicted, readings, noise.measurement)
        corrected = correct(predicted, seen, noise, epoch.available)

        weight = np.exp(log_weight)
        expected = mixture(weight, predicted)
        expected_noise = Noise(
            np.sum(weight * Q, axis=1, keepdims=True),
            np.sum(weight * noise.measurement, axis=1, keepdims=True),
        )
        # Mixing commutes with the linear H: this S is the mixture of the filters' S.
        seen = innovate(expected, readings, expected_noise.measurement)
        nis = correct(expected, seen, expected_noise, epoch.available).nis

        rows = np.sum(epoch.available, axis=0)
        likelihood = log_density(corrected.nis, corrected.determinant, rows)
        log_weight = _normalized(log_weight + likelihood, settings.smallest_weight)
        bank = wrapped(corrected.bank)
        yield estimate_of(mixture(np.exp(log_weight), bank), nis)


run = Rival(_filter)
"""The bank, for any recording and start; its scales are relative to the start's noise. The NIS is
that of the mixture's prediction."""


def log_density(nis: FloatArray, determinant: FloatArray, rows: FloatArray) -> FloatArray:
    """Return log N(r; 0, S), `(F, *batch)`; 0 where nothing was measured.

    Args:
        nis: `(F, *batch)` r' S^-1 r of the rows that were measured.
        determinant: `(F, *batch)` det S of these rows.
        rows: `(*batch)` how many these are.
    """
    density: FloatArray = -0.5 * (nis + np.log(determinant) + rows * math.log(2.0 * math.pi))
    return density


def mixture(weight: FloatArray, bank: Bank) -> Bank:
    """Return mean and covariance of a mixture of poses, as a bank of one filter.

    Args:
        weight: `(F, *batch)`, 1 in sum over the filters.
        bank: the F filters.
    """
    # Angles are averaged as differences from the likeliest filter's: pi and -pi are neighbors.
    likeliest = np.argmax(weight, axis=0)[None, None]
    reference = np.take_along_axis(bank.mean, likeliest, axis=1)
    from_reference = pose_difference(bank.mean, reference)
    x = reference + np.sum(weight * from_reference, axis=1, keepdims=True)
    x[2] = wrap_angle(x[2])
    spread = bank.covariance + outer(pose_difference(bank.mean, x))
    return Bank(x, np.sum(weight * spread, axis=2, keepdims=True))


def _bank_noise(start: Noise, settings: MultipleModelSettings) -> Noise:
    """Return the noise of the bank's filters, from that of one filter."""
    process, measurement = np.meshgrid(
        settings.process_scales, settings.measurement_scales, indexing="ij"
    )
    shape = (1, -1, *(1,) * (start.process.ndim - 2))
    return Noise(
        start.process * process.reshape(shape), start.measurement * measurement.reshape(shape)
    )


def _normalized(log_weight: FloatArray, smallest_weight: float) -> FloatArray:
    """Return the logarithms of weights `(F, *batch)` that sum to one and keep to the floor."""
    log_weight = log_weight - np.max(log_weight, axis=0)
    log_weight = log_weight - np.log(np.sum(np.exp(log_weight), axis=0))
    if smallest_weight == 0.0:
        return log_weight
    weight = np.maximum(np.exp(log_weight), smallest_weight)
    floored: FloatArray = np.log(weight / np.sum(weight, axis=0))
    return floored
