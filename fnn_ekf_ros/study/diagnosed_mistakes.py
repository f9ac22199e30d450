# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""What `doctor` says of a drive with a mistake, simulated or put into a recording."""

import math
from collections.abc import Iterable, Mapping
from dataclasses import asdict
from typing import Any, NamedTuple

import numpy as np

from fnn_ekf_ros.calibration.examination import Drive, examine, meters_per_count
from fnn_ekf_ros.calibration.findings import UNTOLD, Certainty, Change
from fnn_ekf_ros.core.angles import wrap_angle
from fnn_ekf_ros.core.arrays import FloatArray
from fnn_ekf_ros.messages.names import COMPASS
from fnn_ekf_ros.parameters.fake_robot import FakeRobotParameters
from fnn_ekf_ros.parameters.faults import Bias, UnequalWheels, WrongStamp, WrongUnit
from fnn_ekf_ros.parameters.matching import matching_localizer
from fnn_ekf_ros.study.mistakes import RIGHT_OVER_LEFT, Mistake

NUMBERS = {
    "wheel_radius": "meters_per_count",
    "gear_ratio": "meters_per_count",
    "encoder_counts_per_revolution": "meters_per_count",
    "wheel_separation": "wheel_separation",
    "left_wheel_radius_multiplier": RIGHT_OVER_LEFT,
    "right_wheel_radius_multiplier": RIGHT_OVER_LEFT,
    "compass_offset": "compass_offset",
    "lrf_yaw_offset": "lrf_yaw_offset",
    "compass_delay": "compass_delay",
    "lrf_pose_delay": "lrf_pose_delay",
    "lrf_pose_scale": "lrf_pose_scale",
}
"""Number that a parameter stands for; parameters that enter as a product stand for one."""
FACTORS = ("meters_per_count", "wheel_separation", RIGHT_OVER_LEFT, "lrf_pose_scale")
"""Numbers whose errors are factors; those of others are differences."""


class Diagnosed(NamedTuple):
    """What `doctor` says of a mistake.

    Attributes:
        certainty: of the finding that names it; empty if there is none above possible.
        error: of the value to set: relative to that value for a factor, to the mistake's size for a
            difference. NaN without a number.
        covered: whether the 95 % interval has the right value in it; None without an interval.
        others: names of other findings above possible.
    """

    certainty: str
    error: float
    covered: bool | None
    others: tuple[str, ...]


def diagnosed(
    mistake: Mistake | None,
    drive: Drive,
    configured: Mapping[str, Any],
    true: Mapping[str, float],
    known: Iterable[str] = (),
) -> Diagnosed:
    """Return what `doctor` says of a drive.

    Args:
        mistake: that is in it; None: there is none.
        drive: its readings.
        configured: parameters of the localizer, by name, with the mistake in them.
        true: the right numbers, as `numbers_of` gives them.
        known: names of findings that are there without the mistake.
    """
    findings = [
        each
        for each in examine(drive, configured).findings
        if each.certainty is not Certainty.POSSIBLE and each.name not in UNTOLD
    ]
    own = None
    if mistake is not None:
        own = next((each for each in findings if mistake.is_found(each)), None)
    others = tuple(each.name for each in findings if each is not own and each.name not in known)
    if own is None:
        return Diagnosed("", math.nan, None, others)
    assert mistake is not None
    parameter = next(
        (each.parameter for each in own.changes if each.parameter in mistake.parameters), ""
    )
    number = NUMBERS.get(parameter)
    if number is None:
        return Diagnosed(str(own.certainty), math.nan, None, others)
    value = numbers_of(_with(configured, own.changes))[number]
    right = true[number]
    ends = [numbers_of(_with(configured, own.changes, end))[number] for end in ("low", "high")]
    covered = None if any(map(math.isnan, ends)) else min(ends) <= right <= max(ends)
    error = value / right - 1.0 if number in FACTORS else (value - right) / mistake.size(number)
    return Diagnosed(str(own.certainty), error, covered, others)


def numbers_of(configured: Mapping[str, Any]) -> dict[str, float]:
    """Return the numbers that parameters stand for."""
    left, right = (float(configured[f"{side}_wheel_radius_multiplier"]) for side in _SIDES)
    found = {name: float(configured[name]) for name in NUMBERS if name == NUMBERS[name]}
    return found | {
        "meters_per_count": meters_per_count(configured),
        RIGHT_OVER_LEFT: right / left,
    }


_SIDES = ("left", "right")


def _with(
    configured: Mapping[str, Any], changes: Iterable[Change], which: str = "value"
) -> dict[str, Any]:
    return {**configured, **{each.parameter: getattr(each, which) for each in changes}}


def true_numbers(robot: FakeRobotParameters, mistake: Mistake | None) -> dict[str, float]:
    """Return the right numbers for a simulated robot with a mistake."""
    return with_effects(numbers_of(asdict(matching_localizer(robot))), mistake)


def examined_numbers(drive: Drive, configured: Mapping[str, Any]) -> dict[str, float]:
    """Return the numbers of a recorded robot as `doctor` estimates them, where it can."""
    estimates = examine(drive, configured).estimates
    numbers = numbers_of(_with(configured, estimates))
    for each in estimates:
        if each.parameter == RIGHT_OVER_LEFT:
            numbers[RIGHT_OVER_LEFT] *= float(each.value)
    return numbers


def with_effects(numbers: Mapping[str, float], mistake: Mistake | None) -> dict[str, float]:
    """Return the right numbers for a robot whose messages have a mistake in them."""
    found = dict(numbers)
    for name, (factor, shift) in ({} if mistake is None else mistake.effects()).items():
        found[name] = factor * found[name] + shift
    return found


def with_mistake(drive: Drive, mistake: Mistake) -> Drive:
    """Return the readings of a recorded drive with a mistake in its messages."""
    left, right, compass, fixes = (table.copy() for table in drive)
    for fault in mistake.faults:
        if isinstance(fault, UnequalWheels):
            for side, table in zip(_SIDES, (left, right), strict=True):
                table[:, 1] /= fault.factor if side == fault.wheel else 1.0
        elif isinstance(fault, WrongUnit) and fault.topic == COMPASS:
            compass[:, 1] = wrap_angle(compass[:, 1] * fault.factor)
        elif isinstance(fault, WrongUnit):
            fixes[:, 1:3] *= fault.factor
        elif isinstance(fault, Bias) and fault.topic == COMPASS:
            compass[:, 1] = wrap_angle(compass[:, 1] + fault.size[2])
        elif isinstance(fault, Bias):
            fixes[:, 1:] += fault.size
            fixes[:, 3] = wrap_angle(fixes[:, 3])
        elif isinstance(fault, WrongStamp):
            table = compass if fault.topic == COMPASS else fixes
            table[:, 0] += fault.size
    if mistake.swapped:
        left, right = right, left
    return Drive(left, right, compass, fixes)


def fits(mistake: Mistake, drive: Drive) -> bool:
    """Return whether a drive has the readings that a mistake is about."""
    if mistake.sensor == COMPASS:
        return _turning(drive.compass[:, 1])
    if mistake.given.get("lrf_use_yaw"):
        return _turning(drive.fixes[:, 3])
    return len(drive.fixes) > 0


def _turning(yaws: FloatArray) -> bool:
    """Return whether there is a yaw that changes."""
    yaws = yaws[np.isfinite(yaws)]
    return len(yaws) > 0 and bool(np.ptp(yaws) > 0.0)
