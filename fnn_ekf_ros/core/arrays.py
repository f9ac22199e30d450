"""Array types and the row layout of the measurement vector, shared by the whole core."""

from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

STATE_SIZE = 3


class Row(IntEnum):
    """Row of the measurement vector z = [x, y, compass yaw, laser yaw] (m, m, rad, rad)."""

    X = 0
    Y = 1
    COMPASS_YAW = 2
    LRF_YAW = 3


MEASUREMENT_SIZE = len(Row)


def transpose(matrix: FloatArray) -> FloatArray:
    """Return the matrices `(..., n, m)` transposed to `(..., m, n)`."""
    return np.swapaxes(matrix, -1, -2)


def symmetrize(matrix: FloatArray) -> FloatArray:
    """Return the mean of the matrices `(..., n, n)` and their transposes."""
    return 0.5 * (matrix + transpose(matrix))


def diagonal_matrix(diagonal: FloatArray) -> FloatArray:
    """Return matrices `(..., n, n)` with the entries `(..., n)` on their diagonals."""
    return np.asarray(diagonal[..., None] * np.eye(diagonal.shape[-1]), dtype=np.float64)
