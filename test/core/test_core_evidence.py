import itertools
import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import pytest

from fnn_ekf_ros.core.arrays import BoolArray, FloatArray, diagonal_matrix
from fnn_ekf_ros.core.evidence import (
    CONSISTENT_SCALE,
    NEIGHBOUR_STEP,
    SCALE_COUNT,
    SCALES,
    STAR,
    STAR_SIZE,
    TAIL_DEGREES_OF_FREEDOM,
    Evidence,
    log_likelihood,
    star_evidence,
)
from fnn_ekf_ros.core.kalman import Innovation, innovate, update
from fnn_ekf_ros.core.motion import MotionModel
from fnn_ekf_ros.core.plant import Plant, predict

Covariances = Callable[[np.random.Generator, int, int], FloatArray]
ALL_MASKS = list(itertools.product([False, True], repeat=4))
NO_ROWS = np.zeros(4, dtype=np.bool_)
STATE_OF_ROW = [0, 1, 2, 2]
SCALE_OF_ROW = [2, 2, 3, 3]
NU = TAIL_DEGREES_OF_FREEDOM
Q = np.array([4e-4, 3e-4])
R = np.array([0.01, 0.01, 0.018, 0.02])
PLANT = Plant(MotionModel.EXACT_ARC, 1.0, (0.01, 0.01, 0.018, 0.02))


def expected_tail(scale: float, n: int) -> float:
    """E[e / (c + e)] of chi-square with n degrees of freedom, by Simpson's rule over sqrt(e)."""
    x = np.linspace(0.0, 30.0, 60_001)
    density = 2.0 * x ** (n - 1) * np.exp(-0.5 * x**2) / (2.0 ** (0.5 * n) * math.gamma(0.5 * n))
    weight = np.ones_like(x)
    weight[1:-1:2], weight[2:-1:2] = 4.0, 2.0
    integral: float = np.sum(weight * density * x**2 / (scale + x**2)) * x[1] / 3.0
    return integral


@pytest.mark.parametrize("n", [1, 2, 3, 4])
def test_gaussian_innovations_have_an_expected_score_of_zero(n: int) -> None:
    """dl/dlog S = -n/2 + (nu + n)/2 e/(c + e); the tables show four decimals of c."""
    c = CONSISTENT_SCALE[n]
    share = [(NU + n) * expected_tail(scale, n) - n for scale in (c - 1e-4, c, c + 1e-4)]
    assert share[0] > 0.0 > share[2]
    assert abs(share[1]) < 2e-5


def student_log_likelihood(r: FloatArray, S: FloatArray) -> float:
    """The heavy tail for the rows that are there, from an inverse and a determinant."""
    n = len(r)
    if n == 0:
        return 0.0
    e = float(r @ np.linalg.inv(S) @ r)
    tail = (NU + n) * math.log(1.0 + e / CONSISTENT_SCALE[n])
    return -0.5 * (math.log(np.linalg.det(S)) + tail)


@pytest.mark.parametrize("mask", ALL_MASKS, ids=str)
@pytest.mark.parametrize("left_over", [0.0, 1e6, math.nan])
def test_log_likelihood_counts_the_available_rows_only(
    mask: tuple[bool, ...], left_over: float, random_covariances: Covariances
) -> None:
    rng = np.random.default_rng(80)
    available = np.array(mask)
    rows = np.flatnonzero(available)
    for P, noise in zip(random_covariances(rng, 5, 3), random_covariances(rng, 5, 4), strict=True):
        z = rng.standard_normal(4)
        S = P[np.ix_(STATE_OF_ROW, STATE_OF_ROW)] + noise
        expected = student_log_likelihood(z[rows], S[np.ix_(rows, rows)])
        z[~available] = left_over
        got = log_likelihood(innovate(np.zeros(3), P, z, noise, available))
        assert got == pytest.approx(expected, abs=1e-12)
        assert got.shape == ()


def test_the_star_has_its_centre_and_two_neighbours_for_each_scale() -> None:
    assert SCALES == ("forward", "heading", "position", "yaw")
    assert len(SCALES) == SCALE_COUNT
    assert STAR.shape == (STAR_SIZE, SCALE_COUNT) == (9, 4)
    expected = np.zeros((9, 4))
    for scale in range(4):
        expected[1 + 2 * scale, scale] = NEIGHBOUR_STEP
        expected[2 + 2 * scale, scale] = -NEIGHBOUR_STEP
    np.testing.assert_array_equal(STAR, expected)


class Period(NamedTuple):
    control: FloatArray
    measurement: FloatArray
    available: BoolArray


class Filters(NamedTuple):
    """Means and covariances; the last batch axis is the star's."""

    mean: FloatArray
    covariance: FloatArray


def star_step(filters: Filters, period: Period) -> tuple[Filters, Innovation]:
    """Take a star of filters over one period, each with noise of its own."""
    process_noise = Q * np.exp(STAR[:, :2])
    noise = diagonal_matrix(R * np.exp(STAR[:, SCALE_OF_ROW]))
    mean, covariance = predict(PLANT, *filters, process_noise, period.control[..., None, :])
    available = period.available[..., None, :]
    seen = innovate(mean, covariance, period.measurement[..., None, :], noise, available)
    counts = np.broadcast_to(seen.degrees_of_freedom, seen.nis.shape)
    seen = seen._replace(degrees_of_freedom=counts)
    return Filters(*update(mean, covariance, noise, available, seen)), seen


def random_periods(seed: int, steps: int) -> list[Period]:
    """A robot on a circle, measured by other rows each time."""
    rng = np.random.default_rng(seed)
    truth, periods = np.array([1.0, 2.0, 0.5]), []
    for _ in range(steps):
        control = np.array([rng.uniform(0.1, 0.4), rng.uniform(0.02, 0.2)])
        driven = control + rng.standard_normal(2) * np.sqrt(4.0 * Q)
        truth = predict(PLANT, truth, np.eye(3), Q, driven)[0]
        z = truth[STATE_OF_ROW] + rng.standard_normal(4) * np.sqrt(R)
        periods.append(Period(control, z, rng.random(4) < 0.6))
    return periods


def independent_innovations(
    textbook_step: Any, periods: list[Period], theta: FloatArray
) -> list[tuple[FloatArray, FloatArray]]:
    """Return r and S of the rows measured in each period, of one textbook filter."""
    process = np.diag(Q * np.exp(theta[:2]))
    noise = np.diag(R * np.exp(theta[SCALE_OF_ROW]))
    x, P, found = np.array([1.0, 2.0, 0.5]), 0.01 * np.eye(3), []
    for control, z, available in periods:
        rows = [int(row) for row in np.flatnonzero(available)]
        states = [STATE_OF_ROW[row] for row in rows]
        args = (False, x, P, control, process, z, noise)
        ahead, spread = textbook_step(*args, [])
        r = z[rows] - ahead[states]
        r = np.where(np.array(states) == 2, np.arctan2(np.sin(r), np.cos(r)), r)
        found.append((r, spread[np.ix_(states, states)] + noise[np.ix_(rows, rows)]))
        x, P = textbook_step(*args, rows)
    return found


def along_the_star(periods: list[Period]) -> list[Evidence]:
    filters = Filters(
        np.tile([1.0, 2.0, 0.5], (STAR_SIZE, 1)), np.tile(0.01 * np.eye(3), (STAR_SIZE, 1, 1))
    )
    found = []
    for period in periods:
        filters, seen = star_step(filters, period)
        found.append(star_evidence(seen))
    return found


@pytest.mark.parametrize(("h", "tolerance"), [(NEIGHBOUR_STEP, 1e-8), (1e-4, 0.03)])
def test_score_is_the_derivative_of_an_independent_filters_log_likelihood(
    textbook_step: Any, h: float, tolerance: float
) -> None:
    """With the star's step to the last digits, and with a tiny one: no bias to speak of."""
    periods = random_periods(seed=81, steps=60)
    score = np.array([evidence.score for evidence in along_the_star(periods)])
    expected = np.zeros_like(score)
    for scale in range(SCALE_COUNT):
        by_side = []
        for side in (h, -h):
            theta = np.zeros(SCALE_COUNT)
            theta[scale] = side
            seen = independent_innovations(textbook_step, periods, theta)
            by_side.append([student_log_likelihood(r, S) for r, S in seen])
        expected[:, scale] = (np.array(by_side[0]) - np.array(by_side[1])) / (2.0 * h)
    size = np.max(np.abs(expected), axis=0)
    assert np.all(size > 0.1)
    assert np.all(np.abs(score - expected) < tolerance * size)


def test_information_of_an_independent_filter_has_both_terms(textbook_step: Any) -> None:
    """Row by row, of measured rows only."""
    periods = random_periods(seed=82, steps=40)
    h = 1e-4
    by_offset = {
        (scale, side): independent_innovations(
            textbook_step, periods, side * h * np.eye(SCALE_COUNT)[scale]
        )
        for scale in range(SCALE_COUNT)
        for side in (1.0, -1.0)
    }
    centre = independent_innovations(textbook_step, periods, np.zeros(SCALE_COUNT))
    for i, evidence in enumerate(along_the_star(periods)):
        expected = np.zeros((SCALE_COUNT, SCALE_COUNT))
        n = len(centre[i][0])
        for row in range(n):
            pairs = [(by_offset[s, 1.0][i], by_offset[s, -1.0][i]) for s in range(SCALE_COUNT)]
            by_variance = np.array([math.log(p[1][row, row] / m[1][row, row]) for p, m in pairs])
            by_lead = np.array([p[0][row] - m[0][row] for p, m in pairs])
            by_lead /= math.sqrt(centre[i][1][row, row])
            both = 0.5 * np.outer(by_variance, by_variance) + np.outer(by_lead, by_lead)
            expected += (NU + n) / (NU + n + 2.0) * both / (2.0 * h) ** 2
        assert np.max(np.abs(evidence.information - expected)) < 0.03 * np.max(expected) + 1e-12
        assert np.min(np.linalg.eigvalsh(evidence.information)) > -1e-12


class Sampled(NamedTuple):
    """Scores of many measurements and their mean information."""

    score: FloatArray
    information: FloatArray


def sample(control: list[float], available: BoolArray, seed: int, heavy: bool) -> Sampled:
    """Run robots that move and measure as the star's centre believes, until they are settled.

    The innovations are drawn, not the noise: as Gaussians, or as the likelihood's own Student's t.
    """
    rng = np.random.default_rng(seed)
    runs, n = 100, int(np.sum(available))
    filters = Filters(np.zeros((runs, STAR_SIZE, 3)), np.tile(1e-3 * np.eye(3), (runs, 9, 1, 1)))
    nothing = Period(np.tile(control, (runs, 1)), np.zeros((runs, 4)), np.tile(NO_ROWS, (runs, 1)))
    scores, information = [], []
    for i in range(160):
        ahead = Filters(*(part[:, 0] for part in star_step(filters, nothing)[0]))
        S = ahead.covariance[:, STATE_OF_ROW][:, :, STATE_OF_ROW] + np.diag(R)
        root = np.linalg.cholesky(S[:, available][:, :, available])
        r = rng.standard_normal((runs, n))
        if heavy:
            r *= np.sqrt(CONSISTENT_SCALE[n] / rng.chisquare(NU, (runs, 1)))
        z = ahead.mean[:, STATE_OF_ROW]
        z[:, available] += (root @ r[..., None])[..., 0]
        period = nothing._replace(measurement=z, available=np.tile(available, (runs, 1)))
        filters, seen = star_step(filters, period)
        if i >= 40:
            evidence = star_evidence(seen)
            scores.append(evidence.score)
            information.append(np.mean(evidence.information, axis=0))
    return Sampled(np.concatenate(scores), np.mean(information, axis=0))


@pytest.mark.parametrize("heavy", [False, True])
def test_sampled_scores_at_the_truth_average_to_zero(heavy: bool) -> None:
    score, _ = sample([0.2, 0.05], np.array([True, True, True, False]), seed=83, heavy=heavy)
    standard_error = np.std(score, axis=0) / math.sqrt(len(score))
    assert np.all(standard_error < 0.01)
    assert np.all(np.abs(np.mean(score, axis=0)) < 4.0 * standard_error)


def relative_spread(sampled: Sampled, scales: list[int]) -> FloatArray:
    """Return the eigenvalues of the scores' covariance as seen by the information."""
    scores = sampled.score[:, scales]
    root = np.linalg.cholesky(sampled.information[np.ix_(scales, scales)])
    white = np.linalg.solve(root, scores.T)
    return np.asarray(np.linalg.eigvalsh(white @ white.T / len(scores)), dtype=np.float64)


def test_information_is_the_scores_covariance_turning_on_the_spot() -> None:
    """One row, two scales: either term alone is singular.

    Fisher's information of Student's t (Lange, Little and Taylor 1989): nu/(nu + 3)/2 of the log
    scale and (nu + 1)/(nu + 3) nu/c of the innovation, in units of S.
    """
    sampled = sample([0.0, 0.1], np.array([False, False, True, False]), seed=84, heavy=True)
    expected = sorted([NU / (NU + 1.0), NU / CONSISTENT_SCALE[1]])
    np.testing.assert_allclose(relative_spread(sampled, [1, 3]), expected, rtol=0.05)
    assert not np.any(sampled.score[:, [0, 2]])
    assert not np.any(sampled.information[[0, 2]])


def test_information_is_nearly_the_scores_covariance_driving() -> None:
    """Three rows, four scales; rows are taken for independent, so within a third."""
    sampled = sample([0.2, 0.05], np.array([True, True, True, False]), seed=85, heavy=True)
    spread = relative_spread(sampled, [0, 1, 2, 3])
    assert np.all((spread > 0.67) & (spread < 1.33)), spread
    of_scales = np.var(sampled.score, axis=0) / np.diag(sampled.information)
    assert np.all((of_scales > 0.8) & (of_scales < 1.25)), of_scales


def two_filters(first: FloatArray, second: FloatArray, z: float, row: int) -> Evidence:
    """Evidence of one row, where the heading's neighbours expect `first` and `second`."""
    mean = np.zeros((STAR_SIZE, 3))
    mean[3], mean[4] = first, second
    measurement = np.zeros(4)
    measurement[row] = z
    available = np.tile(np.arange(4) == row, (STAR_SIZE, 1))
    return star_evidence(innovate(mean, np.eye(3), measurement, np.eye(4), available))


@pytest.mark.parametrize("row", [2, 3])
def test_innovations_on_both_sides_of_pi_are_close(row: int) -> None:
    heading = np.array([0.0, 0.0, 0.2])
    ordinary = two_filters(heading, -heading, 0.3, row).information
    opposite = two_filters(heading, -heading, math.pi, row).information
    lead = 0.4 / (2.0 * NEIGHBOUR_STEP * math.sqrt(2.0))
    assert ordinary[1, 1] == pytest.approx((NU + 1.0) / (NU + 3.0) * lead**2, rel=1e-12)
    np.testing.assert_allclose(opposite, ordinary, rtol=1e-12)


@pytest.mark.parametrize("row", [0, 1])
def test_positions_far_apart_are_far_apart(row: int) -> None:
    away = np.where(np.arange(3) == row, 4.0, 0.0)
    information = two_filters(away, -away, 0.0, row).information
    lead = 8.0 / (2.0 * NEIGHBOUR_STEP * math.sqrt(2.0))
    assert information[1, 1] == pytest.approx((NU + 1.0) / (NU + 3.0) * lead**2, rel=1e-12)


def test_no_measurement_says_nothing() -> None:
    rng = np.random.default_rng(86)
    mean = rng.standard_normal((5, STAR_SIZE, 3))
    P = np.eye(3) * rng.uniform(0.1, 2.0, (5, STAR_SIZE, 1, 1))
    nothing = np.broadcast_to(NO_ROWS, (5, STAR_SIZE, 4))
    evidence = star_evidence(innovate(mean, P, np.full(4, np.nan), np.eye(4), nothing))
    assert evidence.log_likelihood.shape == (5,)
    assert evidence.score.shape == (5, SCALE_COUNT)
    assert evidence.information.shape == (5, SCALE_COUNT, SCALE_COUNT)
    assert not any(np.any(part) for part in evidence)


@pytest.mark.parametrize("mask", ALL_MASKS[1:], ids=str)
def test_masked_rows_contribute_nothing(
    mask: tuple[bool, ...], random_covariances: Covariances
) -> None:
    """Whatever they hold, and whatever their noise would be."""
    rng = np.random.default_rng(87)
    available = np.tile(mask, (STAR_SIZE, 1))
    mean, P = rng.standard_normal((STAR_SIZE, 3)), random_covariances(rng, STAR_SIZE, 3)
    z, noise = rng.standard_normal(4), diagonal_matrix(rng.uniform(0.1, 2.0, (STAR_SIZE, 4)))
    clean = star_evidence(innovate(mean, P, z, noise, available))
    hidden = ~np.array(mask)
    z[hidden] = 1e6
    noise[:, hidden, hidden] *= rng.uniform(0.1, 10.0, (STAR_SIZE, int(np.sum(hidden))))
    dirty = star_evidence(innovate(mean, P, z, noise, available))
    for one, other in zip(clean, dirty, strict=True):
        assert one.tobytes() == other.tobytes()


def test_one_wild_fix_says_only_so_much() -> None:
    """The score is bounded by the tail; of a Gaussian it would grow with the square."""
    mean, P = np.zeros((STAR_SIZE, 3)), np.tile(np.eye(3), (STAR_SIZE, 1, 1))
    noise = diagonal_matrix(np.exp(STAR[:, SCALE_OF_ROW]))
    available = np.tile([True, False, False, False], (STAR_SIZE, 1))
    scores = [
        star_evidence(innovate(mean, P, np.full(4, far), noise, available)).score[2]
        for far in (3.0, 30.0, 300.0, 3000.0)
    ]
    assert scores == sorted(scores)
    # S = 1 + R and R is half of it: at most (nu + 1 - 1) / 2 halved.
    assert scores[-1] == pytest.approx(0.25 * NU, rel=1e-2)
