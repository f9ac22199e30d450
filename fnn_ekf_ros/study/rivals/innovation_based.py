"""Q and R from the last innovations: IAE, Mohamed and Schwarz (1999).

With C_hat the mean of r r' over the last N innovations r = z - H x-,

    R = C_hat - H P- H'
    Q = K C_hat K'                  in a steady state; here Q of W Q W'

(Journal of Geodesy 73(4), pp. 193-203.) R as a difference can be negative and is then held at a
share of C_hat. Only diagonals are adapted. With both, R + H P- H' = C_hat whatever Q is: the pair
that is settled on need not be the true one.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from fnn_ekf_ros.core.arrays import (
    MEASUREMENT_SIZE,
    BoolArray,
    FloatArray,
    diagonal_matrix,
    transpose,
)
from fnn_ekf_ros.core.kalman import MEASUREMENT_JACOBIAN, Correction, correct
from fnn_ekf_ros.core.motion import MotionModel
from fnn_ekf_ros.study.recording import Recording, Start, Track
from fnn_ekf_ros.study.rivals.shared import (
    AdaptedNoise,
    collect,
    period_scale,
    predict,
    row_variances,
    shows_wheel_noise,
    wheel_noise,
    whole_batch,
    within_limits,
)


@dataclass(frozen=True, slots=True)
class InnovationBasedSettings:
    """Settings of the IAE filter.

    Attributes:
        adapted_noise: what is adapted. R alone is as good as the EKF where Q is right, but cannot
            mend a wrong Q; both together are the better bet where nothing is known.
        window_length: N; with fewer Q and R chase each other's noise, with more nothing is gained
            and a wrong start is remembered for longer.
        first_use: how many innovations a row has before it teaches, 1 to `window_length`; waiting
            for a full window costs more than the noise of a short one.
        smallest_share: R is at least this share of C_hat, over 0 and up to 1; a small share lets
            the filter follow every measurement for as long as Q is too large.
    """

    adapted_noise: AdaptedNoise = AdaptedNoise.BOTH
    window_length: int = 200
    first_use: int = 10
    smallest_share: float = 0.2

    def __post_init__(self) -> None:
        """Refuse windows that never teach and a floor that is none."""
        if not 1 <= self.first_use <= self.window_length:
            raise ValueError(
                f"first_use is 1 to window_length ({self.window_length}), not {self.first_use}"
            )
        if not 0.0 < self.smallest_share <= 1.0:
            raise ValueError(f"smallest_share is over 0 and at most 1, not {self.smallest_share}")


class _Window(NamedTuple):
    """Each row's own last N innovations.

    Attributes:
        innovations: `(..., N, 4)`, newest last, 0 where not filled.
        counts: `(..., 4)` how many are filled.
    """

    innovations: FloatArray
    counts: FloatArray


def run(
    motion_model: MotionModel,
    recording: Recording,
    start: Start,
    settings: InnovationBasedSettings,
) -> Track:
    """Run the IAE filter over a recording.

    Args:
        motion_model: f(x, u).
        recording: what the sensors said.
        start: pose and noise to start from.
        settings: what is adapted and by which window.
    """
    mean, covariance, Q, R = whole_batch(recording, start)
    scale = period_scale(recording)
    adapts_Q = settings.adapted_noise is not AdaptedNoise.R
    adapts_R = settings.adapted_noise is not AdaptedNoise.Q
    batch = mean.shape[:-1]
    window = _Window(
        np.zeros((*batch, settings.window_length, MEASUREMENT_SIZE)),
        np.zeros((*batch, MEASUREMENT_SIZE)),
    )
    steps: list[Correction] = []
    for control, z, available in zip(
        recording.control, recording.measurement, recording.available, strict=True
    ):
        predicted = predict(motion_model, mean, covariance, control, Q * scale)
        corrected = correct(
            predicted.motion.mean, predicted.covariance, z, diagonal_matrix(R), available
        )
        mean, covariance = corrected.mean, corrected.covariance
        steps.append(corrected)

        window = _push(window, corrected.innovation, available)
        C = _innovation_covariance(window)
        teaches = available & (window.counts >= settings.first_use)
        if adapts_Q:
            K = _gain(covariance, R, available)  # this step's, before R changes
            sample = wheel_noise(predicted.motion, K @ C @ transpose(K)) / scale
            Q = np.where(shows_wheel_noise(teaches), within_limits(sample), Q)
        if adapts_R:
            variance = np.diagonal(C, axis1=-2, axis2=-1)
            sample = np.maximum(
                variance - row_variances(predicted.covariance), settings.smallest_share * variance
            )
            R = np.where(teaches, within_limits(sample), R)
    return collect(steps)


def _push(window: _Window, innovation: FloatArray, available: BoolArray) -> _Window:
    """Return the window with one more innovation in the rows that have one."""
    shifted = np.concatenate([window.innovations[..., 1:, :], innovation[..., None, :]], axis=-2)
    length = float(window.innovations.shape[-2])
    return _Window(
        np.where(available[..., None, :], shifted, window.innovations),
        np.minimum(window.counts + available, length),
    )


def _innovation_covariance(window: _Window) -> FloatArray:
    """Return C_hat, `(..., 4, 4)`: positive semidefinite however differently rows are filled."""
    count = np.maximum(window.counts, 1.0)
    r = window.innovations / np.sqrt(count)[..., None, :]
    return transpose(r) @ r


def _gain(
    covariance: FloatArray, measurement_noise: FloatArray, available: BoolArray
) -> FloatArray:
    """Return K = P H' R^-1, `(..., 3, 4)`; columns of rows that were not measured are 0."""
    H = MEASUREMENT_JACOBIAN * available[..., :, None]
    return covariance @ transpose(H) / measurement_noise[..., None, :]
