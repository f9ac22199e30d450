# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The robot that all rows use: its geometry, and a drive of it as arrays."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
"""Array of double precision numbers."""

GEOMETRY: dict[str, Any] = {
    "wheel_radius": 0.025,
    "wheel_separation": 0.6,
    "encoder_counts_per_revolution": 500.0,
}
"""Parameters of the localizer that have no usable default."""
PERIOD_S = 0.375
"""The filter's period [s]."""
SLIP_STD = (0.05, 0.05235987755982989)
"""Of distance and rotation for 375 ms; the localizer's default Q (m, rad)."""
MEASUREMENT_STD = (0.1, 0.1, 0.1341640786499874, 0.1341640786499874)
"""Of x, y, compass yaw and the fix's yaw; the localizer's default R (m, m, rad, rad)."""
SPEED, LAP_S = 0.3, 40.0
"""The robot drives figures of eight, a lap to each side (m/s, s)."""


class Drive(NamedTuple):
    """A drive; T steps, n robots.

    Attributes:
        truth: `(T + 1, n, 3)` true poses, the start first (m, m, rad; map frame).
        control: `(T, n, 2)` [distance, rotation] from the encoders (m, rad).
        measurement: `(T, n, 4)` x, y, compass yaw, fix yaw at the end of each step.
    """

    truth: FloatArray
    control: FloatArray
    measurement: FloatArray


def drive(steps: int, robots: int, step_s: float, seed: int) -> Drive:
    """Drive a batch of robots on figures of eight.

    Args:
        steps: T.
        robots: n.
        step_s: length of a step [s].
        seed: of slip and noise.
    """
    rng = np.random.default_rng(seed)
    lap = np.arange(steps) * step_s // LAP_S
    rotation = 2.0 * np.pi / LAP_S * np.where(lap % 2 == 0, 1.0, -1.0)
    control = np.empty((steps, robots, 2))
    control[..., 0] = SPEED * step_s
    control[..., 1] = rotation[:, None] * step_s
    slip = np.asarray(SLIP_STD) * np.sqrt(step_s / PERIOD_S)
    moved = control + slip * rng.standard_normal(control.shape)
    yaw = np.concatenate([np.zeros((1, robots)), np.cumsum(moved[..., 1], axis=0)])
    direction = yaw[:-1] + 0.5 * moved[..., 1]
    step = moved[..., :1] * np.stack([np.cos(direction), np.sin(direction)], axis=-1)
    position = np.concatenate([np.zeros((1, robots, 2)), np.cumsum(step, axis=0)])
    truth = np.concatenate([position, yaw[..., None]], axis=-1)
    z = truth[1:, :, [0, 1, 2, 2]]
    z = z + np.asarray(MEASUREMENT_STD) * rng.standard_normal(z.shape)
    truth[..., 2], z[..., 2:] = wrapped(truth[..., 2]), wrapped(z[..., 2:])
    return Drive(truth=truth, control=control, measurement=z)


def wrapped(angle: FloatArray) -> FloatArray:
    """Return angles in [-pi, pi) [rad]."""
    return np.asarray((angle + np.pi) % (2.0 * np.pi) - np.pi)
