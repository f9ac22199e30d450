# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Trajectories as text in the formats of TUM and KITTI, as evo reads and writes them."""

import numpy as np

from fnn_ekf_ros.core.arrays import FloatArray
from fnn_ekf_ros.timeline.trajectory import Trajectory


def tum_text(track: Trajectory) -> str:
    """Return one line `t x y z qx qy qz qw` for each pose, t in seconds with all nanoseconds.

    Poses without a yaw are left out: the format has no way to say so.
    """
    lines = []
    for time_ns, (x, y, yaw) in zip(track.time_ns.tolist(), track.pose.tolist(), strict=True):
        if np.isfinite(yaw):
            seconds, rest = divmod(time_ns, 10**9)
            turn = f"{np.sin(0.5 * yaw):.12g} {np.cos(0.5 * yaw):.12g}"
            lines.append(f"{seconds}.{rest:09d} {x:.12g} {y:.12g} 0 0 0 {turn}\n")
    return "".join(lines)


def kitti_text(pose: FloatArray) -> str:
    """Return one line for each pose `(n, 3)` (m, m, rad): the first 3 rows of its 4x4 matrix.

    The format has no stamps: two files belong together if their lines do.
    """
    lines = []
    for x, y, yaw in pose.tolist():
        c, s = np.cos(yaw), np.sin(yaw)
        lines.append(f"{c:.12g} {-s:.12g} 0 {x:.12g} {s:.12g} {c:.12g} 0 {y:.12g} 0 0 1 0\n")
    return "".join(lines)
