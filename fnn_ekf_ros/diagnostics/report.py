# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The report on /diagnostics: one status for each part of the localizer.

docs/diagnostics.md says when a status is WARN and when ERROR; a test compares its numbers with the
constants here and in the modules of the statuses.
"""

from collections.abc import Iterator

from fnn_ekf_ros.core.adaptation import AdaptationMode
from fnn_ekf_ros.core.lasting.report import LastingReport, report_lasting
from fnn_ekf_ros.core.state import FilterState
from fnn_ekf_ros.diagnostics.encoder_status import EncoderStatus
from fnn_ekf_ros.diagnostics.fault_isolation import (
    LEARNING_NS,
    NO_FAULT,
    FaultIsolation,
    isolate_fault,
    symptoms_of,
    with_doubtful_yaw,
    without_unused,
)
from fnn_ekf_ros.diagnostics.filter_status import Failures, FilterFacts, filter_status
from fnn_ekf_ros.diagnostics.frozen import FrozenReadings, frozen_sensors
from fnn_ekf_ros.diagnostics.lasting_words import YawOffset, doubtful_yaw, yaw_offset
from fnn_ekf_ros.diagnostics.late_stamps import LateStamps, late_stamps
from fnn_ekf_ros.diagnostics.messages import (
    EncoderMessage,
    FilterMessage,
    TimeMessage,
    join,
)
from fnn_ekf_ros.diagnostics.mistakes import Mistakes, with_mistakes, without_remedy
from fnn_ekf_ros.diagnostics.recent_periods import (
    RecentPeriods,
    SensorReadings,
    new_move,
    stands,
)
from fnn_ekf_ros.diagnostics.reception import Reception
from fnn_ekf_ros.diagnostics.sensor_status import measuring_status
from fnn_ekf_ros.diagnostics.time_status import TimeStatus
from fnn_ekf_ros.diagnostics.wheel_sizes import size_messages, size_values
from fnn_ekf_ros.parameters.localizer import LocalizerParameters
from fnn_ekf_ros.timeline.events import (
    CompassYaw,
    Estimate,
    Event,
    Level,
    Move,
    PassedOver,
    PoseFix,
    PoseReset,
    Rejected,
    Sensor,
    Status,
    WheelCount,
)
from fnn_ekf_ros.timeline.initialization import AwaitingStart
from fnn_ekf_ros.timeline.inputs import Counts, LeftOut
from fnn_ekf_ros.timeline.wheels import BufferChange

EXPLAINED_NS = 10 * 10**9
"""Time after a fault of a sensor is seen for which it explains what does not fit [ns]: the filter
needs some seconds to settle, and the suspects' leads to fade."""


class DiagnosticsReport:
    """Counts the events of inputs and periods, and makes the statuses of them on request.

    Args:
        parameters: of the localizer.
    """

    def __init__(self, parameters: LocalizerParameters) -> None:
        self._parameters = parameters
        self._reception = Reception()
        self._encoders = EncoderStatus(parameters)
        self._mistakes = Mistakes(parameters)
        self._time = TimeStatus()
        self._failures = Failures()
        self._explained_by: dict[Sensor, int] = {}
        self._reported_move: Move | None = None

    def changed(self, parameters: LocalizerParameters) -> None:
        """Go on with other parameters."""
        self._parameters = parameters
        self._mistakes = Mistakes(parameters)

    def took(self, event: Event, change: BufferChange) -> None:
        """Count an event that was taken in, and what it changed."""
        sensor = _sensor_of(event)
        if change.left_out and sensor is not None:
            self._reception.left_out(sensor, change.left_out)
        if change.changed_ns is None:
            if not change.left_out:
                self._time.repeated()
            return
        if change.out_of_order:
            self._time.out_of_order()
        self._mistakes.took(event, change)
        if isinstance(event, WheelCount):
            self._reception.heard(Sensor.ENCODERS, event.stamp_ns)
            self._encoders.saw(event, change)
        elif isinstance(event, PoseReset):
            self._encoders.pose_was_set(event.stamp_ns)
        elif sensor is not None:
            self._reception.heard(sensor, event.stamp_ns)

    def rejected(self, rejected: Rejected) -> None:
        """Count a message that was refused for what it says."""
        self._reception.refused(rejected)

    def passed_over(self, passed: PassedOver) -> None:
        """Remember a message that says nothing about the sensor."""
        self._reception.passed_over(passed)

    def dropped(self, message: TimeMessage, event: Event, now_ns: int) -> None:
        """Count an event that was refused for its stamp.

        Args:
            message: `LATE` or `AHEAD`.
            event: as it was stamped.
            now_ns: ROS time at which it arrived [ns].
        """
        sensor = _sensor_of(event)
        if sensor is not None:
            self._reception.dropped(sensor)
        self._time.dropped(message, sensor, now_ns - event.stamp_ns)

    def overran(self, seconds: float) -> None:
        """Count a delay of more than a period [s]."""
        self._time.overran(seconds)

    def shed(self, count: int) -> None:
        """Count readings that were left out because the node is too slow."""
        self._time.shed(count)

    def paused(self, time_ns: int) -> None:
        """Count a time in which nothing was heard, not even the clock [ns]."""
        self._time.paused(time_ns)

    def redone(self, periods: int) -> None:
        """Count the periods that were run again for late inputs."""
        self._time.redone(periods)

    def restarted(self, from_ns: int, to_ns: int) -> None:
        """Count a restart by a jump of the clock [ns], after which every stamp begins anew."""
        self._begin_anew()
        self._time.restarted(from_ns, to_ns)

    def set_back(self, from_ns: int, to_ns: int) -> None:
        """Count a step of the clock back [ns] that is no restart; stamps begin anew, too."""
        self._begin_anew()
        self._time.set_back(from_ns, to_ns)

    def _begin_anew(self) -> None:
        self._reception.begin_anew()
        self._failures = self._failures._replace(end_ns=None)
        self._encoders.restarted()
        self._mistakes = Mistakes(self._parameters)
        self._explained_by.clear()
        self._reported_move = None

    def failed(self, end_ns: int, reason: str, *, restarts: bool) -> None:
        """Count a period that left the finite numbers; once if late inputs have it run again."""
        last_ns = self._failures.end_ns
        if last_ns is None or end_ns > last_ns or restarts:
            new = FilterMessage.RESTARTED if restarts else FilterMessage.PERIOD_FAILED
            self._failures = Failures(
                total=self._failures.total + 1, new=new, reason=reason, end_ns=end_ns
            )

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
        self._mistakes.advance(end_ns)
        period_s = self._parameters.period
        if complete and estimate is not None and stands(estimate.twist * period_s, period_s):
            self._reception.stood(round(period_s * 1e9))

    def left_out(self, readings: LeftOut) -> None:
        """Count readings of a period that were too many to be used."""
        for sensor, count in zip((Sensor.COMPASS, Sensor.LRF_POSE), readings, strict=True):
            self._reception.left_out(sensor, count)

    def report(
        self,
        now_ns: int,
        state: FilterState | AwaitingStart,
        estimate: Estimate | None,
        mode: AdaptationMode,
        recent: RecentPeriods | None,
    ) -> tuple[Status, ...]:
        """Return the statuses; events since the last report decide their levels.

        Args:
            now_ns: ROS time [ns].
            state: the filter, or what it waits with.
            estimate: of the last period; None without one.
            mode: the adaptation in use.
            recent: the last periods; None before the filter runs.
        """
        encoders = self._encoders.status(
            self._reception.status(Sensor.ENCODERS, now_ns, expected=True),
            now_ns,
            refused=self._reception.is_refused(Sensor.ENCODERS),
        )
        frozen = frozen_sensors(state)
        mistakes = self._mistakes.findings
        late = late_stamps(self._parameters, recent)
        lasting = _lasting(state)
        offset = None
        if lasting is not None:
            offset = yaw_offset(lasting, self._parameters.compass_offset)
        found = self._isolate(now_ns, encoders, {*frozen, *late}, lasting, recent, mode)
        if mistakes:  # they explain what does not fit
            found = NO_FAULT._replace(leads=found.leads)
            late = {}
            if not any(finding.name == "compass_offset" for finding in mistakes):
                offset = None
        moved = new_move(self._reported_move, recent)
        self._reported_move = moved or self._reported_move
        facts = FilterFacts(
            now_ns=now_ns,
            state=state,
            estimate=estimate,
            recent=recent,
            found=found,
            mistakes=mistakes,
            lasting=lasting,
            mode=mode,
            moved=moved,
            missing=self._missing(state) if isinstance(state, AwaitingStart) else (),
            failures=self._failures,
        )
        statuses = (
            _with_isolation(encoders, found),
            *self._measuring(now_ns, frozen, offset, late, found, recent),
            filter_status(self._parameters, facts),
            self._time.status(),
        )
        if not self._mistakes.examined:
            statuses = tuple(map(without_remedy, statuses))
        statuses = tuple(with_mistakes(status, mistakes) for status in statuses)
        self._reception.reported()
        self._failures = self._failures._replace(new="")
        return statuses

    def _measuring(
        self,
        now_ns: int,
        frozen: dict[Sensor, FrozenReadings],
        offset: YawOffset | None,
        late: dict[Sensor, LateStamps],
        found: FaultIsolation,
        recent: RecentPeriods | None,
    ) -> Iterator[Status]:
        """Yield the statuses of the compass and of the fixes."""
        readings = SensorReadings() if recent is None else recent.readings
        for sensor, of_sensor, expected in (
            (Sensor.COMPASS, readings.compass, not self._parameters.lrf_use_yaw),
            (Sensor.LRF_POSE, readings.lrf_pose, True),
        ):
            common = self._reception.status(sensor, now_ns, expected=expected)
            yield measuring_status(
                common,
                frozen.get(sensor),
                offset,
                late.get(sensor),
                symptoms_of(of_sensor),
                found,
            )

    def _isolate(
        self,
        now_ns: int,
        encoders: Status,
        faulty: set[Sensor],
        lasting: LastingReport | None,
        recent: RecentPeriods | None,
        mode: AdaptationMode,
    ) -> FaultIsolation:
        """Return the sensor that does not fit, unless a fault that is seen already explains it."""
        if recent is None:
            return NO_FAULT
        if encoders.level is not Level.OK:
            self._explained_by[Sensor.ENCODERS] = now_ns
        self._explained_by |= dict.fromkeys(faulty, now_ns)
        learning = mode is AdaptationMode.JOINT and now_ns - recent.start_ns < LEARNING_NS
        found = isolate_fault(recent, self._parameters.wheel_separation, learning=learning)
        found = without_unused(found, self._reception.unused())
        doubtful = None if lasting is None else doubtful_yaw(lasting)
        explained = {
            sensor
            for sensor, last_ns in self._explained_by.items()
            if now_ns - last_ns <= EXPLAINED_NS and sensor is not doubtful
        }
        if explained and found.named not in explained:
            found = NO_FAULT._replace(leads=found.leads)
        if lasting is None or doubtful is None:
            return found
        self._explained_by[doubtful] = now_ns  # what it has shown is seen for a while
        return with_doubtful_yaw(found, doubtful, turned=bool(lasting.doubted))

    def _missing(self, waiting: AwaitingStart) -> tuple[FilterMessage, ...]:
        """Return what a filter that waits waits for."""
        missing = []
        if not self._reception.is_heard(Sensor.ENCODERS):
            missing.append(FilterMessage.AWAITS_COUNTS)
        if waiting.given_pose is None:
            if waiting.position is None:
                missing.append(FilterMessage.AWAITS_POSITION)
            if waiting.yaw is None:
                missing.append(FilterMessage.AWAITS_YAW)
        return tuple(missing) or (FilterMessage.AWAITS_PERIOD,)


def _with_isolation(encoders: Status, found: FaultIsolation) -> Status:
    """Return the encoders' status, WARN if they are what does not fit."""
    if encoders.level is not Level.OK or found.named is not Sensor.ENCODERS:
        return encoders
    if found.sizes is None:
        return encoders._replace(level=Level.WARN, message=EncoderMessage.DISAGREE)
    return encoders._replace(
        level=Level.WARN,
        message=join(size_messages(found.sizes)),
        values=(*encoders.values, *size_values(found.sizes)),
    )


def _lasting(state: FilterState | AwaitingStart) -> LastingReport | None:
    if isinstance(state, AwaitingStart) or state.lasting is None:
        return None
    return report_lasting(state.lasting)


def _sensor_of(event: Event) -> Sensor | None:
    if isinstance(event, WheelCount):
        return Sensor.ENCODERS
    if isinstance(event, CompassYaw):
        return Sensor.COMPASS
    return Sensor.LRF_POSE if isinstance(event, PoseFix) else None
