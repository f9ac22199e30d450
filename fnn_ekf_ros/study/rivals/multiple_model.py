"""A bank of filters with Bayesian weights: multiple model adaptive estimation, Magill (1965).

One extended Kalman filter for every pair of a scale of Q and a scale of R, each for itself; which
of them is right does not change with time. With the innovation r and its covariance S of each
filter, its weight goes with the likelihood of all it has seen so far,

    w <- w N(r; 0, S) / sum of the same over the bank

(IEEE Transactions on Automatic Control 10(4), pp. 434-439), and the bank says the mixture's mean
and covariance,

    x = sum w x_i,   P = sum w (P_i + (x_i - x)(x_i - x)')

The weight of a filter that is wrong falls exponentially and, where the noise changes, takes as
long to come back. A floor under the weights shortens that (Maybeck 1982, section 10.8).
"""

from dataclasses import dataclass

import numpy as np

from fnn_ekf_ros.core.angles import wrap_angle
from fnn_ekf_ros.core.arrays import STATE_SIZE, BoolArray, FloatArray, Row, diagonal_matrix
from fnn_ekf_ros.core.kalman import Correction, correct
from fnn_ekf_ros.core.motion import MotionModel
from fnn_ekf_ros.study.recording import Recording, Start, Track
from fnn_ekf_ros.study.rivals.shared import (
    collect,
    outer,
    period_scale,
    pose_difference,
    predict,
    whole_batch,
)

NINE_SCALES = tuple(5.0 ** (half / 2.0) for half in range(-4, 5))
"""1/25 to 25 times a variance, evenly in the logarithm."""


@dataclass(frozen=True, slots=True)
class MultipleModelSettings:
    """Settings of the bank.

    Attributes:
        process_scales: what the start's Q is multiplied by; each is paired with each of
        measurement_scales: what the start's R is multiplied by.
        smallest_weight: floor under every weight before they are made to sum to 1; 0 is none, and
            1 / number of filters too much. One part in a million costs nothing where the noise is
            constant, and the bank follows where it changes; 1e-3 costs 3 %.
    """

    process_scales: tuple[float, ...] = NINE_SCALES
    measurement_scales: tuple[float, ...] = NINE_SCALES
    smallest_weight: float = 1e-6

    def __post_init__(self) -> None:
        """Refuse banks that cannot be run."""
        scales = (*self.process_scales, *self.measurement_scales)
        if not self.process_scales or not self.measurement_scales or min(scales) <= 0.0:
            raise ValueError("a bank needs scales of Q and of R, all over 0")
        count = len(self.process_scales) * len(self.measurement_scales)
        if not 0.0 <= self.smallest_weight * count < 1.0:
            raise ValueError(f"{count} filters cannot each weigh {self.smallest_weight} or more")


def run(
    motion_model: MotionModel,
    recording: Recording,
    start: Start,
    settings: MultipleModelSettings,
) -> Track:
    """Run the bank over a recording.

    Args:
        motion_model: f(x, u).
        recording: what the sensors said.
        start: pose and noise to start from; the bank's scales are relative to its noise.
        settings: the bank.

    Returns:
        The track of the mixture; its `nis` is that of the mixture's prediction.
    """
    start = whole_batch(recording, start)
    Q, R = _bank_noise(start, settings)
    step_noise, R_matrix = Q * period_scale(recording), diagonal_matrix(R)
    count = len(Q)
    mean = np.broadcast_to(start.mean, (count, *start.mean.shape))
    covariance = np.broadcast_to(start.covariance, (count, *start.covariance.shape))
    log_weight = np.full((count, *start.mean.shape[:-1]), -np.log(count))
    steps: list[Correction] = []
    for control, z, available in zip(
        recording.control, recording.measurement, recording.available, strict=True
    ):
        predicted = predict(motion_model, mean, covariance, control, step_noise)
        corrected = correct(predicted.motion.mean, predicted.covariance, z, R_matrix, available)
        weight = np.exp(log_weight)
        expected = mixture(weight, predicted.motion.mean, predicted.covariance)
        R_expected = diagonal_matrix(np.sum(weight[..., None] * R, axis=0))
        # Mixing commutes with the linear H: this S is the mixture of the filters' S.
        step = correct(*expected, z, R_expected, available)

        log_weight = _normalised(
            log_weight + log_likelihood(corrected.nis, predicted.covariance, R, available),
            settings.smallest_weight,
        )
        mean, covariance = corrected.mean, corrected.covariance
        x, P = mixture(np.exp(log_weight), mean, covariance)
        steps.append(step._replace(mean=x, covariance=P))
    return collect(steps)


def log_likelihood(
    nis: FloatArray,
    covariance: FloatArray,
    measurement_noise: FloatArray,
    available: BoolArray,
) -> FloatArray:
    """Return log N(r; 0, S), `(...)`, over the rows that were measured; 0 if none was.

    Args:
        nis: `(...)` r' S^-1 r.
        covariance: `(..., 3, 3)` P-.
        measurement_noise: `(..., 4)` diagonal of R.
        available: `(..., 4)` which rows were measured.
    """
    # det S = det R det(I + P- H' R^-1 H), and H' R^-1 H is diagonal: 3x3 whatever was measured.
    information = available / measurement_noise
    J = np.concatenate(
        [
            information[..., : Row.COMPASS_YAW],
            np.sum(information[..., Row.COMPASS_YAW :], axis=-1, keepdims=True),
        ],
        axis=-1,
    )
    log_determinant = np.sum(
        np.where(available, np.log(2.0 * np.pi * measurement_noise), 0.0), axis=-1
    ) + np.log(np.linalg.det(np.eye(STATE_SIZE) + covariance * J[..., None, :]))
    log_density: FloatArray = -0.5 * (nis + log_determinant)
    return log_density


def mixture(
    weight: FloatArray, mean: FloatArray, covariance: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return mean and covariance of a mixture of poses; the filters are the first dimension.

    Args:
        weight: `(filters, ...)`, 1 in sum over the filters.
        mean: `(filters, ..., 3)` (m, m, rad).
        covariance: `(filters, ..., 3, 3)`.
    """
    # Angles are averaged as differences from the likeliest filter's: pi and -pi are neighbours.
    likeliest = np.argmax(weight, axis=0)[None, ..., None]
    reference = np.take_along_axis(mean, likeliest, axis=0)[0]
    from_reference = pose_difference(mean, reference)
    x = reference + np.sum(weight[..., None] * from_reference, axis=0)
    x = np.concatenate([x[..., :2], wrap_angle(x[..., 2:])], axis=-1)
    spread = covariance + outer(pose_difference(mean, x))
    P: FloatArray = np.sum(weight[..., None, None] * spread, axis=0)
    return x, P


def _bank_noise(start: Start, settings: MultipleModelSettings) -> tuple[FloatArray, FloatArray]:
    """Return the diagonals of Q `(filters, ..., 2)` and R `(filters, ..., 4)` of the bank."""
    process, measurement = np.meshgrid(
        settings.process_scales, settings.measurement_scales, indexing="ij"
    )
    shape = (-1, *(1,) * start.process_noise.ndim)
    return (
        start.process_noise * process.reshape(shape),
        start.measurement_noise * measurement.reshape(shape),
    )


def _normalised(log_weight: FloatArray, smallest_weight: float) -> FloatArray:
    """Return the logarithms of weights `(filters, ...)` that sum to one and keep to the floor."""
    log_weight = log_weight - np.max(log_weight, axis=0)
    log_weight = log_weight - np.log(np.sum(np.exp(log_weight), axis=0))
    if smallest_weight == 0.0:
        return log_weight
    weight = np.maximum(np.exp(log_weight), smallest_weight)
    floored: FloatArray = np.log(weight / np.sum(weight, axis=0))
    return floored
