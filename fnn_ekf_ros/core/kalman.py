"""The extended Kalman filter's two halves (Nguyen et al., eqs. 5-12), with maskable rows.

    prediction   P- = A P A' + W Q W'
    innovation   r = z - H x-            S = H P- H' + R          (12)
    correction   K = P- H' S^-1          x = x- + K r
                 P = (I - K H) P- (I - K H)' + K R K'             (Joseph form)

A row that is not available has a zero row of H, a zero innovation and a unit entry in S: it
drops out of every product, exactly as if the row had not been there, and batches keep their
shape.
"""

from typing import NamedTuple

import numpy as np

from fnn_ekf_ros.core.angles import wrap_angle
from fnn_ekf_ros.core.arrays import (
    STATE_SIZE,
    BoolArray,
    FloatArray,
    Row,
    diagonal_matrix,
    symmetrize,
    transpose,
)
from fnn_ekf_ros.core.motion import Motion

MEASUREMENT_JACOBIAN: FloatArray = np.array(
    [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, 1.0]]
)
"""H: rows as in `Row`, columns [x, y, theta]."""

_IDENTITY = np.eye(STATE_SIZE)


class Innovation(NamedTuple):
    """What a measurement says against a prediction.

    Attributes:
        innovation: `(..., 4)` r (m, m, rad, rad), rows as in `Row`; 0 where not available.
        innovation_covariance: `(..., 4, 4)` S; rows that are not available are unit rows.
        kalman_gain: `(..., 3, 4)` K.
        nis: `(...)` normalised innovation squared r' S^-1 r of the available rows; 0 if none.
        degrees_of_freedom: `(...)` number of available rows.
    """

    innovation: FloatArray
    innovation_covariance: FloatArray
    kalman_gain: FloatArray
    nis: FloatArray
    degrees_of_freedom: FloatArray


class Correction(NamedTuple):
    """Result of `correct`.

    Attributes:
        mean: `(..., 3)` corrected state (m, m, rad in (-pi, pi]).
        covariance: `(..., 3, 3)` its covariance.
        innovation: `(..., 4)` r (m, m, rad, rad), rows as in `Row`; 0 where not available.
        innovation_variance: `(..., 4)` diagonal of S (m^2, m^2, rad^2, rad^2); of every row,
            available or not.
        nis: `(...)` normalised innovation squared r' S^-1 r of the available rows; 0 if none.
        degrees_of_freedom: `(...)` number of available rows.
    """

    mean: FloatArray
    covariance: FloatArray
    innovation: FloatArray
    innovation_variance: FloatArray
    nis: FloatArray
    degrees_of_freedom: FloatArray


def predict_covariance(
    covariance: FloatArray, motion: Motion, process_noise: FloatArray
) -> FloatArray:
    """Return P- = A P A' + W Q W'.

    Args:
        covariance: `(..., 3, 3)` P before the step.
        motion: the step, with A and W.
        process_noise: `(..., 2)` diagonal of Q for this step (m^2, rad^2).
    """
    A, W = motion.motion_jacobian, motion.noise_jacobian
    return symmetrize(
        A @ covariance @ transpose(A) + (W * process_noise[..., None, :]) @ transpose(W)
    )


def innovate(
    mean: FloatArray,
    covariance: FloatArray,
    measurement: FloatArray,
    measurement_noise: FloatArray,
    available: BoolArray,
) -> Innovation:
    """Compare a predicted state with the rows that are available.

    Args:
        mean: `(..., 3)` x- (m, m, rad).
        covariance: `(..., 3, 3)` P-.
        measurement: `(..., 4)` z (m, m, rad, rad), rows as in `Row`; ignored where masked.
        measurement_noise: `(..., 4, 4)` R, symmetric positive definite on the available rows.
        available: `(..., 4)` which rows were measured.
    """
    expected = mean[..., [0, 1, 2, 2]]
    difference = np.where(available, measurement, expected) - expected
    r = np.concatenate(
        [difference[..., : Row.COMPASS_YAW], wrap_angle(difference[..., Row.COMPASS_YAW :])],
        axis=-1,
    )

    mask = available.astype(np.float64)
    H = MEASUREMENT_JACOBIAN * mask[..., None]
    PHt = covariance @ transpose(H)
    S = symmetrize(H @ PHt + _masked(measurement_noise, mask) + diagonal_matrix(1.0 - mask))
    # One solve gives the gain and the whitened innovation: S [K' | S^-1 r] = [H P | r].
    solved = np.linalg.solve(S, np.concatenate([transpose(PHt), r[..., None]], axis=-1))
    return Innovation(
        innovation=r,
        innovation_covariance=S,
        kalman_gain=transpose(solved[..., :STATE_SIZE]),
        nis=np.sum(r * solved[..., STATE_SIZE], axis=-1),
        degrees_of_freedom=np.sum(mask, axis=-1),
    )


def update(
    mean: FloatArray,
    covariance: FloatArray,
    measurement_noise: FloatArray,
    available: BoolArray,
    innovation: Innovation,
) -> tuple[FloatArray, FloatArray]:
    """Return mean `(..., 3)` and covariance `(..., 3, 3)` corrected by an innovation of theirs."""
    mask = available.astype(np.float64)
    H = MEASUREMENT_JACOBIAN * mask[..., None]
    K, r = innovation.kalman_gain, innovation.innovation
    corrected = mean + (K @ r[..., None])[..., 0]
    I_KH = _IDENTITY - K @ H
    P = I_KH @ covariance @ transpose(I_KH) + K @ _masked(measurement_noise, mask) @ transpose(K)
    corrected = np.concatenate([corrected[..., :2], wrap_angle(corrected[..., 2:])], axis=-1)
    return corrected, symmetrize(P)


def correct(
    mean: FloatArray,
    covariance: FloatArray,
    measurement: FloatArray,
    measurement_noise: FloatArray,
    available: BoolArray,
) -> Correction:
    """Correct a predicted state by the rows that are available; arguments as of `innovate`."""
    seen = innovate(mean, covariance, measurement, measurement_noise, available)
    corrected, P = update(mean, covariance, measurement_noise, available, seen)
    variance = np.diagonal(covariance, axis1=-2, axis2=-1)[..., [0, 1, 2, 2]]
    return Correction(
        mean=corrected,
        covariance=P,
        innovation=seen.innovation,
        innovation_variance=variance + np.diagonal(measurement_noise, axis1=-2, axis2=-1),
        nis=seen.nis,
        degrees_of_freedom=seen.degrees_of_freedom,
    )


def _masked(matrix: FloatArray, mask: FloatArray) -> FloatArray:
    return matrix * mask[..., :, None] * mask[..., None, :]
