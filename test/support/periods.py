# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Starts and periods of filters for tests, and all bits of what comes of them."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from fnn_ekf_ros.core.results import Epoch

MODES = ("none", "r", "q", "rq", "joint")
START = np.array([1.0, 2.0, 0.5])
START_COVARIANCE = np.array([[0.04, 0.01, 0.0], [0.01, 0.05, 0.002], [0.0, 0.002, 0.01]])
ALL_ROWS = np.ones(4, dtype=np.bool_)
NO_ROWS = np.zeros(4, dtype=np.bool_)
FIX = np.array([True, True, False, False])
ONLY_COMPASS = np.array([False, False, True, False])
FIX_AND_COMPASS = np.array([True, True, True, False])


def arrays_of(*values: Sequence[Any]) -> list[np.ndarray[Any, Any]]:
    found: list[np.ndarray[Any, Any]] = []
    for value in values:
        for part in value:
            if isinstance(part, tuple):
                found += arrays_of(part)
            elif isinstance(part, np.ndarray | np.generic):
                found.append(np.asarray(part))
    return found


def bytes_of(*values: Sequence[Any]) -> list[bytes]:
    return [array.tobytes() for array in arrays_of(*values)]


def one_of_batch(value: Any, index: tuple[int, ...]) -> Any:
    """Return the tuple of arrays with the batch dimensions taken away."""
    parts = [
        one_of_batch(part, index) if isinstance(part, tuple) else
        part[..., *index] if isinstance(part, np.ndarray) else part
        for part in value
    ]  # fmt: skip
    return type(value)(*parts)


def wild_epochs(
    rng: np.random.Generator, count: int, batch: tuple[int, ...] = (), most_s: float = 0.3
) -> list[Epoch]:
    """Epochs of a robot near START with any rows, outliers that agree, instants that coincide."""
    few, epochs = (-1, *(1,) * len(batch)), []
    for _ in range(count):
        duration_s = float(rng.choice([0.0, rng.uniform(0.0, most_s)]))
        low, high = (duration_s * np.reshape(limit, few) for limit in ([-0.2, 0.1], [0.5, 0.8]))
        z = rng.normal(np.reshape([1.0, 2.0, 0.5, 0.5], few), 0.3, (4, *batch))
        z[:2] += np.where(rng.random(batch) < 0.3, 20.0, 0.0)
        root = 0.1 * rng.standard_normal((3, 3, *batch))
        reported = np.einsum("ik...,jk...->ij...", root, root)
        reported += 0.01 * np.eye(3).reshape(3, 3, *(1,) * len(batch))
        epochs.append(
            Epoch(
                rng.uniform(low, high, (2, *batch)),
                duration_s,
                z,
                rng.random((4, *batch)) < rng.choice([0.0, 0.5, 1.0]),
                reported if rng.random() < 0.3 else None,
            )
        )
    return epochs
