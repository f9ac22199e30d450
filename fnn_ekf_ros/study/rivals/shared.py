# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Parts that the rivals share: start, a step of the EKF, and wheel noise read from state noise.

Arrays are as in `core.bank`: components first, then the filters, then the batch.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Generic, NamedTuple, Protocol, TypeVar

import numpy as np

from fnn_ekf_ros.core.angles import wrap_angle
from fnn_ekf_ros.core.arrays import STATES_OF_ROWS, BoolArray, FloatArray, Row, diagonal_of
from fnn_ekf_ros.core.bank import (
    Bank,
    Noise,
    Readings,
    correct,
    innovate,
    predict_covariance,
    wrapped,
)
from fnn_ekf_ros.core.covariance import limit_uncertainty
from fnn_ekf_ros.core.limits import LARGEST_STD, SMALLEST_STD
from fnn_ekf_ros.core.motion import Motion, MotionModel, move
from fnn_ekf_ros.core.pace import NOMINAL_PERIOD_S
from fnn_ekf_ros.core.results import Epoch
from fnn_ekf_ros.study.blocks import BlockStart, StepEstimate, run_in_blocks
from fnn_ekf_ros.study.recording import Estimates, Recording, Start


class RivalSettings(Protocol):
    """Settings of a rival filter."""

    @property
    def numbers(self) -> int:
        """Number of floating-point numbers that the filter keeps of a robot."""


Settings = TypeVar("Settings", bound=RivalSettings)
"""Settings of one rival."""


@dataclass(frozen=True, slots=True)
class Rival(Generic[Settings]):
    """A rival filter that is run over recordings; it can be pickled.

    Attributes:
        block_filter: takes f(x, u), the settings, the start of some robots and their epochs; yields
            an estimate after each epoch.
    """

    block_filter: Callable[
        [MotionModel, Settings, BlockStart, Iterator[Epoch]], Iterator[StepEstimate]
    ]

    def __call__(
        self, motion_model: MotionModel, recording: Recording, start: Start, settings: Settings
    ) -> Estimates:
        """Run the filter over a recording.

        Args:
            motion_model: f(x, u).
            recording: what the sensors measured.
            start: pose and noise to start from.
            settings: of the filter.
        """
        block_filter = partial(self.block_filter, motion_model, settings)
        return run_in_blocks(recording, start, block_filter, settings.numbers)


class Prediction(NamedTuple):
    """A step before its measurements.

    Attributes:
        motion: the step, with the Jacobians A and W.
        bank: x- and P-; yaws are not wrapped.
    """

    motion: Motion
    bank: Bank


class EkfStep(NamedTuple):
    """A step of an EKF with the noise of its time.

    Attributes:
        predicted: before the measurements.
        innovation: `(4, F, *batch)` r = z - H x-, rows as in `Row` (m, m, rad, rad).
        available: `(4, 1, *batch)` the rows that were measured.
        bank: x and P after the measurements, yaws wrapped.
        nis: `(F, *batch)` r' S^-1 r.
    """

    predicted: Prediction
    innovation: FloatArray
    available: BoolArray
    bank: Bank
    nis: FloatArray


def one_filter(start: BlockStart) -> tuple[Bank, Noise]:
    """Return a bank of one filter at the start, and the noise it starts with."""
    return (
        Bank(start.mean[:, None], start.covariance[:, :, None]),
        Noise(start.process_noise[:, None], start.measurement_noise[:, None]),
    )


def period_scale(start: BlockStart) -> float:
    """Return the recording's period in nominal ones: the factor of Q for one step."""
    return start.period_s / NOMINAL_PERIOD_S


def predict(
    motion_model: MotionModel, bank: Bank, control: FloatArray, process_noise: FloatArray
) -> Prediction:
    """Return x- and P- as `core.bank.predict` does, and the step that led there.

    Args:
        motion_model: f(x, u).
        bank: x and P.
        control: `(2, *batch)` [dS, dtheta] (m, rad).
        process_noise: `(2, F, *batch)` diagonal of Q for this step (m^2, rad^2).
    """
    motion = move(motion_model, bank.mean, control)
    covariance = predict_covariance(bank.covariance, motion, process_noise)
    return Prediction(motion, Bank(motion.mean, limit_uncertainty(covariance)))


def ekf_step(
    motion_model: MotionModel, bank: Bank, noise: Noise, scale: float, epoch: Epoch
) -> EkfStep:
    """Return an EKF's step over an epoch.

    Args:
        motion_model: f(x, u).
        bank: x and P before the epoch.
        noise: Q of a nominal period, and R.
        scale: the factor of Q for the epoch, as of `period_scale`.
        epoch: the control and the measurement.
    """
    predicted = predict(motion_model, bank, epoch.control, noise.process * scale)
    readings = Readings(epoch.measurement, epoch.available)
    innovations = innovate(predicted.bank, readings, noise.measurement)
    corrected = correct(predicted.bank, innovations, noise, epoch.available)
    return EkfStep(
        predicted=predicted,
        innovation=innovations.innovation,
        available=epoch.available[:, None],
        bank=wrapped(corrected.bank),
        nis=corrected.nis,
    )


def estimate_of(bank: Bank, nis: FloatArray) -> StepEstimate:
    """Return the estimate of a bank of one filter.

    Args:
        bank: x and P.
        nis: `(1, *batch)` the NIS to report.
    """
    return StepEstimate(mean=bank.mean[:, 0], covariance=bank.covariance[:, :, 0], nis=nis[0])


def pose_difference(mean: FloatArray, reference: FloatArray) -> FloatArray:
    """Return poses `(3, ...)` less others, the angle wrapped (m, m, rad)."""
    difference = mean - reference
    difference[2] = wrap_angle(difference[2])
    return difference


def row_values(state: FloatArray) -> FloatArray:
    """Return H x, `(4, ...)` rows as in `Row`, for vectors x `(3, ...)`."""
    values: FloatArray = state[STATES_OF_ROWS]
    return values


def row_variances(covariance: FloatArray) -> FloatArray:
    """Return the diagonal of H P H', `(4, ...)` rows as in `Row`, for P `(3, 3, ...)`."""
    return row_values(diagonal_of(covariance))


def outer(vector: FloatArray) -> FloatArray:
    """Return v v', `(n, n, ...)`, for vectors `(n, ...)`."""
    return vector[:, None] * vector[None]


def wheel_noise(motion: Motion, state_noise: FloatArray) -> FloatArray:
    """Return the diagonal of the Q whose W Q W' comes closest to a covariance of the state.

    The papers estimate the noise of the state; here it enters by two wheel increments. The
    least-squares solution of W Q W' = M is Q = W+ M W+' with the pseudo-inverse
    W+ = (W'W)^-1 W'.

    Args:
        motion: the step, with W.
        state_noise: `(3, 3, ...)` M, symmetric.

    Returns:
        `(2, ...)` (m^2, rad^2); positive if M is positive definite.
    """
    distance, rotation = np.moveaxis(motion.noise_jacobian(), 1, 0)  # the columns of W
    a, b, c = (
        (one * other).sum(axis=0)
        for one, other in ((distance, distance), (distance, rotation), (rotation, rotation))
    )
    inverse = np.stack([c * distance - b * rotation, a * rotation - b * distance])
    inverse = inverse / (a * c - b * b)
    diagonal: FloatArray = np.sum(inverse * matmul(inverse, state_noise), axis=1)
    return diagonal


def matmul(one: FloatArray, other: FloatArray) -> FloatArray:
    """Return the products `(n, k, ...)` of matrices `(n, m, ...)` and `(m, k, ...)`."""
    product: FloatArray = np.einsum("ij...,jk...->ik...", one, other)
    return product


def shows_wheel_noise(available: BoolArray) -> BoolArray:
    """Return `(2, ...)`: whether the available rows `(4, ...)` show noise of distance and rotation.

    Noise of the distance shows in x and y together, as the robot may face in any direction; noise
    of the rotation in a yaw.
    """
    distance = available[Row.X] & available[Row.Y]
    rotation = available[Row.COMPASS_YAW] | available[Row.LRF_YAW]
    return np.stack([distance, rotation])


def within_limits(variance: FloatArray) -> FloatArray:
    """Return variances of any shape held to what double precision can work with."""
    return np.clip(variance, SMALLEST_STD**2, LARGEST_STD**2)
