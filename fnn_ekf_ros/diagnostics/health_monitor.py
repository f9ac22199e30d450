# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Follows a run by the localizer's outputs as they come, and sums up how healthy it was.

The memory is bounded: a run is counted, not kept. /diagnostics comes once a second, so that a share
of its reports is a share of the time. What was reported before the filter started is not counted,
but for what it waited for.
"""

from collections import Counter

import numpy as np

from fnn_ekf_ros.core.joint_state import noise_without_alarms
from fnn_ekf_ros.core.lasting.report import LastingReport
from fnn_ekf_ros.core.results import StepResult
from fnn_ekf_ros.core.rows import COMPASS, LRF_POSE
from fnn_ekf_ros.core.state import FilterState
from fnn_ekf_ros.diagnostics.health import (
    FoundNoise,
    HealthSummary,
    SensorHealth,
    SensorNis,
    StatusHealth,
    honest_band,
)
from fnn_ekf_ros.diagnostics.lasting_words import lasting_in_words
from fnn_ekf_ros.diagnostics.messages import (
    LEFT_OUT,
    MEASUREMENT_NOISES,
    PROCESS_NOISES,
    RECEIVED,
    REFUSED,
    SEPARATOR,
    dropped_key,
    fitting_parameters,
)
from fnn_ekf_ros.diagnostics.travel import Travel
from fnn_ekf_ros.parameters.localizer import LocalizerParameters
from fnn_ekf_ros.parameters.schema import default_of
from fnn_ekf_ros.timeline.events import Level, Move, Output, Sensor, Status
from fnn_ekf_ros.timeline.filter_model import noise_bounds

_USUAL_NOISE = (
    *default_of(LocalizerParameters, "process_noise_std"),
    *default_of(LocalizerParameters, "measurement_noise_std"),
    default_of(LocalizerParameters, "lrf_yaw_std"),
)
"""Defaults of the noise parameters (m, rad, m, m, rad, rad)."""


class _Reports:
    """Counts the reports of one status."""

    def __init__(self) -> None:
        self.levels: Counter[Level] = Counter()
        self.messages: Counter[str] = Counter()
        self.values: dict[str, tuple[tuple[str, str], ...]] = {}
        self.last = Level.OK

    def saw(self, status: Status) -> None:
        self.levels[status.level] += 1
        self.last = status.level
        if status.level is Level.OK:
            return
        for message in status.message.split(SEPARATOR):
            self.messages[message] += 1
            self.values[message] = status.values

    def health(self, name: str) -> StatusHealth:
        message, count = next(iter(self.messages.most_common(1)), ("", 0))
        return StatusHealth(
            name=name,
            reports=self.levels.total(),
            warnings=self.levels[Level.WARN],
            errors=self.levels[Level.ERROR],
            last=self.last,
            message=message,
            message_reports=count,
            values=self.values.get(message, ()),
        )


class _Judged:
    """Counts the readings of a sensor that came in time, and their NIS."""

    def __init__(self) -> None:
        self.count = self.rejected = self.rows = 0
        self.nis = 0.0


class HealthMonitor:
    """Follows a run by its outputs.

    Args:
        parameters: of the localizer.
    """

    def __init__(self, parameters: LocalizerParameters) -> None:
        self._parameters = parameters
        self._started_ns: int | None = None
        self._estimates = 0
        self._awaited = ""
        self._reports: dict[str, _Reports] = {}
        self._last_values: dict[str, dict[str, str]] = {}
        self._received_before: dict[Sensor, int] = {}
        self._fitting: dict[str, bool | float | str] = {}
        self._judged = {sensor: _Judged() for sensor in (Sensor.COMPASS, Sensor.LRF_POSE)}
        self._travel = Travel(parameters.period)
        self._state: FilterState | None = None
        self._lasting: LastingReport | None = None
        self._moves = 0
        self._last_move: Move | None = None

    def saw(self, output: Output) -> None:
        """Count the output of a period."""
        if output.estimate is not None:
            if self._started_ns is None:
                self._started_ns = output.estimate.stamp_ns
                self._received_before = {sensor: self._taken(sensor) for sensor in Sensor}
            self._estimates += 1
            self._state = output.estimate.state
            self._travel.saw(output.estimate, moved=output.moved is not None)
            if output.estimate.result is not None:
                self._saw_result(output.estimate.result)
        if output.moved is not None:
            self._moves += 1
            self._last_move = output.moved
        if output.statuses is not None:
            self._fitting = {}
        for status in output.statuses or ():
            self._fitting |= fitting_parameters(status.values)
            self._last_values[status.name] = dict(status.values)
            if self._started_ns is not None:
                self._reports.setdefault(status.name, _Reports()).saw(status)
            elif status.name == "filter":
                self._awaited = status.message

    def summary(self) -> HealthSummary | None:
        """Return the summary so far; None before the filter has started."""
        if self._started_ns is None or self._state is None:
            return None
        lasting = self._lasting
        return HealthSummary(
            parameters=self._parameters,
            started_ns=self._started_ns,
            estimates=self._estimates,
            awaited=self._awaited,
            statuses=tuple(reports.health(name) for name, reports in self._reports.items()),
            noise=self._noise(self._state),
            nis=tuple(
                SensorNis(sensor, judged.nis / judged.rows, judged.rows, honest_band(judged.rows))
                for sensor, judged in self._judged.items()
                if judged.rows
            ),
            travel=self._travel.ratios(),
            sensors=tuple(map(self._sensor, Sensor)),
            lasting="" if lasting is None else lasting_in_words(lasting)[0][1],
            fitting=tuple(self._fitting.items()),
            moves=self._moves,
            last_move=self._last_move,
        )

    def _saw_result(self, result: StepResult) -> None:
        if result.lasting is not None:
            self._lasting = result.lasting
        for shown in result.shown:
            for sensor, row in ((Sensor.COMPASS, COMPASS), (Sensor.LRF_POSE, LRF_POSE)):
                rows = int(shown.sensor_degrees_of_freedom[row])
                if not rows:
                    continue
                judged = self._judged[sensor]
                judged.count += 1
                if shown.rejected[row]:
                    judged.rejected += 1
                else:
                    judged.rows += rows
                    judged.nis += float(shown.sensor_nis[row])

    def _noise(self, state: FilterState) -> tuple[FoundNoise, ...]:
        """Return the noise of the wheels and of the sensors that were there."""
        p = self._parameters
        bounds = noise_bounds(p)
        Q, R = bounds.within(state.process_noise, state.measurement_noise)
        if state.joint is not None:
            Q, R = noise_without_alarms(state.joint, bounds)
        fixes, compass = (
            self._sensor(sensor).received > 0 for sensor in (Sensor.LRF_POSE, Sensor.COMPASS)
        )
        is_there = (True, True, fixes, fixes, compass, fixes and p.lrf_use_yaw)
        each = zip(
            (*PROCESS_NOISES, *MEASUREMENT_NOISES),
            ("m", "rad", "m", "m", "rad", "rad"),
            (*p.process_noise_std, *p.measurement_noise_std, p.lrf_yaw_std),
            np.sqrt([*Q, *R]),
            _USUAL_NOISE,
            is_there,
            strict=True,
        )
        return tuple(
            FoundNoise(name, unit, configured, float(found), usual)
            for name, unit, configured, found, usual, there in each
            if there
        )

    def _taken(self, sensor: Sensor) -> int:
        """Return how many readings were taken in up to the last report and not left out."""
        own = self._last_values.get(sensor, {})
        return int(own.get(RECEIVED, 0)) - int(own.get(LEFT_OUT, 0))

    def _sensor(self, sensor: Sensor) -> SensorHealth:
        own = self._last_values.get(sensor, {})
        time = self._last_values.get("time", {})
        judged = self._judged.get(sensor)
        since_start = self._taken(sensor) - self._received_before.get(sensor, 0)
        return SensorHealth(
            sensor=sensor,
            received=int(own.get(RECEIVED, 0)),
            refused=int(own.get(REFUSED, 0)),
            dropped=int(time.get(dropped_key(sensor), 0)),
            left_out=int(own.get(LEFT_OUT, 0)),
            in_time=0 if judged is None else judged.count,
            late=0 if judged is None else max(since_start - judged.count, 0),
            rejected=0 if judged is None else judged.rejected,
        )
