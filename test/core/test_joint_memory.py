# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Memory of the joint learners: how fast what was learned fades."""

import math
from collections.abc import Callable

import numpy as np
import pytest
from drives import drive, fused, start_of
from periods import FIX, FIX_AND_COMPASS, ONLY_COMPASS, bytes_of

from fnn_ekf_ros.core.arrays import BoolArray, FloatArray
from fnn_ekf_ros.core.joint import LONGEST_MEMORY, MEMORY_GROWTH, Lesson, learn
from fnn_ekf_ros.core.joint_filters import JOINT_COUNT
from fnn_ekf_ros.core.joint_state import (
    PRIOR_INFORMATION,
    SHORTEST_MEMORY,
    JointState,
    fading,
    start_joint,
)
from fnn_ekf_ros.core.rows import rows_where
from fnn_ekf_ros.core.state import FilterModel


def nothing_new(scored: BoolArray, teaches: BoolArray, since_scored: float) -> Lesson:
    """Return readings of which all filters are equally right: they inform of nothing."""
    none = np.zeros((4, JOINT_COUNT))
    since = np.asarray(since_scored)
    return Lesson(none, none + 1.0, none[0], rows_where(teaches), rows_where(scored), since)


def after_lessons(
    model: FilterModel,
    state: JointState,
    plan: list[tuple[float, BoolArray]],
    teaches: BoolArray | None = None,
) -> JointState:
    """Return the state after such readings, each some nominal periods after the one before.

    Args:
        model: the filter.
        state: before them.
        plan: the time before each [nominal periods], and the rows that are scored.
        teaches: `(4,)` the rows that the gate lets teach; None for all.
    """
    sets, bounds = model.adaptation.networks.joint.sets, model.adaptation.bounds
    for elapsed, scored in plan:
        state = fading(state, elapsed * np.array([0.1, 0.1]), elapsed)
        lesson = nothing_new(scored, scored if teaches is None else scored & teaches, elapsed)
        state = learn(state, sets, bounds, lesson, learning=True).state
    return state


@pytest.fixture
def known(model_of: Callable[..., FilterModel]) -> tuple[FilterModel, JointState]:
    """A learner that knows much."""
    model = model_of("joint")
    start = start_joint(np.array(model.process_noise), np.array(model.measurement_noise))
    root = np.random.default_rng(121).standard_normal((4, 4, 2))
    much = np.einsum("ik...,jk...->ij...", root, root) + 5.0 * np.eye(4)[..., None]
    information = start.information + 10.0 * much
    return model, start._replace(information=information, forecast_count=np.array(2.0))


def left(before: JointState, after: JointState) -> FloatArray:
    """Return which part of what was learned is left, `(4, 4, 2)`."""
    prior = PRIOR_INFORMATION[..., None]
    part: FloatArray = (after.information - prior) / (before.information - prior)
    return part


def faded(counts: list[float]) -> tuple[FloatArray, FloatArray]:
    """Return which part of what was learned is left `(2,)`, and N `(2,)`.

    Args:
        counts: for how much of a reading each reading counts.
    """
    N, part = np.full(2, SHORTEST_MEMORY), np.ones(2)
    for count in counts:
        part = part * (1.0 - count / N)
        N = np.minimum(N + MEMORY_GROWTH * count, LONGEST_MEMORY)
    return part, N


def test_each_scale_fades_with_the_readings_that_inform_it(
    known: tuple[FilterModel, JointState],
) -> None:
    """A compass alone leaves what is known of the fixes' noise and of the way's as it is."""
    model, before = known
    for rows, informed in (
        (ONLY_COMPASS, [False, True, False, True]),
        (np.array([False, False, False, True]), [False, True, False, True]),
        (FIX, [True, True, True, False]),
        (FIX_AND_COMPASS, [True] * 4),
    ):
        part, N = faded([1.0] * 30)
        after = after_lessons(model, before, [(1.0, rows)] * 30)
        each = np.where(np.array(informed)[:, None], np.sqrt(part), 1.0)
        np.testing.assert_allclose(left(before, after), each[:, None] * each[None], rtol=1e-9)
        memory = np.where(np.array(informed)[:, None], N, SHORTEST_MEMORY)
        np.testing.assert_allclose(after.memory, memory, rtol=1e-12)


def test_rejected_readings_fade_a_scale_as_those_that_teach_do(
    known: tuple[FilterModel, JointState],
) -> None:
    """Memory is counted in the readings of a sensor, whatever the gate says about them."""
    model, before = known
    everything_teaches = after_lessons(model, before, [(1.0, FIX_AND_COMPASS)] * 30)
    compass_teaches = after_lessons(
        model, before, [(1.0, FIX_AND_COMPASS)] * 30, teaches=ONLY_COMPASS
    )
    assert bytes_of(compass_teaches) == bytes_of(everything_teaches)


@pytest.mark.parametrize("parts", [2, 5, 19])
def test_readings_that_come_fast_make_a_scale_fade_by_the_root_of_the_time(
    known: tuple[FilterModel, JointState], parts: int
) -> None:
    """One that follows the last one after a part p of a nominal period counts for sqrt(p) of one.

    So n readings in a nominal period count for sqrt(n) together; the first of all counts in full.
    """
    model, before = known
    readings = 20 * parts
    after = after_lessons(model, before, [(1.0 / parts, FIX_AND_COMPASS)] * readings)
    part, N = faded([1.0] + [math.sqrt(1.0 / parts)] * (readings - 1))
    np.testing.assert_allclose(left(before, after), np.broadcast_to(part, (4, 4, 2)), rtol=1e-8)
    np.testing.assert_allclose(after.memory, np.broadcast_to(N, (4, 2)), rtol=1e-12)
    by_time = SHORTEST_MEMORY + MEMORY_GROWTH * (1.0 + (readings - 1) / math.sqrt(parts))
    assert N[0] == pytest.approx(by_time, rel=1e-12)


@pytest.mark.parametrize("elapsed", [1.0, 1.5, 4.0])
def test_readings_that_come_slowly_count_for_one_each(
    known: tuple[FilterModel, JointState], elapsed: float
) -> None:
    model, before = known
    after = after_lessons(model, before, [(elapsed, FIX_AND_COMPASS)] * 20)
    part, N = faded([1.0] * 20)
    np.testing.assert_allclose(left(before, after), np.broadcast_to(part, (4, 4, 2)), rtol=1e-9)
    np.testing.assert_allclose(after.memory, np.broadcast_to(N, (4, 2)), rtol=1e-12)


def test_of_two_sensors_out_of_step_each_counts_for_the_root_of_a_half_of_rotation(
    known: tuple[FilterModel, JointState],
) -> None:
    """Both inform the rotation's scale; the other scales have one of them each, a period apart.

    So the rotation fades by sqrt(2) readings in a nominal period, in step it fades by one.
    """
    model, before = known
    in_step = after_lessons(model, before, [(1.0, FIX_AND_COMPASS)] * 30)
    halves = [(0.5, FIX), (0.5, ONLY_COMPASS)]
    apart = after_lessons(model, before, halves * 30)
    own, rotation = [0, 2, 3], 1
    np.testing.assert_allclose(apart.memory[own], in_step.memory[own], rtol=1e-12)
    ratio = left(before, apart) / left(before, in_step)
    np.testing.assert_allclose(ratio[own, own], 1.0, rtol=1e-9)
    part, N = faded([1.0] + [math.sqrt(0.5)] * 59)
    np.testing.assert_allclose(apart.memory[rotation], N, rtol=1e-12)
    np.testing.assert_allclose(left(before, apart)[rotation, rotation], part, rtol=1e-8)
    assert np.all(ratio[rotation, rotation] < 1.0), ratio


def test_a_fast_compass_makes_nothing_of_the_fixes_be_forgotten(
    model_of: Callable[..., FilterModel],
) -> None:
    """Fixes stop; 20 s of compass readings later their scale is known as well as before."""
    model = model_of("joint", suspects=False)
    plan = drive(122, 1, 20.0, 0.375, 0.375)
    state = fused(model, plan.epochs, start_of(model, 1))[0][-1]
    blind = drive(123, 1, 20.0, None, 0.05, start=plan.truth[-1])
    after = fused(model, blind.epochs, state)[0][-1]
    assert state.joint is not None
    assert after.joint is not None
    for scale in (0, 2):
        known, now = state.joint.information[scale, scale], after.joint.information[scale, scale]
        assert np.all(now >= known - 1e-9), (known, now)
        np.testing.assert_array_equal(after.joint.memory[scale], state.joint.memory[scale])
    assert np.all(after.joint.memory[3, 0] > state.joint.memory[3, 0])
