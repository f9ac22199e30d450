# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Sensors that are fast or out of step: the gate and the accuracy."""

import math
from collections.abc import Callable

import numpy as np
import pytest
from drives import TRUE_Q, TRUE_R, drive, fused, start_of
from periods import FIX, FIX_AND_COMPASS, MODES, ONLY_COMPASS, START_COVARIANCE

from fnn_ekf_ros.core.arrays import BoolArray, FloatArray
from fnn_ekf_ros.core.filter import step
from fnn_ekf_ros.core.gate import SPREAD_GROWTH, SPREAD_MEMORY
from fnn_ekf_ros.core.motion import MotionModel, displacement
from fnn_ekf_ros.core.pace import NOMINAL_PERIOD_S
from fnn_ekf_ros.core.results import Epoch
from fnn_ekf_ros.core.rows import COMPASS, LRF_POSE
from fnn_ekf_ros.core.state import FilterModel, FilterState, start_filter, with_noise


@pytest.mark.parametrize("sensor", [COMPASS, LRF_POSE])
@pytest.mark.parametrize("interval_s", [0.02, 0.05, 0.1875, 0.375, 0.75])
def test_spread_grows_and_decays_by_time_with_fast_sensors_and_by_readings_with_slow_ones(
    model_of: Callable[..., FilterModel], sensor: int, interval_s: float
) -> None:
    model, rng = model_of("none"), np.random.default_rng(120)
    state = start_filter(model, np.zeros(3), np.diag([0.01, 0.01, 0.018]))
    rows = ONLY_COMPASS if sensor == COMPASS else FIX
    part = min(interval_s / NOMINAL_PERIOD_S, 1.0)
    if sensor == COMPASS:  # no yaw is far off: a compass that is known to be as good as this
        certain = np.array([0.01, 0.01, 1e-6, 1e-6])
        state = start_filter(model, np.zeros(3), np.diag([0.01, 0.01, 1e-6]), None, certain)
        tiny = np.full(2, 1e-10)
        state = with_noise(model, state, tiny, certain)
    spread, count = [], round(1.5 / (part * NOMINAL_PERIOD_S))
    for i in range(count + 1):
        size = 1e4 if sensor == LRF_POSE else 1.0
        z = np.array([*(size * rng.standard_normal(2)), 0.9 + (i % 3), 0.0])
        state, result = step(model, state, [Epoch(np.zeros(2), interval_s, z, rows)])
        assert result.rejected[sensor]
        spread.append(float(state.gate.spread[sensor]))
    grown = SPREAD_GROWTH ** (part * np.arange(count + 1))
    np.testing.assert_allclose(np.array(spread) / spread[0], grown, rtol=1e-12)
    assert spread[0] == pytest.approx(SPREAD_GROWTH, rel=1e-12)  # the first one counts in full
    other = LRF_POSE if sensor == COMPASS else COMPASS
    assert state.gate.spread[other] == 1.0
    # Right ones without an innovation: the spread falls towards 1.
    before, found = spread[-1], []
    for _ in range(count):
        z = state.mean[[0, 1, 2, 2]]
        state, result = step(model, state, [Epoch(np.zeros(2), interval_s, z, rows)])
        assert not result.rejected.any()
        found.append(float(state.gate.spread[sensor]))
    left = before * SPREAD_MEMORY ** (part * np.arange(1, count + 1))
    np.testing.assert_allclose(found, np.maximum(left, 1.0), rtol=1e-9)
    assert left[-1] > 1.0 or found[-1] == 1.0


OUT_OF_STEP = {
    "apart": [FIX, ONLY_COMPASS],
    "fast compass": [ONLY_COMPASS, ONLY_COMPASS, FIX_AND_COMPASS, ONLY_COMPASS],
    "both fast": [FIX_AND_COMPASS] * 3,
}


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("order", OUT_OF_STEP)
@pytest.mark.parametrize("wild", [FIX, ONLY_COMPASS], ids=["fix", "compass"])
@pytest.mark.slow
def test_a_lone_wild_reading_does_what_a_missing_one_does_out_of_step_too(
    model_of: Callable[..., FilterModel], mode: str, order: str, wild: BoolArray
) -> None:
    """Bit for bit in the modes of the paper, and close to it in mode joint.

    There which compass readings are scored differs, and how fast what was learned fades.
    """
    model, rng, truth = model_of(mode, suspects=False), np.random.default_rng(126), np.zeros(3)
    rows_of_period = OUT_OF_STEP[order]
    periods, at = [], next(i for i, rows in enumerate(rows_of_period) if np.all(rows[wild]))
    part = 1.0 / len(rows_of_period)
    for t in range(45):
        periods.append([])
        for rows in rows_of_period:
            control = part * np.array([0.11, 0.1 * math.sin(0.05 * t)])
            driven = control + np.sqrt(part * TRUE_Q) * rng.standard_normal(2)
            truth = truth + displacement(MotionModel.EXACT_ARC, truth[2], driven)
            z = truth[[0, 1, 2, 2]] + np.sqrt(TRUE_R) * rng.standard_normal(4)
            periods[-1].append(Epoch(control, part * NOMINAL_PERIOD_S, z, rows))
    usual = periods[25][at]
    far = usual._replace(measurement=usual.measurement + wild * np.array([20.0, 0.0, 3.0, 0.0]))
    missing = usual._replace(available=usual.available & ~wild)
    ways: list[list[FilterState]] = []
    rejected: list[int] = []
    for epoch in (far, missing):
        periods[25][at] = epoch
        state, states, count = start_filter(model, np.zeros(3), START_COVARIANCE), [], 0
        for period in periods:
            state, result = step(model, state, period)
            states.append(state)
            count += int(result.rejected.sum())
        ways.append(states)
        rejected.append(count)
    assert rejected[0] == rejected[1] + 1  # R that was learned too small rejects others in both
    for one, other in zip(*ways, strict=True):
        for name in ("mean", "covariance", "process_noise", "measurement_noise"):
            a, b = getattr(one, name), getattr(other, name)
            if mode != "joint":
                assert a.tobytes() == b.tobytes()
            elif name.endswith("noise"):
                np.testing.assert_allclose(a, b, rtol=0.05)
            else:
                np.testing.assert_allclose(a, b, rtol=0.0, atol=2e-3)


FAST = {"fix_s": 0.1, "compass_s": 0.04, "late_s": 0.007}


def squared_errors(states: list[FilterState], truth: list[FloatArray]) -> FloatArray:
    """Return `(T, 2, runs)` squared errors of position and yaw."""
    found = []
    for state, true in zip(states, truth, strict=True):
        error = state.mean - true
        error[2] = np.arctan2(np.sin(error[2]), np.cos(error[2]))
        found.append([error[0] ** 2 + error[1] ** 2, error[2] ** 2])
    return np.array(found)


def nees(state: FilterState, true: FloatArray) -> FloatArray:
    error = state.mean - true
    error[2] = np.arctan2(np.sin(error[2]), np.cos(error[2]))
    white = np.linalg.solve(np.moveaxis(state.covariance, -1, 0), error.T[..., None])[..., 0]
    return np.asarray(np.sum(error * white.T, axis=0))


def test_plain_filter_is_consistent_with_fast_sensors(
    make_model: Callable[..., FilterModel],
) -> None:
    """Mean NEES of 300 robots is 3, by four of its standard deviations at most."""
    model, runs = make_model(), 300
    plan = drive(124, runs, 12.0, **FAST)
    states, shown = fused(model, plan.epochs, start_of(model, runs))
    for at in (len(states) // 2, -1):
        assert abs(np.mean(nees(states[at], plan.truth[at])) - 3.0) < 4.0 * math.sqrt(6.0 / runs)
    nis = np.mean([seen.nis.sum() for seen in shown if seen is not None]) / runs
    rows = np.mean([seen.degrees_of_freedom.sum() for seen in shown if seen is not None]) / runs
    assert nis == pytest.approx(rows, rel=0.02)


@pytest.mark.slow
def test_joint_with_fast_sensors_keeps_a_right_start_and_mends_a_wrong_one(
    model_of: Callable[..., FilterModel], make_model: Callable[..., FilterModel]
) -> None:
    """Against the plain filter with the true noise; what is mended, in the last third."""
    runs, right, mended = 24, slice(0, 8), slice(8, None)
    joint, plain = model_of("joint", gated=False, suspects=False), make_model()
    plan = drive(125, runs, 30.0, **FAST)
    wrong = np.ones((2, runs))
    wrong[:, mended] = np.repeat([[25.0, 25.0, 0.04, 0.04], [25.0, 0.04, 25.0, 0.04]], 4, axis=1)
    noise = {
        "process_noise": TRUE_Q[:, None] * wrong[0],
        "measurement_noise": TRUE_R[:, None] * wrong[1],
    }
    starts = (
        (joint, start_of(joint, runs, **noise)),
        (plain, start_of(plain, runs)),
        (plain, start_of(plain, runs, **noise)),
    )
    of_joint, oracle, of_start = (
        squared_errors(fused(model, plan.epochs, start)[0], plan.truth) for model, start in starts
    )
    cost = of_joint[:, :, right].mean(axis=(0, 2)) / oracle[:, :, right].mean(axis=(0, 2))
    assert np.all(np.sqrt(cost) < 1.02), cost
    late = slice(2 * len(oracle) // 3, None)
    after = [each[late, :, mended].mean(axis=(0, 2)) for each in (of_joint, oracle, of_start)]
    assert np.all(np.sqrt(after[0] / after[1]) < 1.1), after
    assert np.sqrt(after[0][0] / after[2][0]) < 0.9, after
