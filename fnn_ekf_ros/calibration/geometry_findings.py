# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Findings of an explanation: which parameter, which value, how sure."""

import math
from collections.abc import Mapping
from typing import Any

from fnn_ekf_ros.calibration.evidence import Evidence
from fnn_ekf_ros.calibration.explanation import Explanation
from fnn_ekf_ros.calibration.findings import (
    LEVEL,
    Certainty,
    Change,
    Finding,
    certainty_of_number,
    certainty_of_sign,
)

LEAST_SIZE = 0.05
"""Smallest part by which radius or separation is wrong; less is a matter of calibration."""
LEAST_RATIO = 0.02
"""Smallest part by which two wheels differ."""
LEAST_ANGLE = 0.1
"""Smallest offset of a yaw [rad]."""
LEAST_DELAY_S = 0.1
"""Smallest delay that matters [s]."""
SAMPLED = 1.0
"""Smallest delay as a part of the time between two readings of a wheel: speeds that are sampled
once in an interval, or read late in it, are off by up to that."""
SLOWEST_WHEELS_S = 0.5
"""Longest usual time between two readings of a wheel [s]: a robot turns unevenly within a longer
one, and what is interpolated looks like delays and, in a short drive, like wrong sizes."""
NEAR = 0.12
"""Part by which a factor may differ from one that is typical of a mistake."""
COUNT_FACTORS = (4.0, 2.0, 0.5, 0.25)
"""Factors between counts per revolution with one, two and four edges of the encoder counted."""
LARGE_FACTOR = 1.5
"""Factor from which on a gear is a better explanation than a radius that was measured wrong."""
UNIT_FACTORS = (100.0, 1000.0, 0.01, 0.001)
"""Factors of lengths in centimeters and millimeters."""


class Context:
    """What findings are written with.

    Args:
        configured: parameters of the localizer, by name; lengths may be out of range.
        evidence: what the readings say.
        explanation: what explains it.
        wheel_interval_s: usual time between two readings of a wheel [s].
    """

    def __init__(
        self,
        configured: Mapping[str, Any],
        evidence: Evidence,
        explanation: Explanation,
        wheel_interval_s: float,
    ) -> None:
        self.configured, self.evidence = configured, evidence
        self.explanation, self.wheel_interval_s = explanation, wheel_interval_s

    def odds(self, *names: str) -> float | None:
        """Return the log odds of the first of some mistakes that was made; None if none was."""
        return next(
            (self.explanation.wrong[name] for name in names if name in self.explanation.wrong), None
        )

    def change(self, parameter: str, factor: float, std: float, unit: str = "") -> Change:
        """Return a parameter times a factor whose logarithm has a standard error."""
        value = float(self.configured[parameter]) * factor
        spread = math.exp(LEVEL * std)
        return Change(parameter, value, value / spread, value * spread, unit)

    def shift(self, parameter: str, by: float, std: float, unit: str, about: float = 0.0) -> Change:
        """Return a number moved by an amount with a standard error."""
        value = about + by
        return Change(parameter, value, value - LEVEL * std, value + LEVEL * std, unit)


def geometry_findings(context: Context) -> list[Finding]:
    """Return the findings about wheels, compass and fixes."""
    return [
        *_sides(context),
        *_scale(context),
        *_separation(context),
        *_ratio(context),
        *_compass(context),
        *_fixes(context),
        *_delays(context),
    ]


def scale_change(context: Context) -> Change:
    """Return the parameter that most likely has the factor of the meters per count."""
    factor = math.exp(context.explanation.value("scale"))
    std = context.explanation.std("scale")
    ticks = context.configured["encoder_source"] == "ticks"
    if ticks and _is_near(factor, std, COUNT_FACTORS):
        return context.change("encoder_counts_per_revolution", 1.0 / factor, std, "counts")
    if ticks and not _is_near(factor, std, UNIT_FACTORS) and _is_large(factor):
        return context.change("gear_ratio", 1.0 / factor, std)
    return context.change("wheel_radius", factor, std, "m")


def _is_near(factor: float, std: float, typical: tuple[float, ...]) -> bool:
    return any(abs(math.log(factor / each)) < max(NEAR, LEVEL * std) for each in typical)


def _is_large(factor: float) -> bool:
    return max(factor, 1.0 / factor) > LARGE_FACTOR


def _scale(context: Context) -> list[Finding]:
    odds = context.odds("scale")
    if odds is None:
        return []
    log, std = context.explanation.value("scale"), context.explanation.std("scale")
    change = scale_change(context)
    return [
        Finding(
            "meters_per_count",
            f"wheels travel {math.exp(log):.4g} times what {_product(context)} say",
            _explained(context),
            certainty_of_number(odds, abs(log), std, math.log1p(LEAST_SIZE)),
            (change,),
        )
    ]


def _product(context: Context) -> str:
    if context.configured["encoder_source"] != "ticks":
        return "positions and wheel_radius"
    return "counts, encoder_counts_per_revolution, gear_ratio and wheel_radius together"


def _separation(context: Context) -> list[Finding]:
    odds = context.odds("separation")
    if odds is None:
        return []
    log, std = context.explanation.value("separation"), context.explanation.std("separation")
    return [
        Finding(
            "wheel_separation",
            f"the robot rotates {math.exp(-log):.4g} times what wheel_separation says",
            _rotations(context),
            certainty_of_number(odds, abs(log), std, math.log1p(LEAST_SIZE)),
            (context.change("wheel_separation", math.exp(log), std, "m"),),
        )
    ]


def _ratio(context: Context) -> list[Finding]:
    odds = context.odds("right_wheel", "left_wheel", "ratio")
    if odds is None:
        return []
    swapped = context.explanation.wiring.sides < 0
    log = context.explanation.value("ratio") * (-1.0 if swapped else 1.0)
    std = context.explanation.std("ratio")
    wrong = context.explanation.wrong
    one = "left" if ("left_wheel" in wrong) != swapped else "right"
    if "ratio" in wrong:
        changes = tuple(
            context.change(f"{side}_wheel_radius_multiplier", math.exp(sign * log), 0.5 * std)
            for side, sign in (("left", -0.5), ("right", 0.5))
        )
    else:
        factor = math.exp(log if one == "right" else -log)
        changes = (context.change(f"{one}_wheel_radius_multiplier", factor, std),)
    return [
        Finding(
            "wheel_ratio",
            f"the right wheel travels {math.exp(log):.4g} times as far per count as the left one",
            _rotations(context),
            certainty_of_number(odds, abs(log), std, math.log1p(LEAST_RATIO)),
            changes,
        )
    ]


def _sides(context: Context) -> list[Finding]:
    found = []
    swapped = context.odds("swapped")
    for side in ("left", "right"):
        odds = context.odds(f"{side}_inverted")
        if odds is None:
            continue
        other = "right" if side == "left" else "left"
        parameter = f"{other if swapped is not None else side}_inverted"
        found.append(
            Finding(
                f"{side}_inverted",
                f"the {side} counter runs the other way",
                _explained(context),
                certainty_of_sign(odds),
                (Change(parameter, not context.configured[f"{side}_inverted"]),),
            )
        )
    if swapped is not None:
        joints = context.configured["encoder_source"] != "ticks"
        changes = (
            Change("left_joint", context.configured["right_joint"]),
            Change("right_joint", context.configured["left_joint"]),
        )
        found.append(
            Finding(
                "wheels_swapped",
                "left and right wheel are swapped",
                _rotations(context),
                certainty_of_sign(swapped),
                changes if joints else (),
                () if joints else ("left_ticks:=/right_ticks", "right_ticks:=/left_ticks"),
            )
        )
    return found


def _compass(context: Context) -> list[Finding]:
    found = []
    evidence, explanation = context.evidence, context.explanation
    clockwise, offset = context.odds("compass_clockwise"), context.odds("compass_offset")
    sign = explanation.wiring.compass
    angle = math.remainder(
        sign * float(context.configured["compass_offset"]) + explanation.value("compass_offset"),
        2.0 * math.pi,
    )
    std = explanation.std("compass_offset")
    shift = context.shift("compass_offset", angle, std, "rad")
    if clockwise is not None:
        turned = Change("compass_clockwise", not context.configured["compass_clockwise"])
        ned = abs(angle - 0.5 * math.pi) < max(LEAST_ANGLE, LEVEL * std)
        found.append(
            Finding(
                "compass_clockwise",
                "the compass counts clockwise" + (", from north, as in NED" if ned else ""),
                _explained(context),
                certainty_of_sign(clockwise),
                (turned, shift) if offset is not None else (turned,),
            )
        )
    elif offset is not None:
        size = abs(math.remainder(explanation.value("compass_offset"), 2.0 * math.pi))
        found.append(
            Finding(
                "compass_offset",
                f"the compass is off by {-explanation.value('compass_offset'):.3g} rad from the "
                "direction of travel",
                _explained(context),
                certainty_of_number(offset, size, std, LEAST_ANGLE),
                (shift,),
            )
        )
    return [*found, *compass_unit(evidence)]


def compass_unit(evidence: Evidence) -> list[Finding]:
    """Return whether the compass turns further than the robot, or less."""
    if evidence.compass is None or evidence.compass.usable:
        return []
    factor = evidence.compass.factor
    taken = "degrees taken for radians" if factor > 1.0 else "radians taken for degrees"
    return [
        Finding(
            "compass_degrees",
            f"the compass turns {factor:.3g} times as far as the robot: {taken}",
            "its driver has to convert; no parameter can undo it",
            Certainty.CERTAIN,
        )
    ]


def _fixes(context: Context) -> list[Finding]:
    found = []
    explanation = context.explanation
    odds = context.odds("fix_unit")
    if odds is not None:
        unit = explanation.wiring.unit
        scale = float(context.configured["lrf_pose_scale"]) / unit
        name = {1000.0: "millimeters", 100.0: "centimeters"}.get(unit, f"units of {1 / unit:g} m")
        found.append(
            Finding("fix_unit", f"the fixes are in {name}", _explained(context),
                    certainty_of_sign(odds), (Change("lrf_pose_scale", scale, unit="m"),))
        )  # fmt: skip
    odds = context.odds("fixes_mirrored")
    if odds is not None:
        found.append(
            Finding("fixes_mirrored", "the fixes are mirrored: x and y swapped, or y inverted",
                    _explained(context), certainty_of_sign(odds))
        )  # fmt: skip
    odds = context.odds("fix_yaw_clockwise")
    if odds is not None:
        found.append(
            Finding("fix_yaw_clockwise", "the yaw of the fixes counts clockwise",
                    _explained(context), certainty_of_sign(odds))
        )  # fmt: skip
    odds = context.odds("fix_yaw_offset")
    if odds is not None:
        by, std = explanation.value("fix_yaw_offset"), explanation.std("fix_yaw_offset")
        total = math.remainder(float(context.configured["lrf_yaw_offset"]) + by, 2.0 * math.pi)
        used = "" if context.configured["lrf_use_yaw"] else "; it is not used (lrf_use_yaw: false)"
        found.append(
            Finding(
                "fix_yaw_offset",
                f"the yaw of the fixes is off by {-by:.3g} rad from the direction of travel{used}",
                _explained(context),
                certainty_of_number(odds, abs(math.remainder(by, 2.0 * math.pi)), std, LEAST_ANGLE),
                (context.shift("lrf_yaw_offset", total, std, "rad"),),
            )
        )
    return found


def _delays(context: Context) -> list[Finding]:
    found = []
    for name, sensor, parameter in (
        ("compass_delay", "compass", "compass_delay"),
        ("fix_delay", "fixes", "lrf_pose_delay"),
    ):
        odds = context.odds(name)
        if odds is None:
            continue
        by, std = context.explanation.value(name), context.explanation.std(name)
        about = float(context.configured[parameter])
        least = max(LEAST_DELAY_S, SAMPLED * context.wheel_interval_s)
        certainty = certainty_of_number(odds, abs(by), std, least)
        if context.wheel_interval_s > SLOWEST_WHEELS_S:
            certainty = Certainty.POSSIBLE
        found.append(
            Finding(
                name,
                f"the {sensor} {'is' if sensor == 'compass' else 'are'} stamped {abs(by):.3g} s "
                f"{'later' if by > 0 else 'earlier'} than measured, by the wheels' clock",
                _explained(context),
                certainty,
                (context.shift(parameter, by, std, "s", about),),
            )
        )
    return found


def _explained(context: Context) -> str:
    best = context.evidence.best
    if best is None or best.displacement is None:
        return _rotations(context)
    return (
        f"path of {best.displacement.readings} fixes (noise {best.displacement.noise_std:.2g}): "
        f"wheels and yaw explain {100.0 * best.displacement.explained:.0f} %"
    )


def _rotations(context: Context) -> str:
    parts = [
        f"{name} of {source.fit.readings} readings (noise {source.fit.noise_std:.2g} rad): wheels "
        f"explain {100.0 * source.fit.explained:.0f} %"
        for name, source in (
            ("compass", context.evidence.compass),
            ("yaw of the fixes", context.evidence.fix_yaw),
        )
        if source is not None
    ]
    return "; ".join(parts)
