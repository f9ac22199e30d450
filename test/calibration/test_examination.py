# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""One mistake at a time in a simulated drive: it is named, with the value that puts it right."""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import pytest
from examined_drives import COUNTS, RADIUS, SEPARATION, drive, laps, parameters

from fnn_ekf_ros.calibration.examination import Drive, Examined, examine
from fnn_ekf_ros.calibration.findings import Certainty, Change, Finding
from fnn_ekf_ros.core.arrays import FloatArray

SEEDS = (1, 2, 3)


def _same(given: Drive) -> Drive:
    return given


def _yaw(change: Callable[[FloatArray], FloatArray]) -> Callable[[Drive], Drive]:
    def spoil(given: Drive) -> Drive:
        yaw = np.remainder(change(given.compass[:, 1]) + np.pi, 2.0 * np.pi) - np.pi
        return given._replace(compass=np.column_stack([given.compass[:, 0], yaw]))

    return spoil


def _counts(left: float, right: float) -> Callable[[Drive], Drive]:
    def scaled(wheel: FloatArray, factor: float) -> FloatArray:
        return np.column_stack([wheel[:, 0], np.floor(factor * wheel[:, 1])])

    return lambda given: given._replace(
        left=scaled(given.left, left), right=scaled(given.right, right)
    )


class Mistake(NamedTuple):
    """A mistake.

    Attributes:
        spoil: what it does to the readings.
        configured: parameters that are wrong.
        finding: name of the finding.
        parameter: that puts it right; empty if none does.
        value: of it.
    """

    spoil: Callable[[Drive], Drive]
    configured: dict[str, Any]
    finding: str
    parameter: str
    value: float | bool


MISTAKES = {
    "counts x4": Mistake(_counts(4.0, 4.0), {}, "meters_per_count",
                         "encoder_counts_per_revolution", 4.0 * COUNTS),
    "counts /4": Mistake(_counts(0.25, 0.25), {}, "meters_per_count",
                         "encoder_counts_per_revolution", 0.25 * COUNTS),
    "left inverted": Mistake(_counts(-1.0, 1.0), {}, "left_inverted", "left_inverted", True),
    "right inverted": Mistake(_counts(1.0, -1.0), {}, "right_inverted", "right_inverted", True),
    "inverted twice": Mistake(_same, {"left_inverted": True}, "left_inverted", "left_inverted",
                              False),
    "swapped": Mistake(lambda d: d._replace(left=d.right, right=d.left), {}, "wheels_swapped", "",
                       True),
    "radius": Mistake(_same, {"wheel_radius": 1.15 * RADIUS}, "meters_per_count", "wheel_radius",
                      RADIUS),
    "radius in cm": Mistake(_same, {"wheel_radius": 100.0 * RADIUS}, "meters_per_count",
                            "wheel_radius", RADIUS),
    "separation": Mistake(_same, {"wheel_separation": 1.2 * SEPARATION}, "wheel_separation",
                          "wheel_separation", SEPARATION),
    "separation in mm": Mistake(_same, {"wheel_separation": 1e3 * SEPARATION}, "wheel_separation",
                                "wheel_separation", SEPARATION),
    "ratio": Mistake(_counts(1.0, 1.0 / 1.06), {}, "wheel_ratio", "right_wheel_radius_multiplier",
                     1.06),
    "gear ratio": Mistake(_same, {"gear_ratio": 0.1}, "meters_per_count", "gear_ratio", 1.0),
    "NED": Mistake(_yaw(lambda yaw: 0.5 * np.pi - yaw), {}, "compass_clockwise",
                   "compass_offset", 0.5 * math.pi),
    "clockwise": Mistake(_yaw(lambda yaw: -yaw), {}, "compass_clockwise", "compass_clockwise",
                         True),
    "offset": Mistake(_yaw(lambda yaw: yaw + 0.7), {}, "compass_offset", "compass_offset", -0.7),
    "degrees for radians": Mistake(_yaw(np.radians), {}, "compass_degrees", "", True),
    "fix yaw": Mistake(lambda d: d._replace(fixes=np.add(d.fixes, [0.0, 0.0, 0.0, 0.5])), {},
                       "fix_yaw_offset", "lrf_yaw_offset", -0.5),
    "millimeters": Mistake(lambda d: d._replace(fixes=d.fixes * [1.0, 1e3, 1e3, 1.0]), {},
                           "fix_unit", "lrf_pose_scale", 1e-3),
    "late fixes": Mistake(lambda d: d._replace(fixes=np.add(d.fixes, [0.4, 0.0, 0.0, 0.0])), {},
                          "fix_delay", "lrf_pose_delay", 0.4),
    "late compass": Mistake(lambda d: d._replace(compass=np.add(d.compass, [0.4, 0.0])), {},
                            "compass_delay", "compass_delay", 0.4),
}  # fmt: skip


def serious(examined: Examined) -> list[Finding]:
    """Return the findings above 'possible'."""
    return [each for each in examined.findings if each.certainty is not Certainty.POSSIBLE]


def change_of(finding: Finding, parameter: str) -> Change:
    return next(each for each in finding.changes if each.parameter == parameter)


@pytest.mark.parametrize("name", MISTAKES)
def test_one_mistake_is_named_alone_with_its_value(name: str) -> None:
    mistake = MISTAKES[name]
    seed = SEEDS[len(name) % len(SEEDS)]
    examined = examine(mistake.spoil(drive(seed)), parameters(**mistake.configured))
    (finding,) = serious(examined)
    assert finding.name == mistake.finding
    if not mistake.parameter:
        assert not finding.changes
        return
    change = change_of(finding, mistake.parameter)
    if isinstance(mistake.value, bool):
        assert change.value is mistake.value
    elif mistake.parameter.endswith("_delay"):
        assert change.value == pytest.approx(mistake.value, abs=0.04)
    else:
        assert change.value == pytest.approx(mistake.value, rel=0.03)


@pytest.mark.parametrize("seed", SEEDS[:2])
def test_a_right_robot_gets_a_clean_bill(seed: int) -> None:
    assert serious(examine(drive(seed), parameters())) == []
    assert serious(examine(drive(seed, slip=(0.08, 0.08), compass_std=0.13), parameters())) == []


def test_wheels_that_are_read_too_seldom_show_no_delay_for_sure() -> None:
    """What is interpolated between readings that are 0.7 s apart looks like a delay."""
    given = drive(1, 120.0)
    late = given._replace(compass=np.add(given.compass, [1.2, 0.0]))
    seldom = late._replace(left=late.left[::14], right=late.right[::14])
    in_turn = late._replace(left=late.left[::14], right=late.right[7::14])
    for each, certainty in (
        (late, Certainty.CERTAIN), (seldom, Certainty.POSSIBLE), (in_turn, Certainty.POSSIBLE)
    ):  # fmt: skip
        (finding,) = examine(each, parameters()).findings
        assert (finding.name, finding.certainty) == ("compass_delay", certainty)


@pytest.mark.parametrize("each_s", [0.1, 0.02])
def test_one_outlier_does_not_hide_radians(each_s: float) -> None:
    given = drive(2, 120.0)
    times = np.arange(0.2, 119.0, each_s)
    true = np.interp(times, given.compass[:, 0], np.unwrap(given.compass[:, 1]))
    yaw = np.radians(np.remainder(true + np.pi, 2.0 * np.pi) - np.pi)
    yaw[len(yaw) // 2] = 0.5
    (finding,) = serious(
        examine(given._replace(compass=np.column_stack([times, yaw])), parameters())
    )
    assert finding.name == "compass_degrees"


def test_swapped_ticks_are_put_right_by_remapping() -> None:
    given = drive(1)
    (finding,) = serious(examine(given._replace(left=given.right, right=given.left), parameters()))
    assert finding.remaps == ("left_ticks:=/right_ticks", "right_ticks:=/left_ticks")


def test_counters_that_both_run_backward_are_both_named() -> None:
    examined = examine(drive(1), parameters(left_inverted=True, right_inverted=True))
    assert [each.name for each in serious(examined)] == ["left_inverted", "right_inverted"]


def test_mirrored_fixes_are_told_from_a_mirrored_compass() -> None:
    given = drive(1)
    mirrored = given._replace(fixes=given.fixes * [1.0, 1.0, -1.0, -1.0])
    assert [each.name for each in serious(examine(mirrored, parameters()))] == ["fixes_mirrored"]


def test_a_sensor_that_never_changes_is_named() -> None:
    given = drive(1, 40.0)
    compass = given._replace(compass=given.compass * [1.0, 0.0])
    fixes = given._replace(fixes=given.fixes * [1.0, 0.0, 0.0, 0.0])
    for spoiled, name in ((compass, "compass"), (fixes, "fixes")):
        (finding,) = serious(examine(spoiled, parameters()))
        assert finding.name == "frozen_sensor"
        assert name in finding.sentence


def test_without_any_yaw_it_says_so() -> None:
    given = drive(1, 40.0)
    blind = given._replace(compass=given.compass[:0], fixes=given.fixes * [1.0, 1.0, 1.0, np.nan])
    assert [each.name for each in examine(blind, parameters()).findings] == ["no_yaw"]


@pytest.mark.parametrize("sensor", ["left", "right", "fixes"])
def test_too_few_readings_are_no_clean_bill(sensor: str) -> None:
    given = drive(1, 20.0)
    few = given._replace(**{sensor: getattr(given, sensor)[:5]})
    assert [each.name for each in examine(few, parameters()).findings] == ["too_short"]


def test_outliers_and_a_robot_that_was_carried_are_no_mistakes() -> None:
    given, rng = drive(2), np.random.default_rng(7)
    wild = given.fixes + np.outer(rng.random(len(given.fixes)) < 0.15, [0.0, 2.0, -3.0, 1.0])
    carried = given.fixes + np.outer(np.arange(len(given.fixes)) > 70, [0.0, 5.0, 3.0, 0.0])
    for fixes in (wild, carried):
        assert serious(examine(given._replace(fixes=fixes), parameters())) == []


def test_estimates_do_not_depend_on_the_configuration() -> None:
    given = drive(2)
    right = examine(given, parameters())
    wrong = examine(given, parameters(wheel_radius=3.0 * RADIUS, wheel_separation=0.7 * SEPARATION))
    for one, other in zip(right.estimates, wrong.estimates, strict=True):
        assert one.value == pytest.approx(other.value, rel=5e-3, abs=5e-3), one.parameter


@pytest.mark.slow
def test_intervals_cover_the_truth_where_wheels_slip_and_the_driver_steers_back() -> None:
    covered = []
    for seed in range(6):
        examined = examine(drive(seed, 90.0, slip=(0.08, 0.1), compass_std=0.13), parameters())
        by_name = {change.parameter: change for change in examined.estimates}
        for name, truth in (("wheel_radius", RADIUS), ("wheel_separation", SEPARATION)):
            covered.append(by_name[name].low <= truth <= by_name[name].high)
    assert sum(covered) >= 9  # of 12 at 95 %: fewer happen once in 5000 trials


def test_a_robot_that_stands_is_said_to_stand() -> None:
    given = drive(1, 30.0)
    still = given._replace(left=given.left * [1.0, 0.0], right=given.right * [1.0, 0.0])
    (finding,) = examine(still, parameters()).findings
    assert finding.name == "standing"


def test_a_counter_that_never_changes_is_named() -> None:
    given = drive(1, 30.0)
    (finding,) = examine(given._replace(left=given.left * [1.0, 0.0]), parameters()).findings
    assert (finding.name, "left" in finding.sentence) == ("stuck_wheel", True)


@pytest.mark.parametrize("seed", range(3))
def test_a_robot_that_turns_at_one_rate_only_gets_no_other_finding(seed: int) -> None:
    """It drives circles; one turn to the other side is enough to tell the rest."""
    circles = examine(laps(seed, (40.0,), 200.0), parameters())
    assert [finding.name for finding in serious(circles)] == ["one_rate"]
    both = examine(laps(seed, (40.0, -40.0), 200.0), parameters())
    assert serious(both) == []


def test_a_robot_that_never_turns_is_said_to_never_turn() -> None:
    examined = examine(drive(1, 60.0, turning=False), parameters())
    assert [finding.name for finding in serious(examined)] == ["never_turning"]


def test_a_compass_of_random_directions_is_named() -> None:
    given = drive(1)
    noise = np.random.default_rng(5).uniform(-np.pi, np.pi, len(given.compass))
    spoiled = given._replace(compass=np.column_stack([given.compass[:, 0], noise]))
    assert [each.name for each in serious(examine(spoiled, parameters()))] == ["compass_random"]


@pytest.mark.parametrize("bits", [12, 16])
def test_a_narrower_counter_is_found(bits: int) -> None:
    given = drive(1)

    def wrapped(wheel: FloatArray) -> FloatArray:
        half = 2.0 ** (bits - 1)
        return np.column_stack([wheel[:, 0], np.remainder(wheel[:, 1] + half, 2 * half) - half])

    spoiled = given._replace(left=wrapped(given.left), right=wrapped(given.right))
    (finding,) = serious(examine(spoiled, parameters()))
    assert (finding.name, finding.changes[0].value) == ("encoder_bits", bits)
    assert serious(examine(spoiled, parameters(encoder_bits=bits))) == []


def test_a_short_drive_tells_gross_mistakes_only() -> None:
    whole = drive(SEEDS[0])
    short = Drive(*(each[each[:, 0] < whole.left[0, 0] + 30.0] for each in whole))
    unequal = MISTAKES["ratio"].spoil(short)
    assert serious(examine(unequal, parameters())) == []
    (found,) = serious(examine(MISTAKES["counts x4"].spoil(short), parameters()))
    assert found.name == "meters_per_count"
