# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The state of a localizer that outlives its process."""

from typing import NamedTuple

import numpy as np

from fnn_ekf_ros.core.angles import wrap_angle
from fnn_ekf_ros.core.arrays import FloatArray
from fnn_ekf_ros.core.covariance import limit_uncertainty
from fnn_ekf_ros.core.limits import LARGEST_POSITION


class SavedState(NamedTuple):
    """Pose of a localizer, and what it has learned.

    Attributes:
        stamp_ns: ROS time of the pose [ns].
        pose: `(3,)` [x, y, yaw] in the map frame (m, m, rad).
        covariance: `(3, 3)` of the pose, positive definite.
        process_noise: `(2,)` diagonal of Q for 375 ms, without an alarm's share (m^2, rad^2).
        measurement_noise: `(4,)` diagonal of R, rows as in `Row`, without an alarm's share.
        log_weight: `(H, M)` log weights of members of lasting errors, by horizon [nats]; None if
            these were not followed.
    """

    stamp_ns: int
    pose: FloatArray
    covariance: FloatArray
    process_noise: FloatArray
    measurement_noise: FloatArray
    log_weight: FloatArray | None = None


class SavedPose(NamedTuple):
    """A pose as it is saved.

    Attributes:
        mean: `(3,)` [x, y, yaw] (m, m, rad), the yaw in (-pi, pi].
        covariance: `(3, 3)`, with standard deviations of `LARGEST_POSE_STD` at most.
    """

    mean: FloatArray
    covariance: FloatArray


def saved_pose(mean: FloatArray, covariance: FloatArray) -> SavedPose:
    """Return a pose as the filter has it once it runs; one that was given may be beyond that.

    Args:
        mean: `(3,)` [x, y, yaw] (m, m, rad), any yaw.
        covariance: `(3, 3)`, positive definite.
    """
    x, y = np.clip(mean[:2], -LARGEST_POSITION, LARGEST_POSITION)
    return SavedPose(np.array([x, y, float(wrap_angle(mean[2]))]), limit_uncertainty(covariance))
