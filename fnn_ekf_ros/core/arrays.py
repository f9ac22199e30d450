"""Array types and the row layout of the measurement vector, shared by the whole core."""

from enum import IntEnum
from typing import Any

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


def select(where: BoolArray, one: Any, other: Any) -> Any:
    """Return one of two values for each filter of a batch.

    Args:
        where: `(...)` whether it is the first.
        one: an array `(..., n, m)`, None, or a NamedTuple of such values.
        other: of the same kind.
    """
    if one is None:
        return None
    if isinstance(one, tuple):
        parts = zip(one, other, strict=True)
        return type(one)(*(select(where, a, b) for a, b in parts))
    inner = np.ndim(one) - np.ndim(where)
    return np.where(np.reshape(where, (*np.shape(where), *(1,) * inner)), one, other)
