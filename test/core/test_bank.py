# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Prediction and correction against Kalman filters, the textbook and dense linear algebra."""

import itertools
import math
from typing import Any

import numpy as np
import pytest
from banks import (
    ALL_MASKS,
    BOTH_KINDS,
    BOTH_MODELS,
    FIX,
    STATE_OF_ROW,
    UNIT,
    Covariances,
    H,
    assert_symmetric,
    corrected,
    corrected_by,
    dense,
    full_noise,
    one_filter,
    random_case,
)
from jacobians import diagonal_matrix, motion_jacobian
from periods import ALL_ROWS
from textbook_ekf import textbook_step

from fnn_ekf_ros.core.arrays import Row, components_last
from fnn_ekf_ros.core.bank import (
    Bank,
    Noise,
    Readings,
    innovate,
    noise_of_readings,
    predict,
    predict_covariance,
)
from fnn_ekf_ros.core.motion import MotionModel, move


def test_spinning_robot_equals_linear_kalman_filter() -> None:
    """On the spot, A = I and x, y, theta add up: a linear problem, in information form here."""
    rng = np.random.default_rng(11)
    q, R = 1e-3, np.array([0.02, 0.03, 0.01, 0.04])
    root = 0.2 * rng.standard_normal((3, 3))
    x_kf: Any = np.array([1.0, 2.0, 0.0])
    P_kf: Any = root @ root.T + 0.01 * np.eye(3)
    bank = one_filter(x_kf, P_kf)
    for _ in range(60):
        turn = rng.uniform(-0.02, 0.02)
        z = np.array([1.0, 2.0, 0.0, 0.0]) + rng.standard_normal(4) * np.sqrt(R)
        Q = np.array([[0.0], [q]])
        bank = predict(MotionModel.EXACT_ARC, bank, np.array([0.0, turn]), Q)
        bank = corrected(bank, z, R, ALL_ROWS)[1].bank

        x_kf = x_kf + np.array([0.0, 0.0, turn])
        information = np.linalg.inv(P_kf + np.diag([0.0, 0.0, q]))
        gain_free = information @ x_kf + H.T @ (z / R)
        P_kf = np.linalg.inv(information + H.T @ np.diag(1.0 / R) @ H)
        x_kf = P_kf @ gain_free
        np.testing.assert_allclose(bank.mean[:, 0], x_kf, rtol=0.0, atol=1e-12)
        np.testing.assert_allclose(bank.covariance[..., 0], P_kf, rtol=0.0, atol=1e-13)


@BOTH_MODELS
def test_known_heading_equals_linear_kalman_filter(model: MotionModel) -> None:
    """Straight ahead with the heading known, x and y are a linear problem; their noise is one."""
    rng = np.random.default_rng(12)
    heading, way, q = 0.6, 0.3, 4e-4
    along = np.array([math.cos(heading), math.sin(heading)])
    R = np.array([[0.02, 0.005], [0.005, 0.03]])
    fix = np.eye(3)
    fix[:2, :2] = R
    rows = np.array([True, True, False, False])
    noise = noise_of_readings(Noise(np.array([[q], [0.0]]), np.ones((4, 1))), UNIT, fix, rows)
    bank = one_filter([0.0, 0.0, heading], np.diag([0.5, 0.4, 0.0]))
    x_kf, P_kf = bank.mean[:2, 0].copy(), bank.covariance[:2, :2, 0].copy()
    for i in range(60):
        z = (i + 1) * way * along + rng.multivariate_normal(np.zeros(2), R)
        bank = predict(model, bank, np.array([way, 0.0]), noise.process)
        bank = corrected_by(bank, Readings(np.array([*z, 0.0, 0.0]), rows), noise)[1].bank

        x_kf = x_kf + way * along
        P_minus = P_kf + q * np.outer(along, along)
        gain = P_minus @ np.linalg.inv(P_minus + R)
        x_kf, P_kf = x_kf + gain @ (z - x_kf), P_minus - gain @ P_minus
        np.testing.assert_allclose(bank.mean[:, 0], [*x_kf, heading], rtol=0.0, atol=1e-12)
        np.testing.assert_allclose(bank.covariance[:2, :2, 0], P_kf, rtol=0.0, atol=1e-13)
    assert np.all(bank.covariance[2] == 0.0)


@BOTH_MODELS
@BOTH_KINDS
@pytest.mark.slow
def test_long_random_run_equals_the_textbook_filter(
    model: MotionModel, random_covariances: Covariances, reported: bool
) -> None:
    """Rows one after the other do what all together do, whichever there are."""
    rng = np.random.default_rng(13)
    x, P = np.array([1.0, -2.0, 3.0]), 0.05 * random_covariances(rng, 1, 3)[..., 0]
    bank = one_filter(x, P)
    masks_seen = set()
    for _ in range(400):
        turn = rng.uniform(0.02, 0.5) * rng.choice([-1.0, 1.0])
        control = np.array([rng.uniform(-0.3, 0.6), turn])
        Q, own = rng.uniform(1e-4, 1e-2, 2), rng.uniform(1e-3, 0.1, 4)
        fix = 0.02 * random_covariances(rng, 1, 3)[..., 0] if reported else None
        available = rng.random(4) < 0.5
        z = (
            x[STATE_OF_ROW]
            + 0.3 * rng.standard_normal(4)
            + 2.0 * np.pi * rng.integers(-1, 2, 4) * np.array([0.0, 0.0, 1.0, 1.0])
        )
        rows = [i for i in range(4) if available[i]]
        masks_seen.add(tuple(rows))

        bank = predict(model, bank, control, Q[:, None])
        noise = Noise(Q[:, None], own[:, None])
        noise = noise_of_readings(noise, tuple(own), fix, available)
        bank = corrected_by(bank, Readings(z, available), noise)[1].bank
        R = np.diag(own) if fix is None else full_noise(fix, own[Row.COMPASS_YAW])
        paper = model is MotionModel.PAPER
        x, P = textbook_step(paper, x, P, control, np.diag(Q), z, R, rows)

        np.testing.assert_allclose(bank.mean[:2, 0], x[:2], rtol=0.0, atol=1e-9)
        assert abs(math.remainder(bank.mean[2, 0] - x[2], 2.0 * math.pi)) < 1e-9
        np.testing.assert_allclose(bank.covariance[..., 0], P, rtol=0.0, atol=1e-9)
    assert len(masks_seen) == 16


@pytest.mark.parametrize("left_over", [0.0, 1e6, math.nan, math.inf])
@BOTH_KINDS
@pytest.mark.slow
def test_every_subset_of_rows_equals_dense_linear_algebra(
    left_over: float, random_covariances: Covariances, reported: bool
) -> None:
    """Whatever is in the place of a row that was not measured, only the others count.

    Filters have R of their own. What a fix reports is multiplied, row by row, by what theirs are
    to the reference.
    """
    rng = np.random.default_rng(14)
    reference = (0.5, 0.7, 1.0, 2.0)
    for _ in range(4):
        bank, own, (z, available), fix = random_case(rng, random_covariances, 3)
        noise = own
        if reported:
            hidden = ~available[FIX]
            told = np.where(hidden[:, None] | hidden[None], left_over, fix)
            noise = noise_of_readings(own, reference, told, available)
        readings = Readings(np.where(available, z, left_over), available)
        seen, taken = corrected_by(bank, readings, noise)
        assert np.all(np.where(available[:, None], 0.0, seen.innovation) == 0.0)
        for f, i in np.ndindex(taken.nis.shape):
            rows = [row for row in range(4) if available[row, i]]
            mean, P = bank.mean[:, f, i], bank.covariance[:, :, f, i]
            R = np.diag(own.measurement[:, f, i])
            if reported:
                scale = np.sqrt(own.measurement[FIX, f, i] / np.array(reference)[FIX])
                R = full_noise(scale[:, None] * fix[..., i] * scale, R[2, 2])
            expected = dense(mean, P, z[:, i], R, rows)
            got = taken.bank
            np.testing.assert_allclose(got.mean[:, f, i], expected.mean, rtol=0, atol=1e-12)
            np.testing.assert_allclose(
                got.covariance[:, :, f, i], expected.covariance, rtol=0, atol=1e-12
            )
            assert taken.nis[f, i] == pytest.approx(expected.nis, rel=1e-11, abs=1e-14)
            assert taken.determinant[f, i] == pytest.approx(expected.determinant, rel=1e-11)
            of_fix = [row for row in rows if row != Row.COMPASS_YAW]
            alone = dense(mean, P, z[:, i], R, of_fix).nis
            assert taken.fix_nis[f, i] == pytest.approx(alone, rel=1e-11, abs=1e-14)
            np.testing.assert_allclose(
                seen.variance[rows, f, i], np.diag(H @ P @ H.T + R)[rows], rtol=1e-14
            )


def test_innovation_variance_is_the_diagonal_of_S_of_every_row(
    random_covariances: Covariances,
) -> None:
    rng = np.random.default_rng(16)
    bank, noise, readings, _ = random_case(rng, random_covariances, 2)
    seen = innovate(bank, readings, noise.measurement)
    P = np.einsum("ii...->i...", bank.covariance)
    np.testing.assert_array_equal(seen.variance, P[STATE_OF_ROW] + noise.measurement)


@BOTH_MODELS
def test_prediction_is_A_P_A_plus_W_Q_W(
    random_covariances: Covariances, model: MotionModel
) -> None:
    rng = np.random.default_rng(27)
    mean, P = rng.standard_normal((3, 50)), random_covariances(rng, 50, 3)
    control, Q = rng.uniform(-1.0, 1.0, (2, 50)), rng.uniform(0.0, 1.0, (2, 50))
    motion = move(model, mean, control)
    got = predict_covariance(P, motion, Q)
    A, W = (components_last(m, 2) for m in (motion_jacobian(motion), motion.noise_jacobian()))
    noise = components_last(diagonal_matrix(Q), 2)
    expected = A @ components_last(P, 2) @ np.swapaxes(A, 1, 2) + W @ noise @ np.swapaxes(W, 1, 2)
    np.testing.assert_allclose(components_last(got, 2), expected, rtol=1e-13, atol=1e-14)
    assert_symmetric(got)


def cut_in(pieces: int, way: float, turn: float) -> Bank:
    """Take a robot that is known exactly over one step, cut in so many equal pieces."""
    bank = one_filter([0.0, 0.0, 0.0], np.zeros((3, 3)))
    Q = np.array([[0.0], [math.radians(3.0) ** 2 / pieces]])
    for _ in range(pieces):
        bank = predict(MotionModel.EXACT_ARC, bank, np.array([way, turn]) / pieces, Q)
    return bank


@pytest.mark.parametrize("turn", [0.0, 0.3, -1.2])
def test_a_step_cut_in_two_ends_where_it_did_with_a_little_more_doubt(turn: float) -> None:
    """0.3 m/s for 375 ms, heading noise of 3 degrees: way/2 and sqrt(5/16) way of it sideways."""
    way = 0.3 * 0.375
    whole, halves, many = (cut_in(pieces, way, turn) for pieces in (1, 2, 64))
    for cut in (halves, many):
        np.testing.assert_allclose(cut.mean, whole.mean, rtol=0.0, atol=1e-14)
        np.testing.assert_allclose(cut.covariance[2, 2], whole.covariance[2, 2], rtol=1e-14)
    if turn == 0.0:
        sideways = [math.sqrt(bank.covariance[1, 1, 0]) for bank in (whole, halves, many)]
        lever = way * math.radians(3.0)
        np.testing.assert_allclose(sideways[:2], [0.5 * lever, math.sqrt(0.3125) * lever])
        np.testing.assert_allclose(sideways, [2.9e-3, 3.3e-3, 3.4e-3], rtol=0.0, atol=0.05e-3)


@pytest.mark.parametrize("order", list(itertools.permutations(range(4)))[::3], ids=str)
def test_order_of_the_rows_does_not_matter(
    order: tuple[int, ...], random_covariances: Covariances
) -> None:
    """One reading after the other, each against the filter that the one before it left."""
    rng = np.random.default_rng(28)
    bank, noise, _, _ = random_case(rng, random_covariances, 2)
    z = 0.3 * rng.standard_normal((4, len(ALL_MASKS)))
    everything = np.ones(z.shape, dtype=np.bool_)
    together = corrected_by(bank, Readings(z, everything), noise)[1]
    nis, determinant = np.zeros_like(together.nis), np.ones_like(together.nis)
    for row in order:
        available = everything & (np.arange(4) == row)[:, None]
        taken = corrected_by(bank, Readings(z, available), noise)[1]
        bank, nis, determinant = taken.bank, nis + taken.nis, determinant * taken.determinant
    np.testing.assert_allclose(bank.mean, together.bank.mean, rtol=0.0, atol=1e-13)
    np.testing.assert_allclose(bank.covariance, together.bank.covariance, rtol=0.0, atol=1e-13)
    np.testing.assert_allclose(nis, together.nis, rtol=1e-11)
    np.testing.assert_allclose(determinant, together.determinant, rtol=1e-12)


@pytest.mark.parametrize("row", [2, 3])
@pytest.mark.parametrize(
    ("heading", "measured", "innovation"),
    [
        (math.pi - 0.01, -math.pi + 0.01, 0.02),
        (-math.pi + 0.01, math.pi - 0.01, -0.02),
        (3.0, 3.0 + 6.0 * math.pi, 0.0),
        (-3.0, 3.1, 6.1 - 2.0 * math.pi),
        (3.0 + 4.0 * math.pi, 3.1, 0.1),
    ],
)
def test_yaw_innovation_goes_the_short_way_round(
    row: int, heading: float, measured: float, innovation: float
) -> None:
    z = np.zeros(4)
    z[row] = measured
    available = np.arange(4) == row
    seen, taken = corrected(one_filter([0.0, 0.0, heading], np.eye(3)), z, np.ones(4), available)
    assert seen.innovation[row, 0] == pytest.approx(innovation, abs=1e-14)
    mean = taken.bank.mean[:, 0]
    apart = math.remainder(mean[2] - heading - 0.5 * innovation, 2.0 * math.pi)
    assert abs(apart) < 1e-14
    assert -math.pi < mean[2] <= math.pi


def test_heading_that_is_corrected_over_pi_comes_out_wrapped() -> None:
    z = np.array([0.0, 0.0, -math.pi + 0.03, 0.0])
    available = np.array([False, False, True, False])
    bank = one_filter([0.0, 0.0, math.pi - 0.01], np.eye(3))
    _, taken = corrected(bank, z, np.ones(4), available)
    assert taken.bank.mean[2, 0] == pytest.approx(-math.pi + 0.01, abs=1e-14)


def test_positions_are_not_wrapped() -> None:
    z = np.array([100.0, -200.0, 0.0, 0.0])
    available = np.array([True, True, False, False])
    seen, taken = corrected(one_filter(np.zeros(3), np.eye(3)), z, np.ones(4), available)
    np.testing.assert_array_equal(seen.innovation[:, 0], [100.0, -200.0, 0.0, 0.0])
    np.testing.assert_allclose(taken.bank.mean[:, 0], [50.0, -100.0, 0.0], rtol=1e-15)
