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

from typing import NamedTuple

import numpy as np

from fnn_ekf_ros.core.angles import wrap_angle
from fnn_ekf_ros.core.arrays import BoolArray, Constant, FloatArray, Row, against
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
_TRACKED = (Row.X, Row.Y, Row.COMPASS_YAW)
"""Rows whose readings are compared; they are the first ones."""
_SIGN = Constant([1.0, -1.0])
"""Sign of a rotation to the left and to the right."""


class Unchanged(NamedTuple):
    """The last readings that did not change, and the motion of the wheels since the first of them.

    Sensors are in the order of `rows`: compass, fixes.

    Attributes:
        mean: `(3, *batch)` mean of these readings: x, y, compass yaw (m, m, rad).
        readings: `(2, *batch)` number of them, of each sensor; 0 before the first.
        distance: `(2, *batch)` length of the path since the first of them [m].
        rotation: `(2, *batch)` rotation since then [rad].
        displacement: `(2, *batch)` [x, y] of the robot since the first of the fixes, in the frame
            of the robot at that time [m].
        turned: `(2, *batch)` rotation to the left and to the right that a compass has to show
            [rad].
        frozen: `(2, *batch)` whether each sensor is frozen.
    """

    mean: FloatArray
    readings: FloatArray
    distance: FloatArray
    rotation: FloatArray
    displacement: FloatArray
    turned: FloatArray
    frozen: BoolArray


def start_unchanged(batch: tuple[int, ...]) -> Unchanged:
    """Return the memory before the first reading."""
    none = np.zeros((SENSOR_COUNT, *batch))
    return Unchanged(
        mean=np.zeros((len(_TRACKED), *batch)),
        readings=none,
        distance=none,
        rotation=none,
        displacement=none,
        turned=none,
        frozen=none.astype(np.bool_),
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
    moved = _moved(before, epoch.control)
    available = epoch.available
    if not available.any():
        return moved, epoch
    after = _compared(moved, epoch, measurement_noise)
    if not after.frozen.any():
        return after, epoch
    return after, epoch._replace(available=available & ~after.frozen[SENSOR_OF_ROW])


def _moved(before: Unchanged, control: FloatArray) -> Unchanged:
    """Return the memory after a step of the wheels `(2, *batch)`, [dS, dtheta] (m, rad)."""
    distance, rotation = control
    length = abs(distance)
    middle = before.rotation[LRF_POSE] + 0.5 * rotation
    turned = before.turned + (rotation * _SIGN.behind(rotation.ndim) - WHEEL_ERROR * length)
    return before._replace(
        distance=before.distance + length,
        rotation=before.rotation + rotation,
        displacement=before.displacement + distance * np.array([np.cos(middle), np.sin(middle)]),
        turned=np.maximum(turned, 0.0),
    )


def _compared(moved: Unchanged, epoch: Epoch, measurement_noise: tuple[float, ...]) -> Unchanged:
    """Return the memory after readings."""
    available = epoch.available[: len(_TRACKED)]
    measured = _by_sensor(available)
    change = np.where(available, epoch.measurement[: len(_TRACKED)] - moved.mean, 0.0)
    change[Row.COMPASS_YAW] = wrap_angle(change[Row.COMPASS_YAW])
    std = np.sqrt(measurement_noise[: len(_TRACKED)])
    close = abs(change) <= against(np.minimum(JITTER, JITTER_STDS * std), change)
    same = _by_sensor(close) & (moved.readings > 0.0)
    changed, kept = measured & ~same, measured & same
    readings = np.where(changed, 1.0, moved.readings + kept)
    rows = SENSOR_OF_ROW[: len(_TRACKED)]
    share = np.where(measured, 1.0 / np.maximum(readings, 1.0), 0.0)
    fixes_changed, compass_changed = changed[LRF_POSE], changed[COMPASS]
    displacement = np.where(fixes_changed, 0.0, moved.displacement)
    turned = np.where(compass_changed, 0.0, moved.turned)
    far = np.empty(measured.shape, dtype=np.bool_)
    far[COMPASS] = turned.max(axis=0) >= FROZEN_ROTATION
    far[LRF_POSE] = np.hypot(displacement[0], displacement[1]) >= FROZEN_DISTANCE
    freezes = kept & (readings >= FROZEN_READINGS) & far
    return Unchanged(
        mean=moved.mean + share[rows] * change,
        readings=readings,
        distance=np.where(changed, 0.0, moved.distance),
        rotation=np.where(changed, 0.0, moved.rotation),
        displacement=displacement,
        turned=turned,
        frozen=(moved.frozen & ~changed) | freezes,
    )


def _by_sensor(tracked: BoolArray) -> BoolArray:
    """Return which sensors `(2, *batch)` have all of their rows among `(3, *batch)`."""
    found = np.empty((SENSOR_COUNT, *tracked.shape[1:]), dtype=np.bool_)
    found[COMPASS] = tracked[Row.COMPASS_YAW]
    found[LRF_POSE] = tracked[Row.X] & tracked[Row.Y]
    return found
