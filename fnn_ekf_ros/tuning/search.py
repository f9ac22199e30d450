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
_DAMPED = 0.1
"""Damping from which on a small gain does not mean that the optimum is near."""
_LEAST_GAIN = 1e-3
"""Predicted gain of a damped step that is not worth a pass [nats]."""
_ROUNDING = 1e-9
"""Difference of coordinates that is none."""
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
        if gain < (ENOUGH if damping < _DAMPED else _LEAST_GAIN):
            return Optimum(u, here, converged=damping < _DAMPED)
        there = at(moved)
        passes += 1
        actual = there.value - here.value
        if not actual > 0.0:
            damping = max(10.0 * damping, _DAMPED)
            continue
        u, here = moved, there
        if actual < ENOUGH and damping < _DAMPED:
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
    least, most = np.maximum(low, u - _LARGEST_STEP), np.minimum(high, u + _LARGEST_STEP)
    _, gradient, information = here
    change = np.zeros_like(u)
    stays = ((u <= low) & (gradient < 0.0)) | ((u >= high) & (gradient > 0.0))
    scale = np.sqrt(np.maximum(np.diag(information), 1e-9))
    curved = information + damping * np.diag(scale**2)
    while not stays.all():  # each round takes at least one coordinate to where it has to stop
        free, held = np.flatnonzero(~stays), np.flatnonzero(stays)
        left = gradient[free] - curved[np.ix_(free, held)] @ change[held]
        normalized = curved[np.ix_(free, free)] / np.outer(scale[free], scale[free])
        step = np.linalg.lstsq(normalized, left / scale[free], rcond=1e-8)[0] / scale[free]
        change[free] = np.clip(u[free] + step, least[free], most[free]) - u[free]
        beyond = np.abs(change[free] - step) > _ROUNDING
        if not beyond.any():
            break
        stays[free[beyond]] = True
    gain = float(gradient @ change - 0.5 * change @ information @ change)
    return u + change, gain
