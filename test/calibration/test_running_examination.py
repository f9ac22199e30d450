# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The examination of a robot that drives: sums of blocks say what all readings at once say."""

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from examined_drives import COUNTS, RADIUS, SEPARATION, drive, laps, parameters

from fnn_ekf_ros.calibration.block_sums import NODES_S, travel_at
from fnn_ekf_ros.calibration.drift_regression import Drift, filtered
from fnn_ekf_ros.calibration.examination import Drive, examine
from fnn_ekf_ros.calibration.running_examination import RunningExamination
from fnn_ekf_ros.calibration.yaw_blocks import MOST_BLOCKS, YawBlocks
from fnn_ekf_ros.core.arrays import FloatArray

LONG_S = 60.0
"""Length of the drives: within a minute mistakes are named [s]."""


def feed(
    examination: RunningExamination, given: Drive, configured: dict[str, Any]
) -> Iterator[float]:
    """Let an examination take a drive in, in the order of stamps; yield each instant [s]."""
    tables = (given.left, given.right, given.compass, given.fixes)
    rows = sorted((row[0], kind, tuple(row)) for kind, t in enumerate(tables) for row in t.tolist())
    for time, kind, row in rows:
        if kind < 2:
            side = ("left", "right")[kind]
            sign = -1.0 if configured[f"{side}_inverted"] else 1.0
            examination.wheel(side, time, sign * row[1])
        elif kind == 2:
            examination.compass(time, row[1])
        else:
            examination.fix(*row)
        examination.advance(time)
        yield time


def examined(given: Drive, **configured: Any) -> RunningExamination:
    """Return the examination after a drive."""
    values = parameters(**configured)
    examination = RunningExamination(values)
    for _ in feed(examination, given, values):
        pass
    return examination


def names(examination: RunningExamination) -> list[str]:
    return [finding.name for finding in examination.findings]


def with_compass(given: Drive, change: Any, since_s: float = 0.0) -> Drive:
    yaw = np.where(given.compass[:, 0] >= since_s, change(given.compass[:, 1]), given.compass[:, 1])
    wrapped = np.remainder(yaw + np.pi, 2.0 * np.pi) - np.pi
    return given._replace(compass=np.column_stack([given.compass[:, 0], wrapped]))


def test_travel_between_the_nodes_is_that_of_a_cubic() -> None:
    for delay in (-1.4, -0.31, 0.0, 0.07, 0.9, 1.45):
        weights, slopes = travel_at(delay)
        values = 1.0 - 2.0 * NODES_S + 0.5 * NODES_S**2 + 0.3 * NODES_S**3
        assert weights @ values == pytest.approx(
            1.0 - 2.0 * delay + 0.5 * delay**2 + 0.3 * delay**3
        )
        assert slopes @ values == pytest.approx(-2.0 + delay + 0.9 * delay**2)


def test_a_filter_goes_on_where_it_was() -> None:
    rng = np.random.default_rng(3)
    times = np.cumsum(rng.uniform(0.1, 0.5, 30))
    columns = np.cumsum(rng.standard_normal((30, 1, 3)), axis=0)
    breaks = np.arange(30) == 0
    ratios = np.array([0.01, 1.0])
    whole = filtered(Drift(times, breaks, np.ones(30), 0.1), columns, ratios)
    first = filtered(Drift(times[:12], breaks[:12], np.ones(12), 0.1), columns[:12], ratios)
    # From its last reading on, counted from another zero.
    rest = Drift(times[11:], breaks[:19], np.ones(19), 0.1)
    second = filtered(rest, columns[11:] + 7.0, ratios, first.level)
    np.testing.assert_allclose(second.white[1:], whole.white[12:], rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(second.spread[1:], whole.spread[12:])
    assert np.all(second.white[0] == 0.0)


def test_blocks_say_what_all_readings_say() -> None:
    given = drive(1, 90.0)
    at_once = examine(given, parameters()).evidence
    by_blocks = examined(given).evidence()
    assert at_once is not None
    one, other = at_once.compass, by_blocks.compass
    assert one is not None
    assert other is not None
    assert one.displacement is not None
    assert other.displacement is not None
    assert one.handedness == other.handedness == 1
    for fit, second in ((one.fit, other.fit), (one.displacement, other.displacement)):
        std = np.sqrt(np.diag(fit.covariance))
        assert np.all(np.abs(fit.coefficients - second.coefficients) < 2.0 * std)
        assert np.all(np.sqrt(np.diag(second.covariance)) < 2.0 * std)
        assert second.noise_std == pytest.approx(fit.noise_std, rel=0.2)


@pytest.mark.parametrize(
    ("change", "configured", "name", "parameter", "value"),
    [
        (None, {"encoder_counts_per_revolution": COUNTS / 4.0}, "meters_per_count",
         "encoder_counts_per_revolution", COUNTS),
        (None, {"right_inverted": True}, "right_inverted", "right_inverted", False),
        (None, {"wheel_separation": 100.0 * SEPARATION}, "wheel_separation", "wheel_separation",
         SEPARATION),
        (None, {"wheel_radius": 1.2 * RADIUS}, "meters_per_count", "wheel_radius", RADIUS),
        (lambda yaw: 0.5 * np.pi - yaw, {}, "compass_clockwise", "compass_clockwise", True),
        (lambda yaw: yaw + 0.7, {}, "compass_offset", "compass_offset", -0.7),
        (np.radians, {}, "compass_degrees", "", 0.0),
    ],
)  # fmt: skip
def test_a_mistake_is_told_alone_within_a_minute(
    change: Any, configured: dict[str, Any], name: str, parameter: str, value: float | bool
) -> None:
    given = drive(2, LONG_S)
    examination = examined(given if change is None else with_compass(given, change), **configured)
    (finding,) = examination.findings
    assert finding.name == name
    told = {each.parameter: each.value for each in finding.changes}
    if parameter:
        assert told[parameter] == pytest.approx(value, rel=0.1)
    else:
        assert not told


def test_swapped_wheels_and_millimeters_are_told() -> None:
    given = drive(3, LONG_S)
    assert names(examined(given._replace(left=given.right, right=given.left))) == ["wheels_swapped"]
    (finding,) = examined(given._replace(fixes=given.fixes * [1.0, 1e3, 1e3, 1.0])).findings
    assert (finding.name, finding.changes[0].value) == ("fix_unit", 1e-3)


@pytest.mark.parametrize("slip", [(0.01, 0.01), (0.08, 0.08)])
def test_of_a_right_robot_nothing_is_told(slip: tuple[float, float]) -> None:
    values = parameters(lrf_use_yaw=True)
    examination = RunningExamination(values)
    for _ in feed(examination, drive(4, 120.0, slip=slip, compass_std=0.13), values):
        assert not examination.findings


def test_a_sensor_that_is_not_used_is_not_told() -> None:
    given = drive(2, LONG_S)
    turned = given._replace(fixes=np.add(given.fixes, [0.0, 0.0, 0.0, 0.6]))
    assert names(examined(turned)) == []
    assert names(examined(turned, lrf_use_yaw=True)) == ["fix_yaw_offset"]


def slipping(seed: int, duration_s: float = LONG_S) -> Drive:
    return drive(seed, duration_s, slip=(0.03, 0.03), compass_std=0.1)


def with_fix_yaw(given: Drive, yaw: FloatArray) -> Drive:
    wrapped = np.remainder(yaw + np.pi, 2.0 * np.pi) - np.pi
    return given._replace(fixes=np.column_stack([given.fixes[:, :3], wrapped]))


def test_a_yaw_of_the_fixes_that_is_not_used_shows_how_late_they_are() -> None:
    late = slipping(2)._replace(fixes=np.add(slipping(2).fixes, [0.5, 0.0, 0.0, 0.0]))
    widths = []
    for yaw in (0.0, 0.6, np.pi, np.nan):
        (finding,) = examined(with_fix_yaw(late, late.fixes[:, 3] + yaw)).findings
        assert finding.name == "fix_delay"
        (change,) = finding.changes
        assert change.value == pytest.approx(0.5, abs=0.1)
        widths.append(change.high - change.low)
    assert widths[:3] == pytest.approx(widths[:1] * 3, rel=0.05)
    assert widths[0] < 0.75 * widths[3]


@pytest.mark.parametrize("noise_m", [0.0, 0.8])
@pytest.mark.parametrize("seed", [2, 3])
def test_a_late_yaw_of_the_fixes_does_not_make_their_positions_late(
    seed: int, noise_m: float
) -> None:
    given = slipping(seed, 100.0)
    more = noise_m * np.random.default_rng(seed).standard_normal((len(given.fixes), 2))
    given.fixes[:, 1:3] += more
    true = drive(seed, 100.0, slip=(0.03, 0.03), compass_std=0.0).compass
    noise = 0.1 * np.random.default_rng(9).standard_normal(len(given.fixes))
    for late_s in (0.3, 0.6):
        late = np.interp(given.fixes[:, 0] - late_s, true[:, 0], np.unwrap(true[:, 1])) + noise
        assert names(examined(with_fix_yaw(given, late))) == []


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_yaw_that_is_not_used_does_not_hide_what_is_wrong(sign: float) -> None:
    """Such as one that the fixes take from the wheels, by the same wrong separation."""
    given = slipping(2)
    left, right = (np.interp(given.fixes[:, 0], *wheel.T) for wheel in (given.left, given.right))
    wide = 1.25 * SEPARATION
    yaw = sign * (right - left) * 2.0 * np.pi * RADIUS / COUNTS / wide
    (finding,) = examined(with_fix_yaw(given, yaw), wheel_separation=wide).findings
    assert finding.name == "wheel_separation"
    swapped = given._replace(left=given.right, right=given.left)
    backward = with_fix_yaw(swapped, sign * given.fixes[:, 3] + np.pi)
    assert names(examined(backward)) == ["wheels_swapped"]


def test_a_finding_is_over_although_a_yaw_that_is_not_used_is_wrong_or_ends() -> None:
    given = slipping(6, 220.0)
    given = with_fix_yaw(given, given.fixes[:, 3] + 0.6)
    turned = with_compass(given, lambda yaw: yaw + 0.8)
    late = given.compass[:, 0] >= 80.0
    turned.compass[late] = given.compass[late]
    ending = turned._replace(fixes=turned.fixes.copy())
    ending.fixes[ending.fixes[:, 0] > 80.0, 3] = np.nan
    values = parameters()
    for each in (turned, ending):
        examination = RunningExamination(values)
        told = [names(examination) for _ in feed(examination, each, values)]
        assert ["compass_offset"] in told
        assert told[-1] == []


@pytest.mark.parametrize("seed", range(3))
def test_radians_taken_for_degrees_are_told_beside_a_yaw_of_the_fixes(seed: int) -> None:
    given = drive(seed, LONG_S)
    given = given._replace(compass=given.compass * [1.0, np.pi / 180.0])
    for used in (False, True):
        assert names(examined(given, lrf_use_yaw=used)) == ["compass_degrees"]


def test_radians_are_told_beside_another_mistake() -> None:
    given = drive(2, LONG_S)
    given = given._replace(compass=given.compass * [1.0, np.pi / 180.0])
    given = given._replace(fixes=given.fixes * [1.0, 1e3, 1e3, 1.0])
    assert set(names(examined(given, lrf_use_yaw=True))) == {"compass_degrees", "fix_unit"}


def test_one_outlier_does_not_hide_radians() -> None:
    values, given = parameters(), drive(2, 140.0)
    given = given._replace(compass=given.compass * [1.0, np.pi / 180.0])
    given.compass[np.searchsorted(given.compass[:, 0], 100.0), 1] = 0.5
    examination = RunningExamination(values)
    told = [names(examination) for _ in feed(examination, given, values)]
    first = told.index(["compass_degrees"])
    assert all(each == ["compass_degrees"] for each in told[first:])


def corridor(seed: int, ratio: float) -> Drive:
    """Return a drive straight on along the x axis with wheels that differ by a factor."""
    rng = np.random.default_rng(seed)
    times = 0.05 * np.arange(1, 1801)
    travelled = 0.5 * times * COUNTS / (2.0 * np.pi * RADIUS)
    some, few = times[::2], times[::8]
    positions = np.column_stack([0.5 * few, np.zeros(len(few))])
    positions += 0.1 * rng.standard_normal(positions.shape)
    return Drive(
        np.column_stack([times, np.floor(travelled)]),
        np.column_stack([times, np.floor(travelled / ratio)]),
        np.column_stack([some, 0.05 * rng.standard_normal(len(some))]),
        np.column_stack([few, positions, np.full(len(few), np.nan)]),
    )


@pytest.mark.parametrize("ratio", [1.03, 1.07, 0.93])
def test_a_right_compass_on_a_straight_road_is_not_random(ratio: float) -> None:
    """The wheels seem to turn the robot; its compass, near 0 all the time, does not say so."""
    values, given = parameters(), corridor(1, ratio)
    examination = RunningExamination(values)
    for time in feed(examination, given, values):
        assert not examination.findings, time


def test_a_compass_that_starts_late_is_judged_by_its_own_readings() -> None:
    values, given = parameters(lrf_use_yaw=True), drive(3, 200.0)
    turned = with_compass(given, lambda yaw: 0.5 * np.pi - yaw)
    late = turned._replace(compass=turned.compass[turned.compass[:, 0] > 100.0])
    examination = RunningExamination(values)
    told = [t for t in feed(examination, late, values) if names(examination)]
    assert told[0] < 160.0
    assert names(examination) == ["compass_clockwise"]


def test_a_separation_in_centimeters_is_no_compass_in_degrees() -> None:
    """With a robot that turns 80 times as far as its wheels say, either could be."""
    given = drive(2, 100.0, slip=(0.05, 0.05), compass_std=0.13)
    values = parameters(wheel_separation=65.0 * SEPARATION)
    examination = RunningExamination(values)
    told = [names(examination) for _ in feed(examination, given, values)]
    assert told[-1] == ["wheel_separation"]
    assert ["compass_degrees"] not in told


def stand(examination: RunningExamination, each_s: float, jitter: float) -> None:
    """Let wheels send the same for a minute, but for one count."""
    for k in range(round(60.0 / each_s)):
        for side in ("left", "right"):
            examination.wheel(side, k * each_s, 5.0 + jitter * (k % 2))
        examination.advance(k * each_s)


def test_a_drive_is_examined_after_four_blocks_of_driving() -> None:
    values, given = parameters(), drive(2, LONG_S)
    examination = RunningExamination(values)
    first = next(t for t in feed(examination, given, values) if examination.examined)
    assert 36.0 < first < 40.0
    for each_s, jitter in ((0.1, 0.0), (0.1, 1.0), (1.3, 0.0), (1.3, 1.0)):
        standing = RunningExamination(values)
        stand(standing, each_s, jitter)
        assert not standing.examined
    seldom = RunningExamination(values)  # which is driving, though nothing is found in it
    for _ in feed(seldom, given._replace(left=given.left[::26], right=given.right[::26]), values):
        pass
    assert seldom.examined


@pytest.mark.parametrize("late_s", [0.25, 1.2])
def test_a_gross_size_is_told_beside_a_delay_that_is_not(late_s: float) -> None:
    given = slipping(2)
    late = given._replace(compass=np.add(given.compass, [late_s, 0.0]))
    (finding,) = examined(late, wheel_radius=2.0 * RADIUS).findings
    assert finding.name == "meters_per_count"


def test_a_size_is_told_beside_a_delay_that_is_too_small_to_tell() -> None:
    given = slipping(3)
    late = given._replace(compass=np.add(given.compass, [0.25, 0.0]))
    assert names(examined(late, wheel_separation=1.25 * SEPARATION)) == ["wheel_separation"]


def test_a_compass_that_ended_soon_does_not_hinder_the_examination() -> None:
    values, given = parameters(), drive(2, 90.0)
    ended = given._replace(compass=given.compass[given.compass[:, 0] < 20.0])
    examination = RunningExamination(values)
    seen = {round(t): examination.examined for t in feed(examination, ended, values)}
    assert not seen[45]  # it may be late only
    assert seen[89]


def test_a_compass_that_begins_is_not_examined_yet() -> None:
    values, given = parameters(), drive(2, 120.0)
    late = given._replace(compass=given.compass[given.compass[:, 0] > 60.0])
    examination = RunningExamination(values)
    seen = {round(t): examination.examined for t in feed(examination, late, values)}
    assert seen[50]
    assert not seen[80]
    assert seen[119]


def test_what_begins_while_driving_is_no_mistake() -> None:
    values, given = parameters(), drive(5, 100.0)
    examination = RunningExamination(values)
    for _ in feed(examination, with_compass(given, lambda yaw: yaw + 1.0, 50.0), values):
        assert not examination.findings


def test_a_finding_stays_until_the_newest_blocks_contradict_it() -> None:
    values, given = parameters(), drive(6, 220.0)
    mended = given.compass.copy()
    given = with_compass(given, lambda yaw: yaw + 0.8)
    late = given.compass[:, 0] >= 80.0
    given.compass[late] = mended[late]
    examination = RunningExamination(values)
    told = [(time, bool(examination.findings)) for time in feed(examination, given, values)]
    places = [place for place, (_, is_told) in enumerate(told) if is_told]
    assert places == list(range(places[0], places[-1] + 1))
    assert told[places[0]][0] < 60.0
    assert 85.0 < told[places[-1]][0] < 200.0
    assert not examination.findings


def test_no_call_does_all_of_the_work(monkeypatch: pytest.MonkeyPatch) -> None:
    """Sums and sources of a sensor take milliseconds each: a call has one, or the sources of half
    of the blocks."""
    done = list[str]()

    def noting(name: str) -> Callable[..., Any]:
        method = getattr(YawBlocks, name)

        def noted(*words: Any) -> Any:
            done.append(name)
            return method(*words)

        return noted

    for name in ("add", "source"):
        monkeypatch.setattr(YawBlocks, name, noting(name))
    values, given = parameters(), with_compass(drive(6, 60.0), lambda yaw: yaw + 0.8)
    examination, calls = RunningExamination(values), set[tuple[str, ...]]()
    for _ in feed(examination, given, values):
        calls.add(tuple(done))
        done.clear()
    assert examination.findings
    assert calls == {(), ("add",), ("source",), ("source", "source")}


def test_a_robot_that_never_turns_tells_nothing() -> None:
    assert names(examined(drive(1, LONG_S, turning=False))) == []


def test_memory_is_bounded() -> None:
    values, given = parameters(), drive(7, 300.0)
    examination = RunningExamination(values)
    kept = [examination.kept for _ in feed(examination, given, values)]
    assert max(blocks for blocks, _ in kept) == MOST_BLOCKS
    assert max(readings for _, readings in kept) < 20 * 2 * 15 + 10 * 15 + 3 * 15


def test_numbers_of_no_robot_end_nothing() -> None:
    given = drive(1, LONG_S)
    wild = given._replace(fixes=given.fixes * [1.0, 1e300, 1e300, 1.0])
    assert names(examined(wild)) == []


@pytest.mark.parametrize("seed", range(4))
def test_a_robot_that_turns_at_one_rate_only_and_then_at_the_opposite_one_is_no_mistake(
    seed: int,
) -> None:
    """One rate does not tell the wheels' coefficients apart; a wrong pair fits it as well."""
    values = parameters()
    given = laps(seed, (40.0, -40.0), 400.0)
    examination = RunningExamination(values)
    for time in feed(examination, given, values):
        assert not examination.findings, time
