# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Mode `joint`, exactly: what one period does to what was learned, and what it must not do."""

import dataclasses
import itertools
import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import pytest
from periods import ALL_ROWS, NO_ROWS

from fnn_ekf_ros.core.adaptation import Adaptation
from fnn_ekf_ros.core.arrays import FloatArray
from fnn_ekf_ros.core.evidence import (
    CONSISTENT_SCALE,
    NEIGHBOR_STEP,
    STAR,
    TAIL_DEGREES_OF_FREEDOM,
)
from fnn_ekf_ros.core.filter import step
from fnn_ekf_ros.core.fuzzy import infer
from fnn_ekf_ros.core.gate import gate_for
from fnn_ekf_ros.core.joint import LONGEST_MEMORY, MEMORY_GROWTH, STANDSTILL
from fnn_ekf_ros.core.joint_filters import SLIP
from fnn_ekf_ros.core.joint_state import (
    ALARM_MEMORY,
    HYPOTHESES,
    PRIOR_INFORMATION,
    JointReport,
    JointState,
    noise_in_use,
)
from fnn_ekf_ros.core.motion import displacement
from fnn_ekf_ros.core.results import Epoch, StepResult
from fnn_ekf_ros.core.state import (
    JOINT,
    FilterModel,
    FilterState,
    reset_pose,
    start_filter,
    with_noise,
)

MakeModel = Callable[..., FilterModel]
MakeAdaptation = Callable[..., Adaptation]
START_COVARIANCE = np.diag([0.01, 0.01, 0.018])
SETTLED, FAST = 0, 1
SCALE_OF_ROW = [2, 2, 3, 3]
PERIOD_S = 0.375
LEARNED = ("log_scale", "information", "memory", "start_weight")


def learned(state: FilterState) -> tuple[JointState, list[bytes]]:
    assert state.joint is not None
    return state.joint, [getattr(state.joint, name).tobytes() for name in LEARNED]


def report(result: StepResult) -> JointReport:
    assert isinstance(result.joint, JointReport)
    return result.joint


def at_end(
    control: FloatArray, z: FloatArray, rows: FloatArray, duration_s: float = PERIOD_S
) -> list[Epoch]:
    """Return a period with readings at its end only."""
    return [Epoch(np.asarray(control), duration_s, np.asarray(z), rows.astype(np.bool_))]


def joint_periods(rng: np.random.Generator, steps: int, plain: bool = False) -> list[list[Epoch]]:
    """Around the origin, unless plain with readings in between, reported covariances and gaps."""
    periods = []
    for _ in range(steps):
        control = rng.uniform([0.05, -0.3], [0.3, 0.3])
        z = rng.normal(0.0, 0.3, 4)
        if plain:
            periods.append(at_end(control, z, ALL_ROWS))
            continue
        root = 0.1 * rng.standard_normal((3, 3))
        reported = root @ root.T + 0.01 * np.eye(3)
        part = rng.random()
        periods.append(
            [
                Epoch(share * control, share * PERIOD_S, z, rng.random(4) < 0.6, reported)
                for share in (part, 1.0 - part)
            ]
        )
    return periods


def trained(model: FilterModel, seed: int = 90, steps: int = 40) -> FilterState:
    """Return a state of which every part has moved."""
    state = start_filter(model, np.zeros(3), START_COVARIANCE)
    for period in joint_periods(np.random.default_rng(seed), steps, plain=True):
        state, _ = step(model, state, period)
    joint, _ = learned(state)
    assert np.all(joint.log_scale != 0.0)
    assert np.all(joint.lead != 0.0)
    return state


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
    for _ in range(5):
        state, result = step(model, state, at_end(control, np.full((4, 3), 0.5), rows))
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


class Scalar(NamedTuple):
    """Headings and variances of a star of filters that only turn."""

    heading: FloatArray
    variance: FloatArray


def predicted(star: Scalar, turn: float, q: FloatArray) -> Scalar:
    return Scalar(star.heading + turn, star.variance + q)


def likelihood_of(star: Scalar, z: float, r: FloatArray) -> FloatArray:
    S, nu = star.variance + r, TAIL_DEGREES_OF_FREEDOM
    e = (z - star.heading) ** 2 / S
    return -0.5 * (np.log(S) + (nu + 1.0) * np.log(1.0 + e / CONSISTENT_SCALE[1]))


def scalar_evidence(star: Scalar, z: float, r: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return score and information of heading and yaw; the others cannot be seen."""
    lead, S = z - star.heading, star.variance + r
    parts = [likelihood_of(star, z, r), np.log(S), lead / math.sqrt(S[0])]
    slope = [np.array([0.0, p[3] - p[4], 0.0, p[7] - p[8]]) / (2.0 * NEIGHBOR_STEP) for p in parts]
    factor = (TAIL_DEGREES_OF_FREEDOM + 1.0) / (TAIL_DEGREES_OF_FREEDOM + 3.0)
    return slope[0], factor * (0.5 * np.outer(slope[1], slope[1]) + np.outer(slope[2], slope[2]))


def test_turning_on_the_spot_equals_scalar_filters(model: FilterModel) -> None:
    """Everything from the definition: forecasts, score, information, network, memory, odds."""
    rng = np.random.default_rng(94)
    state = start_filter(model, np.zeros(3), START_COVARIANCE)
    # Rows of each: the start's noise, then the star of a learner; snapshots are of the settled's.
    stars = {k: Scalar(np.zeros(10), np.full(10, 0.018)) for k in (SETTLED, FAST)}
    snapshots: list[Scalar] = []
    checked = 0
    for i in range(120):
        joint, _ = learned(state)
        turn, measured = 0.1 * (-1.0) ** (i // 3) + 0.013, rng.random() < 0.7
        z = stars[FAST].heading[0] + turn + rng.normal(0.0, 0.4)
        rows = np.array([False, False, measured, False])
        offsets = {
            k: np.vstack([np.zeros(4), joint.log_scale[:, k] + STAR.T]) for k in (SETTLED, FAST)
        }
        q = {k: model.process_noise[1] * np.exp(offsets[k][:, 1]) for k in offsets}
        r = {k: model.measurement_noise[2] * np.exp(offsets[k][:, 3]) for k in offsets}
        stars = {k: predicted(stars[k], turn, q[k]) for k in stars}
        snapshots = [predicted(star, turn, q[SETTLED]) for star in snapshots]
        state, result = step(model, state, at_end(np.array([0.0, turn]), np.full(4, z), rows))
        after, _ = learned(state)
        if not measured:
            continue
        sources = {FAST: stars[FAST]}
        if len(snapshots) == 2:
            sources[SETTLED] = snapshots[0]
            checked += 1
            apart = likelihood_of(snapshots[0], z, r[SETTLED])
            w, v = joint.start_weight, after.start_weight
            if 0.1 < v < 0.9:
                odds = math.log(v / (1.0 - v)) - math.log(w / (1.0 - w))
                assert odds == pytest.approx(apart[0] - apart[1], abs=0.01)
        for k, star in sources.items():
            score, seen = scalar_evidence(Scalar(star.heading[1:], star.variance[1:]), z, r[k][1:])
            # The compass informs heading and yaw; what is known of the others does not fade.
            N, informed = joint.memory[:, k], np.array([False, True, False, True])
            fade = np.where(informed, np.sqrt(1.0 - 1.0 / N), 1.0)
            known = joint.information[..., k] - PRIOR_INFORMATION
            information = np.outer(fade, fade) * known + PRIOR_INFORMATION + seen
            np.testing.assert_allclose(after.information[..., k], information, rtol=0.0, atol=1e-8)
            u = np.linalg.solve(information, score)
            if k == SETTLED:
                np.testing.assert_allclose(report(result).explained, u, rtol=0.0, atol=1e-9)
            moved = joint.log_scale[:, k] + infer(model.adaptation.networks.joint.sets, -u).change
            np.testing.assert_allclose(after.log_scale[:, k], moved, rtol=0.0, atol=1e-9)
            grown = np.minimum(N + MEMORY_GROWTH * informed, LONGEST_MEMORY[k])
            np.testing.assert_array_equal(after.memory[:, k], grown)
        for k, star in stars.items():
            gain = star.variance / (star.variance + r[k])
            stars[k] = Scalar(
                star.heading + gain * (z - star.heading), (1.0 - gain) * star.variance
            )
        snapshots = [*snapshots, stars[SETTLED]][-2:]
    assert checked > 60


@pytest.mark.slow
def test_noise_in_use_is_the_start_times_the_weighted_scales(model: FilterModel) -> None:
    """Right noise, wheels that slide, loud fixes for long: every hypothesis has its time."""
    rng, truth = np.random.default_rng(95), np.zeros(3)
    state, dominant = start_filter(model, truth, START_COVARIANCE), set()
    for i in range(300):
        control = rng.uniform([0.05, -0.3], [0.3, 0.3])
        spread = np.sqrt(model.process_noise) * (20.0 if 60 <= i < 70 else 1.0)
        driven = control + spread * rng.standard_normal(2)
        truth = truth + displacement(model.motion_model, truth[2], driven)
        noise = np.sqrt(model.measurement_noise) * (10.0 if i >= 120 else 1.0)
        z = truth[[0, 1, 2, 2]] + noise * rng.standard_normal(4)
        state, result = step(model, state, at_end(control, z, ALL_ROWS))
        weights, joint = report(result).weights, learned(state)[0]
        assert np.sum(weights) == pytest.approx(1.0, abs=1e-12)
        assert np.min(weights) >= 0.0
        dominant.add(HYPOTHESES[int(np.argmax(weights))])
        settled, fast = joint.log_scale.T
        theta = weights[1:] @ np.array([settled, fast, settled + SLIP])
        np.testing.assert_allclose(report(result).log_scale, theta, rtol=0.0, atol=1e-12)
        Q, R = np.exp(theta[:2]), np.exp(theta[SCALE_OF_ROW])
        np.testing.assert_allclose(state.process_noise, model.process_noise * Q, rtol=1e-12)
        np.testing.assert_allclose(state.measurement_noise, model.measurement_noise * R, rtol=1e-12)
    assert dominant == set(HYPOTHESES)


def test_published_filter_runs_on_the_noise_in_use(
    make_model: MakeModel, model: FilterModel
) -> None:
    """Each step of it is one of the plain filter with the noise of the step before."""
    state, plain = trained(model), make_model()
    for epoch in itertools.chain(*joint_periods(np.random.default_rng(96), 20)):
        period = [epoch]
        same = start_filter(
            plain, state.mean, state.covariance, state.process_noise, state.measurement_noise
        )
        expected, _ = step(plain, same, period)
        state, _ = step(model, state, period)
        assert state.mean.tobytes() == expected.mean.tobytes()
        assert state.covariance.tobytes() == expected.covariance.tobytes()


def scaled_run(model: FilterModel, length: float, quarter_turns: int = 0) -> list[FloatArray]:
    """Return log scales and weights over time, with lengths in other units and a map turned."""
    unit = np.array([length, length, 1.0, 1.0])
    angle = 0.5 * math.pi * quarter_turns
    turned = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
    scaled = dataclasses.replace(
        model,
        process_noise=tuple(np.array(model.process_noise) * unit[[0, 2]] ** 2),
        measurement_noise=tuple(np.array(model.measurement_noise) * unit**2),
    )
    covariance = START_COVARIANCE * np.outer(unit[:3], unit[:3])
    state, found = start_filter(scaled, np.array([0.0, 0.0, angle]), covariance), []
    for [epoch] in joint_periods(np.random.default_rng(97), 120, plain=True):
        z = np.concatenate([turned @ epoch.measurement[:2], epoch.measurement[2:] + angle])
        period = at_end(epoch.control * unit[[0, 2]], z * unit, ALL_ROWS)
        state, result = step(scaled, state, period)
        joint, _ = learned(state)
        found += [joint.log_scale.ravel(), report(result).log_scale, report(result).weights]
    return found


@pytest.mark.parametrize(("length", "quarter_turns"), [(2.0, 0), (5.0, 0), (0.1, 0), (1.0, 1)])
@pytest.mark.slow
def test_neither_units_nor_the_maps_axes_change_what_is_learned(
    model: FilterModel, length: float, quarter_turns: int
) -> None:
    for one, other in zip(
        scaled_run(model, 1.0), scaled_run(model, length, quarter_turns), strict=True
    ):
        np.testing.assert_allclose(other, one, rtol=0.0, atol=1e-6)
