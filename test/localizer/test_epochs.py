# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Epochs: how a period is cut at its readings, and that nothing else depends on the period."""

import math
import random
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pytest
from localizers import (
    PERIOD_NS,
    SECOND_NS,
    Arrival,
    estimates,
    feed,
    joints_pipeline,
    make_parameters,
    same_estimates,
)

from fnn_ekf_ros.core import filter as filter_module
from fnn_ekf_ros.core.angles import wrap_angle
from fnn_ekf_ros.core.arrays import FloatArray
from fnn_ekf_ros.core.results import Epoch
from fnn_ekf_ros.parameters.localizer import LocalizerParameters
from fnn_ekf_ros.timeline.epochs import (
    MOST_READINGS,
    MOST_READINGS_A_SECOND,
    Cutter,
    Instant,
    instants,
    thinned,
)
from fnn_ekf_ros.timeline.events import (
    CompassYaw,
    Event,
    Level,
    Output,
    PoseFix,
    PoseReset,
    Status,
    Wheel,
    WheelCount,
)
from fnn_ekf_ros.timeline.inputs import Counts, InputBuffer, PeriodInputs

MS = 10**6
BEGIN_NS, END_NS = 80 * PERIOD_NS, 81 * PERIOD_NS  # 30 s
WHEEL_STEP_NS = 25 * MS
SPEED, RATE, RADIUS, SEPARATION = 0.5, 0.6, 0.025, 0.6
SHARED_NS = 3 * SECOND_NS
"""Interval at which the periods 0.02, 0.1, 0.375 and 1 s end together [ns]."""
COMPASS, FIX, BOTH, NONE = (
    [False, False, True, False],
    [True, True, False, False],
    [True, True, True, False],
    [False] * 4,
)


def compass(stamp_ns: int, yaw: float = 0.0) -> CompassYaw:
    return CompassYaw(stamp_ns, yaw)


def fix(stamp_ns: int, x: float = 0.0, y: float = 0.0) -> PoseFix:
    return PoseFix(stamp_ns, np.array([x, y, 0.0]), np.eye(3))


def wheels(stamp_ns: int, rate: float = RATE, from_ns: int = BEGIN_NS) -> list[WheelCount]:
    """Return how far the wheels of a robot on a circle have turned [rad]."""
    time = (stamp_ns - from_ns) * 1e-9
    ways = (SPEED - 0.5 * SEPARATION * rate) * time, (SPEED + 0.5 * SEPARATION * rate) * time
    return [WheelCount(stamp_ns, w, way / RADIUS) for w, way in zip(Wheel, ways, strict=True)]


def pose_at(stamp_ns: int) -> FloatArray:
    """Return where the robot on the circle is; it begins at the origin."""
    turn, radius = RATE * (stamp_ns - BEGIN_NS) * 1e-9, SPEED / RATE
    return np.array([radius * math.sin(turn), radius * (1.0 - math.cos(turn)), turn])


def readings(
    seconds: float, compass_hz: float = 8.0, fix_hz: float = 2.5, offset_ns: int = 0
) -> list[Event]:
    """Return noisy readings of the robot on the circle; both sensors read at its begin, too."""
    rng = np.random.default_rng(12)
    found: list[Event] = []
    for rate_hz in (compass_hz, fix_hz):
        for number in range(int(seconds * rate_hz)):
            stamp = BEGIN_NS + round(number * 1e9 / rate_hz) + (offset_ns if number else 0)
            pose = pose_at(stamp) + rng.standard_normal(3) * [0.1, 0.1, 0.134]
            if rate_hz == fix_hz:
                found.append(fix(stamp, pose[0], pose[1]))
            else:
                found.append(compass(stamp, pose[2]))
    return found


def in_time(events: Sequence[Event], seconds: float) -> list[Any]:
    """Return readings and the wheels' as arriving at their stamps, until a little later."""
    begin, end = BEGIN_NS - 2 * SECOND_NS, BEGIN_NS + round(seconds * 1e9) + SECOND_NS
    turned = [e for stamp in range(begin, end, WHEEL_STEP_NS) for e in wheels(stamp)]
    ordered = sorted([*events, *turned], key=lambda event: event.stamp_ns)
    return [Arrival(event.stamp_ns, event) for event in ordered]


@pytest.fixture
def cut() -> Callable[..., PeriodInputs]:
    """Cuts the period from `BEGIN_NS` to `END_NS` at readings; the robot turns on a circle."""

    def run(
        events: Sequence[Event], counts: Counts | None = None, turn: float = 0.0, **changes: Any
    ) -> PeriodInputs:
        buffer = InputBuffer(make_parameters(encoder_source="joint_states", **changes))
        for stamp in range(BEGIN_NS - SECOND_NS, END_NS + SECOND_NS, WHEEL_STEP_NS):
            # A rate that swings: the path between two readings is no straight share of it.
            for event in wheels(stamp, RATE + turn * math.sin(stamp * 1e-9)):
                buffer.add(event)
        for event in events:
            buffer.add(event)
        at_begin = buffer.counts_at(BEGIN_NS) if counts is None else counts
        return buffer.period(BEGIN_NS, END_NS, at_begin)

    return run


def measured(inputs: PeriodInputs) -> list[list[bool]]:
    """Return which rows the epochs of a period have."""
    return [epoch.available.tolist() for epoch in (*inputs.epochs, *inputs.epochs_after_reset)]


def durations_ms(epochs: Sequence[Epoch]) -> list[float]:
    return [1e3 * epoch.duration_s for epoch in epochs]


def same_inputs(one: PeriodInputs, other: PeriodInputs) -> None:
    """Assert that two periods are cut in the same way, bit for bit."""
    assert len(one.epochs) == len(other.epochs)
    for first, second in zip(one.epochs, other.epochs, strict=True):
        for a, b in zip(first, second, strict=True):
            np.testing.assert_array_equal(a, b)


# Cutting


def test_a_period_without_readings_is_one_epoch(cut: Any) -> None:
    inputs = cut([])
    assert measured(inputs) == [NONE]
    assert durations_ms(inputs.epochs) == [375.0]
    np.testing.assert_array_equal(inputs.epochs[0].control, inputs.control)
    np.testing.assert_allclose(inputs.control, [SPEED * 0.375, RATE * 0.375])


@pytest.mark.parametrize("reverse", [False, True])
def test_readings_of_one_millisecond_are_one_epoch_that_ends_with_the_last(
    cut: Any, reverse: bool
) -> None:
    at = BEGIN_NS + 100 * MS
    for early, late in [(1, MS), (200_000, 200_001), (5, 5)]:
        for events in (
            [compass(at + early, 0.3), fix(at + late, 1.0, 2.0)],
            [compass(at + late, 0.3), fix(at + early, 1.0, 2.0)],
        ):
            inputs = cut(events[::-1] if reverse else events)
            assert measured(inputs) == [BOTH, NONE]
            assert inputs.epochs[0].duration_s == (100 * MS + late) / 1e9
            np.testing.assert_array_equal(inputs.epochs[0].measurement, [1.0, 2.0, 0.3, 0.0])
            same_inputs(inputs, cut(events))


def test_readings_of_two_milliseconds_are_two_epochs(cut: Any) -> None:
    at = BEGIN_NS + 100 * MS  # milliseconds end with the whole ones, as periods do
    assert measured(cut([compass(at), fix(at + 1)])) == [COMPASS, FIX, NONE]
    assert measured(cut([compass(at + MS + 1), fix(at + MS)])) == [FIX, COMPASS, NONE]


def test_a_second_reading_of_a_sensor_is_an_epoch_of_its_own(cut: Any) -> None:
    at = BEGIN_NS + 100 * MS
    events = [compass(at - 900, 0.1), compass(at - 500, 0.2), fix(at - 100), compass(at, 0.3)]
    inputs = cut(events)
    assert measured(inputs) == [BOTH, COMPASS, COMPASS, NONE]
    assert [epoch.measurement[2] for epoch in inputs.epochs[:3]] == [0.1, 0.2, 0.3]
    assert all(duration >= 0.0 for duration in durations_ms(inputs.epochs))
    assert sum(durations_ms(inputs.epochs)[:3]) == pytest.approx(100.0, abs=1e-9)
    for seed in range(6):
        shuffled = random.Random(seed).sample(events, len(events))
        same_inputs(cut(shuffled), inputs)


def test_equal_stamps_of_one_sensor_are_two_epochs_whatever_comes_first(cut: Any) -> None:
    at = BEGIN_NS + 100 * MS
    events = [compass(at, 0.2), compass(at, 0.1), fix(at, 2.0), fix(at, 1.0)]
    inputs = cut(events)
    assert measured(inputs) == [BOTH, BOTH, NONE]
    same_inputs(inputs, cut(events[::-1]))
    np.testing.assert_array_equal(inputs.epochs[1].control, 0.0)
    assert inputs.epochs[1].duration_s == 0.0
    same_inputs(inputs, cut([*events, *events]))  # what is sent twice counts once


def test_a_reading_at_the_begin_belongs_to_the_period_before_and_one_at_the_end_to_this(
    cut: Any,
) -> None:
    events = [compass(BEGIN_NS), fix(BEGIN_NS), compass(END_NS, 0.5), fix(END_NS + 1)]
    inputs = cut(events)
    assert measured(inputs) == [COMPASS]
    assert durations_ms(inputs.epochs) == [375.0]
    assert measured(cut([compass(BEGIN_NS + 1), fix(END_NS)])) == [COMPASS, FIX]


@pytest.mark.parametrize("reset", [False, True])
def test_epochs_add_up_to_the_period(cut: Any, reset: bool) -> None:
    """Durations, and the wheels' way and turn; the sums are exact but for rounding."""
    rng = np.random.default_rng(3)
    for _ in range(40):
        stamps = BEGIN_NS + 1 + rng.integers(0, PERIOD_NS, 12)
        events: list[Event] = [
            compass(int(stamp)) if number % 3 else fix(int(stamp))
            for number, stamp in enumerate(stamps)
        ]
        if reset:
            at = int(stamps[0]) + int(rng.integers(-1, 2))
            events.append(PoseReset(min(max(at, BEGIN_NS + 1), END_NS), np.zeros(3), np.eye(3)))
        inputs = cut(events, turn=0.5)
        epochs = [*inputs.epochs, *inputs.epochs_after_reset]
        assert sum(int(sum(epoch.available)) for epoch in epochs) == 8 + 4 * 2
        assert sum(epoch.duration_s for epoch in epochs) == pytest.approx(0.375, abs=1e-12)
        assert min(epoch.duration_s for epoch in epochs) >= 0.0
        total = np.sum([epoch.control for epoch in epochs], axis=0)
        np.testing.assert_allclose(total, inputs.control, rtol=0.0, atol=1e-13)
        if reset:
            assert inputs.reset is not None
            before = sum(epoch.duration_s for epoch in inputs.epochs)
            since = (inputs.reset.stamp_ns - BEGIN_NS) / 1e9
            assert before == pytest.approx(since, abs=1e-12)


def test_an_epoch_has_what_the_wheels_did_in_it(cut: Any) -> None:
    inputs = cut([compass(BEGIN_NS + 110 * MS), fix(BEGIN_NS + 260 * MS)])
    for epoch, duration_s in zip(inputs.epochs, (0.11, 0.15, 0.115), strict=True):
        assert epoch.duration_s == pytest.approx(duration_s)
        np.testing.assert_allclose(epoch.control, [SPEED * duration_s, RATE * duration_s])


def test_what_the_wheels_did_before_and_was_not_known_falls_into_the_first_epoch(
    cut: Any,
) -> None:
    at = BEGIN_NS + 100 * MS
    plain = cut([compass(at), fix(at + 50 * MS)])
    behind = 0.04 / RADIUS  # 40 mm of both wheels
    left, right = (event.reading for event in wheels(BEGIN_NS))
    late = cut([compass(at), fix(at + 50 * MS)], Counts(left - behind, right - behind))
    np.testing.assert_allclose(late.epochs[0].control - plain.epochs[0].control, [0.04, 0.0],
                               atol=1e-12)  # fmt: skip
    for one, other in zip(late.epochs[1:], plain.epochs[1:], strict=True):
        np.testing.assert_allclose(one.control, other.control, atol=1e-12)
    np.testing.assert_allclose(late.control - plain.control, [0.04, 0.0], atol=1e-12)


def test_a_robot_does_not_move_in_epochs_before_both_wheels_have_spoken() -> None:
    buffer = InputBuffer(make_parameters(encoder_source="joint_states"))
    spoke = {Wheel.LEFT: BEGIN_NS + 50 * MS, Wheel.RIGHT: BEGIN_NS + 200 * MS}  # one would turn it
    for stamp in range(BEGIN_NS, END_NS + SECOND_NS, WHEEL_STEP_NS):
        for event in wheels(stamp):
            if stamp >= spoke[event.wheel]:
                buffer.add(event)
    for event in (compass(BEGIN_NS + 100 * MS), compass(BEGIN_NS + 300 * MS)):
        buffer.add(event)
    inputs = buffer.period(BEGIN_NS, END_NS, Counts())
    assert not inputs.wheels_known
    first, second, last = inputs.epochs
    np.testing.assert_array_equal(first.control, 0.0)
    np.testing.assert_allclose(second.control, [SPEED * 0.1, RATE * 0.1], atol=1e-12)
    np.testing.assert_allclose(last.control, [SPEED * 0.075, RATE * 0.075], atol=1e-12)


def test_instants_are_in_order_and_never_go_back() -> None:
    rng = np.random.default_rng(5)
    for _ in range(50):
        stamps = [np.sort(rng.integers(0, 20 * MS, 30)) for _ in range(2)]
        ours = [compass(int(stamp)) for stamp in stamps[0]], [fix(int(s)) for s in stamps[1]]
        found: list[Instant] = instants(*ours)
        ends = [instant.stamp_ns for instant in found]
        assert ends == sorted(ends)
        assert sum(len(instant.readings) for instant in found) == 60
        for instant in found:
            assert len({type(reading) for reading in instant.readings}) == len(instant.readings)
            assert all(0 <= instant.stamp_ns - r.stamp_ns < MS for r in instant.readings)


# Thinning


@pytest.mark.parametrize("period_s", [0.02, 0.375, 2.0])
def test_as_many_readings_as_are_taken_are_spread_evenly(period_s: float) -> None:
    most = max(MOST_READINGS, math.ceil(MOST_READINGS_A_SECOND * period_s))
    for count in (0, 1, most - 1, most):
        few = [compass(number) for number in range(count)]
        assert thinned(few, period_s) is few
    for count in (most + 1, 2 * most, 7 * most + 3):
        stamps = [r.stamp_ns for r in thinned([compass(n) for n in range(count)], period_s)]
        assert len(stamps) == most
        assert stamps[-1] == count - 1  # the last one, which the noise is learned from
        apart = np.diff([-1, *stamps])
        assert set(apart) <= {count // most, -(-count // most)}


def sensor_statuses(outputs: list[Output], name: str) -> list[Status]:
    return [status for o in outputs for status in o.statuses or () if status.name == name]


@pytest.mark.parametrize("sensor", ["compass", "lrf_pose"])
@pytest.mark.slow
def test_a_sensor_that_is_too_fast_is_thinned_and_told(sensor: str) -> None:
    rates = {"compass_hz": 500.0} if sensor == "compass" else {"fix_hz": 500.0}
    arrivals = in_time(readings(3.0, **rates), 3.0)
    ran = joints_pipeline(adaptation="none")
    outputs = feed(ran, arrivals)
    told = [s for s in sensor_statuses(outputs, sensor) if "too fast" in s.message]
    assert len(told) >= 2
    left_out = 0
    for status in told:
        assert status.level is Level.WARN
        assert status.message == "too fast: some readings are left out"
        values = dict(status.values)
        assert values["largest rate that is used [1/s]"] == "250"
        left_out += int(values["left out since the last report"])
        assert values["left out"] == str(left_out)
    # 3 s of 1500 readings, 94 taken in each of eight periods; the last second may not be told yet.
    assert 400 <= left_out <= 1500 - 8 * 94
    other = "lrf_pose" if sensor == "compass" else "compass"
    assert not any("left out" in dict(s.values) for s in sensor_statuses(outputs, other))
    for output in estimates(outputs)[1:8]:
        assert output.estimate is not None
        assert output.estimate.result is not None
        index = 0 if sensor == "compass" else 1
        most = 94 if sensor == "compass" else 188  # rows of 94 readings
        assert output.estimate.result.sensor_degrees_of_freedom[index] == most


@pytest.mark.parametrize(
    ("rate_hz", "period"), [(100.0, 0.375), (190.0, 0.375), (250.0, 0.375), (200.0, 0.29)]
)
@pytest.mark.slow
def test_a_fast_sensor_is_not_thinned(rate_hz: float, period: float) -> None:
    """Up to 250 Hz; 0.29 s times 200 Hz is a little less than 58 in floating point."""
    arrivals = in_time(readings(2.5, compass_hz=rate_hz, offset_ns=700), 2.5)
    outputs = feed(joints_pipeline(adaptation="none", period=period), arrivals)
    statuses = sensor_statuses(outputs, "compass")
    assert len(statuses) >= 2
    for status in statuses:
        assert "left out" not in dict(status.values)
        assert "too fast" not in status.message
    full = [o.estimate for o in estimates(outputs)[1:6]]
    taken = sum(int(e.result.sensor_degrees_of_freedom[0]) for e in full if e and e.result)
    assert abs(taken - rate_hz * 5 * period) <= 1.0


@pytest.mark.parametrize("mode", ["none", "joint"])
@pytest.mark.slow
def test_a_burst_of_a_very_fast_compass_is_bounded_work(
    monkeypatch: pytest.MonkeyPatch, mode: str
) -> None:
    """A second at 1000 Hz amid an ordinary drive."""
    fuse, calls = filter_module.fuse, [0]

    def counted(*told: Any) -> Any:
        calls[0] += 1
        return fuse(*told)

    monkeypatch.setattr(filter_module, "fuse", counted)
    rng = np.random.default_rng(2)
    burst: list[Event] = [
        compass(stamp, float(pose_at(stamp)[2]) + 0.134 * rng.standard_normal())
        for stamp in range(BEGIN_NS + SECOND_NS + 1, BEGIN_NS + 2 * SECOND_NS, MS)
    ]
    arrivals = in_time([*readings(4.0), *burst], 4.0)
    outputs, most = [], 0
    ran = joints_pipeline(adaptation=mode)
    for now_ns, event in arrivals:
        before = calls[0]
        closed = ran.add(event, now_ns)
        outputs += closed
        if closed:
            most = max(most, (calls[0] - before) // len(closed))
    assert 94 <= most <= 94 + 1 + 1 + 1  # the compass's, a fix or two, the period's end
    found = [o.estimate for o in estimates(outputs)]
    assert len(found) >= 10
    for estimate in found:
        assert estimate is not None
        error = estimate.state.mean - pose_at(estimate.stamp_ns)
        assert np.hypot(*error[:2]) < 0.35
        assert abs(wrap_angle(error[2])) < 0.35
        assert np.linalg.eigvalsh(estimate.state.covariance)[0] > 0.0


# Nothing depends on the period, or on when a reading comes in


@pytest.fixture
def shared() -> Callable[..., dict[int, tuple[FloatArray, FloatArray, FloatArray, FloatArray]]]:
    """What a filter finds at the instants at which periods of any length end, every `SHARED_NS`."""

    def run(period: float, mode: str, seconds: float) -> Any:
        arrivals = in_time(readings(seconds, offset_ns=10 * MS + 13), seconds)
        outputs = estimates(feed(joints_pipeline(period=period, adaptation=mode), arrivals))
        assert outputs[0].stamp_ns == BEGIN_NS  # it starts with its first readings
        states = {o.stamp_ns: o.estimate.state for o in outputs if o.estimate is not None}
        return {
            stamp: (s.mean, s.covariance, s.process_noise, s.measurement_noise)
            for stamp, s in states.items()
            if stamp % SHARED_NS == 0
        }

    return run


@pytest.mark.parametrize("period", [0.02, 0.1, 1.0])
@pytest.mark.slow
def test_the_plain_filter_does_not_depend_on_the_period(shared: Any, period: float) -> None:
    """But for where steps are cut.

    A period's end cuts a step, and of the noise in its middle the rest of the way makes a little
    variance sideways (`core.motion`). Here, 11 cuts between two readings move the standard
    deviations by 0.09 % at the most (0.04 mm), and the estimates by 0.03 mm and 0.003 mrad.
    """
    found, expected = shared(period, "none", 12.0), shared(0.375, "none", 12.0)
    assert found.keys() == expected.keys()
    assert len(found) >= 5
    for stamp, (x, P, _, _) in expected.items():
        mean, covariance, _, _ = found[stamp]
        np.testing.assert_allclose(mean[:2], x[:2], atol=5e-5)
        np.testing.assert_allclose(wrap_angle(mean[2] - x[2]), 0.0, atol=1e-5)
        stds, other = np.sqrt(np.diag(covariance)), np.sqrt(np.diag(P))
        np.testing.assert_allclose(stds, other, rtol=1.5e-3)


@pytest.mark.parametrize("period", [0.02, 1.0])
@pytest.mark.slow
def test_joint_adaptation_hardly_depends_on_the_period(shared: Any, period: float) -> None:
    """As the plain filter; what is learned of it differs by 0.3 % (variance) at the most."""
    found, expected = shared(period, "joint", 12.0), shared(0.375, "joint", 12.0)
    assert found.keys() == expected.keys()
    for stamp, (x, P, Q, R) in expected.items():
        mean, covariance, process, measurement = found[stamp]
        np.testing.assert_allclose(mean[:2], x[:2], atol=2e-4)
        np.testing.assert_allclose(wrap_angle(mean[2] - x[2]), 0.0, atol=2e-4)
        np.testing.assert_allclose(np.diag(covariance), np.diag(P), rtol=5e-3)
        np.testing.assert_allclose(process, Q, rtol=0.01)
        np.testing.assert_allclose(measurement, R, rtol=5e-3)


@pytest.mark.slow
def test_short_periods_mean_no_more_learning(monkeypatch: pytest.MonkeyPatch) -> None:
    """Joint adaptation learns from readings, of which there are as many whatever the period."""
    arrivals = in_time(readings(6.0, offset_ns=10 * MS), 6.0)
    learn, calls = filter_module.learn, [0]

    def counted(*told: Any, **more: Any) -> Any:
        calls[0] += 1
        return learn(*told, **more)

    monkeypatch.setattr(filter_module, "learn", counted)
    learned = []
    for period in (0.02, 0.375):
        calls[0] = 0
        outputs = estimates(feed(joints_pipeline(period=period, adaptation="joint"), arrivals))
        assert outputs[-1].stamp_ns >= BEGIN_NS + 6 * SECOND_NS
        learned.append(calls[0])
    assert learned[0] == learned[1]
    fixes = sum(isinstance(a.event, PoseFix) for a in arrivals)
    # Every fix and one reading of the compass after each, if it did not share the fix's instant.
    assert fixes - 1 <= learned[0] <= 2 * fixes


@pytest.mark.parametrize(("period", "mode"), [(0.1, "none"), (0.375, "rq"), (0.375, "joint")])
@pytest.mark.slow
def test_readings_that_come_late_and_in_any_order_count_as_if_they_had_come_in_time(
    period: float, mode: str
) -> None:
    """Within `history`, bit for bit."""
    prompt = in_time(readings(5.0, offset_ns=7 * MS), 6.0)
    rng = random.Random(4)
    late = [
        a._replace(now_ns=a.now_ns + rng.randrange(800 * MS))
        if not isinstance(a.event, WheelCount)
        else a
        for a in prompt
    ]
    late.sort(key=lambda a: a.now_ns)
    settings = {"period": period, "adaptation": mode, "history": 2.0}
    since = max(a.now_ns for a in late if not isinstance(a.event, WheelCount))
    assert since > BEGIN_NS + 5 * SECOND_NS
    ran = []
    for arrivals in (prompt, late):
        outputs = feed(joints_pipeline(**settings), arrivals)
        ran.append([o for o in outputs if o.stamp_ns > since])
    assert ran[0]
    same_estimates(*ran)
    assert ran[0][-1].estimate is not None


def test_the_papers_adaptation_takes_one_step_a_period_from_the_last_reading_of_each_row(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    adapt, told = filter_module.adapt, []

    def recorded(*arguments: Any) -> Any:
        told.append(arguments)
        return adapt(*arguments)

    monkeypatch.setattr(filter_module, "adapt", recorded)
    arrivals = in_time(readings(6.0, 20.0, 6.0, offset_ns=3 * MS), 6.0)
    ran = joints_pipeline(
        adaptation="rq", innovation_window=5, measurement_noise_std=[0.3, 0.3, 0.3]
    )
    outputs = [o.estimate for o in estimates(feed(ran, arrivals))]
    steps = [e for e in outputs if e is not None and e.result is not None]
    assert len(told) == len(steps) >= 15
    before = None
    for estimate, (_, Q, R, window, variance, teaches, _, _) in zip(steps, told, strict=True):
        result = estimate.result
        assert result is not None
        for row in range(3):
            seen = [shown for shown in result.shown if shown.available[row]]
            if seen:
                assert result.innovation[row] == seen[-1].innovation[row]
                assert variance[row] == seen[-1].innovation_variance[row]
                assert bool(teaches[row]) == bool(seen[-1].teaches[row])
                assert result.innovation[row] ** 2 in window.squares[:, row]
        if before is not None:  # in between the noise was as it had been
            np.testing.assert_array_equal(Q, before.state.process_noise)
            np.testing.assert_array_equal(R, before.state.measurement_noise)
        before = estimate
    assert any(len([s for s in e.result.shown if s.available[2]]) > 5 for e in steps if e.result)
    assert np.any(steps[-1].state.measurement_noise[:3] < 0.08)


def test_what_a_fix_reports_of_a_yaw_that_is_not_used_does_not_matter() -> None:
    """Nobody has checked it."""
    parameters = LocalizerParameters(
        wheel_radius=0.05,
        wheel_separation=0.4,
        encoder_counts_per_revolution=500.0,
        lrf_use_message_covariance=True,
    )
    covariance = np.array([[0.04, 0.01, 1e300], [0.01, 0.09, math.nan], [1e300, math.nan, 1e300]])
    reading = PoseFix(BEGIN_NS + 5, np.array([1.0, 2.0, 0.5]), covariance)
    cutter = Cutter(parameters)
    (epoch,) = cutter.epochs(
        BEGIN_NS, BEGIN_NS + 5, instants((), (reading,)), lambda _: np.zeros(2), np.zeros(2)
    )
    assert epoch.fix_covariance is not None
    np.testing.assert_array_equal(epoch.fix_covariance[:2, :2], covariance[:2, :2])
    np.testing.assert_array_equal(epoch.fix_covariance[2], [0.0, 0.0, 1.0])
