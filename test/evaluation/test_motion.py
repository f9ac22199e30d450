# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Corrections and outage forecasts of drives whose answers are known."""

import math

import numpy as np
import pytest
from localizers import SECOND_NS
from numpy.typing import NDArray

from fnn_ekf_ros.evaluation.motion import corrections, forecasts, wheel_path
from fnn_ekf_ros.recordings.run_record import RunRecord
from fnn_ekf_ros.timeline.trajectory import Trajectory

SPEED, TURN, PERIOD_S = 0.4, 0.25, 0.5


def circle(n: int = 200) -> RunRecord:
    """A drive on an exact circle of radius SPEED / TURN from the origin, heading along x."""
    t = PERIOD_S * np.arange(n)
    radius = SPEED / TURN
    pose = np.column_stack([radius * np.sin(TURN * t), radius * (1.0 - np.cos(TURN * t)), TURN * t])
    track = Trajectory(np.round(t * SECOND_NS).astype(np.int64), pose, np.zeros((n, 3, 3)))
    return RunRecord(track, np.tile([SPEED, TURN], (n, 1)))


def with_pose(run: RunRecord, pose: NDArray[np.float64]) -> RunRecord:
    return RunRecord(Trajectory(run.track.time_ns, pose, run.track.covariance), run.twist)


def test_the_wheels_alone_draw_the_circle() -> None:
    run = circle()
    path, bridged = wheel_path(run)
    np.testing.assert_allclose(path, run.track.pose, atol=1e-12)
    assert np.all(bridged)
    assert corrections(run).max == pytest.approx(0.0, abs=1e-12)


def test_a_jump_is_a_correction_of_its_length() -> None:
    run = circle()
    pose = run.track.pose.copy()
    pose[100:, :2] += (0.3, -0.4)
    found = corrections(with_pose(run, pose))
    assert found.max == pytest.approx(0.5)
    assert found.rmse == pytest.approx(0.5 / math.sqrt(199.0))


@pytest.mark.parametrize("gap_s", [10.0, 33.3])
def test_forecasts_of_the_circle_are_exact_between_odoms_too(gap_s: float) -> None:
    run = circle()
    t = np.array([40.0, 61.25, 77.0])
    targets = np.round(t * SECOND_NS).astype(np.int64)
    radius = SPEED / TURN
    xy = radius * np.column_stack([np.sin(TURN * t), 1.0 - np.cos(TURN * t)])
    found = forecasts(run, targets, xy, gap_s)
    np.testing.assert_array_equal(found.time_ns, targets)
    # Between two odoms the arc is cut short to its chord: (v T)^2 / (8 r) = 3 mm.
    np.testing.assert_allclose(found.error, 0.0, atol=0.0035)
    assert found.error[0] < 1e-9


def test_a_yaw_that_is_off_shows_in_the_forecast_as_its_chord() -> None:
    """The forecast is turned about its start: chord of the arc times 2 sin(offset / 2)."""
    run = circle()
    pose = run.track.pose + np.array([0.0, 0.0, 0.1])
    target = np.array([60 * SECOND_NS])
    found = forecasts(with_pose(run, pose), target, run.track.pose[[120], :2], 10.0)
    chord = 2.0 * SPEED / TURN * math.sin(0.5 * TURN * 10.0)
    assert found.error[0] == pytest.approx(chord * 2.0 * math.sin(0.05), rel=1e-6)


def test_forecasts_need_a_start_an_end_and_no_hole_between() -> None:
    run = circle()
    xy = np.zeros((3, 2))
    early_late = np.array([5 * SECOND_NS, 50 * SECOND_NS, 500 * SECOND_NS])
    assert forecasts(run, early_late, xy, 10.0).time_ns.tolist() == [50 * SECOND_NS]
    kept = np.r_[0:90, 100:200]  # 5.5 s without odom, at 45 s
    track = Trajectory(run.track.time_ns[kept], run.track.pose[kept], run.track.covariance[kept])
    holed = RunRecord(track, run.twist[kept])
    times = np.array([44 * SECOND_NS, 52 * SECOND_NS, 70 * SECOND_NS])
    assert forecasts(holed, times, xy, 10.0).time_ns.tolist() == [times[0], times[2]]
    unknown = np.array([[math.nan, 0.0], [0.0, 0.0], [0.0, 0.0]])
    assert forecasts(run, times, unknown, 10.0).time_ns.tolist() == times[1:].tolist()
