# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""What the rivals share: their start, the prediction, and wheel noise read from state noise.

Arrays are as in `core.bank`: components first, then the filters, then the batch.
"""

from typing import NamedTuple

import numpy as np

from fnn_ekf_ros.core.angles import wrap_angle
from fnn_ekf_ros.core.arrays import STATES_OF_ROWS, BoolArray, FloatArray, Row, diagonal_of
from fnn_ekf_ros.core.bank import Bank, Noise, predict_covariance
from fnn_ekf_ros.core.covariance import limit_uncertainty
from fnn_ekf_ros.core.limits import LARGEST_STD, SMALLEST_STD
from fnn_ekf_ros.core.motion import Motion, MotionModel, move
from fnn_ekf_ros.core.pace import NOMINAL_PERIOD_S
from fnn_ekf_ros.study.blocks import BlockStart


class Prediction(NamedTuple):
    """A step before its measurements.

    Attributes:
        motion: the step, with the Jacobians A and W.
        bank: x- and P-; headings are not wrapped.
    """

    motion: Motion
    bank: Bank


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
    """Return `(2, ...)`: whether the available rows `(4, ...)` show (forward, heading) noise.

    Noise of the distance shows in x and y together, as the robot may face in any direction; noise
    of the rotation in a yaw.
    """
    forward = available[Row.X] & available[Row.Y]
    heading = available[Row.COMPASS_YAW] | available[Row.LRF_YAW]
    return np.stack([forward, heading])


def within_limits(variance: FloatArray) -> FloatArray:
    """Return variances of any shape held to what double precision can work with."""
    return np.clip(variance, SMALLEST_STD**2, LARGEST_STD**2)
