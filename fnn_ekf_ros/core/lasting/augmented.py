# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Filters whose state holds lasting errors of the sensors beside the pose.

    state        x, y, theta, b_x, b_y, b_g, b_0
    fix          z = (x, y) + (b_x, b_y) + v
    yaw          z = theta + b_g + b_0 + v
    errors       b_x, b_y, b_g:  b' = phi b + w,  phi = exp(-dt/tau),  var w = (1 - phi^2) var b
                 b_0 is constant

The pose moves as in `bank`; the covariance of pose and errors follows from A and phi:

    P_pb- = A P_pb phi,     P_bb- = phi P_bb phi + var w

Filters without an error have a singular covariance: its rows and columns are 0.
"""

import math
from enum import IntEnum
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from fnn_ekf_ros.core.angles import wrap_angle
from fnn_ekf_ros.core.arrays import STATE_SIZE, Constant, FloatArray, diagonal_of
from fnn_ekf_ros.core.bank import Bank, predict_covariance
from fnn_ekf_ros.core.covariance import limit_uncertainty
from fnn_ekf_ros.core.motion import MotionModel, move


class Component(IntEnum):
    """Components of the augmented state (m, m, rad, m, m, rad, rad)."""

    X = 0
    Y = 1
    YAW = 2
    FIX_X = 3
    FIX_Y = 4
    YAW_DRIFT = 5
    YAW_OFFSET = 6


AUGMENTED_SIZE = len(Component)
"""Components of the augmented state."""
POSE = slice(0, STATE_SIZE)
"""The pose's components."""
ERRORS = slice(STATE_SIZE, AUGMENTED_SIZE)
"""The errors' components."""
_OBSERVED = slice(Component.FIX_X, Component.YAW_OFFSET)
"""Errors that add to x, y and yaw in this order; the yaw's offset comes on top."""


class Observation(NamedTuple):
    """Predictions of x, y and a yaw that a sensor with lasting errors measures.

    Attributes:
        expected: `(3, F, *batch)` (m, m, rad).
        covariance: `(3, 3, F, *batch)` H P H'.
    """

    expected: FloatArray
    covariance: FloatArray


def predict_augmented(
    model: MotionModel,
    bank: Bank,
    control: FloatArray,
    process_noise: FloatArray,
    kept: FloatArray,
    added: FloatArray,
) -> Bank:
    """Return the filters after a step of the wheels.

    Args:
        model: f(x, u).
        bank: before the step, `(7, F, *batch)`.
        control: `(2, *batch)` [dS, dtheta] (m, rad).
        process_noise: `(2, F, *batch)` diagonal of Q for this step (m^2, rad^2).
        kept: phi, `(4, 1, *ones)`.
        added: `(4, F, *batch)` variance added to the errors (m^2, m^2, rad^2, rad^2).
    """
    motion = move(model, bank.mean[POSE], control)
    P = bank.covariance
    mean, after = np.empty_like(bank.mean), np.empty_like(P)
    mean[POSE] = motion.mean
    mean[Component.YAW] = wrap_angle(motion.mean[Component.YAW])
    np.multiply(kept, bank.mean[ERRORS], out=mean[ERRORS])
    pose = predict_covariance(P[POSE, POSE], motion, process_noise)
    limited = limit_uncertainty(pose)
    after[POSE, POSE] = limited
    cross = after[POSE, ERRORS]
    cross[...] = P[POSE, ERRORS]
    cross[:2] += motion.by_heading[:, None] * P[Component.YAW, ERRORS]
    cross *= kept
    if limited is not pose:
        with np.errstate(invalid="ignore", divide="ignore"):
            scale = np.sqrt(diagonal_of(limited) / diagonal_of(pose))
        cross *= scale[:, None]
    after[ERRORS, POSE] = cross.swapaxes(0, 1)
    errors = after[ERRORS, ERRORS]
    np.multiply(P[ERRORS, ERRORS], kept[:, None] * kept[None], out=errors)
    diagonal = diagonal_of(errors)
    diagonal += added
    return Bank(mean, after)


@lru_cache(maxsize=256)
def kept_by_errors(duration_s: float, time_constant_s: float) -> Constant:
    """Return phi, `(4, 1)`: the part of each error that a duration leaves."""
    phi = math.exp(-duration_s / time_constant_s)
    return Constant([phi, phi, phi, 1.0])


def observe(bank: Bank) -> Observation:
    """Return what a fix and a yaw with lasting errors are expected to be, and how surely."""
    x, P = bank
    expected = x[POSE] + x[_OBSERVED]
    expected[Component.YAW] += x[Component.YAW_OFFSET]
    HP = P[POSE] + P[_OBSERVED]
    HP[Component.YAW] += P[Component.YAW_OFFSET]
    HPH = HP[:, POSE] + HP[:, _OBSERVED]
    HPH[:, Component.YAW] += HP[:, Component.YAW_OFFSET]
    return Observation(expected=expected, covariance=HPH)


def at_pose(pose: Bank, error_variances: FloatArray, *, from_readings: bool) -> Bank:
    """Return filters at a pose, whose errors are as uncertain as in the long run.

    Args:
        pose: `(3, 1, *batch)`.
        error_variances: `(4, F, *batch)` variances of the errors (m^2, m^2, rad^2, rad^2).
        from_readings: whether the pose is of a fix and a yaw; it then has their errors.
    """
    shape = error_variances.shape[1:]
    mean, P = np.zeros((AUGMENTED_SIZE, *shape)), np.zeros((AUGMENTED_SIZE,) * 2 + shape)
    mean[POSE], P[POSE, POSE] = pose.mean, pose.covariance
    for place, variance in enumerate(error_variances):
        error, measured = STATE_SIZE + place, min(place, Component.YAW)
        P[error, error] = variance
        if from_readings:
            P[measured, measured] += variance
            P[measured, error] = P[error, measured] = -variance
    return Bank(mean, P)
