# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The window of the last N innovations and its mean square (Nguyen et al., eq. 13)."""

from typing import NamedTuple

import numpy as np

from fnn_ekf_ros.core.arrays import MEASUREMENT_SIZE, BoolArray, FloatArray


class InnovationWindow(NamedTuple):
    """Squares of the last N innovations of each row.

    Attributes:
        squares: `(N, 4, *batch)` squared innovations (m^2, m^2, rad^2, rad^2), newest last.
        counts: `(4, *batch)` number of innovations in the window.
    """

    squares: FloatArray
    counts: FloatArray


def empty_window(length: int, batch: tuple[int, ...] = ()) -> InnovationWindow:
    """Return an empty window for the last `length` innovations."""
    return InnovationWindow(
        np.zeros((length, MEASUREMENT_SIZE, *batch)), np.zeros((MEASUREMENT_SIZE, *batch))
    )


def push(
    window: InnovationWindow, innovation: FloatArray, available: BoolArray
) -> InnovationWindow:
    """Return the window with one more innovation in the measured rows.

    Args:
        window: the window so far; not changed.
        innovation: `(4, *batch)` r (m, m, rad, rad).
        available: `(4, *batch)` which rows were measured; the others are unchanged.
    """
    length = len(window.squares)
    shifted = np.concatenate([window.squares[1:], (innovation * innovation)[None]])
    return InnovationWindow(
        np.where(available, shifted, window.squares),
        np.minimum(window.counts + available, float(length)),
    )


def mean_square(window: InnovationWindow) -> FloatArray:
    """Return the diagonal of C_hat, `(4, *batch)` (m^2, m^2, rad^2, rad^2); 0 for an empty row."""
    total: FloatArray = window.squares.sum(axis=0)
    return total / np.maximum(window.counts, 1.0)
