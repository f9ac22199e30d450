# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Likelihood, derivatives and curvature of tuning, against closed forms and differences."""

import numpy as np
import pytest
from tuning_drives import Noise, drive

from fnn_ekf_ros.core.arrays import FloatArray
from fnn_ekf_ros.core.evidence import CONSISTENT_SCALE, TAIL_DEGREES_OF_FREEDOM
from fnn_ekf_ros.tuning.likelihood import curvature_factors
from fnn_ekf_ros.tuning.objective import slopes, term_values
from fnn_ekf_ros.tuning.quantities import (
    COUNT,
    MEANINGS,
    Quantity,
    bounds,
    coordinates,
    with_coordinates,
)
from fnn_ekf_ros.tuning.search import Point, maximize
from fnn_ekf_ros.tuning.tune import configured

NOISE = (Quantity.DISTANCE, Quantity.ROTATION, Quantity.POSITION, Quantity.COMPASS)


@pytest.mark.parametrize("rows", [1, 2, 3])
def test_curvature_of_the_likelihood_of_gaussian_numbers(rows: int) -> None:
    e = np.random.default_rng(1).standard_normal((400_000, rows))
    nu, c = TAIL_DEGREES_OF_FREEDOM, CONSISTENT_SCALE[rows]

    def mean_likelihood(scale: float, shift: float) -> float:
        q = ((e[:, 0] - shift) ** 2 + (e[:, 1:] ** 2).sum(axis=1)) / scale**2
        return float(np.mean(-rows * np.log(scale) - 0.5 * (nu + rows) * np.log1p(q / c)))

    def curvature(h: float, point: tuple[float, float]) -> float:
        around = [mean_likelihood(np.exp(s * h * point[0]), s * h * point[1]) for s in (-1, 0, 1)]
        return -(around[0] - 2.0 * around[1] + around[2]) / h**2

    w, b = curvature_factors(rows)
    # A step of the log scale changes all log variances by 2.
    by_size = rows * 4.0 * (0.5 - 2.0 * w) - w * (2.0 * rows) ** 2
    assert curvature(0.01, (1.0, 0.0)) == pytest.approx(by_size, rel=0.02)
    assert curvature(0.01, (0.0, 1.0)) == pytest.approx(b, rel=0.02)


def test_gradients_are_differences_of_the_terms() -> None:
    recording = drive(np.random.default_rng(2), 900, Noise(fix_error=0.1))
    values = configured(recording.parameters)
    values[: Quantity.FIX_TIME] = 0.03, 0.03, 0.1, 0.1, 0.1, 0.1
    values[Quantity.YAW_ERROR] = 0.05
    which = (*NOISE, Quantity.FIX_ERROR, Quantity.FIX_TIME, Quantity.YAW_ERROR)
    which = (*which, Quantity.RADIUS, Quantity.SEPARATION, Quantity.OFFSET, Quantity.FIX_DELAY)
    u = coordinates(values, which)
    found = slopes([recording], values, which, u)
    h = 1e-3
    for place in range(len(which)):
        near = np.repeat(u[:, None], 2, axis=1)
        near[place] += [h, -h]
        up, down = term_values([recording], with_coordinates(values, which, near)).T
        np.testing.assert_allclose(
            found.gradient[:, place], (up - down) / (2 * h), rtol=0.06, atol=0.3
        )


def test_information_is_the_expected_curvature_of_next_readings() -> None:
    values = configured(drive(np.random.default_rng(0), 10).parameters)
    values[:4] = 0.02, 0.02, 0.1, 0.1
    u, covariance, information = coordinates(values, NOISE), [], []
    for seed in range(12):
        there = slopes([drive(np.random.default_rng(seed), 400)], values, NOISE, u)
        information.append(there.information[:2].sum(axis=0))
        score = there.timed[0].score[:2].sum(axis=0)
        covariance.append(score.T @ score)
    # Scores of a right model have its information as their covariance, but for the tails.
    ratio = np.diag(np.mean(covariance, axis=0)) / np.diag(np.mean(information, axis=0))
    np.testing.assert_allclose(ratio, 0.95, atol=0.2)


def test_coordinates_and_back() -> None:
    values = np.full(COUNT, 0.6)
    values[Quantity.RATIO] = 0.1
    which = tuple(Quantity)
    u = coordinates(values, which)
    assert with_coordinates(np.zeros(COUNT), which, u[:, None])[:, 0] == pytest.approx(values)
    low, high = bounds(which)
    assert (low < high).all()
    for quantity, least, most in zip(which, low, high, strict=True):
        value = with_coordinates(values, (quantity,), np.array([[least, most]]))[quantity]
        assert value == pytest.approx([MEANINGS[quantity].low, MEANINGS[quantity].high])


def test_the_search_stays_within_bounds_and_finds_the_noise_of_the_fixes() -> None:
    recording = drive(np.random.default_rng(5), 400)
    values = configured(recording.parameters)
    values[[Quantity.DISTANCE, Quantity.ROTATION, Quantity.COMPASS]] = 0.02, 0.02, 0.1
    values[Quantity.POSITION] = 900.0
    which = (Quantity.POSITION,)

    def at(u: FloatArray) -> Point:
        there = slopes([recording], values, which, u)
        return Point(float(there.value[0]), there.gradient[0], there.information[0])

    found = maximize(at, bounds(which), coordinates(values, which))
    assert np.exp(found.coordinate[0]) == pytest.approx(0.1, rel=0.1)
