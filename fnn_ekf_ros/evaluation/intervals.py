# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Quantiles and intervals; numpy and the normal distribution are all that is needed."""

from statistics import NormalDist
from typing import NamedTuple

import numpy as np

from fnn_ekf_ros.core.arrays import FloatArray

CONFIDENCE = 0.95
"""Confidence level of all intervals."""
CONFIDENCE_Z = NormalDist().inv_cdf(0.5 + 0.5 * CONFIDENCE)
"""Quantile of the normal distribution at that level."""


class Interval(NamedTuple):
    """An estimate with its 95 % confidence interval; NaN ends where it is not known.

    Attributes:
        value: `(...)` the estimate.
        low: `(...)` lower end.
        high: `(...)` upper end.
    """

    value: FloatArray
    low: FloatArray
    high: FloatArray


def student_t(degrees_of_freedom: int) -> float:
    """Return the two-sided 95 % quantile of Student's t; within 0.5 % from 3 degrees on.

    Cornish and Fisher's expansion in 1/nu (Abramowitz and Stegun 1964, eq. 26.7.5).
    """
    z, nu = CONFIDENCE_Z, float(degrees_of_freedom)
    terms = (
        z,
        (z**3 + z) / 4.0,
        (5.0 * z**5 + 16.0 * z**3 + 3.0 * z) / 96.0,
        (3.0 * z**7 + 19.0 * z**5 + 17.0 * z**3 - 15.0 * z) / 384.0,
        (79.0 * z**9 + 776.0 * z**7 + 1482.0 * z**5 - 1920.0 * z**3 - 945.0 * z) / 92160.0,
    )
    return sum(term / nu**power for power, term in enumerate(terms))


def chi_square_band(degrees_of_freedom: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the 2.5 % and 97.5 % quantiles of chi-square divided by its degrees of freedom.

    Wilson and Hilferty 1931: (chi^2 / nu)^(1/3) is nearly N(1 - 2 / (9 nu), 2 / (9 nu)); within
    0.2 % from 50 degrees of freedom on.
    """
    spread = 2.0 / (9.0 * degrees_of_freedom)
    low, high = ((1.0 - spread + side * CONFIDENCE_Z * spread**0.5) ** 3 for side in (-1.0, 1.0))
    return low, high


def mean_interval(samples: FloatArray) -> Interval:
    """Return the mean over the last axis, independent samples `(..., n)`, by Student's t."""
    n = samples.shape[-1]
    mean = np.mean(samples, axis=-1)
    if n < 2:
        return Interval(value=mean, low=np.full_like(mean, np.nan), high=np.full_like(mean, np.nan))
    half = student_t(n - 1) * np.std(samples, axis=-1, ddof=1) / n**0.5
    return Interval(value=mean, low=mean - half, high=mean + half)


def root_ratio_interval(above: FloatArray, below: FloatArray) -> Interval:
    """Return sqrt(mean a / mean b) over the last axis, pairs `(..., n)` of positive numbers.

    Delta method on the logarithm, pair by pair, so that what both have in common cancels:
    var(log ratio) = var(a / mean a - b / mean b) / (4 n).
    """
    n = above.shape[-1]
    mean_a, mean_b = (np.mean(s, axis=-1, keepdims=True) for s in (above, below))
    ratio = np.sqrt(mean_a / mean_b)[..., 0]
    if n < 2:
        return Interval(
            value=ratio, low=np.full_like(ratio, np.nan), high=np.full_like(ratio, np.nan)
        )
    spread = np.std(above / mean_a - below / mean_b, axis=-1, ddof=1)
    factor = np.exp(student_t(n - 1) * 0.5 * spread / n**0.5)
    return Interval(value=ratio, low=ratio / factor, high=ratio * factor)
