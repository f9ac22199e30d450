"""Covariances at the edge of what double precision holds."""

import numpy as np
import pytest

from fnn_ekf_ros.core.arrays import FloatArray
from fnn_ekf_ros.core.covariance import limit_uncertainty
from fnn_ekf_ros.core.kalman import innovate, update
from fnn_ekf_ros.core.motion import MotionModel
from fnn_ekf_ros.core.plant import Plant, StepInput, noise_matrix, predict

FILTERS, STEPS = 800, 150
UNIT = (1.0, 1.0, 1.0, 1.0)


def log_uniform(rng: np.random.Generator, low: float, high: float, *shape: int) -> FloatArray:
    return np.exp(rng.uniform(np.log(low), np.log(high), shape))


def reports(rng: np.random.Generator) -> FloatArray:
    """Return usable covariances of all rows, with nearly singular correlations among them."""
    half = rng.normal(size=(FILTERS, 4, 4))
    C = half @ np.swapaxes(half, 1, 2)
    std = np.sqrt(np.diagonal(C, axis1=1, axis2=2))
    C = (1.0 - 1e-6) * C / std[:, :, None] / std[:, None, :] + 1e-6 * np.eye(4)
    reported = log_uniform(rng, 1e-4, 1e3, FILTERS, 4)
    return C * reported[:, :, None] * reported[:, None, :]


@pytest.mark.parametrize("reported", [False, True])
def test_the_worst_wheels_with_the_best_sensors_stay_positive_definite(reported: bool) -> None:
    """Everything that parameters and messages allow: 1e3 of one kind with 1e-4 of another."""
    rng = np.random.default_rng(3)
    Q = np.where(rng.random((FILTERS, 2)) < 0.7, 1e6, 1e-8)
    R = np.where(rng.random((FILTERS, 4)) < 0.7, 1e-8, 1e6)
    start = np.ones(4) if not reported else np.full(4, 1e6)
    plant = Plant(MotionModel.EXACT_ARC, 1.0, tuple(start))
    mean, P = np.zeros((FILTERS, 3)), np.broadcast_to(np.eye(3), (FILTERS, 3, 3))
    for _ in range(STEPS):
        control = rng.normal(size=(FILTERS, 2)) * log_uniform(rng, 1e-3, 10.0, FILTERS, 2)
        control[:, 1] = np.clip(control[:, 1], -3.0, 3.0)
        available = rng.random((FILTERS, 4)) < (0.6, 0.6, 0.7, 0.2)
        period = StepInput(
            control, np.zeros((FILTERS, 4)), available, None, reports(rng) if reported else None
        )
        ahead, spread = predict(plant, np.zeros_like(mean), P, Q, control)
        noise = noise_matrix(plant, R, period)
        z = ahead[:, [0, 1, 2, 2]]
        seen = innovate(ahead, spread, z, noise, available)
        mean, P = update(ahead, spread, noise, available, seen)
        assert np.all(np.linalg.eigvalsh(P)[:, 0] > 0.0)


def test_ordinary_covariances_come_back_as_they_are() -> None:
    """And beside vague ones in a batch, too."""
    ordinary = np.array([[90.0**2, 5.0, 0.1], [5.0, 1.0, 0.2], [0.1, 0.2, 0.9]])
    assert limit_uncertainty(ordinary) is ordinary
    vague = ordinary * 1e6
    batch = limit_uncertainty(np.stack([ordinary, vague]))
    np.testing.assert_array_equal(batch[0], ordinary)
    np.testing.assert_allclose(np.sqrt(np.diag(batch[1])), [1e3, 1e3, 10.0])
    std = np.sqrt(np.diag(vague))
    kept = batch[1] / np.outer([1e3, 1e3, 10.0], [1e3, 1e3, 10.0])
    np.testing.assert_allclose(kept, vague / np.outer(std, std), rtol=1e-11)


def test_a_scale_makes_no_report_better_than_any_sensor_is() -> None:
    plant = Plant(MotionModel.EXACT_ARC, 1.0, UNIT)
    period = StepInput(
        np.zeros(2), np.zeros(4), np.array([True, True, False, False]), None,
        np.diag([1e-6, 1e-2, 1.0, 1.0]),
    )  # fmt: skip
    R = noise_matrix(plant, np.full(4, 1e-4), period)
    np.testing.assert_allclose(np.diag(R), [1e-8, 1e-6, 1e-4, 1e-4])
