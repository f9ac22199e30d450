# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Trajectories: poses over time, and what one of them is at another's times."""

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
        frame: name of the poses' frame; empty where it is not known.
    """

    time_ns: NDArray[np.int64]
    pose: FloatArray
    covariance: FloatArray
    frame: str = ""


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
