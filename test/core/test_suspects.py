# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Suspects: the one that does not fit the others is found, and nobody without a reason."""

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from drives import TRUE_Q as Q
from drives import TRUE_R as R

from fnn_ekf_ros.core.arrays import FloatArray, Row
from fnn_ekf_ros.core.filter import step
from fnn_ekf_ros.core.motion import displacement
from fnn_ekf_ros.core.results import Epoch, StepResult
from fnn_ekf_ros.core.state import FilterModel, FilterState, start_filter
from fnn_ekf_ros.core.suspects import LARGEST_SUSPECT_LEAD, SUSPECT_COUNT, SUSPECTS, SUSPICION

START_P = np.diag([0.01, 0.01, 0.018])
AVAILABLE = np.array([True, True, True, False])
FIX, COMPASS = np.array([True, True, False, False]), np.array([False, False, True, False])
NONE = np.zeros(4, dtype=np.bool_)
PERIOD_S = 0.375
Spoil = Callable[[float, np.random.Generator], tuple[FloatArray, FloatArray]]


@pytest.fixture(scope="module")
def model(make_model: Callable[..., FilterModel]) -> FilterModel:
    """A filter that adapts nothing and rejects nothing, with suspects beside it."""
    plain = make_model(process_noise=tuple(Q), measurement_noise=tuple(R))
    return dataclasses.replace(plain, suspects=True)


def drive(
    model: FilterModel,
    spoil: Spoil,
    periods: int = 200,
    runs: int = 4,
    seed: int = 3,
    rates: tuple[int, int] | None = None,
) -> FloatArray:
    """Return the leads `(periods, 3, runs)` of robots on a bent path after each period.

    Args:
        model: the filter.
        spoil: takes the time [periods] and returns what is added to the measured controls,
            for a whole period, and to the measurements.
        periods: how many.
        runs: how many robots.
        seed: of their noise.
        rates: how many epochs a period has, and with which of them there is a fix; a compass
            reading comes with each. None: both sensors speak at a period's end.
    """
    rng = np.random.default_rng(seed)
    epochs, fix_each = rates or (1, 1)
    size = 1.0 / epochs
    truth = np.zeros((3, runs))
    state = start_filter(model, truth, START_P)
    leads, count = [], 0
    for period in range(periods):
        readings = []
        for i in range(epochs):
            count += 1
            told = size * np.repeat([[0.11], [0.03]], runs, axis=1)
            noise = np.sqrt(size * Q)[:, None] * rng.normal(size=(2, runs))
            truth = truth + displacement(model.motion_model, truth[2], told + noise)
            z = truth[[0, 1, 2, 2]] + np.sqrt(R)[:, None] * rng.normal(size=(4, runs))
            wrong_control, wrong_z = spoil(period + i / epochs, rng)
            rows = np.repeat((AVAILABLE if count % fix_each == 0 else COMPASS)[:, None], runs, 1)
            told += size * wrong_control[:, None]
            readings.append(Epoch(told, size * PERIOD_S, z + wrong_z[:, None], rows))
        state, _ = step(model, state, readings)
        leads.append(state.lead)
    return np.array(leads)


def nothing(_: float, __: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    return np.zeros(2), np.zeros(4)


def turned_compass(time: float, _: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    return np.zeros(2), np.array([0.0, 0.0, 1.5 * (time >= 50), 0.0])


def noisy_fixes(time: float, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    return np.zeros(2), np.array([1.0, 1.0, 0.0, 0.0]) * 0.5 * (time >= 50) * rng.normal(size=4)


def stuck_left_wheel(time: float, _: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """Of a robot with wheels 0.6 m apart: half of the way, and a turn that there is not."""
    left = 0.11 - 0.3 * 0.03
    return -np.array([0.5 * left, -left / 0.6]) * (time >= 50), np.zeros(4)


def one_period(
    model: FilterModel, state: FilterState, z: Any, rows: FloatArray = AVAILABLE, way: float = 0.0
) -> tuple[FilterState, StepResult]:
    """Return what a period with one reading of each sensor at its end does."""
    return step(model, state, [Epoch(np.array([way, 0.0]), PERIOD_S, np.array(z), rows)])


def suspects_of(model: FilterModel, state: FilterState) -> tuple[FloatArray, FloatArray]:
    """Return the suspects' means `(3, 4, *batch)` and covariances."""
    return state.bank.filters(model.layout.suspects)


def with_lead(state: FilterState, lead: list[float]) -> FilterState:
    return state._replace(lead=np.array(lead))


def test_the_bank_has_a_filter_for_nobody_and_one_for_each_suspect(model: FilterModel) -> None:
    """Each with its suspect's noise alone taken for larger."""
    state = start_filter(model, np.zeros(3), START_P)
    assert model.layout.suspects.stop - model.layout.suspects.start == SUSPECT_COUNT
    noise = state.noise.filters(model.layout.suspects)
    process, measurement = noise.process / Q[:, None], noise.measurement / R[:, None]
    np.testing.assert_allclose(process, [[1.0, SUSPICION, 1.0, 1.0]] * 2)
    fix = [1.0, 1.0, 1.0, SUSPICION]
    np.testing.assert_allclose(measurement, [fix, fix, [1.0, 1.0, SUSPICION, 1.0], fix])


def test_suspects_change_nothing_of_the_published_filter(model: FilterModel) -> None:
    plain = dataclasses.replace(model, suspects=False)
    a, b = (start_filter(m, np.zeros(3), START_P) for m in (model, plain))
    rng = np.random.default_rng(4)
    for _ in range(40):
        z = rng.normal(0.0, 1.0, 4)
        (a, one), (b, other) = one_period(model, a, z), one_period(plain, b, z)
        assert a.mean.tobytes() == b.mean.tobytes()
        assert a.covariance.tobytes() == b.covariance.tobytes()
        assert one.nis.tobytes() == other.nis.tobytes()
    assert a.lead.any()


def test_nobody_is_suspected_without_a_reason(model: FilterModel) -> None:
    leads = drive(model, nothing, periods=1000)
    assert np.mean(leads > 10.0) < 5e-3
    assert np.mean(leads > 0.0) < 0.4


FAST = (15, 4)
"""In a period of 0.375 s 15 epochs of 25 ms: a compass at 40 Hz, fixes at 10 Hz."""
CULPRITS = [(turned_compass, "compass"), (noisy_fixes, "lrf_pose"), (stuck_left_wheel, "encoders")]


@pytest.mark.parametrize(("spoil", "culprit"), CULPRITS)
def test_who_does_not_fit_the_others_leads_within_seconds(
    model: FilterModel, spoil: Spoil, culprit: str
) -> None:
    leads = drive(model, spoil)
    assert leads[:50].max() < 12.0
    who = SUSPECTS.index(culprit)
    others = [index for index in range(len(SUSPECTS)) if index != who]
    for later in (65, 80):
        assert np.all(leads[later, who] > 10.0), leads[later]
        assert np.all(leads[later, who] - leads[later][others].max(axis=0) > 6.0)


def test_leads_are_capped_together(model: FilterModel) -> None:
    """Who leads by how much stays when a lead is at its cap."""
    state = start_filter(model, np.zeros(3), START_P)
    far = [0.0, 0.0, 0.6, 0.0]  # explained best by the compass
    after, _ = one_period(model, with_lead(state, [LARGEST_SUSPECT_LEAD, 30.0, 0.0]), far)
    free, _ = one_period(model, with_lead(state, [20.0, 10.0, 0.0]), far)
    assert after.lead.max() == LARGEST_SUSPECT_LEAD
    np.testing.assert_allclose(after.lead[0] - after.lead[1], free.lead[0] - free.lead[1])


def test_a_cleared_suspect_starts_again_from_the_one_that_suspects_nobody(
    model: FilterModel,
) -> None:
    state = start_filter(model, np.array([9.0, 9.0, 0.9]), 0.1 * START_P)
    which, mean = model.layout.suspects, state.bank.mean.copy()
    mean[:, which] = 9.0 + np.arange(12.0).reshape(4, 3).T * 0.001
    mean[2, which] -= 8.0
    state = state._replace(bank=state.bank._replace(mean=mean))
    right = [9.0, 9.001, 1.002, 0.0]
    after, _ = one_period(model, with_lead(state, [5.0, 0.0, 0.0]), right)
    assert after.lead[0] > 0.0
    np.testing.assert_array_equal(after.lead[1:], 0.0)
    means, covariances = suspects_of(model, after)
    for cleared in (2, 3):
        np.testing.assert_array_equal(means[:, cleared], means[:, 0])
        np.testing.assert_array_equal(covariances[:, :, cleared], covariances[:, :, 0])
    assert not np.array_equal(means[:, 1], means[:, 0])
    assert not np.array_equal(means[:, 0], after.mean)
    free, _ = one_period(model, with_lead(state, [0.0, 0.0, 0.0]), right)
    np.testing.assert_array_equal(free.lead, 0.0)
    means, covariances = suspects_of(model, free)
    np.testing.assert_array_equal(means, np.repeat(free.mean[:, None], 4, axis=1))
    np.testing.assert_array_equal(covariances, np.repeat(free.covariance[:, :, None], 4, axis=2))


def test_a_period_without_measurements_changes_no_lead(model: FilterModel) -> None:
    state = with_lead(start_filter(model, np.zeros(3), START_P), [3.0, 1.0, 0.0])
    after, _ = one_period(model, state, np.full(4, np.nan), NONE, way=0.1)
    np.testing.assert_array_equal(after.lead, state.lead)
    np.testing.assert_allclose(suspects_of(model, after)[0][0], 0.1)


def test_a_wild_fix_moves_the_filters_by_a_bounded_way(model: FilterModel) -> None:
    """An outlier of twice the size moves them by far less than twice as much; none follows."""
    state = start_filter(model, np.zeros(3), START_P)
    moved = []
    for far in (20.0, 40.0):
        after, _ = one_period(model, state, [far, 0.0, 0.0, 0.0])
        assert after.lead[SUSPECTS.index("lrf_pose")] > 10.0
        moved.append(suspects_of(model, after)[0][Row.X, 0])
    assert moved[0] < 1.0
    assert moved[1] < 1.2 * moved[0]


def test_robots_of_a_batch_do_not_mix(model: FilterModel) -> None:
    poses = np.array([[0.0, 0.0, 0.0], [5.0, 1.0, 1.0], [-3.0, 2.0, 2.0]]).T
    z = np.array([[0.1, 0.0, 0.9, 0.0], [5.0, 3.0, 1.0, 0.0], [-3.0, 2.0, 2.0, 0.0]]).T
    rows = np.array([AVAILABLE, AVAILABLE, FIX]).T
    control = np.array([[0.1, 0.1, 0.0], [0.0, 0.0, 0.1]])
    both = start_filter(model, poses, START_P)
    alone = [start_filter(model, poses[:, index], START_P) for index in range(3)]
    for _ in range(3):
        both, _ = step(model, both, [Epoch(control, PERIOD_S, z, rows)])
        for index in range(3):
            mine = Epoch(control[:, index], PERIOD_S, z[:, index], rows[:, index])
            alone[index], _ = step(model, alone[index], [mine])
            whole, part = (*both.bank, both.lead), (*alone[index].bank, alone[index].lead)
            for one, other in zip(whole, part, strict=True):
                np.testing.assert_allclose(one[..., index], other, rtol=1e-12, atol=1e-12)


def found_after(leads: FloatArray, who: int) -> FloatArray:
    """Return how many periods after the fault's begin each robot's suspect leads by 10."""
    assert leads[:50].max() < 12.0
    clear = (leads[50:, who] > 10.0) & (leads[50:, who] == leads[50:].max(axis=1))
    assert np.all(clear.any(axis=0))
    return np.argmax(clear, axis=0)


@pytest.mark.parametrize(("spoil", "culprit"), CULPRITS)
@pytest.mark.slow
def test_a_fault_is_found_as_soon_with_fast_sensors(
    model: FilterModel, spoil: Spoil, culprit: str
) -> None:
    """Not later than with one reading of each a period, and no culprit is another one."""
    who = SUSPECTS.index(culprit)
    slow = found_after(drive(model, spoil, periods=68, runs=8), who)
    fast_leads = drive(model, spoil, periods=68, runs=8, rates=FAST)
    fast = found_after(fast_leads, who)
    assert np.median(fast) <= np.median(slow) + 1.0, (fast, slow)
    assert np.max(fast) <= 12, fast
    others = [index for index in range(len(SUSPECTS)) if index != who]
    assert np.all(fast_leads[64:, who] - fast_leads[64:, others].max(axis=1) > 6.0)


@pytest.mark.slow
def test_nobody_is_suspected_without_a_reason_by_fast_sensors(model: FilterModel) -> None:
    leads = drive(model, nothing, periods=80, runs=60, rates=FAST)
    assert np.mean(leads > 10.0) < 5e-3, np.mean(leads > 10.0)
    assert np.max(leads) < 25.0, np.max(leads)
