import itertools
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from fnn_ekf_ros.core.arrays import FloatArray
from fnn_ekf_ros.core.kalman import (
    MEASUREMENT_JACOBIAN,
    correct,
    innovate,
    predict_covariance,
    update,
)
from fnn_ekf_ros.core.motion import MotionModel, move

Covariances = Callable[[np.random.Generator, int, int], FloatArray]
BOTH_MODELS = pytest.mark.parametrize("model", list(MotionModel))
ALL_MASKS = list(itertools.product([False, True], repeat=4))
ALL_ROWS = np.ones(4, dtype=np.bool_)
NO_ROWS = np.zeros(4, dtype=np.bool_)

# Quantiles 0.005 and 0.995 of chi-square with 1500 degrees of freedom, found by bisection on the
# regularised incomplete gamma function (Abramowitz and Stegun, 26.4.19).
CHI_SQUARE_1500 = (1362.674, 1644.838)


def run(
    model: MotionModel,
    mean: FloatArray,
    covariance: FloatArray,
    control: FloatArray,
    process_noise: FloatArray,
    measurement: FloatArray,
    measurement_noise: FloatArray,
    available: Any,
) -> tuple[FloatArray, FloatArray]:
    """Predict and correct once."""
    motion = move(model, mean, control)
    predicted = predict_covariance(covariance, motion, process_noise)
    corrected = correct(motion.mean, predicted, measurement, measurement_noise, available)
    return corrected.mean, corrected.covariance


def test_spinning_robot_equals_linear_kalman_filter() -> None:
    """On the spot, A = I and x, y, theta add up: a linear problem, in information form here."""
    rng = np.random.default_rng(11)
    q, R = 1e-3, np.diag([0.02, 0.03, 0.01, 0.04])
    root = 0.2 * rng.standard_normal((3, 3))
    mean: FloatArray = np.array([1.0, 2.0, 0.0])
    P: FloatArray = root @ root.T + 0.01 * np.eye(3)
    x_kf: Any = mean.copy()
    P_kf: Any = P.copy()
    H = MEASUREMENT_JACOBIAN
    for _ in range(60):
        turn = rng.uniform(-0.02, 0.02)
        z = np.array([1.0, 2.0, 0.0, 0.0]) + rng.standard_normal(4) * np.sqrt(np.diag(R))
        control, Q = np.array([0.0, turn]), np.array([0.0, q])
        mean, P = run(MotionModel.EXACT_ARC, mean, P, control, Q, z, R, ALL_ROWS)

        x_kf = x_kf + np.array([0.0, 0.0, turn])
        information = np.linalg.inv(P_kf + np.diag([0.0, 0.0, q]))
        gain_free = information @ x_kf + H.T @ np.linalg.inv(R) @ z
        P_kf = np.linalg.inv(information + H.T @ np.linalg.inv(R) @ H)
        x_kf = P_kf @ gain_free
        np.testing.assert_allclose(mean, x_kf, rtol=0.0, atol=1e-12)
        np.testing.assert_allclose(P, P_kf, rtol=0.0, atol=1e-13)


@BOTH_MODELS
def test_known_heading_equals_linear_kalman_filter(model: MotionModel) -> None:
    """Straight ahead with the heading known, x and y are a linear problem."""
    rng = np.random.default_rng(12)
    heading, way, q = 0.6, 0.3, 4e-4
    along = np.array([math.cos(heading), math.sin(heading)])
    R = np.array([[0.02, 0.005], [0.005, 0.03]])
    R_all = np.eye(4)
    R_all[:2, :2] = R
    mean, P = np.array([0.0, 0.0, heading]), np.diag([0.5, 0.4, 0.0])
    x_kf, P_kf = mean[:2].copy(), P[:2, :2].copy()
    rows = np.array([True, True, False, False])
    for i in range(60):
        z = (i + 1) * way * along + rng.multivariate_normal(np.zeros(2), R)
        z_all = np.array([z[0], z[1], 0.0, 0.0])
        control, Q = np.array([way, 0.0]), np.array([q, 0.0])
        mean, P = run(model, mean, P, control, Q, z_all, R_all, rows)

        x_kf = x_kf + way * along
        P_minus = P_kf + q * np.outer(along, along)
        gain = P_minus @ np.linalg.inv(P_minus + R)
        x_kf, P_kf = x_kf + gain @ (z - x_kf), P_minus - gain @ P_minus
        np.testing.assert_allclose(mean, [*x_kf, heading], rtol=0.0, atol=1e-12)
        np.testing.assert_allclose(P[:2, :2], P_kf, rtol=0.0, atol=1e-13)
    assert np.all(P[2] == 0.0)


@BOTH_MODELS
def test_long_random_run_equals_the_textbook_filter(
    model: MotionModel, textbook_step: Any, random_covariances: Covariances
) -> None:
    rng = np.random.default_rng(13)
    mean, P = np.array([1.0, -2.0, 3.0]), 0.05 * random_covariances(rng, 1, 3)[0]
    x, P_book = mean.copy(), P.copy()
    masks_seen = set()
    for _ in range(800):
        turn = rng.uniform(0.02, 0.5) * rng.choice([-1.0, 1.0])
        control = np.array([rng.uniform(-0.3, 0.6), turn])
        Q = rng.uniform(1e-4, 1e-2, 2)
        R = 0.02 * random_covariances(rng, 1, 4)[0]
        available = rng.random(4) < 0.5
        z = (
            x[[0, 1, 2, 2]]
            + 0.3 * rng.standard_normal(4)
            + 2.0 * np.pi * rng.integers(-1, 2, 4) * np.array([0.0, 0.0, 1.0, 1.0])
        )
        rows = [i for i in range(4) if available[i]]
        masks_seen.add(tuple(rows))

        mean, P = run(model, mean, P, control, Q, z, R, available)
        paper = model is MotionModel.PAPER
        x, P_book = textbook_step(paper, x, P_book, control, np.diag(Q), z, R, rows)

        np.testing.assert_allclose(mean[:2], x[:2], rtol=0.0, atol=1e-9)
        assert abs(math.remainder(mean[2] - x[2], 2.0 * math.pi)) < 1e-9
        np.testing.assert_allclose(P, P_book, rtol=0.0, atol=1e-9)
    assert len(masks_seen) == 16


def dropped_rows(
    mean: FloatArray, P: FloatArray, z: FloatArray, R: FloatArray, rows: list[int]
) -> tuple[FloatArray, FloatArray, float]:
    """Correct with smaller matrices that never had the other rows."""
    H, R_rows = MEASUREMENT_JACOBIAN[rows], R[np.ix_(rows, rows)]
    S_inverse = np.linalg.inv(H @ P @ H.T + R_rows)
    r = z[rows] - H @ mean
    K = P @ H.T @ S_inverse
    return mean + K @ r, P - K @ H @ P, float(r @ S_inverse @ r)


@pytest.mark.parametrize("mask", ALL_MASKS, ids=str)
@pytest.mark.parametrize("left_over", [0.0, 1e6, math.nan, math.inf])
def test_masked_rows_equal_dropped_rows(
    mask: tuple[bool, ...], left_over: float, random_covariances: Covariances
) -> None:
    """Whatever a masked row holds, only the available ones count; R is full."""
    rng = np.random.default_rng(14)
    mean = np.array([1.0, 2.0, 0.3])
    available = np.array(mask)
    rows = [i for i in range(4) if mask[i]]
    for P, R in zip(random_covariances(rng, 8, 3), random_covariances(rng, 8, 4), strict=True):
        z = mean[[0, 1, 2, 2]] + 0.1 * rng.standard_normal(4)
        expected_mean, expected_P, nis = dropped_rows(mean, P, z, R, rows)
        z[~available] = left_over
        result = correct(mean, P, z, R, available)
        np.testing.assert_allclose(result.mean, expected_mean, rtol=0.0, atol=1e-12)
        np.testing.assert_allclose(result.covariance, expected_P, rtol=0.0, atol=1e-12)
        assert result.nis == pytest.approx(nis, abs=1e-12)
        assert result.degrees_of_freedom == len(rows)
        assert np.all(result.innovation[~available] == 0.0)


@pytest.mark.parametrize("mask", ALL_MASKS, ids=str)
def test_innovation_then_update_is_the_correction(
    mask: tuple[bool, ...], random_covariances: Covariances
) -> None:
    """And S, its determinant and the gain are those of the rows that are there."""
    rng = np.random.default_rng(22)
    available = np.array(mask)
    rows = [i for i in range(4) if mask[i]]
    for P, R in zip(random_covariances(rng, 8, 3), random_covariances(rng, 8, 4), strict=True):
        mean, z = 0.3 * rng.standard_normal(3), 0.3 * rng.standard_normal(4)
        seen = innovate(mean, P, z, R, available)
        updated_mean, updated_P = update(mean, P, R, available, seen)
        together = correct(mean, P, z, R, available)
        assert updated_mean.tobytes() == together.mean.tobytes()
        assert updated_P.tobytes() == together.covariance.tobytes()
        expected_mean, expected_P, _ = dropped_rows(mean, P, z, R, rows)
        np.testing.assert_allclose(updated_mean, expected_mean, rtol=0.0, atol=1e-12)
        np.testing.assert_allclose(updated_P, expected_P, rtol=0.0, atol=1e-12)

        H = MEASUREMENT_JACOBIAN[rows]
        S, gain = np.eye(4), np.zeros((3, 4))
        S[np.ix_(rows, rows)] = H @ P @ H.T + R[np.ix_(rows, rows)]
        gain[:, rows] = P @ H.T @ np.linalg.inv(S[np.ix_(rows, rows)])
        np.testing.assert_allclose(seen.innovation_covariance, S, rtol=1e-14)
        np.testing.assert_allclose(seen.kalman_gain, gain, rtol=0.0, atol=1e-13)
        assert np.all(seen.kalman_gain[:, ~available] == 0.0)


def test_many_filters_innovate_from_one_measurement(random_covariances: Covariances) -> None:
    """The measurement and its mask have a batch axis of length 1."""
    rng = np.random.default_rng(23)
    mean, P, R = rng.standard_normal((5, 3)), random_covariances(rng, 5, 3), np.eye(4)
    z, available = rng.standard_normal((1, 4)), np.array([[True, False, True, True]])
    seen = innovate(mean, P, z, R, available)
    together = update(mean, P, R, available, seen)
    for i in range(5):
        alone = correct(mean[i], P[i], z[0], R, available[0])
        np.testing.assert_allclose(together[0][i], alone.mean, rtol=1e-12, atol=1e-13)
        np.testing.assert_allclose(together[1][i], alone.covariance, rtol=1e-12, atol=1e-13)


def test_without_any_row_nothing_changes(random_covariances: Covariances) -> None:
    P = random_covariances(np.random.default_rng(15), 1, 3)[0]
    mean = np.array([1.0, 2.0, 3.0])
    result = correct(mean, P, np.full(4, np.nan), np.eye(4), NO_ROWS)
    np.testing.assert_array_equal(result.mean, mean)
    np.testing.assert_array_equal(result.covariance, P)
    assert result.nis == 0.0
    assert result.degrees_of_freedom == 0.0


def test_correlation_inside_the_measurement_noise_counts() -> None:
    """By hand: P = I, R on x and y = [[1, .5], [.5, 1]], innovation (1, 0)."""
    R = np.eye(4)
    R[0, 1] = R[1, 0] = 0.5
    result = correct(
        np.zeros(3), np.eye(3), np.array([1.0, 0.0, 0.0, 0.0]), R,
        np.array([True, True, False, False]),
    )  # fmt: skip
    # S = [[2, .5], [.5, 2]], S^-1 = [[2, -.5], [-.5, 2]] / 3.75
    np.testing.assert_allclose(result.mean, [2.0 / 3.75, -0.5 / 3.75, 0.0], atol=1e-15)
    assert result.nis == pytest.approx(2.0 / 3.75, abs=1e-15)


@pytest.mark.parametrize("row", [2, 3])
@pytest.mark.parametrize(
    ("heading", "measured", "innovation"),
    [
        (math.pi - 0.01, -math.pi + 0.01, 0.02),
        (-math.pi + 0.01, math.pi - 0.01, -0.02),
        (3.0, 3.0 + 6.0 * math.pi, 0.0),
        (-3.0, 3.1, 6.1 - 2.0 * math.pi),
    ],
)
def test_yaw_innovation_goes_the_short_way_round(
    row: int, heading: float, measured: float, innovation: float
) -> None:
    z = np.zeros(4)
    z[row] = measured
    available = np.arange(4) == row
    result = correct(np.array([0.0, 0.0, heading]), np.eye(3), z, np.eye(4), available)
    assert result.innovation[row] == pytest.approx(innovation, abs=1e-14)
    apart = math.remainder(result.mean[2] - heading - 0.5 * innovation, 2.0 * math.pi)
    assert abs(apart) < 1e-14
    assert -math.pi < result.mean[2] <= math.pi


def test_heading_that_is_corrected_over_pi_comes_out_wrapped() -> None:
    z = np.array([0.0, 0.0, -math.pi + 0.03, 0.0])
    available = np.array([False, False, True, False])
    result = correct(np.array([0.0, 0.0, math.pi - 0.01]), np.eye(3), z, np.eye(4), available)
    assert result.mean[2] == pytest.approx(-math.pi + 0.01, abs=1e-14)


def test_positions_are_not_wrapped() -> None:
    z = np.array([100.0, -200.0, 0.0, 0.0])
    available = np.array([True, True, False, False])
    result = correct(np.zeros(3), np.eye(3), z, np.eye(4), available)
    np.testing.assert_array_equal(result.innovation, [100.0, -200.0, 0.0, 0.0])
    np.testing.assert_allclose(result.mean, [50.0, -100.0, 0.0], rtol=1e-15)


@pytest.mark.parametrize("mask", ALL_MASKS, ids=str)
def test_innovation_variance_is_the_diagonal_of_S_of_every_row(
    mask: tuple[bool, ...], random_covariances: Covariances
) -> None:
    rng = np.random.default_rng(16)
    P, R = random_covariances(rng, 1, 3)[0], random_covariances(rng, 1, 4)[0]
    result = correct(np.zeros(3), P, np.zeros(4), R, np.array(mask))
    S = MEASUREMENT_JACOBIAN @ P @ MEASUREMENT_JACOBIAN.T + R
    np.testing.assert_allclose(result.innovation_variance, np.diag(S), rtol=1e-15)


def test_nis_of_right_noise_averages_to_the_number_of_rows() -> None:
    """Innovations drawn from S itself: the mean of chi-square is its degrees of freedom."""
    rng = np.random.default_rng(17)
    P = np.array([[0.3, 0.1, 0.02], [0.1, 0.2, 0.01], [0.02, 0.01, 0.05]])
    R = np.diag([0.1, 0.2, 0.03, 0.04])
    S = MEASUREMENT_JACOBIAN @ P @ MEASUREMENT_JACOBIAN.T + R
    count = 20_000
    z = rng.multivariate_normal(np.zeros(4), S, count)
    result = correct(np.zeros((count, 3)), P, z, R, np.broadcast_to(ALL_ROWS, (count, 4)))
    # Variance of chi-square with 4 degrees of freedom is 8.
    assert np.mean(result.nis) == pytest.approx(4.0, abs=6.0 * math.sqrt(8.0 / count))


def test_batches_equal_one_by_one(random_covariances: Covariances) -> None:
    rng = np.random.default_rng(18)
    mean, z = rng.standard_normal((2, 3, 3)), rng.standard_normal((2, 3, 4))
    P = random_covariances(rng, 6, 3).reshape(2, 3, 3, 3)
    R = random_covariances(rng, 6, 4).reshape(2, 3, 4, 4)
    available = rng.random((2, 3, 4)) < 0.5
    control, Q = rng.standard_normal((2, 3, 2)), rng.uniform(0.1, 1.0, (2, 3, 2))
    predicted = predict_covariance(P, move(MotionModel.EXACT_ARC, mean, control), Q)
    together = correct(mean, P, z, R, available)
    for i in np.ndindex(2, 3):
        motion = move(MotionModel.EXACT_ARC, mean[i], control[i])
        np.testing.assert_allclose(
            predicted[i], predict_covariance(P[i], motion, Q[i]), rtol=1e-13, atol=1e-13
        )
        alone = correct(mean[i], P[i], z[i], R[i], available[i])
        for one, other in zip(together, alone, strict=True):
            np.testing.assert_allclose(one[i], other, rtol=1e-12, atol=1e-12)


@BOTH_MODELS
@pytest.mark.parametrize("turn", [0.0, 0.4, -1.2])
def test_predicted_covariance_equals_the_spread_of_samples(model: MotionModel, turn: float) -> None:
    """Each entry within 6 standard deviations of a sample covariance's entry."""
    rng = np.random.default_rng(19)
    count = 200_000
    mean, control = np.array([1.0, 2.0, 0.7]), np.array([0.8, turn])
    P = np.array([[4.0, 1.0, 0.5], [1.0, 3.0, -0.4], [0.5, -0.4, 1.0]]) * 1e-5
    Q = np.array([3e-5, 1e-5])
    predicted = predict_covariance(P, move(model, mean, control), Q)
    starts = mean + rng.standard_normal((count, 3)) @ np.linalg.cholesky(P).T
    controls = control + rng.standard_normal((count, 2)) * np.sqrt(Q)
    sampled = np.cov(move(model, starts, controls).mean, rowvar=False)
    variance = np.diag(predicted)
    sigma = np.sqrt((np.outer(variance, variance) + predicted**2) / count)
    assert np.all(np.abs(sampled - predicted) < 6.0 * sigma)


@BOTH_MODELS
def test_mean_nees_of_consistent_runs_is_inside_its_band(model: MotionModel) -> None:
    """500 robots that move and measure with exactly the noise the filter is told."""
    rng = np.random.default_rng(20)
    runs, checked_at = 500, (20, 40, 60)
    P0 = np.diag([0.05, 0.05, 0.02]) ** 2
    Q = np.array([0.01, 0.005]) ** 2
    R = np.diag([0.03, 0.03, 0.02, 0.03]) ** 2
    R[0, 1] = R[1, 0] = 0.5 * R[0, 0]
    mean = np.broadcast_to([0.0, 0.0, 3.0], (runs, 3))
    truth = mean + rng.multivariate_normal(np.zeros(3), P0, runs)
    P = np.broadcast_to(P0, (runs, 3, 3))
    for i in range(1, max(checked_at) + 1):
        control = np.broadcast_to([0.15, 0.1 * math.sin(0.2 * i)], (runs, 2))
        truth = move(model, truth, control + rng.standard_normal((runs, 2)) * np.sqrt(Q)).mean
        z = truth[:, [0, 1, 2, 2]] + rng.multivariate_normal(np.zeros(4), R, runs)
        available = rng.random((runs, 4)) < 0.6
        mean, P = run(model, mean, P, control, Q, z, R, available)
        if i in checked_at:
            error = mean - truth
            error[:, 2] = np.arctan2(np.sin(error[:, 2]), np.cos(error[:, 2]))
            nees = np.sum(error * np.linalg.solve(P, error[..., None])[..., 0], axis=-1)
            assert CHI_SQUARE_1500[0] < np.sum(nees) < CHI_SQUARE_1500[1]


def test_covariance_survives_a_measurement_far_better_than_what_was_known() -> None:
    """Where P- - K H P- loses all its digits: P of 1e8 m^2 meets R of 1e-8 m^2."""
    root = np.array([[1e4, 0.0, 0.0], [7e3, 4e3, 0.0], [0.3, -0.2, 0.1]])
    P, R = root @ root.T, np.diag([1e-8, 1e-8, 1e-8, 1e-8])
    for mask in ALL_MASKS[1:]:
        corrected = correct(np.zeros(3), P, np.zeros(4), R, np.array(mask)).covariance
        np.testing.assert_array_equal(corrected, corrected.T)
        np.linalg.cholesky(corrected)
        measured = np.array([mask[0], mask[1], mask[2] or mask[3]])
        assert np.all(np.diag(corrected)[measured] < 1.01e-8)
        assert np.all(np.diag(corrected)[measured] > 0.49e-8)


def test_covariance_stays_positive_definite_over_100_000_steps() -> None:
    """Side by side: ordinary, tiny, huge and lopsided noise; always, rarely, never measured."""
    rng = np.random.default_rng(21)
    steps = 100_000
    Q = np.array([[4e-4, 3e-4], [1e-14, 1e-14], [1e2, 1e1], [1e-12, 1e1], [4e-4, 3e-4],
                  [1e-10, 1e-10], [4e-4, 3e-4]])  # fmt: skip
    R = np.eye(4) * np.array([0.01, 1e-10, 1e6, 1e-8, 0.01, 1e8, 1e-6])[:, None, None]
    R[-1, 2, 2] = 1e4
    share = np.array([1.0, 1.0, 1.0, 0.5, 0.002, 0.5, 0.0])[:, None]
    batch = len(Q)
    mean, P = np.zeros((batch, 3)), np.broadcast_to(0.01 * np.eye(3), (batch, 3, 3))
    controls = rng.uniform([-0.1, -0.3], [0.3, 0.3], (steps, 2))
    for first in range(0, steps, 1000):
        masks = rng.random((1000, batch, 4)) < share
        for control, available in zip(controls[first : first + 1000], masks, strict=True):
            motion = move(MotionModel.EXACT_ARC, mean, control)
            predicted = predict_covariance(P, motion, Q)
            expected = motion.mean[:, [0, 1, 2, 2]]
            corrected = correct(motion.mean, predicted, expected, R, available)
            mean, P = corrected.mean, corrected.covariance
        assert np.all(np.isfinite(mean))
        assert np.all(np.isfinite(P))
        np.testing.assert_array_equal(P, np.swapaxes(P, -1, -2))
        np.linalg.cholesky(P)  # refuses what is not positive definite
