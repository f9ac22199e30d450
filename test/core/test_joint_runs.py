# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Mode `joint` on simulated drives: what it costs, what it gains, what it survives."""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import pytest
from drives import TRUE_Q, TRUE_R
from periods import ALL_ROWS

from fnn_ekf_ros.core.adaptation import Adaptation
from fnn_ekf_ros.core.arrays import BoolArray, FloatArray
from fnn_ekf_ros.core.bounds import NoiseBounds
from fnn_ekf_ros.core.filter import step
from fnn_ekf_ros.core.joint import LARGEST_ALARM_LEAD, LARGEST_LIKELIHOOD_RATIO, LONGEST_MEMORY
from fnn_ekf_ros.core.joint_filters import SLIP
from fnn_ekf_ros.core.joint_state import JointState
from fnn_ekf_ros.core.motion import MotionModel, displacement
from fnn_ekf_ros.core.results import Epoch
from fnn_ekf_ros.core.state import JOINT, FilterModel, FilterState, start_filter

MakeModel = Callable[..., FilterModel]
MakeAdaptation = Callable[..., Adaptation]

COMPASS_AND_POSITION = np.array([True, True, True, False])
START_COVARIANCE = np.diag([0.01, 0.01, 0.018])
STEPS = 600
LOUD = (300, 400)
SLIDE = (300, 305)
WRONG = [(25.0, 25.0), (25.0, 0.04), (0.04, 25.0), (0.04, 0.04)]
RIGHT, CORNERS, COLORED, HEAVY, NOISE_STEP, SLIDING = (
    slice(0, 20), slice(20, 68), slice(68, 84), slice(84, 100), slice(100, 112), slice(112, 120)
)  # fmt: skip
RUNS = 120


class Run(NamedTuple):
    """Estimates by filters of the same drives; time first, then components, then runs."""

    error: FloatArray
    nees: FloatArray
    measurement_noise: FloatArray
    weights: FloatArray
    log_scale: FloatArray


class Runs(NamedTuple):
    """The same drives by three filters."""

    joint: Run
    start: Run
    """mode `none` from the same start"""
    oracle: Run
    """mode `none` from the true noise"""


def drives(seed: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return controls, measurements and truth: robots on exact arcs."""
    rng = np.random.default_rng(seed)
    truth, controls, measurements, truths = np.zeros((3, RUNS)), [], [], []
    colored = rng.standard_normal((RUNS, 2)).T
    for i in range(STEPS):
        control = np.repeat([[0.11], [0.03 + 0.05 * math.sin(0.05 * i)]], RUNS, axis=1)
        driven = control + (rng.standard_normal((RUNS, 2)) * np.sqrt(TRUE_Q)).T
        truth = truth + displacement(MotionModel.EXACT_ARC, truth[2], driven)
        if SLIDE[0] <= i < SLIDE[1]:
            truth[:, SLIDING] += [[0.3], [-0.4], [0.3]]
        noise = rng.standard_normal((RUNS, 4)).T
        colored = 0.5 * colored + math.sqrt(0.75) * noise[:2]
        noise[:2, COLORED] = colored[:, COLORED]
        tail = np.sqrt(1.0 / rng.chisquare(3, RUNS))  # Student's t with variance 1
        noise[:2, HEAVY] *= tail[HEAVY]
        if LOUD[0] <= i < LOUD[1]:
            noise[:, NOISE_STEP] *= 5.0
        controls.append(control)
        measurements.append(truth[[0, 1, 2, 2]] + noise * np.sqrt(TRUE_R)[:, None])
        truths.append(truth)
    return np.array(controls), np.array(measurements), np.array(truths)


def filtered(
    model: FilterModel,
    drive: tuple[FloatArray, FloatArray, FloatArray],
    wrong: FloatArray,
) -> Run:
    """Run a filter whose noise is wrong by `(2, RUNS)`, Q and R."""
    control, measurement, truth = drive
    mask = np.repeat(COMPASS_AND_POSITION[:, None], RUNS, axis=1)
    Q, R = TRUE_Q[:, None] * wrong[0], TRUE_R[:, None] * wrong[1]
    state = start_filter(model, np.zeros((3, RUNS)), START_COVARIANCE, Q, R)
    found: list[list[FloatArray]] = [[], [], [], [], []]
    for u, z, true in zip(control, measurement, truth, strict=True):
        state, result = step(model, state, [Epoch(u, 0.375, z, mask)])
        error = state.mean - true
        error[2] = np.arctan2(np.sin(error[2]), np.cos(error[2]))
        white = np.linalg.solve(state.covariance.T, error.T[..., None])[..., 0]
        row = [error, np.sum(error * white.T, axis=0), state.measurement_noise]
        if result.joint is not None:
            row += [result.joint.weights, result.joint.log_scale]
        for kept, value in zip(found, row, strict=False):
            kept.append(value)
    return Run(*(np.array(kept) for kept in found))


@pytest.fixture(scope="module")
def runs(make_model: MakeModel, make_adaptation: MakeAdaptation) -> Runs:
    drive = drives(seed=100)
    right = np.ones((2, RUNS))
    wrong = right.copy()
    wrong[:, CORNERS] = np.repeat(WRONG, 12, axis=0).T
    joint = make_model(adaptation=make_adaptation(mode="joint"))
    plain = make_model()
    return Runs(
        filtered(joint, drive, wrong), filtered(plain, drive, wrong), filtered(plain, drive, right)
    )


def position_rmse(run: Run, which: slice, times: slice = slice(None)) -> float:
    return math.sqrt(float(np.mean(np.sum(run.error[times, :2, which] ** 2, axis=1))))


def yaw_rmse(run: Run, which: slice, times: slice = slice(None)) -> float:
    return math.sqrt(float(np.mean(run.error[times, 2, which] ** 2)))


@pytest.mark.slow
def test_right_start_is_kept_at_next_to_no_cost(runs: Runs) -> None:
    weight = runs.joint.weights[:, 0, RIGHT]
    assert np.mean(weight > 0.5) > 0.9
    assert np.all(np.mean(weight > 0.5, axis=0) > 0.5)
    assert position_rmse(runs.joint, RIGHT) < 1.01 * position_rmse(runs.start, RIGHT)
    assert yaw_rmse(runs.joint, RIGHT) < 1.01 * yaw_rmse(runs.start, RIGHT)


@pytest.mark.parametrize("cell", range(4), ids=[str(wrong) for wrong in WRONG])
def test_start_wrong_by_25_is_mended(runs: Runs, cell: int) -> None:
    which = slice(CORNERS.start + 12 * cell, CORNERS.start + 12 * cell + 12)
    late = slice(STEPS // 2, None)
    oracle = position_rmse(runs.oracle, which, late)
    assert position_rmse(runs.joint, which, late) < 1.06 * oracle
    assert yaw_rmse(runs.joint, which, late) < 1.06 * yaw_rmse(runs.oracle, which, late)
    assert 2.5 < np.mean(runs.joint.nees[late, which]) < 3.8
    # The plain filter would be wrong about where it is, or about how well it knows.
    lost = position_rmse(runs.start, which, late) > 1.5 * oracle
    fooled = not 0.2 < np.mean(runs.start.nees[late, which]) / 3.0 < 5.0
    assert lost or fooled
    assert np.mean(runs.joint.weights[late, 0, which] < 0.01) > 0.95


def test_mended_start_stays_mended(runs: Runs) -> None:
    """No limit cycle: the log scales wander slowly, within what 200 measurements can tell."""
    theta = runs.joint.log_scale[-200:, :, CORNERS]
    spread = np.std(theta, axis=0)
    assert np.all(np.mean(spread, axis=1) < [0.4, 0.4, 0.1, 0.15])
    assert np.max(spread) < 1.0
    change = np.diff(theta, axis=0)
    assert np.sqrt(np.mean(change**2)) < 0.06
    # Changes do not swing back: that would be overshooting.
    swing = np.mean(change[1:] * change[:-1], axis=(0, 2)) / np.mean(change**2, axis=(0, 2))
    assert np.all(np.abs(swing) < 0.5), swing


def test_colored_fixes_do_not_fool_the_right_start(runs: Runs) -> None:
    """Autoregressive with 0.5: the innovations ask for less R and more Q, and that is wrong."""
    assert position_rmse(runs.joint, COLORED) < 1.02 * position_rmse(runs.start, COLORED)
    assert np.mean(runs.joint.weights[:, 0, COLORED] > 0.5) > 0.8


def test_heavy_tailed_fixes_cost_little(runs: Runs) -> None:
    """Student's t with 3 degrees of freedom and the variance of the start's R."""
    assert position_rmse(runs.joint, HEAVY) < 1.06 * position_rmse(runs.start, HEAVY)
    assert np.mean(runs.joint.nees[:, HEAVY]) < 6.0


def test_loud_fixes_are_noticed_at_once_and_forgotten_afterwards(runs: Runs) -> None:
    weights = runs.joint.weights[..., NOISE_STEP]
    R = runs.joint.measurement_noise[..., NOISE_STEP] / TRUE_R[:, None]
    begin, end = LOUD
    assert np.all(weights[begin - 20 : begin, 2] < 0.5)
    assert np.all(weights[begin + 20, 2] > 0.8)
    assert np.all(R[begin + 20, :3] > 2.0)
    typical = np.median(R[end - 20 : end, :3], axis=(0, 2))
    assert np.all((typical > 12.0) & (typical < 50.0)), typical
    assert np.all(weights[end + 60 :, 0] > 0.8)
    assert np.all(np.abs(np.log(R[end + 60 :, :3])) < math.log(1.5))
    loud, after = slice(*LOUD), slice(end + 60, None)
    start = runs.start
    assert position_rmse(runs.joint, NOISE_STEP, loud) < position_rmse(start, NOISE_STEP, loud)
    quiet = position_rmse(runs.joint, NOISE_STEP, after)
    assert quiet < 1.01 * position_rmse(start, NOISE_STEP, after)


def test_sliding_wheels_are_met_within_a_few_periods(runs: Runs) -> None:
    """Half a meter and 17 degrees in each of five periods, which the wheels do not see."""
    begin, end = SLIDE
    slip = runs.joint.weights[:, 3, SLIDING]
    assert np.all(slip[begin - 20 : begin] < 0.1)
    assert np.all(np.max(slip[begin : begin + 5], axis=0) > 0.5)
    assert np.all(slip[end + 60 :] < 0.5)
    assert np.median(runs.joint.weights[end + 60 :, 0, SLIDING]) > 0.8
    sliding = slice(begin, end + 10)
    joint, start = runs.joint, runs.start
    assert position_rmse(joint, SLIDING, sliding) < 0.9 * position_rmse(start, SLIDING, sliding)
    after = slice(end + 60, None)
    assert position_rmse(joint, SLIDING, after) < 1.05 * position_rmse(start, SLIDING, after)


HOSTILE_BOUNDS = NoiseBounds(
    process_min=(1e-8, 1e-8),
    process_max=(1e2, 9.0),
    measurement_min=(1e-6, 1e-6, 1e-6, 1e-6),
    measurement_max=(1e6, 1e6, 9.0, 9.0),
)


def hostile_period(rng: np.random.Generator, truth: FloatArray, i: int) -> list[Epoch]:
    """Standstill and jumps, outliers of all sizes, gaps, several readings, reported covariances."""
    batch = truth.shape[1]
    epochs = int(rng.integers(1, 4)) if i % 3 == 0 else 1
    parts = rng.dirichlet(np.ones(epochs))
    period = rng.normal(0.0, 0.3, (2, batch)) * 10.0 ** rng.uniform(-6.0, 1.0, batch)
    period[:, rng.random(batch) < 0.1] = 0.0
    found = []
    for part in parts:
        control = part * period
        truth += displacement(MotionModel.EXACT_ARC, truth[2], control)
        wild = rng.random((4, batch)) < 0.1
        size = np.where(wild, 10.0 ** rng.uniform(0.0, 6.0, (4, batch)), 0.1)
        z = truth[[0, 1, 2, 2]] + rng.standard_normal((4, batch)) * size
        root = 10.0 ** rng.uniform(-2.0, 2.0, batch) * rng.standard_normal((3, 3, batch))
        reported = np.einsum("ik...,jk...->ij...", root, root) + 1e-4 * np.eye(3)[..., None]
        available: BoolArray = rng.random((4, batch)) < 0.8
        available &= (np.arange(batch) + i // 50) % 5 != 0
        found.append(
            Epoch(
                control,
                float(part) * 0.375,
                np.where(available, z, np.nan),
                available,
                reported if i % 400 > 300 else None,
            )
        )
    return found


def assert_definite(matrices: FloatArray) -> None:
    """Matrices `(n, n, ...)` are positive definite."""
    np.linalg.cholesky(np.moveaxis(matrices, (0, 1), (-2, -1)))  # refuses what is not


def in_bounds(state: FilterState) -> bool:
    b, Q, R = HOSTILE_BOUNDS, state.process_noise.T, state.measurement_noise.T
    return bool(
        np.all((b.process_min <= Q) & (b.process_max >= Q))
        and np.all((b.measurement_min <= R) & (b.measurement_max >= R))
    )


@pytest.mark.slow
def test_hostile_drives_leave_it_sound(
    make_model: MakeModel, make_adaptation: MakeAdaptation
) -> None:
    """From the ends of the bounds and between: finite, positive definite, in bounds."""
    rng = np.random.default_rng(101)
    model = make_model(adaptation=make_adaptation(mode="joint", bounds=HOSTILE_BOUNDS))
    b, batch = HOSTILE_BOUNDS, 8
    where_Q, where_R = rng.random((batch, 2)), rng.random((batch, 4))
    where_Q[:5], where_R[:5] = np.round(where_Q[:5]), np.round(where_R[:5])
    Q = np.clip(
        np.exp((1 - where_Q) * np.log(b.process_min) + where_Q * np.log(b.process_max)),
        b.process_min,
        b.process_max,
    )
    R = np.clip(
        np.exp((1 - where_R) * np.log(b.measurement_min) + where_R * np.log(b.measurement_max)),
        b.measurement_min,
        b.measurement_max,
    )
    truth = np.zeros((3, batch))
    state, touched = start_filter(model, truth.copy(), START_COVARIANCE, Q.T, R.T), False
    for i in range(1000):
        state, result = step(model, state, hostile_period(rng, truth, i))
        joint = state.joint
        assert isinstance(joint, JointState)
        assert result.joint is not None
        assert in_bounds(state)
        assert_definite(state.covariance)
        if i % 5 != 0:
            continue
        assert all(np.all(np.isfinite(part)) for part in (*joint, *result.joint, result.nis))
        assert_definite(state.bank.covariance)
        assert_definite(joint.information)
        np.testing.assert_allclose(np.sum(result.joint.weights, axis=0), 1.0, rtol=1e-12)
        assert np.all((joint.start_weight > 0.0) & (joint.start_weight < 1.0))
        assert np.all(
            (joint.lead <= LARGEST_ALARM_LEAD) & (joint.lead > -20.0 * LARGEST_LIKELIHOOD_RATIO)
        )
        assert np.all(joint.memory <= LONGEST_MEMORY[:, None])
        scale = (np.exp(joint.log_scale[:2]) * Q.T[:, None]).T
        assert np.all(scale > 0.999 * np.array(b.process_min))
        assert np.all(scale < 1.001 * np.array(b.process_max))
        touched |= bool(np.any(scale > 0.999 * np.array(b.process_max)))
    assert touched


def test_rows_that_share_a_scale_stop_at_the_closer_bound(
    make_model: MakeModel, make_adaptation: MakeAdaptation
) -> None:
    """So that their R keep their ratio, and a learner can come back at once."""
    bounds = NoiseBounds((1e-4, 1e-4), (1e-3, 1e-3), (5e-3,) * 4, (3e-2,) * 4)
    model = make_model(
        measurement_noise=(0.008, 0.02, 0.006, 0.025),
        adaptation=make_adaptation(mode="joint", bounds=bounds),
    )
    low, high = [5e-3 / 0.008, 5e-3 / 0.006], [3e-2 / 0.02, 3e-2 / 0.025]
    rng = np.random.default_rng(98)
    for size, limit in ((0.0, low), (1.0, high)):
        state = start_filter(model, np.zeros(3), START_COVARIANCE)
        for _ in range(150):
            z = np.array([0.0, 0.0, 0.0, 0.0]) + size * rng.standard_normal(4)
            epoch = Epoch(np.array([0.0, 2e-3]), 0.375, z, ALL_ROWS)
            state, _ = step(model, state, [epoch])
        assert state.joint is not None
        np.testing.assert_allclose(np.exp(state.joint.log_scale[2:, 0]), limit, rtol=1e-9)


def test_every_hypothesis_is_a_plain_filter_with_its_own_noise(
    make_model: MakeModel, make_adaptation: MakeAdaptation
) -> None:
    """The start's, the centers of the two stars, slip: with the log scales of the step before."""
    model, plain = make_model(adaptation=make_adaptation(mode="joint")), make_model()
    rng = np.random.default_rng(99)
    state = start_filter(model, np.zeros(3), START_COVARIANCE)
    filters = [0, 1, 10, 19]
    for i in range(40):
        rows = ALL_ROWS if i < 30 else rng.random(4) < 0.4
        control = rng.uniform([0.05, -0.3], [0.3, 0.3])
        z = state.mean[[0, 1, 2, 2]] + rng.normal(0.0, 0.5, 4)
        period = [Epoch(control, 0.375, z, rows)]
        before = state
        state, _ = step(model, state, period)
        assert before.joint is not None
        settled, fast = before.joint.log_scale.T
        theta = np.array([0.0 * settled, settled, fast, settled + SLIP]).T
        mean, covariance = before.bank.filters(JOINT)
        alone = start_filter(
            plain,
            mean[:, filters],
            covariance[:, :, filters],
            np.array(plain.process_noise)[:, None] * np.exp(theta[:2]),
            np.array(plain.measurement_noise)[:, None] * np.exp(theta[[2, 2, 3, 3]]),
        )
        copies = [np.repeat(a[:, None], 4, axis=1) for a in (control, z, rows)]
        expected, _ = step(plain, alone, [Epoch(copies[0], 0.375, *copies[1:])])
        mean, covariance = state.bank.filters(JOINT)
        np.testing.assert_allclose(mean[:, filters], expected.mean, rtol=0.0, atol=1e-10)
        np.testing.assert_allclose(
            covariance[:, :, filters], expected.covariance, rtol=1e-9, atol=1e-15
        )
