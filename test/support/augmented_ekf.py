# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The filter of seven states as a textbook prints it; used by the tests only.

    x, y, theta, b_x, b_y, b_g, b_0

Written from the equations: full matrices, Jacobians of the motion by central differences, S
inverted. One filter of one robot; angles are not wrapped.
"""

import math
from typing import NamedTuple

import numpy as np
from banks import Covariances

from fnn_ekf_ros.core.arrays import FloatArray
from fnn_ekf_ros.core.bank import Bank

SIZE = 7
H_FIX = np.array([[1.0, 0, 0, 1, 0, 0, 0], [0, 1, 0, 0, 1, 0, 0]])
"""Rows of a fix's x and y."""
H_YAW = np.array([[0.0, 0, 1, 0, 0, 1, 1]])
"""Row of a yaw that has lasting errors."""
H_PLAIN_YAW = np.array([[0.0, 0, 1, 0, 0, 0, 0]])
"""Row of a yaw that has none."""


class Gaussian(NamedTuple):
    """One filter: mean `(7,)` and covariance `(7, 7)`."""

    mean: FloatArray
    covariance: FloatArray


def moved(pose: FloatArray, u: FloatArray, *, paper_model: bool) -> FloatArray:
    """Return the pose `(3,)` after [dS, dtheta]; dtheta is not 0."""
    distance, rotation = float(u[0]), float(u[1])
    before, after = float(pose[2]), float(pose[2]) + rotation
    if paper_model:
        dx, dy = distance * math.cos(after), distance * math.sin(after)
    else:
        radius = distance / rotation
        dx = radius * (math.sin(after) - math.sin(before))
        dy = radius * (math.cos(before) - math.cos(after))
    return np.array([pose[0] + dx, pose[1] + dy, after])


def predicted(
    start: Gaussian, u: FloatArray, Q: FloatArray, kept: FloatArray, added: FloatArray,
    *, paper_model: bool,
) -> Gaussian:  # fmt: skip
    """Return the filter after a step; Q `(2,)`, phi and added variance of the errors `(4,)`."""
    h = 1e-6

    def f(x: FloatArray, w: FloatArray) -> FloatArray:
        return np.concatenate([moved(x[:3], u + w, paper_model=paper_model), kept * x[3:]])

    none = np.zeros(2)
    A = np.stack(
        [(f(start.mean + d, none) - f(start.mean - d, none)) / (2 * h) for d in h * np.eye(SIZE)],
        axis=1,
    )
    W = np.stack([(f(start.mean, d) - f(start.mean, -d)) / (2 * h) for d in h * np.eye(2)], axis=1)
    errors = np.diag(np.concatenate([np.zeros(3), added]))
    P = A @ start.covariance @ A.T + W @ np.diag(Q) @ W.T + errors
    return Gaussian(f(start.mean, none), P)


def corrected(start: Gaussian, H: FloatArray, r: FloatArray, R: FloatArray) -> Gaussian:
    """Return the filter after rows `(m, 7)` with innovation `(m,)` and noise `(m, m)`."""
    P = start.covariance
    K = P @ H.T @ np.linalg.inv(H @ P @ H.T + R)
    return Gaussian(start.mean + K @ r, P - K @ H @ P)


def random_bank(
    rng: np.random.Generator, random_covariances: Covariances, filters: int, batch: tuple[int, ...],
    errors: tuple[int, ...] = (3, 4, 5, 6),
) -> Bank:  # fmt: skip
    """Return filters whose covariances are singular but for the pose and some of the errors."""
    shape = (filters, *batch)
    mean = 0.3 * rng.standard_normal((SIZE, *shape))
    P = random_covariances(rng, math.prod(shape), SIZE).reshape(SIZE, SIZE, *shape)
    absent = [error for error in range(3, SIZE) if error not in errors]
    mean[absent], P[absent], P[:, absent] = 0.0, 0.0, 0.0
    return Bank(mean, P)


def of_filter(bank: Bank, *index: int) -> Gaussian:
    """Return one filter of one robot."""
    place = (slice(None), *index)
    return Gaussian(bank.mean[place], bank.covariance[(slice(None), *place)])


def assert_semidefinite(covariance: FloatArray, tolerance: float = 1e-11) -> None:
    """Exactly symmetric, no negative eigenvalue of the correlations; 0 where there is no error."""
    assert np.all(np.isfinite(covariance))
    assert covariance.tobytes() == np.swapaxes(covariance, 0, 1).tobytes()
    last = np.moveaxis(covariance, (0, 1), (-2, -1))
    variance = np.diagonal(last, axis1=-2, axis2=-1)
    assert np.all(variance >= 0.0)
    std = np.sqrt(np.where(variance > 0.0, variance, 1.0))
    eigenvalues = np.linalg.eigvalsh(last / (std[..., :, None] * std[..., None, :]))
    assert eigenvalues.min() > -tolerance
