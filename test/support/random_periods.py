# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Periods of a robot near START with any rows, instants and reported covariances."""

import numpy as np

from fnn_ekf_ros.core.arrays import FloatArray
from fnn_ekf_ros.core.results import Epoch


def random_covariance(rng: np.random.Generator, size: float = 0.1) -> FloatArray:
    """Return a `(3, 3)` covariance of the rows of a fix."""
    root = size * rng.standard_normal((3, 3))
    return root @ root.T + 0.01 * np.eye(3)


def random_epoch(rng: np.random.Generator, batch: tuple[int, ...], duration_s: float) -> Epoch:
    """Return an epoch of robots near START, with any of the rows and a reported covariance."""
    size, few = duration_s / 0.375, (-1, *(1,) * len(batch))
    low, high = (np.reshape(limit, few) for limit in ([-0.1, 0.02], [0.2, 0.3]))
    reported = [random_covariance(rng) for _ in np.ndindex(*batch)]
    return Epoch(
        control=size * rng.uniform(low, high, (2, *batch)),
        duration_s=duration_s,
        measurement=rng.normal(np.reshape([1.0, 2.0, 0.5, 0.5], few), 0.3, (4, *batch)),
        available=rng.random((4, *batch)) < 0.6,
        fix_covariance=np.moveaxis(np.array(reported), 0, -1).reshape(3, 3, *batch),
    )


def random_periods(
    rng: np.random.Generator, steps: int, batch: tuple[int, ...] = (), most: int = 3
) -> list[list[Epoch]]:
    """Periods of one epoch to `most`."""
    periods = []
    for _ in range(steps):
        inside = np.sort(rng.uniform(0.0, 0.375, rng.integers(0, most)))
        durations = np.diff(inside, prepend=0.0, append=0.375).tolist()
        periods.append([random_epoch(rng, batch, duration_s) for duration_s in durations])
    return periods


def one_epoch(
    control: FloatArray,
    z: FloatArray,
    rows: FloatArray,
    fix_covariance: FloatArray | None = None,
    duration_s: float = 0.375,
) -> list[Epoch]:
    """Return a period with readings at its end only."""
    return [Epoch(control, duration_s, z, rows.astype(np.bool_), fix_covariance)]
