# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""An EKF by its textbook equations, written apart from the package's own: the one to compare with.

It takes every reading at its instant and knows no periods. Matrices have their batch first and
`numpy.linalg` inverts S. Of the core it has the constants only. Per epoch, with s = dS and
w = dtheta of the wheels, c = s sin(w/2) / (w/2) the chord and d = theta + w/2 its direction:

    x- = x + c cos d,  y- = y + c sin d,  theta- = theta + w
    P- = A P A' + W Q W'                                   Q grows with the time of the epoch
    K = P- H' (H P- H' + R)^-1
    x = x- + K (z - H x-),  P = (I - K H) P- (I - K H)' + K R K'      (Joseph)

(Bar-Shalom, Li and Kirubarajan 2001, chapters 5 and 10; the motion is the arc's.)
"""

import numpy as np

from fnn_ekf_ros.core.arrays import STATE_OF_ROW, STATE_SIZE, FloatArray
from fnn_ekf_ros.core.pace import NOMINAL_PERIOD_S
from fnn_ekf_ros.study.instants import TimedRecording
from fnn_ekf_ros.study.recording import Start

SMALL_HALF_TURN = 1e-4
"""Half rotation below which the derivative of the chord is its series' first term [rad]: the
quotient would lose its digits."""


def run(recording: TimedRecording, start: Start) -> tuple[FloatArray, FloatArray]:
    """Run the filter over a recording.

    Args:
        recording: of n robots.
        start: `(n,)` starts; Q and R are those of the first robot.

    Returns:
        Means `(T, n, 3)` and covariances `(T, n, 3, 3)` at the ends of the periods.
    """
    Q, R = np.diag(start.process_noise[0]), np.diag(start.measurement_noise[0])
    x, P = start.mean.copy(), start.covariance.copy()
    means, covariances = [], []
    for k, duration_s in enumerate(recording.duration_s):
        x, P = _predict(x, P, recording.control[k].T, Q * duration_s / NOMINAL_PERIOD_S)
        rows = np.flatnonzero(recording.available[k])
        if len(rows):
            z = recording.measurement[k].T[:, rows]
            x, P = _correct(x, P, z, R[np.ix_(rows, rows)], [STATE_OF_ROW[row] for row in rows])
        if recording.ends_period[k]:
            means.append(x)
            covariances.append(P)
    return np.array(means), np.array(covariances)


def _predict(
    x: FloatArray, P: FloatArray, u: FloatArray, Q: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return x- and P-, of x `(n, 3)`, P `(n, 3, 3)`, u `(n, 2)` and Q `(2, 2)`."""
    s, w = u[:, 0], u[:, 1]
    half = 0.5 * w
    ratio = np.sinc(half / np.pi)  # sin(half) / half
    small = np.abs(half) < SMALL_HALF_TURN
    divisor = np.where(small, 1.0, half)
    ratio_slope = np.where(small, -half / 3.0, (np.cos(half) - ratio) / divisor)
    chord, chord_by_w = s * ratio, 0.5 * s * ratio_slope
    cos, sin = np.cos(x[:, 2] + half), np.sin(x[:, 2] + half)

    A = np.tile(np.eye(STATE_SIZE), (len(x), 1, 1))
    A[:, 0, 2], A[:, 1, 2] = -chord * sin, chord * cos
    W = np.zeros((len(x), STATE_SIZE, 2))
    W[:, 0, 0], W[:, 1, 0] = ratio * cos, ratio * sin
    W[:, 0, 1] = chord_by_w * cos - 0.5 * chord * sin
    W[:, 1, 1] = chord_by_w * sin + 0.5 * chord * cos
    W[:, 2, 1] = 1.0
    moved = x + np.stack([chord * cos, chord * sin, w], axis=-1)
    return moved, A @ P @ A.transpose(0, 2, 1) + W @ Q @ W.transpose(0, 2, 1)


def _correct(
    x: FloatArray, P: FloatArray, z: FloatArray, R: FloatArray, measured: list[int]
) -> tuple[FloatArray, FloatArray]:
    """Return x and P after rows z `(n, m)` with R `(m, m)` of these m components of the state."""
    H = np.eye(STATE_SIZE)[measured]
    r = z - x @ H.T
    angle = np.array(measured) == STATE_SIZE - 1
    r = np.where(angle, _plain_angle(r), r)
    K = P @ H.T @ np.linalg.inv(H @ P @ H.T + R)
    x = x + (K @ r[:, :, None])[:, :, 0]
    x[:, 2] = _plain_angle(x[:, 2])
    rest = np.eye(STATE_SIZE) - K @ H
    return x, rest @ P @ rest.transpose(0, 2, 1) + K @ R @ K.transpose(0, 2, 1)


def _plain_angle(angle: FloatArray) -> FloatArray:
    return np.asarray(np.arctan2(np.sin(angle), np.cos(angle)))
