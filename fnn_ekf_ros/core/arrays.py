"""Array types and the layout of state and measurement vectors, shared by the whole core.

Components come first, then the filters of a bank, then the batch: a mean is `(3, F, *batch)`, a
covariance `(3, 3, F, *batch)`. So an entry of all filters is one block of memory, and one numpy
call works on all of them.
"""

from collections.abc import Sequence
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
STATE_OF_ROW = (0, 1, 2, 2)
"""Which component of the state each row measures."""


def transpose(matrix: FloatArray) -> FloatArray:
    """Return the matrices `(n, m, ...)` transposed to `(m, n, ...)`."""
    return np.swapaxes(matrix, 0, 1)


def symmetrize(matrix: FloatArray) -> FloatArray:
    """Return the mean of the matrices `(n, n, ...)` and their transposes."""
    mean: FloatArray = 0.5 * (matrix + transpose(matrix))
    return mean


def diagonal_of(matrix: FloatArray) -> FloatArray:
    """Return the diagonals `(n, ...)` of matrices `(n, n, ...)`; a view."""
    diagonals: FloatArray = np.einsum("ii...->i...", matrix)
    return diagonals


def diagonal_matrix(diagonal: FloatArray) -> FloatArray:
    """Return matrices `(n, n, ...)` with the entries `(n, ...)` on their diagonals."""
    matrix = np.zeros((len(diagonal), *diagonal.shape))
    diagonal_of(matrix)[...] = diagonal
    return matrix


def against(values: Sequence[float] | FloatArray, array: FloatArray) -> FloatArray:
    """Return values `(n,)` with as many dimensions as an array `(n, ...)`, to go with it."""
    return np.reshape(values, (-1, *(1,) * (array.ndim - 1)))


class Constant:
    """Values `(n, ...)` that go with arrays which have filters and batch behind their components.

    Args:
        values: as an array of one robot's one filter would have them.
    """

    def __init__(self, values: Sequence[Any] | FloatArray) -> None:
        self._values: FloatArray = np.asarray(values, dtype=np.float64)
        self._shaped = {0: self._values}

    def behind(self, dimensions: int) -> FloatArray:
        """Return the values with so many dimensions of length 1 behind their own."""
        found = self._shaped.get(dimensions)
        if found is None:
            found = self._values.reshape(*self._values.shape, *(1,) * dimensions)
            self._shaped[dimensions] = found
        return found


def components_first(array: FloatArray, count: int = 1) -> FloatArray:
    """Return an array `(*batch, n)` (`count` 2: `(*batch, n, n)`) as `(n, *batch)`; a view."""
    axes = range(-count, 0)
    return np.moveaxis(array, tuple(axes), tuple(range(count)))


def components_last(array: FloatArray, count: int = 1) -> FloatArray:
    """Return an array `(n, *batch)` (`count` 2: `(n, n, *batch)`) as `(*batch, n)`; a view."""
    return np.moveaxis(array, tuple(range(count)), tuple(range(-count, 0)))


def select(where: BoolArray, one: Any, other: Any) -> Any:
    """Return one of two values for each robot of a batch.

    Args:
        where: `(*batch)` whether it is the first.
        one: an array `(n, F, *batch)`, None, or a NamedTuple of such values.
        other: of the same kind.
    """
    if one is None:
        return None
    if isinstance(one, tuple):
        parts = zip(one, other, strict=True)
        return type(one)(*(select(where, a, b) for a, b in parts))
    return np.where(where, one, other)
