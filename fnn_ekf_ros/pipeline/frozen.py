"""Sensors that say the same again and again while the wheels move the robot."""

import math

from fnn_ekf_ros.pipeline.events import CompassYaw, PoseFix, Sensor
from fnn_ekf_ros.pipeline.inputs import Counts

FROZEN_READINGS = 5
"""So many readings in a row have to be the same to the last digit."""
FROZEN_WAY = 0.5
"""While the wheels move the robot by so much: a fix is frozen then [m]."""
FROZEN_TURN = 0.5
"""While they turn it by so much: a compass is [rad]."""


class FrozenSensor:
    """Watches the readings of a sensor.

    Args:
        sensor: the compass or the fixes.
        metres_per_count: way of a wheel's rim.
        wheel_separation: distance between the wheels [m].
    """

    def __init__(self, sensor: Sensor, metres_per_count: float, wheel_separation: float) -> None:
        self._sensor = sensor
        self._metres_per_count, self._separation = metres_per_count, wheel_separation
        self._value: tuple[float, ...] = ()
        self._same = 0
        self._since: tuple[float, float] | None = None
        self._now: tuple[float, float] | None = None

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
        self._now = counts.left * self._metres_per_count, counts.right * self._metres_per_count
        if self._since is None:
            self._since = self._now

    def forget(self) -> None:
        """Begin anew."""
        self._value, self._same, self._since, self._now = (), 0, None, None

    def accusation(self) -> str:
        """Return what is wrong; empty if nothing is."""
        if self._same < FROZEN_READINGS or self._since is None or self._now is None:
            return ""
        left, right = (now - then for now, then in zip(self._now, self._since, strict=True))
        way, turn = abs(0.5 * (left + right)), abs(right - left) / self._separation
        same = f"frozen: the last {self._same} readings are the same"
        if self._sensor is Sensor.LRF_POSE and way >= FROZEN_WAY:
            return f"{same} while the wheels moved {way:.2f} m"
        if self._sensor is Sensor.COMPASS and turn >= FROZEN_TURN:
            return f"{same} while the wheels turned {math.degrees(turn):.0f} degrees"
        return ""
