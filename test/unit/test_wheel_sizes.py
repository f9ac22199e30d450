"""Wheels of another size than they should have, seen by corrections that lean."""

import numpy as np
import pytest

from fnn_ekf_ros.core.arrays import FloatArray
from fnn_ekf_ros.pipeline.blame import CLEARED_LEAD, blame
from fnn_ekf_ros.pipeline.events import Sensor
from fnn_ekf_ros.pipeline.watch import Leads, Readings, Watch
from fnn_ekf_ros.pipeline.wheel_sizes import (
    LOOK_BACK_S,
    SMALLEST_PART,
    Sizes,
    Step,
    in_words,
    recent,
    seen_sizes,
)

SEPARATION = 0.6
PERIOD_NS = 375_000_000
COUNT = round(LOOK_BACK_S * 1e9 / PERIOD_NS) + 1
WAY_STD, TURN_STD = 0.02, 0.02


def steps(
    left: float = 0.0,
    right: float = 0.0,
    *,
    seed: int = 0,
    way_off: FloatArray | float = 0.0,
    turn_off: FloatArray | float = 0.0,
) -> tuple[Step, ...]:
    """Return what a filter that follows compass and fixes would see of wheels of such sizes."""
    rng = np.random.default_rng(seed)
    turn = 0.08 * np.sin(0.2 * np.arange(COUNT)) + 0.02
    way = np.full(COUNT, 0.11)
    by_left, by_right = way - 0.5 * SEPARATION * turn, way + 0.5 * SEPARATION * turn
    turned = (
        (left * by_left - right * by_right) / SEPARATION
        + rng.normal(0.0, TURN_STD, COUNT)
        + turn_off
    )
    moved = -0.5 * (left * by_left + right * by_right) + rng.normal(0.0, WAY_STD, COUNT) + way_off
    return tuple(
        Step(
            index * PERIOD_NS, float(way[index]), float(turn[index]), float(moved[index]),
            float(turned[index]), WAY_STD**2, TURN_STD**2, 1e-3, 1e-3,
        )
        for index in range(COUNT)
    )  # fmt: skip


def sizes(seen: tuple[Step, ...]) -> Sizes:
    found = seen_sizes(seen, SEPARATION)
    assert found is not None
    return found


@pytest.mark.parametrize(("left", "right"), [(0.2, 0.0), (0.0, 0.2), (-0.25, 0.0)])
def test_a_wheel_of_another_size_is_seen_and_measured(left: float, right: float) -> None:
    for seed in range(5):
        found = sizes(steps(left, right, seed=seed))
        assert found.wrong
        assert (found.left, found.right) == pytest.approx((left, right), abs=0.1)


def test_right_wheels_are_not_accused() -> None:
    """A chi-square variable of two degrees of freedom has the mean 2."""
    found = [sizes(steps(seed=seed)) for seed in range(300)]
    assert not any(each.wrong for each in found)
    assert np.mean([each.sigmas**2 for each in found]) == pytest.approx(2.0, abs=0.4)


def test_a_size_that_is_clear_but_hardly_off_is_nothing_to_tell() -> None:
    found = sizes(steps(0.2))._replace(left=0.9 * SMALLEST_PART, right=0.0)
    assert not found.wrong


def test_what_happened_once_is_no_size() -> None:
    jump = np.zeros(COUNT)
    jump[COUNT // 4] = -1.0
    found = sizes(steps(turn_off=jump))
    assert found.sigmas > 5.0
    assert not found.wrong


def test_a_way_that_leans_without_the_turn_is_no_wheel_and_neither_is_the_reverse() -> None:
    for off in ({"way_off": -0.03}, {"turn_off": -0.08}):
        for seed in range(5):
            found = sizes(steps(seed=seed, **off))
            assert found.sigmas > 5.0
            assert not found.wrong


def test_noise_that_was_learned_from_the_lean_does_not_hide_it() -> None:
    learned = tuple(
        step._replace(turn_noise=25.0 * step.turn_noise) if index > 5 else step
        for index, step in enumerate(steps(0.2))
    )
    assert sizes(learned) == sizes(steps(0.2))


def test_nothing_is_said_before_the_time_is_over_and_nothing_older_is_kept() -> None:
    kept: tuple[Step, ...] = ()
    for index, step in enumerate(steps() + steps()):
        kept = recent(kept, step._replace(stamp_ns=index * PERIOD_NS))
        assert (seen_sizes(kept, SEPARATION) is None) == (index < COUNT - 1)
        assert len(kept) == min(index + 1, COUNT)


def test_a_robot_at_rest_has_no_sizes() -> None:
    resting = tuple(
        step._replace(way=0.0, turn=0.0, way_correction=0.5, turn_correction=0.5)
        for step in steps()
    )
    assert not sizes(resting).wrong


def test_wheels_are_blamed_unless_another_sensor_is_suspected() -> None:
    nobody = (Leads(0, (0.0, 0.0, 0.0)),)
    seen = Watch((Readings(), Readings()), 0, 0, leads=nobody, steps=steps(0.2))
    found = blame(seen, SEPARATION)
    assert found.culprit is Sensor.ENCODERS
    assert found.sizes is not None
    assert in_words(found.sizes).startswith("the left wheel goes ")
    for leads in ((0.0, CLEARED_LEAD, 0.0), (0.0, 0.0, CLEARED_LEAD)):
        suspected = seen._replace(leads=(Leads(0, leads),))
        assert blame(suspected, SEPARATION).culprit is None


def test_sizes_are_told_in_parts_of_the_way() -> None:
    assert in_words(Sizes(0.2, -0.1, 9.0, 9.0, 9.0)) == (
        "the left wheel goes 20% less than it counts and the right wheel goes 10% more than it "
        "counts"
    )
