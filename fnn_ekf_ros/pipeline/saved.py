"""What of a localizer outlives its process."""

from typing import NamedTuple

from fnn_ekf_ros.core.arrays import FloatArray


class SavedState(NamedTuple):
    """Where a localizer was, and the noise it had found.

    Attributes:
        stamp_ns: ROS time of the pose [ns].
        pose: `(3,)` [x, y, yaw] in the map frame (m, m, rad).
        covariance: `(3, 3)` of the pose, positive definite.
        process_noise: `(2,)` diagonal of Q for 375 ms, without an alarm's share (m^2, rad^2).
        measurement_noise: `(4,)` diagonal of R, rows as in `Row`; likewise.
    """

    stamp_ns: int
    pose: FloatArray
    covariance: FloatArray
    process_noise: FloatArray
    measurement_noise: FloatArray
