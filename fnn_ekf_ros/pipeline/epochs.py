"""A period, cut at the instants at which something was measured.

Readings of different sensors that share a millisecond are one epoch, which ends with the last of
them; a second reading of one sensor is an epoch of its own. Which reading came first does not
matter, only their stamps. The last epoch ends with the period.
"""

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from fnn_ekf_ros.core.arrays import MEASUREMENT_SIZE, FloatArray, Row
from fnn_ekf_ros.core.results import Epoch
from fnn_ekf_ros.core.rows import FIX_ROWS
from fnn_ekf_ros.parameters.localizer import LocalizerParameters
from fnn_ekf_ros.pipeline.events import CompassYaw, PoseFix

MOST_READINGS_A_SECOND = 250.0
"""Of each sensor; a faster one's are thinned, or the filter would not keep up with it."""
MOST_READINGS = 6
"""So many in a period are taken, however short it is."""
_MILLISECOND_NS = 10**6

Reading = CompassYaw | PoseFix


class Instant(NamedTuple):
    """What was measured at one instant.

    Attributes:
        stamp_ns: when [ns].
        readings: one of each sensor at the most.
    """

    stamp_ns: int
    readings: tuple[Reading, ...]


def thinned(readings: Sequence[Reading], period_s: float) -> Sequence[Reading]:
    """Return as many of a sensor's readings of a period as are taken, evenly spread."""
    most = max(MOST_READINGS, math.ceil(MOST_READINGS_A_SECOND * period_s))
    count = len(readings)
    if count <= most:
        return readings
    return [readings[(place + 1) * count // most - 1] for place in range(most)]


def instants(*of_sensors: Sequence[Reading]) -> list[Instant]:
    """Return the instants of readings, each sensor's in the order of their stamps."""
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
        self._offset = parameters.compass_offset
        self._rows = list(FIX_ROWS if parameters.lrf_use_yaw else FIX_ROWS[:2])
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
            measured: in it.
            control_until: `(2,)` [dS, dtheta] of the period up to an instant (m, rad).
            done: `(2,)` what of that has been taken already; the first epoch takes what is left,
                also what the wheels did earlier and was not known then.
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
                measurement[Row.COMPASS_YAW] = reading.yaw + self._offset
                available[Row.COMPASS_YAW] = True
            else:
                measurement[self._rows] = reading.pose[: len(self._rows)]
                available[self._rows] = True
                covariance = self._used(reading.covariance) if self._reported else None
        return Epoch(control, duration_ns / 1e9, measurement, available, covariance)

    def _used(self, covariance: FloatArray) -> FloatArray:
        """Return of a reported covariance `(3, 3)` what is used; only that has been checked."""
        count = len(self._rows)
        used = np.eye(len(covariance))
        used[:count, :count] = covariance[:count, :count]
        return used
