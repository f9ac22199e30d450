# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The same EKF as a user of filterpy writes it: 3 states, 4 measured rows, yaws wrapped."""

from math import cos, pi, sin
from typing import Any

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter

from bench.robot import MEASUREMENT_STD, SLIP_STD, FloatArray

H = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, 1.0]])
"""Measurement matrix: x, y, and yaw twice."""
Q = np.diag(np.square(SLIP_STD))
"""Process noise of a period (m^2, rad^2)."""


class RobotEkf(ExtendedKalmanFilter):  # type: ignore[misc]
    """filterpy's EKF on exact arcs; scalars by `math`, which is faster than numpy for one robot."""

    def __init__(self, mean: FloatArray, covariance: FloatArray) -> None:
        super().__init__(dim_x=3, dim_z=4)
        self.x, self.P = mean.copy(), covariance.copy()
        self.R = np.diag(np.square(MEASUREMENT_STD))

    def predict_x(self, u: Any = 0) -> None:
        """Move the state along an arc; set F = df/dx and Q = W Q W' for `predict`."""
        x, y, yaw = self.x
        distance, rotation = u
        half = 0.5 * rotation
        if abs(half) < 1e-4:
            sinc, slope = 1.0 - half * half / 6.0, -half / 3.0
        else:
            sinc = sin(half) / half
            slope = (cos(half) - sinc) / half
        c, s = cos(yaw + half), sin(yaw + half)
        dx, dy = distance * sinc * c, distance * sinc * s
        along = 0.5 * distance * slope
        self.x = np.array([x + dx, y + dy, yaw + rotation])
        self.F = np.array([[1.0, 0.0, -dy], [0.0, 1.0, dx], [0.0, 0.0, 1.0]])
        W = np.array([
            [sinc * c, along * c - 0.5 * dy], [sinc * s, along * s + 0.5 * dx], [0.0, 1.0]
        ])  # fmt: skip
        self.Q = W @ Q @ W.T

    def step(self, control: FloatArray, measurement: FloatArray) -> FloatArray:
        """Predict and update; return the mean."""
        self.predict(control.tolist())
        self.update(measurement, jacobian, expected, residual=difference)
        self.x[2] = (self.x[2] + pi) % (2.0 * pi) - pi
        return np.asarray(self.x)


def jacobian(_: FloatArray) -> FloatArray:
    """Return H."""
    return H


def expected(x: FloatArray) -> FloatArray:
    """Return what the sensors should measure."""
    return x[[0, 1, 2, 2]]


def difference(z: FloatArray, of_state: FloatArray) -> FloatArray:
    """Return the innovation, yaws in [-pi, pi)."""
    r = z - of_state
    r[2:] = (r[2:] + pi) % (2.0 * pi) - pi
    return r
