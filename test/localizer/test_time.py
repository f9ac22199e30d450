# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Time: late inputs, their order, clocks that jump, resets, and switching the adaptation."""

import functools
import random
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from localizers import (
    PERIOD_NS,
    SECOND_NS,
    START_NS,
    Arrival,
    feed,
    make_localizer,
    same_estimates,
    simulated,
    status_at_end,
    time_values,
)

from fnn_ekf_ros.core.joint_state import noise_without_alarms
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
from fnn_ekf_ros.timeline.filter_model import noise_bounds

WRONG_START = {"adaptation": "r", "measurement_noise_std": [0.4, 0.4, 0.5]}


def value_of(status: Status, key: str) -> str:
    return dict(status.values)[key]


def noise_of(output: Output) -> np.ndarray:
    assert output.estimate is not None
    return output.estimate.state.measurement_noise


def delayed(arrivals: Sequence[Any], moved: Event, by_ns: int) -> list[Any]:
    """Return arrivals in which one event comes in later."""
    late = [a._replace(now_ns=a.now_ns + by_ns) if a.event is moved else a for a in arrivals]
    return sorted(late, key=lambda a: a.now_ns)


def pick(arrivals: Sequence[Any], kind: type[Event], after_ns: int) -> Any:
    """Return the first event of a kind after a time; a measurement that ends its period."""
    return next(
        a.event
        for a in arrivals
        if isinstance(a.event, kind)
        and a.event.stamp_ns > after_ns
        and (kind is WheelCount or a.event.stamp_ns % PERIOD_NS == 0)
    )


@functools.cache
def run_in_time(adaptation: str) -> tuple[Sequence[Arrival], list[Output]]:
    """Return what arrives in 20 s, and what comes of it where nothing is late."""
    arrivals = simulated(11, 20.0).arrivals
    return arrivals, feed(make_localizer(adaptation=adaptation), arrivals)


@pytest.mark.parametrize("adaptation", ["none", "r", "q", "rq"])
@pytest.mark.parametrize("kind", [CompassYaw, PoseFix])
@pytest.mark.parametrize("late_s", [0.2, 1.1, 1.6])
@pytest.mark.slow
def test_a_late_measurement_counts_from_the_next_period_on_as_if_it_had_been_in_time(
    adaptation: str, kind: type, late_s: float
) -> None:
    arrivals, in_time = run_in_time(adaptation)
    event = pick(arrivals, kind, START_NS + 14 * SECOND_NS)
    localizer = make_localizer(adaptation=adaptation)
    outputs = feed(localizer, delayed(arrivals, event, round(late_s * SECOND_NS)))
    came_ns = event.stamp_ns + round(late_s * SECOND_NS)
    same_estimates(
        [o for o in outputs if o.stamp_ns > came_ns], [o for o in in_time if o.stamp_ns > came_ns]
    )
    between = [o for o in outputs if event.stamp_ns <= o.stamp_ns < came_ns - 20_000_000]
    for output in between:  # what was published without it stays published
        twin = next(o for o in in_time if o.stamp_ns == output.stamp_ns)
        assert output.estimate is not None
        assert twin.estimate is not None
        if not (kind is CompassYaw and late_s == 0.2):
            assert np.any(output.estimate.state.mean != twin.estimate.state.mean)
    assert time_values(localizer)["dropped"] == "0"
    assert int(time_values(localizer)["periods run again for late inputs"]) == len(
        [o for o in outputs if event.stamp_ns <= o.stamp_ns < came_ns]
    )


@pytest.mark.slow
def test_a_late_pose_reset_counts_at_its_stamp() -> None:
    arrivals = list(simulated(11, 30.0).arrivals)
    reset = PoseReset(START_NS + 20 * SECOND_NS + 7, np.array([5.0, 5.0, 1.0]), 0.01 * np.eye(3))
    arrivals = sorted([*arrivals, Arrival(reset.stamp_ns, reset)], key=lambda a: a.now_ns)
    in_time = feed(make_localizer(adaptation="r"), arrivals)
    outputs = feed(make_localizer(adaptation="r"), delayed(arrivals, reset, SECOND_NS))
    later = START_NS + 21 * SECOND_NS + 100
    same_estimates(
        [o for o in outputs if o.stamp_ns > later], [o for o in in_time if o.stamp_ns > later]
    )


@pytest.mark.parametrize("wheels", [[Wheel.LEFT], [Wheel.RIGHT], list(Wheel)])
@pytest.mark.slow
def test_wheels_that_come_late_are_made_up_for(wheels: list[Wheel]) -> None:
    """A gap of 1.5 s, longer than the timeout; then all counts of the gap come at once."""
    arrivals = simulated(11, 30.0).arrivals
    begin, end = START_NS + 20 * SECOND_NS, START_NS + 20 * SECOND_NS + 1_500_000_000

    def held_up(a: Any) -> bool:
        return (
            isinstance(a.event, WheelCount) and a.event.wheel in wheels and begin < a.now_ns < end
        )

    late = [a._replace(now_ns=end) if held_up(a) else a for a in arrivals]
    late.sort(key=lambda a: a.now_ns)
    in_time = feed(make_localizer(adaptation="r"), arrivals)
    localizer = make_localizer(adaptation="r")
    outputs = feed(localizer, late)
    assert (
        int(value_of(status_at_end(localizer, "encoders"), "periods closed without both wheels"))
        >= 2
    )
    same_estimates(
        [o for o in outputs if o.stamp_ns > end], [o for o in in_time if o.stamp_ns > end]
    )


@pytest.mark.slow
def test_a_gap_in_the_counts_is_bridged_and_no_way_is_lost() -> None:
    """Counts that are lost for good for longer than `history`: the way comes in afterwards."""
    run = simulated(2, 40.0, slip_std=(0.0, 0.0), path="figure_eight", speed=0.05)
    begin, end = START_NS + 20 * SECOND_NS, START_NS + 24 * SECOND_NS
    arrivals = [
        a for a in run.arrivals if isinstance(a.event, WheelCount) and not begin < a.now_ns < end
    ]
    heading = list(run.truth[min(run.truth)])
    outputs = feed(make_localizer(initial_pose=heading), arrivals)
    last = outputs[-1]
    assert last.estimate is not None
    way = np.linalg.norm(last.estimate.state.mean[:2] - run.truth[last.stamp_ns][:2])
    assert way < 0.1
    assert np.linalg.norm(run.truth[last.stamp_ns][:2] - heading[:2]) > 1.0


@pytest.mark.parametrize("kind", [CompassYaw, PoseFix, WheelCount])
@pytest.mark.slow
def test_what_comes_later_than_history_is_dropped_and_counted(kind: type) -> None:
    arrivals = simulated(11, 30.0).arrivals
    event = pick(arrivals, kind, START_NS + 20 * SECOND_NS)
    without = feed(make_localizer(), [a for a in arrivals if a.event is not event])
    localizer = make_localizer()
    outputs = feed(localizer, delayed(arrivals, event, 3 * SECOND_NS))
    same_estimates(outputs, without)
    status = status_at_end(localizer, "time")
    assert value_of(status, "dropped") == "1"
    reports = [s for o in outputs if o.statuses for s in o.statuses if s.name == "time"]
    warnings = [s for s in reports if s.level is Level.WARN]
    assert len(warnings) == 1
    name = {CompassYaw: "compass", PoseFix: "lrf_pose", WheelCount: "encoders"}[kind]
    assert warnings[0].message == f"{name} message dropped: later than history"
    assert value_of(status, "last dropped, delay [s]").startswith("3.0")


def test_what_is_stamped_far_ahead_is_dropped_and_counted() -> None:
    localizer = make_localizer(initial_pose=[0.0, 0.0, 0.0])
    now = 10 * PERIOD_NS
    localizer.add(CompassYaw(now, 0.0), now)
    localizer.add(CompassYaw(now + SECOND_NS + 1, 1.0), now)
    assert time_values(localizer)["dropped"] == "1"
    localizer.add(CompassYaw(now + SECOND_NS, 1.0), now)
    status = status_at_end(localizer, "time")
    assert (value_of(status, "dropped"), status.level) == ("1", Level.OK)


def test_a_first_event_that_is_too_old_is_dropped() -> None:
    """A driver that does not stamp sends time 0; filling the time since then takes for ever."""
    localizer = make_localizer(initial_pose=[0.0, 0.0, 0.0])
    outputs = localizer.add(CompassYaw(1, 0.0), 900 * SECOND_NS)
    assert min(output.stamp_ns for output in outputs) > 897 * SECOND_NS
    assert time_values(localizer)["dropped"] == "1"


def test_an_event_before_the_first_period_is_not_called_received() -> None:
    localizer = make_localizer(initial_pose=[0.0, 0.0, 0.0])
    now = 20 * PERIOD_NS
    for wheel in Wheel:
        localizer.add(WheelCount(now + 1, wheel, 0), now + 1)
    localizer.add(CompassYaw(now - 2_400_000_000, 1.0), now + 2)
    assert time_values(localizer)["dropped"] == "1"
    assert value_of(status_at_end(localizer, "compass"), "received") == "0"


def test_a_measurement_as_old_as_history_is_used_or_counted() -> None:
    localizer = make_localizer(period=0.5, history=2.0, initial_pose=[0.0, 0.0, 0.0])
    outputs: list[Output] = []
    for number in range(40, 61):
        stamp = number * SECOND_NS // 4
        for wheel in Wheel:
            outputs += localizer.add(WheelCount(stamp, wheel, 0), stamp)
    localizer.add(CompassYaw(outputs[-1].stamp_ns - 2 * SECOND_NS, 1.0), 15 * SECOND_NS)
    (output,) = localizer.advance(16 * SECOND_NS)
    assert output.estimate is not None
    used = abs(float(output.estimate.state.mean[2])) > 0.1
    assert used or time_values(localizer)["dropped"] == "1"


@settings(derandomize=True, deadline=None, max_examples=12)
@given(seed=st.integers(0, 2**32 - 1))
@pytest.mark.slow
def test_the_order_of_events_inside_a_period_does_not_matter(seed: int) -> None:
    """Everything stamped inside of a period comes at its end, in any order.

    Only the first count of each wheel comes first: it closes the period before, and tells how
    the wheels went on from its end.
    """
    arrivals = simulated(11, 15.0, "joint_states").arrivals
    rng = random.Random(seed)
    first = START_NS + PERIOD_NS  # from the second period on: see below
    shuffled = [a for a in arrivals if a.event.stamp_ns <= first]
    for end in range(first + PERIOD_NS, arrivals[-1].now_ns, PERIOD_NS):
        inside = [a.event for a in arrivals if end - PERIOD_NS < a.event.stamp_ns <= end]
        counts = [event for event in inside if isinstance(event, WheelCount)]
        closing = [next(event for event in counts if event.wheel is wheel) for wheel in Wheel]
        others = [event for event in inside if all(event is not c for c in closing)]
        rng.shuffle(others)
        shuffled += [Arrival(end, event) for event in [*closing, *others]]
    source = {"encoder_source": "joint_states"}  # ticks are in order: they are stamped on arrival
    ordered = feed(make_localizer(adaptation="r", **source), arrivals)
    outputs = feed(make_localizer(adaptation="r", **source), shuffled)
    assert len(outputs) > 30
    same_estimates(outputs, ordered[: len(outputs)])


def test_the_order_of_the_very_first_counts_does_not_matter() -> None:
    ran = []
    for order in (1, -1):
        localizer = make_localizer(initial_pose=[0.0, 0.0, 0.0], encoder_source="joint_states")
        inside = [(3_100_000_000, 0), (3_300_000_000, 100)]
        for stamp, count in [*inside[::order], (3_500_000_000, 200)]:
            outputs = []
            for wheel in Wheel:
                outputs += localizer.add(WheelCount(stamp, wheel, count), 3_500_000_000)
        ran.append(outputs)
    same_estimates(*ran)


def shifted(arrivals: Sequence[Any], by_ns: int) -> list[Any]:
    return [
        a._replace(
            now_ns=a.now_ns + by_ns, event=a.event._replace(stamp_ns=a.event.stamp_ns + by_ns)
        )
        for a in arrivals
    ]


@pytest.mark.parametrize("jump_s", [-27, -1500, 1500, 999_999])  # whole periods, as all shifts
@pytest.mark.slow
def test_a_clock_that_jumps_starts_anew_and_keeps_the_adapted_noise(jump_s: int) -> None:
    arrivals = simulated(11, 30.0).arrivals
    moved = shifted(arrivals, 2001 * SECOND_NS)
    localizer = make_localizer(**WRONG_START)
    adapted = noise_of(feed(localizer, moved)[-1])
    assert np.all(adapted[:3] < 0.7 * np.array([0.16, 0.16, 0.25]))

    again = shifted(moved, (jump_s + (30 if jump_s > 0 else 0)) * SECOND_NS)
    outputs = feed(localizer, again)
    assert outputs[0].estimate is None  # pose and inputs are forgotten: it waits as at the start
    assert len(outputs) <= len(arrivals)
    assert {o.stamp_ns % PERIOD_NS for o in outputs} == {0}
    assert min(o.stamp_ns for o in outputs) > again[0].now_ns - 2_400_000_000
    first = next(o.estimate for o in outputs if o.estimate is not None)
    np.testing.assert_array_equal(np.diag(first.state.covariance), adapted[:3])
    np.testing.assert_array_equal(first.state.measurement_noise, adapted)
    status = next(s for o in outputs if o.statuses for s in o.statuses if s.name == "time")
    assert status.level is Level.WARN
    assert ("back" in status.message) is (jump_s < 0)
    assert value_of(status, "restarts") == "1"


def test_a_restart_in_mode_joint_keeps_what_is_calm_and_no_alarm() -> None:
    arrivals = simulated(11, 30.0).arrivals
    localizer = make_localizer(adaptation="joint", measurement_noise_std=[0.4, 0.4, 0.5])
    last = feed(localizer, arrivals)[-1].estimate
    assert last is not None
    assert last.state.joint is not None
    expected = noise_without_alarms(last.state.joint, noise_bounds(localizer.parameters))
    outputs = feed(localizer, shifted(arrivals, 2001 * SECOND_NS))
    first = next(o.estimate for o in outputs if o.estimate is not None)
    np.testing.assert_allclose(first.state.process_noise, expected[0], rtol=1e-12)
    np.testing.assert_allclose(first.state.measurement_noise, expected[1], rtol=1e-12)
    assert np.all(expected[1][:3] < 0.7 * np.array([0.16, 0.16, 0.25]))


def test_a_clock_that_jumps_twice_keeps_the_adapted_noise() -> None:
    localizer = make_localizer(**WRONG_START)
    moved = shifted(simulated(11, 30.0).arrivals, 2001 * SECOND_NS)
    adapted = noise_of(feed(localizer, moved)[-1])
    localizer.advance(1000 * SECOND_NS)
    localizer.advance(0)
    outputs = feed(localizer, simulated(11, 30.0).arrivals[:400])
    first = next(o.estimate for o in outputs if o.estimate is not None)
    np.testing.assert_array_equal(first.state.measurement_noise, adapted)


def test_a_clock_that_goes_back_and_forth_does_not_lose_the_robot() -> None:
    run = simulated(11, 30.0)
    localizer = make_localizer(adaptation="r")
    half = len(run.arrivals) // 2
    feed(localizer, run.arrivals[:half])
    localizer.advance(run.arrivals[half].now_ns - 1_900_000_000)
    after = feed(localizer, run.arrivals[half:])
    assert time_values(localizer)["restarts"] == "0"
    assert time_values(localizer)["steps back"] == "1"
    last = after[-1].estimate
    assert last is not None
    assert np.linalg.norm(last.state.mean[:2] - run.truth[last.stamp_ns][:2]) < 0.5


def test_a_silence_is_filled_period_by_period() -> None:
    localizer = make_localizer(initial_pose=[0.0, 0.0, 0.0])
    localizer.advance(10 * PERIOD_NS - 1 + 500_000_000)
    outputs = localizer.advance(10 * PERIOD_NS + 100 * SECOND_NS)
    assert [o.stamp_ns for o in outputs] == [
        n * PERIOD_NS for n in range(10, 10 + (100 * SECOND_NS - 500_000_000) // PERIOD_NS + 1)
    ]


@pytest.mark.slow
def test_reset_is_a_new_start() -> None:
    arrivals = simulated(11, 30.0).arrivals
    localizer = make_localizer(**WRONG_START)
    assert noise_of(feed(localizer, arrivals)[-1])[0] < 0.1
    localizer.reset()
    assert status_at_end(localizer, "filter").message.startswith("waiting for the first")
    moved = shifted(arrivals, 30 * SECOND_NS)  # 80 periods
    same_estimates(feed(localizer, moved), feed(make_localizer(**WRONG_START), moved))


@pytest.mark.parametrize("adaptation", ["r", "q", "rq"])
@pytest.mark.slow
def test_without_learning_from_the_start_it_is_the_plain_filter(adaptation: str) -> None:
    arrivals = simulated(11, 30.0).arrivals
    localizer = make_localizer(adaptation=adaptation)
    localizer.enable_adaptation(False)
    plain = feed(make_localizer(adaptation="none"), arrivals)
    same_estimates(feed(localizer, arrivals), plain)
    learning = feed(make_localizer(adaptation=adaptation), arrivals)
    assert learning[-1].estimate is not None
    assert plain[-1].estimate is not None
    assert np.any(learning[-1].estimate.state.mean != plain[-1].estimate.state.mean)


@pytest.mark.slow
def test_learning_can_be_held_and_resumed() -> None:
    arrivals = simulated(11, 40.0).arrivals
    third = len(arrivals) // 3
    localizer = make_localizer(**WRONG_START)
    before = feed(localizer, arrivals[:third])
    localizer.enable_adaptation(False)
    held = feed(localizer, arrivals[third : 2 * third])
    localizer.enable_adaptation(True)
    after = feed(localizer, arrivals[2 * third :])
    for output in held:
        np.testing.assert_array_equal(noise_of(output), noise_of(before[-1]))
    assert np.any(noise_of(after[-1]) != noise_of(held[-1]))


def test_there_is_nothing_to_enable_without_an_adaptation() -> None:
    arrivals = simulated(11, 30.0).arrivals
    localizer = make_localizer(adaptation="none")
    localizer.enable_adaptation(True)
    same_estimates(feed(localizer, arrivals), feed(make_localizer(adaptation="none"), arrivals))


def test_late_data_are_learned_from_as_if_they_had_come_before_the_noise_was_held() -> None:
    arrivals = simulated(11, 30.0).arrivals
    half = len(arrivals) // 2
    now = arrivals[half].now_ns
    event = CompassYaw((now // PERIOD_NS - 3) * PERIOD_NS, 1.0)
    ran = []
    for late in (False, True):
        localizer = make_localizer(**WRONG_START)
        before = [a for a in arrivals[:half] if a.event.stamp_ns != event.stamp_ns]
        if not late:
            before.append(Arrival(event.stamp_ns, event))
            before.sort(key=lambda a: a.now_ns)
        feed(localizer, before)
        localizer.enable_adaptation(False)
        outputs = feed(localizer, [Arrival(now, event)] if late else [])
        ran.append([o for o in outputs + feed(localizer, arrivals[half:]) if o.stamp_ns > now])
    same_estimates(*ran)
    np.testing.assert_array_equal(noise_of(ran[0][0]), noise_of(ran[0][-1]))
