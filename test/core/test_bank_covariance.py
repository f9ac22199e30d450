# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Covariances of a bank: as large as the errors, symmetric and positive definite."""

import math

import numpy as np
import pytest
from banks import (
    ALL_MASKS,
    BOTH_KINDS,
    FIX,
    STATE_OF_ROW,
    UNIT,
    Covariances,
    H,
    assert_positive_definite,
    assert_symmetric,
    corrected,
    corrected_by,
    full_noise,
    one_filter,
    random_case,
)

from fnn_ekf_ros.core.arrays import FloatArray, components_last
from fnn_ekf_ros.core.bank import Bank, Noise, Readings, noise_of_readings, predict
from fnn_ekf_ros.core.covariance import limit_uncertainty
from fnn_ekf_ros.core.limits import LARGEST_POSE_STD, SMALLEST_STD
from fnn_ekf_ros.core.motion import MotionModel, move

# Quantiles 0.005 and 0.995 of chi-square with 1500 degrees of freedom, found by bisection on the
# regularised incomplete gamma function (Abramowitz and Stegun, 26.4.19).
CHI_SQUARE_1500 = (1362.674, 1644.838)


@BOTH_KINDS
def test_nis_of_right_noise_averages_to_the_number_of_rows(reported: bool) -> None:
    """Innovations drawn from S itself: the mean of chi-square is its degrees of freedom."""
    rng = np.random.default_rng(17)
    P = np.array([[0.3, 0.1, 0.02], [0.1, 0.2, 0.01], [0.02, 0.01, 0.05]])
    fix = np.diag([0.1, 0.2, 0.04])
    if reported:
        fix = np.array([[0.1, 0.08, -0.03], [0.08, 0.2, 0.02], [-0.03, 0.02, 0.04]])
    S = H @ P @ H.T + full_noise(fix, 0.03)
    count = 20_000
    z = rng.multivariate_normal(np.zeros(4), S, count).T
    own = np.broadcast_to(np.array([0.1, 0.2, 0.03, 0.04])[:, None, None], (4, 1, count))
    noise = Noise(np.ones((2, 1, count)), own)
    available = np.ones((4, count), dtype=np.bool_)
    noise = noise_of_readings(
        noise, (0.1, 0.2, 0.03, 0.04), fix[:, :, None] if reported else None, available
    )
    bank = Bank(np.zeros((3, 1, count)), np.broadcast_to(P[:, :, None, None], (3, 3, 1, count)))
    _, taken = corrected_by(bank, Readings(z, available), noise)
    # Variance of chi-square with n degrees of freedom is 2 n.
    assert np.mean(taken.nis) == pytest.approx(4.0, abs=6.0 * math.sqrt(8.0 / count))
    assert np.mean(taken.fix_nis) == pytest.approx(3.0, abs=6.0 * math.sqrt(6.0 / count))


def test_errors_of_many_runs_are_as_large_as_the_covariance_says() -> None:
    """Sampled runs with the assumed noise: sum of NEES inside its chi-square band."""
    rng = np.random.default_rng(20)
    runs, checked_at = 500, (20, 40, 60)
    P0 = np.diag([0.05, 0.05, 0.02]) ** 2
    Q = np.array([0.01, 0.005]) ** 2
    own = np.array([0.03, 0.03, 0.02, 0.03]) ** 2
    fix = np.diag(own[FIX])
    fix[0, 1] = fix[1, 0] = 0.5 * fix[0, 0]
    R = full_noise(fix, own[2])
    noise = Noise(
        np.broadcast_to(Q[:, None, None], (2, 1, runs)),
        np.broadcast_to(own[:, None, None], (4, 1, runs)),
    )
    mean = np.broadcast_to(np.array([0.0, 0.0, 3.0])[:, None], (3, runs))
    truth = mean + rng.multivariate_normal(np.zeros(3), P0, runs).T
    bank = Bank(mean[:, None], np.broadcast_to(P0[:, :, None, None], (3, 3, 1, runs)))
    for i in range(1, max(checked_at) + 1):
        control = np.array([[0.15], [0.1 * math.sin(0.2 * i)]]) * np.ones(runs)
        driven = control + rng.standard_normal((2, runs)) * np.sqrt(Q)[:, None]
        truth = move(MotionModel.EXACT_ARC, truth, driven).mean
        z = truth[STATE_OF_ROW] + rng.multivariate_normal(np.zeros(4), R, runs).T
        available = rng.random((4, runs)) < 0.6
        used = noise_of_readings(noise, tuple(own), fix[:, :, None], available)
        bank = predict(MotionModel.EXACT_ARC, bank, control, noise.process)
        bank = corrected_by(bank, Readings(z, available), used)[1].bank
        if i in checked_at:
            error = bank.mean[:, 0] - truth
            error[2] = np.arctan2(np.sin(error[2]), np.cos(error[2]))
            P = components_last(bank.covariance[:, :, 0], 2)
            nees = np.sum(error.T * np.linalg.solve(P, error.T[..., None])[..., 0], axis=-1)
            assert CHI_SQUARE_1500[0] < np.sum(nees) < CHI_SQUARE_1500[1]


@BOTH_KINDS
def test_covariances_are_exactly_symmetric(random_covariances: Covariances, reported: bool) -> None:
    """Bit for bit, without a mean of the two halves at the end."""
    rng = np.random.default_rng(29)
    bank, noise, readings, fix = random_case(rng, random_covariances, 8)
    for _ in range(5):
        scale = 10.0 ** rng.uniform(-6.0, 3.0, noise.measurement.shape)
        varied = noise._replace(measurement=scale)
        if reported:
            varied = noise_of_readings(varied, UNIT, fix, readings.available)
        control = rng.uniform(-2.0, 2.0, (2, len(ALL_MASKS)))
        predicted = predict(MotionModel.EXACT_ARC, bank, control, noise.process)
        assert_symmetric(predicted.covariance)
        bank = corrected_by(predicted, readings, varied)[1].bank
        assert_symmetric(bank.covariance)


def test_covariance_survives_a_measurement_far_better_than_what_was_known() -> None:
    """Where P- - K H P- loses all its digits: P of 1e8 m^2 meets R of 1e-8 m^2."""
    root = np.array([[1e4, 0.0, 0.0], [7e3, 4e3, 0.0], [0.3, -0.2, 0.1]])
    for mask in ALL_MASKS[1:]:
        bank = one_filter(np.zeros(3), root @ root.T)
        P = corrected(bank, np.zeros(4), np.full(4, 1e-8), np.array(mask))[1].bank.covariance
        assert_symmetric(P)
        assert_positive_definite(P)
        measured = np.array([mask[0], mask[1], mask[2] or mask[3]])
        assert np.all(np.diag(P[..., 0])[measured] < 1.01e-8)
        assert np.all(np.diag(P[..., 0])[measured] > 0.49e-8)


@BOTH_KINDS
def test_poses_that_are_almost_lost_are_found_by_the_best_sensor(reported: bool) -> None:
    """P as large as it may be, nearly singular or not; R as small as any; and again and again."""
    rng = np.random.default_rng(30)
    count = 1000
    std = np.array(LARGEST_POSE_STD) * 10.0 ** rng.uniform(-1.0, 2.0, (count, 3))
    P = limit_uncertainty(nearly_singular(rng, std))[:, :, None]
    R = SMALLEST_STD**2 * 10.0 ** np.maximum(rng.uniform(-6.0, 6.0, (4, 1, count)), 0.0)
    own, bank = Noise(np.zeros((2, 1, count)), R), Bank(np.zeros((3, 1, count)), P)
    for _ in range(10):
        available = rng.random((4, count)) < 0.5
        noise = own
        if reported:
            fix = (1.0 - 1e-6) * nearly_singular(rng, np.ones((count, 3)))
            fix += 1e-6 * np.eye(3)[:, :, None]
            noise = noise_of_readings(own, UNIT, fix, available)
        bank = corrected_by(bank, Readings(np.zeros((4, count)), available), noise)[1].bank
        assert_symmetric(bank.covariance)
        assert_positive_definite(bank.covariance)
        variance = np.einsum("ii...->i...", bank.covariance)[STATE_OF_ROW]
        assert np.all(np.where(available[:, None], variance / R, 0.0) <= 1.0 + 1e-9)


def nearly_singular(rng: np.random.Generator, std: FloatArray) -> FloatArray:
    """Return covariances `(3, 3, count)` of standard deviations `(count, 3)`."""
    count = len(std)
    root = rng.standard_normal((count, 3, 3)) * 10.0 ** rng.uniform(-8.0, 4.0, (count, 1, 3))
    C = root @ np.swapaxes(root, 1, 2)
    scale = std / np.sqrt(np.diagonal(C, axis1=1, axis2=2))
    P = np.moveaxis(C * scale[:, :, None] * scale[:, None], 0, -1)
    return 0.5 * (P + np.swapaxes(P, 0, 1))


@pytest.mark.slow
def test_covariance_stays_positive_definite_over_a_million_rows() -> None:
    """R from 1e-6 to 1e6 of P, Q likewise, in 250 chains of 1000 instants with four rows each.

    Before each the units are changed, by powers of two, so that P stays at 1.
    """
    rng = np.random.default_rng(31)
    chains, steps = 250, 1000
    mean = np.zeros((3, 10, chains // 10))
    P: FloatArray = np.eye(3)[:, :, None, None] * np.ones((1, *mean.shape[1:]))
    readings = Readings(np.zeros((4, chains // 10)), np.ones((4, chains // 10), dtype=np.bool_))
    for k in range(steps):
        unit = np.exp2(-np.round(0.5 * np.log2(np.einsum("ii...->i...", P))))
        P = P * (unit[:, None] * unit[None])
        Q = 10.0 ** rng.uniform(-6.0, 6.0, (2, *mean.shape[1:]))
        Q[1] = np.minimum(Q[1], 10.0)
        bank = predict(
            MotionModel.EXACT_ARC, Bank(mean, P), rng.uniform(-0.5, 0.5, (2, chains // 10)), Q
        )
        variance = np.einsum("ii...->i...", bank.covariance)[STATE_OF_ROW]
        noise = Noise(Q, variance * 10.0 ** rng.uniform(-6.0, 6.0, variance.shape))
        P = corrected_by(bank, readings, noise)[1].bank.covariance
        if k % 20 == 0 or k > steps - 20:
            assert_symmetric(P)
            assert_positive_definite(P)


@pytest.mark.slow
def test_covariance_stays_positive_definite_over_a_million_steps() -> None:
    """Side by side: ordinary, tiny, huge and lopsided noise; always, rarely, never measured."""
    rng = np.random.default_rng(21)
    steps, robots = 1000, 150
    Q = np.array([[4e-4, 3e-4], [1e-14, 1e-14], [1e2, 1e1], [1e-12, 1e1], [4e-4, 3e-4],
                  [1e-10, 1e-10], [4e-4, 3e-4]]).T  # fmt: skip
    R = np.ones((4, 1)) * [0.01, 1e-10, 1e6, 1e-8, 0.01, 1e8, 1e-6]
    R[2, -1] = 1e4
    filters = Q.shape[1]
    noise = Noise(
        np.broadcast_to(Q[:, :, None], (2, filters, robots)),
        np.broadcast_to(R[:, :, None], (4, filters, robots)),
    )
    share = np.repeat([1.0, 0.5, 0.3, 0.05, 0.002, 0.0], robots // 6)
    bank = Bank(
        np.zeros((3, filters, robots)),
        0.01 * np.eye(3)[:, :, None, None] * np.ones((filters, robots)),
    )
    for k in range(steps):
        control = rng.uniform([[-0.1], [-0.3]], [[0.3], [0.3]], (2, robots))
        bank = predict(MotionModel.EXACT_ARC, bank, control, noise.process)
        available = rng.random((4, robots)) < share
        readings = Readings(bank.mean[STATE_OF_ROW, 0], available)
        bank = corrected_by(bank, readings, noise)[1].bank
        if k % 50 == 49:
            assert np.all(np.isfinite(bank.mean))
            assert_symmetric(bank.covariance)
            assert_positive_definite(bank.covariance)
