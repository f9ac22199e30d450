# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Forecasts of a recording's readings against a textbook filter, and the outages' schedule."""

import numpy as np
import pytest
from textbook_ekf import textbook_step
from tuning_drives import STEP_S, Noise, drive

from fnn_ekf_ros.core.motion import MotionModel, displacement
from fnn_ekf_ros.core.pace import NOMINAL_PERIOD_S
from fnn_ekf_ros.timeline.events import PoseReset
from fnn_ekf_ros.tuning.forecasts import forecasts, poses
from fnn_ekf_ros.tuning.quantities import Quantity
from fnn_ekf_ros.tuning.recording import HORIZONS_S, schedule_of
from fnn_ekf_ros.tuning.tune import configured


def test_a_white_model_is_the_textbook_filter() -> None:
    recording = drive(np.random.default_rng(1), 60, Noise(position=0.05, compass=0.05))
    values = configured(recording.parameters)
    values[[Quantity.POSITION, Quantity.COMPASS]] = 0.1  # so that no reading is an outlier
    seen = poses(recording, values[:, None])
    x, P = recording.mean, recording.covariance
    assert STEP_S == NOMINAL_PERIOD_S
    Q = np.diag(values[[Quantity.DISTANCE, Quantity.ROTATION]] ** 2)
    R = np.diag([0.1, 0.1, 0.1, 1.0]) ** 2
    for t in range(60):
        u, z = recording.control[:, t], recording.measurement[:, t]
        x, P = textbook_step(False, x, P, u, Q, z, R, [0, 1, 2])
        np.testing.assert_allclose(seen.mean[t, :, 0], x, atol=1e-9)
        np.testing.assert_allclose(seen.variance[t, :, 0], np.diag(P), atol=1e-9)


def test_lasting_errors_of_nothing_are_none() -> None:
    recording = drive(np.random.default_rng(2), 300)
    white = configured(recording.parameters)
    lasting = white.copy()
    lasting[[Quantity.FIX_ERROR, Quantity.YAW_ERROR]] = 1e-9
    one = forecasts(recording, white[:, None])
    other = forecasts(recording, lasting[:, None])
    np.testing.assert_allclose(one.fixes.normalized, other.fixes.normalized, atol=1e-6)
    np.testing.assert_allclose(one.compass.variance, other.compass.variance, rtol=1e-6)
    for horizon in range(len(HORIZONS_S)):
        np.testing.assert_allclose(
            one.outages[horizon].normalized, other.outages[horizon].normalized, atol=1e-6
        )


def test_models_do_not_see_each_other() -> None:
    recording = drive(np.random.default_rng(3), 100)
    one = configured(recording.parameters)
    other = one.copy()
    other[Quantity.FIX_ERROR], other[Quantity.RADIUS], other[Quantity.FIX_DELAY] = 0.3, 1.02, 0.1
    together = forecasts(recording, np.stack([one, other], axis=1))
    np.testing.assert_allclose(
        together.fixes.normalized[..., 0],
        forecasts(recording, one[:, None]).fixes.normalized[..., 0],
        atol=1e-9,
    )


def test_forecasts_after_outages_are_as_wrong_as_they_say() -> None:
    recording = drive(np.random.default_rng(4), 1600)
    values = configured(recording.parameters)
    values[:4] = 0.02, 0.02, 0.1, 0.1
    seen = forecasts(recording, values[:, None])
    for items in seen.outages:
        taken = items.taken.astype(bool)
        assert 0.5 < np.mean(items.normalized[taken] ** 2) < 1.6
    short, long = (np.median(items.variance[items.taken.astype(bool)]) for items in seen.outages)
    assert 4 * values[Quantity.POSITION] ** 2 < 4 * short < long


@pytest.mark.parametrize("stands", [False, True])
def test_windows_follow_each_other_and_copies_are_old_enough(stands: bool) -> None:
    steps = 2000
    control = np.full((2, steps), 0.1)
    if stands:
        control[:, 500:700] = 0.0
    duration_s = np.full(steps, 0.375)
    schedule = schedule_of(control, duration_s, np.ones(steps, dtype=bool))
    moving = np.cumsum(np.where(control[0] > 0.0, duration_s, 0.0))
    for place, horizon in enumerate(HORIZONS_S):
        made = {}
        ages = []
        for t in range(steps):
            copy = schedule.scored[t, place]
            if copy >= 0:
                ages.append(moving[t] - made[copy])
            if schedule.renewed[t, place] >= 0:
                made[schedule.renewed[t, place]] = moving[t]
        assert min(ages) >= horizon - 2 * 0.375
        assert max(ages) <= 1.5 * horizon + 2 * 0.375
        first = int(np.argmax(schedule.scored[:, place] >= 0))
        assert (schedule.scored[first:, place] >= 0).all()
        windows = schedule.window[first:, place]
        for window in np.unique(windows):
            weight = schedule.weight[first:, place][windows == window]
            assert weight.sum() == pytest.approx(1.0)


def test_a_pose_that_is_set_counts_from_then_on() -> None:
    recording = drive(np.random.default_rng(5), 60)
    pose, covariance = np.array([5.0, -3.0, 1.0]), 1e-6 * np.eye(3)
    recording = recording._replace(resets={30: PoseReset(0, pose, covariance)})
    values = configured(recording.parameters)
    values[[Quantity.POSITION, Quantity.COMPASS]] = 1e3  # so that readings change nothing
    before, after = poses(recording, values[:, None]).mean[[29, 30], :, 0]
    assert np.hypot(*before[:2]) < 5.0
    step = displacement(MotionModel.EXACT_ARC, pose[2], recording.control[:, 30])
    np.testing.assert_allclose(after, pose + step, atol=1e-3)


def test_variances_that_fixes_report_count_times_the_scale() -> None:
    recording = drive(np.random.default_rng(6), 60)
    values = configured(recording.parameters)
    doubled = values.copy()
    doubled[Quantity.POSITION] *= 2.0
    reported = recording.reported.copy()
    reported[[0, 1]] = 4.0
    np.testing.assert_allclose(
        poses(recording._replace(reported=reported), values[:, None]).mean,
        poses(recording, doubled[:, None]).mean,
        atol=1e-12,
    )
