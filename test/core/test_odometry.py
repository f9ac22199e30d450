# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

import math

import numpy as np
import pytest

from fnn_ekf_ros.core.odometry import WheelGeometry, control_from_counts

# The paper's robot: D = 0.05 m, L = 0.6 m, n = 1, C_e = 500.
PAPER = WheelGeometry(
    wheel_radius=0.025, wheel_separation=0.6, gear_ratio=1.0, encoder_counts_per_revolution=500.0
)


def test_meters_per_count_of_the_paper() -> None:
    # pi * 0.05 m / 500 = 0.157079632679 m / 500
    assert PAPER.meters_per_count == pytest.approx(3.14159265358979e-4, rel=1e-14)


def test_one_wheel_turn_is_the_circumference() -> None:
    assert 500.0 * PAPER.meters_per_count == pytest.approx(math.pi * 0.05, rel=1e-15)


def test_gear_ratio_counts_encoder_turns_per_wheel_turn() -> None:
    geared = WheelGeometry(0.025, 0.6, 20.0, 500.0)
    assert geared.meters_per_count == pytest.approx(PAPER.meters_per_count / 20.0, rel=1e-15)


@pytest.mark.parametrize(
    ("left", "right", "way", "turn"),
    [
        # 200 counts on average: 200 * 3.14159e-4 m; 200 counts apart: 0.0628319 m / 0.6 m
        (100.0, 300.0, 0.0628318530717959, 0.104719755119660),
        (300.0, 100.0, 0.0628318530717959, -0.104719755119660),
        (500.0, 500.0, 0.157079632679490, 0.0),
        (-500.0, -500.0, -0.157079632679490, 0.0),
        # On the spot: half the wheels' difference of 0.6 m * pi / 2 each way is a quarter turn.
        (-1500.0, 1500.0, 0.0, 1.57079632679490),
        (0.0, 0.5, 7.85398163397448e-5, 2.61799387799149e-4),
        (0.0, 0.0, 0.0, 0.0),
    ],
)
def test_counts_by_hand(left: float, right: float, way: float, turn: float) -> None:
    control = control_from_counts(PAPER, left, right)
    assert control.shape == (2,)
    np.testing.assert_allclose(control, [way, turn], rtol=1e-13, atol=1e-17)


def test_right_wheel_ahead_turns_left() -> None:
    assert control_from_counts(PAPER, 0.0, 10.0)[1] > 0.0


def test_batches_equal_one_by_one() -> None:
    rng = np.random.default_rng(1)
    left, right = rng.integers(-1000, 1000, (2, 3, 4)).astype(np.float64)
    control = control_from_counts(PAPER, left, right)
    assert control.shape == (2, 3, 4)
    for index in np.ndindex(3, 4):
        np.testing.assert_array_equal(
            control[:, *index],
            control_from_counts(PAPER, float(left[index]), float(right[index])),
        )
