# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""A track beside the truth, at the times that both have."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fnn_ekf_ros.core.arrays import FloatArray
from fnn_ekf_ros.timeline.trajectory import Trajectory, interpolate, pose_errors


class Matched(NamedTuple):
    """Poses of an estimate and the true ones at the same times.

    Attributes:
        time_ns: `(n,)` [ns].
        estimate: `(n, 3)` poses (m, m, rad).
        covariance: `(n, 3, 3)` that the estimate claims.
        truth: `(n, 3)` true poses; NaN yaw where it is not known.
    """

    time_ns: NDArray[np.int64]
    estimate: FloatArray
    covariance: FloatArray
    truth: FloatArray

    def errors(self) -> FloatArray:
        """Return estimate less truth `(n, 3)`, yaw wrapped (m, m, rad)."""
        return pose_errors(self.estimate, self.truth)


def match(estimate: Trajectory, truth: Trajectory) -> Matched | None:
    """Return the estimate's poses at which truth is known, with it; None if it nowhere is.

    The truth is interpolated linearly, not across gaps.
    """
    if len(truth.time_ns) < 2 or not len(estimate.time_ns):
        return None
    true_pose = interpolate(truth, estimate.time_ns)
    known = np.isfinite(true_pose[:, 0])
    if not np.any(known):
        return None
    return Matched(
        time_ns=estimate.time_ns[known],
        estimate=estimate.pose[known],
        covariance=estimate.covariance[known],
        truth=true_pose[known],
    )
