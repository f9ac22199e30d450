# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Tuning of simulated recordings, whose noise is known."""

import dataclasses

import numpy as np
import pytest
from tuning_drives import Noise, drive, recording_of

from fnn_ekf_ros.errors import FnnEkfError
from fnn_ekf_ros.tuning.fit import FULL, SHORT_OUTAGES, beginnings, errors_last, fit
from fnn_ekf_ros.tuning.objective import Timed
from fnn_ekf_ros.tuning.plain import plain_noise
from fnn_ekf_ros.tuning.quantities import LASTING, Quantity
from fnn_ekf_ros.tuning.tune import configured, found_parameters, tune
from fnn_ekf_ros.tuning.uncertainty import gradient_covariance, intervals, profiles
from fnn_ekf_ros.tuning.words import lines, remarks, table

NOISE = (Quantity.DISTANCE, Quantity.ROTATION, Quantity.POSITION, Quantity.COMPASS)


def quiet(_: str) -> None:
    pass


@pytest.mark.slow
def test_white_noise_is_found_within_its_standard_errors() -> None:
    recording = drive(np.random.default_rng(1), 700)
    start = configured(recording.parameters)
    found = fit([recording], NOISE, start[:, None], quiet)
    assert found.trusts_next_readings
    truth = np.log([0.02, 0.02, 0.1, 0.1])
    known = intervals(found)
    for interval, true in zip(known, truth, strict=True):
        assert abs(interval.coordinate - true) < 3.0 * interval.std
        assert 0.01 < interval.std < 0.2
        assert not interval.at_bound
    for interval, profile in zip(known, profiles([recording], found, known), strict=True):
        # At 1.96 standard errors a parabola has lost 1.92 nats; points are half an error apart.
        middle = len(profile.values) // 2
        assert profile.log_likelihood[middle] == pytest.approx(0.0, abs=1e-6)
        for at in (middle - 4, middle + 4):
            assert -3.0 < profile.log_likelihood[at] < -1.2, interval


@pytest.mark.slow
def test_lasting_errors_are_found() -> None:
    noise = Noise(position=0.05, fix_error=0.3, fix_time=6.0)
    recording = drive(np.random.default_rng(2), 450, noise)
    found = tune([recording], calibrates=False, progress=quiet)
    assert found.errors_last
    assert found.lasting.fit.trusts_next_readings
    values = found.lasting.fit.values
    assert values[Quantity.FIX_ERROR] == pytest.approx(0.3, rel=0.25)
    known = {interval.quantity: interval for interval in found.lasting.intervals}
    truth = {Quantity.FIX_ERROR: 0.3, Quantity.FIX_TIME: 6.0, Quantity.POSITION: 0.05}
    for quantity, true in truth.items():
        assert abs(known[quantity].coordinate - np.log(true)) < 3.0 * known[quantity].std
        assert known[quantity].std < 0.3
    # The plain filter may not take fixes for as precise as they look from one to the next.
    assert found.after.measurement_noise_std[0] > 0.2
    assert "Errors of the fixes last" in " ".join(remarks([recording], found))


@pytest.mark.slow
def test_calibration_of_compass_wheels_and_delay() -> None:
    recording = drive(np.random.default_rng(3), 450, offset=0.2, delay_steps=1)
    control = recording.control / 1.02  # the robot's wheels are 2 % larger than configured
    recording = recording._replace(control=control)
    found = tune([recording], calibrates=True, progress=quiet)
    assert found.after.compass_offset == pytest.approx(0.2, abs=0.03)
    radius = found.after.wheel_radius / found.before.wheel_radius
    known = {interval.quantity: interval.std for interval in found.shown.intervals}
    assert abs(np.log(radius / 1.02)) < 3.0 * known[Quantity.RADIUS] < 0.06
    delay_s, delay_std_s = found.after.lrf_pose_delay, 0.1 * known[Quantity.FIX_DELAY]
    assert abs(delay_s - 0.375) < 3.0 * delay_std_s < delay_s
    assert found.shown.fit.values[Quantity.FIX_DELAY] == pytest.approx(0.375, abs=0.1)
    named = {line.name: line for line in lines(found, found.shown)}
    assert named["lrf_pose_delay"].now == 0.0
    assert named["compass_offset"].found == pytest.approx(found.after.compass_offset)


def test_a_robot_that_never_turns_is_told_so() -> None:
    rng = np.random.default_rng(4)
    steps = 120
    control = np.stack([np.full(steps, 0.1), np.zeros(steps)])
    z = np.zeros((4, steps))
    z[0] = np.cumsum(control[0])
    z[:3] += 0.05 * rng.standard_normal((3, steps))
    recording = recording_of(control, z)
    found = tune([recording], calibrates=True, progress=quiet)
    said = " ".join(remarks([recording], found))
    assert "0.0 turns" in said
    of_separation = [line for line in lines(found, found.shown) if line.name == "wheel_separation"]
    assert of_separation[0].hardly_known
    assert "wheel_separation" in said
    assert "wheel_separation" in table(lines(found, found.shown))


def test_too_few_fixes_are_refused() -> None:
    with pytest.raises(FnnEkfError, match="20 fixes in the recordings: expected at least 30"):
        tune([drive(np.random.default_rng(5), 20)], calibrates=False, progress=quiet)


def test_found_noise_stays_within_the_bounds_of_the_parameters() -> None:
    before = dataclasses.replace(
        drive(np.random.default_rng(6), 40).parameters,
        process_noise_std_min=(0.01, 0.01),
        measurement_noise_std_max=(0.5, 0.5, 0.5),
    )
    values = configured(before)
    values[list(NOISE)] = 1e-4, 0.02, 3.0, 0.123456
    after = found_parameters(before, values, NOISE, ())
    assert after.process_noise_std == (0.01, 0.02)
    assert after.measurement_noise_std == (0.5, 0.5, 0.1235)
    assert after.wheel_radius == before.wheel_radius


def test_the_covariance_of_gradients_counts_correlated_contributions() -> None:
    rng = np.random.default_rng(7)
    white = rng.standard_normal((4, 4000, 1))
    time_s = 0.375 * np.arange(4000)
    alike = np.repeat(white[:, ::8], 8, axis=1)
    weights = np.array([1.0, 0.0, 0.0, 0.0])
    alone, together = (
        gradient_covariance(Timed(time_s, score, score[..., 0]), weights, 30.0)[0, 0]
        for score in (white, alike)
    )
    assert alone == pytest.approx(4000.0, rel=0.25)
    assert together == pytest.approx(8 * 4000.0, rel=0.3)


def test_errors_last_only_if_the_model_gains() -> None:
    recording = drive(np.random.default_rng(8), 60)
    start = configured(recording.parameters)
    white = fit([recording], (Quantity.POSITION,), start[:, None], quiet)
    same = white._replace(cautious=SHORT_OUTAGES)
    assert not errors_last(white, same)
    better = same._replace(weights=SHORT_OUTAGES, cautious_terms=white.cautious_terms + 10.0)
    assert errors_last(white._replace(weights=SHORT_OUTAGES), better)
    assert errors_last(white._replace(weights=SHORT_OUTAGES), same._replace(weights=FULL))


def test_the_plain_filter_is_near_the_one_with_lasting_errors() -> None:
    recording = drive(np.random.default_rng(9), 300, Noise(position=0.05, fix_error=0.2))
    lasting = configured(recording.parameters)
    lasting[:4] = 0.02, 0.02, 0.05, 0.1
    lasting[list(LASTING)] = 0.2, 10.0, 0.0, 1.0
    plain = plain_noise([recording], lasting, NOISE, quiet)
    assert (plain[list(LASTING)][[0, 2]] == 0.0).all()
    assert plain[Quantity.POSITION] > 0.15
    models = beginnings(plain, constant_yaw_error=False)
    assert (models[Quantity.YAW_CONSTANT] == 0.0).all()
    assert (models[Quantity.FIX_ERROR] > 0.0).all()
