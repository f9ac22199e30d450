# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Mistakes of robot, wiring and configuration that `doctor` finds, found while driving."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict

from fnn_ekf_ros.calibration.findings import Change, Finding
from fnn_ekf_ros.calibration.running_examination import RunningExamination
from fnn_ekf_ros.diagnostics.messages import (
    FITTING,
    MISTAKE,
    CompassMessage,
    DiagnosticMessage,
    EncoderMessage,
    FilterMessage,
    FixMessage,
    fill,
    join,
)
from fnn_ekf_ros.diagnostics.noise_words import Values
from fnn_ekf_ros.parameters.localizer import LocalizerParameters
from fnn_ekf_ros.timeline.events import (
    CompassYaw,
    Event,
    Level,
    PoseFix,
    Sensor,
    Status,
    Wheel,
    WheelCount,
)
from fnn_ekf_ros.timeline.wheels import BufferChange

MESSAGES_OF_FINDINGS: Mapping[str, tuple[Sensor, DiagnosticMessage]] = {
    "meters_per_count": (Sensor.ENCODERS, EncoderMessage.WRONG_SIZE),
    "wheel_separation": (Sensor.ENCODERS, EncoderMessage.WRONG_SEPARATION),
    "wheel_ratio": (Sensor.ENCODERS, EncoderMessage.UNEQUAL),
    "left_inverted": (Sensor.ENCODERS, EncoderMessage.LEFT_BACKWARD),
    "right_inverted": (Sensor.ENCODERS, EncoderMessage.RIGHT_BACKWARD),
    "wheels_swapped": (Sensor.ENCODERS, EncoderMessage.SWAPPED),
    "compass_clockwise": (Sensor.COMPASS, CompassMessage.CLOCKWISE),
    "compass_degrees": (Sensor.COMPASS, CompassMessage.DEGREES),
    "compass_random": (Sensor.COMPASS, CompassMessage.RANDOM),
    "compass_offset": (Sensor.COMPASS, CompassMessage.OFF),
    "compass_delay": (Sensor.COMPASS, CompassMessage.DELAYED),
    "fix_yaw_offset": (Sensor.LRF_POSE, FixMessage.YAW_OFF),
    "fix_yaw_clockwise": (Sensor.LRF_POSE, FixMessage.YAW_CLOCKWISE),
    "fixes_mirrored": (Sensor.LRF_POSE, FixMessage.MIRRORED),
    "fix_unit": (Sensor.LRF_POSE, FixMessage.UNIT),
    "fix_delay": (Sensor.LRF_POSE, FixMessage.DELAYED),
}
"""Status and message of each finding of `calibration.findings.KINDS` that readings can show."""

LASTING_JUMPS = 3
"""Consecutive jumps of a wheel from which on they are its motion."""


class Mistakes:
    """Examines the events of a localizer.

    Args:
        parameters: of the localizer.
    """

    def __init__(self, parameters: LocalizerParameters) -> None:
        self._parameters = parameters
        self._examination = RunningExamination(asdict(parameters))
        self._start_ns: int | None = None
        self._compass_sign = -1.0 if parameters.compass_clockwise else 1.0
        ticks = parameters.encoder_source == "ticks"
        self._modulus = 2**parameters.encoder_bits if ticks else None
        self._signs = {
            Wheel.LEFT: -1.0 if parameters.left_inverted else 1.0,
            Wheel.RIGHT: -1.0 if parameters.right_inverted else 1.0,
        }
        self._readings: dict[Wheel, int | float] = {}
        self._counts = dict.fromkeys(Wheel, 0.0)
        self._jumps = dict.fromkeys(Wheel, 0)

    @property
    def findings(self) -> tuple[Finding, ...]:
        """What is wrong, the surest first."""
        return self._examination.findings

    @property
    def examined(self) -> bool:
        """Whether enough of the drive was looked at to find one."""
        return self._examination.examined

    def took(self, event: Event, change: BufferChange) -> None:
        """Take an event in, and what it changed."""
        if self._start_ns is None:
            self._start_ns = event.stamp_ns
        if isinstance(event, WheelCount):
            if not change.out_of_order:
                self._count(event, jumped=change.jump != 0.0)
        elif isinstance(event, CompassYaw):
            yaw = self._compass_sign * event.yaw + self._parameters.compass_offset
            self._examination.compass(self._seconds(event.stamp_ns), yaw)
        elif isinstance(event, PoseFix):
            x, y, yaw = event.pose.tolist()
            self._examination.fix(self._seconds(event.stamp_ns), x, y, yaw)

    def advance(self, now_ns: int) -> None:
        """Look at what is over at a ROS time [ns]."""
        if self._start_ns is not None:
            self._examination.advance(self._seconds(now_ns))

    def _seconds(self, time_ns: int) -> float:
        assert self._start_ns is not None
        return (time_ns - self._start_ns) * 1e-9

    def _count(self, event: WheelCount, *, jumped: bool) -> None:
        """Take a wheel's reading in; a jump is no motion, nor is the way back from a glitch.

        A wheel that jumps again and again only is configured far too large.
        """
        last = self._readings.get(event.wheel)
        self._readings[event.wheel] = event.reading
        before = self._jumps[event.wheel]
        self._jumps[event.wheel] = before + 1 if jumped else 0
        if last is not None and (before >= LASTING_JUMPS or not (jumped or before)):
            step = event.reading - last
            if self._modulus is not None:
                half = self._modulus // 2
                step = (step + half) % self._modulus - half
            self._counts[event.wheel] += self._signs[event.wheel] * step
        side = event.wheel.name.lower()
        self._examination.wheel(side, self._seconds(event.stamp_ns), self._counts[event.wheel])


def culprits(findings: Sequence[Finding]) -> tuple[Sensor, ...]:
    """Return the parts that findings are about, in the order of `Sensor`."""
    found = {MESSAGES_OF_FINDINGS[finding.name][0] for finding in findings}
    return tuple(sensor for sensor in Sensor if sensor in found)


def filter_messages(findings: Sequence[Finding]) -> list[str]:
    """Return what the status `filter` says of findings."""
    return [fill(FilterMessage.MISTAKE, sensor=sensor) for sensor in culprits(findings)]


def without_remedy(status: Status) -> Status:
    """Return a status that names no parameter.

    Symptoms show before the mistake that causes them: a compass that counts clockwise, or a wheel
    that does, looks like one that is off by an angle.
    """
    values = tuple((key, value) for key, value in status.values if key != FITTING)
    return status._replace(values=values)


def with_mistakes(status: Status, findings: Sequence[Finding]) -> Status:
    """Return a sensor's status with what is wrong with it; errors of it come first."""
    own = [each for each in findings if MESSAGES_OF_FINDINGS[each.name][0] == status.name]
    if not own:
        return status
    status = without_remedy(status)
    status = status._replace(values=(*status.values, *_values(own)))
    if status.level is Level.ERROR:
        return status
    messages = [str(MESSAGES_OF_FINDINGS[each.name][1]) for each in own]
    if status.level is Level.WARN:
        messages.append(status.message)
    return status._replace(level=Level.WARN, message=join(messages))


def _values(findings: Sequence[Finding]) -> Values:
    """Return the numbers behind findings: what shows them, how sure, what puts them right."""
    values: Values = (
        (MISTAKE, join(finding.sentence for finding in findings)),
        ("evidence", join(finding.evidence for finding in findings)),
        ("certainty", join(finding.certainty for finding in findings)),
    )
    changes = [change for finding in findings for change in finding.changes]
    if changes:
        values += ((FITTING, join(map(_fitting, changes))),)
    intervals = [change.words() for change in changes if not math.isnan(change.low)]
    if intervals:
        values += (("with its interval", join(intervals)),)
    remaps = [remap for finding in findings for remap in finding.remaps]
    if remaps:
        values += (("remapping that would fit", " ".join(f"-r {remap}" for remap in remaps)),)
    return values


def _fitting(change: Change) -> str:
    return change._replace(low=math.nan, unit="").words()
