# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Array types and the layout of state and measurement vectors, shared by the whole core.

Components come first, then the filters of a bank, then the batch: a mean is `(3, F, *batch)`, a
covariance `(3, 3, F, *batch)`. One entry of all filters is one block of memory, and one numpy call
works on all filters.
"""

from collections.abc import Sequence
from enum import IntEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
"""Array of double precision numbers."""
BoolArray = NDArray[np.bool_]
"""Array of truth values."""

STATE_SIZE = 3
"""Components of the state x = [x, y, theta] (m, m, rad)."""


class Row(IntEnum):
    """Row of the measurement vector z = [x, y, compass yaw, laser yaw] (m, m, rad, rad)."""

    X = 0
    Y = 1
    COMPASS_YAW = 2
    LRF_YAW = 3


MEASUREMENT_SIZE = len(Row)
"""Rows of the measurement vector."""
STATE_OF_ROW = (0, 1, 2, 2)
"""Index of the state's component that each row measures."""
STATES_OF_ROWS = np.array(STATE_OF_ROW)
"""The same, to index arrays with: `mean[STATES_OF_ROWS]` is what all rows measure."""


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


def against(values: Sequence[float] | FloatArray, array: FloatArray) -> FloatArray:
    """Return values `(n,)` in a shape that broadcasts against an array `(n, ...)`."""
    return np.reshape(values, (-1, *(1,) * (array.ndim - 1)))


class Constant:
    """Values `(n, ...)` that broadcast against arrays with filters and batch dimensions.

    Args:
        values: one for each component, without the dimensions of filters and batch.
    """

    def __init__(self, values: Sequence[Any] | FloatArray) -> None:
        self._values: FloatArray = np.asarray(values, dtype=np.float64)
        self._shaped = {0: self._values}

    def behind(self, dimensions: int) -> FloatArray:
        """Return the values with a number of dimensions of length 1 appended."""
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
        where: `(*batch)` whether to take the first.
        one: the first, an array `(n, F, *batch)`, None, or a NamedTuple of such values.
        other: the second, of the same kind.
    """
    if one is None:
        return None
    if isinstance(one, tuple):
        parts = zip(one, other, strict=True)
        return type(one)(*(select(where, a, b) for a, b in parts))
    return np.where(where, one, other)
