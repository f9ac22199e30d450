# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The covariance that a fix reports, scaled by what a filter has learned."""

import itertools

import numpy as np
import pytest
from banks import FIX, UNIT, Covariances, corrected_by, dense, full_noise, one_filter
from periods import ALL_ROWS

from fnn_ekf_ros.core.bank import Bank, Noise, Readings, noise_of_readings
from fnn_ekf_ros.core.limits import SMALLEST_STD

FIX_MASKS = list(itertools.product([False, True], repeat=3))


@pytest.mark.parametrize("mask", FIX_MASKS, ids=str)
def test_scales_of_a_report_go_row_by_row_and_end_at_the_best_sensor(
    mask: tuple[bool, ...], random_covariances: Covariances
) -> None:
    """C = D R D, D = diag(max(sqrt(R / R_ref), 1e-4 / std)), and the rows are coupled by C's."""
    rng = np.random.default_rng(24)
    available = np.array([mask[0], mask[1], True, mask[2]])
    reference = (0.01, 0.04, 0.02, 0.01)
    fix = random_covariances(rng, 5, 3)
    fix *= 1e-7  # stds of some 0.3 mm: the second filter's scales would make them too good
    own = np.array(reference)[:, None, None] * np.array([[4.0, 1e-6], [0.25, 1e-6], [1.0, 9.0],
                                                         [1e-6, 16.0]])[:, :, None]  # fmt: skip
    own = np.broadcast_to(own, (4, 2, 5))
    noise = noise_of_readings(Noise(np.ones((2, 2, 5)), own), reference, fix, available[:, None] &
                              np.ones(5, dtype=np.bool_))  # fmt: skip
    P = 1e-6 * random_covariances(rng, 10, 3).reshape(3, 3, 2, 5)
    z = 1e-3 * rng.standard_normal((4, 5))
    rows = [row for row in range(4) if available[row]]
    readings = Readings(z, np.broadcast_to(available[:, None], (4, 5)))
    taken = corrected_by(Bank(np.zeros((3, 2, 5)), P), readings, noise)[1]
    floors = 0
    for f, i in np.ndindex(2, 5):
        std = np.sqrt(np.diag(fix[..., i]))
        ratio = np.sqrt(own[FIX, f, i] / np.array(reference)[FIX])
        scale = np.maximum(ratio, SMALLEST_STD / std)
        floors += int(np.sum(scale > ratio))
        R = full_noise(scale[:, None] * fix[..., i] * scale, own[2, f, i])
        measured = [row for row in FIX if available[row]]
        np.testing.assert_allclose(noise.measurement[measured, f, i], np.diag(R)[measured])
        assert np.all(noise.measurement[measured, f, i] >= SMALLEST_STD**2 * (1.0 - 1e-15))
        hidden = [row for row in range(4) if row not in measured]
        np.testing.assert_array_equal(noise.measurement[hidden, f, i], own[hidden, f, i])
        expected = dense(np.zeros(3), P[..., f, i], z[:, i], R, rows)
        got = taken.bank
        np.testing.assert_allclose(got.mean[:, f, i], expected.mean, rtol=0, atol=1e-14)
        np.testing.assert_allclose(
            got.covariance[..., f, i], expected.covariance, rtol=0, atol=1e-12 * np.max(P)
        )
        assert taken.nis[f, i] == pytest.approx(expected.nis, rel=1e-10)
        assert taken.determinant[f, i] == pytest.approx(expected.determinant, rel=1e-10)
    assert floors > 10


def test_a_scale_makes_no_report_better_than_any_sensor_is() -> None:
    own = np.full((4, 1), 1e-4)
    available = np.array([True, True, False, False])
    noise = noise_of_readings(
        Noise(np.ones((2, 1)), own), UNIT, np.diag([1e-6, 1e-2, 1.0]), available
    )
    np.testing.assert_allclose(noise.measurement[:, 0], [1e-8, 1e-6, 1e-4, 1e-4])


def test_without_a_report_the_filters_run_on_their_own_noise() -> None:
    noise = Noise(np.ones((2, 3)), np.ones((4, 3)))
    assert noise_of_readings(noise, UNIT, None, ALL_ROWS) is noise


def test_correlation_inside_the_measurement_noise_counts() -> None:
    """By hand: P = I, R on x and y = [[1, .5], [.5, 1]], innovation (1, 0)."""
    fix = np.eye(3)
    fix[0, 1] = fix[1, 0] = 0.5
    rows = np.array([True, True, False, False])
    noise = noise_of_readings(Noise(np.ones((2, 1)), np.ones((4, 1))), UNIT, fix, rows)
    readings = Readings(np.array([1.0, 0.0, 0.0, 0.0]), rows)
    _, taken = corrected_by(one_filter(np.zeros(3), np.eye(3)), readings, noise)
    # S = [[2, .5], [.5, 2]], S^-1 = [[2, -.5], [-.5, 2]] / 3.75
    np.testing.assert_allclose(taken.bank.mean[:, 0], [2.0 / 3.75, -0.5 / 3.75, 0.0], atol=1e-15)
    assert taken.nis[0] == pytest.approx(2.0 / 3.75, abs=1e-15)
    assert taken.determinant[0] == pytest.approx(3.75, abs=1e-14)


@pytest.mark.parametrize("correlation", [0.5, 0.99, 0.9999, -0.99999, 0.999998])
@pytest.mark.parametrize("std", [SMALLEST_STD, 1e-2])
def test_lost_pose_takes_over_the_correlation_of_a_fix(correlation: float, std: float) -> None:
    """However nearly singular a report may be: its smallest eigenvalue is 1 - |correlation|."""
    P = np.array([[1e6, 3e5, 50.0], [3e5, 1e6, -40.0], [50.0, -40.0, 1.0]])
    fix = std**2 * np.array([[1.0, correlation, 0.0], [correlation, 1.0, 0.0], [0.0, 0.0, 1.0]])
    rows = np.array([True, True, False, False])
    noise = noise_of_readings(Noise(np.ones((2, 1)), np.ones((4, 1))), UNIT, fix, rows)
    taken = corrected_by(one_filter(np.zeros(3), P), Readings(np.zeros(4), rows), noise)[1]
    found = taken.bank.covariance[..., 0]
    np.testing.assert_allclose(found[:2, :2], fix[:2, :2], rtol=1e-9)
    sizes = np.sqrt(np.diag(found))
    smallest = np.linalg.eigvalsh(found / np.outer(sizes, sizes))[0]
    assert smallest == pytest.approx(1.0 - abs(correlation), rel=1e-3)
