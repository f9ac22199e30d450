"""The fake robot: the simulated drive with its sensors, as the messages they would send."""

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from fnn_ekf_ros import messages
from fnn_ekf_ros.core.arrays import FloatArray
from fnn_ekf_ros.messages import Message
from fnn_ekf_ros.parameters.fake_robot import FakeRobotParameters
from fnn_ekf_ros.simulation.paths import scripted_path
from fnn_ekf_ros.simulation.robot import (
    STEP_S,
    advance,
    at_rest,
    encoder_counts,
    follow,
)

STEP_NS = round(STEP_S * 1e9)
# Each sensor's interval and phase in steps. Fixes and compass are due at the filter's period
# boundaries; the encoders, which close a period, a step later, as from a robot that samples its
# slow sensors first.
_EVERY_LRF, _EVERY_COMPASS, _EVERY_TRUTH = 30, 10, 10
_EVERY_ENCODERS, _ENCODERS_PHASE = 4, 1

OUTPUT_TYPES = {
    messages.LEFT_TICKS: messages.TICKS_TYPE,
    messages.RIGHT_TICKS: messages.TICKS_TYPE,
    messages.JOINT_STATES: messages.JOINT_STATES_TYPE,
    messages.COMPASS: messages.COMPASS_TYPE,
    messages.LRF_POSE: messages.POSE_TYPE,
    messages.GROUND_TRUTH: messages.ODOMETRY_TYPE,
}
"""Topics of the fake robot."""


class Sent(NamedTuple):
    """A message the robot sends."""

    topic: str
    message: Message


class FakeRobot:
    """A robot that moves a step at a time and says what it senses.

    Args:
        parameters: the robot; with its seed they determine all that is sent (but for `cmd_vel`).
        start_ns: ROS time of the start, rounded up to a multiple of `STEP_NS` [ns].
    """

    def __init__(self, parameters: FakeRobotParameters, start_ns: int) -> None:
        self.parameters = parameters
        self._step = -(-start_ns // STEP_NS)
        # Streams of their own: the slip is the same whatever the sensors draw.
        drive_seed, sensor_seed = np.random.SeedSequence(parameters.seed).spawn(2)
        self._drive_rng = np.random.default_rng(drive_seed)
        self._sensor_rng = np.random.default_rng(sensor_seed)
        driven = parameters.path != "cmd_vel"
        self._path = scripted_path(parameters.path) if driven else None
        self._robot = at_rest(np.zeros(3) if self._path is None else self._path.start())
        self._command = np.zeros(2)

    @property
    def stamp_ns(self) -> int:
        """ROS time of the robot's state [ns]."""
        return self._step * STEP_NS

    def jump_to(self, stamp_ns: int) -> None:
        """Set the robot's clock without moving the robot [ns]."""
        self._step = -(-stamp_ns // STEP_NS)

    def set_command(self, linear_x: float, angular_z: float) -> None:
        """Set what is driven from now on if the path is `cmd_vel` (m/s, rad/s)."""
        self._command = np.array([linear_x, angular_z])

    def step(self) -> list[Sent]:
        """Move on by one step and return what is sent at its end."""
        command = self._command
        if self._path is not None:
            self._robot, command = follow(self._path, self._robot, self.parameters.speed)
        self._robot = advance(self.parameters, self._robot, command, self._drive_rng)
        self._step += 1
        return list(self._due(command))

    def _due(self, command: FloatArray) -> Iterator[Sent]:
        if self._step % _EVERY_TRUTH == 0:
            yield Sent(messages.GROUND_TRUTH, self._truth(command))
        if self._step % _EVERY_COMPASS == 0:
            yield Sent(messages.COMPASS, self._compass())
        if self._step % _EVERY_LRF == 0:
            yield Sent(messages.LRF_POSE, self._lrf_pose())
        if self._step % _EVERY_ENCODERS == _ENCODERS_PHASE:
            counts = encoder_counts(self.parameters, self._robot)
            p = self.parameters
            for topic, count, start in (
                (messages.LEFT_TICKS, counts[0], p.left_start_count),
                (messages.RIGHT_TICKS, counts[1], p.right_start_count),
            ):
                data = {"data": _wrapped(start + int(count), p.encoder_bits)}
                yield Sent(topic, Message(messages.TICKS_TYPE, data))
            yield Sent(messages.JOINT_STATES, self._joint_states(counts))

    def _truth(self, command: FloatArray) -> Message:
        p = self.parameters
        return messages.odometry_message(
            self.stamp_ns, p.frame_id, p.base_frame, self._robot.pose, command,
            np.zeros((6, 6)), np.zeros((6, 6)),
        )  # fmt: skip

    def _compass(self) -> Message:
        std = self.parameters.compass_std
        yaw = float(self._robot.pose[2]) + std * self._sensor_rng.standard_normal()
        return messages.compass_message(self.stamp_ns, self.parameters.base_frame, yaw, std)

    def _lrf_pose(self) -> Message:
        std = np.asarray(self.parameters.lrf_std)
        pose = self._robot.pose + std * self._sensor_rng.standard_normal(3)
        variances = np.maximum(std**2, messages.UNUSED_VARIANCE)
        return Message(
            messages.POSE_TYPE,
            {
                "header": messages.header(self.stamp_ns, self.parameters.frame_id),
                "pose": messages.pose_with_covariance(
                    pose, messages.planar_covariance(np.diag(variances))
                ),
            },
        )

    def _joint_states(self, counts: FloatArray) -> Message:
        p = self.parameters
        radians = counts * 2.0 * math.pi / (p.gear_ratio * p.encoder_counts_per_revolution)
        return Message(
            messages.JOINT_STATES_TYPE,
            {
                "header": messages.header(self.stamp_ns, ""),
                "name": [p.left_joint, p.right_joint],
                "position": radians,
                "velocity": np.zeros(0),
                "effort": np.zeros(0),
            },
        )


def _wrapped(count: int, bits: int) -> int:
    half = 1 << (bits - 1)
    return (count + half) % (2 * half) - half
