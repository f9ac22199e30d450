# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The noise of a plain EKF on a robot whose errors last.

An EKF that takes all errors for white has no right noise there. The best it can have brings its
poses nearest to the true ones, of which those of the filter that follows lasting errors are the
best guess. With d the difference of both filters in x, y and yaw at each epoch, and P and P_l the
variances that they claim,

    minimize sum (d_x^2 + d_y^2 + c d_yaw^2) over Q and R,   c = sum (P_l,x + P_l,y) / sum P_l,yaw

up to a common factor of Q and R, which does not change the poses. The factor is

    sum (d_x^2 + d_y^2 + P_l,x + P_l,y) / sum (P_x + P_y)

so that the EKF claims, on average, the error that it has: where it is not the better filter, its
error is d plus the other one's, and these are about independent.
"""

from collections.abc import Sequence

import numpy as np

from fnn_ekf_ros.core.angles import wrap_angle
from fnn_ekf_ros.core.arrays import FloatArray
from fnn_ekf_ros.tuning.fit import Progress
from fnn_ekf_ros.tuning.forecasts import Poses, poses
from fnn_ekf_ros.tuning.objective import star
from fnn_ekf_ros.tuning.quantities import (
    LASTING,
    STEPS,
    Quantity,
    bounds,
    coordinates,
    with_coordinates,
)
from fnn_ekf_ros.tuning.recording import TuningRecording
from fnn_ekf_ros.tuning.search import Point, maximize

_COUNTS = 2000.0
"""Number of independent epochs that all count as: it only says when the search ends."""
BEGINNINGS: FloatArray = np.log([0.1, 0.3, 1.0, 3.0])
"""Log factors on the standard deviations of Q to begin with; the best one is taken."""


def plain_noise(
    recordings: Sequence[TuningRecording],
    lasting: FloatArray,
    noise: tuple[Quantity, ...],
    progress: Progress,
) -> FloatArray:
    """Return values `(16,)` of the EKF that takes all errors for white.

    Args:
        recordings: of the robot.
        lasting: `(16,)` values of the model with lasting errors.
        noise: quantities of noise that there are sensors for.
        progress: is told about each pass.
    """
    wanted = [poses(recording, lasting[:, None]) for recording in recordings]
    base = _without_lasting(lasting)
    variance = np.sum([best.variance.sum(axis=(0, 2)) for best in wanted], axis=0)
    scale = np.array([1.0, 1.0, np.sqrt((variance[0] + variance[1]) / variance[2])])[:, None]
    which = tuple(quantity for quantity in noise if quantity is not Quantity.POSITION)
    of_wheels = np.isin(which, [Quantity.DISTANCE, Quantity.ROTATION])
    steps = STEPS[list(which)]

    def misses(models: FloatArray) -> list[FloatArray]:
        progress("plain EKF")
        return [
            scale * _difference(poses(recording, models), best)
            for recording, best in zip(recordings, wanted, strict=True)
        ]

    def at(u: FloatArray) -> Point:
        d = np.concatenate([each.reshape(-1, 1 + 2 * len(which)) for each in misses(
            star(base, which, u)
        )])  # fmt: skip
        mean_square = float(np.mean(d[:, 0] ** 2))
        slope = (d[:, 1::2] - d[:, 2::2]) / (2.0 * steps)
        weight = _COUNTS / (len(d) * mean_square)
        return Point(
            value=-_COUNTS * 0.5 * np.log(mean_square),
            gradient=-weight * (slope.T @ d[:, 0]),
            information=weight * (slope.T @ slope),
        )

    center = coordinates(base, which)
    begin = center[:, None] + np.outer(of_wheels, BEGINNINGS)
    first = misses(with_coordinates(base, which, begin))
    total = np.sum([(d**2).sum(axis=(0, 1)) for d in first], axis=0)
    u = maximize(at, bounds(which), begin[:, int(np.argmin(total))]).coordinate
    values = with_coordinates(base, which, u[:, None])[:, 0]
    values[list(noise)] *= np.sqrt(_factor(recordings, values, wanted))
    return values


def _difference(one: Poses, other: Poses) -> FloatArray:
    """Return the difference of poses, `(T, 3, S)` (m, m, rad)."""
    d = one.mean - other.mean
    d[:, 2] = wrap_angle(d[:, 2])
    return d


def _without_lasting(lasting: FloatArray) -> FloatArray:
    """Return a model whose white errors are as large as all errors together."""
    base = lasting.copy()
    base[Quantity.POSITION] = np.hypot(lasting[Quantity.POSITION], lasting[Quantity.FIX_ERROR])
    for yaw in (Quantity.COMPASS, Quantity.FIX_YAW):
        base[yaw] = np.hypot(lasting[yaw], lasting[Quantity.YAW_ERROR])
    base[[*LASTING, Quantity.YAW_CONSTANT]] = 0.0, 1.0, 0.0, 1.0, 0.0
    return base


def _factor(
    recordings: Sequence[TuningRecording], values: FloatArray, wanted: Sequence[Poses]
) -> float:
    """Return the factor on all variances by which a filter claims the error that it has."""
    error = claimed = 0.0
    for recording, best in zip(recordings, wanted, strict=True):
        own = poses(recording, values[:, None])
        error += float((_difference(own, best)[:, :2] ** 2).sum() + best.variance[:, :2].sum())
        claimed += float(own.variance[:, :2].sum())
    return error / claimed
