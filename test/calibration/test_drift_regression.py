# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The regression with drift against generalized least squares with the whole covariance."""

import numpy as np
import pytest

from fnn_ekf_ros.calibration.drift_regression import (
    Drift,
    fit_drifting,
    fit_with,
    fit_with_instruments,
    profile,
    smoothed,
)
from fnn_ekf_ros.core.arrays import FloatArray

RATIO = 0.3


def uneven_times(rng: np.random.Generator, count: int) -> FloatArray:
    return np.cumsum(rng.uniform(0.1, 1.0, count))


def dense_covariance(times: FloatArray, weights: FloatArray) -> FloatArray:
    """Return the covariance of drift plus noise in units of r; the drift's start is unknown."""
    elapsed = times - times[0]
    return RATIO * np.minimum.outer(elapsed, elapsed) + np.diag(1.0 / weights)


def test_it_is_generalized_least_squares_with_the_whole_covariance() -> None:
    rng = np.random.default_rng(1)
    times, weights = uneven_times(rng, 60), rng.uniform(0.1, 1.0, 60)
    columns, readings = rng.standard_normal((60, 1, 2)), rng.standard_normal((60, 1))
    drift = Drift(times, np.arange(60) == 0, weights, RATIO)
    fit = fit_with(drift, readings, columns)
    design = np.column_stack([np.ones(60), columns[:, 0]])  # the unknown start is a constant
    inverse = np.linalg.inv(dense_covariance(times, weights))
    expected = np.linalg.solve(design.T @ inverse @ design, design.T @ inverse @ readings[:, 0])
    assert fit.coefficients == pytest.approx(expected[1:], rel=1e-9)
    left = readings[:, 0] - design @ expected
    variance = left @ inverse @ left / (60 - 3)
    model = variance * np.linalg.inv(design.T @ inverse @ design)[1:, 1:]
    assert np.linalg.eigvalsh(fit.covariance - model).min() > -1e-9 * np.trace(model)


def test_the_smoothed_drift_is_the_conditional_mean() -> None:
    rng = np.random.default_rng(2)
    times, weights = uneven_times(rng, 40), rng.uniform(0.1, 1.0, 40)
    readings = rng.standard_normal(40)
    drift = Drift(times, np.arange(40) == 0, weights, RATIO)
    noise = np.diag(1.0 / weights)
    whole = dense_covariance(times, weights)
    inverse = np.linalg.inv(whole)
    one = np.ones(40)
    start = (one @ inverse @ readings) / (one @ inverse @ one)
    expected = start + (whole - noise) @ inverse @ (readings - start)
    assert smoothed(drift, readings) == pytest.approx(expected, abs=1e-9)


def test_a_break_starts_the_drift_anew() -> None:
    rng = np.random.default_rng(3)
    times, column = uneven_times(rng, 80), np.cumsum(rng.standard_normal(80))
    readings = 0.7 * column + 0.01 * rng.standard_normal(80)
    readings[40:] += 500.0
    breaks = np.zeros(80, dtype=np.bool_)
    with_break = breaks.copy()
    with_break[40] = True
    fit = fit_drifting(times, readings[:, None], column[:, None, None], with_break)
    assert fit.coefficients[0] == pytest.approx(0.7, abs=0.005)


def test_noise_and_drift_are_told_apart_and_outliers_do_not_matter() -> None:
    rng = np.random.default_rng(4)
    times = 0.2 * np.arange(1500)
    column = np.cumsum(rng.standard_normal(1500))
    drift = np.cumsum(0.05 * np.sqrt(0.2) * rng.standard_normal(1500))
    readings = 0.3 * column + drift + 0.1 * rng.standard_normal(1500)
    readings[rng.random(1500) < 0.1] += 5.0
    fit = fit_drifting(times, readings[:, None], column[:, None, None], np.zeros(1500, np.bool_))
    assert abs(fit.coefficients[0] - 0.3) < 4.0 * np.sqrt(fit.covariance[0, 0])
    assert np.sqrt(fit.covariance[0, 0]) < 0.01
    assert fit.noise_std == pytest.approx(0.1, rel=0.25)
    assert fit.noise_std * np.sqrt(fit.drift.ratio) == pytest.approx(0.05, rel=0.6)


def test_the_profile_is_the_likelihood_of_each_set_of_columns() -> None:
    rng = np.random.default_rng(5)
    times = uneven_times(rng, 50)
    readings = rng.standard_normal((50, 2))
    sets = rng.standard_normal((3, 50, 2, 2))
    drift = Drift(times, np.arange(50) == 0, np.ones(50), RATIO)
    expected = [fit_with(drift, readings, columns).log_likelihood for columns in sets]
    assert profile(drift, readings, sets) == pytest.approx(expected, rel=1e-9)


def feedback_drive(rng: np.random.Generator, count: int) -> tuple[FloatArray, FloatArray]:
    """Return travel of a driver who steers past slips back, and a yaw: a coefficient of 1."""
    travel, yaw, course, seen = np.zeros(count), np.zeros(count), 0.0, 0.0
    rate = 0.0
    for k in range(1, count):
        if k % 30 == 0:
            rate = float(rng.uniform(-0.08, 0.08))
        course += rate
        turn = rate + 0.2 * (course - seen)
        travel[k] = travel[k - 1] + turn
        seen += turn + 0.05 * rng.standard_normal()
        yaw[k] = seen
    return travel, yaw


def test_instruments_are_right_where_feedback_biases_least_squares() -> None:
    plain, with_instruments = [], []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        travel, yaw = feedback_drive(rng, 1500)
        times = 0.1 * np.arange(1500)
        readings = (yaw + 0.15 * rng.standard_normal(1500))[:, None]
        columns = travel[:, None, None]
        fit = fit_drifting(times, readings, columns, np.zeros(1500, np.bool_))
        plain.append(fit.coefficients[0])
        found, covariance = fit_with_instruments(fit.drift, readings, columns, columns)
        with_instruments.append((found[0] - 1.0) / np.sqrt(covariance[0, 0]))
    assert np.mean(plain) < 0.95
    assert abs(np.mean(with_instruments)) < 1.0
    assert np.max(np.abs(with_instruments)) < 3.5
