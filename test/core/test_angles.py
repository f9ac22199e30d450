# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fnn_ekf_ros.core.angles import wrap_angle

PROPERTY = settings(derandomize=True, deadline=None, database=None, max_examples=300)


@pytest.mark.parametrize(
    ("angle", "expected"),
    [
        (0.0, 0.0),
        (math.pi, math.pi),
        (-math.pi, math.pi),
        (3.0 * math.pi, math.pi),
        (-3.0 * math.pi, math.pi),
        (2.0 * math.pi, 0.0),
        (-2.0 * math.pi, 0.0),
        (1.5 * math.pi, -0.5 * math.pi),
        (-1.5 * math.pi, 0.5 * math.pi),
        (7.0, 7.0 - 2.0 * math.pi),
        (-100.0, -100.0 + 32.0 * math.pi),
    ],
)
def test_known_angles(angle: float, expected: float) -> None:
    assert float(wrap_angle(angle)) == pytest.approx(expected, abs=1e-13)


def test_minus_pi_is_pi_itself() -> None:
    assert float(wrap_angle(-math.pi)) == math.pi
    assert float(wrap_angle(math.pi)) == math.pi


def test_no_neighbor_of_a_half_turn_leaves_the_interval() -> None:
    for turns in range(-9, 10):
        angle = turns * math.pi
        neighbors = angle + np.arange(-4, 5) * np.spacing(abs(angle))
        for neighbor in neighbors:
            assert -math.pi < float(wrap_angle(neighbor)) <= math.pi, repr(neighbor)


@PROPERTY
@given(st.floats(min_value=math.nextafter(-math.pi, 0.0), max_value=math.pi))
@pytest.mark.slow
def test_angle_inside_keeps_every_bit(angle: float) -> None:
    assert np.float64(wrap_angle(angle)).tobytes() == np.float64(angle).tobytes()


@PROPERTY
@given(st.floats(min_value=-1e6, max_value=1e6))
@pytest.mark.slow
def test_wrapped_angle_is_inside_and_points_the_same_way(angle: float) -> None:
    wrapped = float(wrap_angle(angle))
    assert -math.pi <= wrapped <= math.pi
    assert math.cos(wrapped) == pytest.approx(math.cos(angle), abs=1e-9)
    assert math.sin(wrapped) == pytest.approx(math.sin(angle), abs=1e-9)


@PROPERTY
@given(st.floats(min_value=-1e6, max_value=1e6))
@pytest.mark.slow
def test_wrapping_twice_changes_nothing(angle: float) -> None:
    once = wrap_angle(angle)
    assert wrap_angle(once).tobytes() == once.tobytes() or abs(float(once)) == math.pi


@PROPERTY
@given(st.floats(min_value=-3.1, max_value=3.1), st.integers(min_value=-1000, max_value=1000))
@pytest.mark.slow
def test_whole_turns_do_not_matter(angle: float, turns: int) -> None:
    assert float(wrap_angle(angle + turns * 2.0 * math.pi)) == pytest.approx(angle, abs=1e-11)


@PROPERTY
@given(st.floats(min_value=-1e300, max_value=1e300))
@pytest.mark.slow
def test_huge_angle_stays_inside_and_is_as_right_as_its_last_digit(angle: float) -> None:
    wrapped = float(wrap_angle(angle))
    assert -math.pi <= wrapped <= math.pi
    exact = math.remainder(angle, 2.0 * math.pi)
    apart = abs(math.remainder(wrapped - exact, 2.0 * math.pi))
    assert apart <= 2.0 * float(np.spacing(abs(angle))) + 1e-15


def test_arrays_keep_their_shape_and_each_entry_is_wrapped_alone() -> None:
    angles = np.linspace(-20.0, 20.0, 24).reshape(2, 3, 4)
    wrapped = wrap_angle(angles)
    assert wrapped.shape == angles.shape
    assert wrapped.dtype == np.float64
    for index in np.ndindex(*angles.shape):
        assert wrapped[index] == wrap_angle(angles[index])


def test_angle_inside_keeps_every_bit_beside_others_that_are_wrapped() -> None:
    """Or the same robot would come out differently in another batch."""
    rng = np.random.default_rng(1)
    inside = rng.uniform(-math.pi, math.pi, 500) * 10.0 ** rng.uniform(-12.0, 0.0, 500)
    angles = np.stack([inside, inside + 2.0 * math.pi])
    angles[1, 0] = -math.pi
    given = angles.copy()
    wrapped = wrap_angle(angles)
    assert wrapped[0].tobytes() == inside.tobytes()
    assert wrapped[1, 0] == math.pi
    assert angles.tobytes() == given.tobytes()
    assert wrap_angle(inside).tobytes() == inside.tobytes()
