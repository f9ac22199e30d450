# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Frozen readings: a sensor repeats one value while the wheels move the robot.

A driver that hangs sends its last value again and again, sometimes with a little noise. The filter
would follow it. From the readings alone, a hanging sensor and a standing robot look the same; the
wheels tell them apart. A correct reading changes by about as much as the wheels move the robot, so
a sensor is frozen where

    its last readings stay within a small jitter of their mean, and meanwhile
    fixes:    the wheels moved the robot away by FROZEN_DISTANCE, as the crow flies
    compass:  the wheels rotated the robot by FROZEN_ROTATION in one direction, on any part of the
              path, beyond what wheels of another size than configured would seem to rotate it:
              turned <- max(0, turned +- dtheta - WHEEL_ERROR |dS|)        (CUSUM, Page 1954)

The readings of a frozen sensor are not available to the filter until they change. A standing or
creeping robot, a robot that rotates on the spot, a compass on a straight path and a sensor whose
resolution is coarse stay below the limits; a precise sensor leaves the jitter first.

What cannot be told apart: wheels that spin while the robot stands, or a wheel whose counter hangs
on a straight path, beside a sensor that repeats its value exactly because it is correct. Such a
sensor is used again with its next change.
"""

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from fnn_ekf_ros.core.angles import wrap_angle
from fnn_ekf_ros.core.arrays import BoolArray, Constant, FloatArray, Row
from fnn_ekf_ros.core.results import Epoch
from fnn_ekf_ros.core.rows import COMPASS, LRF_POSE, SENSOR_COUNT, SENSOR_OF_ROW

FROZEN_READINGS = 5
"""Consecutive unchanged readings from which on a sensor may count as frozen: a driver may send one
reading again, and noise hardly repeats a value even twice."""
JITTER = 5e-3
"""Largest distance of unchanged readings from their mean [m, rad]: five standard deviations of a
jitter of 1 mm or 1 mrad, and a sixtieth of what correct readings would have changed by. A coarse
resolution (1 cm, 1 degree) is more, so that its steps count as changes."""
JITTER_STDS = 0.2
"""Largest part of the configured standard deviation that counts as unchanged: correct readings of a
standing robot stay so close to each other five times in a row with a probability below 1e-3. So a
precise sensor is not frozen by its small noise alone, even where the wheels spin."""
FROZEN_DISTANCE = 0.3
"""Distance by which the wheels move the robot away meanwhile for fixes to count as frozen [m]: more
than the resolution of any fix, and than a localizer moves between two of its updates (0.25 m)."""
FROZEN_ROTATION = 0.3
"""Rotation by the wheels meanwhile for a compass to count as frozen [rad]: more than the resolution
of any compass, and more than wheel slip on a straight path."""
WHEEL_ERROR = 0.1
"""Rotation that the wheels report on a straight path although there is none [rad/m]: that of radii
that differ by 5 % at a wheel separation of 0.5 m."""
_TRACKED = slice(Row.X, Row.COMPASS_YAW + 1)
"""Rows whose readings are compared: x, y and compass yaw."""
_SENSOR_OF_TRACKED = SENSOR_OF_ROW[_TRACKED]
"""Index of the sensor that measures each of them."""
_DISTANCE, _ROTATION, _DISPLACEMENT, _TURNED = (
    slice(first, first + SENSOR_COUNT) for first in range(0, 4 * SENSOR_COUNT, SENSOR_COUNT)
)
"""Places in `Unchanged.travel`."""
_SENSOR_OF_TRAVEL = np.array([COMPASS, LRF_POSE] * 2 + [LRF_POSE] * 2 + [COMPASS] * 2)
"""Index of the sensor since whose readings each entry of `Unchanged.travel` counts."""


class Unchanged(NamedTuple):
    """The last readings that did not change, and the motion of the wheels since the first of them.

    Sensors are in the order of `rows`: compass, fixes.

    Attributes:
        mean: `(3, *batch)` mean of these readings: x, y, compass yaw (m, m, rad).
        readings: `(2, *batch)` number of them, of each sensor; 0 before the first.
        travel: `(8, *batch)` motion of the wheels since then; see the properties (m, rad).
        frozen: `(2, *batch)` whether each sensor is frozen.
    """

    mean: FloatArray
    readings: FloatArray
    travel: FloatArray
    frozen: BoolArray

    @property
    def distance(self) -> FloatArray:
        """`(2, *batch)` length of the path since the first of these readings of a sensor [m]."""
        return self.travel[_DISTANCE]

    @property
    def rotation(self) -> FloatArray:
        """`(2, *batch)` rotation since then [rad]."""
        return self.travel[_ROTATION]

    @property
    def displacement(self) -> FloatArray:
        """`(2, *batch)` [x, y] since the first of the fixes, in the robot's frame then [m]."""
        return self.travel[_DISPLACEMENT]

    @property
    def turned(self) -> FloatArray:
        """`(2, *batch)` rotation to the left and right that a correct compass shows [rad]."""
        return self.travel[_TURNED]


def start_unchanged(batch: tuple[int, ...]) -> Unchanged:
    """Return the memory before the first reading."""
    return Unchanged(
        mean=np.zeros((len(_SENSOR_OF_TRACKED), *batch)),
        readings=np.zeros((SENSOR_COUNT, *batch)),
        travel=np.zeros((len(_SENSOR_OF_TRAVEL), *batch)),
        frozen=np.zeros((SENSOR_COUNT, *batch), dtype=np.bool_),
    )


def without_frozen(
    before: Unchanged, epoch: Epoch, measurement_noise: tuple[float, ...]
) -> tuple[Unchanged, Epoch]:
    """Return the memory after an epoch, and the epoch without the readings of frozen sensors.

    Args:
        before: the memory before the epoch; not changed.
        epoch: the step of the wheels, and the readings at its end.
        measurement_noise: configured diagonal of R, rows as in `Row` (m^2, m^2, rad^2, rad^2).
    """
    moved = before._replace(travel=_travel_after(before.travel, epoch.control))
    if not epoch.available.any():
        return moved, epoch
    after = _compared(moved, epoch, _tolerance(measurement_noise))
    if not after.frozen.any():
        return after, epoch
    return after, epoch._replace(available=epoch.available & ~after.frozen[SENSOR_OF_ROW])


def _travel_after(travel: FloatArray, control: FloatArray) -> FloatArray:
    """Return `Unchanged.travel` after a step of the wheels `(2, *batch)`, [dS, dtheta] (m, rad)."""
    distance, rotation = control
    length = abs(distance)
    middle = travel[_ROTATION][LRF_POSE] + 0.5 * rotation
    x, y = distance * np.cos(middle), distance * np.sin(middle)
    error = WHEEL_ERROR * length
    after: FloatArray = travel + np.array(
        [length, length, rotation, rotation, x, y, rotation - error, -rotation - error]
    )
    np.maximum(after[_TURNED], 0.0, out=after[_TURNED])
    return after


def _compared(moved: Unchanged, epoch: Epoch, tolerance: Constant) -> Unchanged:
    """Return the memory after readings; `tolerance` `(3,)` is the largest jitter (m, m, rad)."""
    available = epoch.available[_TRACKED]
    change = np.where(available, epoch.measurement[_TRACKED] - moved.mean, 0.0)
    change[Row.COMPASS_YAW] = wrap_angle(change[Row.COMPASS_YAW])
    close = available & (abs(change) <= tolerance.behind(change.ndim - 1))
    measured = _by_sensor(available)
    kept = _by_sensor(close) & (moved.readings > 0.0)
    changed = measured & ~kept
    readings = np.where(changed, 1.0, moved.readings + kept)
    share = measured / np.maximum(readings, 1.0)
    travel = np.where(changed[_SENSOR_OF_TRAVEL], 0.0, moved.travel)
    frozen = moved.frozen & ~changed
    many = kept & (readings >= FROZEN_READINGS)
    if many.any():
        frozen |= many & _far(travel)
    return Unchanged(
        mean=moved.mean + share[_SENSOR_OF_TRACKED] * change,
        readings=readings,
        travel=travel,
        frozen=frozen,
    )


def _far(travel: FloatArray) -> BoolArray:
    """Return whether the wheels moved the robot clearly since each sensor's reading, `(2, ...)`."""
    far = np.empty((SENSOR_COUNT, *travel.shape[1:]), dtype=np.bool_)
    far[COMPASS] = travel[_TURNED].max(axis=0) >= FROZEN_ROTATION
    far[LRF_POSE] = np.hypot(*travel[_DISPLACEMENT]) >= FROZEN_DISTANCE
    return far


@lru_cache(maxsize=16)
def _tolerance(measurement_noise: tuple[float, ...]) -> Constant:
    """Return the largest distance of unchanged readings from their mean, `(3,)` (m, m, rad)."""
    return Constant(np.minimum(JITTER, JITTER_STDS * np.sqrt(measurement_noise[_TRACKED])))


def _by_sensor(tracked: BoolArray) -> BoolArray:
    """Return which sensors `(2, *batch)` have all of their rows among `(3, *batch)`."""
    found = np.empty((SENSOR_COUNT, *tracked.shape[1:]), dtype=np.bool_)
    found[COMPASS] = tracked[Row.COMPASS_YAW]
    found[LRF_POSE] = tracked[Row.X] & tracked[Row.Y]
    return found
