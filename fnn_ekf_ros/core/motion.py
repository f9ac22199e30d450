"""Motion models f(x, u) of the differential drive and their Jacobians (Nguyen et al., eqs. 4-8).

State x = [x, y, theta] (m, m, rad; in the map frame), control u = [dS, dtheta] (m, rad).

Exact arc (default): the robot drives on the arc that the increments describe,

    x' = x + dS sinc(dtheta/2) cos(theta + dtheta/2)
    y' = y + dS sinc(dtheta/2) sin(theta + dtheta/2)        sinc(h) = sin(h) / h
    theta' = theta + dtheta

Paper's model (eq. 4): first turns, then drives straight,

    x' = x + dS cos(theta + dtheta),  y' = y + dS sin(theta + dtheta),  theta' = theta + dtheta

which is off sideways by about dS dtheta / 2 in a turn; it is kept to reproduce the paper.

Jacobians, with d = direction of the step, dx = x' - x, dy = y' - y:

        | 1  0  -dy |        | s cos d   gx |
    A = | 0  1   dx |    W = | s sin d   gy |
        | 0  0    1 |        |    0       1 |

where s = sinc(dtheta/2) for the arc and 1 for the paper's model, and (gx, gy) is the derivative
of (x', y') with respect to dtheta.
"""

from enum import StrEnum
from typing import NamedTuple

import numpy as np

from fnn_ekf_ros.core.angles import wrap_angle
from fnn_ekf_ros.core.arrays import FloatArray

# Below this half angle the power series are exact to double precision; above it the closed
# forms lose nothing to cancellation that matters (relative error under 1e-11).
_SERIES_LIMIT = 1e-2


class MotionModel(StrEnum):
    """The motion models a filter can use."""

    EXACT_ARC = "exact_arc"
    PAPER = "paper"


class Motion(NamedTuple):
    """One step of a motion model.

    Attributes:
        mean: `(..., 3)` state after the step (m, m, rad in (-pi, pi]).
        motion_jacobian: `(..., 3, 3)` A = df/dx.
        noise_jacobian: `(..., 3, 2)` W = df/du.
    """

    mean: FloatArray
    motion_jacobian: FloatArray
    noise_jacobian: FloatArray


def sinc(h: FloatArray) -> FloatArray:
    """Return sin(h)/h, 1 at zero; any shape [rad]."""
    h2 = h * h
    series = 1.0 - h2 / 6.0 * (1.0 - h2 / 20.0 * (1.0 - h2 / 42.0))
    safe = np.where(np.abs(h) < _SERIES_LIMIT, 1.0, h)
    return np.where(np.abs(h) < _SERIES_LIMIT, series, np.sin(safe) / safe)


def sinc_derivative(h: FloatArray) -> FloatArray:
    """Return d/dh sin(h)/h = (cos h - sinc h)/h, 0 at zero; any shape [rad]."""
    h2 = h * h
    series = -h / 3.0 * (1.0 - h2 / 10.0 * (1.0 - h2 / 28.0 * (1.0 - h2 / 54.0)))
    safe = np.where(np.abs(h) < _SERIES_LIMIT, 1.0, h)
    return np.where(np.abs(h) < _SERIES_LIMIT, series, (np.cos(safe) - np.sin(safe) / safe) / safe)


def displacement(model: MotionModel, heading: FloatArray, control: FloatArray) -> FloatArray:
    """Return how far a step moves the robot in the map frame.

    Args:
        model: the motion model.
        heading: `(...)` heading before the step [rad].
        control: `(..., 2)` [dS, dtheta] (m, rad).

    Returns:
        `(..., 3)`: [dx, dy, dtheta] (m, m, rad).
    """
    heading, way, turn = np.broadcast_arrays(heading, control[..., 0], control[..., 1])
    if model is MotionModel.PAPER:
        chord, direction = way, heading + turn
    else:
        chord, direction = way * sinc(0.5 * turn), heading + 0.5 * turn
    return np.stack([chord * np.cos(direction), chord * np.sin(direction), turn], axis=-1)


def move(model: MotionModel, mean: FloatArray, control: FloatArray) -> Motion:
    """Return the state after one step and the Jacobians there (eqs. 4, 7 and 8).

    Args:
        model: the motion model.
        mean: `(..., 3)` [x, y, theta] before the step (m, m, rad).
        control: `(..., 2)` [dS, dtheta] (m, rad); leading dimensions broadcast.
    """
    mean, control = np.broadcast_arrays(mean, np.concatenate([control, control[..., :1]], axis=-1))
    way, turn, heading = control[..., 0], control[..., 1], mean[..., 2]
    if model is MotionModel.PAPER:
        scale, direction = np.ones_like(way), heading + turn
        c, s = np.cos(direction), np.sin(direction)
        gx, gy = -way * s, way * c
    else:
        half = 0.5 * turn
        scale, direction = sinc(half), heading + half
        c, s = np.cos(direction), np.sin(direction)
        slope = 0.5 * way * sinc_derivative(half)
        lever = 0.5 * way * scale
        gx, gy = slope * c - lever * s, slope * s + lever * c
    dx, dy = way * scale * c, way * scale * s

    motion_jacobian = np.zeros((*mean.shape, 3))
    motion_jacobian[..., 0, 0] = 1.0
    motion_jacobian[..., 1, 1] = 1.0
    motion_jacobian[..., 2, 2] = 1.0
    motion_jacobian[..., 0, 2] = -dy
    motion_jacobian[..., 1, 2] = dx

    noise_jacobian = np.zeros((*mean.shape, 2))
    noise_jacobian[..., 0, 0] = scale * c
    noise_jacobian[..., 1, 0] = scale * s
    noise_jacobian[..., 0, 1] = gx
    noise_jacobian[..., 1, 1] = gy
    noise_jacobian[..., 2, 1] = 1.0

    moved = np.stack([mean[..., 0] + dx, mean[..., 1] + dy, wrap_angle(heading + turn)], axis=-1)
    return Motion(moved, motion_jacobian, noise_jacobian)
