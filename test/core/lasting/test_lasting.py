# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The filters of lasting errors together: their mixture, moves, copies, and long runs."""

import dataclasses
from collections.abc import Callable

import numpy as np
import pytest
from augmented_ekf import assert_semidefinite
from periods import START, START_COVARIANCE, bytes_of, one_of_batch, wild_epochs

from fnn_ekf_ros.core.arrays import FloatArray, Row, diagonal_of
from fnn_ekf_ros.core.bank import Bank, Noise, Readings, noise_of_readings
from fnn_ekf_ros.core.filter import fuse
from fnn_ekf_ros.core.gate import OPEN_GATE
from fnn_ekf_ros.core.lasting.augmented import ERRORS, POSE, Component
from fnn_ekf_ros.core.lasting.challenger import LOST_AT
from fnn_ekf_ros.core.lasting.lasting import (
    LastingState,
    after_instant,
    after_readings,
    compare_with_members,
    moved,
    moved_to_witness,
    predict_lasting,
    start_lasting,
    with_compass,
    without_offset,
    witness_pose,
)
from fnn_ekf_ros.core.lasting.members import (
    CHALLENGER,
    COPIES,
    FILTER_COUNT,
    HORIZONS_S,
    MEMBER_COUNT,
    MEMBERS,
    OF_MEMBERS,
    PHASES,
    PRIOR,
    WITNESS,
    error_variances,
)
from fnn_ekf_ros.core.motion import MotionModel
from fnn_ekf_ros.core.state import FilterModel, FilterState, for_mode, reset_pose, start_filter

ModelOf = Callable[..., FilterModel]
R = np.array([0.01, 0.02, 0.018, 0.03])


def joint_with_lasting(model_of: ModelOf, **changes: bool) -> FilterModel:
    return dataclasses.replace(model_of("joint", **changes), lasting_errors=True)


def started(model: FilterModel, robots: int) -> FilterState:
    mean = np.repeat(START[:, None], robots, axis=1)
    return start_filter(model, mean, START_COVARIANCE, from_readings=True)


def of_two_robots(seed: int = 40) -> LastingState:
    """Return a state of which every part has moved."""
    rng = np.random.default_rng(seed)
    pose = Bank(rng.standard_normal((3, 1, 2)), START_COVARIANCE[:, :, None, None] * np.ones(2))
    state = start_lasting(pose, R[:, None] * np.ones(2), from_readings=True)
    for _ in range(60):
        state = random_step(rng, state)
    return state


def random_step(rng: np.random.Generator, state: LastingState) -> LastingState:
    """Take all filters over a step and readings of any rows, near the first member's pose."""
    batch = state.outlier_share.shape
    duration_s, wide = float(rng.uniform(0.0, 1.0)), (-1, *(1,) * len(batch))
    control = rng.uniform(-0.3, 0.3, (2, *batch))
    Q = 10.0 ** rng.uniform(-6.0, -2.0, (2, *batch))
    state = predict_lasting(MotionModel.EXACT_ARC, state, control, Q, Q, duration_s)
    available = rng.random((4, *batch)) < 0.6
    available[Row.Y] = available[Row.X]
    z = state.bank.mean[[0, 1, 2, 2], 0] + rng.normal(0.0, 0.3, (4, *batch))
    readings = Readings(z, available)
    noise = Noise(Q[:, None], (np.reshape(R, wide) * 10.0 ** rng.uniform(-3, 3))[:, None]
                  * np.ones((4, 1, *batch)))  # fmt: skip
    state = with_compass(state, readings, noise)
    if rng.random() < 0.3:
        root = 0.1 * rng.standard_normal((3, 3, *batch))
        reported = np.einsum("ik...,jk...->ij...", root, root)
        diagonal_of(reported)[...] += 0.01
        noise = noise_of_readings(noise, tuple(R), reported, available)
    seen = compare_with_members(state, readings, noise)
    accepted = available & (rng.random((4, *batch)) < 0.9)
    accepted[Row.Y] = accepted[Row.X]
    moves, weighs = rng.random(batch) < 0.9, np.ones(batch, dtype=np.bool_)
    state = after_readings(state, seen, noise, accepted, available, moves, duration_s).state
    return after_instant(state, moves, duration_s, weighs)


def test_members() -> None:
    """The first is white; weights of the prior fall with the error; as many copies as needed."""
    assert MEMBERS[0] == (0.0, 0.0)
    assert len(set(MEMBERS)) == MEMBER_COUNT
    prior = PRIOR.behind(0)
    assert prior.sum() == pytest.approx(1.0)
    assert np.argmax(prior) == 0
    assert COPIES.stop - COPIES.start == len(HORIZONS_S) * PHASES * MEMBER_COUNT
    variances = error_variances(np.array([0.5, 2.0]))
    assert variances.shape == (4, FILTER_COUNT)
    for k, (f, s) in enumerate(MEMBERS):
        np.testing.assert_allclose(
            variances[:, k], [0.5 * f**2, 2.0 * f**2, s**2, s**2], atol=1e-15
        )
    of_copies = variances[:, COPIES].reshape(4, -1, MEMBER_COUNT)
    assert np.array_equal(of_copies, np.repeat(variances[:, None, OF_MEMBERS],
                                               of_copies.shape[1], axis=1))  # fmt: skip


def test_estimate_is_the_mixture_of_the_members() -> None:
    """Mean and covariance, with yaws on both sides of pi."""
    state = of_two_robots()
    bank = Bank(state.bank.mean.copy(), state.bank.covariance)
    yaw = np.random.default_rng(41).uniform(-0.5, 0.5, (MEMBER_COUNT, 2)) + np.pi
    bank.mean[Component.YAW, OF_MEMBERS] = np.arctan2(np.sin(yaw), np.cos(yaw))
    assert np.ptp(np.sign(bank.mean[Component.YAW, OF_MEMBERS])) == 2.0
    moves, weighs = np.zeros(2, dtype=np.bool_), np.zeros(2, dtype=np.bool_)
    found = after_instant(state._replace(bank=bank), moves, 0.0, weighs)
    for n in range(2):
        w = found.weights[:, n]
        x = found.bank.mean[POSE, OF_MEMBERS, n].T.copy()
        x[:, 2] = yaw[:, n]
        mean = w @ x
        d = x - mean
        P = np.einsum("k,ijk->ij", w, found.bank.covariance[POSE, POSE, OF_MEMBERS, n])
        P += np.einsum("k,ki,kj->ij", w, d, d)
        mean[2] = np.arctan2(np.sin(mean[2]), np.cos(mean[2]))
        np.testing.assert_allclose(found.mean[:, n], mean, atol=1e-12)
        np.testing.assert_allclose(found.covariance[..., n], P, atol=1e-12)


def test_copies_are_made_anew_from_their_members() -> None:
    """Only those whose time has come; the others go on without fixes."""
    state = of_two_robots()
    ages = np.full((len(HORIZONS_S), PHASES, 2), 1.0)
    ages[0, 1, 0] = 1.5 * HORIZONS_S[0] - 0.1
    ages[1, 0, 1] = -0.1
    state = state._replace(outages=state.outages._replace(age_s=ages))
    found = after_instant(state, np.array([True, True]), 0.2, np.array([False, False]))
    shape = (len(HORIZONS_S), PHASES, MEMBER_COUNT, 2)
    for one, before in zip(found.bank, state.bank, strict=True):
        lead = one.ndim - 2
        skip = (slice(None),) * lead
        copies, old = (
            array[(*skip, COPIES)].reshape(*array.shape[:lead], *shape) for array in (one, before)
        )
        expected = old.copy()
        expected[(*skip, 0, 1, slice(None), 0)] = before[(*skip, OF_MEMBERS, 0)]
        expected[(*skip, 1, 0, slice(None), 1)] = before[(*skip, OF_MEMBERS, 1)]
        assert np.array_equal(copies, expected)
        others = (*skip, slice(0, COPIES.start))
        assert np.array_equal(one[others], before[others])


def test_start_from_readings_is_less_certain_than_that_from_a_pose() -> None:
    pose = Bank(START[:, None], START_COVARIANCE[:, :, None])
    given = start_lasting(pose, R, from_readings=False)
    read = start_lasting(pose, R, from_readings=True)
    np.testing.assert_allclose(given.covariance, START_COVARIANCE, atol=1e-15)
    np.testing.assert_allclose(given.mean, START)
    np.testing.assert_allclose(read.mean, START)
    w, variances = read.weights, error_variances(R[:2])[:, OF_MEMBERS]
    more = [w @ variances[0], w @ variances[1], w @ (variances[2] + variances[3])]
    np.testing.assert_allclose(read.covariance, START_COVARIANCE + np.diag(more))


def test_move_keeps_what_was_learned() -> None:
    """Weights, offset and the fixes' noise; the errors begin anew, outages are not scored."""
    state = of_two_robots()
    pose = Bank(np.ones((3, 1, 2)), 0.1 * np.eye(3)[:, :, None, None] * np.ones(2))
    found = moved(state, pose)
    assert found.outages.log_weight is state.outages.log_weight
    assert found.weights is state.weights
    assert found.fix_variance is state.fix_variance
    assert not found.outages.fixes.any()
    k = Component.YAW_OFFSET
    assert np.array_equal(found.bank.mean[k, WITNESS], state.bank.mean[k, WITNESS])
    assert np.array_equal(found.bank.covariance[k, k, WITNESS],
                          state.bank.covariance[k, k, WITNESS])  # fmt: skip
    np.testing.assert_allclose(found.mean, np.ones((3, 2)))
    np.testing.assert_allclose(found.covariance, pose.covariance[:, :, 0], atol=1e-15)
    expected = error_variances(state.fix_variance)
    expected[3, [WITNESS, CHALLENGER]] = state.bank.covariance[k, k, WITNESS]
    np.testing.assert_allclose(diagonal_of(found.bank.covariance)[ERRORS], expected)


def test_move_to_the_witness_keeps_it_as_it_was() -> None:
    state = of_two_robots()
    found = moved_to_witness(state)
    mean, covariance = witness_pose(state)
    np.testing.assert_allclose(found.mean, mean)
    np.testing.assert_allclose(found.covariance, covariance, atol=1e-15)
    for one, before in zip(found.bank, state.bank, strict=True):
        skip = (slice(None),) * (one.ndim - 2)
        for k in (WITNESS, CHALLENGER):
            assert np.array_equal(one[(*skip, k)], before[(*skip, k)])
        pose = (slice(0, 3),) * (one.ndim - 2)
        for k in set(range(FILTER_COUNT)) - {CHALLENGER}:
            assert np.array_equal(one[(*pose, k)], before[(*pose, WITNESS)])
    assert found.offset is state.offset


def test_lead_of_a_challenger_does_not_pass_to_another_one() -> None:
    """At another pose the opposite one begins; that there is none stays so."""
    state = of_two_robots()
    lead = np.array([7.8, LOST_AT])
    state = state._replace(offset=state.offset._replace(challenger=lead))
    pose = Bank(np.ones((3, 1, 2)), 0.1 * np.eye(3)[:, :, None, None] * np.ones(2))
    found = moved(state, pose)
    assert found.offset.challenger.tolist() == [0.0, LOST_AT]
    turned = found.bank.mean[Component.YAW, CHALLENGER] - found.bank.mean[Component.YAW, WITNESS]
    np.testing.assert_allclose(np.cos(turned), -1.0)


def test_believed_offset_is_taken_from_the_readings() -> None:
    """From the compass's, and from a fix's yaw where no compass was read."""
    state = of_two_robots()
    state.bank.mean[Component.YAW_OFFSET, WITNESS] = 0.5
    none = without_offset(state, np.zeros((4, 2)))
    assert not none.any()
    believed = state.offset._replace(believed=np.array([True, True]))
    state = state._replace(offset=believed, compass_seen=np.array([True, False]))
    z = without_offset(state, np.zeros((4, 2)))
    assert z.tolist() == [[0.0, 0.0], [0.0, 0.0], [-0.5, -0.5], [0.0, -0.5]]
    wrapped = without_offset(state, np.full((4, 2), -3.0))
    np.testing.assert_allclose(wrapped[Row.COMPASS_YAW], 2.0 * np.pi - 3.5)


@pytest.mark.slow
def test_covariances_stay_covariances_over_100_000_steps() -> None:
    """500 steps of 51 filters of 4 robots; noise from 1e-3 to 1e3 of the usual."""
    rng = np.random.default_rng(42)
    pose = Bank(np.zeros((3, 1, 4)), START_COVARIANCE[:, :, None, None] * np.ones(4))
    state = start_lasting(pose, R[:, None] * np.ones(4), from_readings=True)
    for k in range(500):
        state = random_step(rng, state)
        if k % 20 == 19:
            assert np.all(np.isfinite(state.bank.mean))
            assert_semidefinite(state.bank.covariance, 1e-10)
            variances = diagonal_of(state.bank.covariance)
            absent = error_variances(state.fix_variance) == 0.0
            assert not variances[ERRORS][absent].any()
            np.linalg.cholesky(np.moveaxis(state.covariance, -1, 0))
            assert np.all(state.weights > 0.0)
            np.testing.assert_allclose(state.weights.sum(axis=0), 1.0)


def test_robots_of_a_batch_do_not_influence_each_other(model_of: ModelOf) -> None:
    """Any rows, outliers that agree, reported covariances, offsets that are believed."""
    model, robots = joint_with_lasting(model_of), 3
    state = started(model, robots)
    alone = [one_of_batch(state, (n,)) for n in range(robots)]
    for epoch in wild_epochs(np.random.default_rng(43), 60, (robots,)):
        state, _ = fuse(model, state, epoch)
        for n in range(robots):
            alone[n], _ = fuse(model, alone[n], one_of_batch(epoch, (n,)))
    for n in range(robots):
        for name in ("mean", "covariance"):
            np.testing.assert_allclose(
                getattr(state, name)[..., n], getattr(alone[n], name), atol=1e-9, err_msg=name
            )
        assert state.lasting is not None
        assert alone[n].lasting is not None
        np.testing.assert_allclose(state.lasting.bank.covariance[..., n],
                                   alone[n].lasting.bank.covariance, atol=1e-8)  # fmt: skip


def test_step_changes_no_state(model_of: ModelOf) -> None:
    model = joint_with_lasting(model_of)
    state = started(model, 2)
    for epoch in wild_epochs(np.random.default_rng(44), 30, (2,)):
        before = bytes_of(state)
        after, _ = fuse(model, state, epoch)
        assert bytes_of(state) == before
        state = after


def test_without_a_gate_the_learner_learns_what_it_learns_alone(model_of: ModelOf) -> None:
    """Bit for bit, as long as no offset is likely: white filters do not see the members."""
    lasting = dataclasses.replace(joint_with_lasting(model_of), gate=OPEN_GATE)
    alone = dataclasses.replace(lasting, lasting_errors=False)
    one, other = started(lasting, 2), started(alone, 2)
    assert other.lasting is None
    for wild in wild_epochs(np.random.default_rng(45), 60, (2,)):
        assert one.lasting is not None
        z = wild.measurement.copy()
        z[[Row.COMPASS_YAW, Row.LRF_YAW]] = one.lasting.bank.mean[Component.YAW, WITNESS]
        epoch = wild._replace(measurement=z)
        one, _ = fuse(lasting, one, epoch)
        other, _ = fuse(alone, other, epoch)
        assert one.lasting is not None
        assert not (one.lasting.offset.believed | one.lasting.offset.unknown).any()
    assert bytes_of(one._replace(lasting=None, gate=other.gate)) == bytes_of(other)
    assert np.any(one.mean != other.mean)


@pytest.mark.parametrize("mode", ["none", "r", "q", "rq"])
def test_other_modes_follow_no_lasting_errors(mode: str, model_of: ModelOf) -> None:
    model = dataclasses.replace(model_of(mode), lasting_errors=True)
    assert started(model, 1).lasting is None


def test_joint_without_learning_and_without_lasting_errors_is_the_plain_filter(
    model_of: ModelOf,
) -> None:
    joint, plain = model_of("joint", suspects=False), model_of("none", suspects=False)
    fixed = dataclasses.replace(
        joint, adaptation=dataclasses.replace(joint.adaptation, learning=False),
        lasting_errors=False,
    )  # fmt: skip
    one, other = started(fixed, 2), started(plain, 2)
    for epoch in wild_epochs(np.random.default_rng(46), 40, (2,)):
        one, _ = fuse(fixed, one, epoch)
        other, _ = fuse(plain, other, epoch)
    assert one.mean.tobytes() == other.mean.tobytes()
    assert one.covariance.tobytes() == other.covariance.tobytes()


def test_mode_and_pose_may_change(model_of: ModelOf) -> None:
    """The filters start with mode joint, end with it, and are moved with the pose."""
    model, plain = joint_with_lasting(model_of), model_of("none")
    state = started(model, 1)
    for epoch in wild_epochs(np.random.default_rng(47), 10, (1,)):
        state, _ = fuse(model, state, epoch)
    left = for_mode(plain, state)
    assert left.lasting is None
    np.testing.assert_array_equal(left.mean, state.mean)
    np.testing.assert_array_equal(left.covariance, state.covariance)
    again = for_mode(model, left)
    assert again.lasting is not None
    np.testing.assert_allclose(again.mean, state.mean, atol=1e-15)
    np.testing.assert_allclose(again.covariance, state.covariance, atol=1e-15)
    pose: FloatArray = np.array([[9.0], [8.0], [1.0]])
    found = reset_pose(model, state, pose, START_COVARIANCE[:, :, None])
    np.testing.assert_allclose(found.mean, pose)
    np.testing.assert_allclose(found.covariance[..., 0], START_COVARIANCE, atol=1e-15)
    assert found.lasting is not None
    assert state.lasting is not None
    np.testing.assert_array_equal(found.lasting.weights, state.lasting.weights)
