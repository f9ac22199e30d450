# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The fake robot: the simulated drive with its sensors, as the messages they would send."""

import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from fnn_ekf_ros import messages
from fnn_ekf_ros.core.angles import wrap_angle
from fnn_ekf_ros.core.arrays import FloatArray
from fnn_ekf_ros.messages import Message
from fnn_ekf_ros.parameters.fake_robot import FakeRobotParameters
from fnn_ekf_ros.parameters.faults import WHEELS, Fault
from fnn_ekf_ros.simulation.delivery import STEP_NS, Delivery, Sent
from fnn_ekf_ros.simulation.faults import Encoder, Schedule
from fnn_ekf_ros.simulation.paths import scripted_path
from fnn_ekf_ros.simulation.reading_times import ReadingTimes
from fnn_ekf_ros.simulation.robot import (
    advance,
    at_rest,
    encoder_counts,
    follow,
)
from fnn_ekf_ros.simulation.spoiling import LATEST_STAMP_NS

_EVERY_TRUTH = 10
"""Interval of `ground_truth` [steps]."""
_ENCODERS_PHASE_NS = STEP_NS
"""Phase of the encoder messages [ns]: fixes and compass are due at multiples of their intervals,
and so at the default rates at the filter's period boundaries; the encoders, which close a period,
come a step later, as from a robot that samples its slow sensors first."""

OUTPUT_TYPES = {
    messages.LEFT_TICKS: messages.TICKS_TYPE,
    messages.RIGHT_TICKS: messages.TICKS_TYPE,
    messages.JOINT_STATES: messages.JOINT_STATES_TYPE,
    messages.COMPASS: messages.COMPASS_TYPE,
    messages.LRF_POSE: messages.POSE_TYPE,
    messages.GROUND_TRUTH: messages.ODOMETRY_TYPE,
}
"""Type by topic of what the fake robot publishes."""


class _Seen(NamedTuple):
    """State of the robot when a sensor is read.

    Attributes:
        pose: `(3,)` true pose (m, m, rad; map frame).
        stamp_ns: time by the robot's own clock [ns].
    """

    pose: FloatArray
    stamp_ns: int


class _LastStep(NamedTuple):
    """The robot's last step, for readings that are due before its end.

    Attributes:
        begin: `(3,)` true pose before the step (m, m, rad; map frame).
        end: `(3,)` true pose after it, before anybody carries the robot away.
        clock_error_ns: of the robot's own clock before the step [ns].
    """

    begin: FloatArray
    end: FloatArray
    clock_error_ns: int


class FakeRobot:
    """A robot that moves a step at a time and sends what it senses.

    Compass and fixes are read, and stamped, at the multiples of their intervals in ROS time, also
    between two ends of steps; they are sent at the end of the step. Encoders are read at the first
    end of a step at or after their time, because ticks have no stamp.

    Compass and fixes draw their noise from one stream, in the order of their readings: another
    rate of one of them gives both other noise. Rates change neither the drive nor the faults'
    own draws.

    Args:
        parameters: the robot; with its seed they determine all that is sent (but for `cmd_vel`).
        start_ns: ROS time of the start, rounded up to a multiple of `STEP_NS` [ns].
        faults: what goes wrong. They draw from streams of their own: all that they do not touch
            is sent as without them. The parameter `faults_file` is not read here.
    """

    def __init__(
        self, parameters: FakeRobotParameters, start_ns: int, faults: Sequence[Fault] = ()
    ) -> None:
        self.parameters = parameters
        self._step = -(-start_ns // STEP_NS)
        # Streams of their own: the slip is the same whatever the sensors draw.
        drive_seed, sensor_seed, fault_seed = np.random.SeedSequence(parameters.seed).spawn(3)
        self._drive_rng = np.random.default_rng(drive_seed)
        self._sensor_rng = np.random.default_rng(sensor_seed)
        driven = parameters.path != "cmd_vel"
        self._path = scripted_path(parameters.path) if driven else None
        self._robot = at_rest(np.zeros(3) if self._path is None else self._path.start())
        self._command = np.zeros(2)
        self._steps_driven, self._clock_error_ns = 0, 0
        self._last_step = _LastStep(begin=self._robot.pose, end=self._robot.pose, clock_error_ns=0)
        self._encoder_times = ReadingTimes(parameters.encoder_rate, _ENCODERS_PHASE_NS)
        self._measuring_times = {
            messages.COMPASS: ReadingTimes(parameters.compass_rate),
            messages.LRF_POSE: ReadingTimes(parameters.lrf_rate),
        }
        self._schedule = Schedule(faults)
        rngs = [np.random.default_rng(seed) for seed in fault_seed.spawn(len(faults))]
        self._delivery = Delivery(faults, rngs)
        counts = (parameters.left_start_count, parameters.right_start_count)
        self._encoders = [
            Encoder(wheel, count, self._schedule)
            for wheel, count in zip(WHEELS, counts, strict=True)
        ]

    @property
    def time_ns(self) -> int:
        """ROS time of the robot's state, by a clock that is right [ns]."""
        return self._step * STEP_NS

    @property
    def stamp_ns(self) -> int:
        """ROS time by the robot's own clock, the stamp of all it sends [ns].

        The same as `time_ns` but for a fault `clock_jump`.
        """
        return _stamp_ns(self.time_ns, self._clock_error_ns)

    def jump_to(self, time_ns: int) -> None:
        """Set the time without moving the robot [ns]."""
        self._step = -(-time_ns // STEP_NS)

    def set_command(self, linear_x: float, angular_z: float) -> None:
        """Set what is driven from now on if the path is `cmd_vel` (m/s, rad/s)."""
        self._command = np.array([linear_x, angular_z])

    def step(self) -> list[Sent]:
        """Move on by one step and return what is sent at its end, in order."""
        self._steps_driven += 1
        now, schedule = self._steps_driven, self._schedule
        command = self._command
        if self._path is not None:
            self._robot, command = follow(self._path, self._robot, self.parameters.speed)
        driven = advance(
            self.parameters, self._robot, command, self._drive_rng,
            schedule.radius_factors(now), schedule.slip_std(now, self.parameters.slip()),
        )  # fmt: skip
        self._last_step = _LastStep(
            begin=self._robot.pose, end=driven.pose, clock_error_ns=self._clock_error_ns
        )
        self._robot = schedule.carried(now, driven)
        self._step += 1
        self._set_clock(schedule.clock_jump_ns(now))
        return self._delivery.sent(now, self._measured(command))

    def _set_clock(self, jump_ns: int) -> None:
        if jump_ns:
            jumped = min(max(self.stamp_ns + jump_ns, 0), LATEST_STAMP_NS)
            self._clock_error_ns = jumped - self.time_ns

    def _measured(self, command: FloatArray) -> Iterator[Sent]:
        if self._step % _EVERY_TRUTH == 0:
            yield Sent(messages.GROUND_TRUTH, self._truth(command))
        began_ns = self.time_ns - STEP_NS
        due = [
            (time_ns, topic)
            for topic, times in self._measuring_times.items()
            for time_ns in times.within(began_ns, self.time_ns)
        ]
        for time_ns, topic in sorted(due, key=lambda reading: reading[0]):
            seen = self._seen_at(time_ns)
            measured = self._compass if topic == messages.COMPASS else self._lrf_pose
            yield Sent(topic, measured(seen))
        if self._encoder_times.within(began_ns, self.time_ns):
            yield from self._wheels()

    def _seen_at(self, time_ns: int) -> _Seen:
        """Return what is seen at a time in the last step; in between, the path is straight."""
        before_end_ns = self.time_ns - time_ns
        if before_end_ns == 0:
            return _Seen(pose=self._robot.pose, stamp_ns=self.stamp_ns)
        last = self._last_step
        moved = last.end - last.begin
        moved[2] = wrap_angle(moved[2])
        pose = last.begin + (1.0 - before_end_ns / STEP_NS) * moved
        return _Seen(pose=pose, stamp_ns=_stamp_ns(time_ns, last.clock_error_ns))

    def _wheels(self) -> Iterator[Sent]:
        p = self.parameters
        readings = [
            encoder.read(self._steps_driven, int(count))
            for encoder, count in zip(self._encoders, encoder_counts(p, self._robot), strict=True)
        ]
        for topic, reading in zip(
            (messages.LEFT_TICKS, messages.RIGHT_TICKS), readings, strict=True
        ):
            if reading.heard:
                data = {"data": _wrapped(reading.ticks, p.encoder_bits)}
                yield Sent(topic, Message(messages.TICKS_TYPE, data))
        joints = [
            (joint, reading.turned)
            for joint, reading in zip((p.left_joint, p.right_joint), readings, strict=True)
            if reading.heard
        ]
        if joints:
            names, turned = zip(*joints, strict=True)
            counts = np.array(turned, dtype=np.float64)
            yield Sent(messages.JOINT_STATES, self._joint_states(list(names), counts))

    def _truth(self, command: FloatArray) -> Message:
        p = self.parameters
        return messages.odometry_message(
            self.stamp_ns, p.frame_id, p.base_frame, self._robot.pose, command,
            np.zeros((6, 6)), np.zeros((6, 6)),
        )  # fmt: skip

    def _compass(self, seen: _Seen) -> Message:
        std = self.parameters.compass_std
        noise = std * self._schedule.noise_factor(self._steps_driven, messages.COMPASS)
        yaw = float(seen.pose[2]) + noise * self._sensor_rng.standard_normal()
        return messages.compass_message(seen.stamp_ns, self.parameters.base_frame, yaw, std)

    def _lrf_pose(self, seen: _Seen) -> Message:
        std = np.asarray(self.parameters.lrf_std)
        noise = std * self._schedule.noise_factor(self._steps_driven, messages.LRF_POSE)
        pose = seen.pose + noise * self._sensor_rng.standard_normal(3)
        variances = np.maximum(std**2, messages.UNUSED_VARIANCE)
        return Message(
            messages.POSE_TYPE,
            {
                "header": messages.header(seen.stamp_ns, self.parameters.frame_id),
                "pose": messages.pose_with_covariance(
                    pose, messages.planar_covariance(np.diag(variances))
                ),
            },
        )

    def _joint_states(self, joints: list[str], counts: FloatArray) -> Message:
        p = self.parameters
        radians = counts * 2.0 * math.pi / (p.gear_ratio * p.encoder_counts_per_revolution)
        return Message(
            messages.JOINT_STATES_TYPE,
            {
                "header": messages.header(self.stamp_ns, ""),
                "name": joints,
                "position": radians,
                "velocity": np.zeros(0),
                "effort": np.zeros(0),
            },
        )


def _stamp_ns(time_ns: int, clock_error_ns: int) -> int:
    return max(time_ns + clock_error_ns, 0)


def _wrapped(count: int, bits: int) -> int:
    half = 1 << (bits - 1)
    return (count + half) % (2 * half) - half
