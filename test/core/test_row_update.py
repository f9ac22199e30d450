# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Corrections by single rows of several components, against the matrix formula."""

from typing import NamedTuple

import numpy as np
import pytest
from augmented_ekf import (
    H_FIX,
    H_YAW,
    Gaussian,
    assert_semidefinite,
    corrected,
    of_filter,
    random_bank,
)
from banks import Covariances

from fnn_ekf_ros.core.arrays import BoolArray, FloatArray
from fnn_ekf_ros.core.bank import Bank
from fnn_ekf_ros.core.row_update import Terms, take_row

FILTERS, ROBOTS = 3, 4
SINGULAR = pytest.mark.parametrize("errors", [(3, 4, 5, 6), (3, 4), (5, 6), ()])


class Taken(NamedTuple):
    """A bank after a row, and what `take_row` returned."""

    bank: Bank
    e: FloatArray
    s: FloatArray


def take(bank: Bank, terms: Terms, r: FloatArray, d: FloatArray, some: BoolArray | None) -> Taken:
    x, P = np.zeros_like(bank.mean), bank.covariance.copy()
    e, s = take_row(x, P, terms, r, d, some)
    return Taken(Bank(bank.mean + x, P), e, s)


def row_of(terms: Terms, k: int, n: int) -> FloatArray:
    h = np.zeros((1, 7))
    for i, part in terms:
        h[0, i] = 1.0 if part is None else np.broadcast_to(part, (FILTERS, ROBOTS))[k, n]
    return h


def all_terms(rng: np.random.Generator) -> list[Terms]:
    """Rows of one, two, three and more components, with factors of filters and of robots."""
    of_filters = rng.uniform(-1.0, 1.0, (FILTERS, ROBOTS))
    of_robots = np.array([0.0, 1.0, -0.5, 0.3])
    return [
        ((2, None),),
        ((0, None), (3, None)),
        ((2, None), (5, None), (6, None)),
        ((2, None), (5, of_robots), (6, of_robots)),
        ((1, None), (4, None), (0, of_filters), (3, of_filters)),
    ]


@SINGULAR
@pytest.mark.parametrize("which", range(5))
def test_row_is_the_matrix_formula(
    which: int, errors: tuple[int, ...], random_covariances: Covariances
) -> None:
    rng = np.random.default_rng(10)
    bank = random_bank(rng, random_covariances, FILTERS, (ROBOTS,), errors)
    terms = all_terms(rng)[which]
    r, d = rng.standard_normal((FILTERS, ROBOTS)), rng.uniform(0.01, 2.0, (FILTERS, ROBOTS))
    found = take(bank, terms, r, d, None)
    assert_semidefinite(found.bank.covariance)
    for k in range(FILTERS):
        for n in range(ROBOTS):
            h, noise = row_of(terms, k, n), d[k, n].reshape(1, 1)
            one = of_filter(bank, k, n)
            expected = corrected(one, h, r[k, n].reshape(1), noise)
            s = (h @ one.covariance @ h.T + noise).item()
            np.testing.assert_allclose(found.bank.mean[:, k, n], expected.mean, atol=1e-12)
            np.testing.assert_allclose(
                found.bank.covariance[:, :, k, n], expected.covariance, atol=1e-12
            )
            assert found.s[k, n] == pytest.approx(s)
            assert found.e[k, n] == pytest.approx(r[k, n] / np.sqrt(s))


@pytest.mark.parametrize("which", range(5))
def test_robots_without_the_row_do_not_change(which: int, random_covariances: Covariances) -> None:
    """Bit for bit; the others are corrected as if all had it."""
    rng = np.random.default_rng(11)
    bank = random_bank(rng, random_covariances, FILTERS, (ROBOTS,))
    terms = all_terms(rng)[which]
    r, d = rng.standard_normal((FILTERS, ROBOTS)), rng.uniform(0.01, 2.0, (FILTERS, ROBOTS))
    some = np.array([True, False, True, False])
    part, whole = take(bank, terms, r, d, some), take(bank, terms, r, d, None)
    assert part.bank.mean[..., ~some].tobytes() == bank.mean[..., ~some].tobytes()
    assert part.bank.covariance[..., ~some].tobytes() == bank.covariance[..., ~some].tobytes()
    assert np.array_equal(part.e[:, ~some], np.zeros((FILTERS, 2)))
    assert np.array_equal(part.s[:, ~some], np.ones((FILTERS, 2)))
    for one, other in zip((*part.bank, part.e, part.s), (*whole.bank, whole.e, whole.s),
                          strict=True):  # fmt: skip
        assert one[..., some].tobytes() == other[..., some].tobytes()


@pytest.mark.parametrize("which", range(5))
def test_batch_equals_single_robots(which: int, random_covariances: Covariances) -> None:
    rng = np.random.default_rng(12)
    bank = random_bank(rng, random_covariances, FILTERS, (ROBOTS,))
    terms = all_terms(rng)[which]
    r, d = rng.standard_normal((FILTERS, ROBOTS)), rng.uniform(0.01, 2.0, (FILTERS, ROBOTS))
    whole = take(bank, terms, r, d, None)
    for n in range(ROBOTS):
        of_one = tuple((i, None if part is None else part[..., n]) for i, part in terms)
        alone = Bank(bank.mean[..., n], bank.covariance[..., n])
        single = take(alone, of_one, r[:, n], d[:, n], None)
        np.testing.assert_array_equal(single.bank.mean, whole.bank.mean[..., n])
        np.testing.assert_array_equal(single.bank.covariance, whole.bank.covariance[..., n])


@SINGULAR
def test_rows_one_after_the_other_equal_all_together(
    errors: tuple[int, ...], random_covariances: Covariances
) -> None:
    """x, y and yaw with a coupled R, whitened by the unit triangular factor of R = L D L'."""
    rng = np.random.default_rng(13)
    bank = random_bank(rng, random_covariances, 1, (1,), errors)
    H, R = np.vstack([H_FIX, H_YAW]), random_covariances(rng, 1, 3)[..., 0]
    r = rng.standard_normal(3)
    lower = np.linalg.cholesky(R)
    white = np.linalg.inv(lower / np.diag(lower))
    x, P = np.zeros_like(bank.mean), bank.covariance.copy()
    own = (((0, None), (3, None)), ((1, None), (4, None)), ((2, None), (5, None), (6, None)))
    for m in range(3):
        terms: Terms = own[m]
        for other in range(m):
            part = np.full((1, 1), white[m, other])
            terms = (*terms, *((i, part) for i, _ in own[other]))
        e, d = np.full((1, 1), white[m] @ r), np.full((1, 1), lower[m, m] ** 2)
        take_row(x, P, terms, e, d, None)
    expected = corrected(of_filter(bank, 0, 0), H, r, R)
    np.testing.assert_allclose((bank.mean + x)[:, 0, 0], expected.mean, atol=1e-11)
    np.testing.assert_allclose(P[:, :, 0, 0], expected.covariance, atol=1e-11)
    assert_semidefinite(P)


def test_precise_row_of_an_unknown_sum_leaves_a_covariance() -> None:
    """Where P- - K s K' loses all its digits: 1e8 m^2 of pose and error meet 1e-8 m^2."""
    bank = Bank(np.zeros((7, 1, 1)), np.diag([1e8, 1e8, 10, 1e8, 0, 1, 2.0])[:, :, None, None])
    P = bank.covariance
    for terms in (((0, None), (3, None)), ((1, None), (4, None))):
        P = take(Bank(bank.mean, P), terms, np.zeros((1, 1)), np.full((1, 1), 1e-8), None)[0][1]
    assert_semidefinite(P, 1e-9)
    assert 0.0 <= P[1, 1, 0, 0] <= 1.01e-8
    total = (H_FIX[0] @ P[:, :, 0, 0] @ H_FIX[0]).item()
    assert abs(total) < 1e-6  # what 1e8 leaves of 1e-8 in double precision
    assert Gaussian(bank.mean[:, 0, 0], P[:, :, 0, 0]).covariance[0, 0] == pytest.approx(5e7)
