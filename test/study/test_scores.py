# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Scores and intervals against closed forms, tables of quantiles and sampling."""

import math

import numpy as np
import pytest

from fnn_ekf_ros.core.arrays import FloatArray
from fnn_ekf_ros.evaluation.intervals import (
    chi_square_band,
    mean_interval,
    root_ratio_interval,
    student_t,
)
from fnn_ekf_ros.study.recording import Estimates
from fnn_ekf_ros.study.scores import LOST_FACTOR, Errors, compare, rms_over_runs, score

WHOLE = slice(0, None)


def errors_of(error: FloatArray, nees: float = 3.0, nis: float = 3.0, dof: float = 3.0) -> Errors:
    """Return errors whose other numbers are the same at every step and run."""
    shape = error.shape[:-1]
    return Errors(error, np.full(shape, nees), np.full(shape, nis), np.full(shape, dof))


# --- Intervals -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("degrees", "expected"), [(3, 3.1824), (5, 2.5706), (10, 2.2281), (30, 2.0423), (99, 1.9842)]
)
def test_student_t_as_in_the_tables(degrees: int, expected: float) -> None:
    assert student_t(degrees) == pytest.approx(expected, rel=5e-3)


@pytest.mark.parametrize(
    ("degrees", "low", "high"),
    [(50, 32.357, 71.420), (100, 74.222, 129.561), (300, 253.912, 349.874)],
)
def test_chi_square_band_as_in_the_tables(degrees: int, low: float, high: float) -> None:
    band = chi_square_band(np.array(degrees))
    assert band == pytest.approx((low / degrees, high / degrees), rel=2e-3)


def test_interval_of_a_mean() -> None:
    """1, 2, 3, 4: mean 2.5, deviation sqrt(5/3), t(3) = 3.182: half width 2.054."""
    found = mean_interval(np.array([[1.0, 2.0, 3.0, 4.0], [5.0, 5.0, 5.0, 5.0]]))
    np.testing.assert_allclose(found.value, [2.5, 5.0])
    np.testing.assert_allclose(found.high - found.value, [2.054, 0.0], atol=0.01)
    np.testing.assert_allclose(found.value - found.low, [2.054, 0.0], atol=0.01)


def test_what_pairs_have_in_common_cancels_in_their_ratio() -> None:
    below = np.random.default_rng(0).uniform(1.0, 9.0, 20)
    found = root_ratio_interval(4.0 * below, below)
    assert (found.value, found.low, found.high) == pytest.approx((2.0, 2.0, 2.0))


@pytest.mark.parametrize("shared", [0.0, 0.9])
def test_intervals_of_a_ratio_hold_what_they_promise(shared: float) -> None:
    """Of 2000 intervals, 95 % hold the true ratio, whether the pairs have much in common or not."""
    rng = np.random.default_rng(1)
    common, own_a, own_b = rng.gamma(20.0, 1.0 / 20.0, (3, 2000, 30))
    below = shared * common + (1.0 - shared) * own_a
    above = 2.25 * (shared * common + (1.0 - shared) * own_b)
    found = root_ratio_interval(above, below)
    held = np.mean((found.low <= 1.5) & (found.high >= 1.5))
    assert held == pytest.approx(0.95, abs=0.02)


def test_one_run_has_no_interval() -> None:
    for found in (mean_interval(np.ones((2, 1))), root_ratio_interval(np.ones((2, 1)), np.ones(1))):
        np.testing.assert_array_equal(found.value, [1.0, 1.0])
        assert np.isnan([found.low, found.high]).all()


# --- Errors --------------------------------------------------------------------------------------


def test_errors_are_against_the_truth_after_each_step() -> None:
    truth = np.zeros((3, 2, 3))
    truth[:, 0] = [[9.0, 9.0, 9.0], [1.0, 2.0, 3.1], [4.0, 5.0, -3.1]]
    mean = np.zeros((2, 4, 2, 3))
    mean[:, :, 0] = np.array([[1.5, 1.0, -3.1], [4.0, 5.0, 3.1]])[:, None]
    covariance = np.tile(np.diag([0.25, 4.0, 1.0]), (2, 4, 2, 1, 1))
    track = Estimates(mean, covariance, np.full((2, 4, 2), 7.0), np.full((2, 4, 2), 2.0))
    found = compare(track, truth)
    turn = 2.0 * math.pi - 6.2
    np.testing.assert_allclose(found.error[0, :, 0], [[0.5, -1.0, turn]] * 4)
    np.testing.assert_allclose(found.error[1, :, 0], [[0.0, 0.0, -turn]] * 4)
    np.testing.assert_allclose(found.error[:, :, 1], 0.0)
    np.testing.assert_allclose(found.nees[0, :, 0], 1.0 + 0.25 + turn**2)
    np.testing.assert_allclose(found.nees[:, :, 1], 0.0)
    assert (found.nis[0, 0, 0], found.degrees_of_freedom[0, 0, 0]) == (7.0, 2.0)


def test_nees_uses_the_whole_covariance() -> None:
    """P = [[2, 1], [1, 2]] in x, y: P^-1 = [[2, -1], [-1, 2]] / 3; e = (1, 1, 0): 2 / 3."""
    P = np.array([[2.0, 1.0, 0.0], [1.0, 2.0, 0.0], [0.0, 0.0, 1.0]])
    ones = np.ones((1, 1))
    track = Estimates(np.array([[[1.0, 1.0, 0.0]]]), P[None, None], ones, ones)
    assert compare(track, np.zeros((2, 1, 3))).nees == pytest.approx(2.0 / 3.0)


# --- Scores --------------------------------------------------------------------------------------


def test_rmse_is_the_mean_over_the_runs_and_the_ratio_that_of_all_together() -> None:
    """Runs of RMSE 0.1 and 0.7 in x: mean 0.4; together sqrt((0.01 + 0.49) / 2) = 0.5."""
    error = np.zeros((4, 2, 3))
    error[:, 0, 0], error[:, 1, 0] = 0.1, -0.7
    error[:, :, 1] = np.array([0.6, 0.0, 0.0, 0.0])[:, None]
    error[:, :, 2] = 0.2
    best = np.full((4, 2, 3), 0.1)
    found = score(errors_of(error), errors_of(best), WHOLE)
    np.testing.assert_allclose(found.rmse.value, [0.4, 0.3, 0.2])
    np.testing.assert_allclose(found.ratio.value, [5.0, 3.0, 2.0])
    assert found.rmse.low[0] < 0.4 < found.rmse.high[0]
    np.testing.assert_allclose(found.ratio.low[1:], [3.0, 2.0])


def test_only_the_steps_asked_for_count() -> None:
    error = np.arange(1.0, 7.0)[:, None, None] * np.ones((6, 2, 3))
    found = score(errors_of(error), errors_of(np.ones((6, 2, 3))), slice(2, 4))
    np.testing.assert_allclose(found.rmse.value, math.sqrt((9.0 + 16.0) / 2.0))
    np.testing.assert_allclose(rms_over_runs(errors_of(error))[:, 0], np.arange(1.0, 7.0))


def test_batches_are_scored_one_by_one() -> None:
    rng = np.random.default_rng(5)
    error, best = rng.standard_normal((9, 3, 4, 3)), rng.standard_normal((9, 4, 3))
    together = score(errors_of(error), errors_of(best), WHOLE)
    for index in range(3):
        alone = score(errors_of(error[:, index]), errors_of(best), WHOLE)
        for one, other in (
            (together.rmse, alone.rmse),
            (together.ratio, alone.ratio),
            (together.nees, alone.nees),
        ):
            for a, b in zip(one, other, strict=True):
                np.testing.assert_allclose(a[index], b)
        np.testing.assert_allclose(together.nis_band[index], alone.nis_band)
        assert together.diverged[index] == alone.diverged


def test_an_honest_covariance_is_inside_its_bands_and_others_are_not() -> None:
    rng = np.random.default_rng(6)
    chi_square = rng.chisquare(3.0, (400, 3, 50)) * np.array([1.0, 1.3, 0.7])[None, :, None]
    error, best = np.ones((400, 3, 50, 3)), np.ones((400, 50, 3))
    errors = Errors(error, chi_square, chi_square, np.full((400, 3, 50), 3.0))
    found = score(errors, errors_of(best), WHOLE)
    np.testing.assert_allclose(found.nees.value, [3.0, 3.9, 2.1], rtol=0.02)
    assert found.nees_inside[0] == pytest.approx(0.95, abs=0.04)
    assert np.all(found.nees_inside[1:] < 0.6)
    low, high = np.moveaxis(found.nis_band, -1, 0)
    assert ((low < found.nis) & (found.nis < high)).tolist() == [True, False, False]
    assert found.nees_band == pytest.approx((3.0 * 117.985 / 150.0, 3.0 * 185.8 / 150.0), rel=2e-3)


def test_nis_counts_what_was_measured() -> None:
    """Runs that measure 3 rows and 1 row: (6 + 1) / (3 + 1); and one that measures none."""
    errors = errors_of(np.ones((5, 2, 3)))
    errors = errors._replace(
        nis=np.tile([6.0, 1.0], (5, 1)), degrees_of_freedom=np.tile([3.0, 1.0], (5, 1))
    )
    assert score(errors, errors, WHOLE).nis == pytest.approx(7.0 / 4.0)
    blind = errors_of(np.ones((5, 2, 3)), nis=0.0, dof=0.0)
    assert np.isnan(score(blind, errors, WHOLE).nis)


def test_runs_that_were_lost_once_have_diverged() -> None:
    best = np.zeros((10, 4, 3))
    best[...] = [0.03, 0.04, 0.1]  # 0.05 m
    error = best.copy()
    error[3, 1, :2] = [0.0, -0.99 * LOST_FACTOR * 0.05]
    error[3, 2, :2] = [0.8 * 1.01 * LOST_FACTOR * 0.05, 0.6 * 1.01 * LOST_FACTOR * 0.05]
    error[7, 3, 0] = math.nan
    found = score(errors_of(error), errors_of(best), WHOLE)
    assert found.diverged == 0.5
    assert score(errors_of(error), errors_of(best), slice(4, 7)).diverged == 0.0
