# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""What is heard of each sensor: how many messages, how old, what was refused and what left out."""

from collections import Counter

from fnn_ekf_ros.diagnostics.messages import (
    LAST_REFUSAL,
    LEFT_OUT,
    PASSED_OVER,
    RECEIVED,
    REFUSED,
    InputMessage,
    SensorMessage,
    fill,
)
from fnn_ekf_ros.diagnostics.noise_words import Values
from fnn_ekf_ros.timeline.epochs import MOST_READINGS_A_SECOND
from fnn_ekf_ros.timeline.events import STALE_NS, Level, PassedOver, Rejected, Sensor, Status


class Reception:
    """Counts messages, and makes the status of a sensor of which nothing else is known."""

    def __init__(self) -> None:
        self._count: Counter[Sensor] = Counter()
        self._last_ns: dict[Sensor, int] = {}
        self._stood_ns = 0
        self._refused: Counter[Sensor] = Counter()
        self._last_refusal: dict[Sensor, str] = {}
        self._new_refusal: dict[Sensor, str] = {}
        self._passed_over: dict[Sensor, str] = {}
        self._came: set[Sensor] = set()
        self._left_out: Counter[Sensor] = Counter()
        self._newly_left_out: Counter[Sensor] = Counter()

    def heard(self, sensor: Sensor, stamp_ns: int) -> None:
        """Count a reading with its stamp [ns]."""
        self._count[sensor] += 1
        self._came.add(sensor)
        self._last_ns[sensor] = max(stamp_ns, self._last_ns.get(sensor, 0))
        if sensor is Sensor.LRF_POSE:
            self._stood_ns = 0

    def stood(self, time_ns: int) -> None:
        """Count a time in which the robot stood still [ns]: scan matchers send nothing then."""
        self._stood_ns += time_ns

    def refused(self, rejected: Rejected) -> None:
        """Count a message that was refused for what it says."""
        self._refused[rejected.sensor] += 1
        self._came.add(rejected.sensor)
        self._new_refusal[rejected.sensor] = fill(InputMessage.REFUSED, check=rejected.check)
        self._last_refusal[rejected.sensor] = rejected.reason

    def dropped(self, sensor: Sensor) -> None:
        """Remember that a reading came, whose stamp was refused."""
        self._came.add(sensor)

    def passed_over(self, passed: PassedOver) -> None:
        """Remember why a message says nothing about a sensor."""
        self._passed_over[passed.sensor] = passed.reason

    def left_out(self, sensor: Sensor, count: int) -> None:
        """Count readings that were too many to be used."""
        if count:
            self._left_out[sensor] += count
            self._newly_left_out[sensor] += count

    def begin_anew(self) -> None:
        """Forget stamps, after the clock has jumped."""
        self._last_ns.clear()
        self._stood_ns = 0

    def reported(self) -> None:
        """Forget what was new in the last report."""
        self._new_refusal.clear()
        self._newly_left_out.clear()

    def is_heard(self, sensor: Sensor) -> bool:
        """Return whether there is a reading since the clock jumped last."""
        return sensor in self._last_ns

    def is_refused(self, sensor: Sensor) -> bool:
        """Return whether a message was refused since the last report."""
        return sensor in self._new_refusal

    def unused(self) -> set[Sensor]:
        """Return the sensors without any reading."""
        return {sensor for sensor in Sensor if not self._count[sensor]}

    def status(self, sensor: Sensor, now_ns: int, *, expected: bool) -> Status:
        """Return what can be said of any sensor.

        Args:
            sensor: the one in question.
            now_ns: ROS time [ns].
            expected: whether the filter needs it.
        """
        last_ns = self._last_ns.get(sensor)
        values = self._counts(sensor)
        if sensor in self._new_refusal:
            return Status(sensor, Level.WARN, self._new_refusal[sensor], values)
        if last_ns is None:
            if expected:
                return Status(sensor, Level.WARN, InputMessage.NONE_YET, values)
            return Status(sensor, Level.OK, SensorMessage.NOT_USED, values)
        age_ns = max(now_ns - last_ns, 0)
        values = (("age [s]", f"{age_ns * 1e-9:.3f}"), *values)
        stood_ns = self._stood_ns if sensor is Sensor.LRF_POSE else 0
        if age_ns - stood_ns > STALE_NS:
            return Status(sensor, Level.WARN, InputMessage.SILENT, values)
        if age_ns > STALE_NS:
            return Status(sensor, Level.OK, SensorMessage.STANDING, values)
        if self._newly_left_out[sensor]:
            return Status(sensor, Level.WARN, SensorMessage.TOO_FAST, values)
        return Status(sensor, Level.OK, InputMessage.RECEIVED, values)

    def _counts(self, sensor: Sensor) -> Values:
        """Return the values of any sensor but for the age of its last message."""
        values: Values = (
            (RECEIVED, str(self._count[sensor])),
            (REFUSED, str(self._refused[sensor])),
        )
        if sensor in self._last_refusal:
            values += ((LAST_REFUSAL, self._last_refusal[sensor]),)
        if sensor in self._passed_over and sensor not in self._came:
            values += ((PASSED_OVER, self._passed_over[sensor]),)
        if self._left_out[sensor]:
            values += (
                (LEFT_OUT, str(self._left_out[sensor])),
                ("left out since the last report", str(self._newly_left_out[sensor])),
                ("largest rate that is used [1/s]", f"{MOST_READINGS_A_SECOND:.0f}"),
            )
        return values
