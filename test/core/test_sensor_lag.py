# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The lags of the sensors: found where the drive shows them, and not mistaken for other errors."""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import pytest

from fnn_ekf_ros.core import sensor_lag
from fnn_ekf_ros.core.arrays import FloatArray
from fnn_ekf_ros.core.results import Epoch
from fnn_ekf_ros.core.rows import COMPASS, LRF_POSE
from fnn_ekf_ros.core.sensor_lag import Lags, at_another_pose, lags_after

STEP_S = 0.1
"""Time from one reading of each sensor to the next [s]."""
FIX_STD, YAW_STD = 0.1, 0.13
"""Noise of the readings (m, rad)."""
SLIP_STD = np.array([0.01, 0.02])
"""What the wheels do not count in a step (m, rad)."""
MEASURED = np.array([True, True, True, False])
"""Rows that are measured each time."""


class Drive(NamedTuple):
    """A drive's epochs, and the yaw that a filter predicts for their ends."""

    epochs: list[Epoch]
    headings: list[float]


def turning(k: int) -> tuple[float, float]:
    """Return speed and rotation rate of step k: curves to both sides, stops (m/s, rad/s)."""
    return (0.05 if k % 90 > 75 else 0.4), (0.9, 0.0, -0.7)[k // 25 % 3]


def circling(_: int) -> tuple[float, float]:
    return 0.4, 0.5


def straight_on(_: int) -> tuple[float, float]:
    return 0.4, 0.0


def drive(
    rng: np.random.Generator,
    *,
    seconds: float = 150.0,
    lags: tuple[int, int] = (0, 0),
    speeds: Callable[[int], tuple[float, float]] = turning,
    lasts: tuple[float, float] = (0.0, 1.0),
    offset: float = 0.0,
    wheels: tuple[float, float] = (1.0, 1.0),
) -> Drive:
    """Return a drive.

    Args:
        rng: of noise and slip.
        seconds: its duration.
        lags: steps by which the stamps of compass and fixes are late.
        speeds: speed and rotation rate by step.
        lasts: std and correlation time of fix errors that last (m, s).
        offset: of the compass, and of the yaw that it lets the filter predict [rad].
        wheels: factors on distance and rotation that the wheels count.
    """
    pose, poses, error = np.zeros(3), [], np.zeros(2)
    kept = math.exp(-STEP_S / lasts[1])
    epochs, headings = [], []
    for k in range(round(seconds / STEP_S)):
        control = np.array(speeds(k)) * STEP_S
        distance, turn = control + SLIP_STD * rng.standard_normal(2)
        middle = pose[2] + 0.5 * turn
        pose = pose + np.array([distance * np.cos(middle), distance * np.sin(middle), turn])
        poses.append(pose)
        late_yaw, late = (poses[max(k - lag, 0)] for lag in lags)
        error = kept * error + lasts[0] * math.sqrt(1.0 - kept**2) * rng.standard_normal(2)
        x, y = late[:2] + error + FIX_STD * rng.standard_normal(2)
        yaw = late_yaw[2] + offset + YAW_STD * rng.standard_normal()
        z = np.array([x, y, math.remainder(yaw, math.tau), 0.0])
        epochs.append(Epoch(control * np.array(wheels), STEP_S, z, MEASURED))
        headings.append(float(pose[2] + offset + 0.03 * rng.standard_normal()))
    return Drive(epochs, headings)


def after(recording: Drive, lags: Lags | None = None) -> Lags:
    lags = lags or Lags()
    for epoch, heading in zip(*recording, strict=True):
        lags = lags_after(lags, epoch, heading, MEASURED)
    return lags


def ever_believed(recording: Drive) -> bool:
    lags = Lags()
    for epoch, heading in zip(*recording, strict=True):
        lags = lags_after(lags, epoch, heading, MEASURED)
        if any(sensor.believed for sensor in lags.sensors):
            return True
    return False


@pytest.mark.parametrize("steps", [(0, 4), (5, 0), (7, 8), (-3, -4)])
def test_lags_are_found_with_an_honest_error(steps: tuple[int, int]) -> None:
    rng = np.random.default_rng(3)
    least = min(*steps, 0)  # readings that are early: the others are late, and the stamps earlier
    ends = []
    for _ in range(8):
        recording = drive(rng, lags=(steps[0] - least, steps[1] - least))
        if least:
            shifted = [
                one._replace(measurement=later.measurement)
                for one, later in zip(recording.epochs, recording.epochs[-least:], strict=False)
            ]
            recording = Drive(shifted, recording.headings[: len(shifted)])
        ends.append(after(recording))
    for place, lag in ((COMPASS, steps[0]), (LRF_POSE, steps[1])):
        found = np.array([end.sensors[place].lag for end in ends])
        std = np.array([end.sensors[place].std for end in ends])
        assert found.mean() == pytest.approx(STEP_S * lag, abs=0.06)
        assert np.all(np.abs(found - found.mean()) < 4.0 * std)
        assert std.max() < 0.1
        assert [end.sensors[place].believed for end in ends] == [lag != 0] * 8


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"lasts": (0.5, 3.0)},
        {"lasts": (0.5, 10.0)},
        {"lasts": (0.4, 100.0)},
        {"offset": 0.15},
        {"offset": 0.8},
        {"wheels": (1.1, 1.0)},
        {"wheels": (1.0, 0.9)},
        {"speeds": straight_on},
        {"speeds": circling},
    ],
    ids=[
        "none",
        "fixes-3s",
        "fixes-10s",
        "fixes-100s",
        "compass-little",
        "compass-much",
        "left-wheel",
        "right-wheel",
        "straight-on",
        "circling",
    ],
)
def test_other_errors_are_no_lag(changes: dict[str, object]) -> None:
    rng = np.random.default_rng(5)
    for _ in range(6):
        assert not ever_believed(drive(rng, **changes))  # type: ignore[arg-type]


@pytest.mark.parametrize("speeds", [straight_on, circling])
def test_driving_that_does_not_change_shows_no_lag_of_the_fixes(
    speeds: Callable[[int], tuple[float, float]],
) -> None:
    lags = after(drive(np.random.default_rng(6), lags=(0, 6), speeds=speeds))
    assert lags.sensors[LRF_POSE].std > 0.3
    assert not lags.sensors[LRF_POSE].believed


def high_passed(samples: FloatArray) -> FloatArray:
    """Return samples `(n, 3)` without their means over the readings before."""
    share = 1.0 - math.exp(-STEP_S / sensor_lag.HIGH_PASS_S)
    means, passed = samples[0], []
    for count, sample in enumerate(samples[1:], start=2):
        passed.append(sample - means)
        means = means + max(share, 1.0 / count) * (sample - means)
    return np.array(passed)


def test_the_lag_is_that_of_a_regression_that_frees_scale_and_direction() -> None:
    readings = round(sensor_lag.BLOCK_S / STEP_S) + 1  # the last one ends the block
    epochs, headings = drive(np.random.default_rng(8), seconds=readings * STEP_S, lags=(2, 4))
    lags, samples = Lags(), []
    for epoch, heading in zip(epochs, headings, strict=True):
        lags = lags_after(lags, epoch, heading, MEASURED)
        speed = (lags.position - lags.position_behind) / sensor_lag.SPEED_S
        z = complex(*epoch.measurement[:2])
        samples.append((z - lags.position, lags.position, speed))
    y, p, v = high_passed(np.array(samples)).T
    # Real and imaginary parts as rows; c = c_r + i c_i turns and scales p.
    columns = [np.r_[p.real, p.imag], np.r_[-p.imag, p.real], np.r_[-v.real, -v.imag]]
    solution, *_ = np.linalg.lstsq(np.stack(columns, axis=1), np.r_[y.real, y.imag], rcond=None)
    assert lags.sensors[LRF_POSE].evidence.information > 0.0
    assert lags.sensors[LRF_POSE].lag == pytest.approx(solution[2], rel=1e-9)


def test_the_speed_is_exact_at_constant_speed_whatever_the_epochs() -> None:
    ends = []
    for parts in (1, 7):
        lags = Lags()
        for _ in range(10 * parts):
            step = Epoch(np.array([0.4, 0.1]) / parts, 0.5 / parts, np.zeros(4), MEASURED)
            lags = lags_after(lags, step)
        ends.append((lags.rotation - lags.rotation_behind) / sensor_lag.SPEED_S)
    assert ends[0] == pytest.approx(0.2, rel=1e-4)
    assert ends[1] == pytest.approx(ends[0], rel=1e-12)


def test_a_pose_that_is_set_keeps_the_lags_and_begins_the_path_anew() -> None:
    rng = np.random.default_rng(9)
    lags = after(drive(rng, lags=(0, 5)))
    assert lags.sensors[LRF_POSE].believed
    elsewhere = drive(rng, seconds=30.0, lags=(0, 5))
    moved = [
        epoch._replace(measurement=epoch.measurement + np.array([50.0, -20.0, 0.0, 0.0]))
        for epoch in elsewhere.epochs
    ]
    later = after(elsewhere._replace(epochs=moved), at_another_pose(lags))
    assert later.sensors[LRF_POSE].lag == pytest.approx(lags.sensors[LRF_POSE].lag, abs=0.06)
    assert later.sensors[LRF_POSE].std < 1.2 * lags.sensors[LRF_POSE].std


def test_a_long_gap_begins_the_means_anew() -> None:
    rng = np.random.default_rng(10)
    lags = after(drive(rng, seconds=20.0))
    before = lags.sensors[LRF_POSE]
    gap = Epoch(np.array([3.0, 1.0]), sensor_lag.LARGEST_GAP_S + STEP_S, np.zeros(4), MEASURED)
    lags = lags_after(lags, gap, 0.0, MEASURED)
    assert lags.sensors[LRF_POSE].averaged == 1
    assert lags.sensors[LRF_POSE].block == before.block


def test_rejected_rows_teach_nothing() -> None:
    lags = after(drive(np.random.default_rng(11), seconds=20.0))
    epoch = Epoch(np.array([0.04, 0.05]), STEP_S, np.full(4, 9.0), MEASURED)
    later = lags_after(lags, epoch, 0.0, np.zeros(4, dtype=np.bool_))
    assert later.sensors == lags.sensors


def test_a_believed_lag_is_given_up_once_the_stamps_are_right() -> None:
    rng = np.random.default_rng(12)
    lags = after(drive(rng, lags=(0, 4)))
    assert lags.sensors[LRF_POSE].believed
    lags = after(drive(rng, seconds=1200.0), at_another_pose(lags))
    assert not lags.sensors[LRF_POSE].believed
