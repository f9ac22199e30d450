"""What the localizer says about its own condition: one status for each part.

| status | WARN | ERROR |
| --- | --- | --- |
| encoders | periods closed without both wheels; messages refused | none, or not for `STALE_NS` |
| compass, lrf_pose | none, or not for `STALE_NS`; messages refused | |
| filter | waits for its start | |
| time | late messages were dropped, or the clock jumped | |
"""

from collections import Counter

import numpy as np

from fnn_ekf_ros.core.adaptation import AdaptationMode
from fnn_ekf_ros.core.filter import FilterState
from fnn_ekf_ros.parameters.localizer import LocalizerParameters
from fnn_ekf_ros.pipeline.belief import Values, belief_in_words
from fnn_ekf_ros.pipeline.events import (
    CompassYaw,
    Estimate,
    Event,
    Level,
    PoseFix,
    Rejected,
    Sensor,
    Status,
    WheelCount,
)
from fnn_ekf_ros.pipeline.start import Waiting

STALE_NS = 3 * 10**9
"""A sensor that has been silent for longer is called stale [ns]."""


class Health:
    """Counts what happens and puts it into words once in a while.

    Args:
        parameters: which sensors are expected at all.
    """

    def __init__(self, parameters: LocalizerParameters) -> None:
        self._parameters = parameters
        self._last_ns: dict[Sensor, int] = {}
        self._received: Counter[Sensor] = Counter()
        self._refused: Counter[Sensor] = Counter()
        self._new_refusal: dict[Sensor, str] = {}
        self._timeouts = self._new_timeouts = 0
        self._dropped = self._redone = self._restarts = 0
        self._new_time_trouble = ""

    def changed(self, parameters: LocalizerParameters) -> None:
        """Go on with other parameters."""
        self._parameters = parameters

    def saw(self, event: Event) -> None:
        """Count an event that was taken in."""
        sensor = _sensor_of(event)
        if sensor is not None:
            self._received[sensor] += 1
            self._last_ns[sensor] = max(event.stamp_ns, self._last_ns.get(sensor, 0))

    def rejected(self, rejected: Rejected) -> None:
        """Count a message that was refused for what it says."""
        self._refused[rejected.sensor] += 1
        self._new_refusal[rejected.sensor] = rejected.reason

    def dropped(self, event: Event, reason: str) -> None:
        """Count an event that was refused for its stamp."""
        self._dropped += 1
        name = _sensor_of(event) or "initialpose"
        self._new_time_trouble = f"{name} {reason}"

    def redone(self, periods: int) -> None:
        """Count the periods that were run again for late inputs."""
        self._redone += periods

    def restarted(self, reason: str, from_ns: int, to_ns: int) -> None:
        """Count a restart by a jump of the clock, after which every stamp begins anew."""
        self._restarts += 1
        self._last_ns.clear()
        self._new_time_trouble = f"{reason} from {from_ns * 1e-9:.3f} s to {to_ns * 1e-9:.3f} s"

    def closed(self, complete: bool) -> None:
        """Count a period; `complete` if both wheels were known up to its end."""
        if not complete:
            self._timeouts += 1
            self._new_timeouts += 1

    def report(
        self,
        now_ns: int,
        state: FilterState | Waiting,
        estimate: Estimate | None,
        mode: AdaptationMode,
    ) -> tuple[Status, ...]:
        """Return the statuses; what is new since the last report decides their levels."""
        statuses = (
            self._encoders(now_ns),
            self._sensor(Sensor.COMPASS, now_ns, expected=not self._parameters.lrf_use_yaw),
            self._sensor(Sensor.LRF_POSE, now_ns, expected=True),
            self._filter(state, estimate, mode),
            self._time(),
        )
        self._new_refusal.clear()
        self._new_timeouts = 0
        self._new_time_trouble = ""
        return statuses

    def _encoders(self, now_ns: int) -> Status:
        status = self._sensor(Sensor.ENCODERS, now_ns, expected=True)
        values = (*status.values, ("periods closed without both wheels", str(self._timeouts)))
        if status.level is Level.WARN and Sensor.ENCODERS not in self._new_refusal:
            return status._replace(level=Level.ERROR, values=values)
        if status.level is Level.OK and self._new_timeouts:
            message = f"{self._new_timeouts} periods closed without both wheels"
            return status._replace(level=Level.WARN, message=message, values=values)
        return status._replace(values=values)

    def _sensor(self, sensor: Sensor, now_ns: int, *, expected: bool) -> Status:
        last_ns = self._last_ns.get(sensor)
        values: Values = (
            ("received", str(self._received[sensor])),
            ("refused", str(self._refused[sensor])),
        )
        if sensor in self._new_refusal:
            return Status(sensor, Level.WARN, f"refused: {self._new_refusal[sensor]}", values)
        if last_ns is None:
            level = Level.WARN if expected else Level.OK
            return Status(sensor, level, "no message yet" if expected else "not used", values)
        age_ns = max(now_ns - last_ns, 0)
        values = (("age [s]", f"{age_ns * 1e-9:.3f}"), *values)
        if age_ns > STALE_NS:
            return Status(sensor, Level.WARN, f"silent for {age_ns * 1e-9:.1f} s", values)
        return Status(sensor, Level.OK, "received", values)

    def _filter(
        self, state: FilterState | Waiting, estimate: Estimate | None, mode: AdaptationMode
    ) -> Status:
        asked = self._parameters.adaptation
        values: Values = (
            ("adaptation", asked if mode == asked else f"{asked}, disabled"),
            ("process noise std [m, rad]", _stds(state.process_noise)),
            ("measurement noise std [m, m, rad, rad]", _stds(state.measurement_noise)),
        )
        if isinstance(state, Waiting):
            missing = [
                name
                for name, value in (("position", state.position), ("yaw", state.yaw))
                if value is None
            ]
            if Sensor.ENCODERS not in self._last_ns:
                missing.insert(0, "wheel counts")
            message = f"waiting for the first {' and '.join(missing)}"
            return Status("filter", Level.WARN, message, values)
        values += (("position std [m]", f"{_position_std(state):.3g}"),)
        if estimate is not None and estimate.result is not None:
            result = estimate.result
            values += (
                ("NIS", f"{float(result.nis):.3g}"),
                ("degrees of freedom", f"{int(result.degrees_of_freedom)}"),
            )
            if result.joint is not None:
                values += belief_in_words(result.joint)
        return Status("filter", Level.OK, "running", values)

    def _time(self) -> Status:
        values = (
            ("dropped", str(self._dropped)),
            ("periods run again for late inputs", str(self._redone)),
            ("restarts", str(self._restarts)),
        )
        if self._new_time_trouble:
            return Status("time", Level.WARN, self._new_time_trouble, values)
        return Status("time", Level.OK, "in order", values)


def _sensor_of(event: Event) -> Sensor | None:
    if isinstance(event, WheelCount):
        return Sensor.ENCODERS
    if isinstance(event, CompassYaw):
        return Sensor.COMPASS
    return Sensor.LRF_POSE if isinstance(event, PoseFix) else None


def _stds(variances: object) -> str:
    return ", ".join(f"{value:.4g}" for value in np.sqrt(np.asarray(variances)))


def _position_std(state: FilterState) -> float:
    return float(np.sqrt(np.max(np.linalg.eigvalsh(state.covariance[:2, :2]))))
