# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The filter's step: pure, the same in a batch, the textbook's without adaptation."""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import pytest
from banks import BOTH_MODELS
from jacobians import motion_jacobian
from periods import (
    ALL_ROWS,
    MODES,
    NO_ROWS,
    START,
    START_COVARIANCE,
    arrays_of,
    bytes_of,
    one_of_batch,
)
from random_periods import one_epoch, random_epoch, random_periods
from textbook_ekf import textbook_step

from fnn_ekf_ros.core.adaptation import Adaptation
from fnn_ekf_ros.core.filter import step
from fnn_ekf_ros.core.joint_state import noise_without_alarms
from fnn_ekf_ros.core.motion import MotionModel, move
from fnn_ekf_ros.core.pace import NOMINAL_PERIOD_S
from fnn_ekf_ros.core.state import FilterModel, for_mode, reset_pose, start_filter


def assert_same_results(one: NamedTuple, other: NamedTuple) -> None:
    """Rows without a reading show nothing: their S and D are not compared."""
    rows = one.available  # type: ignore[attr-defined]
    for name in one._fields:
        got, expected = getattr(one, name), getattr(other, name)
        if name == "shown":
            continue
        if name in ("innovation_variance", "mismatch"):
            got, expected = got[rows], expected[rows]
        parts = [(got, expected)]
        if isinstance(got, tuple):
            parts = list(zip(arrays_of(got), arrays_of(expected), strict=True))
        for a, b in parts:
            if a is not None:
                np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-12, err_msg=name)


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.slow
def test_step_changes_none_of_its_arguments_and_repeats_itself(
    make_model: Callable[..., FilterModel], make_adaptation: Callable[..., Adaptation], mode: str
) -> None:
    model = make_model(adaptation=make_adaptation(mode=mode, window_length=6))
    state = start_filter(model, START, START_COVARIANCE)
    for period in random_periods(np.random.default_rng(60), 30):
        before = bytes_of(state, *period)
        for array in arrays_of(state, *period):
            array.flags.writeable = False
        first, second = step(model, state, period), step(model, state, period)
        assert bytes_of(*first) == bytes_of(*second)
        assert bytes_of(state, *period) == before
        state = first[0]


@pytest.mark.parametrize("mode", MODES)
@BOTH_MODELS
@pytest.mark.slow
def test_batch_equals_single_filters(
    make_model: Callable[..., FilterModel],
    make_adaptation: Callable[..., Adaptation],
    mode: str,
    model: MotionModel,
) -> None:
    batch = (2, 2)
    filter_model = make_model(
        motion_model=model, adaptation=make_adaptation(mode=mode, window_length=6)
    )
    rng = np.random.default_rng(61)
    mean = START[:, None, None] + 0.1 * rng.standard_normal((3, *batch))
    together = start_filter(filter_model, mean, START_COVARIANCE)
    every = list(np.ndindex(*batch))
    alone = {i: start_filter(filter_model, mean[:, *i], START_COVARIANCE) for i in every}
    for period in random_periods(rng, 20, batch):
        together, result = step(filter_model, together, period)
        for i in every:
            mine = [one_of_batch(epoch, i) for epoch in period]
            alone[i], single = step(filter_model, alone[i], mine)
            got = arrays_of(one_of_batch(together, i))
            for one, other in zip(got, arrays_of(alone[i]), strict=True):
                np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-12)
            assert_same_results(one_of_batch(result._replace(shown=()), i), single)


@BOTH_MODELS
@pytest.mark.slow
def test_without_adaptation_the_run_equals_the_textbook_filter(
    make_model: Callable[..., FilterModel], model: MotionModel
) -> None:
    """The steps together: prediction with Q of the period, correction with R, masks."""
    filter_model = make_model(motion_model=model, period_s=0.15)
    Q = np.diag(filter_model.process_noise) * 0.15 / 0.375
    R = np.diag(filter_model.measurement_noise)
    state = start_filter(filter_model, START, START_COVARIANCE)
    x, P = START, START_COVARIANCE
    paper = model is MotionModel.PAPER
    rng = np.random.default_rng(64)
    for _ in range(300):
        epoch = random_epoch(rng, (), 0.375)._replace(duration_s=0.15, fix_covariance=None)
        rows = [int(row) for row in np.flatnonzero(epoch.available)]
        before = textbook_step(paper, x, P, epoch.control, Q, epoch.measurement, R, [])
        x, P = textbook_step(paper, x, P, epoch.control, Q, epoch.measurement, R, rows)
        state, result = step(filter_model, state, [epoch])
        np.testing.assert_allclose(state.mean[:2], x[:2], atol=1e-10, rtol=0.0)
        assert abs(math.remainder(state.mean[2] - x[2], 2.0 * math.pi)) < 1e-10
        np.testing.assert_allclose(state.covariance, P, atol=1e-12, rtol=0.0)
        variance = np.diag(before[1])[[0, 1, 2, 2]] + np.diag(R)
        np.testing.assert_allclose(result.innovation_variance, variance, rtol=1e-10)
        assert result.degrees_of_freedom == len(rows)
    assert state.process_noise.tobytes() == np.array(filter_model.process_noise).tobytes()
    assert state.measurement_noise.tobytes() == np.array(filter_model.measurement_noise).tobytes()


@pytest.mark.parametrize("mode", ["r", "q", "rq"])
def test_adaptation_changes_nothing_before_it_has_learned_something(
    make_model: Callable[..., FilterModel], make_adaptation: Callable[..., Adaptation], mode: str
) -> None:
    """The first step of the adapted noise is the one after the window is ready."""
    adaptive = make_model(adaptation=make_adaptation(mode=mode, window_length=45))
    state = start_filter(adaptive, START, START_COVARIANCE)
    plain = start_filter(make_model(), START, START_COVARIANCE)
    rng = np.random.default_rng(65)
    for i in range(16):
        period = [random_epoch(rng, (), 0.375)._replace(available=ALL_ROWS)]
        state, plain = step(adaptive, state, period)[0], step(make_model(), plain, period)[0]
        same = bytes_of(state._replace(gate=plain.gate)) == bytes_of(plain)
        # A third of 45 innovations: after the 15th the noise moves, and the 16th feels it.
        assert same == (i < 14)
        assert (state.mean.tobytes() == plain.mean.tobytes()) == (i < 15)


@pytest.mark.parametrize("period_s", [0.375, 0.1, 1.5])
def test_process_noise_grows_with_the_period(
    make_model: Callable[..., FilterModel], period_s: float
) -> None:
    model, control = make_model(period_s=period_s), np.array([0.4, 0.5])
    state = start_filter(model, START, START_COVARIANCE)
    period = one_epoch(control, np.zeros(4), NO_ROWS, duration_s=period_s)
    after, _ = step(model, state, period)
    motion = move(MotionModel.EXACT_ARC, START[:, None], control[:, None])
    A, W = motion_jacobian(motion)[..., 0], motion.noise_jacobian()[..., 0]
    Q = np.diag(model.process_noise) * period_s / 0.375
    expected = A @ START_COVARIANCE @ A.T + W @ Q @ W.T
    np.testing.assert_allclose(after.covariance, expected, rtol=0.0, atol=1e-15)
    np.testing.assert_array_equal(after.process_noise, model.process_noise)
    assert NOMINAL_PERIOD_S == 0.375


def test_start_takes_its_noise_from_the_model_or_from_its_caller(
    make_model: Callable[..., FilterModel],
) -> None:
    model = make_model()
    mean = np.zeros((3, 2, 5))
    state = start_filter(model, mean, np.eye(3))
    assert state.covariance.shape == (3, 3, 2, 5)
    assert state.window.squares.shape == (45, 4, 2, 5)
    np.testing.assert_array_equal(state.covariance[:, :, 1, 4], np.eye(3))
    np.testing.assert_array_equal(state.process_noise[:, 1, 4], model.process_noise)
    np.testing.assert_array_equal(state.measurement_noise[:, 1, 4], model.measurement_noise)
    assert not np.any(state.window.counts)
    Q, R = np.array([1.0, 2.0]), np.ones((4, 1, 1)) * np.arange(1.0, 11.0).reshape(2, 5)
    state = start_filter(model, mean, np.eye(3), Q, R)
    np.testing.assert_array_equal(state.process_noise[:, 0, 3], Q)
    np.testing.assert_array_equal(state.measurement_noise, R)


def test_new_pose_keeps_the_noise_and_forgets_the_innovations(
    make_model: Callable[..., FilterModel], make_adaptation: Callable[..., Adaptation]
) -> None:
    model = make_model(adaptation=make_adaptation(mode="r", window_length=6))
    state = start_filter(model, START, START_COVARIANCE)
    for period in random_periods(np.random.default_rng(67), 20):
        state, _ = step(model, state, period)
    before = bytes_of(state)
    fresh = reset_pose(model, state, np.array([7.0, 8.0, 0.9]), np.eye(3))
    assert bytes_of(state) == before
    np.testing.assert_array_equal(fresh.mean, [7.0, 8.0, 0.9])
    np.testing.assert_array_equal(fresh.covariance, np.eye(3))
    assert fresh.measurement_noise.tobytes() == state.measurement_noise.tobytes()
    assert fresh.process_noise.tobytes() == state.process_noise.tobytes()
    assert fresh.window.squares.shape == (6, 4)
    assert not np.any(fresh.window.counts)


def test_mode_q_projects_on_the_heading_at_the_end_of_the_step(
    make_model: Callable[..., FilterModel], make_adaptation: Callable[..., Adaptation]
) -> None:
    """Driving along y after a quarter turn, only y's innovations teach distance noise."""
    model = make_model(adaptation=make_adaptation(mode="q", window_length=3))
    loud_x = np.array([5.0, 0.0, 0.0, 0.0])
    available = np.array([True, True, False, False])
    changes = []
    for heading in (0.0, -math.pi / 2.0):
        state = start_filter(model, np.array([0.0, 0.0, heading]), 1e-4 * np.eye(3))
        turned = state.mean + np.array([0.0, 0.0, math.pi / 2.0])
        z = turned[[0, 1, 2, 2]] + loud_x
        period = one_epoch(np.array([0.0, math.pi / 2.0]), z, available)
        after, _ = step(model, state, period)
        changes.append(after.process_noise[0] - model.process_noise[0])
    # Ends along y: y was quiet, so the noise falls; ends along x: it rises.
    assert changes[0] < 0.0 < changes[1]


@pytest.mark.parametrize("before", MODES)
@pytest.mark.parametrize("after", MODES)
@pytest.mark.slow
def test_a_change_of_mode_keeps_the_pose_and_the_noise_without_an_alarms_share(
    make_model: Callable[..., FilterModel],
    make_adaptation: Callable[..., Adaptation],
    before: str,
    after: str,
) -> None:
    old, new = (
        make_model(adaptation=make_adaptation(mode=mode, window_length=6))
        for mode in (before, after)
    )
    state = start_filter(old, START, START_COVARIANCE)
    periods = random_periods(np.random.default_rng(61), 25)
    for period in periods[:20]:
        state, _ = step(old, state, period)
    if state.joint is not None:  # slip leads: the noise in use is not the calm one
        state = state._replace(joint=state.joint._replace(lead=np.array([0.0, 12.0])))
    changed = for_mode(new, state)
    for name in ("mean", "covariance", "window", "gate", "pace"):
        assert bytes_of([getattr(changed, name)]) == bytes_of([getattr(state, name)])
    if (before == "joint") == (after == "joint"):
        assert changed is state
    elif before == "joint":
        assert state.joint is not None
        Q, R = noise_without_alarms(state.joint, old.adaptation.bounds)
        np.testing.assert_array_equal(changed.process_noise, Q)
        np.testing.assert_array_equal(changed.measurement_noise, R)
    else:
        assert changed.joint is not None
        np.testing.assert_array_equal(changed.process_noise, state.process_noise)
        np.testing.assert_array_equal(changed.measurement_noise, state.measurement_noise)
        np.testing.assert_array_equal(changed.joint.process_noise, state.process_noise)
        np.testing.assert_array_equal(changed.joint.measurement_noise, state.measurement_noise)
        np.testing.assert_array_equal(changed.joint.log_scale, 0.0)
    assert changed.bank.mean.shape == (3, new.layout.steady.stop)
    for period in periods[20:]:
        changed, _ = step(new, changed, period)
    assert (changed.joint is not None) == (after == "joint")
