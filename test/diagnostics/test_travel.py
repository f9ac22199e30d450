# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The travel of the pose over that of the wheels."""

import numpy as np
import pytest
from localizers import PERIOD_NS, make_parameters

from fnn_ekf_ros.core.arrays import FloatArray
from fnn_ekf_ros.core.motion import MotionModel, move
from fnn_ekf_ros.core.state import start_filter
from fnn_ekf_ros.diagnostics.travel import (
    FEWEST_WINDOWS,
    LARGEST_ERROR,
    SIGMAS,
    Travel,
    TravelRatio,
    TravelRatios,
)
from fnn_ekf_ros.membership.files import networks_for
from fnn_ekf_ros.timeline.events import Estimate
from fnn_ekf_ros.timeline.filter_model import filter_model

PERIOD_S = PERIOD_NS * 1e-9
PERIODS_A_WINDOW = 27
"""The first multiple of 375 ms that is 10 s or more."""
PARAMETERS = make_parameters(adaptation="none")
MODEL = filter_model(PARAMETERS, networks_for(PARAMETERS))
STATE = start_filter(
    MODEL, np.zeros(3), np.eye(3), np.array(MODEL.process_noise), np.array(MODEL.measurement_noise)
)


def estimate(number: int, pose: FloatArray, control: FloatArray) -> Estimate:
    """Return an estimate at a pose, after a period in which the wheels counted `control`."""
    state = STATE._replace(bank=STATE.bank._replace(mean=pose[:, None]))
    np.testing.assert_array_equal(state.mean, pose)
    return Estimate(
        stamp_ns=number * PERIOD_NS,
        state=state,
        twist=control / PERIOD_S,
        twist_variance=np.zeros(2),
        result=None,
    )


def driven(
    windows: int, distance: float, rotation: float, slip: float = 0.0, seed: int = 1
) -> TravelRatios:
    """Return the ratios of a drive on arcs whose pose does a factor of what the wheels count."""
    rng = np.random.default_rng(seed)
    travel = Travel(PERIOD_S)
    pose = np.array([1.0, 2.0, 3.0])
    travel.saw(estimate(0, pose, np.zeros(2)), moved=False)
    for number in range(1, windows * PERIODS_A_WINDOW + 1):
        control = np.array([0.11, 0.04 if number % 90 < 60 else -0.03])
        slipped = slip * rng.standard_normal(2)
        pose = move(MotionModel.EXACT_ARC, pose, control * [distance, rotation] + slipped).mean
        travel.saw(estimate(number, pose, control), moved=False)
    return travel.ratios()


@pytest.mark.parametrize(
    ("distance", "rotation"), [(1.0, 1.0), (4.0, 4.0), (0.5, 2.0), (1.0, -1.0)]
)
def test_the_ratios_are_the_factors(distance: float, rotation: float) -> None:
    """To the second order of the rotation of a period: a chord is shorter than its arc."""
    found = driven(6, distance, rotation)
    assert found.distance is not None
    assert found.rotation is not None
    assert found.rotation.ratio == pytest.approx(rotation, rel=1e-9)
    assert found.distance.ratio == pytest.approx(distance, rel=2e-3)
    assert found.distance.explained > 0.999
    assert found.rotation.explained == pytest.approx(1.0, abs=1e-9)
    assert found.rotation.wrong is (rotation != 1.0)
    assert found.distance.wrong is (distance != 1.0)


@pytest.mark.slow
def test_the_std_is_that_of_the_ratios_of_many_drives() -> None:
    """Wheels that slip, which the pose sees."""
    many = [driven(8, 1.0, 1.0, slip=0.02, seed=seed) for seed in range(40)]
    for name in ("distance", "rotation"):
        each = [getattr(ratios, name) for ratios in many]
        spread = np.std([ratio.ratio for ratio in each])
        typical = np.sqrt(np.mean([ratio.std**2 for ratio in each]))
        assert typical == pytest.approx(spread, rel=0.4)
        assert np.mean([ratio.ratio for ratio in each]) == pytest.approx(1.0, abs=0.03)
        assert not any(ratio.wrong for ratio in each)


def test_a_wheel_that_counts_backward_mixes_distance_and_rotation_up() -> None:
    """What the wheels say of the distance is the robot's rotation, and the other way round."""
    travel, half = Travel(PERIOD_S), 0.3
    pose = np.zeros(3)
    for number in range(12 * PERIODS_A_WINDOW):
        motion = np.array([0.11, 0.06 if number % 70 < 45 else -0.08])
        pose = move(MotionModel.EXACT_ARC, pose, motion).mean
        counted = np.array([half * motion[1], motion[0] / half])  # left wheel inverted
        travel.saw(estimate(number, pose, counted), moved=False)
    ratios = travel.ratios()
    assert ratios.distance is not None
    assert ratios.distance.explained < 0.5


def test_a_short_drive_and_a_robot_that_stands_have_no_ratio() -> None:
    assert driven(FEWEST_WINDOWS - 1, 1.0, 1.0) == TravelRatios(None, None)
    assert driven(FEWEST_WINDOWS, 1.0, 1.0).distance is not None
    travel = Travel(PERIOD_S)
    for number in range(10 * PERIODS_A_WINDOW):
        travel.saw(estimate(number, np.zeros(3), np.zeros(2)), moved=False)
    assert travel.ratios() == TravelRatios(None, None)


def test_a_pose_that_is_moved_and_a_gap_in_time_are_no_travel() -> None:
    travel = Travel(PERIOD_S)
    pose, number = np.zeros(3), 0
    for step in range(8 * PERIODS_A_WINDOW):
        control = np.array([0.1, 0.03])
        pose = move(MotionModel.EXACT_ARC, pose, control).mean
        if moved := step % 100 == 50:
            pose = pose + 50.0
        if step % 100 == 80:
            pose, number = pose - 30.0, number + 1000
        number += 1
        travel.saw(estimate(number, pose, control), moved=moved)
    ratios = travel.ratios()
    assert ratios.distance is not None
    assert ratios.rotation is not None
    assert ratios.distance.ratio == pytest.approx(1.0, abs=1e-3)
    assert ratios.rotation.ratio == pytest.approx(1.0, abs=1e-9)


def test_a_ratio_is_wrong_if_it_is_far_from_one_and_that_is_significant() -> None:
    small, large = 0.9 * LARGEST_ERROR, 1.1 * LARGEST_ERROR
    assert not TravelRatio(1.0 + small, 1e-6, 1.0).wrong
    assert TravelRatio(1.0 + large, 0.9 * large / SIGMAS, 1.0).wrong
    assert TravelRatio(1.0 - large, 0.9 * large / SIGMAS, 1.0).wrong
    assert not TravelRatio(1.0 + large, 1.1 * large / SIGMAS, 1.0).wrong
