# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Frozen readings are missing readings; correct ones are never taken for frozen."""

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np
import pytest
from periods import bytes_of

from fnn_ekf_ros.core.arrays import FloatArray
from fnn_ekf_ros.core.filter import fuse, step
from fnn_ekf_ros.core.frozen import (
    FROZEN_DISTANCE,
    FROZEN_READINGS,
    FROZEN_ROTATION,
    JITTER,
    WHEEL_ERROR,
    Unchanged,
    start_unchanged,
    without_frozen,
)
from fnn_ekf_ros.core.motion import MotionModel, displacement
from fnn_ekf_ros.core.results import Epoch
from fnn_ekf_ros.core.rows import COMPASS, LRF_POSE
from fnn_ekf_ros.core.state import FilterModel, start_filter

NOISE = (0.01, 0.01, 0.018, 0.018)
ALL = np.array([True, True, True, False])


class Taken(NamedTuple):
    """A reading after the decision: what the memory holds, and which rows were left."""

    memory: Unchanged
    available: FloatArray


def taken(
    controls: FloatArray, readings: FloatArray, noise: tuple[float, ...] = NOISE
) -> Iterator[Taken]:
    """Yield what becomes of readings `(n, 3)`, each after a step of the wheels `(n, 2)`."""
    memory = start_unchanged(())
    for control, reading in zip(controls, readings, strict=True):
        epoch = Epoch(control, 0.375, np.append(reading, 0.0), ALL)
        memory, left = without_frozen(memory, epoch, noise)
        yield Taken(memory, left.available)


def driven(controls: FloatArray) -> FloatArray:
    """Return the true poses `(n, 3)` after the steps of the wheels."""
    pose, poses = np.zeros(3), []
    for control in controls:
        pose = pose + displacement(MotionModel.EXACT_ARC, pose[2], control)
        poses.append(pose)
    return np.array(poses)


def ever_frozen(
    controls: FloatArray, readings: FloatArray, noise: tuple[float, ...] = NOISE
) -> list[bool]:
    frozen = [each.memory.frozen for each in taken(controls, readings, noise)]
    return [bool(sensor) for sensor in np.any(frozen, axis=0)]


def steps(count: int, distance: float, rotation: float) -> FloatArray:
    return np.tile([distance, rotation], (count, 1))


@pytest.mark.parametrize("jitter", [0.0, 1e-3])
def test_readings_that_stay_while_the_wheels_move_are_left_out_until_they_change(
    jitter: float,
) -> None:
    """1 mm and 1 mrad of jitter, for a minute, are no change."""
    controls = steps(170, 0.1, 0.15)
    noise = jitter * np.random.default_rng(1).standard_normal((160, 3))
    readings = np.concatenate(
        [np.tile([3.0, -2.0, 3.14], (160, 1)) + noise, driven(controls[160:])]
    )
    found = list(taken(controls, readings))
    left = np.array([each.available for each in found])
    by_travel = 1 + int(np.ceil(FROZEN_DISTANCE / 0.1))
    assert by_travel <= FROZEN_READINGS
    assert left[: FROZEN_READINGS - 1, :3].all()
    assert not left[FROZEN_READINGS - 1 : 160].any()
    assert left[160:, :3].all()
    memory = found[159].memory
    np.testing.assert_array_equal(memory.readings, 160.0)
    np.testing.assert_allclose(memory.distance, 15.9)
    np.testing.assert_allclose(memory.rotation, 0.15 * 159)


def test_a_frozen_sensor_stays_so_while_the_robot_stands_or_returns() -> None:
    controls = np.concatenate([steps(6, 0.1, 0.1), steps(5, -0.1, -0.1), steps(5, 0.0, 0.0)])
    *_, last = taken(controls, np.zeros((16, 3)))
    assert last.memory.frozen.all()


def test_few_readings_are_not_frozen_whatever_the_wheels_do() -> None:
    """A driver may send one reading again."""
    count = FROZEN_READINGS - 1
    assert ever_frozen(steps(count, 5.0, 1.0), np.zeros((count, 3))) == [False, False]


def test_a_compass_is_frozen_by_rotations_and_fixes_by_distances() -> None:
    still = np.zeros((40, 3))
    assert ever_frozen(steps(40, 0.0, 0.05), still) == [True, False]
    assert ever_frozen(steps(40, 0.05, 0.0), still) == [False, True]
    assert ever_frozen(steps(40, 0.0, 0.0), still) == [False, False]


def test_a_turn_after_a_long_straight_path_shows_a_frozen_compass() -> None:
    """Wheels of another size seem to rotate the robot: no turn may hide behind their error."""
    straight, turn = steps(300, 0.1, 0.0), steps(12, 0.05, -0.1)
    found = [
        each.memory.frozen[COMPASS]
        for each in taken(np.vstack([straight, turn]), np.zeros((312, 3)))
    ]
    assert not any(found[:300])
    needed = int(np.ceil(FROZEN_ROTATION / (0.1 - 0.05 * WHEEL_ERROR)))
    assert found.index(True) == 300 + needed - 1


@pytest.mark.parametrize("rotation", [0.0, 0.01, 0.2])
@pytest.mark.parametrize("distance", [0.0, 5e-4, 0.02, 0.2])
@pytest.mark.parametrize("resolution", [1e-9, 1e-2])
def test_correct_readings_are_never_frozen(
    distance: float, rotation: float, resolution: float
) -> None:
    """Without noise, of a standing, creeping or driving robot; fine, or of 1 cm and 1 degree."""
    controls = steps(300, distance, rotation)
    steps_of = resolution * np.array([1.0, 1.0, 1.75])
    readings = np.round(driven(controls) / steps_of) * steps_of
    assert ever_frozen(controls, readings) == [False, False]


def test_wheels_of_another_size_do_not_freeze_a_correct_compass_on_a_straight_path() -> None:
    """Radii differ by 5 % at 0.6 m: the wheels report a turn where there is none, for 100 m."""
    controls = steps(1000, 0.1, 0.1 * 0.05 / 0.6)
    readings = driven(steps(1000, 0.1, 0.0))
    assert ever_frozen(controls, readings) == [False, False]


def test_a_precise_sensor_is_not_frozen_by_its_small_noise_while_the_wheels_spin() -> None:
    noise = 1e-3 * np.random.default_rng(2).standard_normal((200, 3))
    spinning = steps(200, 0.1, 0.1)
    assert max(abs(noise).ravel()) < JITTER
    assert ever_frozen(spinning, noise, (1e-6,) * 4) == [False, False]
    assert ever_frozen(spinning, noise) == [True, True]


def test_rows_of_a_batch_are_decided_one_by_one() -> None:
    """The same to the last bit as each robot alone; rows that are not measured may be anything."""
    rng = np.random.default_rng(3)
    memory, alone = start_unchanged((3,)), [start_unchanged(()) for _ in range(3)]
    frozen = np.zeros((2, 3), dtype=bool)
    for number in range(60):
        control = rng.uniform(0.0, 0.2, (2, 3))
        z = np.where(rng.random((4, 3)) < 0.02 * number, rng.standard_normal((4, 3)), 0.5)
        available = (rng.random((4, 3)) < 0.9) & ALL[:, None]
        z[~available] = np.nan
        memory, left = without_frozen(memory, Epoch(control, 0.1, z, available), NOISE)
        for robot in range(3):
            epoch = Epoch(control[:, robot], 0.1, z[:, robot], available[:, robot])
            alone[robot], own = without_frozen(alone[robot], epoch, NOISE)
            np.testing.assert_array_equal(left.available[:, robot], own.available)
            for whole, single in zip(memory, alone[robot], strict=True):
                np.testing.assert_array_equal(whole[..., robot], single)
        frozen |= memory.frozen
    assert frozen.any()


@pytest.mark.parametrize("mode", ["none", "joint", "rq"])
def test_frozen_readings_are_missing_readings_to_the_filter(
    model_of: Callable[..., FilterModel], mode: str
) -> None:
    """From the decision on both filters are the same, bit for bit."""
    model = model_of(mode)
    controls = steps(40, 0.11, 0.05)
    truth = driven(controls)
    frozen_at = 10
    frozen = missing = start_filter(model, np.zeros(3), np.diag([0.01, 0.01, 0.018]))
    for number, (control, pose) in enumerate(zip(controls, truth, strict=True)):
        z = np.append(pose, 0.0)
        if number >= frozen_at:
            z[:2] = truth[frozen_at, :2]
        epoch = Epoch(control, 0.375, z, ALL)
        decided = bool(frozen.unchanged.frozen[LRF_POSE])
        without = epoch._replace(available=ALL & [not decided, not decided, True, False])
        frozen, result = step(model, frozen, [epoch])
        missing, expected = step(model, missing, [without if decided else epoch])
        if decided:
            assert bytes_of(result) == bytes_of(expected)
            assert bytes_of(frozen._replace(unchanged=missing.unchanged)) == bytes_of(missing)
    assert frozen.unchanged.frozen[LRF_POSE]
    assert not frozen.unchanged.frozen[COMPASS]
    assert np.hypot(*(frozen.mean - truth[-1])[:2]) < FROZEN_DISTANCE


def test_an_instant_with_frozen_readings_only_shows_that_nothing_was_used(
    make_model: Callable[..., FilterModel],
) -> None:
    """There is one result for each instant with readings, used or not."""
    model = make_model()
    state = start_filter(model, np.zeros(3), np.diag([0.01, 0.01, 0.018]))
    state = state._replace(
        unchanged=state.unchanged._replace(frozen=np.array([True, True]), readings=np.full(2, 9.0))
    )
    after, seen = fuse(model, state, Epoch(np.array([0.1, 0.1]), 0.375, np.zeros(4), ALL))
    assert seen is not None
    assert not seen.available.any()
    assert seen.nis == 0.0
    blind = Epoch(np.array([0.1, 0.1]), 0.375, np.zeros(4), np.zeros(4, dtype=bool))
    predicted, nothing = fuse(model, state, blind)
    assert nothing is None
    assert bytes_of(after.bank, after.gate) == bytes_of(predicted.bank, predicted.gate)
