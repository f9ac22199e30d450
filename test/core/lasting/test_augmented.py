# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Filters whose state holds lasting errors, against a textbook filter of seven states."""

import math

import numpy as np
import pytest
from augmented_ekf import (
    H_FIX,
    H_YAW,
    Gaussian,
    assert_semidefinite,
    of_filter,
    predicted,
    random_bank,
)
from banks import BOTH_MODELS, Covariances

from fnn_ekf_ros.core.bank import Bank, predict
from fnn_ekf_ros.core.lasting.augmented import (
    ERRORS,
    POSE,
    Component,
    at_pose,
    kept_by_errors,
    observe,
    predict_augmented,
)
from fnn_ekf_ros.core.limits import LARGEST_POSE_STD
from fnn_ekf_ros.core.motion import MotionModel

ALL_ERRORS, NO_ERROR, ONLY_OF_FIXES, ONLY_OF_YAWS = (3, 4, 5, 6), (), (3, 4), (5, 6)
WHICH_ERRORS = pytest.mark.parametrize(
    "errors", [ALL_ERRORS, NO_ERROR, ONLY_OF_FIXES, ONLY_OF_YAWS]
)


@BOTH_MODELS
@WHICH_ERRORS
def test_prediction_is_the_textbooks(
    model: MotionModel, errors: tuple[int, ...], random_covariances: Covariances
) -> None:
    rng = np.random.default_rng(1)
    filters, robots = 3, 4
    bank = random_bank(rng, random_covariances, filters, (robots,), errors)
    control = np.stack([rng.uniform(-0.5, 0.5, robots), rng.uniform(0.2, 0.6, robots)])
    Q = rng.uniform(1e-4, 1e-2, (2, filters, robots))
    kept = kept_by_errors(2.5, 10.0)
    added = rng.uniform(0.0, 0.2, (4, filters, robots))
    found = predict_augmented(model, bank, control, Q, kept.behind(2), added)
    assert_semidefinite(found.covariance)
    for k in range(filters):
        for n in range(robots):
            mean, P = predicted(
                of_filter(bank, k, n), control[:, n], Q[:, k, n], kept.behind(0), added[:, k, n],
                paper_model=model is MotionModel.PAPER,
            )  # fmt: skip
            np.testing.assert_allclose(found.mean[:, k, n], mean, atol=1e-12)
            np.testing.assert_allclose(found.covariance[:, :, k, n], P, atol=1e-8)


def test_errors_keep_what_the_time_constant_says() -> None:
    phi = math.exp(-2.5 / 10.0)
    assert kept_by_errors(2.5, 10.0).behind(0).tolist() == [phi, phi, phi, 1.0]


def test_pose_of_filters_without_errors_is_that_of_the_bank(
    random_covariances: Covariances,
) -> None:
    """Bit for bit: a white member is an ordinary filter."""
    rng = np.random.default_rng(2)
    bank = random_bank(rng, random_covariances, 4, (5,), NO_ERROR)
    control, Q = rng.uniform(-0.3, 0.3, (2, 5)), rng.uniform(1e-4, 1e-2, (2, 4, 5))
    found = predict_augmented(
        MotionModel.EXACT_ARC, bank, control, Q, kept_by_errors(1.0, 10.0).behind(2),
        np.zeros((4, 4, 5)),
    )  # fmt: skip
    plain = predict(
        MotionModel.EXACT_ARC, Bank(bank.mean[POSE], bank.covariance[POSE, POSE]), control, Q
    )
    assert found.mean[:2].tobytes() == plain.mean[:2].tobytes()
    assert found.covariance[POSE, POSE].tobytes() == plain.covariance.tobytes()
    assert not found.covariance[ERRORS].any()
    assert not found.mean[ERRORS].any()


def test_yaws_are_wrapped(random_covariances: Covariances) -> None:
    bank = random_bank(np.random.default_rng(3), random_covariances, 1, (1,))
    bank.mean[Component.YAW] = 3.1
    found = predict_augmented(
        MotionModel.EXACT_ARC, bank, np.array([[0.1], [0.2]]), np.full((2, 1, 1), 1e-4),
        kept_by_errors(1.0, 10.0).behind(2), np.zeros((4, 1, 1)),
    )  # fmt: skip
    assert found.mean[Component.YAW, 0, 0] == pytest.approx(3.3 - 2.0 * math.pi)


def test_pose_that_is_almost_lost_keeps_its_correlations_with_errors(
    random_covariances: Covariances,
) -> None:
    """Limited as in the bank: pose and errors stay a covariance."""
    rng = np.random.default_rng(4)
    bank = random_bank(rng, random_covariances, 1, (3,))
    scale = np.ones((7, 1, 3))
    scale[:3] = 1e3 * np.array(LARGEST_POSE_STD)[:, None, None]
    P = bank.covariance * scale[:, None] * scale[None]
    found = predict_augmented(
        MotionModel.EXACT_ARC, Bank(bank.mean, P), np.array([[0.1], [0.2]]) * np.ones(3),
        np.full((2, 1, 3), 1e-4), kept_by_errors(0.0, 10.0).behind(2), np.zeros((4, 1, 3)),
    ).covariance  # fmt: skip
    for k, largest in enumerate(LARGEST_POSE_STD):
        assert np.all(found[k, k] <= largest**2 * (1.0 + 1e-9))
    assert_semidefinite(found)

    def correlation(C: np.ndarray) -> np.ndarray:
        return C[2, 5] / np.sqrt(C[2, 2] * C[5, 5])

    np.testing.assert_allclose(correlation(found), correlation(P), rtol=1e-6)


@WHICH_ERRORS
def test_observation_is_the_textbooks(
    errors: tuple[int, ...], random_covariances: Covariances
) -> None:
    bank = random_bank(np.random.default_rng(5), random_covariances, 3, (2,), errors)
    found = observe(bank)
    H = np.vstack([H_FIX, H_YAW])
    for k in range(3):
        for n in range(2):
            x, P = of_filter(bank, k, n)
            np.testing.assert_allclose(found.expected[:, k, n], H @ x, atol=1e-14)
            np.testing.assert_allclose(found.covariance[:, :, k, n], H @ P @ H.T, atol=1e-13)


def test_pose_of_readings_has_their_errors() -> None:
    """x is known no better than the fix's noise and its lasting error; x + b_x is as the fix."""
    pose = Bank(np.array([1.0, 2.0, 0.5])[:, None], np.diag([0.01, 0.02, 0.03])[:, :, None])
    variances = np.array([0.5, 0.6, 0.07, 0.08])[:, None]
    found = at_pose(pose, variances, from_readings=True)
    assert found.mean[:, 0].tolist() == [1.0, 2.0, 0.5, 0.0, 0.0, 0.0, 0.0]
    P = found.covariance[..., 0]
    np.testing.assert_allclose(np.diag(P), [0.51, 0.62, 0.18, 0.5, 0.6, 0.07, 0.08])
    assert (P[0, 3], P[1, 4], P[2, 5], P[2, 6]) == (-0.5, -0.6, -0.07, -0.08)
    np.testing.assert_allclose(
        observe(found).covariance[..., 0], np.diag([0.01, 0.02, 0.03]), atol=1e-15
    )
    assert_semidefinite(found.covariance)


def test_pose_from_elsewhere_has_no_errors_of_sensors() -> None:
    pose = Bank(np.array([1.0, 2.0, 0.5])[:, None], np.diag([0.01, 0.02, 0.03])[:, :, None])
    found = at_pose(pose, np.array([0.5, 0.6, 0.07, 0.08])[:, None], from_readings=False)
    expected = np.diag([0.01, 0.02, 0.03, 0.5, 0.6, 0.07, 0.08])
    assert np.array_equal(found.covariance[..., 0], expected)


def test_textbook_filter_is_one() -> None:
    """Its Jacobians: of a straight line almost, the shear is dS."""
    start = Gaussian(np.zeros(7), np.diag([0.0, 0, 1, 0, 0, 0, 0]))
    found = predicted(
        start, np.array([2.0, 1e-4]), np.zeros(2), np.ones(4), np.zeros(4), paper_model=False
    )
    assert found.covariance[1, 1] == pytest.approx(4.0, rel=1e-3)
