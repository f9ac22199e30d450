# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Matrices of a step of the wheels that the filter itself never builds."""

import numpy as np

from fnn_ekf_ros.core.arrays import FloatArray, diagonal_of
from fnn_ekf_ros.core.motion import Motion


def motion_jacobian(motion: Motion) -> FloatArray:
    """Return A = df/dx, `(3, 3, ...)`."""
    A = np.zeros((3, *motion.mean.shape))
    diagonal_of(A)[...] = 1.0
    A[:2, 2] = motion.by_heading
    return A


def diagonal_matrix(diagonal: FloatArray) -> FloatArray:
    """Return matrices `(n, n, ...)` with the entries `(n, ...)` on their diagonals."""
    matrix = np.zeros((len(diagonal), *diagonal.shape))
    diagonal_of(matrix)[...] = diagonal
    return matrix
