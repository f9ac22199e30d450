# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Fewer points that draw the same picture: extremes stay."""

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from fnn_ekf_ros.core.arrays import FloatArray

BUCKETS = 400
"""Number of parts of the time axis of each of which the extremes are drawn: about as many as a
curve has pixels on a phone."""
DOT_CELLS = 220
"""Number of cells along the longer side of a picture, each of which has one dot at most."""

SERIES_HEIGHT = 0.25
"""Height of a panel of dots over time in parts of its width."""


def extremes(*curves: FloatArray, buckets: int = BUCKETS) -> NDArray[np.intp]:
    """Return indices, in order, of the points of curves `(n,)` that have to be drawn.

    Of each bucket the first and the last point, and those where a curve is least and most. Around
    points that are not known (NaN) gaps stay gaps.
    """
    n = len(curves[0])
    if n <= 2 * (1 + len(curves)) * buckets:
        return np.arange(n)
    edges = np.linspace(0, n, buckets + 1).astype(np.intp)
    kept = {0, n - 1}
    for begin, end in pairwise(edges):
        kept |= {int(begin), int(end) - 1}
        for curve in curves:
            part = curve[begin:end]
            unknown = np.flatnonzero(np.isnan(part))
            if len(unknown):
                kept.add(int(begin + unknown[0]))
            if len(unknown) < len(part):
                kept |= {int(begin + np.nanargmin(part)), int(begin + np.nanargmax(part))}
    return np.array(sorted(kept))


def spread_dots(x: FloatArray, y: FloatArray) -> NDArray[np.intp]:
    """Return indices of dots, one for each cell of a grid over all of them; the extremes stay."""
    known = np.flatnonzero(np.isfinite(x) & np.isfinite(y))
    if len(known) <= DOT_CELLS:
        return known
    points = np.stack([x[known], y[known]], axis=1)
    low = np.min(points, axis=0)
    side = max(float(np.max(np.ptp(points, axis=0))), np.finfo(float).tiny)
    cells = np.floor((points - low) / side * DOT_CELLS).astype(np.int64)
    _, first = np.unique(cells[:, 0] * (2 * DOT_CELLS) + cells[:, 1], return_index=True)
    outermost = [int(np.argmin(v)) for v in points.T] + [int(np.argmax(v)) for v in points.T]
    kept: NDArray[np.intp] = known[np.unique([*first, *outermost])]
    return kept


def spread_series(x: FloatArray, y: FloatArray) -> NDArray[np.intp]:
    """Return the same for dots over time, whose two axes have different units."""
    known = np.flatnonzero(np.isfinite(x) & np.isfinite(y))
    if len(known) <= DOT_CELLS:
        return known
    scaled = []
    for values in (x[known], y[known]):
        size = max(float(np.ptp(values)), np.finfo(float).tiny)
        scaled.append((values - np.min(values)) / size)
    return known[spread_dots(scaled[0], SERIES_HEIGHT * scaled[1])]
