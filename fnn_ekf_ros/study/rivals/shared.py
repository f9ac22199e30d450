"""What the rivals share: the batch, the prediction, and wheel noise read from state noise."""

from collections.abc import Sequence
from enum import StrEnum
from typing import NamedTuple

import numpy as np

from fnn_ekf_ros.core.angles import wrap_angle
from fnn_ekf_ros.core.arrays import BoolArray, FloatArray, Row, transpose
from fnn_ekf_ros.core.covariance import limit_uncertainty
from fnn_ekf_ros.core.filter import NOMINAL_PERIOD_S
from fnn_ekf_ros.core.kalman import Correction, predict_covariance
from fnn_ekf_ros.core.limits import LARGEST_STD, SMALLEST_STD
from fnn_ekf_ros.core.motion import Motion, MotionModel, move
from fnn_ekf_ros.study.recording import Recording, Start, Track


class AdaptedNoise(StrEnum):
    """Which noise covariances a rival adapts."""

    R = "r"
    Q = "q"
    BOTH = "both"


class Prediction(NamedTuple):
    """A step before its measurements.

    Attributes:
        motion: x- with the Jacobians A and W.
        covariance: `(..., 3, 3)` P-.
    """

    motion: Motion
    covariance: FloatArray


def whole_batch(recording: Recording, start: Start) -> Start:
    """Return the start with all arrays broadcast to one batch, the recording's runs included."""
    batch = np.broadcast_shapes(
        recording.control.shape[1:-1],
        start.mean.shape[:-1],
        start.covariance.shape[:-2],
        start.process_noise.shape[:-1],
        start.measurement_noise.shape[:-1],
    )
    return Start(
        np.broadcast_to(start.mean, (*batch, *start.mean.shape[-1:])),
        np.broadcast_to(start.covariance, (*batch, *start.covariance.shape[-2:])),
        np.broadcast_to(start.process_noise, (*batch, *start.process_noise.shape[-1:])),
        np.broadcast_to(start.measurement_noise, (*batch, *start.measurement_noise.shape[-1:])),
    )


def period_scale(recording: Recording) -> float:
    """Return the recording's period in nominal ones: the factor of Q for one step."""
    return recording.period_s / NOMINAL_PERIOD_S


def predict(
    motion_model: MotionModel,
    mean: FloatArray,
    covariance: FloatArray,
    control: FloatArray,
    process_noise: FloatArray,
) -> Prediction:
    """Return x- and P-.

    Args:
        motion_model: f(x, u).
        mean: `(..., 3)` x (m, m, rad).
        covariance: `(..., 3, 3)` P.
        control: `(..., 2)` [dS, dtheta] (m, rad).
        process_noise: `(..., 2)` diagonal of Q for this step (m^2, rad^2).
    """
    motion = move(motion_model, mean, control)
    return Prediction(
        motion, limit_uncertainty(predict_covariance(covariance, motion, process_noise))
    )


def pose_difference(mean: FloatArray, reference: FloatArray) -> FloatArray:
    """Return poses `(..., 3)` less others, the angle wrapped (m, m, rad)."""
    difference = mean - reference
    return np.concatenate([difference[..., :2], wrap_angle(difference[..., 2:])], axis=-1)


def row_values(state: FloatArray) -> FloatArray:
    """Return H x, `(..., 4)` rows as in `Row`, for vectors x `(..., 3)`."""
    return state[..., [0, 1, 2, 2]]


def row_variances(covariance: FloatArray) -> FloatArray:
    """Return the diagonal of H P H', `(..., 4)` rows as in `Row`, for P `(..., 3, 3)`."""
    return row_values(np.diagonal(covariance, axis1=-2, axis2=-1))


def outer(vector: FloatArray) -> FloatArray:
    """Return v v', `(..., n, n)`, for vectors `(..., n)`."""
    return vector[..., :, None] * vector[..., None, :]


def wheel_noise(motion: Motion, state_noise: FloatArray) -> FloatArray:
    """Return the diagonal of the Q whose W Q W' comes closest to a covariance of the state.

    The papers estimate the noise of the state; here it enters by two wheel increments. The
    least-squares solution of W Q W' = M is Q = W+ M W+' with the pseudo-inverse
    W+ = (W'W)^-1 W'.

    Args:
        motion: the step, with W.
        state_noise: `(..., 3, 3)` M, symmetric.

    Returns:
        `(..., 2)` (m^2, rad^2); positive if M is positive definite.
    """
    W = motion.noise_jacobian
    inverse = np.linalg.solve(transpose(W) @ W, transpose(W))
    diagonal: FloatArray = np.sum((inverse @ state_noise) * inverse, axis=-1)
    return diagonal


def shows_wheel_noise(available: BoolArray) -> BoolArray:
    """Return `(..., 2)`: whether the available rows `(..., 4)` show (forward, heading) noise.

    Forward noise shows in x and y together, as the robot may face any way; the heading's in a yaw.
    """
    forward = available[..., Row.X] & available[..., Row.Y]
    heading = available[..., Row.COMPASS_YAW] | available[..., Row.LRF_YAW]
    return np.stack([forward, heading], axis=-1)


def within_limits(variance: FloatArray) -> FloatArray:
    """Return variances of any shape held to what double precision can work with."""
    return np.clip(variance, SMALLEST_STD**2, LARGEST_STD**2)


def collect(steps: Sequence[Correction]) -> Track:
    """Return the steps as one track."""
    # What was measured is the same for every start, and so are the degrees of freedom.
    return Track(
        np.stack([step.mean for step in steps]),
        np.stack([step.covariance for step in steps]),
        np.stack([step.nis for step in steps]),
        np.stack([np.broadcast_to(step.degrees_of_freedom, step.nis.shape) for step in steps]),
    )
