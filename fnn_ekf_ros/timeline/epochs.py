# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""A period, cut into epochs at the instants of its readings.

Readings of different sensors that share a millisecond are one epoch, which ends with the last of
them; a second reading of one sensor is an epoch of its own. Only the stamps matter, not the order
of arrival. The last epoch ends with the period.
"""

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from fnn_ekf_ros.core.arrays import MEASUREMENT_SIZE, FloatArray, Row
from fnn_ekf_ros.core.results import Epoch
from fnn_ekf_ros.core.rows import FIX_ROWS, POSITION_ROWS
from fnn_ekf_ros.parameters.localizer import LocalizerParameters
from fnn_ekf_ros.timeline.events import CompassYaw, PoseFix

MOST_READINGS_A_SECOND = 250.0
"""Largest rate of readings of one sensor that are used [1/s]; those of a faster sensor are thinned,
or the filter would not keep up with it."""
MOST_READINGS = 6
"""Readings of one sensor that are used in any period, however short it is."""
_MILLISECOND_NS = 10**6
"""Readings of different sensors within the same one share an epoch [ns]."""

Reading = CompassYaw | PoseFix
"""One fix or one compass value."""


class Instant(NamedTuple):
    """The readings of one instant.

    Attributes:
        stamp_ns: the instant [ns].
        readings: at most one of each sensor.
    """

    stamp_ns: int
    readings: tuple[Reading, ...]


def thinned(readings: Sequence[Reading], period_s: float) -> Sequence[Reading]:
    """Return the used readings of a sensor in a period: all, or as many evenly spread ones."""
    most = max(MOST_READINGS, math.ceil(MOST_READINGS_A_SECOND * period_s))
    count = len(readings)
    if count <= most:
        return readings
    return [readings[(place + 1) * count // most - 1] for place in range(most)]


def instants(*of_sensors: Sequence[Reading]) -> list[Instant]:
    """Return the instants of readings that are ordered by their stamps for each sensor."""
    places: dict[tuple[int, int], list[Reading]] = {}
    for readings in of_sensors:
        millisecond, place = None, 0
        for reading in readings:
            now = -(-reading.stamp_ns // _MILLISECOND_NS)
            place = place + 1 if now == millisecond else 0
            millisecond = now
            places.setdefault((now, place), []).append(reading)
    found: list[Instant] = []
    for key in sorted(places):
        together = tuple(places[key])
        stamp_ns = max(reading.stamp_ns for reading in together)
        if found:
            stamp_ns = max(stamp_ns, found[-1].stamp_ns)
        found.append(Instant(stamp_ns, together))
    return found


class Cutter:
    """Makes epochs of instants.

    Args:
        parameters: which rows of the laser are used, and how.
    """

    def __init__(self, parameters: LocalizerParameters) -> None:
        self._compass_sign = -1.0 if parameters.compass_clockwise else 1.0
        self._offset = parameters.compass_offset
        self._rows = list(FIX_ROWS if parameters.lrf_use_yaw else POSITION_ROWS)
        self._reported = parameters.lrf_use_message_covariance
        self._nothing = np.zeros(MEASUREMENT_SIZE), np.zeros(MEASUREMENT_SIZE, dtype=np.bool_)

    def epochs(
        self,
        begin_ns: int,
        end_ns: int,
        measured: Sequence[Instant],
        control_until: Callable[[int], FloatArray],
        done: FloatArray,
    ) -> list[Epoch]:
        """Return the epochs of the time (begin, end]; the last one ends with it.

        Args:
            begin_ns: its begin [ns].
            end_ns: its end [ns].
            measured: the instants in it.
            control_until: `(2,)` [dS, dtheta] of the period up to an instant (m, rad).
            done: `(2,)` part of that which earlier epochs have taken; the first epoch takes the
                rest, and also motion before `begin_ns` that was not known then.
        """
        found = []
        last_ns = begin_ns
        for instant in measured:
            control = control_until(instant.stamp_ns)
            found.append(self._epoch(control - done, instant.stamp_ns - last_ns, instant.readings))
            done, last_ns = control, instant.stamp_ns
        if last_ns < end_ns:
            found.append(self._epoch(control_until(end_ns) - done, end_ns - last_ns, ()))
        return found

    def _epoch(self, control: FloatArray, duration_ns: int, readings: tuple[Reading, ...]) -> Epoch:
        if not readings:
            return Epoch(control, duration_ns / 1e9, *self._nothing)
        measurement = np.zeros(MEASUREMENT_SIZE)
        available = np.zeros(MEASUREMENT_SIZE, dtype=np.bool_)
        covariance = None
        for reading in readings:
            if isinstance(reading, CompassYaw):
                measurement[Row.COMPASS_YAW] = self._compass_sign * reading.yaw + self._offset
                available[Row.COMPASS_YAW] = True
            else:
                measurement[self._rows] = reading.pose[: len(self._rows)]
                available[self._rows] = True
                covariance = self._used(reading.covariance) if self._reported else None
        return Epoch(
            control=control,
            duration_s=duration_ns / 1e9,
            measurement=measurement,
            available=available,
            fix_covariance=covariance,
        )

    def _used(self, covariance: FloatArray) -> FloatArray:
        """Return the used part of a reported covariance `(3, 3)`; only that has been checked."""
        count = len(self._rows)
        used = np.eye(len(covariance))
        used[:count, :count] = covariance[:count, :count]
        return used
