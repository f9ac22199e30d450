# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Thinned curves and dots keep their extremes and their gaps."""

from itertools import pairwise

import numpy as np

from fnn_ekf_ros.reports.thinning import BUCKETS, DOT_CELLS, extremes, spread_dots, spread_series


def test_the_extremes_of_every_part_stay() -> None:
    values = np.random.default_rng(1).standard_normal(50000)
    values[31234], values[777] = 90.0, -80.0
    kept = extremes(values)
    assert {0, 777, 31234, 49999} <= set(kept.tolist())
    assert len(kept) <= 4 * BUCKETS + 2
    assert np.all(np.diff(kept) > 0)
    edges = np.linspace(0, 50000, BUCKETS + 1).astype(int)
    for begin, end in pairwise(edges):
        inside = values[kept[(kept >= begin) & (kept < end)]]
        part = values[begin:end]
        assert (inside.min(), inside.max()) == (part.min(), part.max())


def test_short_curves_are_drawn_whole_and_gaps_stay_gaps() -> None:
    assert extremes(np.arange(100.0)).tolist() == list(range(100))
    values = np.ones(50000)
    values[20000:20050] = np.nan
    assert np.any(np.isnan(values[extremes(values)]))
    assert len(extremes(np.full(50000, np.nan)))


def test_dots_are_one_a_cell_and_the_outermost_stay() -> None:
    points = np.random.default_rng(2).random((300000, 2))
    points[12345] = (7.0, -3.0)
    kept = spread_dots(*points.T)
    assert 12345 in kept
    assert len(kept) <= (DOT_CELLS + 1) ** 2
    assert len(spread_series(np.arange(300000.0), points[:, 0] * 1e-6)) < 0.3 * DOT_CELLS**2
    assert spread_dots(np.array([1.0, np.nan]), np.array([2.0, 2.0])).tolist() == [0]
