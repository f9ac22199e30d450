"""What the localizer says about its own condition: one status for each part.

docs/diagnostics.md has the table of what is WARN and what ERROR; a test holds its numbers against
the constants here and in the modules of the parts.
"""

from collections import Counter

from fnn_ekf_ros.core.adaptation import AdaptationMode
from fnn_ekf_ros.core.rows import COMPASS, LRF_POSE
from fnn_ekf_ros.core.state import FilterState
from fnn_ekf_ros.parameters.localizer import LocalizerParameters
from fnn_ekf_ros.pipeline.belief import Values
from fnn_ekf_ros.pipeline.blame import NOBODY, Blame, blame, symptoms_of
from fnn_ekf_ros.pipeline.configure import wheel_geometry
from fnn_ekf_ros.pipeline.encoder_health import EncoderHealth
from fnn_ekf_ros.pipeline.epochs import MOST_READINGS_A_SECOND
from fnn_ekf_ros.pipeline.events import (
    STALE_NS,
    CompassYaw,
    Estimate,
    Event,
    Level,
    Move,
    PoseFix,
    PoseReset,
    Rejected,
    Sensor,
    Status,
    WheelCount,
)
from fnn_ekf_ros.pipeline.filter_health import FilterLook, filter_status
from fnn_ekf_ros.pipeline.frozen import FrozenSensor
from fnn_ekf_ros.pipeline.inputs import Counts
from fnn_ekf_ros.pipeline.measuring_health import OTHERS, measuring_status
from fnn_ekf_ros.pipeline.start import Waiting
from fnn_ekf_ros.pipeline.time_health import TimeHealth
from fnn_ekf_ros.pipeline.watch import Readings, Watch, stands
from fnn_ekf_ros.pipeline.wheel_sizes import in_words
from fnn_ekf_ros.pipeline.wheels import Addition

EXPLAINED_NS = 10 * 10**9
"""What a sensor did that was seen to fail explains what does not fit for so long [ns]."""


class _Heard:
    """How often a sensor was heard, and the newest stamp since the clock jumped last [ns]."""

    __slots__ = ("count", "last_ns")

    def __init__(self) -> None:
        self.count = 0
        self.last_ns: int | None = None

    def at(self, stamp_ns: int) -> None:
        self.count += 1
        if self.last_ns is None or stamp_ns > self.last_ns:
            self.last_ns = max(stamp_ns, 0)


class Health:
    """Counts what happens and puts it into words once in a while.

    Args:
        parameters: which sensors are expected at all.
    """

    def __init__(self, parameters: LocalizerParameters) -> None:
        self._parameters = parameters
        self._heard = {sensor: _Heard() for sensor in Sensor}
        self._stood_ns = 0
        self._refused: Counter[Sensor] = Counter()
        self._left_out: Counter[Sensor] = Counter()
        self._newly_left_out: Counter[Sensor] = Counter()
        self._new_refusal: dict[Sensor, str] = {}
        self._encoders = EncoderHealth(parameters)
        self._time = TimeHealth()
        self._failed = 0
        self._last_failed_ns: int | None = None
        geometry = wheel_geometry(parameters)
        self._frozen = {
            sensor: FrozenSensor(sensor, geometry.metres_per_count, geometry.wheel_separation)
            for sensor in (Sensor.COMPASS, Sensor.LRF_POSE)
        }
        self._new_failure = ""
        self._explained_by: dict[Sensor, int] = {}
        self._told_move_ns: int | None = None

    def changed(self, parameters: LocalizerParameters) -> None:
        """Go on with other parameters."""
        self._parameters = parameters

    def took(self, event: Event, addition: Addition) -> None:
        """Count an event that was taken in, and what it changed."""
        if addition.changed_ns is None:
            self._time.repeated()
            return
        if addition.out_of_order:
            self._time.out_of_order()
        if isinstance(event, WheelCount):
            self._heard[Sensor.ENCODERS].at(event.stamp_ns)
            self._encoders.saw(event, addition)
        elif isinstance(event, PoseReset):
            self._encoders.pose_was_set(event.stamp_ns)
        else:
            sensor = Sensor.COMPASS if isinstance(event, CompassYaw) else Sensor.LRF_POSE
            self._heard[sensor].at(event.stamp_ns)
            self._frozen[sensor].saw(event)
            if sensor is Sensor.LRF_POSE:
                self._stood_ns = 0

    def rejected(self, rejected: Rejected) -> None:
        """Count a message that was refused for what it says."""
        self._refused[rejected.sensor] += 1
        self._new_refusal[rejected.sensor] = rejected.reason

    def dropped(self, event: Event, reason: str) -> None:
        """Count an event that was refused for its stamp."""
        self._time.dropped(_sensor_of(event) or "initialpose", reason)

    def overran(self, seconds: float) -> None:
        """Count a delay of more than a period [s]."""
        self._time.overran(seconds)

    def paused(self, time_ns: int) -> None:
        """Count a time in which nothing was heard, not even the clock [ns]."""
        self._time.paused(time_ns)

    def redone(self, periods: int) -> None:
        """Count the periods that were run again for late inputs."""
        self._time.redone(periods)

    def restarted(self, reason: str, from_ns: int, to_ns: int) -> None:
        """Count a restart by a jump of the clock, after which every stamp begins anew."""
        for heard in self._heard.values():
            heard.last_ns = None
        self._stood_ns = 0
        self._last_failed_ns = None
        self._encoders.restarted()
        for frozen in self._frozen.values():
            frozen.forget()
        self._explained_by.clear()
        self._told_move_ns = None
        self._time.restarted(reason, from_ns, to_ns)

    def failed(self, end_ns: int, reason: str, *, restarts: bool) -> None:
        """Count a period that left the finite numbers; once if late inputs have it run again."""
        if self._last_failed_ns is None or end_ns > self._last_failed_ns or restarts:
            what = "the filter starts anew" if restarts else "its measurements are left out"
            self._new_failure = f"the period until {end_ns * 1e-9:.3f} s failed ({reason}): {what}"
            self._last_failed_ns = end_ns
            self._failed += 1

    def closed(
        self, end_ns: int, complete: bool, counts: Counts, estimate: Estimate | None
    ) -> None:
        """Count a period.

        Args:
            end_ns: its end [ns].
            complete: whether both wheels were known up to there.
            counts: what they had counted there.
            estimate: what came of it.
        """
        self._encoders.closed(end_ns, complete, counts, estimate)
        for frozen in self._frozen.values():
            frozen.closed(counts)
        period_s = self._parameters.period
        if complete and estimate is not None and stands(estimate.twist * period_s, period_s):
            self._stood_ns += round(period_s * 1e9)

    def left_out(self, readings: tuple[int, int]) -> None:
        """Count readings of compass and fixes that were too many to be taken in a period."""
        for sensor, count in zip((Sensor.COMPASS, Sensor.LRF_POSE), readings, strict=True):
            if count:
                self._left_out[sensor] += count
                self._newly_left_out[sensor] += count

    def report(
        self,
        now_ns: int,
        state: FilterState | Waiting,
        estimate: Estimate | None,
        mode: AdaptationMode,
        watch: Watch | None,
    ) -> tuple[Status, ...]:
        """Return the statuses; what is new since the last report decides their levels."""
        encoders = self._encoders.status(
            self._sensor(Sensor.ENCODERS, now_ns, expected=True),
            now_ns,
            refused=Sensor.ENCODERS in self._new_refusal,
        )
        frozen = {sensor: each.accusation() for sensor, each in self._frozen.items()}
        found = self._blame(now_ns, encoders, frozen, watch)
        if encoders.level is Level.OK and found.culprit is Sensor.ENCODERS:
            what = (
                "wheel slip or an encoder fault" if found.sizes is None else in_words(found.sizes)
            )
            message = f"disagree with {OTHERS[Sensor.ENCODERS]}: {what}"
            encoders = encoders._replace(level=Level.WARN, message=message)
        readings = (Readings(), Readings()) if watch is None else watch.readings
        measuring = (
            measuring_status(
                self._sensor(sensor, now_ns, expected=expected),
                frozen[sensor],
                symptoms_of(readings[index]),
                found,
            )
            for sensor, index, expected in (
                (Sensor.COMPASS, COMPASS, not self._parameters.lrf_use_yaw),
                (Sensor.LRF_POSE, LRF_POSE, True),
            )
        )
        look = FilterLook(
            now_ns,
            state,
            estimate,
            watch,
            found,
            mode,
            self._new_move(watch),
            self._missing(state) if isinstance(state, Waiting) else "",
            self._new_failure,
            self._failed,
        )
        statuses = (
            encoders,
            *measuring,
            filter_status(self._parameters, look),
            self._time.status(),
        )
        self._new_refusal.clear()
        self._newly_left_out.clear()
        self._new_failure = ""
        return statuses

    def _blame(
        self, now_ns: int, encoders: Status, frozen: dict[Sensor, str], watch: Watch | None
    ) -> Blame:
        """Return who is to blame for what does not fit, but for what is explained already."""
        if watch is None:
            return NOBODY
        if encoders.level is not Level.OK:
            self._explained_by[Sensor.ENCODERS] = now_ns
        self._explained_by |= {sensor: now_ns for sensor, words in frozen.items() if words}
        found = blame(watch, self._parameters.wheel_separation)
        explained = {
            sensor
            for sensor, last_ns in self._explained_by.items()
            if now_ns - last_ns <= EXPLAINED_NS
        }
        if explained and found.culprit not in explained:
            return NOBODY._replace(leads=found.leads)
        return found

    def _new_move(self, watch: Watch | None) -> Move | None:
        """Return a move of the pose that has not been told yet."""
        moved = None if watch is None else watch.moved
        if moved is None or moved.stamp_ns == self._told_move_ns:
            return None
        self._told_move_ns = moved.stamp_ns
        return moved

    def _sensor(self, sensor: Sensor, now_ns: int, *, expected: bool) -> Status:
        heard = self._heard[sensor]
        last_ns = heard.last_ns
        values: Values = (
            ("received", str(heard.count)),
            ("refused", str(self._refused[sensor])),
        )
        if self._left_out[sensor]:
            values += (("left out", str(self._left_out[sensor])),)
        if sensor in self._new_refusal:
            return Status(sensor, Level.WARN, f"refused: {self._new_refusal[sensor]}", values)
        if last_ns is None:
            level = Level.WARN if expected else Level.OK
            return Status(sensor, level, "no message yet" if expected else "not used", values)
        age_ns = max(now_ns - last_ns, 0)
        values = (("age [s]", f"{age_ns * 1e-9:.3f}"), *values)
        stood_ns = self._stood_ns if sensor is Sensor.LRF_POSE else 0
        if age_ns > STALE_NS:
            silent = f"silent for {age_ns * 1e-9:.1f} s"
            if age_ns - stood_ns > STALE_NS:
                return Status(sensor, Level.WARN, silent, values)
            return Status(sensor, Level.OK, f"{silent}; the robot stands or stood", values)
        if count := self._newly_left_out[sensor]:
            most = f"more than {MOST_READINGS_A_SECOND:.0f} readings a second"
            message = f"too fast: {most}, {count} left out; lower the sensor's rate"
            return Status(sensor, Level.WARN, message, values)
        return Status(sensor, Level.OK, "received", values)

    def _missing(self, waiting: Waiting) -> str:
        missing = ["wheel counts"] if self._heard[Sensor.ENCODERS].last_ns is None else []
        if waiting.given_pose is None:
            missing += [
                name
                for name, value in (("position", waiting.position), ("yaw", waiting.yaw))
                if value is None
            ]
        return " and ".join(missing) or "period of both wheels"


def _sensor_of(event: Event) -> Sensor | None:
    if isinstance(event, WheelCount):
        return Sensor.ENCODERS
    if isinstance(event, CompassYaw):
        return Sensor.COMPASS
    return Sensor.LRF_POSE if isinstance(event, PoseFix) else None
