# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Covariances at the edge of what double precision holds."""

from collections.abc import Callable

import numpy as np
import pytest

from fnn_ekf_ros.core.arrays import FloatArray, components_first, components_last
from fnn_ekf_ros.core.bank import (
    Bank,
    Noise,
    Readings,
    correct,
    innovate,
    noise_of_readings,
    predict,
)
from fnn_ekf_ros.core.covariance import limit_uncertainty
from fnn_ekf_ros.core.limits import CORRELATION_MARGIN, LARGEST_POSE_STD
from fnn_ekf_ros.core.motion import MotionModel

FILTERS, STEPS = 800, 150
STATE_OF_ROW = [0, 1, 2, 2]


def log_uniform(rng: np.random.Generator, low: float, high: float, *shape: int) -> FloatArray:
    return np.exp(rng.uniform(np.log(low), np.log(high), shape))


def reports(rng: np.random.Generator) -> FloatArray:
    """Return usable covariances of fixes, with nearly singular correlations among them."""
    half = rng.normal(size=(FILTERS, 3, 3))
    C = half @ np.swapaxes(half, 1, 2)
    std = np.sqrt(np.diagonal(C, axis1=1, axis2=2))
    C = (1.0 - 1e-6) * C / std[:, :, None] / std[:, None, :] + 1e-6 * np.eye(3)
    reported = log_uniform(rng, 1e-4, 1e3, FILTERS, 3)
    return components_first(C * reported[:, :, None] * reported[:, None, :], 2)


@pytest.mark.parametrize("reported", [False, True])
@pytest.mark.slow
def test_the_worst_wheels_with_the_best_sensors_stay_positive_definite(reported: bool) -> None:
    """Everything that parameters and messages allow: 1e3 of one kind with 1e-4 of another."""
    rng = np.random.default_rng(3)
    Q = np.where(rng.random((2, 1, FILTERS)) < 0.7, 1e6, 1e-8)
    R = np.where(rng.random((4, 1, FILTERS)) < 0.7, 1e-8, 1e6)
    reference = (1e6,) * 4 if reported else (1.0,) * 4
    still = np.zeros((3, 1, FILTERS))
    P = np.broadcast_to(np.eye(3)[:, :, None, None], (3, 3, 1, FILTERS))
    share = np.array([0.6, 0.6, 0.7, 0.2])[:, None]
    for _ in range(STEPS):
        control = rng.normal(size=(2, FILTERS)) * log_uniform(rng, 1e-3, 10.0, 2, FILTERS)
        control[1] = np.clip(control[1], -3.0, 3.0)
        available = rng.random((4, FILTERS)) < share
        predicted = predict(MotionModel.EXACT_ARC, Bank(still, P), control, Q)
        fix = reports(rng) if reported else None
        noise = noise_of_readings(Noise(Q, R), reference, fix, available)
        readings = Readings(predicted.mean[STATE_OF_ROW, 0], available)
        seen = innovate(predicted, readings, noise.measurement)
        P = correct(predicted, seen, noise, available).bank.covariance
        assert P.tobytes() == np.swapaxes(P, 0, 1).tobytes()
        assert np.all(np.linalg.eigvalsh(components_last(P, 2))[..., 0] > 0.0)


def test_ordinary_covariances_come_back_as_they_are() -> None:
    """And beside vague ones in a batch, too."""
    ordinary = np.array([[90.0**2, 5.0, 0.1], [5.0, 1.0, 0.2], [0.1, 0.2, 0.9]])
    assert limit_uncertainty(ordinary) is ordinary
    vague = ordinary * 1e6
    batch = limit_uncertainty(np.stack([ordinary, vague], axis=-1))
    np.testing.assert_array_equal(batch[..., 0], ordinary)
    np.testing.assert_allclose(np.sqrt(np.diag(batch[..., 1])), LARGEST_POSE_STD)
    std = np.sqrt(np.diag(vague))
    kept = batch[..., 1] / np.outer(LARGEST_POSE_STD, LARGEST_POSE_STD)
    np.testing.assert_allclose(kept, vague / np.outer(std, std), rtol=1e-11)


@pytest.mark.parametrize("axis", range(3))
def test_each_component_has_its_own_limit(axis: int) -> None:
    """Of a pose that is lost in one of them the others stay."""
    std = np.array([1.0, 2.0, 0.5])
    std[axis] = 3.0 * LARGEST_POSE_STD[axis]
    correlation = np.array([[1.0, 0.5, -0.3], [0.5, 1.0, 0.2], [-0.3, 0.2, 1.0]])
    limited = limit_uncertainty((correlation * np.outer(std, std))[:, :, None, None])
    assert limited.shape == (3, 3, 1, 1)
    std[axis] = LARGEST_POSE_STD[axis]
    np.testing.assert_allclose(limited[:, :, 0, 0], correlation * np.outer(std, std), rtol=1e-11)
    assert limited.tobytes() == np.swapaxes(limited, 0, 1).tobytes()


def test_what_is_limited_stays_exactly_symmetric(
    random_covariances: Callable[[np.random.Generator, int, int], FloatArray],
) -> None:
    rng = np.random.default_rng(31)
    std = np.array([3e3, 2e3, 30.0]) * rng.uniform(0.5, 2.0, (200, 3))
    covariances = random_covariances(rng, 200, 3) * std.T[:, None] * std.T[None]
    limited = limit_uncertainty(0.5 * (covariances + covariances.swapaxes(0, 1)))
    assert np.any(limited != covariances)
    np.testing.assert_array_equal(limited, limited.swapaxes(0, 1))


def test_a_singular_covariance_of_a_vague_pose_keeps_its_margin() -> None:
    direction = np.array([300.0, 400.0, 2.0])
    limited = limit_uncertainty(np.outer(direction, direction))
    correlation = limited / np.outer(direction, direction)
    np.testing.assert_allclose(np.diag(correlation), 1.0, rtol=1e-15)
    np.testing.assert_allclose(1.0 - correlation[0, 1], CORRELATION_MARGIN, rtol=1e-3)
    np.linalg.cholesky(limited)
