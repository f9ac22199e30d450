# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Periods: when they close, what the wheels did in them, which measurements they take."""

import itertools
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from localizers import (
    PERIOD_NS,
    Arrival,
    estimates,
    feed,
    make_localizer,
    same_estimates,
    simulated,
)
from textbook_ekf import textbook_step

from fnn_ekf_ros.core.arrays import FloatArray, Row
from fnn_ekf_ros.localizer.localizer import Localizer
from fnn_ekf_ros.timeline.events import CompassYaw, Output, PoseFix, Wheel, WheelCount

TIMEOUT_NS = 500_000_000
METERS_PER_COUNT = math.pi * 0.05 / 500.0
AT_ORIGIN = {"initial_pose": [0.0, 0.0, 0.0], "initial_pose_std": [0.1, 0.1, 0.1]}


def seconds(time: float) -> int:
    return round(time * 1e9)


def ticks(stamp_ns: int, left: int, right: int) -> list[WheelCount]:
    return [WheelCount(stamp_ns, Wheel.LEFT, left), WheelCount(stamp_ns, Wheel.RIGHT, right)]


def in_time(events: Sequence[Any]) -> list[Any]:
    """Return the events as arriving at their stamps."""
    return [Arrival(event.stamp_ns, event) for event in events]


def means(outputs: list[Output]) -> FloatArray:
    return np.array([o.estimate.state.mean for o in outputs if o.estimate is not None])


def stand(localizer: Localizer, begin_ns: int) -> None:
    """Have both wheels known at a period's begin, and all periods closed until then."""
    for event in ticks(begin_ns, 0, 0):
        localizer.add(event, begin_ns)


def arc_pose(speed: float, rate: float, time: float) -> FloatArray:
    """Return where a robot is that left the origin on an arc."""
    turn = rate * time
    if rate == 0.0:
        return np.array([speed * time, 0.0, 0.0])
    radius = speed / rate
    heading = math.remainder(turn, 2.0 * math.pi)
    return np.array([radius * math.sin(turn), radius * (1.0 - math.cos(turn)), heading])


@pytest.mark.parametrize("period", [0.375, 0.1, 0.05, 1.0 / 3.0, 2.5])
@pytest.mark.parametrize("start_ns", [seconds(10.1), seconds(1.7e9) + 123_456_789, 1])
@pytest.mark.slow
def test_periods_end_at_integer_multiples(period: float, start_ns: int) -> None:
    events = [e for i in range(200) for e in ticks(start_ns + i * 70_000_000, i, i)]
    outputs = feed(make_localizer(period=period, **AT_ORIGIN), in_time(events))
    stamps = [output.stamp_ns for output in estimates(outputs)]
    period_ns = round(period * 1e9)
    first = (start_ns - 1) // period_ns + 1  # both wheels are known at its end
    last = (start_ns + 199 * 70_000_000) // period_ns
    assert stamps == [number * period_ns for number in range(first, last + 1)]
    assert [o.estimate.stamp_ns for o in outputs if o.estimate is not None] == stamps


def test_an_event_on_a_boundary_belongs_to_the_period_that_ends_there() -> None:
    boundary = 20 * PERIOD_NS
    localizer = make_localizer(**AT_ORIGIN)
    stand(localizer, boundary - PERIOD_NS)
    outputs = localizer.add(ticks(boundary, 0, 0)[0], boundary)
    outputs += localizer.add(CompassYaw(boundary, 0.5), boundary)
    assert outputs == []
    (output,) = localizer.add(ticks(boundary, 0, 0)[1], boundary)
    assert output.stamp_ns == boundary
    assert output.estimate is not None
    assert output.estimate.result is not None
    np.testing.assert_array_equal(output.estimate.result.available, [False, False, True, False])


@pytest.mark.parametrize("first", list(Wheel))
def test_a_period_closes_when_both_wheels_are_known(first: Wheel) -> None:
    localizer = make_localizer(**AT_ORIGIN)
    begin, second = 10 * PERIOD_NS, Wheel(1 - first)
    stand(localizer, begin)
    for stamp in (begin + 1, begin + PERIOD_NS // 2, begin + PERIOD_NS - 1):
        for wheel in Wheel:
            assert localizer.add(WheelCount(stamp, wheel, 0), stamp) == []
    after = begin + PERIOD_NS + 1000
    assert localizer.add(WheelCount(after, first, 0), after) == []
    assert localizer.add(WheelCount(begin + PERIOD_NS - 1, second, 0), after + 1) == []
    outputs = localizer.add(WheelCount(begin + PERIOD_NS, second, 0), after + 2)
    assert [output.stamp_ns for output in outputs] == [begin + PERIOD_NS]


@pytest.mark.parametrize("timeout", [0.5, 0.0, 3.0])
@pytest.mark.parametrize("speaking", [[], [Wheel.LEFT], [Wheel.RIGHT]])
def test_a_period_closes_without_the_wheels_after_the_timeout(
    timeout: float, speaking: list[Wheel]
) -> None:
    localizer = make_localizer(encoder_timeout=timeout, **AT_ORIGIN)
    begin = 10 * PERIOD_NS
    stand(localizer, begin)
    deadline = begin + PERIOD_NS + seconds(timeout)
    for wheel in speaking:
        assert localizer.add(WheelCount(deadline - 1, wheel, 0), deadline - 1) == []
    assert localizer.advance(deadline - 1) == []
    assert [output.stamp_ns for output in localizer.advance(deadline)] == [begin + PERIOD_NS]
    assert localizer.advance(deadline + PERIOD_NS - 1) == []
    assert len(localizer.advance(deadline + 3 * PERIOD_NS)) == 3


def test_a_period_closes_without_the_wheels_and_takes_what_was_measured() -> None:
    localizer = make_localizer(**AT_ORIGIN)
    boundary = 10 * PERIOD_NS
    stand(localizer, boundary - PERIOD_NS)
    assert localizer.add(CompassYaw(boundary, 0.4), boundary) == []
    assert localizer.advance(boundary + TIMEOUT_NS - 1) == []
    (output,) = localizer.advance(boundary + TIMEOUT_NS)
    assert output.estimate is not None
    assert output.estimate.state.mean[2] > 0.1


def test_several_periods_close_at_once_in_order() -> None:
    localizer = make_localizer(encoder_timeout=10.0, **AT_ORIGIN)
    stand(localizer, 10 * PERIOD_NS)
    stamp = 15 * PERIOD_NS + 1
    outputs = [o for event in ticks(stamp, 50, 50) for o in localizer.add(event, stamp)]
    assert [o.stamp_ns for o in outputs] == [n * PERIOD_NS for n in range(11, 16)]
    ways = np.diff(means(outputs)[:, 0])
    np.testing.assert_allclose(ways, 10.0 * METERS_PER_COUNT, rtol=1e-6)


def test_each_wheel_is_interpolated_linearly_on_its_own() -> None:
    rng = np.random.default_rng(4)
    stamps = [np.cumsum(rng.integers(10_000_000, 90_000_000, 120)) + seconds(7) for _ in Wheel]
    counts = [np.cumsum(rng.integers(-30, 60, 120)) for _ in Wheel]
    events = [
        WheelCount(int(stamp), wheel, int(count))
        for wheel in Wheel
        for stamp, count in zip(stamps[wheel], counts[wheel], strict=True)
    ]
    arrivals = sorted(in_time(events), key=lambda a: a.now_ns)
    # In the first period the wheels count from when both have spoken.
    outputs = estimates(feed(make_localizer(**AT_ORIGIN), arrivals))[1:]
    assert len(outputs) > 10
    ends = np.array([output.stamp_ns for output in outputs])
    begins = ends - PERIOD_NS
    left, right = (
        np.interp(ends, stamps[wheel], counts[wheel])
        - np.interp(begins, stamps[wheel], counts[wheel])
        for wheel in Wheel
    )
    expected = np.stack(
        [0.5 * (left + right) / 0.375, (right - left) / 0.6 / 0.375], axis=-1
    ) * METERS_PER_COUNT  # fmt: skip
    twists = np.array([o.estimate.twist for o in outputs if o.estimate is not None])
    np.testing.assert_allclose(twists, expected, rtol=1e-7, atol=1e-9)


def wrapped(count: int, bits: int, signed: bool) -> int:
    """Return a count as a counter of so many bits shows it."""
    shown = count % 2**bits
    return shown - 2**bits if signed and shown >= 2 ** (bits - 1) else shown


@pytest.mark.parametrize(
    ("bits", "start"), [(8, 120), (8, -128), (16, 65535), (32, 2**31 - 3), (32, 2**32 - 1)]
)
def test_a_counter_that_wraps_does_not_move_the_robot(bits: int, start: int) -> None:
    arrivals = [
        entry
        for number in range(60)
        for entry in in_time(
            ticks(seconds(3.0 + 0.05 * number), *(wrapped(start + 7 * number, bits, True),) * 2),
        )
    ]
    outputs = estimates(feed(make_localizer(encoder_bits=bits, **AT_ORIGIN), arrivals))
    expected = [7 * METERS_PER_COUNT * 7.5 * i for i in range(len(outputs))]
    np.testing.assert_allclose(means(outputs)[:, 0], expected, atol=1e-7)
    np.testing.assert_array_equal(means(outputs)[:, 1:], 0.0)


@pytest.mark.parametrize(("left", "right"), [*itertools.product([False, True], repeat=2)])
def test_inverted_wheels_count_backwards(left: bool, right: bool) -> None:
    plain, inverted = [], []
    for number in range(100):
        stamp = seconds(3.0 + 0.05 * number)
        counts = (40 * number, 30 * number)
        plain += in_time(ticks(stamp, *counts))
        shown = (wrapped(c * (-1 if i else 1), 8, True) for c, i in
                 zip(counts, (left, right), strict=True))  # fmt: skip
        inverted += in_time(ticks(stamp, *shown))
    localizer = make_localizer(
        encoder_bits=8, left_inverted=left, right_inverted=right, **AT_ORIGIN
    )
    outputs = feed(localizer, inverted)
    same_estimates(outputs, feed(make_localizer(**AT_ORIGIN), plain))
    assert means(outputs)[-1, 0] != 0.0
    assert means(outputs)[-1, 2] < 0.0


@pytest.mark.slow
def test_joint_states_give_what_ticks_give() -> None:
    ran = {
        source: feed(
            make_localizer(encoder_source=source, adaptation="r"),
            simulated(11, 30.0, source).arrivals,
        )
        for source in ("ticks", "joint_states")
    }
    assert len(ran["ticks"]) > 70
    assert [o.stamp_ns for o in ran["ticks"]] == [o.stamp_ns for o in ran["joint_states"]]
    np.testing.assert_allclose(means(ran["ticks"]), means(ran["joint_states"]), atol=1e-9)


@pytest.mark.parametrize("gear_ratio", [1.0, 30.0])
def test_a_joint_is_the_wheel_behind_the_gear(gear_ratio: float) -> None:
    counts = [(int(60 * i * gear_ratio), int(45 * i * gear_ratio)) for i in range(40)]
    per_turn = 500.0 * gear_ratio
    by_ticks, by_joints = [], []
    for number, (left, right) in enumerate(counts):
        stamp = seconds(3.0 + 0.1 * number)
        by_ticks += in_time(ticks(stamp, left, right))
        radians = (2.0 * math.pi * left / per_turn, 2.0 * math.pi * right / per_turn)
        by_joints += [
            Arrival(stamp, WheelCount(stamp, w, r)) for w, r in zip(Wheel, radians, strict=True)
        ]
    changes = AT_ORIGIN | {"gear_ratio": gear_ratio}
    first = means(feed(make_localizer(**changes), by_ticks))
    second = means(feed(make_localizer(encoder_source="joint_states", **changes), by_joints))
    np.testing.assert_allclose(first, second, atol=1e-12)
    assert first[-1, 0] > 0.5


def test_every_measurement_in_a_period_counts_at_its_own_time() -> None:
    """The textbook's EKF, fed with all readings in order, whatever comes in first."""
    begin, step_ns = 10 * PERIOD_NS, 25_000_000
    way, turn = 10.0 * METERS_PER_COUNT, 2.0 * METERS_PER_COUNT / 0.6  # of a step
    yaw, position = Row.COMPASS_YAW, [Row.X, Row.Y]
    R = np.diag(np.square([0.1, 0.1, np.sqrt(0.018), 1.0]))
    Q = np.square([0.05, math.radians(3.0)])
    rng = np.random.default_rng(8)
    x, P = np.zeros(3), 0.01 * np.eye(3) + np.diag([Q[0], 0.0, Q[1]])  # it stood for a period
    since, expected = 0, []
    arrivals, hasty = [], []
    for step in range(12 * 15 + 1):
        stamp = begin + step * step_ns
        events: list[Any] = ticks(stamp, 9 * step, 11 * step)
        z, rows = np.append(arc_pose(way, turn, step) + 0.1 * rng.standard_normal(3), 0.0), []
        if step % 15 in {4, 8, 13}:
            events.append(CompassYaw(stamp, z[yaw]))
            rows = [yaw]
        if step % 15 in {6, 8, 11}:
            events.append(PoseFix(stamp, z[:3], np.eye(3)))
            rows = [*position, *rows]
        if step and (rows or step % 15 == 0):
            steps = step - since
            noise = np.diag(Q * steps * step_ns / PERIOD_NS)
            x, P = textbook_step(False, x, P, [way * steps, turn * steps], noise, z, R, rows)
            since = step
        if step and step % 15 == 0:
            expected.append((x, P))
        arrivals += in_time(events)
        end = begin + -(-step // 15) * 15 * step_ns - 1 if step % 15 else stamp
        hasty += [Arrival(end, event) for event in reversed(events)]
    hasty.sort(key=lambda a: (a.now_ns, isinstance(a.event, WheelCount), -a.event.stamp_ns))
    settings = {"adaptation": "none", "motion_model": "exact_arc", **AT_ORIGIN}
    settings |= {"compass_gate": 0.0, "lrf_pose_gate": 0.0}
    outputs = feed(make_localizer(**settings), arrivals)
    found = [o.estimate for o in estimates(outputs) if o.stamp_ns > begin]
    assert len(found) == len(expected) == 12
    for estimate, (x, P) in zip(found, expected, strict=True):
        assert estimate is not None
        np.testing.assert_allclose(estimate.state.mean, x, atol=1e-7)
        np.testing.assert_allclose(estimate.state.covariance, P, atol=1e-9)
        assert estimate.result is not None
        assert estimate.result.degrees_of_freedom == 3 * 1 + 3 * 2
    same_estimates(feed(make_localizer(**settings), hasty), outputs)


@pytest.mark.parametrize("rate", [0.0, 0.4, -1.2])
@pytest.mark.slow
def test_measurements_inside_a_period_are_compared_with_the_pose_at_their_time(rate: float) -> None:
    """A robot on an arc whose sensors are right: the filter has nothing to correct."""
    speed, start = 0.5, 10 * PERIOD_NS
    arrivals = []
    for step in range(1200):
        stamp = start + step * 12_500_000
        time = (stamp - start) * 1e-9
        ways = (speed - 0.3 * rate) * time, (speed + 0.3 * rate) * time
        events: list[Any] = []
        if step % 30 == 11:
            events.append(PoseFix(stamp, arc_pose(speed, rate, time), np.eye(3)))
        if step % 30 == 17:
            events.append(CompassYaw(stamp, arc_pose(speed, rate, time)[2]))
        events += [WheelCount(stamp, w, way / 0.025) for w, way in zip(Wheel, ways, strict=True)]
        arrivals += in_time(events)
    localizer = make_localizer(
        encoder_source="joint_states", lrf_use_yaw=True, **AT_ORIGIN, motion_model="exact_arc"
    )
    outputs = estimates(feed(localizer, arrivals))[1:]
    assert len(outputs) > 35
    for output in outputs:
        assert output.estimate is not None
        result = output.estimate.result
        assert result is not None
        np.testing.assert_array_equal(result.available, True)
        np.testing.assert_allclose(result.innovation, 0.0, atol=1e-9)
        truth = arc_pose(speed, rate, (output.stamp_ns - start) * 1e-9)
        np.testing.assert_allclose(output.estimate.state.mean, truth, atol=1e-9)
        np.testing.assert_allclose(output.estimate.twist, [speed, rate], atol=1e-9)


@pytest.mark.parametrize(
    ("missing", "rows", "freedom"),
    [(CompassYaw, [Row.COMPASS_YAW], 2), (PoseFix, [Row.X, Row.Y], 3)],
    ids=["compass", "fixes"],
)
def test_a_missing_sensor_drops_its_rows_only(missing: Any, rows: list[Row], freedom: int) -> None:
    """The compass speaks three times a period."""
    arrivals = [a for a in simulated(11, 30.0).arrivals if not isinstance(a.event, missing)]
    localizer = make_localizer(initial_pose=[0.0, 0.0, 0.0], adaptation="q")
    outputs = estimates(feed(localizer, arrivals))
    assert len(outputs) > 70
    for output in outputs[1:-1]:
        assert output.estimate is not None
        assert np.all(np.isfinite(output.estimate.state.mean))
        assert np.all(np.linalg.eigvalsh(output.estimate.state.covariance) > 0.0)
        result = output.estimate.result
        assert result is not None
        assert not any(result.available[row] for row in [*rows, Row.LRF_YAW])
        assert int(result.degrees_of_freedom) == freedom
        assert sum(result.available) == 3 - len(rows)


@pytest.mark.slow
def test_without_any_measurement_the_robot_is_where_the_wheels_say() -> None:
    run = simulated(2, 40.0, slip_std=(0.0, 0.0), wheel_speed_error=0.05)
    arrivals = [a for a in run.arrivals if isinstance(a.event, WheelCount)]
    outputs = estimates(feed(make_localizer(initial_pose=[0.0, 0.0, 0.0]), arrivals))
    assert len(outputs) > 95
    spreads = []
    for output in outputs:
        assert output.estimate is not None
        # A count of 0.3 mm on a base of 0.6 m is 0.5 mrad; over some meters that is some mm.
        np.testing.assert_allclose(
            output.estimate.state.mean[:2], run.truth[output.stamp_ns][:2], atol=0.02
        )
        spreads.append(output.estimate.state.covariance[2, 2])
    assert np.all(np.diff(spreads) > 0.0)


def test_compass_offset_is_added() -> None:
    localizer = make_localizer(compass_offset=0.25)
    boundary = 10 * PERIOD_NS
    for event in ticks(boundary - PERIOD_NS, 0, 0):
        localizer.add(event, event.stamp_ns)
    localizer.add(PoseFix(boundary, np.zeros(3), np.eye(3)), boundary)
    localizer.add(CompassYaw(boundary, 3.1), boundary)
    outputs = [o for e in ticks(boundary, 0, 0) for o in localizer.add(e, boundary)]
    assert outputs[0].estimate is not None
    assert outputs[0].estimate.state.mean[2] == pytest.approx(3.35 - 2.0 * math.pi)


@pytest.mark.parametrize("period", [0.1, 0.375, 1.5])
def test_process_noise_grows_with_the_period(period: float) -> None:
    """After the same time without measurements the heading is equally uncertain."""
    events = [e for i in range(100) for e in ticks(seconds(3.0 + 0.15 * i), 0, 0)]
    localizer = make_localizer(period=period, lasting_errors=False, **AT_ORIGIN)
    outputs = estimates(feed(localizer, in_time(events)))
    assert outputs
    for output in outputs:
        assert output.estimate is not None
        count = output.stamp_ns // round(period * 1e9) - (seconds(3.0) - 1) // round(period * 1e9)
        expected = 0.1**2 + math.radians(3.0) ** 2 * count * period / 0.375
        assert output.estimate.state.covariance[2, 2] == pytest.approx(expected)
        variance = np.array([0.05, math.radians(3.0)]) ** 2 * (period / 0.375) / period**2
        np.testing.assert_allclose(output.estimate.twist_variance, variance)
