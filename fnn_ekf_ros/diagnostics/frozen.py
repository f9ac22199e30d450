# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""What diagnostics say of sensors that the filter found to be frozen (`core.frozen`)."""

from typing import NamedTuple

from fnn_ekf_ros.core.rows import COMPASS, LRF_POSE
from fnn_ekf_ros.core.state import FilterState
from fnn_ekf_ros.diagnostics.messages import SensorMessage
from fnn_ekf_ros.diagnostics.noise_words import Values
from fnn_ekf_ros.timeline.events import Sensor
from fnn_ekf_ros.timeline.initialization import AwaitingStart

_FROZEN = (
    (Sensor.COMPASS, COMPASS, SensorMessage.FROZEN_YAW),
    (Sensor.LRF_POSE, LRF_POSE, SensorMessage.FROZEN_FIX),
)
"""Each sensor with its index in the core, and what is said of it."""


class FrozenReadings(NamedTuple):
    """Readings of a sensor that should have changed.

    Attributes:
        message: what diagnostics say of them.
        readings: number of readings with the same value, but for a small jitter.
        distance: length of the path by the wheels meanwhile [m].
        rotation: by which the wheels rotated the robot meanwhile [rad].
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


def frozen_sensors(state: FilterState | AwaitingStart) -> dict[Sensor, FrozenReadings]:
    """Return the sensors that are frozen, with their readings; none before the filter runs."""
    if isinstance(state, AwaitingStart):
        return {}
    unchanged = state.unchanged
    return {
        sensor: FrozenReadings(
            message=message,
            readings=int(unchanged.readings[index]),
            distance=float(unchanged.distance[index]),
            rotation=abs(float(unchanged.rotation[index])),
        )
        for sensor, index, message in _FROZEN
        if unchanged.frozen[index]
    }
