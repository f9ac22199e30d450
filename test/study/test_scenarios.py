# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Recordings of the studies: truth, slip, counts and sensors against what they are said to be."""

import math

import numpy as np
import pytest

from fnn_ekf_ros.core.angles import wrap_angle
from fnn_ekf_ros.core.arrays import FloatArray, Row, components_first, components_last
from fnn_ekf_ros.core.motion import MotionModel, displacement
from fnn_ekf_ros.core.odometry import control_from_counts
from fnn_ekf_ros.parameters.fake_robot import FakeRobotParameters
from fnn_ekf_ros.simulation.robot import wheel_geometry
from fnn_ekf_ros.study.recording import Recording
from fnn_ekf_ros.study.scenarios import (
    NOMINAL,
    NOMINAL_MEASUREMENT_NOISE,
    Drive,
    Scenario,
    drive,
    event_steps,
    record,
    sense,
)

ROBOT = FakeRobotParameters(path="sim1")
STEPS, RUNS = 100, 40
EVENT = event_steps(STEPS)
COUNT_M = wheel_geometry(ROBOT).meters_per_count


def recorded(
    scenario: Scenario = NOMINAL, steps: int = STEPS, runs: int = RUNS, seed: int = 7
) -> Recording:
    return record(ROBOT, scenario, steps, runs, np.random.default_rng(seed))


def standing(steps: int, runs: int) -> Drive:
    """Robots that stand where noise is all there is."""
    return Drive(np.zeros((steps + 1, runs, 3)), np.zeros((steps + 1, runs, 2)))


def noise_of(scenario: Scenario, steps: int = 2000, runs: int = 50, seed: int = 3) -> FloatArray:
    """Return the errors of the sensors `(T, n, 4)` of robots that stand at the origin."""
    sensed = sense(ROBOT, scenario, standing(steps, runs), np.random.default_rng(seed))
    return sensed.measurement


def slip_of(recording: Recording, robot: FakeRobotParameters) -> FloatArray:
    """Return what the encoders missed in each step, `(T, n, 2)`: ahead and in heading (m, rad).

    Ahead is along the direction of the arc's chord, across which slip does next to nothing.
    """
    heading = recording.truth[:-1, :, 2]
    missed = np.diff(recording.truth, axis=0)
    missed[..., 2] = wrap_angle(missed[..., 2])
    control = components_first(recording.control)
    missed -= components_last(displacement(MotionModel.EXACT_ARC, heading, control))
    along = heading + 0.5 * recording.control[..., 1]
    ahead = missed[..., 0] * np.cos(along) + missed[..., 1] * np.sin(along)
    return np.stack([ahead, missed[..., 2]], axis=-1)


def within_six_sigma(samples: FloatArray, std: float) -> bool:
    """Return whether independent normal samples have the standard deviation they should have."""
    spread = math.sqrt(np.mean(samples**2)) / std
    return abs(spread - 1.0) < 6.0 / math.sqrt(2.0 * samples.size)


def test_shapes_and_rows() -> None:
    recording = recorded(steps=12, runs=3)
    assert recording.period_s == 0.375
    assert recording.truth.shape == (13, 3, 3)
    assert recording.control.shape == (12, 3, 2)
    assert recording.measurement.shape == recording.available.shape == (12, 3, 4)
    assert recording.process_noise.shape == (12, 2)
    assert recording.measurement_noise.shape == (12, 4)
    assert recording.available.all(axis=(0, 1)).tolist() == [True, True, True, False]
    assert not recording.available[..., Row.LRF_YAW].any()
    assert np.all(np.abs(recording.measurement[..., Row.COMPASS_YAW :]) <= math.pi)


@pytest.mark.slow
def test_the_same_seed_gives_the_same_recording() -> None:
    one, same, other = recorded(seed=1), recorded(seed=1), recorded(seed=2)
    for a, b in zip(one, same, strict=True):
        np.testing.assert_array_equal(a, b)
    assert np.all(one.truth[1:] != other.truth[1:])
    assert np.all(one.measurement != other.measurement)


def test_runs_differ() -> None:
    truth = recorded(runs=5).truth
    assert len({tuple(pose) for pose in truth[1]}) == 5
    assert np.ptp(truth[0], axis=0).tolist() == [0.0, 0.0, 0.0]


@pytest.mark.slow
def test_sensors_draw_from_a_stream_of_their_own() -> None:
    one, other = recorded(), recorded(Scenario(measurement_scale=25.0, outlier_share=0.1))
    np.testing.assert_array_equal(one.truth, other.truth)
    np.testing.assert_array_equal(one.control, other.control)


def test_a_longer_recording_begins_as_the_shorter_one() -> None:
    long, short = recorded(steps=20), recorded(steps=12)
    np.testing.assert_array_equal(long.truth[:13], short.truth)
    np.testing.assert_array_equal(long.control[:12], short.control)
    np.testing.assert_array_equal(long.measurement[:12], short.measurement)


@pytest.mark.parametrize("path", ["sim1", "sim2", "round"])
@pytest.mark.slow
def test_slip_is_all_that_the_encoders_miss(path: str) -> None:
    robot = FakeRobotParameters(path=path)
    recording = record(robot, NOMINAL, STEPS, RUNS, np.random.default_rng(2))
    slip = slip_of(recording, robot)
    np.testing.assert_allclose(recording.process_noise, [np.square(robot.slip())] * STEPS)
    # The way is short of the arc by 1 - cos of the heading that slip has gained: below 0.1 %.
    assert within_six_sigma(slip[..., 0], robot.slip()[0])
    assert within_six_sigma(slip[..., 1], robot.slip()[1])
    assert abs(np.mean(slip[1:] * slip[:-1] / np.square(robot.slip()))) < 6.0 / math.sqrt(slip.size)


def test_without_slip_truth_is_the_arc_that_the_wheels_rolled() -> None:
    """Thirty arcs, each with its own wheel speeds, seen through whole counts: 0.3 mm a wheel."""
    still = FakeRobotParameters(path="sim1", slip_std=(0.0, 0.0))
    recording = record(still, NOMINAL, STEPS, 4, np.random.default_rng(5))
    turn = np.diff(recording.truth[..., 2], axis=0)
    off = np.abs(wrap_angle(turn - recording.control[..., 1]))
    assert np.max(off) < 2.0 * COUNT_M / 0.6
    assert np.max(off) > 0.2 * COUNT_M / 0.6  # it is not the truth itself that is reported
    # A chord of the arcs is shorter than the arcs by way * turn^2 / 24 at the most.
    way = np.linalg.norm(np.diff(recording.truth[..., :2], axis=0), axis=-1)
    assert np.max(np.abs(way - recording.control[..., 0])) < 2.0 * COUNT_M + 0.12 * 0.6**2 / 24.0


def test_controls_are_whole_counts() -> None:
    recording = recorded()
    way, turn = np.moveaxis(recording.control, -1, 0)
    for wheel in (way - 0.3 * turn, way + 0.3 * turn):
        counts = wheel / COUNT_M
        np.testing.assert_allclose(counts, np.round(counts), atol=1e-6)
        assert len(np.unique(np.round(counts))) > 20


def test_rounding_to_counts_adds_its_variance_and_does_not_pile_up() -> None:
    """A count is rounded off at both ends: way (C_m^2 / 12) (1/4 + 1/4) 2 = C_m^2 / 12."""
    driven = drive(ROBOT, NOMINAL, STEPS, RUNS, np.random.default_rng(4))
    control = sense(ROBOT, NOMINAL, driven, np.random.default_rng(0)).control
    rolled = np.diff(np.mean(driven.travel, axis=-1), axis=0)
    error = control[..., 0] - rolled
    assert np.var(error) == pytest.approx(COUNT_M**2 / 12.0, rel=0.1)
    assert np.max(np.abs(np.sum(error, axis=0))) < COUNT_M


def test_noise_of_the_sensors() -> None:
    noise = noise_of(NOMINAL)
    for row in Row:
        assert within_six_sigma(noise[..., row], math.sqrt(NOMINAL_MEASUREMENT_NOISE[row]))
    lag = np.mean(noise[1:] * noise[:-1], axis=(0, 1)) / NOMINAL_MEASUREMENT_NOISE
    assert np.all(np.abs(lag) < 6.0 / math.sqrt(noise[..., 0].size))
    across = np.corrcoef(noise.reshape(-1, 4).T) - np.eye(4)
    assert np.max(np.abs(across)) < 6.0 / math.sqrt(noise[..., 0].size)


def test_colored_fixes() -> None:
    noise = noise_of(Scenario(fix_correlation=0.5)) / np.sqrt(NOMINAL_MEASUREMENT_NOISE)
    for row, first, second in ((Row.X, 0.5, 0.25), (Row.Y, 0.5, 0.25), (Row.COMPASS_YAW, 0, 0)):
        assert np.mean(noise[..., row] ** 2) == pytest.approx(1.0, abs=0.03)
        for lag, expected in ((1, first), (2, second)):
            found = np.mean(noise[lag:, :, row] * noise[:-lag, :, row])
            assert found == pytest.approx(expected, abs=0.03)


def test_colored_fixes_are_colored_from_the_first_one_on() -> None:
    noise = noise_of(Scenario(fix_correlation=0.5), steps=3, runs=20_000)
    variance = np.mean(noise**2, axis=1) / NOMINAL_MEASUREMENT_NOISE
    np.testing.assert_allclose(variance, 1.0, atol=0.05)


def test_outliers() -> None:
    scenario = Scenario(outlier_share=0.05, outlier_scale=10.0)
    recording = sense(ROBOT, scenario, standing(2000, 50), np.random.default_rng(3))
    noise = recording.measurement / np.sqrt(NOMINAL_MEASUREMENT_NOISE)
    far = np.abs(noise) > 5.0  # one in two million without outliers, 62 % of those
    assert np.mean(far[..., Row.X]) == pytest.approx(0.05 * 0.617, rel=0.1)
    assert np.mean(far[..., Row.X] & far[..., Row.Y]) == pytest.approx(0.05 * 0.617**2, rel=0.1)
    assert not far[..., Row.COMPASS_YAW].any()
    assert np.mean(far[:, ::2, Row.X] & far[:, 1::2, Row.X]) < 0.01  # each run has its own
    variance = 0.95 + 0.05 * 100.0
    assert np.mean(noise[..., Row.Y] ** 2) == pytest.approx(variance, rel=0.05)
    said = recording.measurement_noise / NOMINAL_MEASUREMENT_NOISE
    np.testing.assert_allclose(said, [[variance, variance, 1.0, 1.0]] * 2000)


def test_the_event_is_the_third_minute_of_five() -> None:
    assert event_steps(800) == slice(320, 480)
    assert (320 * 0.375, 480 * 0.375) == (120.0, 180.0)


def test_slip_in_the_event() -> None:
    recording = recorded(Scenario(process_scale=100.0))
    slip = slip_of(recording, ROBOT) / ROBOT.slip()
    assert recording.process_noise[:, 1] / ROBOT.slip()[1] ** 2 == pytest.approx(
        [100.0 if EVENT.start <= t < EVENT.stop else 1.0 for t in range(STEPS)]
    )
    assert np.std(slip[EVENT, :, 1]) == pytest.approx(10.0, rel=0.1)
    assert np.std(slip[: EVENT.start]) == pytest.approx(1.0, rel=0.1)
    assert np.std(slip[EVENT.stop :]) == pytest.approx(1.0, rel=0.1)


def test_noisy_sensors_in_the_event() -> None:
    recording = recorded(Scenario(measurement_scale=25.0))
    noise = recording.measurement - recording.truth[1:, :, [0, 1, 2, 2]]
    noise = noise[..., :2] / np.sqrt(NOMINAL_MEASUREMENT_NOISE[:2])
    inside = np.zeros(STEPS, dtype=bool)
    inside[EVENT] = True
    assert np.std(noise[inside]) == pytest.approx(5.0, rel=0.1)
    assert np.std(noise[~inside]) == pytest.approx(1.0, rel=0.1)
    said = recording.measurement_noise / NOMINAL_MEASUREMENT_NOISE
    np.testing.assert_allclose(said, np.where(inside, 25.0, 1.0)[:, None] * np.ones(4))


@pytest.mark.slow
def test_compass_bias_in_the_event() -> None:
    plain, biased = recorded(), recorded(Scenario(compass_bias=0.1))
    change = wrap_angle(biased.measurement - plain.measurement)
    np.testing.assert_allclose(change[EVENT, :, Row.COMPASS_YAW], 0.1, atol=1e-12)
    change[EVENT, :, Row.COMPASS_YAW] = 0.0
    assert not change.any()


@pytest.mark.parametrize("lost", [(Row.X, Row.Y), (Row.COMPASS_YAW,)])
@pytest.mark.slow
def test_lost_rows_in_the_event(lost: tuple[Row, ...]) -> None:
    available = recorded(Scenario(lost=lost)).available
    for row in (Row.X, Row.Y, Row.COMPASS_YAW):
        assert available[EVENT, :, row].all() == (row not in lost)
        assert available[: EVENT.start, :, row].all()
        assert available[EVENT.stop :, :, row].all()


@pytest.mark.slow
def test_unequal_wheels() -> None:
    """The larger wheel rolls as far with fewer counts: left seems 1 % shorter, right longer."""
    plain, unequal = recorded(), recorded(Scenario(wheel_inequality=0.02))
    np.testing.assert_array_equal(plain.truth, unequal.truth)
    totals = [np.sum(r.control, axis=0) for r in (plain, unequal)]
    left, right = (
        np.array([total[:, 0] + side * 0.3 * total[:, 1] for total in totals])
        for side in (-1.0, 1.0)
    )
    np.testing.assert_allclose(left[1] / left[0], 1.0 / 1.01, rtol=1e-4)
    np.testing.assert_allclose(right[1] / right[0], 1.0 / 0.99, rtol=1e-4)


def test_counts_are_those_of_the_geometry() -> None:
    wide = FakeRobotParameters(path="sim1", wheel_radius=0.1, encoder_counts_per_revolution=50.0)
    recording = record(wide, NOMINAL, 20, 3, np.random.default_rng(1))
    step = control_from_counts(wheel_geometry(wide), 1.0, 1.0)[0]
    doubled = 2.0 * recording.control[..., 0] / step
    np.testing.assert_allclose(doubled, np.round(doubled), atol=1e-6)
