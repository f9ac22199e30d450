# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Simulated recordings: the fake robot's drive, and what goes wrong with its wheels and sensors.

The robot is the one of `simulate`: truth on exact arcs in steps of 12.5 ms, encoders in whole
counts, a driver who keeps to a path. Between truth and encoders stand slip, the process noise of
the paper's (25), and the rounding to counts. With the paper's wheels a count is 0.3 mm; its
rounding adds (0.3 mm)^2 / 12 to the variance of a period's distance, 1/50000 of simulation 1's.

Fixes and compass are taken at the end of each period: z = truth + N(0, R). There is no laser yaw.
"""

import dataclasses
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from fnn_ekf_ros.core.angles import wrap_angle
from fnn_ekf_ros.core.arrays import MEASUREMENT_SIZE, FloatArray, Row, components_last
from fnn_ekf_ros.core.odometry import control_from_counts
from fnn_ekf_ros.core.pace import NOMINAL_PERIOD_S
from fnn_ekf_ros.parameters.fake_robot import FakeRobotParameters
from fnn_ekf_ros.parameters.paper import MEASUREMENT_STD, YAW_STD
from fnn_ekf_ros.simulation.paths import scripted_path
from fnn_ekf_ros.simulation.robot import (
    STEP_S,
    RobotState,
    advance,
    at_rest,
    encoder_counts,
    follow,
    wheel_geometry,
)
from fnn_ekf_ros.study.recording import Recording

STEPS_PER_PERIOD = round(NOMINAL_PERIOD_S / STEP_S)
"""Steps of the simulation in a period of 375 ms."""
NOMINAL_MEASUREMENT_NOISE: FloatArray = np.square([*MEASUREMENT_STD, YAW_STD])
"""Diagonal of R where nothing is wrong, rows as in `Row` (m^2, m^2, rad^2, rad^2)."""
MEASURED = np.array([True, True, True, False])
"""Rows that the simulated sensors measure."""
POSITION_SLICE = slice(Row.X, Row.COMPASS_YAW)
"""Rows of the x and y of a fix."""


@dataclass(frozen=True, slots=True)
class Scenario:
    """Differences from white Gaussian noise of known size; the default is none.

    The first four happen during the event only, see `event_steps`; the others all the time.

    Attributes:
        process_scale: factor on the variance of slip.
        measurement_scale: factor on the variance of the fixes and the compass.
        compass_bias: added to the compass [rad].
        lost: rows that are not measured.
        wheel_inequality: part by which the left wheel is larger than the right one; their mean
            is configured for both.
        outlier_share: part of the fixes whose standard deviation is `outlier_scale` times larger.
        outlier_scale: see there.
        fix_correlation: correlation of the errors of two successive fixes; their variance stays.
    """

    process_scale: float = 1.0
    measurement_scale: float = 1.0
    compass_bias: float = 0.0
    lost: tuple[Row, ...] = ()
    wheel_inequality: float = 0.0
    outlier_share: float = 0.0
    outlier_scale: float = 1.0
    fix_correlation: float = 0.0


NOMINAL = Scenario()
"""White Gaussian noise of known size."""


class Drive(NamedTuple):
    """True motion of a batch of robots; T steps, n runs.

    Attributes:
        truth: `(T + 1, n, 3)` true poses, the start first (m, m, rad; map frame).
        travel: `(T + 1, n, 2)` distance of the left and right wheel's rim since the start [m].
    """

    truth: FloatArray
    travel: FloatArray


def event_steps(steps: int) -> slice:
    """Return the steps of the event: the third fifth, which is 120 s to 180 s of 300 s."""
    return slice(2 * steps // 5, 3 * steps // 5)


def drive(
    robot: FakeRobotParameters,
    scenario: Scenario,
    steps: int,
    runs: int,
    rng: np.random.Generator,
) -> Drive:
    """Drive a batch of robots along their scripted path.

    Args:
        robot: geometry, path, speed and slip.
        scenario: the slip's schedule.
        steps: T, periods of the paper's length.
        runs: n, robots that differ in what is random.
        rng: source of slip and of the motor control's error.
    """
    path = scripted_path(robot.path)
    slipping = dataclasses.replace(
        robot, slip_std=tuple(std * scenario.process_scale**0.5 for std in robot.slip())
    )
    event = event_steps(steps)
    state = at_rest(np.tile(path.start(), (runs, 1)))
    states = [state]
    for step in range(steps):
        now = slipping if event.start <= step < event.stop else robot
        for _ in range(STEPS_PER_PERIOD):
            state, command = follow(path, state, robot.speed)
            state = advance(now, state, command, rng)
        states.append(state)
    return Drive(np.stack([s.pose for s in states]), np.stack([s.travel for s in states]))


def sense(
    robot: FakeRobotParameters, scenario: Scenario, driven: Drive, rng: np.random.Generator
) -> Recording:
    """Return what encoders, fixes and compass say of a drive.

    The true noise that is noted for the oracle is that of each step, of outliers their variance
    on average. It does not describe biases, correlation in time and unequal wheels: no Q and R can.

    Args:
        robot: geometry and the slip it was driven with.
        scenario: what goes wrong; the slip's schedule must be that of the drive.
        driven: the drive.
        rng: source of the sensors' noise.
    """
    steps, runs = len(driven.truth) - 1, driven.truth.shape[1]
    event = event_steps(steps)
    Q = np.tile(np.square(robot.slip()), (steps, 1))
    Q[event] *= scenario.process_scale
    R = np.tile(NOMINAL_MEASUREMENT_NOISE, (steps, 1))
    R[event] *= scenario.measurement_scale

    noise = _correlated(rng.standard_normal((steps, runs, MEASUREMENT_SIZE)), scenario)
    outlier = rng.random((steps, runs)) < scenario.outlier_share
    noise[..., POSITION_SLICE] *= np.where(outlier, scenario.outlier_scale, 1.0)[..., None]
    z = driven.truth[1:, :, [0, 1, 2, 2]] + noise * np.sqrt(R)[:, None, :]
    z[event, :, Row.COMPASS_YAW] += scenario.compass_bias
    z[..., Row.COMPASS_YAW :] = wrap_angle(z[..., Row.COMPASS_YAW :])
    R[:, POSITION_SLICE] *= 1.0 + scenario.outlier_share * (scenario.outlier_scale**2 - 1.0)

    available = np.tile(MEASURED, (steps, runs, 1))
    available[event, :, list(scenario.lost)] = False
    return Recording(
        period_s=NOMINAL_PERIOD_S,
        truth=driven.truth,
        control=_control(robot, scenario, driven),
        measurement=z,
        available=available,
        process_noise=Q,
        measurement_noise=R,
    )


def record(
    robot: FakeRobotParameters,
    scenario: Scenario,
    steps: int,
    runs: int,
    rng: np.random.Generator,
) -> Recording:
    """Return the recordings of a batch of robots; see `drive` and `sense`.

    Drive and sensors draw from streams of their own: a scenario that leaves the slip as it is
    leaves the truth as it is.
    """
    drive_rng, sensor_rng = rng.spawn(2)
    return sense(robot, scenario, drive(robot, scenario, steps, runs, drive_rng), sensor_rng)


def _correlated(white: FloatArray, scenario: Scenario) -> FloatArray:
    """Return noise of the same variance whose fixes are an AR(1) process."""
    rho = scenario.fix_correlation
    noise = white.copy()
    for step in range(1, len(noise)):
        noise[step, :, POSITION_SLICE] *= (1.0 - rho**2) ** 0.5
        noise[step, :, POSITION_SLICE] += rho * noise[step - 1, :, POSITION_SLICE]
    return noise


def _control(robot: FakeRobotParameters, scenario: Scenario, driven: Drive) -> FloatArray:
    """Return [dS, dtheta] `(T, n, 2)` (m, rad) from counts by the configured geometry."""
    half = 0.5 * scenario.wheel_inequality
    rolled = driven.travel / np.array([1.0 + half, 1.0 - half])
    counts = encoder_counts(
        robot, RobotState(pose=driven.truth, travel=rolled, progress=np.zeros(()))
    )
    left, right = np.moveaxis(np.diff(counts, axis=0), -1, 0)
    return components_last(control_from_counts(wheel_geometry(robot), left, right))
