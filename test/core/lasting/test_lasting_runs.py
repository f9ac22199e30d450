# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Mode `joint` on simulated drives with errors that last, and with none."""

import dataclasses
from collections.abc import Callable

import numpy as np
import pytest
from lasting_drives import Errors, lasting_drive, rms, tracked

from fnn_ekf_ros.core.angles import wrap_angle
from fnn_ekf_ros.core.arrays import Row
from fnn_ekf_ros.core.filter import fuse
from fnn_ekf_ros.core.lasting.compass_offset import offset_of
from fnn_ekf_ros.core.lasting.members import WHITE
from fnn_ekf_ros.core.state import FilterModel, FilterState, reset_pose

pytestmark = pytest.mark.slow
MakeAdaptation = Callable[..., object]


@pytest.fixture(scope="module")
def plain(joint: FilterModel, make_adaptation: MakeAdaptation) -> FilterModel:
    return dataclasses.replace(joint, adaptation=make_adaptation(mode="none"))


def white_weight(state: FilterState) -> float:
    assert state.lasting is not None
    return float(state.lasting.weights[WHITE].mean())


def assert_offset(state: FilterState, expected: float) -> None:
    assert state.lasting is not None
    assert np.all(state.lasting.offset.believed)
    offset, variance = offset_of(state.lasting.bank)
    np.testing.assert_allclose(offset, expected, atol=0.1)
    assert np.all(variance < 0.1**2)


def test_white_noise_from_the_right_start_costs_a_percent(
    joint: FilterModel, plain: FilterModel
) -> None:
    """Against the filter that knows the noise."""
    drive = lasting_drive(7, 20, 400, Errors())
    found, oracle = tracked(joint, drive), tracked(plain, drive)
    assert np.all(rms(found.error) < 1.01 * rms(oracle.error))
    assert white_weight(found.states[-1]) > 0.9
    mean_nees = float(found.nees.mean())
    assert 1.2 < mean_nees < 3.5
    last = found.states[-1].lasting
    assert last is not None
    assert not last.offset.believed.any()
    assert not last.offset.doubted.any()


def test_weights_leave_the_white_member_where_fix_errors_last(joint: FilterModel) -> None:
    """Then the covariance tells of them, and the pose follows the fixes' errors less."""
    drive = lasting_drive(7, 4, 800, Errors(fix_std=0.5))
    alone = dataclasses.replace(joint, lasting_errors=False)
    found, white = tracked(joint, drive), tracked(alone, drive)
    assert white_weight(found.states[100]) > 0.8
    assert white_weight(found.states[-1]) < 0.5
    late = slice(400, None)
    assert np.all(rms(found.error[late])[:2] < rms(white.error[late])[:2])
    assert found.nees[late].mean() < 0.5 * white.nees[late].mean()


def test_compass_that_is_off_from_the_first_reading_is_found(
    joint: FilterModel, plain: FilterModel
) -> None:
    drive = lasting_drive(7, 6, 400, Errors(offset=0.8))
    found, without = tracked(joint, drive, 0.8), tracked(plain, drive, 0.8)
    assert_offset(found.states[-1], 0.8)
    late = slice(300, None)
    assert np.all(rms(found.error[late]) < 0.06)
    assert rms(without.error[late])[2] > 0.3
    assert found.nees[late].mean() < 4.0


@pytest.mark.parametrize("offset", [np.pi, -2.5, 1.6])
def test_large_offset_from_the_first_reading_is_found_within_30_s(
    joint: FilterModel, offset: float
) -> None:
    """Whatever its size: about pi a fix does not say to which side the yaw is wrong."""
    drive = lasting_drive(7, 6, 80, Errors(offset=offset))
    state = tracked(joint, drive, offset).states[-1]
    assert state.lasting is not None
    assert np.all(state.lasting.offset.believed)
    found, _ = offset_of(state.lasting.bank)
    np.testing.assert_allclose(np.cos(found - offset), 1.0, atol=0.1)


@pytest.mark.parametrize("offset", [np.pi, -1.6])
def test_pose_that_was_given_does_not_follow_a_compass_that_is_off(
    joint: FilterModel, offset: float
) -> None:
    """From the first reading on, before it is believed and after."""
    drive = lasting_drive(7, 6, 80, Errors(offset=offset))
    found = tracked(joint, drive)
    assert np.abs(found.error[:, 2]).max() < 0.5
    assert np.hypot(*found.error[:, :2].transpose(1, 0, 2)).max() < 0.4
    assert np.all(rms(found.error)[:2] < 0.1)


def test_wrong_yaw_that_is_said_to_be_exact_does_not_accuse_the_compass(joint: FilterModel) -> None:
    """The robot is found again within 50 s, although the witness was sure of the wrong yaw."""
    drive = lasting_drive(7, 6, 200, Errors())
    state = tracked(joint, drive[:10]).states[-1]
    wrong = drive[9][1] + np.array([1.0, 0.5, 0.6])[:, None]
    exact = np.diag([2e-4, 2e-4, 1e-3])[:, :, None] * np.ones(6)
    state = reset_pose(joint, state, wrong, exact)
    errors = []
    for epoch, truth in drive[10:]:
        state, _ = fuse(joint, state, epoch)
        errors.append(state.mean - truth)
    late = np.array(errors[133:])
    assert np.abs(late[:, :2]).max() < 0.3
    assert np.abs(wrap_angle(late[:, 2])).max() < 0.2
    assert state.lasting is not None
    assert not state.lasting.offset.believed.any()
    assert not state.lasting.offset.doubted.any()


def test_stuck_wheel_turns_no_compass(joint: FilterModel) -> None:
    """The fixes take the compass's side, not the wheels'."""
    drive = lasting_drive(7, 6, 280, Errors(stuck_at=200))
    for state in tracked(joint, drive).states:
        assert state.lasting is not None
        assert not state.lasting.offset.doubted.any()


def test_compass_that_is_turned_while_driving_is_found(joint: FilterModel) -> None:
    """The pose stays the truth's all the time."""
    drive = lasting_drive(7, 6, 560, Errors(turned=1.6, turned_at=300))
    found = tracked(joint, drive)
    assert_offset(found.states[-1], 1.6)
    assert np.abs(found.error[250:, 2]).max() < 0.3
    assert np.all(rms(found.error[250:]) < 0.08)
    doubted = np.array([state.lasting.offset.doubted for state in found.states])  # type: ignore[union-attr]
    assert not doubted[:300].any()
    assert doubted[300:320].any(axis=0).all()
    assert not doubted[400:].any()


def test_compass_that_is_turned_back_is_believed_again(joint: FilterModel) -> None:
    there = lasting_drive(7, 4, 400, Errors(offset=0.8, turned=-0.8, turned_at=200))
    found = tracked(joint, there, 0.8)
    last = found.states[-1].lasting
    assert last is not None
    assert not last.offset.believed.any()
    assert not last.offset.doubted.any()
    np.testing.assert_allclose(offset_of(last.bank)[0], 0.0, atol=0.1)
    assert np.all(rms(found.error[300:]) < 0.08)


def test_compass_that_is_random_for_a_while_leaves_no_false_offset(joint: FilterModel) -> None:
    """As one whose degrees are taken for radians: nothing of it pulls the witness's yaw."""
    rng, robots = np.random.default_rng(5), 60
    drive = lasting_drive(7, robots, 300, Errors())
    for epoch, _ in drive[100:154]:
        epoch.measurement[Row.COMPASS_YAW] = rng.uniform(-np.pi, np.pi, robots)
    found = tracked(joint, drive)
    doubted = np.array([state.lasting.offset.doubted for state in found.states])  # type: ignore[union-attr]
    believed = np.array([state.lasting.offset.believed for state in found.states])  # type: ignore[union-attr]
    assert doubted[100:154].any(axis=0).mean() > 0.9
    assert not believed.any()
    assert not doubted[200:].any()
    assert np.abs(found.error[200:, 2]).max() < 0.5
    assert np.all(rms(found.error[200:]) < 0.1)
