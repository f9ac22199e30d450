# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""An examination of a drive: readings in, findings out."""

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from fnn_ekf_ros.calibration.counters import Counter, read_counter
from fnn_ekf_ros.calibration.evidence import (
    FEWEST_READINGS,
    Evidence,
    Readings,
    evidence_of,
)
from fnn_ekf_ros.calibration.explanation import Explanation, explain
from fnn_ekf_ros.calibration.findings import LEVEL, Certainty, Change, Finding, in_order
from fnn_ekf_ros.calibration.geometry_findings import Context, compass_unit, geometry_findings
from fnn_ekf_ros.calibration.robot import Number
from fnn_ekf_ros.calibration.travel import WheelTravel, usual_interval, wheel_travel
from fnn_ekf_ros.core.arrays import FloatArray

FEWEST_COUNTS = 10.0
"""Counts of both wheels below which the robot stood still: less than an encoder's jitter."""
STILL_RAD = 0.05
"""The same of positions from joint_states [rad]."""
LEAST_ROTATION = 0.5
"""Range of directions below which the robot never turned [rad]."""
NEED_TURNS = ("wheel_separation", "wheel_ratio", "wheels_swapped", "compass_clockwise")
"""Findings that only a robot that turns can give."""
ONE_RATE_S = 1.0
"""Time over which travel of the wheels is compared with each other [s]."""
ONE_RATE = 0.03
"""Part of one wheel's travel that does not follow from the other's, root mean square, below which
the robot turned at one rate only: what wheels and sensors have to do with each other then has one
equation for two numbers, and anything fits it."""
SETTLED_S = 45.0
"""Length of a drive from which on small differences count [s]: their errors come from blocks of
15 s (`drift_regression`), and fewer than three of these tell nothing about errors."""
GROSS = {
    "meters_per_count": 1.5, "wheel_separation": 1.5, "wheel_ratio": 1.5,
    "compass_offset": 0.5, "fix_yaw_offset": 0.5, "compass_delay": 1.0, "fix_delay": 1.0,
}  # fmt: skip
"""Differences that count in a shorter drive: a factor of sizes, an angle [rad], a delay [s]."""
SIZES = ("meters_per_count", "wheel_separation", "wheel_ratio")
"""Those of them that are factors."""
ESTIMATED = {
    Number.SCALE: "wheel_radius",
    Number.RATIO: "right_over_left",
    Number.SEPARATION: "wheel_separation",
    Number.COMPASS_OFFSET: "compass_offset",
    Number.FIX_YAW_OFFSET: "lrf_yaw_offset",
    Number.COMPASS_DELAY: "compass_delay",
    Number.FIX_DELAY: "lrf_pose_delay",
}
"""Names of the estimates; all but `right_over_left` are parameters."""
FEWEST_WHEEL_READINGS = 20
"""Readings of each wheel that an examination needs."""


class Drive(NamedTuple):
    """Readings as they came; stamps in seconds, all since one instant.

    Attributes:
        left: `(n, 2)` stamps and readings of the left wheel.
        right: `(n, 2)` likewise.
        compass: `(n, 2)` stamps, yaw [s, rad].
        fixes: `(n, 4)` stamps, x, y, yaw [s, m, m, rad]; NaN yaw where there is none.
    """

    left: FloatArray
    right: FloatArray
    compass: FloatArray
    fixes: FloatArray


class Examined(NamedTuple):
    """The result of an examination.

    Attributes:
        findings: what is wrong, the surest first.
        evidence: what the readings say; None if the wheels did not move.
        explanation: what explains it; None if there is nothing to explain.
        estimates: every number that could be estimated, with its 95 % interval, by parameter.
    """

    findings: tuple[Finding, ...]
    evidence: Evidence | None = None
    explanation: Explanation | None = None
    estimates: tuple[Change, ...] = ()


def examine(drive: Drive, configured: Mapping[str, Any]) -> Examined:
    """Return what is wrong with robot, wiring or configuration.

    Args:
        drive: readings of a drive.
        configured: parameters of the localizer, by name; lengths may be out of range.
    """
    if min(len(drive.left), len(drive.right)) < FEWEST_WHEEL_READINGS:
        return Examined((_too_short(drive),))
    ticks = configured["encoder_source"] == "ticks"
    bits = int(configured["encoder_bits"]) if ticks else None
    counters = [read_counter(wheel, bits) for wheel in (drive.left, drive.right)]
    findings = _counter_findings(counters, bits)
    if len(drive.fixes) < FEWEST_READINGS:
        findings.append(_too_short(drive))
    moved = [float(np.sum(np.abs(np.diff(counter.readings[:, 1])))) for counter in counters]
    if sum(moved) < (FEWEST_COUNTS if ticks else STILL_RAD):
        return Examined(in_order([*findings, _standing(moved)]))
    if min(moved) == 0.0:
        return Examined(in_order([*findings, _stuck(moved)]))
    findings += _frozen(drive)
    if any(finding.name == "frozen_sensor" and "fixes" in finding.sentence for finding in findings):
        return Examined(in_order(findings))
    travel = wheel_travel(
        *(
            as_counted(counter, configured, side)
            for counter, side in zip(counters, ("left", "right"), strict=True)
        )
    )
    readings = Readings(
        travel,
        _as_configured(drive.compass, configured),
        _as_configured_fixes(drive.fixes, configured),
    )
    if len(travel.times) < FEWEST_WHEEL_READINGS:
        return Examined(in_order([*findings, _too_short(drive)]))
    interval_s = usual_interval(*(counter.readings[:, 0] for counter in counters))
    return _compared(readings, interval_s, configured, findings)


def _compared(
    readings: Readings, interval_s: float, configured: Mapping[str, Any], findings: list[Finding]
) -> Examined:
    """Return what wheels, fixes and compass say of each other, beside what was found already."""
    meters, separation = meters_per_count(configured), float(configured["wheel_separation"])
    evidence = evidence_of(readings, np.array([0.0, 2.0 * meters / separation]))
    explanation = explain(evidence, meters, separation)
    if evidence.random_compass:
        findings = [*findings, random_compass()]
    elif evidence.compass is None and evidence.fix_yaw is None and not findings:
        findings = [_no_yaw()]
    if _rotation(evidence) >= LEAST_ROTATION and _at_one_rate(readings.travel):
        return Examined(in_order([*findings, _one_rate()]), evidence)
    if explanation is None:
        return Examined(in_order([*findings, *compass_unit(evidence)]), evidence)
    context = Context(configured, evidence, explanation, interval_s)
    long_s = float(readings.travel.times[-1] - readings.travel.times[0])
    found = told_findings(context, long_s)
    return Examined(in_order([*findings, *found]), evidence, explanation, _estimates(context))


def told_findings(context: Context, long_s: float) -> list[Finding]:
    """Return the findings that a drive of some length [s] can tell, by how far the robot turned."""
    rotation = _rotation(context.evidence)
    found = geometry_findings(context)
    if long_s < SETTLED_S:
        found = [
            finding._replace(certainty=Certainty.POSSIBLE)
            if is_small(finding, context.configured)
            else finding
            for finding in found
        ]
    if rotation < LEAST_ROTATION:
        found = [finding for finding in found if finding.name not in NEED_TURNS]
        found.append(_straight(rotation))
    return found


def _rotation(evidence: Evidence) -> float:
    """Return the range of directions that the sensors show; infinite if they show none [rad]."""
    sources = [each for each in (evidence.compass, evidence.fix_yaw) if each is not None]
    return max((each.turned for each in sources), default=math.inf)


def _at_one_rate(travel: WheelTravel) -> bool:
    """Return whether the travel of the wheels is in one ratio all the time."""
    times = np.arange(travel.times[0], travel.times[-1], ONE_RATE_S)
    steps = np.diff(travel.at(times), axis=0)
    sizes = np.sqrt(np.mean(steps**2, axis=0))
    alike = np.linalg.eigvalsh(steps.T @ steps / np.outer(sizes, sizes) / max(len(steps), 1))
    return len(steps) > 1 and bool(math.sqrt(max(float(alike[0]), 0.0)) < ONE_RATE)


def is_small(finding: Finding, configured: Mapping[str, Any]) -> bool:
    """Return whether a finding is about a number that is off by less than `GROSS`."""
    if finding.name not in GROSS:
        return False
    for change in finding.changes:
        value, now = float(change.value), float(configured[change.parameter])
        apart = abs(value - now)
        if finding.name in SIZES:
            apart = max(value / now, now / value)
        if apart >= GROSS[finding.name]:
            return False
    return True


def meters_per_count(configured: Mapping[str, Any]) -> float:
    """Return what parameters make of a count, or of a radian with joint_states [m]."""
    radius = float(configured["wheel_radius"])
    if configured["encoder_source"] != "ticks":
        return radius
    turns = float(configured["gear_ratio"]) * float(configured["encoder_counts_per_revolution"])
    return 2.0 * math.pi * radius / turns


def as_counted(counter: Counter, configured: Mapping[str, Any], side: str) -> FloatArray:
    """Return a wheel's counts as the localizer takes them."""
    sign = -1.0 if configured[f"{side}_inverted"] else 1.0
    multiplier = float(configured[f"{side}_wheel_radius_multiplier"])
    return counter.readings * [1.0, sign * multiplier]


def _as_configured(compass: FloatArray, configured: Mapping[str, Any]) -> FloatArray:
    """Return compass readings as the localizer takes them."""
    sign = -1.0 if configured["compass_clockwise"] else 1.0
    delay = float(configured["compass_delay"])
    return compass * [1.0, sign] + [-delay, float(configured["compass_offset"])]


def _as_configured_fixes(fixes: FloatArray, configured: Mapping[str, Any]) -> FloatArray:
    scale = float(configured["lrf_pose_scale"])
    delay = float(configured["lrf_pose_delay"])
    offset = float(configured["lrf_yaw_offset"])
    return fixes * [1.0, scale, scale, 1.0] + [-delay, 0.0, 0.0, offset]


def _counter_findings(counters: list[Counter], bits: int | None) -> list[Finding]:
    found = []
    if bits is not None:
        other = [counter for counter in counters if counter.bits != bits]
        if other:
            width = max(counter.bits for counter in other)
            wraps = sum(counter.wraps for counter in counters)
            shows = f"{wraps} jumps by 2^{width} counts" if wraps else "counts beyond that range"
            found.append(
                Finding(
                    "encoder_bits",
                    f"the counters have {width} bits, encoder_bits says {bits}",
                    shows,
                    Certainty.CERTAIN if wraps != 1 else Certainty.LIKELY,
                    (Change("encoder_bits", width),),
                )
            )
    resets = [counter.resets for counter in counters]
    if any(resets):
        found.append(
            Finding(
                "counter_resets",
                "counters jump further than a wheel can turn; that is counted as no motion",
                f"{resets[0]} times left, {resets[1]} times right",
                Certainty.POSSIBLE,
            )
        )
    return found


def _standing(moved: list[float]) -> Finding:
    return Finding(
        "standing",
        "the robot stood still: record a drive with turns to both sides",
        f"the counters moved by {moved[0]:g} and {moved[1]:g} in all",
        Certainty.CERTAIN,
    )


def _too_short(drive: Drive) -> Finding:
    return Finding(
        "too_short",
        "there are too few readings to compare wheels and sensors: record a minute or more",
        f"{len(drive.left)} of the left wheel, {len(drive.right)} of the right one, "
        f"{len(drive.compass)} of the compass, {len(drive.fixes)} fixes",
        Certainty.CERTAIN,
    )


def _stuck(moved: list[float]) -> Finding:
    side = "left" if moved[0] == 0.0 else "right"
    return Finding(
        "stuck_wheel",
        f"the {side} counter never changes: cable, encoder or topic",
        f"the other one moved by {max(moved):g} counts",
        Certainty.CERTAIN,
    )


def _frozen(drive: Drive) -> list[Finding]:
    """Return the sensors that show the same all the time."""
    found = []
    for name, readings in (("compass", drive.compass[:, 1:2]), ("fixes", drive.fixes[:, 1:3])):
        if len(readings) >= FEWEST_READINGS and not np.any(np.ptp(readings, axis=0)):
            verb = "change" if name == "fixes" else "changes"
            found.append(
                Finding(
                    "frozen_sensor",
                    f"the {name} never {verb} although the wheels move the robot",
                    f"{len(readings)} equal readings",
                    Certainty.CERTAIN,
                )
            )
    return found


def _no_yaw() -> Finding:
    return Finding(
        "no_yaw",
        "nothing gives a yaw: neither a compass nor the fixes",
        "without one, wheels and fixes cannot be compared, and the filter cannot start",
        Certainty.CERTAIN,
    )


def _straight(rotation: float) -> Finding:
    return Finding(
        "never_turning",
        "the robot hardly turned: wheel_separation and the sides cannot be told from this bag",
        f"its direction changed by {rotation:.2g} rad in all",
        Certainty.CERTAIN,
    )


def _one_rate() -> Finding:
    return Finding(
        "one_rate",
        "the robot turned at one rate all the time, so nothing can be told of wheels and sensors: "
        "record a drive with turns to both sides",
        "the travel of the wheels is in one ratio",
        Certainty.CERTAIN,
    )


def random_compass() -> Finding:
    """Return what is said of a compass that is random beside the robot's rotation."""
    return Finding(
        "compass_random",
        "the compass has nothing to do with the rotation: degrees taken for radians, a broken "
        "sensor, or another one's topic",
        "the changes of its readings have no direction in common",
        Certainty.LIKELY,
    )


def _estimates(context: Context) -> tuple[Change, ...]:
    """Return all numbers that the evidence determines, whether they are wrong or not."""
    explanation = context.explanation
    found = []
    for number, parameter in ESTIMATED.items():
        name = number.name.lower()
        value, std = explanation.value(name), explanation.std(name)
        if name in ("scale", "separation"):
            found.append(context.change(parameter, math.exp(value), std, "m"))
        elif name == "ratio":
            spread = math.exp(LEVEL * std)
            ratio = math.exp(value)
            found.append(Change(parameter, ratio, ratio / spread, ratio * spread))
        else:
            unit = "s" if name.endswith("delay") else "rad"
            about = float(context.configured[parameter])
            found.append(context.shift(parameter, value, std, unit, about))
    return tuple(found)
