# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Closed paths for the simulated robot, as points at even distances."""

from typing import NamedTuple

import numpy as np

from fnn_ekf_ros.core.arrays import FloatArray

SPACING = 0.02
"""Distance between two points of a path [m], short beside the lookahead of the driver."""


class Path(NamedTuple):
    """A closed path.

    Attributes:
        points: `(n, 2)` in the map frame [m], `SPACING` apart; the first follows the last.
    """

    points: FloatArray

    def at(self, progress: FloatArray) -> FloatArray:
        """Return the points `(..., 2)` [m] at distances `(...)` [m] along the path, in any lap."""
        return self.points[np.asarray(progress / SPACING, dtype=np.int64) % len(self.points)]

    def start(self) -> FloatArray:
        """Return the pose `(3,)` at the path's begin, looking along it (m, m, rad)."""
        step = self.points[1] - self.points[0]
        return np.array([*self.points[0], np.arctan2(step[1], step[0])])


def scripted_path(name: str) -> Path:
    """Return a path by the name of the fake robot's `path` parameter.

    `square` has 3 m sides. `round` is the paper's experiment, a round trip with corners: a
    6 m x 4 m court with one corner cut and one notch. `figure_eight` crosses itself. `sim1` and
    `sim2` share one winding loop of about 25 m; they differ in slip.
    """
    angle = np.linspace(0.0, 2.0 * np.pi, 4000, endpoint=False)
    if name == "square":
        corners = np.array([[0, 0], [3, 0], [3, 3], [0, 3]], dtype=np.float64)
    elif name == "round":
        corners = np.array(
            [[0, 0], [6, 0], [6, 2.5], [4.5, 4], [3, 4], [3, 3], [1.5, 3], [1.5, 4], [0, 4]],
            dtype=np.float64,
        )
    elif name == "figure_eight":
        corners = np.stack([3.0 * np.sin(angle), 1.5 * np.sin(2.0 * angle)], axis=-1)
    elif name in ("sim1", "sim2"):
        radius = 3.5 + 0.9 * np.cos(3.0 * angle)
        corners = radius[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    else:
        raise ValueError(f"path '{name}': expected square, round, figure_eight, sim1 or sim2")
    return Path(_evenly(corners))


def _evenly(corners: FloatArray) -> FloatArray:
    closed = np.concatenate([corners, corners[:1]])
    distances = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(closed, axis=0), axis=1))])
    even = np.linspace(0.0, distances[-1], round(distances[-1] / SPACING), endpoint=False)
    return np.stack([np.interp(even, distances, closed[:, axis]) for axis in (0, 1)], axis=-1)
