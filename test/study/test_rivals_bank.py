# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The bank of filters against independent textbook filters and the product of their likelihoods."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from textbook_ekf import textbook_step

from fnn_ekf_ros.core.arrays import FloatArray, Row
from fnn_ekf_ros.core.bank import Bank, Noise, Readings, correct, innovate
from fnn_ekf_ros.core.motion import MotionModel
from fnn_ekf_ros.study.recording import Recording, Start
from fnn_ekf_ros.study.rivals import multiple_model
from fnn_ekf_ros.study.rivals.multiple_model import MultipleModelSettings

SMALL_BANK = MultipleModelSettings((0.2, 1.0, 5.0), (0.2, 1.0, 5.0))
ALONE = MultipleModelSettings((1.0,), (1.0,))


def wander(steps: int, seed: int) -> tuple[Recording, Start]:
    """Return what one robot that meets with larger errors than assumed may have said."""
    rng = np.random.default_rng(seed)
    control = np.stack([np.full(steps, 0.11), rng.uniform(0.01, 0.05, steps)], axis=-1)[:, None]
    heading = np.cumsum(control[..., 1], axis=0)
    x, y = np.cumsum(0.11 * np.cos(heading), axis=0), np.cumsum(0.11 * np.sin(heading), axis=0)
    z = np.stack([x, y, heading, heading], axis=-1) + rng.normal(size=(steps, 1, 4)) * 0.2
    available = rng.random((steps, 1, 4)) < 0.7
    Q, R = np.array([1e-4, 1e-4]), np.array([0.01, 0.02, 0.03, 0.04])
    recording = Recording(
        0.375, np.zeros((steps + 1, 1, 3)), control, np.where(available, z, np.nan), available,
        np.tile(Q, (steps, 1)), np.tile(R, (steps, 1)),
    )  # fmt: skip
    return recording, Start(np.array([[0.1, -0.1, 0.2]]), np.diag([0.01, 0.01, 0.02]), Q, R)


def textbook_bank(
    step: Any, recording: Recording, start: Start, settings: MultipleModelSettings
) -> list[tuple[FloatArray, FloatArray, float]]:
    """Return (mean, covariance, nis) of independent filters weighted by their likelihoods."""
    scales = [(q, k) for q in settings.process_scales for k in settings.measurement_scales]
    filters = [(start.mean[0], start.covariance) for _ in scales]
    weights = np.full(len(scales), 1.0 / len(scales))
    said = []
    for k in range(len(recording.control)):
        u, z = recording.control[k, 0], recording.measurement[k, 0]
        rows = [int(i) for i in np.flatnonzero(recording.available[k, 0])]
        likelihoods, innovations, variances = [], [], []
        for i, (q, s) in enumerate(scales):
            Q, R = np.diag(q * start.process_noise), np.diag(s * start.measurement_noise)
            x, P = step(False, *filters[i], u, Q, z, R, [])
            H = np.eye(3)[[0, 1, 2, 2]][rows]
            r = z[rows] - H @ x
            r = np.where(np.array(rows) >= Row.COMPASS_YAW, np.arctan2(np.sin(r), np.cos(r)), r)
            S = H @ P @ H.T + R[np.ix_(rows, rows)]
            density = math.exp(-0.5 * r @ np.linalg.inv(S) @ r)
            likelihoods.append(density / math.sqrt(np.linalg.det(2.0 * math.pi * S)))
            innovations.append(r)
            variances.append(S)
            filters[i] = step(False, *filters[i], u, Q, z, R, rows)
        r = sum(w * v for w, v in zip(weights, innovations, strict=True))
        S = sum(
            w * (V + np.outer(v - r, v - r))
            for w, v, V in zip(weights, innovations, variances, strict=True)
        )
        weights = weights * likelihoods / np.sum(weights * likelihoods)
        weights = np.maximum(weights, settings.smallest_weight)
        weights = weights / np.sum(weights)
        x = sum(w * m for w, (m, _) in zip(weights, filters, strict=True))
        P = sum(
            w * (V + np.outer(m - x, m - x)) for w, (m, V) in zip(weights, filters, strict=True)
        )
        said.append((x, P, float(r @ np.linalg.inv(S) @ r)))
    return said


@pytest.mark.parametrize(
    "settings",
    [SMALL_BANK, replace(SMALL_BANK, smallest_weight=0.03), ALONE],
    ids=["bank", "floor", "alone"],
)
def test_the_bank_is_independent_filters_weighted_by_their_likelihoods(
    settings: MultipleModelSettings,
) -> None:
    recording, start = wander(40, 8)
    track = multiple_model.run(MotionModel.EXACT_ARC, recording, start, settings)
    for k, (x, P, nis) in enumerate(textbook_bank(textbook_step, recording, start, settings)):
        np.testing.assert_allclose(track.mean[k, 0], x, atol=1e-9)
        np.testing.assert_allclose(track.covariance[k, 0], P, rtol=1e-7, atol=1e-12)
        assert track.nis[k, 0] == pytest.approx(nis, rel=1e-7, abs=1e-12)
        assert track.degrees_of_freedom[k, 0] == np.sum(recording.available[k])


def test_the_mixture_averages_angles_across_the_wrap() -> None:
    mean = np.array([[1.0, 3.0], [0.0, 0.0], [math.pi - 0.1, -math.pi + 0.3]])
    x, P = multiple_model.mixture(np.array([0.75, 0.25]), Bank(mean, np.zeros((3, 3, 2))))
    np.testing.assert_allclose(x[:, 0], [1.5, 0.0, math.pi], atol=1e-12)
    np.testing.assert_allclose(P[[0, 0, 2], [0, 2, 2], 0], [0.75, 0.15, 0.03], atol=1e-12)


def test_the_mixture_measures_angles_from_the_likeliest_filter() -> None:
    mean = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [-2.0, 0.0, 2.0]])
    x, _ = multiple_model.mixture(np.array([0.1, 0.6, 0.3]), Bank(mean, np.zeros((3, 3, 3))))
    np.testing.assert_allclose(x[:, 0], [0.0, 0.0, 0.4], atol=1e-12)


@pytest.mark.parametrize("rows", [[], [0], [2, 3], [0, 1, 2], [0, 1, 2, 3]])
def test_the_likelihood_is_the_normal_density_of_the_measured_rows(rows: list[int]) -> None:
    rng = np.random.default_rng(9)
    root, z = rng.normal(size=(3, 3)), rng.normal(size=4)
    P, R = root @ root.T, np.array([0.5, 1.0, 2.0, 3.0])
    H = np.eye(3)[[0, 1, 2, 2]][rows]
    S = H @ P @ H.T + np.diag(R[rows])
    nis = z[rows] @ np.linalg.inv(S) @ z[rows]
    expected = -0.5 * (nis + np.log(np.linalg.det(2.0 * math.pi * S)))
    bank, available = Bank(np.zeros((3, 1)), P[..., None]), np.isin(np.arange(4), rows)
    seen = innovate(bank, Readings(z, available), R[:, None])
    corrected = correct(bank, seen, Noise(np.zeros((2, 1)), R[:, None]), available)
    count = np.array(len(rows))
    density = multiple_model.log_density(corrected.nis, corrected.determinant, count)
    np.testing.assert_allclose(density, [expected], rtol=1e-12)


def test_the_bank_has_the_nine_by_nine_scales_of_the_grid() -> None:
    scales = MultipleModelSettings().process_scales
    np.testing.assert_allclose(np.log(scales) / math.log(5.0), np.linspace(-2.0, 2.0, 9))
    assert scales == MultipleModelSettings().measurement_scales


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"process_scales": ()}, "scales of Q"),
        ({"measurement_scales": (1.0, 0.0)}, "over 0"),
        ({"smallest_weight": -0.1}, "81 filters"),
        ({"smallest_weight": 1.0 / 81.0}, "81 filters"),
    ],
)
def test_banks_that_cannot_be_run_are_refused(wrong: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        MultipleModelSettings(**wrong)
