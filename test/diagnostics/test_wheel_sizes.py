# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Wheels of another size than they should have, seen by corrections that lean."""

import numpy as np
import pytest
from localizers import PERIOD_NS

from fnn_ekf_ros.core.arrays import FloatArray
from fnn_ekf_ros.diagnostics.fault_isolation import CLEARED_LEAD, isolate_fault
from fnn_ekf_ros.diagnostics.recent_periods import Leads, RecentPeriods, SensorReadings
from fnn_ekf_ros.diagnostics.wheel_sizes import (
    LOOK_BACK_S,
    SMALLEST_PART,
    PeriodCorrection,
    WheelSizes,
    estimate_sizes,
    size_messages,
    size_values,
    with_correction,
)
from fnn_ekf_ros.timeline.events import Sensor

SEPARATION = 0.6
COUNT = round(LOOK_BACK_S * 1e9 / PERIOD_NS) + 1
DISTANCE_STD, ROTATION_STD = 0.02, 0.02


def corrections(
    left: float = 0.0,
    right: float = 0.0,
    *,
    seed: int = 0,
    distance_off: FloatArray | float = 0.0,
    rotation_off: FloatArray | float = 0.0,
) -> tuple[PeriodCorrection, ...]:
    """Return what a filter that follows compass and fixes would see of wheels of such sizes."""
    rng = np.random.default_rng(seed)
    rotation = 0.08 * np.sin(0.2 * np.arange(COUNT)) + 0.02
    distance = np.full(COUNT, 0.11)
    by_left, by_right = (
        distance - 0.5 * SEPARATION * rotation,
        distance + 0.5 * SEPARATION * rotation,
    )
    turned = (
        (left * by_left - right * by_right) / SEPARATION
        + rng.normal(0.0, ROTATION_STD, COUNT)
        + rotation_off
    )
    moved = (
        -0.5 * (left * by_left + right * by_right)
        + rng.normal(0.0, DISTANCE_STD, COUNT)
        + distance_off
    )
    return tuple(
        PeriodCorrection(
            index * PERIOD_NS, float(distance[index]), float(rotation[index]), float(moved[index]),
            float(turned[index]), DISTANCE_STD**2, ROTATION_STD**2, 1e-3, 1e-3,
        )
        for index in range(COUNT)
    )  # fmt: skip


def sizes(seen: tuple[PeriodCorrection, ...]) -> WheelSizes:
    found = estimate_sizes(seen, SEPARATION)
    assert found is not None
    return found


@pytest.mark.parametrize(("left", "right"), [(0.2, 0.0), (0.0, 0.2), (-0.25, 0.0)])
def test_a_wheel_of_another_size_is_seen_and_measured(left: float, right: float) -> None:
    for seed in range(5):
        found = sizes(corrections(left, right, seed=seed))
        assert found.wrong
        assert (found.left, found.right) == pytest.approx((left, right), abs=0.1)


def test_right_wheels_are_not_named() -> None:
    """A chi-square variable of two degrees of freedom has the mean 2."""
    found = [sizes(corrections(seed=seed)) for seed in range(300)]
    assert not any(each.wrong for each in found)
    assert np.mean([each.sigmas**2 for each in found]) == pytest.approx(2.0, abs=0.4)


def test_a_size_that_is_clear_but_hardly_off_is_nothing_to_tell() -> None:
    found = sizes(corrections(0.2))._replace(left=0.9 * SMALLEST_PART, right=0.0)
    assert not found.wrong


def test_what_happened_once_is_no_size() -> None:
    jump = np.zeros(COUNT)
    jump[COUNT // 4] = -1.0
    found = sizes(corrections(rotation_off=jump))
    assert found.sigmas > 5.0
    assert not found.wrong


def test_a_distance_that_leans_without_the_rotation_is_no_wheel_and_neither_is_the_reverse() -> (
    None
):
    for off in ({"distance_off": -0.03}, {"rotation_off": -0.08}):
        for seed in range(5):
            found = sizes(corrections(seed=seed, **off))
            assert found.sigmas > 5.0
            assert not found.wrong


def test_noise_that_was_learned_from_the_lean_does_not_hide_it() -> None:
    learned = tuple(
        step._replace(rotation_noise=25.0 * step.rotation_noise) if index > 5 else step
        for index, step in enumerate(corrections(0.2))
    )
    assert sizes(learned) == sizes(corrections(0.2))


def test_nothing_is_said_before_the_time_is_over_and_nothing_older_is_kept() -> None:
    kept: tuple[PeriodCorrection, ...] = ()
    for index, step in enumerate(corrections() + corrections()):
        kept = with_correction(kept, step._replace(stamp_ns=index * PERIOD_NS))
        assert (estimate_sizes(kept, SEPARATION) is None) == (index < COUNT - 1)
        assert len(kept) == min(index + 1, COUNT)


def test_a_robot_at_rest_has_no_sizes() -> None:
    resting = tuple(
        step._replace(distance=0.0, rotation=0.0, distance_correction=0.5, rotation_correction=0.5)
        for step in corrections()
    )
    assert not sizes(resting).wrong


def test_wheels_are_named_unless_another_sensor_is_suspected() -> None:
    nobody = (Leads(0, (0.0, 0.0, 0.0)),)
    seen = RecentPeriods(SensorReadings(), 0, 0, 0, leads=nobody, corrections=corrections(0.2))
    found = isolate_fault(seen, SEPARATION)
    assert found.named is Sensor.ENCODERS
    assert found.sizes is not None
    (message,) = size_messages(found.sizes)
    assert message == (
        "disagree with the other sensors: the left wheel travels less than it counts"
    )
    for leads in ((0.0, CLEARED_LEAD, 0.0), (0.0, 0.0, CLEARED_LEAD)):
        suspected = seen._replace(leads=(Leads(0, leads),))
        assert isolate_fault(suspected, SEPARATION).named is None


def test_sizes_are_told_in_parts_of_the_distance() -> None:
    sizes = WheelSizes(0.2, -0.1, 9.0, 9.0, 9.0)
    assert size_messages(sizes) == [
        "disagree with the other sensors: the left wheel travels less than it counts",
        "disagree with the other sensors: the right wheel travels more than it counts",
    ]
    assert [value for _, value in size_values(sizes)] == ["-20", "+10"]
