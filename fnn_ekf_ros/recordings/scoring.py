# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Errors of an estimated track against a true one."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fnn_ekf_ros.core.angles import wrap_angle
from fnn_ekf_ros.core.arrays import FloatArray

LONGEST_TRUTH_GAP_S = 2.0
"""Longest gap of the ground truth that is interpolated across [s]: a robot at 0.3 m/s drives 0.6 m
in it, and may have turned."""


@dataclass(frozen=True, slots=True)
class Trajectory:
    """Poses over time.

    Attributes:
        time_ns: `(n,)` increasing [ns].
        pose: `(n, 3)` [x, y, yaw] (m, m, rad); NaN yaw where it is not known.
        covariance: `(n, 3, 3)`; zeros where it is not known.
    """

    time_ns: NDArray[np.int64]
    pose: FloatArray
    covariance: FloatArray


@dataclass(frozen=True, slots=True)
class Score:
    """Errors of an estimated trajectory against the truth.

    Attributes:
        count: number of poses compared.
        rmse_x: root mean square error along the map's x [m].
        rmse_y: along its y [m].
        rmse_theta: of the yaw [rad]; NaN if truth has none.
        rmse_position: of the distance [m].
        mean_nees: mean of e' P^-1 e; NaN if truth has no yaw or a covariance is not positive
            definite. Its expectation is 3.
    """

    count: int
    rmse_x: float
    rmse_y: float
    rmse_theta: float
    rmse_position: float
    mean_nees: float


def pose_errors(estimate: FloatArray, truth: FloatArray) -> FloatArray:
    """Return poses `(..., 3)` less true ones, the yaw wrapped (m, m, rad)."""
    error: FloatArray = estimate - truth
    error[..., 2] = wrap_angle(error[..., 2])
    return error


def interpolate(truth: Trajectory, time_ns: NDArray[np.int64]) -> FloatArray:
    """Return the true poses `(n, 3)` at times [ns]; NaN outside of the track and in its gaps."""
    after = np.clip(np.searchsorted(truth.time_ns, time_ns), 1, len(truth.time_ns) - 1)
    before = after - 1
    gap_ns = truth.time_ns[after] - truth.time_ns[before]
    part = (time_ns - truth.time_ns[before]) / gap_ns
    change = pose_errors(truth.pose[after], truth.pose[before])
    pose: FloatArray = truth.pose[before] + part[:, None] * change
    outside = (part < 0.0) | (part > 1.0) | (gap_ns > LONGEST_TRUTH_GAP_S * 1e9)
    pose[outside] = math.nan
    return pose


def score(estimate: Trajectory, truth: Trajectory) -> Score | None:
    """Return the errors at every pose of the estimate for which truth is known; None if none is.

    Nothing is aligned: both are taken as poses in the same frame.
    """
    if len(truth.time_ns) < 2 or not len(estimate.time_ns):
        return None
    true_pose = interpolate(truth, estimate.time_ns)
    known = np.isfinite(true_pose[:, 0])
    if not np.any(known):
        return None
    error = pose_errors(estimate.pose[known], true_pose[known])
    with_yaw = np.isfinite(error[:, 2])
    rmse = np.sqrt(np.mean(error[:, :2] ** 2, axis=0))
    theta = nees = math.nan
    if np.any(with_yaw):
        e = error[with_yaw]
        theta = float(np.sqrt(np.mean(e[:, 2] ** 2)))
        nees = _mean_nees(e, estimate.covariance[known][with_yaw])
    return Score(
        count=int(np.sum(known)),
        rmse_x=float(rmse[0]),
        rmse_y=float(rmse[1]),
        rmse_theta=theta,
        rmse_position=float(np.hypot(*rmse)),
        mean_nees=nees,
    )


def _mean_nees(e: FloatArray, P: FloatArray) -> float:
    """Return the mean of e' P^-1 e = |L^-1 e|^2, where L L' = P; NaN if it is not known."""
    if not np.all(np.isfinite(P)):
        return math.nan
    with np.errstate(all="ignore"):
        try:
            whitened = np.linalg.solve(np.linalg.cholesky(P), e[..., None])[..., 0]
        except np.linalg.LinAlgError:
            return math.nan
        nees = float(np.mean(np.sum(whitened**2, axis=-1)))
    return nees if math.isfinite(nees) else math.nan
