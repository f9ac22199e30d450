# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""`make scenarios`: how runs are measured, and tests of other localizers that no other test has."""

import math
import re

import numpy as np
import pytest
from documents import SCENARIOS, read, section, with_section
from foreign import equal
from foreign.cases import (
    EQUALITIES,
    GLITCH_M,
    GLITCH_S,
    LARGEST_DOUBLE,
    NEW_PLACE,
    RECOVERIES,
    REST,
    USED,
    compass_off,
    fixes_off,
    glitches,
    no_fixes,
)
from foreign.runs import (
    HELD_S,
    LONGEST_GAP_S,
    Measured,
    Odom,
    Recovery,
    drive,
    fix_variance,
    largest_difference,
    longest_row,
    recovery,
    time_to_recover,
    with_gaps,
)
from foreign.tables import TITLE, shown
from foreign.tables import section as table_section

from fnn_ekf_ros.parameters.fault_files import faults_from

GOOD, BAD = 0.5, 2.0
TIMES_S = np.arange(0.0, 20.0)


def shares(*bad: int) -> np.ndarray:
    """Errors of 20 s, bad at some of them; the largest is the first."""
    found = np.full(len(TIMES_S), GOOD)
    found[list(bad)] = BAD
    found[list(bad)[:1]] = 2.0 * BAD
    return found


def test_a_pose_has_recovered_when_it_stays_good_after_its_largest_error() -> None:
    assert time_to_recover(TIMES_S, shares(), 3.0) == 0.0
    assert time_to_recover(TIMES_S, shares(5, 6), 3.0) == 4.0
    assert time_to_recover(TIMES_S, shares(5, 9), 3.0) == 7.0, "good for 3 s only in between"
    assert time_to_recover(TIMES_S, shares(5, 15), 3.0) == 3.0, "the noise of much later"
    assert time_to_recover(TIMES_S, shares(1), 3.0) == 0.0
    assert math.isnan(time_to_recover(TIMES_S, shares(5, 9, 13, 17), 3.0))
    assert math.isnan(time_to_recover(TIMES_S, shares(19), 3.0))
    late = int(len(TIMES_S) - HELD_S)
    assert math.isnan(time_to_recover(TIMES_S, shares(late - 1), 3.0)), "ends too soon to tell"


def test_a_pose_that_is_missing_is_not_good() -> None:
    missing = shares(5)
    missing[6:8] = math.nan
    assert time_to_recover(TIMES_S, missing, 3.0) == 5.0
    times_s, share = with_gaps(np.array([1.0, 1.4, 4.0, 4.4]), np.full(4, GOOD))
    np.testing.assert_array_equal(times_s, [1.0, 1.4, 1.4 + LONGEST_GAP_S, 4.0, 4.4])
    np.testing.assert_array_equal(np.isnan(share), [False, False, True, False, False])


def test_rejections_in_a_row() -> None:
    assert longest_row([]) == 0
    assert longest_row([True, False, True, True, False]) == 2


def odom(stamp_ns: int, x: float) -> Odom:
    pose = np.array([x, 0.0, 0.0])
    return Odom(time_s=0.0, stamp_ns=stamp_ns, pose=pose, truth=pose, finite=True)


def test_runs_differ_where_only_one_has_a_pose() -> None:
    one = [odom(1, 0.0), odom(2, 1.0), odom(3, math.nan)]
    assert largest_difference(one, one) == 0.0
    assert largest_difference(one, [odom(1, 0.0), odom(2, 1.25), odom(3, math.nan)]) == 0.25
    assert largest_difference(one, [odom(1, 0.0), odom(2, 1.0), odom(3, 1.0)]) == math.inf
    assert largest_difference(one, one[:2]) == math.inf
    assert largest_difference([], []) == math.inf


def test_the_table_shows_median_and_worst() -> None:
    assert shown([3.0, 1.0, 2.0], 1) == "2.0 (3.0)"
    assert shown([3.0, 1.0, math.nan], 1) == "3.0 (no)"
    assert shown([math.nan, math.nan, 1.0], 1) == "no (no)"

    def measured(said: dict[tuple[str, str], float], apart_m: float, finite: bool) -> Measured:
        found = Recovery(
            time_s=1.0, largest_m=2.0, largest_rad=0.5, finite=finite, rejected=7, said=said
        )
        return Measured(found, apart_m)

    scenario, same = RECOVERIES[1], EQUALITIES[0]
    heard, once = ("compass WARN", "turned"), ("compass WARN", "silent")
    results = {
        scenario.name: [
            measured({heard: 2.0}, math.nan, finite=True),
            measured({heard: 4.0, once: 1.0}, math.nan, finite=True),
            measured({}, math.nan, finite=False),
        ],
        same.name: [measured({}, apart_m, finite=True) for apart_m in (0.0, 0.0, 0.25)],
    }
    text = table_section([scenario], [same], results, (1, 2, 3), "1.0, commit abc")
    (first, second) = [line for line in text.splitlines() if line.startswith("| **")]
    assert "| 1.0 (1.0) | 2.00 (2.00) | 0.50 (0.50) | 7 (7) | compass WARN: turned (3.0) |" in first
    assert "| 0 (0.25) | 2.00 (2.00) | 0.50 (0.50) | nothing new |" in second
    assert f"Numbers were not finite in: {scenario.name}." in text


def test_a_section_is_replaced_at_its_place_and_everything_else_stays() -> None:
    text = with_section("# A\n\nwords\n", SCENARIOS, "one\n")
    assert section(text, SCENARIOS) == "one"
    assert text.startswith("# A\n\nwords\n\n<!--")
    longer = text + "\nmore\n"
    again = with_section(longer, SCENARIOS, "two")
    assert section(again, SCENARIOS) == "two"
    assert with_section(again, SCENARIOS, "one") == longer.replace("\n\nmore", "\nmore")
    assert section("# A\n", SCENARIOS) == ""


def test_the_document_has_all_scenarios_of_one_version() -> None:
    text = section(read("docs/faults.md"), SCENARIOS)
    assert text.startswith(TITLE)
    assert re.search(r"`make scenarios` \(fnn_ekf_ros [\d.]+, commit [0-9a-f]{7,}\)", text)
    names = re.findall(r"^\| \*\*(.+?)\*\*", text, flags=re.MULTILINE)
    assert names == [each.name for each in (*RECOVERIES, *EQUALITIES)]
    for each in (*RECOVERIES, *EQUALITIES):
        assert each.source in text
        assert each.theirs in text
        assert each.remark in text


@pytest.mark.slow
def test_fixes_that_return_elsewhere_are_followed() -> None:
    """As of PX4: no fixes for 11 s, then all 2.2 m away, where the robot is from then on."""
    faults = faults_from(
        [no_fixes(11.0) | {"start": 12.0}, fixes_off(*NEW_PLACE[:2], 23.0)], "test"
    )
    found = recovery(drive(1, 35.0, faults), 23.0, 23.0, NEW_PLACE)
    assert found.time_s < 5.0
    assert found.largest_m > 2.0


@pytest.mark.slow
def test_fixes_that_jump_about_are_not_followed() -> None:
    """As of ArduPilot: seven offsets of up to 114 m in 3.2 s."""
    timeline = [each | {"start": each["start"] - 15.0} for each in glitches()]
    run = drive(1, 25.0, faults_from(timeline, "test"))
    found = recovery(run, 15.0, 15.0)
    assert sum(run.rejected) == found.rejected >= math.floor(len(GLITCH_M) * GLITCH_S * 2.6)
    assert found.largest_m < 0.3
    assert found.time_s == 0.0


@pytest.mark.slow
def test_yaw_that_is_off_from_the_start_is_put_right() -> None:
    """As of PX4's emergency yaw: off by 110 degrees."""
    off = math.radians(110.0)
    run = drive(2, 30.0, faults_from([compass_off(off, 0.0)], "test"))
    found = recovery(run, 0.0, 0.0)
    assert found.largest_rad > 0.9 * off
    assert found.time_s < 20.0
    assert any("off by a constant angle" in message for _, message in found.said)


@pytest.mark.slow
def test_the_pose_does_not_follow_a_yaw_that_jumps() -> None:
    """To the left for some members and to the right for others: it must not seem to fit."""
    run = drive(3, 15.0, faults_from([compass_off(math.pi, 8.0)], "test"))
    assert recovery(run, 8.0, 0.0).largest_rad < 0.6


@pytest.mark.slow
def test_huge_variances_of_what_is_not_read_change_nothing(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """As of kobuki: the largest double as variance of z, roll and pitch."""
    monkeypatch.setattr(equal, "DURATION_S", 18.0)
    spoil = fix_variance(LARGEST_DOUBLE, REST, 0.0, equal.DURATION_S)
    assert equal.undisturbed(1, spoil=spoil, **USED).apart_m == 0.0


@pytest.mark.slow
def test_a_recording_in_a_loop_is_localized_again(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(equal, "DURATION_S", 21.0)
    found = equal.looped(1)
    assert found.recovery.time_s < 2.0
    assert found.apart_m < 0.01
    assert ("time WARN", "the clock went back: the localizer starts anew") in found.recovery.said
