# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Verdicts on covariances: bands hold what they promise, however correlated the errors are."""

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from fnn_ekf_ros.evaluation.consistency import (
    Consistency,
    Verdict,
    consistency,
    in_words,
    independent_errors,
    judged,
    nees_consistency,
)


def autoregressive(
    rng: np.random.Generator, n: int, d: int, phi: float, runs: int = 1
) -> NDArray[np.float64]:
    """Return errors `(n, runs * d)` of unit variance with the correlation phi^k at lag k."""
    white = rng.standard_normal((n, runs * d))
    errors = np.empty_like(white)
    errors[0] = white[0]
    for k in range(1, n):
        errors[k] = phi * errors[k - 1] + math.sqrt(1.0 - phi**2) * white[k]
    return errors


@pytest.mark.parametrize("phi", [0.0, 0.5, 0.9, 0.97])
def test_independent_errors_of_a_known_correlation(phi: float) -> None:
    """1 + 2 sum phi^(2 k) = (1 + phi^2) / (1 - phi^2)."""
    rng = np.random.default_rng(3)
    errors = autoregressive(rng, 4000, 3, phi, runs=8)
    found = [independent_errors(each) for each in np.split(errors, 8, axis=1)]
    assert np.mean(found) == pytest.approx(4000 * (1 - phi**2) / (1 + phi**2), rel=0.15)


def test_independent_errors_between_one_and_all() -> None:
    assert independent_errors(np.full((1000, 3), 0.7)) == pytest.approx(1.5, abs=0.5)
    assert independent_errors(np.array([[1.0], [-1.0]] * 50)) == 100.0
    assert independent_errors(np.zeros((5, 2))) == 5.0
    huge = 1e150 * np.random.default_rng(1).standard_normal((500, 2))
    assert independent_errors(huge) == pytest.approx(500.0, rel=0.1)


@pytest.mark.parametrize("phi", [0.0, 0.9, 0.97])
def test_an_honest_covariance_is_called_so_in_about_95_of_100_runs(phi: float) -> None:
    """The band without regard to correlation would hold a third of the runs at 0.97.

    Those inside of what is negligible are honest as well, so at least the band's share.
    """
    rng = np.random.default_rng(7)
    errors = autoregressive(rng, 1500, 3, phi, runs=200)
    found = [consistency(each) for each in np.split(errors, 200, axis=1)]
    inside = np.mean([each.low <= each.ratio <= each.high for each in found])
    assert 0.91 <= inside <= 0.99
    assert np.mean([each.verdict is Verdict.HONEST for each in found]) >= inside


@pytest.mark.parametrize(
    ("factor", "verdict"),
    [(2.3, Verdict.TOO_SURE), (1.2, Verdict.TOO_SURE), (0.5, Verdict.TOO_CAUTIOUS)],
)
def test_covariances_that_are_not_honest_are_found(factor: float, verdict: Verdict) -> None:
    rng = np.random.default_rng(11)
    for each in np.split(autoregressive(rng, 3000, 3, 0.8, runs=20), 20, axis=1):
        found = consistency(factor * each)
        assert found.verdict is verdict
        assert math.sqrt(found.ratio) == pytest.approx(factor, rel=0.15)


def test_nees_against_the_textbook() -> None:
    rng = np.random.default_rng(5)
    A = rng.standard_normal((50, 3, 3))
    P = A @ np.swapaxes(A, 1, 2) + 0.1 * np.eye(3)
    e = rng.standard_normal((50, 3))
    expected = np.mean([x @ np.linalg.inv(p) @ x for x, p in zip(e, P, strict=True)])
    assert 3.0 * nees_consistency(e, P).ratio == pytest.approx(expected, rel=1e-9)


def test_errors_that_are_not_known_are_left_out() -> None:
    e = np.array([[1.0, 1.0, math.nan], [1.0, 1.0, 1.0]])
    P = np.tile(np.eye(3), (2, 1, 1))
    assert nees_consistency(e, P).size == 1
    assert nees_consistency(e[:1], P[:1]).verdict is Verdict.UNKNOWN
    assert nees_consistency(e[:, :2], P[:, :2, :2]).size == 2


def test_differences_that_nobody_tunes_for_are_honest() -> None:
    assert judged(1.1, 100000, 100000.0, 3.0).verdict is Verdict.HONEST
    assert judged(1.3, 100000, 100000.0, 3.0).verdict is Verdict.TOO_SURE
    assert judged(0.9, 100000, 100000.0, 3.0).verdict is Verdict.HONEST
    assert judged(0.7, 100000, 100000.0, 3.0).verdict is Verdict.TOO_CAUTIOUS


def test_words() -> None:
    def words(ratio: float, independent: float, verdict: Verdict) -> str:
        return in_words(Consistency(ratio, 0.9, 1.1, 500, independent, 3.0, verdict))

    assert words(1.0, 100.0, Verdict.HONEST) == "honest"
    assert words(5.29, 100.0, Verdict.TOO_SURE) == "too sure: errors are 2.3 times what it says"
    assert words(0.25, 100.0, Verdict.TOO_CAUTIOUS) == (
        "too cautious: errors are 0.5 times what it says"
    )
    assert words(1.0, 2.2, Verdict.HONEST) == "honest (few independent errors: 2)"
    assert "2517 times" in words(19e6 / 3.0, 50.0, Verdict.TOO_SURE)
    assert words(math.nan, 0.0, Verdict.UNKNOWN) == "not known"
