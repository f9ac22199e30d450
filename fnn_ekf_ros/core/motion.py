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
of (x', y') with respect to dtheta. Components come first, then filters and batch.

W Q W' puts the noise of a step at its end. A step that is cut in two has noise in its middle as
well, which the rest of the way turns into a little more position variance sideways: at 0.3 m/s and
3 degrees a period, 3.3 instead of 2.9 mm (standard deviation). Both are approximations of noise
that is spread evenly over the way.
"""

from enum import StrEnum
from typing import NamedTuple

import numpy as np

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
        mean: `(3, ...)` state after the step (m, m, rad; the heading is not wrapped).
        by_heading: `(2, ...)` derivative of (x', y') by the heading, [-dy, dx].
        by_way: `(2, ...)` derivative of (x', y') by dS.
        by_turn: `(2, ...)` derivative of (x', y') by dtheta.
    """

    mean: FloatArray
    by_heading: FloatArray
    by_way: FloatArray
    by_turn: FloatArray

    def motion_jacobian(self) -> FloatArray:
        """Return A = df/dx, `(3, 3, ...)`."""
        A = np.zeros((3, *self.mean.shape))
        A[0, 0] = A[1, 1] = A[2, 2] = 1.0
        A[:2, 2] = self.by_heading
        return A

    def noise_jacobian(self) -> FloatArray:
        """Return W = df/du, `(3, 2, ...)`."""
        W = np.zeros((3, 2, *self.mean.shape[1:]))
        W[:2, 0], W[:2, 1], W[2, 1] = self.by_way, self.by_turn, 1.0
        return W


def sinc(h: FloatArray) -> FloatArray:
    """Return sin(h)/h, 1 at zero; any shape [rad]."""
    return _sinc_and_derivative(h)[0]


def sinc_derivative(h: FloatArray) -> FloatArray:
    """Return d/dh sin(h)/h = (cos h - sinc h)/h, 0 at zero; any shape [rad]."""
    return _sinc_and_derivative(h)[1]


def _sinc_and_derivative(h: FloatArray) -> tuple[FloatArray, FloatArray]:
    small = abs(h) < _SERIES_LIMIT
    if not small.any():
        value = np.sin(h) / h
        return value, (np.cos(h) - value) / h
    h2 = h * h
    series = 1.0 - h2 / 6.0 * (1.0 - h2 / 20.0 * (1.0 - h2 / 42.0))
    slope = -h / 3.0 * (1.0 - h2 / 10.0 * (1.0 - h2 / 28.0 * (1.0 - h2 / 54.0)))
    if small.all():
        return series, slope
    safe = np.where(small, 1.0, h)
    value = np.sin(safe) / safe
    return np.where(small, series, value), np.where(small, slope, (np.cos(safe) - value) / safe)


def displacement(model: MotionModel, heading: FloatArray, control: FloatArray) -> FloatArray:
    """Return how far a step moves the robot in the map frame.

    Args:
        model: the motion model.
        heading: `(...)` heading before the step [rad].
        control: `(2, ...)` [dS, dtheta] (m, rad).

    Returns:
        `(3, ...)`: [dx, dy, dtheta] (m, m, rad).
    """
    heading, way, turn = np.broadcast_arrays(heading, control[0], control[1])
    if model is MotionModel.PAPER:
        chord, direction = way, heading + turn
    else:
        chord, direction = way * sinc(0.5 * turn), heading + 0.5 * turn
    return np.stack([chord * np.cos(direction), chord * np.sin(direction), turn])


def move(model: MotionModel, mean: FloatArray, control: FloatArray) -> Motion:
    """Return the state after one step and the Jacobians there (eqs. 4, 7 and 8).

    Args:
        model: the motion model.
        mean: `(3, ...)` [x, y, theta] before the step (m, m, rad).
        control: `(2, ...)` [dS, dtheta] (m, rad), for all filters the same: it broadcasts against
            the trailing dimensions of `mean`.
    """
    way, turn = control[0], control[1]
    direction, after = np.empty((2, *mean.shape[1:])), np.empty(mean.shape)
    after[2] = mean[2] + turn
    if model is MotionModel.PAPER:
        direction[0], direction[1] = np.cos(after[2]), np.sin(after[2])
        by_way, moved = direction, way * direction
        by_turn = by_heading = _turned_left(moved)
    else:
        half = 0.5 * turn
        scale, slope = _sinc_and_derivative(half)
        middle = mean[2] + half
        direction[0], direction[1] = np.cos(middle), np.sin(middle)
        by_way = scale * direction
        moved = way * by_way
        by_heading = _turned_left(moved)
        by_turn = (0.5 * way * slope) * direction
        by_turn += 0.5 * by_heading
    after[:2] = mean[:2] + moved
    return Motion(after, by_heading, by_way, by_turn)


def _turned_left(vector: FloatArray) -> FloatArray:
    """Return vectors `(2, ...)` turned by a right angle, counter-clockwise."""
    turned = np.empty_like(vector)
    turned[0], turned[1] = -vector[1], vector[0]
    return turned
