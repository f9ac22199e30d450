# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Simulated robots whose fixes and compass have errors that last, for tests of the core."""

import math
from typing import Any, NamedTuple

import numpy as np
from drives import TRUE_Q, TRUE_R

from fnn_ekf_ros.core.arrays import FloatArray
from fnn_ekf_ros.core.filter import fuse
from fnn_ekf_ros.core.motion import MotionModel, displacement
from fnn_ekf_ros.core.pace import NOMINAL_PERIOD_S
from fnn_ekf_ros.core.results import Epoch
from fnn_ekf_ros.core.state import FilterModel, FilterState, start_filter

START_COVARIANCE = np.diag([0.01, 0.01, 0.018])
WHEEL_SEPARATION = 0.6
"""Distance between the wheels of a robot with a stuck one [m]."""
FIX_AND_COMPASS = np.array([True, True, True, False])


class Errors(NamedTuple):
    """Errors that last, of all robots of a drive.

    Attributes:
        fix_std: of x and y [m].
        fix_s: their time constant [s].
        offset: of the compass [rad].
        turned: by which the compass is turned [rad].
        turned_at: the step before which it is.
        stuck_at: the step from which on the left wheel's counter stands still; 0: it does not.
    """

    fix_std: float = 0.0
    fix_s: float = 10.0
    offset: float = 0.0
    turned: float = 0.0
    turned_at: int = 0
    stuck_at: int = 0


class Track(NamedTuple):
    """Estimates of a drive: time first, then components, then robots."""

    error: FloatArray
    nees: FloatArray
    states: list[FilterState]


def lasting_drive(
    seed: int, robots: int, steps: int, errors: Errors
) -> list[tuple[Epoch, FloatArray]]:
    """Return robots on a bent path, with a fix and a compass reading each 375 ms, and the truth."""
    rng = np.random.default_rng(seed)
    rows = np.repeat(FIX_AND_COMPASS[:, None], robots, axis=1)
    truth, offset = np.zeros((3, robots)), errors.offset
    b = errors.fix_std * rng.standard_normal((2, robots))
    phi, found = math.exp(-NOMINAL_PERIOD_S / errors.fix_s), []
    for i in range(steps):
        control = np.repeat([[0.11], [0.03 + 0.05 * math.sin(0.05 * i)]], robots, axis=1)
        driven = control + np.sqrt(TRUE_Q)[:, None] * rng.standard_normal((2, robots))
        truth = truth + displacement(MotionModel.EXACT_ARC, truth[2], driven)
        b = phi * b
        b += math.sqrt(1.0 - phi**2) * errors.fix_std * rng.standard_normal((2, robots))
        if errors.turned and i == errors.turned_at:
            offset += errors.turned
        z = truth[[0, 1, 2, 2]] + np.sqrt(TRUE_R)[:, None] * rng.standard_normal((4, robots))
        z[:2] += b
        z[2] += offset
        if errors.stuck_at and i >= errors.stuck_at:
            right = control[0] + 0.5 * WHEEL_SEPARATION * control[1]
            control = np.stack([0.5 * right, right / WHEEL_SEPARATION])
        found.append((Epoch(control, NOMINAL_PERIOD_S, z, rows), truth))
    return found


def tracked(
    model: FilterModel, drive: list[tuple[Epoch, FloatArray]], start_yaw: float = 0.0, **noise: Any
) -> Track:
    """Run a filter that starts at the origin, from readings."""
    robots = drive[0][1].shape[1]
    start = np.zeros((3, robots))
    start[2] = start_yaw
    state = start_filter(model, start, START_COVARIANCE, from_readings=True, **noise)
    errors, nees, states = [], [], []
    for epoch, truth in drive:
        state, _ = fuse(model, state, epoch)
        error = state.mean - truth
        error[2] = np.arctan2(np.sin(error[2]), np.cos(error[2]))
        white = np.linalg.solve(state.covariance.T, error.T[..., None])[..., 0].T
        errors.append(error)
        nees.append((error * white).sum(axis=0))
        states.append(state)
    return Track(np.array(errors), np.array(nees), states)


def rms(error: FloatArray) -> FloatArray:
    """Return the root mean squares over time and robots, `(3,)` (m, m, rad)."""
    return np.sqrt((error**2).mean(axis=(0, 2)))
