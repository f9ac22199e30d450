# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Trajectories for tests: of a few poses, and of a drive with wheels and fixes."""

import numpy as np
from localizers import SECOND_NS

from fnn_ekf_ros.timeline.trajectory import Trajectory


def track(
    times: list[float], poses: list[list[float]], variances: list[float] | None = None
) -> Trajectory:
    covariance = np.diag(variances or [0.0, 0.0, 0.0])
    return Trajectory(
        np.array([round(time * SECOND_NS) for time in times]),
        np.array(poses, dtype=np.float64),
        np.tile(covariance, (len(times), 1, 1)),
    )


STRAIGHT = track([0.0, 1.0, 2.0, 3.0], [[0, 0, 0], [1, 0, 0], [2, 0, 0], [3, 0, 0]])


def wiggling(n: int = 400, period_s: float = 0.375) -> Trajectory:
    """A drive of curves of many radii, with a yaw along the direction of travel."""
    t = period_s * np.arange(n)
    xy = np.column_stack([0.3 * t + np.sin(0.21 * t), 4.0 * np.sin(0.07 * t) + np.cos(0.13 * t)])
    ahead = np.gradient(xy, axis=0)
    yaw = np.arctan2(ahead[:, 1], ahead[:, 0])
    covariance = np.tile(np.diag([0.01, 0.01, 0.0025]), (n, 1, 1))
    return Trajectory(
        np.round(t * SECOND_NS).astype(np.int64), np.column_stack([xy, yaw]), covariance
    )


def noisy(truth: Trajectory, seed: int = 1) -> Trajectory:
    """The same with errors as its covariance claims, white."""
    rng = np.random.default_rng(seed)
    std = np.sqrt(np.einsum("nii->ni", truth.covariance))
    return Trajectory(
        truth.time_ns, truth.pose + std * rng.standard_normal(std.shape), truth.covariance
    )
