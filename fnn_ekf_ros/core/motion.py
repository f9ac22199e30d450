# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Motion models f(x, u) of the differential drive and their Jacobians (Nguyen et al., eqs. 4-8).

State x = [x, y, theta] (m, m, rad; in the map frame), control u = [dS, dtheta] (m, rad).

Exact arc (default): the robot drives on the arc that the increments describe,

    x' = x + dS sinc(dtheta/2) cos(theta + dtheta/2)
    y' = y + dS sinc(dtheta/2) sin(theta + dtheta/2)        sinc(h) = sin(h) / h
    theta' = theta + dtheta

Paper's model (eq. 4): first turns, then drives straight,

    x' = x + dS cos(theta + dtheta),  y' = y + dS sin(theta + dtheta),  theta' = theta + dtheta

whose lateral error is about dS dtheta / 2 in a turn; it is kept to reproduce the paper.

Jacobians, with d = direction of the step, dx = x' - x, dy = y' - y:

        | 1  0  -dy |        | s cos d   gx |
    A = | 0  1   dx |    W = | s sin d   gy |
        | 0  0    1 |        |    0       1 |

where s = sinc(dtheta/2) for the arc and 1 for the paper's model, and (gx, gy) is the derivative
of (x', y') with respect to dtheta. Components come first, then filters and batch.

W Q W' adds the noise of a step at its end. A step that is cut in two has noise in its middle as
well, which the second half turns into a slightly larger lateral variance: at 0.3 m/s and 3 degrees
a period the lateral standard deviation is 3.3 instead of 2.9 mm. Both are approximations of noise
that is spread evenly over the distance.
"""

from enum import StrEnum
from typing import NamedTuple

import numpy as np

from fnn_ekf_ros.core.arrays import FloatArray

_SERIES_LIMIT = 1e-2
"""Half angle below which power series replace the closed forms [rad]. Below it the series are exact
to double precision; above it cancellation costs the closed forms a relative error under 1e-11."""


class MotionModel(StrEnum):
    """The motion models a filter can use."""

    EXACT_ARC = "exact_arc"
    PAPER = "paper"


class Motion(NamedTuple):
    """One step of a motion model.

    Attributes:
        mean: `(3, ...)` state after the step (m, m, rad; the heading is not wrapped).
        by_heading: `(2, ...)` derivative of (x', y') with respect to theta, [-dy, dx].
        by_distance: `(2, ...)` derivative of (x', y') with respect to dS.
        by_rotation: `(2, ...)` derivative of (x', y') with respect to dtheta.
    """

    mean: FloatArray
    by_heading: FloatArray
    by_distance: FloatArray
    by_rotation: FloatArray

    def noise_jacobian(self) -> FloatArray:
        """Return W = df/du, `(3, 2, ...)`."""
        W = np.zeros((3, 2, *self.mean.shape[1:]))
        W[:2, 0], W[:2, 1], W[2, 1] = self.by_distance, self.by_rotation, 1.0
        return W


def sinc_and_derivative(h: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return sin(h)/h and its derivative (cos h - sinc h)/h; 1 and 0 at zero; any shape [rad]."""
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
    """Return the displacement of the robot by a step, in the map frame.

    Args:
        model: the motion model.
        heading: `(...)` heading before the step [rad].
        control: `(2, ...)` [dS, dtheta] (m, rad); broadcasts against `heading`.

    Returns:
        `(3, ...)`: [dx, dy, dtheta] (m, m, rad).
    """
    distance, rotation = control
    if model is MotionModel.PAPER:
        chord, direction = distance, heading + rotation
    else:
        half = 0.5 * rotation
        ratio, _ = sinc_and_derivative(half)
        chord, direction = distance * ratio, heading + half
    moved = np.empty((3, *direction.shape))
    moved[0], moved[1], moved[2] = chord * np.cos(direction), chord * np.sin(direction), rotation
    return moved


def move(model: MotionModel, mean: FloatArray, control: FloatArray) -> Motion:
    """Return the state after one step and the Jacobians there (eqs. 4, 7 and 8).

    Args:
        model: the motion model.
        mean: `(3, ...)` [x, y, theta] before the step (m, m, rad).
        control: `(2, ...)` [dS, dtheta] (m, rad), the same for all filters: it broadcasts against
            the trailing dimensions of `mean`.
    """
    distance, rotation = control
    direction, after = np.empty((2, *mean.shape[1:])), np.empty(mean.shape)
    after[2] = mean[2] + rotation
    if model is MotionModel.PAPER:
        direction[0], direction[1] = np.cos(after[2]), np.sin(after[2])
        by_distance, moved = direction, distance * direction
        by_rotation = by_heading = _turned_left(moved)
    else:
        half = 0.5 * rotation
        ratio, slope = sinc_and_derivative(half)
        middle = mean[2] + half
        direction[0], direction[1] = np.cos(middle), np.sin(middle)
        by_distance = ratio * direction
        moved = distance * by_distance
        by_heading = _turned_left(moved)
        by_rotation = (0.5 * distance * slope) * direction
        by_rotation += 0.5 * by_heading
    after[:2] = mean[:2] + moved
    return Motion(
        mean=after, by_heading=by_heading, by_distance=by_distance, by_rotation=by_rotation
    )


def _turned_left(vector: FloatArray) -> FloatArray:
    """Return vectors `(2, ...)` turned by a right angle, counter-clockwise."""
    turned = np.empty_like(vector)
    turned[0], turned[1] = -vector[1], vector[0]
    return turned
