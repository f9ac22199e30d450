# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Scores against numbers worked out by hand."""

import math

import numpy as np
import pytest
from localizers import SECOND_NS
from tracks import STRAIGHT, track

from fnn_ekf_ros.evaluation.evaluation import AgainstTruth, against_truth
from fnn_ekf_ros.timeline.trajectory import Trajectory, interpolate


def mean_nees(found: AgainstTruth) -> float:
    return 3.0 * found.nees.ratio


def test_errors_of_a_constant_offset() -> None:
    estimate = track(
        [0.5, 1.0, 2.25], [[0.8, -0.4, 0.1], [1.3, -0.4, 0.1], [2.55, -0.4, 0.1]],
        [0.09, 0.16, 0.01],
    )  # fmt: skip
    found = against_truth(estimate, STRAIGHT)
    assert found is not None
    assert found.errors.poses == 3
    assert found.errors.x.rmse == pytest.approx(0.3)
    assert found.errors.y.rmse == pytest.approx(0.4)
    assert found.errors.yaw.rmse == pytest.approx(0.1)
    assert found.errors.position.rmse == pytest.approx(0.5)
    assert mean_nees(found) == pytest.approx(3.0)


def test_errors_of_different_sizes() -> None:
    """x: 0.1 and 0.7, so sqrt((0.01 + 0.49) / 2) = 0.5; nees: 0.01 / 0.25 and 0.49 / 0.25."""
    estimate = track([1.0, 2.0], [[1.1, 0, 0], [1.3, 0, 0]], [0.25, 1.0, 1.0])
    found = against_truth(estimate, STRAIGHT)
    assert found is not None
    assert found.errors.x.rmse == pytest.approx(0.5)
    assert found.errors.y.rmse == found.errors.yaw.rmse == 0.0
    assert mean_nees(found) == pytest.approx((0.04 + 1.96) / 2.0)


def test_nees_uses_the_whole_covariance() -> None:
    """P = [[2, 1], [1, 2]] in x, y: P^-1 = [[2, -1], [-1, 2]] / 3; e = (1, 1): 2 / 3."""
    estimate = track([1.0], [[2.0, 1.0, 0.0]])
    covariance = np.array([[[2.0, 1.0, 0.0], [1.0, 2.0, 0.0], [0.0, 0.0, 1.0]]])
    found = against_truth(Trajectory(estimate.time_ns, estimate.pose, covariance), STRAIGHT)
    assert found is not None
    assert mean_nees(found) == pytest.approx(2.0 / 3.0)


def test_yaw_errors_are_wrapped() -> None:
    truth = track([0.0, 1.0], [[0, 0, 3.1], [0, 0, 3.1]])
    found = against_truth(track([0.5], [[0, 0, -3.1]], [1, 1, 1]), truth)
    assert found is not None
    assert found.errors.yaw.rmse == pytest.approx(2.0 * math.pi - 6.2)


def test_there_is_no_truth_outside_of_it_and_in_long_gaps() -> None:
    truth = track([0.0, 1.0, 3.5, 4.0], [[0, 0, 0], [1, 0, 0], [2, 0, 0], [3, 0, 0]])
    times = np.array([-1, round(0.5e9), round(2.0e9), round(3.75e9), 4 * SECOND_NS + 1])
    known = np.isfinite(interpolate(truth, times)[:, 0])
    np.testing.assert_array_equal(known, [False, True, False, True, False])
    estimate = track([-1.0, 0.5, 2.0, 3.75, 9.0], [[9, 9, 9], [0.5, 0, 0], [9, 9, 9], [2.5, 0, 0],
                                                   [9, 9, 9]], [1, 1, 1])  # fmt: skip
    found = against_truth(estimate, truth)
    assert found is not None
    assert (found.errors.poses, found.errors.position.rmse, found.errors.yaw.rmse) == (2, 0.0, 0.0)


def test_nothing_in_common_is_no_against_truth() -> None:
    assert against_truth(track([10.0], [[0, 0, 0]]), STRAIGHT) is None
    assert against_truth(track([1.0], [[0, 0, 0]]), track([1.0], [[0, 0, 0]])) is None


def test_truth_without_heading_scores_positions_only() -> None:
    truth = track([0.0, 1.0], [[0, 0, math.nan], [1, 0, math.nan]])
    found = against_truth(track([0.5], [[0.5, 2.0, 1.0]], [1, 1, 1]), truth)
    assert found is not None
    assert found.errors.position.rmse == pytest.approx(2.0)
    assert math.isnan(found.errors.yaw.rmse)
    assert math.isnan(mean_nees(found))


def test_an_estimate_without_covariance_has_no_nees() -> None:
    found = against_truth(track([0.5], [[0.5, 0.0, 0.0]]), STRAIGHT)
    assert found is not None
    assert found.errors.yaw.rmse == 0.0
    assert math.isnan(mean_nees(found))


@pytest.mark.parametrize("variance", [math.nan, math.inf, -1.0, 0.0, 1e-320])
def test_nees_of_a_covariance_that_is_none_is_not_known(variance: float) -> None:
    estimate = track([1.0, 2.0], [[1.1, 0, 0], [2.1, 0, 0]], [1.0, 1.0, 1.0])
    estimate.covariance[1, 0, 0] = variance
    found = against_truth(estimate, STRAIGHT)
    assert found is not None
    assert math.isnan(mean_nees(found))
    assert found.errors.x.rmse == pytest.approx(0.1)


def test_two_negative_variances_are_no_covariance() -> None:
    """Their determinant is positive."""
    found = against_truth(track([1.0], [[1.1, 0, 0]], [-1.0, -1.0, 1.0]), STRAIGHT)
    assert found is not None
    assert math.isnan(mean_nees(found))


def test_nees_of_a_pose_that_is_lost_is_nothing() -> None:
    found = against_truth(track([1.0], [[1.1, 0, 0]], [1e300, 1e300, 1e300]), STRAIGHT)
    assert found is not None
    assert mean_nees(found) == pytest.approx(0.0, abs=1e-200)
