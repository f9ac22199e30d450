# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Checks and limits of covariances."""

import numpy as np

from fnn_ekf_ros.core.arrays import STATE_SIZE, Constant, FloatArray, diagonal_of, symmetrize
from fnn_ekf_ros.core.limits import (
    CORRELATION_MARGIN,
    LARGEST_POSE_STD,
    LARGEST_STD,
    SMALLEST_CORRELATION_EIGENVALUE,
    SMALLEST_STD,
)

_ASYMMETRY = 1e-6
"""Largest difference of two mirrored entries of a correlation: more than rounding leaves."""
_LARGEST = Constant(LARGEST_POSE_STD)
"""Largest standard deviations of a pose (m, m, rad)."""
_VAGUE = Constant([(0.1 * std) ** 2 for std in LARGEST_POSE_STD])
"""Variances from which on `limit_uncertainty` acts (m^2, m^2, rad^2)."""


def usable_covariance(matrix: FloatArray) -> FloatArray | None:
    """Return a covariance `(n, n)` from outside, made exactly symmetric; None if it is invalid.

    It must be finite, symmetric except for rounding, with standard deviations from `SMALLEST_STD`
    to `LARGEST_STD`, and positive definite by a margin that does not depend on units.
    """
    variances = np.diagonal(matrix)
    # No entry may exceed the largest variance; larger ones would make the division overflow.
    if not np.all(np.abs(matrix) <= LARGEST_STD**2) or not np.all(variances >= SMALLEST_STD**2):
        return None
    std = np.sqrt(variances)
    correlation = matrix / std[:, None] / std[None, :]
    if np.max(np.abs(correlation - correlation.T)) > _ASYMMETRY:
        return None
    if np.linalg.eigvalsh(symmetrize(correlation))[0] < SMALLEST_CORRELATION_EIGENVALUE:
        return None
    return symmetrize(matrix)


def limit_uncertainty(covariance: FloatArray) -> FloatArray:
    """Return covariances `(3, 3, ...)` reduced to standard deviations of `LARGEST_POSE_STD`.

    With larger ones, a fix with a standard deviation of 0.1 mm would not leave a positive definite
    covariance in double precision. Correlations are kept; from a tenth of `LARGEST_POSE_STD` on
    they are reduced by `CORRELATION_MARGIN`.
    """
    size = STATE_SIZE
    variances = covariance.reshape(size * size, *covariance.shape[2:])[:: size + 1]
    if not (variances > _VAGUE.behind(variances.ndim - 1)).any():
        return covariance
    largest = _LARGEST.behind(variances.ndim - 1)
    std = np.sqrt(variances)
    vague = np.any(std > 0.1 * largest, axis=0)
    scale = np.minimum(1.0, largest / std)
    limited = covariance * (scale[:, None] * scale[None])  # in this order: exactly symmetric
    apart = (1.0 - CORRELATION_MARGIN) * limited
    diagonal_of(apart)[...] += CORRELATION_MARGIN * diagonal_of(limited)
    return np.where(vague, apart, covariance)
