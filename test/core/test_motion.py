# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

import math

import numpy as np
import pytest
from banks import BOTH_MODELS
from hypothesis import given, settings
from hypothesis import strategies as st
from jacobians import motion_jacobian

from fnn_ekf_ros.core.arrays import FloatArray
from fnn_ekf_ros.core.motion import Motion, MotionModel, displacement, move, sinc_and_derivative

PROPERTY = settings(derandomize=True, deadline=None, database=None, max_examples=200)

POSITION = st.floats(min_value=-100.0, max_value=100.0)
HEADING = st.floats(min_value=-math.pi, max_value=math.pi)
WAY = st.floats(min_value=-2.0, max_value=2.0)
TURN = st.one_of(
    st.floats(min_value=-3.0, max_value=3.0), st.floats(min_value=-0.05, max_value=0.05)
)


def step(model: MotionModel, state: list[float], control: list[float]) -> Motion:
    """Take one filter over one step; its dimension is left out of what comes back."""
    motion = move(model, np.array(state)[:, None], np.array(control))
    return Motion(*(part[:, 0] for part in motion))


def moved(model: MotionModel, state: list[float], control: list[float]) -> FloatArray:
    return step(model, state, control).mean


@BOTH_MODELS
@pytest.mark.parametrize("way", [1.5, -1.5, 0.0])
@pytest.mark.parametrize("heading", [0.0, 0.7, -2.4, math.pi])
def test_straight_line(model: MotionModel, way: float, heading: float) -> None:
    end = moved(model, [1.0, -2.0, heading], [way, 0.0])
    expected = [1.0 + way * math.cos(heading), -2.0 + way * math.sin(heading), heading]
    np.testing.assert_allclose(end, expected, rtol=0.0, atol=1e-15)


@BOTH_MODELS
@pytest.mark.parametrize("turn", [0.3, -0.3, 3.0, 7.0])
def test_spin_on_the_spot_moves_nothing(model: MotionModel, turn: float) -> None:
    end = moved(model, [1.0, -2.0, 0.5], [0.0, turn])
    assert end[0] == 1.0
    assert end[1] == -2.0
    assert end[2] == 0.5 + turn


def test_quarter_circle_to_the_left() -> None:
    radius = 2.0
    end = moved(MotionModel.EXACT_ARC, [0.0, 0.0, 0.0], [radius * math.pi / 2.0, math.pi / 2.0])
    np.testing.assert_allclose(end, [radius, radius, math.pi / 2.0], rtol=1e-15)


def test_quarter_circle_to_the_right() -> None:
    end = moved(MotionModel.EXACT_ARC, [1.0, 1.0, math.pi / 2.0], [math.pi, -math.pi / 2.0])
    np.testing.assert_allclose(end, [3.0, 3.0, 0.0], rtol=0.0, atol=1e-15)


def test_half_circle_backwards() -> None:
    end = moved(MotionModel.EXACT_ARC, [0.0, 0.0, 0.0], [-math.pi, math.pi])
    np.testing.assert_allclose(end, [0.0, -2.0, math.pi], rtol=0.0, atol=1e-15)


@pytest.mark.parametrize("heading", [0.0, 1.1, -3.0])
def test_full_circle_comes_back(heading: float) -> None:
    end = moved(MotionModel.EXACT_ARC, [3.0, 4.0, heading], [5.0, 2.0 * math.pi])
    np.testing.assert_allclose(end, [3.0, 4.0, heading + 2.0 * math.pi], rtol=0.0, atol=1e-14)


@pytest.mark.parametrize("turn", [1e-9, 0.015, 0.025, 0.3, -1.7, 4.0, -9.0])
def test_arc_equals_many_small_straight_steps(turn: float) -> None:
    heading, way, pieces = 0.4, 1.3, 20_000
    # A chord's direction is the heading in its middle; the rest is of second order.
    middle = heading + turn * (np.arange(pieces) + 0.5) / pieces
    expected = [
        2.0 + np.sum(np.cos(middle)) * way / pieces,
        -1.0 + np.sum(np.sin(middle)) * way / pieces,
        heading + turn,
    ]
    end = moved(MotionModel.EXACT_ARC, [2.0, -1.0, heading], [way, turn])
    np.testing.assert_allclose(end, expected, rtol=0.0, atol=2e-8)


@PROPERTY
@given(HEADING, WAY, st.floats(min_value=0.05, max_value=6.0), st.booleans())
@pytest.mark.slow
def test_arc_equals_its_radius_form(heading: float, way: float, turn: float, right: bool) -> None:
    turn = -turn if right else turn
    radius = way / turn
    expected_x = radius * (math.sin(heading + turn) - math.sin(heading))
    expected_y = radius * (math.cos(heading) - math.cos(heading + turn))
    end = moved(MotionModel.EXACT_ARC, [0.0, 0.0, heading], [way, turn])
    np.testing.assert_allclose(end[:2], [expected_x, expected_y], rtol=0.0, atol=1e-13)


@PROPERTY
@given(HEADING, WAY, TURN, st.floats(min_value=0.0, max_value=1.0))
@pytest.mark.slow
def test_arc_in_two_pieces_is_the_arc(heading: float, way: float, turn: float, part: float) -> None:
    whole = moved(MotionModel.EXACT_ARC, [1.0, 2.0, heading], [way, turn])
    first = moved(MotionModel.EXACT_ARC, [1.0, 2.0, heading], [part * way, part * turn])
    both = moved(MotionModel.EXACT_ARC, [*first], [(1.0 - part) * way, (1.0 - part) * turn])
    np.testing.assert_allclose(both[:2], whole[:2], rtol=0.0, atol=1e-13)
    assert both[2] == pytest.approx(whole[2], abs=1e-14)


@PROPERTY
@given(POSITION, POSITION, HEADING, WAY, TURN)
@pytest.mark.slow
def test_paper_model_is_equation_4(
    x: float, y: float, heading: float, way: float, turn: float
) -> None:
    end = moved(MotionModel.PAPER, [x, y, heading], [way, turn])
    assert end[0] == pytest.approx(x + way * math.cos(heading + turn), abs=1e-13)
    assert end[1] == pytest.approx(y + way * math.sin(heading + turn), abs=1e-13)
    assert end[2] == heading + turn


def taylor_sinc(h: float) -> float:
    return math.fsum((-1) ** k * h ** (2 * k) / math.factorial(2 * k + 1) for k in range(12))


def taylor_sinc_derivative(h: float) -> float:
    return math.fsum(
        (-1) ** k * 2 * k * h ** (2 * k - 1) / math.factorial(2 * k + 1) for k in range(1, 12)
    )


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_sinc_and_its_derivative_on_both_sides_of_the_series_limit(sign: float) -> None:
    half_angles = np.concatenate([np.geomspace(1e-12, 1.0, 4001), np.linspace(9e-3, 1.1e-2, 201)])
    for h in sign * half_angles:
        value, slope = map(float, sinc_and_derivative(h))
        assert value == pytest.approx(taylor_sinc(h), rel=1e-15, abs=2.3e-16)
        assert slope == pytest.approx(taylor_sinc_derivative(h), rel=1e-11, abs=0.0)


def test_series_of_small_half_angles_are_exact() -> None:
    """Well below any switch to the closed forms, nothing may be lost to the powers left out."""
    for h in np.geomspace(1e-6, 9e-3, 201):
        value, slope = map(float, sinc_and_derivative(h))
        assert value == pytest.approx(taylor_sinc(h), rel=2.3e-16, abs=0.0)
        assert slope == pytest.approx(taylor_sinc_derivative(h), rel=1e-15, abs=0.0)


def test_sinc_at_zero_and_at_half_turns() -> None:
    h = np.array([0.0, -0.0, 5e-324, math.pi / 2.0, math.pi])
    value, slope = sinc_and_derivative(h)
    np.testing.assert_allclose(value, [1.0, 1.0, 1.0, 2.0 / math.pi, 0.0], atol=1e-16)
    expected = [0.0, 0.0, 0.0, -4.0 / math.pi**2, -1.0 / math.pi]
    np.testing.assert_allclose(slope, expected, rtol=1e-15)


@pytest.mark.parametrize("edge", [0.0, 0.01, 0.02, -0.01, -0.02])
def test_step_is_continuous_in_small_rotations(edge: float) -> None:
    """Two turns 2e-13 apart, either side of any switch between formulas, differ as little."""
    below = step(MotionModel.EXACT_ARC, [1.0, 2.0, 0.6], [1.0, edge - 1e-13])
    above = step(MotionModel.EXACT_ARC, [1.0, 2.0, 0.6], [1.0, edge + 1e-13])
    for one, other in zip(below, above, strict=True):
        np.testing.assert_allclose(one, other, rtol=0.0, atol=1e-12)


@BOTH_MODELS
def test_small_rotation_goes_over_into_the_straight_line(model: MotionModel) -> None:
    straight = step(model, [1.0, 2.0, 0.6], [1.0, 0.0])
    for turn in (1e-13, -1e-13, 1e-200, 5e-324):
        tiny = step(model, [1.0, 2.0, 0.6], [1.0, turn])
        for one, other in zip(tiny, straight, strict=True):
            assert np.all(np.isfinite(one))
            np.testing.assert_allclose(one, other, rtol=0.0, atol=1e-12)


@BOTH_MODELS
@PROPERTY
@given(POSITION, POSITION, HEADING, WAY, TURN)
@pytest.mark.slow
def test_jacobians_equal_central_differences(
    model: MotionModel, x: float, y: float, heading: float, way: float, turn: float
) -> None:
    state, control, h = np.array([x, y, heading]), np.array([way, turn]), 1e-5
    motion = step(model, [*state], [*control])

    def slope(state_step: FloatArray, control_step: FloatArray) -> FloatArray:
        ahead = moved(model, [*(state + state_step)], [*(control + control_step)])
        behind = moved(model, [*(state - state_step)], [*(control - control_step)])
        return (ahead - behind) / (2.0 * h)

    for column in range(3):
        numeric = slope(h * np.eye(3)[column], np.zeros(2))
        np.testing.assert_allclose(motion_jacobian(motion)[:, column], numeric, atol=1e-8, rtol=0)
    for column in range(2):
        numeric = slope(np.zeros(3), h * np.eye(2)[column])
        np.testing.assert_allclose(motion.noise_jacobian()[:, column], numeric, atol=1e-8, rtol=0)


@pytest.mark.parametrize("heading", [0.0, 2.0, -1.0])
@pytest.mark.parametrize("turn", [0.1125, -0.05, 0.01])
def test_paper_model_is_off_sideways_by_half_way_times_turn(heading: float, turn: float) -> None:
    way = 0.1125
    arc = displacement(MotionModel.EXACT_ARC, np.array(heading), np.array([way, turn]))
    paper = displacement(MotionModel.PAPER, np.array(heading), np.array([way, turn]))
    off = paper - arc
    ahead = off[0] * math.cos(heading) + off[1] * math.sin(heading)
    left = -off[0] * math.sin(heading) + off[1] * math.cos(heading)
    assert left == pytest.approx(way * turn / 2.0, rel=0.01)
    assert abs(ahead) < way * turn**2
    assert off[2] == 0.0


def test_paper_model_is_off_by_6_mm_in_an_ordinary_turn() -> None:
    # 0.3 m/s and 0.3 rad/s over 375 ms.
    control = np.array([0.1125, 0.1125])
    arc = displacement(MotionModel.EXACT_ARC, np.array(0.0), control)
    paper = displacement(MotionModel.PAPER, np.array(0.0), control)
    assert paper[1] - arc[1] == pytest.approx(6.3e-3, abs=0.1e-3)


@BOTH_MODELS
@PROPERTY
@given(POSITION, POSITION, HEADING, WAY, TURN)
@pytest.mark.slow
def test_displacement_is_what_move_adds(
    model: MotionModel, x: float, y: float, heading: float, way: float, turn: float
) -> None:
    state, control = np.array([x, y, heading]), np.array([way, turn])
    added = displacement(model, state[2], control)
    end = moved(model, [*state], [*control])
    np.testing.assert_allclose(end[:2], state[:2] + added[:2], rtol=0.0, atol=3e-14)
    assert added[2] == turn
    assert end[2] == heading + turn


@BOTH_MODELS
def test_heading_is_not_wrapped(model: MotionModel) -> None:
    """Which filters wrap once, after the readings: a step says what it adds."""
    assert moved(model, [0.0, 0.0, 3.1], [0.0, 0.2])[2] == 3.1 + 0.2
    assert moved(model, [0.0, 0.0, -3.1], [0.0, -0.2])[2] == -3.1 - 0.2
    np.testing.assert_array_equal(
        displacement(model, np.array(3.1), np.array([0.0, 7.0])), [0.0, 0.0, 7.0]
    )


@BOTH_MODELS
@pytest.mark.parametrize(("filters", "batch"), [(1, ()), (5, ()), (3, (4,)), (2, (3, 4))])
def test_batches_equal_one_by_one(model: MotionModel, filters: int, batch: tuple[int, ...]) -> None:
    """Filters stand before the batch: all of them drive as their robot's wheels say."""
    rng = np.random.default_rng(3)
    states = rng.uniform(-3.0, 3.0, (3, filters, *batch))
    controls = np.moveaxis(rng.uniform(-1.0, 1.0, (*batch, 2)) * [1.0, 0.03], -1, 0)
    together = move(model, states, controls)
    assert together.mean.shape == (3, filters, *batch)
    assert motion_jacobian(together).shape == (3, 3, filters, *batch)
    assert together.noise_jacobian().shape == (3, 2, filters, *batch)
    added = displacement(model, states[2], controls)
    assert added.shape == (3, filters, *batch)
    for index in np.ndindex(filters, *batch):
        state, control = states[:, *index], controls[:, *index[1:]]
        alone = step(model, [*state], [*control])
        for one, other in zip(together, alone, strict=True):
            np.testing.assert_allclose(one[:, *index], other, rtol=0.0, atol=1e-15)
        np.testing.assert_allclose(
            added[:, *index], displacement(model, state[2], control), atol=1e-15
        )


def test_move_changes_none_of_its_arguments() -> None:
    state, control = np.array([[1.0], [2.0], [3.0]]), np.array([0.3, 0.1])
    state.flags.writeable = control.flags.writeable = False
    for model in MotionModel:
        move(model, state, control)
        displacement(model, state[2], control)
