# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The simulated differential drive; every array may have leading batch dimensions.

Truth moves on exact arcs in steps of `STEP_S`, a thirtieth of the filter's period. The motor
control's error moves truth and encoders alike. Slip is what the encoders do not see: white noise
on distance and rotation whose variance over 375 ms is `slip_std` squared, while the wheels turn.
"""

from typing import NamedTuple

import numpy as np

from fnn_ekf_ros.core.angles import wrap_angle
from fnn_ekf_ros.core.arrays import FloatArray, components_last
from fnn_ekf_ros.core.motion import MotionModel, displacement
from fnn_ekf_ros.core.odometry import WheelGeometry
from fnn_ekf_ros.core.pace import NOMINAL_PERIOD_S
from fnn_ekf_ros.parameters.fake_robot import FakeRobotParameters
from fnn_ekf_ros.simulation.paths import Path

STEP_S = 0.0125
"""Length of a step of the simulation [s]."""
LOOKAHEAD = 0.3
"""Distance at which the driver looks ahead along the path [m]."""
LARGEST_TURN_RATE = 1.5
"""Largest rotation rate that the driver commands [rad/s]."""
_STEP_SLIP = np.sqrt(STEP_S / NOMINAL_PERIOD_S)
"""Standard deviation of slip over a step, as a part of that over 375 ms."""
EQUAL_WHEELS = np.ones(2)
"""Factors on the radii of the left and right wheel that are as configured."""


class RobotState(NamedTuple):
    """The simulated robot's truth.

    Attributes:
        pose: `(..., 3)` [x, y, yaw] in the map frame (m, m, rad).
        travel: `(..., 2)` distance of the left and right wheel's rim since the start [m].
        progress: `(...)` distance along the path of the point the driver aims at [m].
    """

    pose: FloatArray
    travel: FloatArray
    progress: FloatArray


def at_rest(pose: FloatArray) -> RobotState:
    """Return a robot at poses `(..., 3)` (m, m, rad) that has not moved yet."""
    batch = pose.shape[:-1]
    return RobotState(pose=pose, travel=np.zeros((*batch, 2)), progress=np.zeros(batch))


def wheel_geometry(parameters: FakeRobotParameters) -> WheelGeometry:
    """Return the robot's true geometry."""
    return WheelGeometry(
        wheel_radius=parameters.wheel_radius,
        wheel_separation=parameters.wheel_separation,
        gear_ratio=parameters.gear_ratio,
        encoder_counts_per_revolution=parameters.encoder_counts_per_revolution,
    )


def follow(path: Path, state: RobotState, speed: float) -> tuple[RobotState, FloatArray]:
    """Return the command of a driver who sees where the robot is and keeps it on the path.

    Pure pursuit (Coulter 1992): steer on the arc through the point ahead, omega = 2 v sin(a) / d.

    Returns:
        The state with the driver's aim moved on, and the command `(..., 2)` [linear x, angular z]
        (m/s, rad/s).
    """
    distance = np.linalg.norm(path.at(state.progress) - state.pose[..., :2], axis=-1)
    progress = state.progress + np.maximum(LOOKAHEAD - distance, 0.0)
    ahead = path.at(progress) - state.pose[..., :2]
    angle = wrap_angle(np.arctan2(ahead[..., 1], ahead[..., 0]) - state.pose[..., 2])
    rate = 2.0 * speed * np.sin(_within(angle, 0.5 * np.pi)) / LOOKAHEAD
    rate = _within(rate, LARGEST_TURN_RATE)
    command = np.empty((*rate.shape, 2))
    command[..., 0], command[..., 1] = speed, rate
    return RobotState(state.pose, state.travel, progress), command


def _within(values: FloatArray, limit: float) -> FloatArray:
    # np.clip is several times slower on a few values.
    limited: FloatArray = np.minimum(np.maximum(values, -limit), limit)
    return limited


def advance(
    parameters: FakeRobotParameters,
    state: RobotState,
    command: FloatArray,
    rng: np.random.Generator,
    radius_factors: FloatArray = EQUAL_WHEELS,
    slip_std: tuple[float, float] | None = None,
) -> RobotState:
    """Return the robot one `STEP_S` later.

    Args:
        parameters: geometry, motor control and slip.
        state: the robot now.
        command: `(..., 2)` [linear x, angular z] (m/s, rad/s).
        rng: source of the motor control's error and of slip.
        radius_factors: `(2,)` true radius of the left and right wheel over the parameters' one.
        slip_std: instead of the parameters' slip, per 375 ms (m, rad).
    """
    L = parameters.wheel_separation
    linear, half_turn = command[..., 0], 0.5 * L * command[..., 1]
    speeds = np.empty(command.shape)
    speeds[..., 0], speeds[..., 1] = linear - half_turn, linear + half_turn
    size = (*state.pose.shape[:-1], 2)
    error = parameters.wheel_speed_error * (2.0 * rng.random(size) - 1.0)
    distances = speeds * (1.0 + error) * STEP_S

    slip = rng.standard_normal(size) * (parameters.slip() if slip_std is None else slip_std)
    slip *= _STEP_SLIP
    moving = np.any(speeds, axis=-1, keepdims=True)
    if not moving.all():
        slip = np.where(moving, slip, 0.0)
    rolled = distances * radius_factors
    left, right = rolled[..., 0], rolled[..., 1]
    control = np.empty((2, *size[:-1]))
    control[0] = 0.5 * (left + right) + slip[..., 0]
    control[1] = (right - left) / L + slip[..., 1]
    moved = displacement(MotionModel.EXACT_ARC, state.pose[..., 2], control)
    pose = state.pose + components_last(moved)
    pose[..., 2] = wrap_angle(pose[..., 2])
    return RobotState(pose, state.travel + distances, state.progress)


def encoder_counts(parameters: FakeRobotParameters, state: RobotState) -> FloatArray:
    """Return the whole counts `(..., 2)` [left, right] since the start, not yet wrapped."""
    return np.floor(state.travel / wheel_geometry(parameters).meters_per_count)
