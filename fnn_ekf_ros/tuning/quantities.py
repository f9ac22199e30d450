# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""What can be tuned: the quantities, their units, bounds, and the coordinates of the search.

Standard deviations, time constants and factors are searched for as logarithms, so that a step means
the same part of a small value as of a large one; offsets and delays are searched for as they are,
in multiples of a scale.
"""

import math
from enum import IntEnum
from typing import NamedTuple

import numpy as np

from fnn_ekf_ros.core.arrays import FloatArray
from fnn_ekf_ros.core.limits import LARGEST_STD, SMALLEST_STD


class Quantity(IntEnum):
    """Quantities that a model of the robot consists of, in the order of a vector of values."""

    DISTANCE = 0
    ROTATION = 1
    POSITION = 2
    COMPASS = 3
    FIX_YAW = 4
    FIX_ERROR = 5
    FIX_TIME = 6
    YAW_ERROR = 7
    YAW_TIME = 8
    RADIUS = 9
    RATIO = 10
    SEPARATION = 11
    OFFSET = 12
    FIX_DELAY = 13
    COMPASS_DELAY = 14
    YAW_CONSTANT = 15


class Meaning(NamedTuple):
    """What a quantity is.

    Attributes:
        name: as tables call it.
        unit: of its value; empty for a factor.
        low: smallest value of the search.
        high: largest value.
        scale: of its coordinate: the value is exp(coordinate) times 1 if it is a logarithm (scale
            0), otherwise the coordinate times the scale.
        step: difference of the coordinate to its neighbors, by which derivatives are taken.
    """

    name: str
    unit: str
    low: float
    high: float
    scale: float
    step: float


_STD_STEP = 0.1
"""Difference to a neighbor in log standard deviation: 10 %, over which likelihoods are nearly
quadratic, and far more than rounding needs."""
MEANINGS = (
    Meaning("distance noise", "m", SMALLEST_STD, 10.0, 0.0, _STD_STEP),
    Meaning("rotation noise", "rad", SMALLEST_STD, 3.0, 0.0, _STD_STEP),
    Meaning("position noise", "m", 1e-3, LARGEST_STD, 0.0, _STD_STEP),
    Meaning("compass noise", "rad", 1e-3, 3.0, 0.0, _STD_STEP),
    Meaning("fix yaw noise", "rad", 1e-3, 3.0, 0.0, _STD_STEP),
    Meaning("lasting fix error", "m", SMALLEST_STD, LARGEST_STD, 0.0, _STD_STEP),
    Meaning("time of fix error", "s", 0.5, 300.0, 0.0, _STD_STEP),
    Meaning("lasting yaw error", "rad", SMALLEST_STD, 1.5, 0.0, _STD_STEP),
    Meaning("time of yaw error", "s", 0.5, 300.0, 0.0, _STD_STEP),
    Meaning("wheel radius", "m", 0.5, 2.0, 0.0, 0.005),
    Meaning("right over left wheel", "", -0.2, 0.2, 0.01, 0.2),
    Meaning("wheel separation", "m", 0.5, 2.0, 0.0, 0.01),
    Meaning("compass offset", "rad", -math.pi, math.pi, 0.05, 0.2),
    Meaning("delay of fixes", "s", -1.0, 1.0, 0.1, 0.2),
    Meaning("delay of compass", "s", -1.0, 1.0, 0.1, 0.2),
    Meaning("constant yaw error", "rad", SMALLEST_STD, 1.5, 0.0, _STD_STEP),
)
"""Meaning of each quantity. Wheel radius and separation are factors on the configured ones here."""
COUNT = len(MEANINGS)
"""Number of quantities."""
LASTING = (Quantity.FIX_ERROR, Quantity.FIX_TIME, Quantity.YAW_ERROR, Quantity.YAW_TIME)
"""The quantities of lasting errors."""
CALIBRATION = tuple(Quantity(q) for q in range(Quantity.RADIUS, Quantity.COMPASS_DELAY + 1))
"""The quantities of geometry, compass offset and delays."""
STEPS: FloatArray = np.array([meaning.step for meaning in MEANINGS])
"""Steps of all coordinates."""
_SCALES = np.array([meaning.scale for meaning in MEANINGS])
_IS_LOG = _SCALES == 0.0
_LOW = np.array([meaning.low for meaning in MEANINGS])
_HIGH = np.array([meaning.high for meaning in MEANINGS])


def is_logarithm(quantity: Quantity) -> bool:
    """Return whether the coordinate of a quantity is its logarithm."""
    return bool(_IS_LOG[quantity])


def scale_of(quantity: Quantity) -> float:
    """Return the value of a coordinate of 1 of a quantity that is no logarithm."""
    return float(_SCALES[quantity])


def coordinates(values: FloatArray, which: tuple[Quantity, ...]) -> FloatArray:
    """Return the coordinates `(n,)` of some quantities of values `(16,)`."""
    some = list(which)
    logs = np.log(np.where(_IS_LOG, np.maximum(values, _LOW), 1.0))
    linear = values / np.where(_IS_LOG, 1.0, _SCALES)
    return np.where(_IS_LOG, logs, linear)[some]


def with_coordinates(
    values: FloatArray, which: tuple[Quantity, ...], coordinate: FloatArray
) -> FloatArray:
    """Return values `(16, S)` with some quantities as coordinates `(n, S)` have them.

    Args:
        values: `(16,)` of the others.
        which: the n quantities.
        coordinate: theirs.
    """
    some = list(which)
    found = np.repeat(values[:, None], coordinate.shape[1], axis=1)
    logs = np.exp(np.where(_IS_LOG[some, None], coordinate, 0.0))
    linear = coordinate * _SCALES[some, None]
    found[some] = np.where(_IS_LOG[some, None], logs, linear)
    return found


def bounds(which: tuple[Quantity, ...]) -> tuple[FloatArray, FloatArray]:
    """Return the smallest and the largest coordinates `(n,)` of some quantities."""
    return coordinates(_LOW, which), coordinates(_HIGH, which)
