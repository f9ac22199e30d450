# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""How a period is cut into epochs at its readings, and which readings are left out."""

import math
import random
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pytest
from circle_drives import (
    BEGIN_NS,
    END_NS,
    MS,
    RADIUS,
    RATE,
    SPEED,
    WHEEL_STEP_NS,
    compass,
    fix,
    wheels,
)
from localizers import PERIOD_NS, SECOND_NS, make_parameters

from fnn_ekf_ros.core.results import Epoch
from fnn_ekf_ros.timeline.epochs import (
    MOST_READINGS,
    MOST_READINGS_A_SECOND,
    Instant,
    instants,
    thinned,
)
from fnn_ekf_ros.timeline.events import Event, PoseReset, Wheel
from fnn_ekf_ros.timeline.inputs import Counts, InputBuffer, PeriodInputs

COMPASS, FIX, BOTH, NONE = (
    [False, False, True, False],
    [True, True, False, False],
    [True, True, True, False],
    [False] * 4,
)


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
