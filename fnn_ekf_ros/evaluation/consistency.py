# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Whether a covariance is honest: mean NEES and NIS beside a band that knows of correlation.

Squares of errors that are whitened by the covariance have the mean 1 where it is honest. Their mean
over a run scatters as a chi-square variable over its degrees of freedom, but errors are alike from
one period to the next, so a run has fewer independent ones than poses. How many is found from the
errors' own correlation: where whitened errors are Gaussian with mean 0, their squares are
correlated by the square of what they are (Isserlis 1918), so that with rho_k of lag k

    n_independent = n / (1 + 2 sum rho_k^2),    k up to the first rho_k below 0.

The correlation is taken about 0, not about the mean: errors that keep their sign for the whole run
are one error, and the band is as wide as that of one.
"""

import math
from enum import StrEnum
from typing import NamedTuple

import numpy as np

from fnn_ekf_ros.core.arrays import FloatArray
from fnn_ekf_ros.evaluation.intervals import chi_square_band

FEW_INDEPENDENT = 10.0
"""Number of independent errors below which a verdict says that there are few: the band then spans a
factor of 2 and more."""

NEGLIGIBLE = 0.1
"""Part of a standard deviation by which a covariance may be off and is called honest still: a long
run tells smaller differences from 1, but nobody tunes for them."""


class Verdict(StrEnum):
    """What a covariance is."""

    HONEST = "honest"
    TOO_SURE = "too sure"
    TOO_CAUTIOUS = "too cautious"
    UNKNOWN = "not known"


class Consistency(NamedTuple):
    """Mean of whitened squares per degree of freedom, beside its band; 1 where all is honest.

    Attributes:
        ratio: the mean; NaN where it is not known.
        low: lower end of the 95 % band of honest covariances.
        high: its upper end.
        size: number of errors.
        independent: number of independent errors that they are worth.
        degrees_of_freedom: mean number of components of an error.
        verdict: what the covariance is.
    """

    ratio: float
    low: float
    high: float
    size: int
    independent: float
    degrees_of_freedom: float
    verdict: Verdict


NOT_KNOWN = Consistency(math.nan, math.nan, math.nan, 0, 0.0, 0.0, Verdict.UNKNOWN)
"""Consistency of nothing."""


def whitened(errors: FloatArray, covariance: FloatArray) -> FloatArray | None:
    """Return L^-1 e `(n, d)`, where L L' = P; None if a covariance is not positive definite.

    Args:
        errors: `(n, d)` e.
        covariance: `(n, d, d)` P.
    """
    if not np.all(np.isfinite(covariance)):
        return None
    with np.errstate(all="ignore"):
        try:
            found = np.linalg.solve(np.linalg.cholesky(covariance), errors[..., None])[..., 0]
        except np.linalg.LinAlgError:
            return None
        return found if np.isfinite(np.mean(found**2)) else None


def independent_errors(errors: FloatArray) -> float:
    """Return how many independent errors the squares of a series `(n, d)` are worth, 1 to n.

    For several components the mean of rho_k^2 is |C_k|^2 / |C_0|^2 (Frobenius), with
    C_k = sum_t z_t z_(t+k)' / n, and the sum ends where the trace of C_k first is below 0.
    """
    n = len(errors)
    if n < 2 or not np.any(errors):
        return float(n)
    products = _lagged_products(errors)
    squares = np.sum(products**2, axis=(1, 2))
    return _worth(squares / squares[0], _first_below_zero(np.einsum("kii->k", products)))


def independent_values(values: FloatArray) -> float:
    """Return how many independent values the mean of a series `(n,)` of mean 0 is worth, 1 to n.

    n / (1 + 2 sum rho_k), up to the first rho_k below 0.
    """
    n = len(values)
    if n < 2 or not np.any(values):
        return float(n)
    products = _lagged_products(values[:, None])[:, 0, 0]
    return _worth(products / products[0], _first_below_zero(products))


def _lagged_products(series: FloatArray) -> FloatArray:
    """Return sum_t z_t z_(t+k)' of a series `(n, d)` by lag k, `(n, d, d)`, up to a factor."""
    n = len(series)
    size = 1 << (2 * n - 1).bit_length()
    scaled = series / np.max(np.abs(series))  # far from overflow
    spectrum = np.fft.rfft(scaled, size, axis=0)
    products = np.conj(spectrum[:, :, None]) * spectrum[:, None, :]
    return np.asarray(np.fft.irfft(products, size, axis=0)[:n], dtype=np.float64)


def _first_below_zero(trace: FloatArray) -> int:
    """Return the first lag, from 1 on, at which a correlation is below 0; n if there is none."""
    below = np.flatnonzero(trace[1:] < 0.0)
    return 1 + int(below[0]) if len(below) else len(trace)


def _worth(correlation: FloatArray, end: int) -> float:
    """Return n / (1 + 2 sum of the correlations from lag 1 to before the end), 1 to n."""
    n = len(correlation)
    return float(min(max(n / (1.0 + 2.0 * float(np.sum(correlation[1:end]))), 1.0), n))


def consistency(errors: FloatArray) -> Consistency:
    """Judge whitened errors `(n, d)` of unit variance where the covariance is honest."""
    n, d = errors.shape
    if not n:
        return NOT_KNOWN
    return judged(float(np.mean(errors**2)), n, independent_errors(errors), float(d))


def judged(ratio: float, count: int, independent: float, degrees_of_freedom: float) -> Consistency:
    """Return a mean of whitened squares per degree of freedom with its band and the verdict.

    Args:
        ratio: the mean.
        count: number of errors.
        independent: number of independent ones.
        degrees_of_freedom: number of components of each.
    """
    low, high = (
        max(float(end), 0.0) for end in chi_square_band(np.array(independent * degrees_of_freedom))
    )
    verdict = Verdict.HONEST
    if ratio > max(high, (1.0 + NEGLIGIBLE) ** 2):
        verdict = Verdict.TOO_SURE
    elif ratio < min(low, (1.0 - NEGLIGIBLE) ** 2):
        verdict = Verdict.TOO_CAUTIOUS
    return Consistency(ratio, low, high, count, independent, degrees_of_freedom, verdict)


def nees_consistency(errors: FloatArray, covariance: FloatArray) -> Consistency:
    """Judge errors `(n, d)`, of which some may not be known (NaN), by covariances `(n, d, d)`."""
    known = np.all(np.isfinite(errors), axis=1)
    if not np.any(known):
        return NOT_KNOWN
    found = whitened(errors[known], covariance[known])
    return NOT_KNOWN if found is None else consistency(found)


def in_words(found: Consistency, whose: str = "errors", says: str = "it says") -> str:
    """Return the verdict as a clause, such as `too sure: errors are 2.3 times what it says`.

    The factor is of standard deviations, the root of the mean of squares.
    """
    if found.verdict is Verdict.UNKNOWN:
        return "not known"
    words = str(found.verdict)
    if found.verdict is not Verdict.HONEST:
        words += f": {whose} are {_factor(math.sqrt(found.ratio))} times what {says}"
    if found.independent < FEW_INDEPENDENT:
        words += f" (few independent {whose}: {found.independent:.0f})"
    return words


def _factor(value: float) -> str:
    """Return a factor with two or three digits and no exponent below a million."""
    if value >= 1e6 or value < 0.001:
        return f"{value:.1e}"
    return f"{value:.0f}" if value >= 100.0 else f"{value:.2g}"
