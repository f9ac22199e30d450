# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Mode `joint`: what one period does to what was learned, and what it must not do."""

import dataclasses

import numpy as np
import pytest
from joint_drives import (
    FAST,
    SETTLED,
    START_COVARIANCE,
    MakeAdaptation,
    MakeModel,
    at_end,
    joint_periods,
    learned,
    report,
    trained,
)
from periods import ALL_ROWS, NO_ROWS

from fnn_ekf_ros.core.arrays import FloatArray
from fnn_ekf_ros.core.filter import step
from fnn_ekf_ros.core.gate import gate_for
from fnn_ekf_ros.core.joint import STANDSTILL
from fnn_ekf_ros.core.joint_state import ALARM_MEMORY, noise_in_use
from fnn_ekf_ros.core.state import (
    JOINT,
    FilterModel,
    FilterState,
    reset_pose,
    start_filter,
    with_noise,
)


@pytest.fixture(scope="module")
def model(make_model: MakeModel, make_adaptation: MakeAdaptation) -> FilterModel:
    return make_model(adaptation=make_adaptation(mode="joint"))


@pytest.fixture(scope="module")
def holding(model: FilterModel) -> FilterModel:
    """The same filter with learning disabled."""
    adaptation = dataclasses.replace(model.adaptation, learning=False)
    return dataclasses.replace(model, adaptation=adaptation)


@pytest.mark.slow
def test_disabled_from_the_start_it_is_the_plain_filter_bit_for_bit(
    make_model: MakeModel, holding: FilterModel
) -> None:
    plain_model = make_model()
    held = start_filter(holding, np.zeros(3), START_COVARIANCE)
    plain = start_filter(plain_model, np.zeros(3), START_COVARIANCE)
    rng = np.random.default_rng(91)
    for period in joint_periods(rng, 100) + joint_periods(rng, 100, plain=True):
        held, result = step(holding, held, period)
        plain, expected = step(plain_model, plain, period)
        for name in ("mean", "covariance", "process_noise", "measurement_noise"):
            assert getattr(held, name).tobytes() == getattr(plain, name).tobytes()
        for name in ("innovation", "innovation_variance", "nis", "degrees_of_freedom"):
            assert getattr(result, name).tobytes() == getattr(expected, name).tobytes()


def without_lead(state: FilterState, model: FilterModel) -> FilterState:
    """Return the state with no sudden hypothesis ahead, and the noise that goes with it."""
    assert state.joint is not None
    joint = state.joint._replace(lead=np.zeros_like(state.joint.lead))
    Q, R = noise_in_use(joint, model.adaptation.bounds)
    return with_noise(model, state._replace(joint=joint), Q, R)


def test_disabled_in_an_alarm_it_calms_down(model: FilterModel, holding: FilterModel) -> None:
    """Slip that is over must not stay in the noise until learning is enabled again."""
    state = trained(model)
    assert state.joint is not None
    calm = without_lead(state, model)
    state = state._replace(joint=state.joint._replace(lead=np.full_like(state.joint.lead, 12.0)))
    for period in joint_periods(np.random.default_rng(93), 100):
        state, _ = step(holding, state, period)
    np.testing.assert_allclose(state.process_noise, calm.process_noise, rtol=1e-3)
    np.testing.assert_allclose(state.measurement_noise, calm.measurement_noise, rtol=1e-3)


def test_disabled_later_it_holds_what_it_has_learned(
    model: FilterModel, holding: FilterModel
) -> None:
    state = without_lead(trained(model), model)
    _, before = learned(state)
    before_mean = state.bank.mean[:, JOINT]
    Q, R = state.process_noise.copy(), state.measurement_noise.copy()
    assert not np.any(np.equal(Q, model.process_noise))
    for period in joint_periods(np.random.default_rng(92), 50):
        state, result = step(holding, state, period)
        assert state.process_noise.tobytes() == Q.tobytes()
        assert state.measurement_noise.tobytes() == R.tobytes()
        assert not np.any(result.firing_strength)
        assert not np.any(report(result).explained)
    _, unchanged = learned(state)
    assert unchanged == before
    # Its filters have moved on: learning goes on from where the robot is.
    mean = state.bank.mean[:, JOINT]
    assert np.max(np.abs(mean - state.mean[:, None])) < 1.5
    assert np.all(mean != before_mean)


STILL = np.array(STANDSTILL)


@pytest.mark.parametrize(
    ("control", "rows", "teaches"),
    [
        ([0.1, 0.1], ALL_ROWS, True),
        ([0.1, 0.1], np.array([False, False, True, False]), True),
        ([0.1, 0.1], NO_ROWS, False),
        (0.9 * STILL, ALL_ROWS, False),
        (-0.9 * STILL, ALL_ROWS, False),
        ([0.0, 0.0], NO_ROWS, False),
        (STILL * [1.1, 0.0], ALL_ROWS, True),
        (STILL * [0.0, -1.1], ALL_ROWS, True),
    ],
)
def test_only_a_robot_that_moves_and_is_measured_learns(
    model: FilterModel, control: FloatArray, rows: FloatArray, teaches: bool
) -> None:
    state = trained(model)
    before, expected = learned(state)
    period = at_end(np.asarray(control), np.array([0.4, -0.4, 0.3, 0.3]), rows)
    state, result = step(model, state, period)
    after, got = learned(state)
    if teaches:
        assert np.all(after.log_scale != before.log_scale)
        assert after.start_weight != before.start_weight
        assert np.all(after.memory >= before.memory)
        assert np.any(result.firing_strength)
        return
    assert got == expected
    np.testing.assert_array_equal(after.lead, ALARM_MEMORY * before.lead)
    assert np.all(np.abs(after.lead) < np.abs(before.lead))
    assert not np.any(result.firing_strength)
    assert not np.any(report(result).explained)


def test_standstill_is_judged_by_the_speed(
    make_model: MakeModel, make_adaptation: MakeAdaptation
) -> None:
    """The same way in a period ten times as long is no way at all."""
    for period_s, teaches in ((0.375, True), (3.75, False)):
        model = make_model(period_s=period_s, adaptation=make_adaptation(mode="joint"))
        state = trained(model)
        _, before = learned(state)
        period = at_end(2.0 * STILL, np.full(4, 0.2), ALL_ROWS, period_s)
        state, _ = step(model, state, period)
        assert (learned(state)[1] != before) == teaches


def test_a_robot_that_stands_learns_nothing_after_a_rejected_reading_either(
    model: FilterModel,
) -> None:
    """The way of two periods is not judged as the way of one."""
    gated = dataclasses.replace(model, gate=gate_for(1e-6, 1e-6))
    state = trained(model)
    z = state.mean[[0, 1, 2, 2]]
    for wild in (True, False):
        _, before = learned(state)
        period = at_end(0.9 * STILL, z + wild * np.array([99.0, 99.0, 3.0, 3.0]), ALL_ROWS)
        state, result = step(gated, state, period)
        assert np.all(result.rejected == wild)
        assert learned(state)[1] == before


def test_robots_of_a_batch_learn_each_for_itself(model: FilterModel) -> None:
    """Drives and is measured, drives unseen, stands."""
    state = start_filter(model, np.zeros((3, 3)), START_COVARIANCE)
    control = np.array([[0.1, 0.1, 0.0], [0.1, 0.1, 0.0]])
    rows = np.stack([ALL_ROWS, NO_ROWS, ALL_ROWS], axis=-1)
    for i in range(5):
        z = np.full((4, 3), 0.5 + 0.02 * i)  # the same ones would be those of frozen sensors
        state, result = step(model, state, at_end(control, z, rows))
    joint, _ = learned(state)
    assert np.all(joint.log_scale[..., 0] != 0.0)
    assert np.all(joint.log_scale[..., 1:] == 0.0)
    np.testing.assert_array_equal(joint.forecast_count, [2.0, 0.0, 2.0])
    assert np.any(result.firing_strength[..., 0])
    assert not np.any(result.firing_strength[..., 1:])


def test_new_pose_keeps_what_was_learned_and_clears_the_forecasts(model: FilterModel) -> None:
    state = trained(model)
    before, expected = learned(state)
    pose, covariance = np.array([7.0, 8.0, 0.9]), 0.02 * np.eye(3)
    state = reset_pose(model, state, pose, covariance)
    after, got = learned(state)
    assert got == expected
    assert after.lead.tobytes() == before.lead.tobytes()
    assert after.forecast_count == 0.0
    mean, matrix = state.bank
    assert mean.shape == (3, model.layout.steady.stop)
    np.testing.assert_array_equal(mean.T, np.broadcast_to(pose, mean.T.shape))
    np.testing.assert_array_equal(matrix.T, np.broadcast_to(covariance, matrix.T.shape))
    # Forecasts that are two measurements old have to be made anew.
    for i in range(4):
        keep, _ = learned(state)
        settled, fast = keep.log_scale.T
        period = at_end(np.array([0.1, 0.1]), pose[[0, 1, 2, 2]] + 0.1, ALL_ROWS)
        state, _ = step(model, state, period)
        joint, _ = learned(state)
        assert np.any(joint.log_scale[:, SETTLED] != settled) == (i >= 2)
        assert (joint.start_weight != keep.start_weight) == (i >= 2)
        assert np.all(joint.log_scale[:, FAST] != fast)


@pytest.mark.parametrize("altered", [1, 2, 3])
def test_settled_learner_looks_past_the_last_measurement(model: FilterModel, altered: int) -> None:
    """Its evidence does not depend on the last measurement before, but on those before that."""
    before = trained(model)
    periods = joint_periods(np.random.default_rng(93), 4, plain=True)
    now = periods.pop()
    after, informations = [], []
    for shift in (0.0, 0.4):
        state = before
        for i, period in enumerate(periods):
            other = [epoch._replace(measurement=epoch.measurement + shift) for epoch in period]
            chosen = other if i == len(periods) - altered else period
            keep, _ = learned(state)
            Q, R = state.process_noise, state.measurement_noise
            state, _ = step(model, state, chosen)
            # What was learned on the way is set back: only the forecasts may tell.
            joint, _ = learned(state)
            joint = joint._replace(log_scale=keep.log_scale, information=keep.information)
            state = with_noise(model, state._replace(joint=joint), Q, R)
        last, result = step(model, state, now)
        after.append(report(result).explained)
        informations.append(learned(last)[0].information)
    assert (after[0].tobytes() == after[1].tobytes()) == (altered == 1)
    settled = [information[..., SETTLED] for information in informations]
    assert (settled[0].tobytes() == settled[1].tobytes()) == (altered == 1)
    assert np.all(informations[0][..., FAST] != informations[1][..., FAST])
