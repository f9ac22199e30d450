# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Initialization: no estimate until both wheels, x, y and yaw are known.

A given pose replaces x, y and yaw: it holds until both wheels have sent a reading, and the filter
starts from it with the period in which they do. When the filter starts thus depends on stamps
alone, and no variance grows before the robot can have moved.
"""

from typing import NamedTuple

import numpy as np

from fnn_ekf_ros.core.angles import wrap_angle
from fnn_ekf_ros.core.arrays import FloatArray, Row
from fnn_ekf_ros.core.motion import move
from fnn_ekf_ros.core.pace import NOMINAL_PERIOD_S
from fnn_ekf_ros.core.results import Epoch
from fnn_ekf_ros.core.rows import FIX_ROWS
from fnn_ekf_ros.core.state import FilterModel, FilterState, start_filter


class AwaitingStart(NamedTuple):
    """Measurements before the filter can start, carried by the wheels.

    Attributes:
        process_noise: `(2,)` Q to start with (m^2, rad^2).
        measurement_noise: `(4,)` R to start with.
        log_weight: `(H, M)` log weights of the members of lasting errors; None: the prior's.
        position: `(2,)` the last fix [m]; None before the first.
        position_variance: `(2, 2)` its covariance [m^2].
        since_fix: `(3,)` pose relative to the robot's pose at the fix (m, m, rad).
        yaw: the last yaw, carried [rad]; None before the first.
        yaw_variance: its variance [rad^2].
        given_pose: `(3,)` pose to start from (m, m, rad); None to wait for measurements.
        given_covariance: `(3, 3)` its covariance.
    """

    process_noise: FloatArray
    measurement_noise: FloatArray
    log_weight: FloatArray | None = None
    position: FloatArray | None = None
    position_variance: FloatArray = np.zeros((2, 2))
    since_fix: FloatArray = np.zeros(3)
    yaw: float | None = None
    yaw_variance: float = 0.0
    given_pose: FloatArray | None = None
    given_covariance: FloatArray = np.zeros((3, 3))


def wait(model: FilterModel, waiting: AwaitingStart, epoch: Epoch) -> AwaitingStart | FilterState:
    """Take one epoch in; return the started filter as soon as x, y and yaw are known.

    The start's covariance is R, plus Q for the time over which a measurement had to be carried.

    Args:
        model: the filter.
        waiting: before the epoch.
        epoch: the time until the next readings, with these.
    """
    waiting = _with_readings(_carried(model, waiting, epoch), epoch)
    if waiting.position is None or waiting.yaw is None:
        return waiting
    yaw_at_fix = waiting.yaw - waiting.since_fix[2]
    c, s = np.cos(yaw_at_fix), np.sin(yaw_at_fix)
    x, y = waiting.position + np.array([[c, -s], [s, c]]) @ waiting.since_fix[:2]
    covariance = np.zeros((3, 3))
    covariance[:2, :2] = waiting.position_variance
    covariance[2, 2] = waiting.yaw_variance
    return start_filter(
        model,
        np.array([x, y, float(wrap_angle(waiting.yaw))]),
        covariance,
        waiting.process_noise,
        waiting.measurement_noise,
        from_readings=True,
        log_weight=waiting.log_weight,
    )


def _carried(model: FilterModel, waiting: AwaitingStart, epoch: Epoch) -> AwaitingStart:
    """Return the measurements, carried over an epoch by the wheels."""
    distance, rotation = np.asarray(waiting.process_noise) * (epoch.duration_s / NOMINAL_PERIOD_S)
    if waiting.position is not None:
        waiting = waiting._replace(
            since_fix=move(model.motion_model, waiting.since_fix, epoch.control).mean,
            position_variance=waiting.position_variance + distance * np.eye(2),
        )
    if waiting.yaw is not None:
        waiting = waiting._replace(
            yaw=waiting.yaw + float(epoch.control[1]),
            yaw_variance=waiting.yaw_variance + float(rotation),
        )
    return waiting


def _with_readings(waiting: AwaitingStart, epoch: Epoch) -> AwaitingStart:
    """Return the measurements with the readings at the end of an epoch."""
    R, reported = np.diag(waiting.measurement_noise), epoch.fix_covariance
    if reported is not None:
        R[np.ix_(FIX_ROWS, FIX_ROWS)] = reported
    if epoch.available[Row.X] and epoch.available[Row.Y]:
        waiting = waiting._replace(
            position=epoch.measurement[[Row.X, Row.Y]],
            position_variance=R[:2, :2],
            since_fix=np.zeros(3),
        )
    yaw_rows = [row for row in (Row.COMPASS_YAW, Row.LRF_YAW) if epoch.available[row]]
    if yaw_rows:
        row = yaw_rows[0]
        waiting = waiting._replace(
            yaw=float(epoch.measurement[row]), yaw_variance=float(R[row, row])
        )
    return waiting
