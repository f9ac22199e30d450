# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Findings: what is wrong, how sure that is, and which parameter puts it right."""

import math
from enum import StrEnum
from typing import NamedTuple

LEVEL = 2.23
"""Half width of a 95 % interval [standard errors]: that of Student's t with 10 degrees of freedom,
as standard errors rest on some ten blocks of time."""
CERTAIN_ODDS = 9.0
"""Log odds against the best other explanation from which on a finding is certain [nats]."""
LIKELY_ODDS = 5.0
"""Log odds from which on it is likely [nats]."""
NUMBER_ODDS = 3.0
"""Log odds that a number needs in addition [nats]: there are many that may be a little off."""


class Certainty(StrEnum):
    """How sure a finding is."""

    CERTAIN = "certain"
    LIKELY = "likely"
    POSSIBLE = "possible"


class Change(NamedTuple):
    """A parameter with the value that puts something right.

    Attributes:
        parameter: its name.
        value: to set.
        low: lower end of the 95 % interval; NaN if the value is no number that was estimated.
        high: its upper end.
        unit: of the value.
    """

    parameter: str
    value: bool | int | float | str
    low: float = math.nan
    high: float = math.nan
    unit: str = ""

    def words(self) -> str:
        """Return the change as it is printed."""
        if isinstance(self.value, bool):
            return f"{self.parameter}: {str(self.value).lower()}"
        if isinstance(self.value, float):
            unit = f" {self.unit}" if self.unit else ""
            if math.isnan(self.low):
                return f"{self.parameter}: {self.value:.5g}{unit}"
            interval = f"(95 %: {self.low:.5g} to {self.high:.5g})"
            return f"{self.parameter}: {self.value:.5g}{unit} {interval}"
        return f"{self.parameter}: {self.value}"


class Finding(NamedTuple):
    """Something that is wrong.

    Attributes:
        name: of `KINDS`.
        sentence: what is wrong, one line.
        evidence: the numbers that show it, one line.
        certainty: how sure it is.
        changes: parameters that put it right; empty if none can.
        remaps: remappings that do, FROM:=TO.
    """

    name: str
    sentence: str
    evidence: str
    certainty: Certainty
    changes: tuple[Change, ...] = ()
    remaps: tuple[str, ...] = ()


KINDS = {
    "not_set": "A parameter of the geometry is not set, or out of its range.",
    "missing_topic": "A topic that the localizer needs is not in the bag.",
    "wrong_type": "A topic has another message type than the localizer reads.",
    "joint_names": "joint_states has no joint of the configured name.",
    "frame": "Fixes come in another frame than frame_id, and are refused.",
    "no_yaw": "Nothing gives a yaw, so the filter cannot start.",
    "clock_skew": "A sensor's stamps are ahead of the bag's clock, far behind it, or drift.",
    "late_messages": "Messages arrive so late that the localizer drops them.",
    "standing": "The robot stood still, so nothing can be said of wheels and sensors.",
    "never_turning": "The robot never turned, so separation and sides cannot be told.",
    "one_rate": "The robot turned at one rate only, so nothing can be told of wheels and sensors.",
    "too_short": "There are too few readings to compare wheels and sensors.",
    "frozen_sensor": "A sensor never changes although the wheels move the robot.",
    "stuck_wheel": "A wheel's counter never changes although the other one's does.",
    "encoder_bits": "The counters wrap at another width than encoder_bits.",
    "counter_resets": "Counters jump by more than a wheel can turn.",
    "meters_per_count": "Wheels travel more or less than counts, gear ratio and radius say.",
    "wheel_separation": "The robot rotates more or less than wheel_separation says.",
    "wheel_ratio": "One wheel travels further per count than the other.",
    "left_inverted": "The left counter runs the other way.",
    "right_inverted": "The right counter runs the other way.",
    "wheels_swapped": "Left and right wheel are swapped.",
    "compass_clockwise": "The compass counts clockwise, as in NED.",
    "compass_degrees": "The compass turns 57.3 times as far as the robot, or 57.3 times less.",
    "compass_random": "The compass has nothing to do with the robot's rotation.",
    "compass_offset": "The compass is off by a constant angle.",
    "compass_delay": "The compass is stamped later or earlier than it measured.",
    "fix_yaw_offset": "The yaw of the fixes is off by a constant angle.",
    "fix_yaw_clockwise": "The yaw of the fixes counts clockwise.",
    "fixes_mirrored": "The fixes are mirrored: x and y are swapped, or y has the wrong sign.",
    "fix_unit": "The fixes are not in meters.",
    "fix_delay": "The fixes are stamped later or earlier than they were measured.",
}
"""What can be found, by name, in the order in which it is reported."""
UNTOLD = ("standing", "never_turning", "one_rate", "too_short")
"""Findings that say what a drive cannot tell: nothing is wrong with the robot."""


def in_order(findings: list[Finding]) -> tuple[Finding, ...]:
    """Return findings, the surest first, then as `KINDS` lists them."""
    ranks, kinds = list(Certainty), list(KINDS)
    return tuple(
        sorted(findings, key=lambda each: (ranks.index(each.certainty), kinds.index(each.name)))
    )


def certainty_of_sign(odds: float) -> Certainty:
    """Return how sure it is that a sign or a unit is wrong.

    Args:
        odds: log odds against the best explanation without it [nats].
    """
    if odds >= CERTAIN_ODDS:
        return Certainty.CERTAIN
    return Certainty.LIKELY if odds >= LIKELY_ODDS else Certainty.POSSIBLE


def certainty_of_number(odds: float, size: float, std: float, least: float) -> Certainty:
    """Return how sure it is that a number is wrong.

    Args:
        odds: log odds against the best explanation without it [nats].
        size: absolute difference from the configured number.
        std: its standard error.
        least: smallest difference that is more than a matter of calibration.
    """
    by_odds = certainty_of_sign(odds - NUMBER_ODDS)
    if by_odds is Certainty.CERTAIN and size - LEVEL * std < least:
        by_odds = Certainty.LIKELY
    return by_odds if size >= least else Certainty.POSSIBLE
