# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

import itertools
import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import pytest
from drives import UNEVEN_Q as Q
from drives import UNEVEN_R as R
from textbook_ekf import textbook_step

from fnn_ekf_ros.core.arrays import BoolArray, FloatArray
from fnn_ekf_ros.core.bank import (
    Bank,
    Correction,
    Innovations,
    Noise,
    Readings,
    correct,
    innovate,
    noise_of_readings,
    predict,
)
from fnn_ekf_ros.core.evidence import (
    CONSISTENT_SCALE,
    NEIGHBOR_STEP,
    SCALE_COUNT,
    SCALES,
    STAR,
    STAR_SIZE,
    TAIL_DEGREES_OF_FREEDOM,
    Evidence,
    log_likelihood,
    star_evidence,
)
from fnn_ekf_ros.core.motion import MotionModel, move
from fnn_ekf_ros.core.rows import FIX_ROWS, rows_where

Covariances = Callable[[np.random.Generator, int, int], FloatArray]
ALL_MASKS = list(itertools.product([False, True], repeat=4))
STATE_OF_ROW = [0, 1, 2, 2]
SCALE_OF_ROW = [2, 2, 3, 3]
NU = TAIL_DEGREES_OF_FREEDOM


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


@pytest.mark.parametrize("left_over", [0.0, 1e6, math.nan])
@pytest.mark.parametrize("reported", [False, True], ids=["own noise", "reported noise"])
def test_log_likelihood_counts_the_available_rows_only(
    left_over: float, random_covariances: Covariances, reported: bool
) -> None:
    """For three filters of 16 robots, to each of which other rows are available."""
    rng = np.random.default_rng(80)
    robots, available = len(ALL_MASKS), np.array(ALL_MASKS).T
    P = random_covariances(rng, 3 * robots, 3).reshape(3, 3, 3, robots)
    own = rng.uniform(0.1, 2.0, (4, 3, robots))
    fix = random_covariances(rng, robots, 3)
    z = rng.standard_normal((4, robots))
    bank = Bank(np.zeros((3, 3, robots)), P)
    noise = Noise(np.ones((2, 3, robots)), own)
    used = noise_of_readings(noise, (1.0,) * 4, fix if reported else None, available)
    readings = Readings(np.where(available, z, left_over), available)
    taken = correct(bank, innovate(bank, readings, used.measurement), used, available)
    got = log_likelihood(taken.nis, taken.determinant, available.sum(axis=0))
    assert got.shape == (3, robots)
    for f, i in np.ndindex(3, robots):
        R_all = np.diag(own[:, f, i])
        if reported:
            scale = np.sqrt(own[FIX_ROWS, f, i])
            R_all[np.ix_(FIX_ROWS, FIX_ROWS)] = scale[:, None] * fix[..., i] * scale
        rows = np.flatnonzero(available[:, i])
        S = (P[..., f, i][np.ix_(STATE_OF_ROW, STATE_OF_ROW)] + R_all)[np.ix_(rows, rows)]
        assert got[f, i] == pytest.approx(student_log_likelihood(z[rows, i], S), abs=1e-12)


def test_the_star_has_its_center_and_two_neighbors_for_each_scale() -> None:
    assert SCALES == ("forward", "heading", "position", "yaw")
    assert len(SCALES) == SCALE_COUNT
    assert STAR.shape == (SCALE_COUNT, STAR_SIZE) == (4, 9)
    expected = np.zeros((4, 9))
    for scale in range(4):
        expected[scale, 1 + 2 * scale] = NEIGHBOR_STEP
        expected[scale, 2 + 2 * scale] = -NEIGHBOR_STEP
    np.testing.assert_array_equal(STAR, expected)


class Period(NamedTuple):
    """What robots drove and measured; components first, then the batch."""

    control: FloatArray
    measurement: FloatArray
    available: BoolArray


def star_noise(batch: tuple[int, ...]) -> Noise:
    """Return the noise of a star of filters."""
    behind = (1,) * len(batch)
    process = Q[:, None] * np.exp(STAR[:2])
    measurement = R[:, None] * np.exp(STAR[SCALE_OF_ROW])
    return Noise(
        np.broadcast_to(process.reshape(2, STAR_SIZE, *behind), (2, STAR_SIZE, *batch)),
        np.broadcast_to(measurement.reshape(4, STAR_SIZE, *behind), (4, STAR_SIZE, *batch)),
    )


def star_step(filters: Bank, period: Period) -> tuple[Bank, Innovations, Correction]:
    """Take a star of filters over one period, each with noise of its own."""
    noise = star_noise(filters.mean.shape[2:])
    predicted = predict(MotionModel.EXACT_ARC, filters, period.control, noise.process)
    readings = Readings(period.measurement, period.available)
    seen = innovate(predicted, readings, noise.measurement)
    taken = correct(predicted, seen, noise, readings.available)
    return taken.bank, seen, taken


def star_evidence_of(seen: Innovations, taken: Correction, available: BoolArray) -> Evidence:
    """Return what all rows available say to the star of one learner; its axis is left out."""
    rows = rows_where(available)
    evidence = star_evidence(
        seen.innovation[:, :, None],
        seen.variance[:, :, None],
        log_likelihood(taken.nis, taken.determinant, rows.total)[:, None],
        rows,
    )
    return Evidence(evidence.score[:, 0], evidence.information[:, :, 0])


def circle_periods(seed: int, steps: int) -> list[Period]:
    """A robot on a circle, measured by other rows each time."""
    rng = np.random.default_rng(seed)
    truth, periods = np.array([1.0, 2.0, 0.5])[:, None], []
    for _ in range(steps):
        control = np.array([rng.uniform(0.1, 0.4), rng.uniform(0.02, 0.2)])
        driven = control + rng.standard_normal(2) * np.sqrt(4.0 * Q)
        truth = move(MotionModel.EXACT_ARC, truth, driven).mean
        z = truth[STATE_OF_ROW, 0] + rng.standard_normal(4) * np.sqrt(R)
        periods.append(Period(control, z, rng.random(4) < 0.6))
    return periods


def independent_innovations(
    periods: list[Period], theta: FloatArray
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
    filters = Bank(
        np.array([1.0, 2.0, 0.5])[:, None] * np.ones(STAR_SIZE),
        0.01 * np.eye(3)[:, :, None] * np.ones(STAR_SIZE),
    )
    found = []
    for period in periods:
        filters, seen, taken = star_step(filters, period)
        found.append(star_evidence_of(seen, taken, period.available))
    return found


@pytest.mark.parametrize(("h", "tolerance"), [(NEIGHBOR_STEP, 1e-8), (1e-4, 0.03)])
def test_score_is_the_derivative_of_an_independent_filters_log_likelihood(
    h: float, tolerance: float
) -> None:
    """With the star's step to the last digits, and with a tiny one: no bias to speak of."""
    periods = circle_periods(seed=81, steps=60)
    score = np.array([evidence.score for evidence in along_the_star(periods)])
    expected = np.zeros_like(score)
    for scale in range(SCALE_COUNT):
        by_side = []
        for side in (h, -h):
            theta = np.zeros(SCALE_COUNT)
            theta[scale] = side
            seen = independent_innovations(periods, theta)
            by_side.append([student_log_likelihood(r, S) for r, S in seen])
        expected[:, scale] = (np.array(by_side[0]) - np.array(by_side[1])) / (2.0 * h)
    size = np.max(np.abs(expected), axis=0)
    assert np.all(size > 0.1)
    assert np.all(np.abs(score - expected) < tolerance * size)


def test_information_of_an_independent_filter_has_both_terms() -> None:
    """Row by row, of measured rows only."""
    periods = circle_periods(seed=82, steps=40)
    h = 1e-4
    by_offset = {
        (scale, side): independent_innovations(periods, side * h * np.eye(SCALE_COUNT)[scale])
        for scale in range(SCALE_COUNT)
        for side in (1.0, -1.0)
    }
    center = independent_innovations(periods, np.zeros(SCALE_COUNT))
    for i, evidence in enumerate(along_the_star(periods)):
        expected = np.zeros((SCALE_COUNT, SCALE_COUNT))
        n = len(center[i][0])
        for row in range(n):
            pairs = [(by_offset[s, 1.0][i], by_offset[s, -1.0][i]) for s in range(SCALE_COUNT)]
            by_variance = np.array([math.log(p[1][row, row] / m[1][row, row]) for p, m in pairs])
            by_lead = np.array([p[0][row] - m[0][row] for p, m in pairs])
            by_lead /= math.sqrt(center[i][1][row, row])
            both = 0.5 * np.outer(by_variance, by_variance) + np.outer(by_lead, by_lead)
            expected += (NU + n) / (NU + n + 2.0) * both / (2.0 * h) ** 2
        assert np.max(np.abs(evidence.information - expected)) < 0.03 * np.max(expected) + 1e-12
        assert np.min(np.linalg.eigvalsh(evidence.information)) > -1e-12


class Sampled(NamedTuple):
    """Scores of many measurements and their mean information."""

    score: FloatArray
    information: FloatArray


def sample(control: list[float], available: BoolArray, seed: int, heavy: bool) -> Sampled:
    """Run robots that move and measure as the star's center believes, until they are settled.

    The innovations are drawn, not the noise: as Gaussians, or as the likelihood's own Student's t.
    """
    rng = np.random.default_rng(seed)
    runs, n = 100, int(np.sum(available))
    filters = Bank(
        np.zeros((3, STAR_SIZE, runs)),
        1e-3 * np.eye(3)[:, :, None, None] * np.ones((STAR_SIZE, runs)),
    )
    driven = np.array(control)[:, None] * np.ones(runs)
    measured = np.broadcast_to(available[:, None], (4, runs))
    process = star_noise((runs,)).process
    scores, information = [], []
    for i in range(160):
        ahead = predict(MotionModel.EXACT_ARC, filters, driven, process)
        S = np.moveaxis(ahead.covariance[:, :, 0], -1, 0)[:, STATE_OF_ROW][:, :, STATE_OF_ROW]
        root = np.linalg.cholesky((S + np.diag(R))[:, available][:, :, available])
        r = rng.standard_normal((runs, n))
        if heavy:
            r *= np.sqrt(CONSISTENT_SCALE[n] / rng.chisquare(NU, (runs, 1)))
        z = ahead.mean[STATE_OF_ROW, 0]
        z[available] += (root @ r[..., None])[..., 0].T
        filters, seen, taken = star_step(filters, Period(driven, z, measured))
        if i >= 40:
            evidence = star_evidence_of(seen, taken, measured)
            scores.append(evidence.score.T)
            information.append(np.mean(evidence.information, axis=-1))
    return Sampled(np.concatenate(scores), np.mean(information, axis=0))


@pytest.mark.parametrize("heavy", [False, True])
@pytest.mark.slow
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


@pytest.mark.slow
def test_information_is_nearly_the_scores_covariance_driving() -> None:
    """Three rows, four scales; rows are taken for independent, so within a third."""
    sampled = sample([0.2, 0.05], np.array([True, True, True, False]), seed=85, heavy=True)
    spread = relative_spread(sampled, [0, 1, 2, 3])
    assert np.all((spread > 0.67) & (spread < 1.33)), spread
    of_scales = np.var(sampled.score, axis=0) / np.diag(sampled.information)
    assert np.all((of_scales > 0.8) & (of_scales < 1.25)), of_scales


def compared(bank: Bank, z: FloatArray, R: FloatArray, available: BoolArray) -> Evidence:
    """Return the evidence of readings of one robot, with variances `(4, 9)` of theirs."""
    noise = Noise(np.ones((2, STAR_SIZE)), R)
    seen = innovate(bank, Readings(z, available), R)
    return star_evidence_of(seen, correct(bank, seen, noise, available), available)


def unit_bank(mean: FloatArray) -> Bank:
    """Return a star of filters with P = I."""
    return Bank(mean, np.eye(3)[:, :, None] * np.ones(STAR_SIZE))


def two_filters(first: FloatArray, second: FloatArray, z: float, row: int) -> Evidence:
    """Evidence of one row, where the heading's neighbors expect `first` and `second`."""
    mean = np.zeros((3, STAR_SIZE))
    mean[:, 3], mean[:, 4] = first, second
    measurement = np.zeros(4)
    measurement[row] = z
    return compared(unit_bank(mean), measurement, np.ones((4, STAR_SIZE)), np.arange(4) == row)


@pytest.mark.parametrize("row", [2, 3])
def test_innovations_on_both_sides_of_pi_are_close(row: int) -> None:
    heading = np.array([0.0, 0.0, 0.2])
    ordinary = two_filters(heading, -heading, 0.3, row).information
    opposite = two_filters(heading, -heading, math.pi, row).information
    lead = 0.4 / (2.0 * NEIGHBOR_STEP * math.sqrt(2.0))
    assert ordinary[1, 1] == pytest.approx((NU + 1.0) / (NU + 3.0) * lead**2, rel=1e-12)
    np.testing.assert_allclose(opposite, ordinary, rtol=1e-12)


@pytest.mark.parametrize("row", [0, 1])
def test_positions_far_apart_are_far_apart(row: int) -> None:
    away = np.where(np.arange(3) == row, 4.0, 0.0)
    information = two_filters(away, -away, 0.0, row).information
    lead = 8.0 / (2.0 * NEIGHBOR_STEP * math.sqrt(2.0))
    assert information[1, 1] == pytest.approx((NU + 1.0) / (NU + 3.0) * lead**2, rel=1e-12)


def test_no_measurement_says_nothing() -> None:
    """Of two learners of five robots."""
    rng = np.random.default_rng(86)
    variance = rng.uniform(0.1, 2.0, (4, STAR_SIZE, 2, 5))
    nothing = rows_where(np.zeros((4, 5), dtype=np.bool_))
    nis, determinant = np.zeros((STAR_SIZE, 2, 5)), np.ones((STAR_SIZE, 2, 5))
    likelihood = log_likelihood(nis, determinant, nothing.total)
    assert not np.any(likelihood)
    evidence = star_evidence(np.zeros_like(variance), variance, likelihood, nothing)
    assert evidence.score.shape == (SCALE_COUNT, 2, 5)
    assert evidence.information.shape == (SCALE_COUNT, SCALE_COUNT, 2, 5)
    assert not any(np.any(part) for part in evidence)


@pytest.mark.parametrize("mask", ALL_MASKS[1:], ids=str)
def test_masked_rows_contribute_nothing(
    mask: tuple[bool, ...], random_covariances: Covariances
) -> None:
    """Whatever they hold, and whatever their noise would be."""
    rng = np.random.default_rng(87)
    available = np.array(mask)
    bank = Bank(rng.standard_normal((3, STAR_SIZE)), random_covariances(rng, STAR_SIZE, 3))
    z, noise = rng.standard_normal(4), rng.uniform(0.1, 2.0, (4, STAR_SIZE))
    clean = compared(bank, z, noise, available)
    hidden = ~available
    z[hidden] = 1e6
    noise[hidden] *= rng.uniform(0.1, 10.0, (int(np.sum(hidden)), STAR_SIZE))
    dirty = compared(bank, z, noise, available)
    for one, other in zip(clean, dirty, strict=True):
        assert one.tobytes() == other.tobytes()


@pytest.mark.parametrize("mask", ALL_MASKS, ids=str)
def test_rows_that_do_not_teach_add_no_information(
    mask: tuple[bool, ...], random_covariances: Covariances
) -> None:
    """Even where they were measured: it is that of the rows that teach, taken alone."""
    rng = np.random.default_rng(88)
    teaches = np.array(mask)
    bank = Bank(rng.standard_normal((3, STAR_SIZE)), random_covariances(rng, STAR_SIZE, 3))
    z, noise = rng.standard_normal(4), rng.uniform(0.1, 2.0, (4, STAR_SIZE))
    alone = compared(bank, z, noise, teaches)
    seen = innovate(bank, Readings(z, np.ones(4, dtype=np.bool_)), noise)
    likelihood = np.zeros((STAR_SIZE, 1))
    among_all = star_evidence(
        seen.innovation[:, :, None], seen.variance[:, :, None], likelihood, rows_where(teaches)
    )
    assert among_all.information[:, :, 0].tobytes() == alone.information.tobytes()


def test_learners_and_robots_are_told_what_each_is_told_alone() -> None:
    rng = np.random.default_rng(89)
    shape = (STAR_SIZE, 2, 3)
    innovation, variance = rng.standard_normal((4, *shape)), rng.uniform(0.1, 2.0, (4, *shape))
    teaches = rng.random((4, 3)) < 0.7
    likelihood = rng.standard_normal(shape)
    given = innovation.copy()
    together = star_evidence(innovation, variance, likelihood, rows_where(teaches))
    assert innovation.tobytes() == given.tobytes()
    for learner, robot in np.ndindex(2, 3):
        alone = star_evidence(
            innovation[:, :, learner : learner + 1, robot],
            variance[:, :, learner : learner + 1, robot],
            likelihood[:, learner : learner + 1, robot],
            rows_where(teaches[:, robot]),
        )
        for one, other in zip(together, alone, strict=True):
            np.testing.assert_allclose(one[..., learner, robot], other[..., 0], rtol=1e-14)


def test_one_wild_fix_says_only_so_much() -> None:
    """The score is bounded by the tail; of a Gaussian it would grow with the square."""
    noise = np.exp(STAR[SCALE_OF_ROW])
    available = np.array([True, False, False, False])
    bank = unit_bank(np.zeros((3, STAR_SIZE)))
    scores = [
        float(compared(bank, np.full(4, far), noise, available).score[2])
        for far in (3.0, 30.0, 300.0, 3000.0)
    ]
    assert scores == sorted(scores)
    # S = 1 + R and R is half of it: at most (nu + 1 - 1) / 2 halved.
    assert scores[-1] == pytest.approx(0.25 * NU, rel=1e-2)
