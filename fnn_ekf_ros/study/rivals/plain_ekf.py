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

from typing import NamedTuple

import numpy as np

from fnn_ekf_ros.core.arrays import STATE_OF_ROW, STATE_SIZE, FloatArray
from fnn_ekf_ros.core.pace import NOMINAL_PERIOD_S
from fnn_ekf_ros.study.instants import TimedRecording
from fnn_ekf_ros.study.recording import Start

SMALL_HALF_TURN = 1e-4
"""Half rotation below which the derivative of the chord is its series' first term [rad]: the
quotient would lose its digits."""
YAW = STATE_SIZE - 1
"""Component of the state that is an angle."""


class Moved(NamedTuple):
    """The motion of n robots.

    Attributes:
        mean: `(n, 3)` x- (m, m, rad), the yaw not wrapped.
        A: `(n, 3, 3)` its derivative by x.
        W: `(n, 3, 2)` its derivative by u.
    """

    mean: FloatArray
    A: FloatArray
    W: FloatArray


class Corrected(NamedTuple):
    """An estimate after a measurement.

    Attributes:
        mean: `(n, s)` x, the yaw wrapped.
        covariance: `(n, s, s)` P.
        nis: `(n,)` r' S^-1 r.
    """

    mean: FloatArray
    covariance: FloatArray
    nis: FloatArray


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
        x, A, W = move(x, recording.control[k].T)
        P = A @ P @ transposed(A) + W @ Q @ transposed(W) * duration_s / NOMINAL_PERIOD_S
        rows = np.flatnonzero(recording.available[k])
        if len(rows):
            H = np.eye(STATE_SIZE)[[STATE_OF_ROW[row] for row in rows]]
            z = recording.measurement[k].T[:, rows]
            x, P, _ = correct(x, P, z, H, R[np.ix_(rows, rows)])
        if recording.ends_period[k]:
            means.append(x)
            covariances.append(P)
    return np.array(means), np.array(covariances)


def move(x: FloatArray, u: FloatArray) -> Moved:
    """Return the motion of poses x `(n, 3)` by the wheels' u `(n, 2)`."""
    s, w = u[:, 0], u[:, 1]
    half = 0.5 * w
    ratio = np.sinc(half / np.pi)  # sin(half) / half
    small = np.abs(half) < SMALL_HALF_TURN
    divisor = np.where(small, 1.0, half)
    ratio_slope = np.where(small, -half / 3.0, (np.cos(half) - ratio) / divisor)
    chord, chord_by_w = s * ratio, 0.5 * s * ratio_slope
    cos, sin = np.cos(x[:, YAW] + half), np.sin(x[:, YAW] + half)

    A = np.tile(np.eye(STATE_SIZE), (len(x), 1, 1))
    A[:, 0, 2], A[:, 1, 2] = -chord * sin, chord * cos
    W = np.zeros((len(x), STATE_SIZE, 2))
    W[:, 0, 0], W[:, 1, 0] = ratio * cos, ratio * sin
    W[:, 0, 1] = chord_by_w * cos - 0.5 * chord * sin
    W[:, 1, 1] = chord_by_w * sin + 0.5 * chord * cos
    W[:, 2, 1] = 1.0
    return Moved(x + np.stack([chord * cos, chord * sin, w], axis=-1), A, W)


def correct(x: FloatArray, P: FloatArray, z: FloatArray, H: FloatArray, R: FloatArray) -> Corrected:
    """Return x and P after a measurement z = H x + N(0, R).

    Args:
        x: `(n, s)` mean; the first three components are the pose.
        P: `(n, s, s)` its covariance.
        z: `(n, m)` measured rows; those that measure the yaw are angles.
        H: `(m, s)`.
        R: `(m, m)`.
    """
    r = z - x @ H.T
    r = np.where(H[:, YAW] != 0.0, _plain_angle(r), r)
    S_inverse = np.linalg.inv(H @ P @ H.T + R)
    K = P @ H.T @ S_inverse
    x = x + (K @ r[:, :, None])[:, :, 0]
    x[:, YAW] = _plain_angle(x[:, YAW])
    rest = np.eye(len(H.T)) - K @ H
    return Corrected(
        mean=x,
        covariance=rest @ P @ transposed(rest) + K @ R @ transposed(K),
        nis=np.einsum("ni,nij,nj->n", r, S_inverse, r),
    )


def transposed(matrices: FloatArray) -> FloatArray:
    """Return the transposes of matrices `(n, i, j)`."""
    return matrices.transpose(0, 2, 1)


def _plain_angle(angle: FloatArray) -> FloatArray:
    return np.asarray(np.arctan2(np.sin(angle), np.cos(angle)))
