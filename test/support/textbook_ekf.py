# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""An extended Kalman filter as a textbook prints it; used by the tests only.

Written from the equations, not from the package: scalars and loops, rows that were not measured
are left out, S is inverted, the covariance update is P = P- - K H P-. The arc is in its radius
form, which needs a turn that is not too small.
"""

import math

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

STATE_OF_ROW = (0, 1, 2, 2)


def textbook_step(
    paper_model: bool,
    x: FloatArray,
    P: FloatArray,
    u: FloatArray,
    Q: FloatArray,
    z: FloatArray,
    R: FloatArray,
    rows: list[int],
) -> tuple[FloatArray, FloatArray]:
    """Return mean and covariance after one prediction and one correction.

    Args:
        paper_model: turn first, then drive straight (eq. 4); otherwise the arc.
        x: state [x, y, theta].
        P: its 3x3 covariance.
        u: [dS, dtheta].
        Q: 2x2 covariance of u.
        z: measurements of all four rows.
        R: their 4x4 covariance.
        rows: the rows that were measured.
    """
    way, turn = float(u[0]), float(u[1])
    px, py, heading = float(x[0]), float(x[1]), float(x[2])
    end = heading + turn
    if paper_model:
        dx, dy = way * math.cos(end), way * math.sin(end)
        by_heading = (-way * math.sin(end), way * math.cos(end))
        by_way = (math.cos(end), math.sin(end))
        by_turn = (-way * math.sin(end), way * math.cos(end))
    else:
        radius = way / turn
        over, up = math.sin(end) - math.sin(heading), math.cos(heading) - math.cos(end)
        dx, dy = radius * over, radius * up
        by_heading = (radius * (math.cos(end) - math.cos(heading)), radius * over)
        by_way = (over / turn, up / turn)
        by_turn = (
            radius * math.cos(end) - way * over / turn**2,
            radius * math.sin(end) - way * up / turn**2,
        )

    A = np.array([[1.0, 0.0, by_heading[0]], [0.0, 1.0, by_heading[1]], [0.0, 0.0, 1.0]])
    W = np.array([[by_way[0], by_turn[0]], [by_way[1], by_turn[1]], [0.0, 1.0]])
    predicted = np.array([px + dx, py + dy, end])
    P_minus = A @ P @ A.T + W @ Q @ W.T
    if not rows:
        return _with_plain_angle(predicted), P_minus

    n = len(rows)
    H, R_rows, r = np.zeros((n, 3)), np.zeros((n, n)), np.zeros(n)
    for i, row in enumerate(rows):
        state = STATE_OF_ROW[row]
        H[i, state] = 1.0
        r[i] = z[row] - predicted[state]
        if state == 2:
            r[i] = math.atan2(math.sin(r[i]), math.cos(r[i]))
        for j, other in enumerate(rows):
            R_rows[i, j] = R[row, other]

    K = P_minus @ H.T @ np.linalg.inv(H @ P_minus @ H.T + R_rows)
    return _with_plain_angle(predicted + K @ r), P_minus - K @ H @ P_minus


def _with_plain_angle(x: FloatArray) -> FloatArray:
    return np.array([x[0], x[1], math.atan2(math.sin(x[2]), math.cos(x[2]))])
