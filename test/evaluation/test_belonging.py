# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Truths of another frame, map, clock or scale are named; the right ones are not."""

import math

import numpy as np
import pytest
from tracks import noisy, wiggling

from fnn_ekf_ros.evaluation.alignment import Similarity, fit
from fnn_ekf_ros.evaluation.belonging import warnings
from fnn_ekf_ros.timeline.trajectory import Trajectory

TRUTH = wiggling()


def moved(motion: Similarity, later_s: float = 0.0) -> Trajectory:
    """A noisy track after a motion of the plane, stamped later."""
    track = noisy(TRUTH)
    return Trajectory(
        track.time_ns + round(later_s * 1e9), motion.poses(track.pose), track.covariance
    )


def test_a_track_that_belongs_to_its_truth_gives_no_warning() -> None:
    assert warnings(noisy(TRUTH), TRUTH) == []


@pytest.mark.parametrize(
    ("motion", "later_s", "words"),
    [
        (Similarity(0.0, 54.0, -3.0), 0.0, ["another frame or map", "moved by (-54, 3"]),
        (Similarity(1.2, 0.0, 0.0), 0.0, ["another frame or map", "turned by -1.2 rad"]),
        (Similarity(0.0, 0.0, 0.0), 2.0, ["another clock", "stamped 2.", "s earlier"]),
        (Similarity(0.0, 0.0, 0.0), -3.0, ["another clock", "stamped 2.9", "s later"]),
        (Similarity(0.7, 0.0, 0.0, 1.0, mirrored=True), 0.0, ["a mirrored map", "mirrored"]),
        (Similarity(0.0, 0.0, 0.0, 1.111), 0.0, ["another scale", "made 0.9 times as large"]),
        (Similarity(0.3, 9.0, 0.0), 4.0, ["another frame and clock", "turned by -0.3"]),
    ],
)  # fmt: skip
def test_what_does_not_belong_together_is_named_with_its_numbers(
    motion: Similarity, later_s: float, words: list[str]
) -> None:
    (said,) = [text for text in warnings(moved(motion, later_s), TRUTH) if "RMSE" in text]
    assert said.startswith("ground truth and odom do not belong together")
    for word in words:
        assert word in said, said
    left = float(said.partition("has a position RMSE of ")[2].split(" m ")[0])
    assert left == pytest.approx(math.hypot(0.1, 0.1), rel=0.15)


def test_large_errors_that_nothing_explains_are_told_with_their_size() -> None:
    rng = np.random.default_rng(2)
    track = noisy(TRUTH)
    pose = track.pose.copy()
    pose[:, :2] = 30.0 * rng.standard_normal((len(pose), 2))
    (said,) = warnings(Trajectory(track.time_ns, pose, track.covariance), TRUTH)
    assert "no shift, turn, mirror image, scale or delay explains them" in said


def test_errors_that_the_covariance_claims_need_no_explanation() -> None:
    track = moved(Similarity(0.0, 5.0, 0.0))
    honest = Trajectory(track.time_ns, track.pose, 2500.0 * track.covariance)
    assert warnings(honest, TRUTH) == []


def test_frames_of_other_names_are_told() -> None:
    track, truth = noisy(TRUTH), wiggling()
    named = Trajectory(track.time_ns, track.pose, track.covariance, "map")
    (said,) = warnings(named, Trajectory(truth.time_ns, truth.pose, truth.covariance, "world"))
    assert "'map'" in said
    assert "'world'" in said


def test_a_constant_error_of_the_yaw_is_told() -> None:
    track = noisy(TRUTH)
    pose = track.pose + np.array([0.0, 0.0, math.pi / 2.0])
    (said,) = warnings(Trajectory(track.time_ns, pose, track.covariance), TRUTH)
    assert "constant 1.56 rad" in said


def test_fit_finds_the_motion_it_is_given() -> None:
    rng = np.random.default_rng(4)
    for mirrored in (False, True):
        given = Similarity(2.5, -3.0, 7.0, 0.6, mirrored)
        xy = rng.standard_normal((30, 2))
        target = given.poses(np.column_stack([xy, np.zeros(30)]))[:, :2]
        found = fit(xy, target, with_scale=True, mirrored=mirrored)
        assert found == pytest.approx(given)
