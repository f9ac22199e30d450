# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Search for the largest objective: Fisher scoring with damping, within bounds."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from fnn_ekf_ros.core.arrays import FloatArray

MOST_PASSES = 15
"""Largest number of passes over the recordings per search; most take ten."""
ENOUGH = 0.02
"""Predicted gain of a step below which the search ends [nats]: a fiftieth of what could be told."""
_LEAST_DAMPING, _MOST_DAMPING = 1e-6, 1e6
"""Range of the damping, in parts of the information's diagonal; beyond it nothing is gained."""
_LARGEST_STEP = 1.0
"""Largest step of a coordinate: a factor of e in a standard deviation."""


Limits = tuple[FloatArray, FloatArray]
"""Smallest and largest coordinates, `(p,)` each."""


class Point(NamedTuple):
    """What is maximized, at coordinates `(p,)`.

    Attributes:
        value: of it [nats].
        gradient: `(p,)`.
        information: `(p, p)` expected curvature.
    """

    value: float
    gradient: FloatArray
    information: FloatArray


At = Callable[[FloatArray], Point]
"""What is maximized, by coordinates `(p,)`."""


class Optimum(NamedTuple):
    """Where a search ended.

    Attributes:
        coordinate: `(p,)`.
        point: there.
        converged: whether no step promised more.
    """

    coordinate: FloatArray
    point: Point
    converged: bool


def maximize(
    at: At,
    limits: Limits,
    begin: FloatArray,
    gives_up: Callable[[FloatArray], bool] | None = None,
) -> Optimum:
    """Return the largest value that is found from a point.

    Args:
        at: what is maximized.
        limits: of the coordinates.
        begin: `(p,)` coordinates to begin with.
        gives_up: says of coordinates after a step up that the search need not go on.
    """
    u = np.clip(begin, *limits)
    here = at(u)
    damping, passes = _LEAST_DAMPING, 1
    while passes < MOST_PASSES and damping < _MOST_DAMPING:
        moved, gain = _step(u, here, damping, limits)
        if 0.0 <= gain < ENOUGH:
            return Optimum(u, here, converged=True)
        if gain < 0.0:  # a bound has turned the step away from where it led
            damping = max(10.0 * damping, 0.1)
            continue
        there = at(moved)
        passes += 1
        actual = there.value - here.value
        if not actual > 0.0:
            damping = max(10.0 * damping, 0.1)
            continue
        u, here = moved, there
        if actual < ENOUGH and damping < 0.1:
            return Optimum(u, here, converged=True)
        if gives_up is not None and gives_up(u):
            break
        damping = max(damping / 10.0 if actual > 0.3 * gain else 2.0 * damping, _LEAST_DAMPING)
    return Optimum(u, here, converged=False)


def _step(
    u: FloatArray,
    here: Point,
    damping: float,
    limits: Limits,
) -> tuple[FloatArray, float]:
    """Return the next point and the gain that is expected of it [nats].

    Coordinates at a bound that the gradient points out of stay there.
    """
    low, high = limits
    _, gradient, information = here
    stays = ((u <= low) & (gradient < 0.0)) | ((u >= high) & (gradient > 0.0))
    free = np.flatnonzero(~stays)
    if not len(free):
        return u, 0.0
    scale = np.sqrt(np.maximum(np.diag(information)[free], 1e-9))
    curved = information[np.ix_(free, free)] / np.outer(scale, scale)
    curved += damping * np.eye(len(free))
    step = np.linalg.lstsq(curved, gradient[free] / scale, rcond=1e-8)[0] / scale
    step *= min(1.0, _LARGEST_STEP / max(float(np.abs(step).max()), 1e-300))
    moved = u.copy()
    moved[free] = np.clip(u[free] + step, low[free], high[free])
    change = moved - u
    gain = float(gradient @ change - 0.5 * change @ information @ change)
    return moved, gain
