# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Corrections of the filters of lasting errors, with a bounded influence of outliers."""

import math

import numpy as np
import pytest
from augmented_ekf import assert_semidefinite, corrected, of_filter
from banks import Covariances
from lasting_banks import Seen, matrices_of, random_seen

from fnn_ekf_ros.core.arrays import BoolArray, FloatArray, Row
from fnn_ekf_ros.core.bank import Bank
from fnn_ekf_ros.core.lasting.comparison import Comparison, compare
from fnn_ekf_ros.core.lasting.correction import (
    LIMIT,
    OUTLIER_MEMORY,
    OUTLIER_NIS,
    OUTLIER_SHARE,
    correct_robustly,
    outlier_share_after,
)
from fnn_ekf_ros.core.lasting.members import COPIES, FILTER_COUNT, WHITE, WITNESS

ALL = list(Row)
SETS_OF_ROWS = [
    [Row.X, Row.Y],
    [Row.COMPASS_YAW],
    [Row.LRF_YAW],
    [Row.X, Row.Y, Row.LRF_YAW],
    ALL,
]
COUPLED = pytest.mark.parametrize("coupled", [False, True], ids=["own noise", "reported noise"])


def compared(seen: Seen) -> Comparison:
    return compare(seen.bank, seen.weights, seen.correcting, seen.readings, seen.noise)


def correct(seen: Seen, rows: BoolArray, share: FloatArray, *, moves: bool = True) -> Bank:
    moving = np.full(rows.shape[1:], moves)
    return correct_robustly(seen.bank, compared(seen), seen.noise, rows, moving, share)


def small(seen: Seen) -> Seen:
    """Return the case with readings that fit, so that no fix is an outlier for any filter."""
    seen.bank.mean[...] *= 0.02
    return seen._replace(readings=seen.readings._replace(values=0.02 * seen.readings.values))


@COUPLED
@pytest.mark.parametrize("fix_yaw", [1.0, 0.0], ids=["no compass", "beside a compass"])
@pytest.mark.parametrize("rows", SETS_OF_ROWS, ids=lambda rows: "+".join(row.name for row in rows))
def test_readings_that_fit_correct_as_the_matrix_formula_says(
    rows: list[Row], fix_yaw: float, coupled: bool, random_covariances: Covariances
) -> None:
    """Members and witness by all rows, copies by the yaws alone."""
    rng = np.random.default_rng(30)
    available = np.zeros((4, 2), dtype=np.bool_)
    available[rows] = True
    seen = small(random_seen(rng, random_covariances, available, coupled=coupled, fix_yaw=fix_yaw))
    assert compared(seen).position_nis.max() < LIMIT
    found = correct(seen, available, np.zeros(2))
    assert_semidefinite(found.covariance)
    for k in range(FILTER_COUNT):
        taken = rows if k < COPIES.start else [row for row in rows if row >= Row.COMPASS_YAW]
        for n in range(2):
            r, H, R = matrices_of(seen, k, n, taken)
            expected = of_filter(seen.bank, k, n)
            if taken:
                expected = corrected(expected, H, r, R)
            np.testing.assert_allclose(found.mean[:, k, n], expected.mean, atol=1e-12)
            np.testing.assert_allclose(
                found.covariance[:, :, k, n], expected.covariance, atol=1e-11
            )


@pytest.mark.parametrize(
    ("share", "moves"), [(0.0, True), (2.0 * OUTLIER_SHARE, True), (2.0 * OUTLIER_SHARE, False)]
)
def test_fix_that_does_not_fit_is_taken_with_more_noise(
    share: float, moves: bool, random_covariances: Covariances
) -> None:
    """R + (max(1, e/h) - 1) (R + P_bb), of x and y; the yaw likewise without P_bb."""
    rng = np.random.default_rng(31)
    rows = [Row.X, Row.Y, Row.LRF_YAW]
    available = np.zeros((4, 2), dtype=np.bool_)
    available[rows] = True
    seen = random_seen(rng, random_covariances, available)
    seen.readings.values[0] += 6.0
    e = compared(seen).position_nis
    assert np.any(e[: COPIES.start] > OUTLIER_NIS)
    assert np.any(e[: COPIES.start] < LIMIT)
    found = correct(seen, available, np.full(2, share), moves=moves)
    for k in range(COPIES.start):
        h = OUTLIER_NIS if k == WHITE and share == 0.0 else LIMIT
        for n in range(2):
            excess = (max(1.0, e[k, n] / h) - 1.0) * (moves or k != WHITE)
            start = of_filter(seen.bank, k, n)
            r, H, R = matrices_of(seen, k, n, rows)
            b = np.array([start.covariance[3, 3], start.covariance[4, 4], 0.0])
            wider = R + np.diag(excess * (np.diag(R) + b))
            expected = corrected(start, H, r, wider)
            apart = found.mean[:, k, n] - expected.mean
            apart[2] = math.remainder(apart[2], 2.0 * math.pi)
            np.testing.assert_allclose(apart, 0.0, atol=1e-11)
            np.testing.assert_allclose(
                found.covariance[:, :, k, n], expected.covariance, atol=1e-11
            )


def test_single_outlier_moves_a_member_that_bounds_it_less(
    random_covariances: Covariances,
) -> None:
    """The farther the fix, the less it moves the member; the white one first follows."""
    rng = np.random.default_rng(32)
    available = np.zeros((4, 1), dtype=np.bool_)
    available[:2] = True
    seen = random_seen(rng, random_covariances, available)
    moves = []
    for far in (1e2, 1e3):
        seen.readings.values[0] = far
        moves.append(abs(correct(seen, available, np.zeros(1)).mean[0] - seen.bank.mean[0]))
    assert np.all(moves[1][: WITNESS + 1] < moves[0][: WITNESS + 1])


def test_robots_are_corrected_by_rows_of_their_own(random_covariances: Covariances) -> None:
    """Batch equals single, with coupled rows that some robots have; none: bit for bit as before."""
    rng = np.random.default_rng(33)
    available = np.array([[1, 1, 0, 1], [1, 1, 1, 0], [0, 0, 0, 0], [1, 1, 1, 1], [0, 0, 1, 1]])
    available = available.T.astype(np.bool_)
    part = np.array([1.0, 0.0, 0.0, 0.0, 0.0])
    seen = random_seen(rng, random_covariances, available, coupled=True, fix_yaw=part)
    found = correct(seen, available, np.zeros(5))
    assert_semidefinite(found.covariance)
    coupling = seen.noise.coupling
    assert coupling is not None
    for n in range(5):
        alone = Seen(
            Bank(*(array[..., n] for array in seen.bank)),
            seen.weights[..., n],
            type(seen.correcting)(*(array[..., n] for array in seen.correcting)),
            type(seen.readings)(*(array[..., n] for array in seen.readings)),
            seen.noise._replace(
                process=seen.noise.process[..., n], measurement=seen.noise.measurement[..., n],
                coupling=type(coupling)(*(array[..., n] for array in coupling)),
            ),
            None,
        )  # fmt: skip
        single = correct(alone, available[:, n], np.zeros(()))
        np.testing.assert_allclose(single.mean, found.mean[..., n], atol=1e-13)
        np.testing.assert_allclose(single.covariance, found.covariance[..., n], atol=1e-13)
    assert found.covariance[..., 2].tobytes() == seen.bank.covariance[..., 2].tobytes()


def test_bank_is_not_changed(random_covariances: Covariances) -> None:
    available = np.ones((4, 2), dtype=np.bool_)
    seen = random_seen(np.random.default_rng(34), random_covariances, available)
    before = [array.tobytes() for array in seen.bank]
    correct(seen, available, np.zeros(2))
    assert [array.tobytes() for array in seen.bank] == before


def test_share_of_outliers(random_covariances: Covariances) -> None:
    available = np.ones((4, 3), dtype=np.bool_)
    seen = compared(random_seen(np.random.default_rng(35), random_covariances, available))
    nis = np.zeros_like(seen.position_nis)
    nis[WHITE] = [OUTLIER_NIS + 0.1, OUTLIER_NIS - 0.1, OUTLIER_NIS + 0.1]
    fixed = np.array([True, True, False])
    after = outlier_share_after(np.full(3, 0.1), seen._replace(position_nis=nis), fixed)
    kept = OUTLIER_MEMORY * 0.1
    np.testing.assert_allclose(after, [kept + 1.0 - OUTLIER_MEMORY, kept, 0.1])
