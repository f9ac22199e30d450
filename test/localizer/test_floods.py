# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Floods of messages: memory and work for each stay bounded, whatever comes; nothing is timed."""

from itertools import permutations

import numpy as np
import pytest
from localizers import SECOND_NS, make_localizer, make_parameters, status_at_end

from fnn_ekf_ros.timeline.events import CompassYaw, PoseFix, Wheel, WheelCount
from fnn_ekf_ros.timeline.inputs import MOST_AT_ONCE, InputBuffer
from fnn_ekf_ros.timeline.wheels import MOST_KEPT, UnwrappedWheel

NOW_NS = 10 * SECOND_NS
POSE = {"initial_pose": [0.0, 0.0, 0.0]}


def kept(buffer: InputBuffer) -> int:
    """Return how many readings are kept of the sensor or wheel with the most."""
    queues = buffer._compass, buffer._fixes, buffer._resets, *buffer._wheels.values()
    return max(len(queue._stamps) for queue in queues)


def fix(stamp_ns: int, x: float) -> PoseFix:
    return PoseFix(stamp_ns, np.array([x, 0.0, 0.0]), np.eye(3))


def counting(comparisons: list[int]) -> type[float]:
    """Return a number that counts how often it is compared."""

    class Counted(float):
        def __lt__(self, other: float) -> bool:
            comparisons[0] += 1
            return float.__lt__(self, other)

        def __eq__(self, other: object) -> bool:
            comparisons[0] += 1
            return float.__eq__(self, other)

        __hash__ = float.__hash__

    return Counted


def test_many_readings_of_one_stamp_cost_a_bounded_number_of_comparisons_each() -> None:
    comparisons = [0]
    number = counting(comparisons)
    buffer = InputBuffer(make_parameters())
    rng = np.random.default_rng(1)
    for _ in range(20 * MOST_AT_ONCE):
        buffer.add(CompassYaw(NOW_NS, number(rng.normal())))
    assert comparisons[0] / (20 * MOST_AT_ONCE) < 4.0 * np.log2(MOST_AT_ONCE)
    assert kept(buffer) == MOST_AT_ONCE


def test_which_readings_of_one_stamp_are_kept_does_not_depend_on_their_order() -> None:
    yaws = np.random.default_rng(2).normal(size=3 * MOST_AT_ONCE)
    found = []
    for seed in range(3):
        buffer = InputBuffer(make_parameters())
        for yaw in np.random.default_rng(seed).permutation(yaws):
            buffer.add(CompassYaw(NOW_NS, float(yaw)))
        inputs = buffer.period(NOW_NS - SECOND_NS, NOW_NS, buffer.counts_at(NOW_NS))
        found.append([epoch.measurement.tolist() for epoch in inputs.epochs])
    assert found[0] == found[1] == found[2]


def test_readings_that_are_left_out_are_reported() -> None:
    localizer = make_localizer(**POSE)
    for place in range(MOST_AT_ONCE + 7):
        localizer.add(fix(NOW_NS, float(place)), NOW_NS)
    status = status_at_end(localizer, "lrf_pose")
    assert status.message == "too fast: some readings are left out"
    assert dict(status.values)["left out"] == "7"


@pytest.mark.parametrize("source", ["ticks", "joint_states"])
def test_nothing_grows_while_the_clock_stands_still(source: str) -> None:
    """As in a simulation that is paused, but whose drivers go on."""
    localizer = make_localizer(encoder_source=source, **POSE)
    localizer.advance(NOW_NS)
    most = 0
    for place in range(2 * MOST_KEPT + 100):
        # Ticks arrive at the time of the clock; all other stamps may differ.
        stamp_ns = NOW_NS if source == "ticks" else NOW_NS + place
        localizer.add(WheelCount(stamp_ns, Wheel.LEFT, place % 5), NOW_NS)
        localizer.add(CompassYaw(NOW_NS + place, 0.1), NOW_NS)
        most = max(most, kept(localizer._history.inputs)) if place % 1000 == 0 else most
    assert most <= MOST_KEPT


def test_all_counts_of_one_arrival_time_are_counted_and_two_are_kept() -> None:
    """The first one ends the ramp from the reading before, the last one begins the next ramp."""
    wheel = UnwrappedWheel(2**16, stamped=False, fastest=1e5, resolution=1.0)
    wheel.add(NOW_NS, 0)
    for place in range(100):
        wheel.add(NOW_NS + SECOND_NS, 10 + place)
    wheel.add(NOW_NS + 2 * SECOND_NS, 209)
    assert wheel.at(NOW_NS + SECOND_NS // 2) == 5.0
    assert wheel.at(NOW_NS + SECOND_NS) == 109.0
    assert wheel.at(NOW_NS + 3 * SECOND_NS // 2) == 159.0
    assert len(wheel._stamps) == 4


def test_of_positions_with_one_stamp_the_smallest_and_the_greatest_are_kept_in_any_order() -> None:
    found = set()
    for order in permutations([1.0, 1.1, 1.05, 0.95]):
        wheel = UnwrappedWheel(None, stamped=True, fastest=10.0, resolution=0.0)
        wheel.add(NOW_NS, 0.5)
        for reading in order:
            wheel.add(NOW_NS + SECOND_NS, reading)
        wheel.add(NOW_NS + 2 * SECOND_NS, 2.2)
        assert len(wheel._stamps) == 4
        found.add(tuple(wheel.at(NOW_NS + part * SECOND_NS // 4) for part in range(1, 8)))
    assert len(found) == 1
    assert found.pop()[3] == 1.1


def test_a_flood_of_fast_counts_keeps_the_way() -> None:
    """More readings than are kept: every other one goes, and the way between them is the same."""
    wheel = UnwrappedWheel(2**31, stamped=False, fastest=1e6, resolution=1.0)
    for place in range(MOST_KEPT + 10):
        wheel.add(NOW_NS + 1000 * place, place)
    assert len(wheel._stamps) <= MOST_KEPT // 2 + 20
    for place in (1, 2, 1001, MOST_KEPT, MOST_KEPT + 9):
        assert wheel.at(NOW_NS + 1000 * place) == pytest.approx(place)
