# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The `fake_robot` node: the simulated hardware on real topics."""

import argparse
import math
import time
from collections.abc import Sequence
from typing import Any

from fnn_ekf_ros import messages
from fnn_ekf_ros.parameters.fake_robot import NODE_NAME, FakeRobotParameters
from fnn_ekf_ros.parameters.fault_files import read_faults
from fnn_ekf_ros.parameters.faults import Fault
from fnn_ekf_ros.ros.build import build_message, message_class
from fnn_ekf_ros.ros.runtime import (
    as_overrides,
    checked_parameters,
    declare,
    ros_started,
    spin_until_stopped,
)
from fnn_ekf_ros.simulation.delivery import STEP_NS
from fnn_ekf_ros.simulation.fake_robot import OUTPUT_TYPES, FakeRobot
from fnn_ekf_ros.simulation.robot import STEP_S

from rclpy.clock import Clock, ClockType  # isort: skip  (runtime explains it if ROS is not here)
from rclpy.node import Node  # isort: skip
from rclpy.qos import QoSProfile  # isort: skip

OUTPUT_QOS = QoSProfile(depth=100)
"""QoS of what the robot sends: deep enough for a portion of steps."""
LARGEST_JUMP_NS = 5 * 10**9
"""Largest lead of the clock over the robot [ns]; with a larger difference the clock has jumped."""
MOST_STEPS_AT_ONCE = 400
"""Largest number of steps at once, 5 s: a robot that is behind its clock catches up in portions, so
that the node stays responsive."""
CLOCK_INTERVAL_NS = 4 * STEP_NS
"""Longest time between two messages of the robot's own clock [ns]; it is also published with all
that is sent."""
MOST_TICKS_BEHIND = 4.0
"""Largest lead of the robot's own clock over the robot [ticks of the timer]: on a busy machine the
clock waits, and so runs slower than asked."""


class FakeRobotNode(Node):  # type: ignore[misc]
    """Moves a `FakeRobot` along with the clock and publishes what it sends.

    Args:
        parameters: checked.
        faults: what goes wrong, in seconds since the robot's start.
    """

    def __init__(self, parameters: FakeRobotParameters, faults: Sequence[Fault] = ()) -> None:
        super().__init__(NODE_NAME, parameter_overrides=as_overrides(parameters))
        declare(self, FakeRobotParameters)
        self._settings, self._faults = parameters, faults
        self._robot: FakeRobot | None = None
        self._topics = {
            topic: self.create_publisher(message_class(type_name), topic, OUTPUT_QOS)
            for topic, type_name in OUTPUT_TYPES.items()
        }
        self._clock_topic = None
        if parameters.publish_clock:
            self._clock_topic = self.create_publisher(
                message_class(messages.CLOCK_TYPE), messages.CLOCK, OUTPUT_QOS
            )
        self._command_ns: int | None = None
        if parameters.path == "cmd_vel":
            self.create_subscription(
                message_class(messages.TWIST_TYPE), messages.CMD_VEL, self._command, 10
            )
        self._began = time.monotonic()
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(STEP_S, self._catch_up, clock=steady)
        self.get_logger().info(
            f"driving {parameters.path}, seed {parameters.seed}"
            + (f", clock x{parameters.real_time_factor:g}" if self._clock_topic else "")
            + (f", faults of {parameters.faults_file}: {len(faults)}" if faults else "")
        )

    def _now_ns(self) -> int:
        if self._clock_topic is None:
            return int(self.get_clock().now().nanoseconds)
        factor = self._settings.real_time_factor
        robot_ns = STEP_NS if self._robot is None else self._robot.time_ns
        lead_ns = int(min(MOST_TICKS_BEHIND * factor, MOST_STEPS_AT_ONCE) * STEP_NS)
        now_ns = STEP_NS + int((time.monotonic() - self._began) * factor * 1e9)
        too_far_ns = max(now_ns - robot_ns - lead_ns, 0)
        self._began += too_far_ns * 1e-9 / factor
        return now_ns - too_far_ns

    def _catch_up(self) -> None:
        now_ns = self._now_ns()
        if now_ns <= 0:
            return  # simulated time has not begun
        if self._robot is None:
            # On a clock of its own it starts with that clock: the same seed gives the same stamps.
            start_ns = now_ns if self._clock_topic is None else STEP_NS
            self._robot = FakeRobot(self._settings, start_ns, self._faults)
        if abs(now_ns - self._robot.time_ns) > LARGEST_JUMP_NS:
            self._robot.jump_to(now_ns)  # the clock has been set, not the robot carried
        for _ in range(MOST_STEPS_AT_ONCE):
            if self._robot.time_ns + STEP_NS > now_ns:
                return
            self._step(self._robot)

    def _step(self, robot: FakeRobot) -> None:
        if self._command_ns is not None:
            silent_s = (robot.time_ns - self._command_ns) * 1e-9
            if silent_s > self._settings.cmd_vel_timeout:
                robot.set_command(0.0, 0.0)
        sent = robot.step()
        due = bool(sent) or robot.time_ns % CLOCK_INTERVAL_NS == 0
        if self._clock_topic is not None and due:
            fields = {"clock": messages.time(robot.stamp_ns)}
            self._clock_topic.publish(build_message(messages.Message(messages.CLOCK_TYPE, fields)))
        for entry in sent:
            self._topics[entry.topic].publish(build_message(entry.message))

    def _command(self, message: Any) -> None:
        linear, angular = float(message.linear.x), float(message.angular.z)
        if not (math.isfinite(linear) and math.isfinite(angular)):
            self.get_logger().warning(
                f"refused: cmd_vel ({linear:g} m/s, {angular:g} rad/s), expected finite numbers",
                throttle_duration_sec=10.0,
            )
            return
        if self._robot is not None:
            self._robot.set_command(linear, angular)
            self._command_ns = self._robot.time_ns


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments; all of them are ROS arguments."""
    parser.epilog = (
        f"Publishes {', '.join(OUTPUT_TYPES)}, /clock when asked; listens to cmd_vel when asked. "
        "Parameters: share/fnn_ekf_ros/config/fake_robot.yaml lists them."
    )


def run(ros_arguments: Sequence[str]) -> int:
    """Run the node until it is stopped; returns the exit code."""
    with ros_started(ros_arguments, NODE_NAME):
        parameters = checked_parameters(FakeRobotParameters, ros_arguments, NODE_NAME)
        faults = read_faults(parameters.faults_file).faults
        return spin_until_stopped(lambda: FakeRobotNode(parameters, faults))
