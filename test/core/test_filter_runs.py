# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import pytest
from drives import TRUE_Q, TRUE_R

from fnn_ekf_ros.core.adaptation import Adaptation
from fnn_ekf_ros.core.arrays import BoolArray, FloatArray
from fnn_ekf_ros.core.filter import step
from fnn_ekf_ros.core.motion import MotionModel, displacement
from fnn_ekf_ros.core.results import Epoch, StepResult
from fnn_ekf_ros.core.state import FilterModel, FilterState, start_filter

COMPASS_AND_POSITION = np.array([True, True, True, False])


class Drive(NamedTuple):
    """A batch of simulated robots; time first, then components, then runs."""

    start: FloatArray
    control: FloatArray
    measurement: FloatArray
    truth: FloatArray


def simulate(seed: int, runs: int, steps: int) -> Drive:
    """Robots on exact arcs; the encoders do not see the noise of the way and the turn."""
    rng = np.random.default_rng(seed)
    truth = start = np.zeros((3, runs))
    std_Q, std_R = np.sqrt(TRUE_Q)[:, None], np.sqrt(TRUE_R)[:, None]
    controls, measurements, truths = [], [], []
    for i in range(steps):
        control = np.repeat([[0.11], [0.03 + 0.05 * math.sin(0.05 * i)]], runs, axis=1)
        driven = control + rng.standard_normal((2, runs)) * std_Q
        truth = truth + displacement(MotionModel.EXACT_ARC, truth[2], driven)
        noise = rng.standard_normal((4, runs)) * std_R
        controls.append(control)
        measurements.append(truth[[0, 1, 2, 2]] + noise)
        truths.append(truth)
    return Drive(start, np.array(controls), np.array(measurements), np.array(truths))


@pytest.fixture(scope="module")
def drive() -> Drive:
    return simulate(seed=70, runs=100, steps=600)


def filter_drive(
    model: FilterModel, drive: Drive, available: BoolArray = COMPASS_AND_POSITION
) -> tuple[FloatArray, FloatArray, FilterState, StepResult]:
    """Return means, R over time, and the last state and result."""
    mask = np.repeat(available[:, None], drive.start.shape[1], axis=1)
    state = start_filter(model, drive.start, np.diag([0.01, 0.01, 0.018]))
    means, noises = [], []
    for control, measurement in zip(drive.control, drive.measurement, strict=True):
        state, result = step(model, state, [Epoch(control, 0.375, measurement, mask)])
        means.append(state.mean)
        noises.append(state.measurement_noise)
    return np.array(means), np.array(noises), state, result


def rmse(means: FloatArray, drive: Drive) -> FloatArray:
    error = means - drive.truth
    error[:, 2] = np.arctan2(np.sin(error[:, 2]), np.cos(error[:, 2]))
    mean_square: FloatArray = np.mean(error**2, axis=(0, 2))
    return np.sqrt(mean_square)


@pytest.mark.parametrize("wrong", [25.0, 1.0 / 25.0])
@pytest.mark.slow
def test_mode_r_finds_the_true_noise_from_a_start_wrong_by_25(
    make_model: Callable[..., FilterModel],
    make_adaptation: Callable[..., Adaptation],
    drive: Drive,
    wrong: float,
) -> None:
    model = make_model(
        process_noise=tuple(TRUE_Q),
        measurement_noise=tuple(wrong * TRUE_R),
        adaptation=make_adaptation(mode="r"),
    )
    means, noises, last, _ = filter_drive(model, drive)
    # The rule keeps moving R by tens of percent; where it settles is its mean over time and runs.
    settled = np.mean(noises[300:], axis=(0, 2))
    ratio = settled[:3] / TRUE_R[:3]
    assert np.all((ratio < 1.5) & (ratio > 1.0 / 1.5)), ratio
    typical = np.median(noises[300:], axis=(0, 2))[:3] / TRUE_R[:3]
    assert np.all((typical < 1.5) & (typical > 1.0 / 1.5)), typical
    assert np.all(last.measurement_noise[3] == wrong * TRUE_R[3])
    assert np.all(np.isfinite(means))


@pytest.mark.parametrize("wrong", [25.0, 1.0 / 25.0])
@pytest.mark.slow
def test_mode_r_beats_the_plain_filter_that_is_wrong_by_25(
    make_model: Callable[..., FilterModel],
    make_adaptation: Callable[..., Adaptation],
    drive: Drive,
    wrong: float,
) -> None:
    noise = {"process_noise": tuple(TRUE_Q), "measurement_noise": tuple(wrong * TRUE_R)}
    plain = filter_drive(make_model(**noise), drive)[0]
    adaptive = filter_drive(make_model(adaptation=make_adaptation(mode="r"), **noise), drive)[0]
    assert np.all(rmse(adaptive, drive) < 0.9 * rmse(plain, drive))


@pytest.mark.slow
def test_mode_r_costs_next_to_nothing_where_the_noise_is_right(
    make_model: Callable[..., FilterModel], make_adaptation: Callable[..., Adaptation], drive: Drive
) -> None:
    noise = {"process_noise": tuple(TRUE_Q), "measurement_noise": tuple(TRUE_R)}
    plain = filter_drive(make_model(**noise), drive)[0]
    adaptive = filter_drive(make_model(adaptation=make_adaptation(mode="r"), **noise), drive)[0]
    ratio = rmse(adaptive, drive) / rmse(plain, drive)
    assert np.all(ratio < 1.02), ratio
    assert np.any(adaptive != plain)


@pytest.mark.parametrize("mode", ["r", "q", "rq"])
@pytest.mark.parametrize("set_name", ["initial", "published"])
@pytest.mark.slow
def test_centroid_keeps_the_filter_sound(
    make_model: Callable[..., FilterModel],
    make_adaptation: Callable[..., Adaptation],
    request: pytest.FixtureRequest,
    mode: str,
    set_name: str,
) -> None:
    """No promise of accuracy, but finite, positive, in bounds, and on the track."""
    short = simulate(seed=71, runs=10, steps=200)
    adaptation = make_adaptation(mode=mode, kind="centroid", sets=request.getfixturevalue(set_name))
    model = make_model(
        process_noise=tuple(TRUE_Q), measurement_noise=tuple(TRUE_R), adaptation=adaptation
    )
    means, noises, last, result = filter_drive(model, short)
    assert np.any(last.measurement_noise != TRUE_R[:, None]) == ("r" in mode)
    assert np.any(last.process_noise != TRUE_Q[:, None]) == ("q" in mode)
    assert np.all((noises >= 1e-8) & (noises <= 1e2))
    assert np.all((last.process_noise >= 1e-8) & (last.process_noise <= 1e2))
    np.linalg.cholesky(np.moveaxis(last.covariance, -1, 0))
    assert np.all(rmse(means, short) < 0.5)
    assert np.all(np.isfinite(result.nis))


@pytest.mark.slow
def test_mode_q_of_the_published_set_stays_near_the_plain_filter(
    make_model: Callable[..., FilterModel], make_adaptation: Callable[..., Adaptation], drive: Drive
) -> None:
    noise = {"process_noise": tuple(TRUE_Q), "measurement_noise": tuple(TRUE_R)}
    plain = filter_drive(make_model(**noise), drive)[0]
    adaptive, noises, last, _ = filter_drive(
        make_model(adaptation=make_adaptation(mode="q"), **noise), drive
    )
    ratio = rmse(adaptive, drive) / rmse(plain, drive)
    assert np.all(ratio < 1.5), ratio
    assert np.all(noises == TRUE_R[:, None])
    assert np.any(last.process_noise != TRUE_Q[:, None])
