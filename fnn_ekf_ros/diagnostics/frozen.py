# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Sensors whose readings stay the same while the wheels move the robot."""

from typing import NamedTuple

from fnn_ekf_ros.diagnostics.messages import SensorMessage
from fnn_ekf_ros.diagnostics.noise_words import Values
from fnn_ekf_ros.diagnostics.wheel_distances import WheelDistances
from fnn_ekf_ros.timeline.events import CompassYaw, PoseFix, Sensor
from fnn_ekf_ros.timeline.inputs import Counts

FROZEN_READINGS = 5
"""Consecutive identical readings from which on a sensor may count as frozen: noise hardly repeats
all digits even twice, but a driver may send one reading again."""
FROZEN_DISTANCE = 0.5
"""Distance by which the wheels move the robot meanwhile for fixes to count as frozen [m]: more than
the resolution of any fix."""
FROZEN_ROTATION = 0.5
"""Rotation by the wheels meanwhile for a compass to count as frozen [rad]: more than the resolution
of any compass, and more than wheel slip on a straight path."""


class FrozenReadings(NamedTuple):
    """Readings of a sensor that should have changed.

    Attributes:
        message: what diagnostics say of them.
        readings: number of identical readings.
        distance: by which the wheels moved the robot meanwhile [m].
        rotation: by which they turned it [rad].
    """

    message: SensorMessage
    readings: int
    distance: float
    rotation: float

    def values(self) -> Values:
        """Return the numbers behind the message."""
        return (
            ("identical readings", str(self.readings)),
            ("distance by the wheels meanwhile [m]", f"{self.distance:.2f}"),
            ("rotation by the wheels meanwhile [rad]", f"{self.rotation:.2f}"),
        )


class FrozenSensor:
    """Compares consecutive readings of a sensor.

    Args:
        sensor: the compass or the fixes.
        meters_per_count: distance of a wheel's rim.
        wheel_separation: distance between the wheels [m].
    """

    def __init__(self, sensor: Sensor, meters_per_count: float, wheel_separation: float) -> None:
        self._sensor = sensor
        self._meters_per_count, self._separation = meters_per_count, wheel_separation
        self._value: tuple[float, ...] = ()
        self._same = 0
        self._since: WheelDistances | None = None
        self._now: WheelDistances | None = None

    def saw(self, event: CompassYaw | PoseFix) -> None:
        """Take a reading in."""
        value = (event.yaw,) if isinstance(event, CompassYaw) else tuple(map(float, event.pose[:2]))
        if value == self._value:
            self._same += 1
        else:
            self._value, self._same, self._since = value, 1, self._now

    def closed(self, counts: Counts) -> None:
        """Take the wheels' counts at the end of a period in."""
        if counts.left is None or counts.right is None:
            self.forget()
            return
        self._now = WheelDistances(
            counts.left * self._meters_per_count, counts.right * self._meters_per_count
        )
        if self._since is None:
            self._since = self._now

    def forget(self) -> None:
        """Begin anew."""
        self._value, self._same, self._since, self._now = (), 0, None, None

    def fault(self) -> FrozenReadings | None:
        """Return the readings that should have changed; None if there are none."""
        if self._same < FROZEN_READINGS or self._since is None or self._now is None:
            return None
        driven = self._now.since(self._since)
        distance, rotation = abs(driven.distance()), abs(driven.rotation(self._separation))
        if self._sensor is Sensor.LRF_POSE and distance >= FROZEN_DISTANCE:
            return FrozenReadings(
                message=SensorMessage.FROZEN_FIX,
                readings=self._same,
                distance=distance,
                rotation=rotation,
            )
        if self._sensor is Sensor.COMPASS and rotation >= FROZEN_ROTATION:
            return FrozenReadings(
                message=SensorMessage.FROZEN_YAW,
                readings=self._same,
                distance=distance,
                rotation=rotation,
            )
        return None
