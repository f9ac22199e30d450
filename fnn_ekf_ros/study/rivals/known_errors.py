# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""An EKF that knows how the errors of fixes and compass last: the one to compare with.

No filter can know this on a robot. Its state has the lasting errors beside the pose: b_x and b_y of
the fixes, a Gauss-Markov process each, and b_0, the constant offset of the compass. With the step
dt, the stationary standard deviation s and the time constant tau, all of them the true ones:

    b_x' = phi b_x + N(0, (1 - phi^2) s^2),  phi = exp(-dt / tau)         b_y likewise
    b_0' = b_0
    z = [x + b_x, y + b_y, theta + b_0] + N(0, R)

(Bar-Shalom, Li and Kirubarajan 2001, section 8.2: augmentation by colored measurement noise.) The
motion and the correction are those of `plain_ekf`. The pose at the start is independent of the
lasting errors: it was given, not measured.
"""

import math
from dataclasses import dataclass

import numpy as np

from fnn_ekf_ros.core.arrays import STATE_SIZE, FloatArray, Row
from fnn_ekf_ros.core.pace import NOMINAL_PERIOD_S
from fnn_ekf_ros.study.recording import Estimates, Recording, Start
from fnn_ekf_ros.study.rivals.plain_ekf import correct, move, transposed

ERROR_COUNT = 3
"""Number of lasting errors: b_x, b_y and b_0."""
SIZE = STATE_SIZE + ERROR_COUNT
"""Number of components of the state: x, y, theta, b_x, b_y, b_0."""
MEASURED = (Row.X, Row.Y, Row.COMPASS_YAW)
"""Rows that are measured, each with its lasting error."""
_H: FloatArray = np.hstack([np.eye(STATE_SIZE), np.eye(ERROR_COUNT)])
"""Measurement matrix: every row is a component of the pose plus its lasting error."""


@dataclass(frozen=True, slots=True)
class ErrorModel:
    """Model of the lasting errors.

    Attributes:
        fix_std: stationary standard deviation of b_x and b_y [m]; 0 for none.
        time_constant_s: tau of b_x and b_y [s].
        offset_std: standard deviation of b_0 before the first reading [rad]; 0 for none.
    """

    fix_std: float = 0.0
    time_constant_s: float = 1.0
    offset_std: float = 0.0

    def __post_init__(self) -> None:
        """Check the numbers.

        Raises:
            ValueError: one is out of its range.
        """
        if min(self.fix_std, self.offset_std) < 0.0 or not self.time_constant_s > 0.0:
            raise ValueError(f"{self}: expected standard deviations from 0 and a time above 0")

    def decay(self, duration_s: float) -> float:
        """Return phi of b_x and b_y over a time [s]."""
        return math.exp(-duration_s / self.time_constant_s)


def run(recording: Recording, start: Start, errors: ErrorModel) -> Estimates:
    """Run the filter over a recording.

    Args:
        recording: of n robots; its noise of each step is the one that the filter assumes.
        start: `(n,)` starts.
        errors: model of the lasting errors.

    Returns:
        `(T, n)` estimates of the pose.

    Raises:
        ValueError: other rows are measured than x, y and the compass's yaw.
    """
    if not (recording.available == np.isin(list(Row), MEASURED)).all():
        raise ValueError("rows are missing: expected x, y and a compass yaw at every step")
    runs = recording.control.shape[1]
    x, P = np.zeros((runs, SIZE)), np.zeros((runs, SIZE, SIZE))
    x[:, :STATE_SIZE], P[:, :STATE_SIZE, :STATE_SIZE] = start.mean, start.covariance
    variance = np.square([errors.fix_std, errors.fix_std, errors.offset_std])
    P[:, STATE_SIZE:, STATE_SIZE:] = np.diag(variance)
    phi = np.array([errors.decay(recording.period_s)] * 2 + [1.0])
    added = np.diag((1.0 - phi**2) * variance)
    steps = []
    for k, u in enumerate(recording.control):
        Q = np.diag(recording.process_noise[k]) * recording.period_s / NOMINAL_PERIOD_S
        R = np.diag(recording.measurement_noise[k, MEASURED])
        x, P = _predict(x, P, u, Q, phi, added)
        corrected = correct(x, P, recording.measurement[k][:, MEASURED], _H, R)
        x, P, _ = corrected
        steps.append(corrected)
    return Estimates(
        mean=np.stack([step.mean[:, :STATE_SIZE] for step in steps]),
        covariance=np.stack([step.covariance[:, :STATE_SIZE, :STATE_SIZE] for step in steps]),
        nis=np.stack([step.nis for step in steps]),
        degrees_of_freedom=np.full((len(steps), runs), float(len(MEASURED))),
    )


def _predict(
    x: FloatArray, P: FloatArray, u: FloatArray, Q: FloatArray, phi: FloatArray, added: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return x- `(n, 6)` and P- `(n, 6, 6)`.

    Args:
        x: `(n, 6)`.
        P: `(n, 6, 6)`.
        u: `(n, 2)` of the wheels.
        Q: `(2, 2)` of the step.
        phi: `(3,)` decay of the lasting errors in the step.
        added: `(3, 3)` variance that is added to them.
    """
    moved = move(x[:, :STATE_SIZE], u)
    F, G = np.zeros_like(P), np.zeros_like(P)
    F[:, :STATE_SIZE, :STATE_SIZE] = moved.A
    F[:, STATE_SIZE:, STATE_SIZE:] = np.diag(phi)
    G[:, :STATE_SIZE, :STATE_SIZE] = moved.W @ Q @ transposed(moved.W)
    G[:, STATE_SIZE:, STATE_SIZE:] = added
    return np.hstack([moved.mean, phi * x[:, STATE_SIZE:]]), F @ P @ transposed(F) + G
