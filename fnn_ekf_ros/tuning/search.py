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
        passes: over the recordings.
    """

    coordinate: FloatArray
    point: Point
    passes: int


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
    damping, passes = 1e-3, 1
    while passes < MOST_PASSES:
        moved, gain = _step(u, here, damping, limits)
        if gain < ENOUGH:
            break
        there = at(moved)
        passes += 1
        actual = there.value - here.value
        if np.isfinite(actual) and actual > 0.0:
            u, here = moved, there
            damping = damping / 10.0 if actual > 0.3 * gain else damping * 2.0
            damping = max(damping, 1e-6)
            if actual < ENOUGH or (gives_up is not None and gives_up(u)):
                break
        else:
            damping = max(10.0 * damping, 0.1)
            if damping > 1e6:
                break
    return Optimum(u, here, passes)


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
    step = np.clip(step, -_LARGEST_STEP, _LARGEST_STEP)
    moved = u.copy()
    moved[free] = np.clip(u[free] + step, low[free], high[free])
    change = moved - u
    gain = float(gradient @ change - 0.5 * change @ information @ change)
    return moved, gain
