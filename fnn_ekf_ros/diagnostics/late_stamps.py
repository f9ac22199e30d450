# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Sensors whose stamps are later or earlier than the instants that they measured."""

from typing import NamedTuple

from fnn_ekf_ros.core.rows import COMPASS, LRF_POSE
from fnn_ekf_ros.diagnostics.messages import SensorMessage, fitting_value
from fnn_ekf_ros.diagnostics.noise_words import Values
from fnn_ekf_ros.diagnostics.recent_periods import RecentPeriods
from fnn_ekf_ros.parameters.localizer import LocalizerParameters
from fnn_ekf_ros.timeline.events import Sensor


class LateStamps(NamedTuple):
    """The believed lag of a sensor.

    Attributes:
        lag_s: by which its stamps are too late, with the configured delay [s]; negative: too early.
        std_s: its standard error [s].
        parameter: name of the parameter that puts it right.
        delay_s: the configured value of that [s].
    """

    lag_s: float
    std_s: float
    parameter: str
    delay_s: float

    @property
    def message(self) -> SensorMessage:
        """What diagnostics say of it."""
        return SensorMessage.STAMPS_LATE if self.lag_s > 0.0 else SensorMessage.STAMPS_EARLY

    def values(self) -> Values:
        """Return the numbers behind the message."""
        return (
            ("lag of the stamps [s]", f"{self.lag_s:.2f}"),
            ("its standard error [s]", f"{self.std_s:.2f}"),
            fitting_value(self.parameter, self.delay_s + self.lag_s),
        )


def late_stamps(
    parameters: LocalizerParameters, recent: RecentPeriods | None
) -> dict[Sensor, LateStamps]:
    """Return the believed lags.

    Args:
        parameters: of the localizer.
        recent: its last periods; None while no filter runs.
    """
    if recent is None:
        return {}
    of_sensors = (
        (Sensor.COMPASS, COMPASS, "compass_delay", parameters.compass_delay),
        (Sensor.LRF_POSE, LRF_POSE, "lrf_pose_delay", parameters.lrf_pose_delay),
    )
    return {
        sensor: LateStamps(
            lag_s=recent.lags.sensors[place].lag,
            std_s=recent.lags.sensors[place].std,
            parameter=parameter,
            delay_s=delay_s,
        )
        for sensor, place, parameter, delay_s in of_sensors
        if recent.lags.sensors[place].believed
    }
