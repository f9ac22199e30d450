"""The `localizer` node: messages into the pipeline, its estimates out."""

import argparse
import functools
from collections.abc import Sequence
from typing import Any

from fnn_ekf_ros import messages
from fnn_ekf_ros.core.adaptation import FuzzyNetwork
from fnn_ekf_ros.membership.files import read_membership
from fnn_ekf_ros.parameters.localizer import NODE_NAME, LocalizerParameters
from fnn_ekf_ros.parameters.schema import build
from fnn_ekf_ros.pipeline.events import Output, Rejected
from fnn_ekf_ros.pipeline.pipeline import Pipeline
from fnn_ekf_ros.ros.build import build_message, message_class
from fnn_ekf_ros.ros.runtime import (
    as_overrides,
    declare,
    given_parameters,
    ros_started,
    spin_until_stopped,
)

from rclpy.node import Node  # isort: skip  (runtime explains it if ROS is not here)
from rclpy.qos import QoSProfile, ReliabilityPolicy  # isort: skip
from rclpy.qos_overriding_options import QoSOverridingOptions  # isort: skip
from std_srvs.srv import SetBool, Trigger  # isort: skip

INPUT_QOS = QoSProfile(depth=200, reliability=ReliabilityPolicy.BEST_EFFORT)
"""Best effort as for sensor data, but deep enough for a burst of a second."""
OUTPUT_QOS = QoSProfile(depth=10)
LOG_INTERVAL_S = 10.0
"""A trouble that lasts is logged this often [s]."""
TIMER_DIVISOR = 4
"""The clock is looked at so many times a period, to close periods that wait for the wheels."""


class LocalizerNode(Node):  # type: ignore[misc]
    """Feeds a `Pipeline` from topics and publishes what comes out.

    Args:
        parameters: checked.
        network: the membership functions.
    """

    def __init__(self, parameters: LocalizerParameters, network: FuzzyNetwork) -> None:
        super().__init__(NODE_NAME, parameter_overrides=as_overrides(parameters))
        declare(self, LocalizerParameters)
        self._settings = parameters
        self._pipeline = Pipeline(parameters, network)
        overridable = QoSOverridingOptions.with_default_policies()
        self._odom, self._noise, self._diagnostics = (
            self.create_publisher(
                message_class(type_name), topic, OUTPUT_QOS, qos_overriding_options=overridable
            )
            for topic, type_name in (
                (messages.ODOM, messages.ODOMETRY_TYPE),
                (f"~/{messages.NOISE}", messages.NOISE_TYPE),
                (messages.DIAGNOSTICS, messages.DIAGNOSTICS_TYPE),
            )
        )
        for topic in messages.input_topics(parameters):
            self.create_subscription(
                message_class(messages.INPUT_TYPES[topic]),
                topic,
                functools.partial(self._receive, topic),
                INPUT_QOS,
                qos_overriding_options=overridable,
            )
        self.create_service(Trigger, "~/reset", self._reset)
        self.create_service(SetBool, "~/enable_adaptation", self._enable_adaptation)
        self.create_timer(parameters.period / TIMER_DIVISOR, self._look_at_clock)
        self.get_logger().info(
            f"adaptation {parameters.adaptation}, odom every {parameters.period:g} s in "
            f"{parameters.frame_id}"
        )

    def _now_ns(self) -> int:
        """Return ROS time [ns]; 0 while simulated time has not begun."""
        return int(self.get_clock().now().nanoseconds)

    def _receive(self, topic: str, message: Any) -> None:
        now_ns = self._now_ns()
        if now_ns <= 0:
            self.get_logger().warning(
                f"{topic} before the first /clock is dropped", throttle_duration_sec=LOG_INTERVAL_S
            )
            return
        try:
            events = messages.read_input(topic, message, now_ns, self._settings)
            if isinstance(events, Rejected):
                self._pipeline.reject(events)
                self.get_logger().warning(
                    f"refused: {events.reason}", throttle_duration_sec=LOG_INTERVAL_S
                )
                return
            for event in events:
                self._publish(self._pipeline.add(event, now_ns))
        except Exception as error:  # a robot must not lose its localizer over one message
            self.get_logger().error(
                f"{topic}: {type(error).__name__}: {error}; the message is dropped",
                throttle_duration_sec=LOG_INTERVAL_S,
            )

    def _look_at_clock(self) -> None:
        now_ns = self._now_ns()
        if now_ns > 0:
            self._publish(self._pipeline.advance(now_ns))

    def _publish(self, outputs: Sequence[Output]) -> None:
        for output in outputs:
            if output.estimate is not None:
                odometry = messages.odometry(
                    output.estimate, self._settings.frame_id, self._settings.base_frame
                )
                self._odom.publish(build_message(odometry))
                self._noise.publish(build_message(messages.noise(output.estimate)))
            if output.health is not None:
                name = self.get_fully_qualified_name().lstrip("/")
                diagnostics = messages.diagnostics(output.stamp_ns, name, output.health)
                self._diagnostics.publish(build_message(diagnostics))

    def _reset(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._pipeline.reset()
        response.success = True
        response.message = "pose and adapted noise are forgotten; waiting for the start"
        self.get_logger().info(response.message)
        return response

    def _enable_adaptation(
        self, request: SetBool.Request, response: SetBool.Response
    ) -> SetBool.Response:
        mode = self._settings.adaptation
        self._pipeline.enable_adaptation(request.data)
        response.success = not (request.data and mode == "none")
        if not request.data:
            response.message = "the noise is held where it is"
        elif response.success:
            response.message = f"adaptation {mode} is on"
        else:
            response.message = "adaptation is 'none': start with r or q to have one to enable"
        self.get_logger().info(response.message)
        return response


EPILOG = (
    "Parameters: --ros-args --params-file FILE, or -p name:=value; config/localizer.yaml lists "
    "them. wheel_radius, wheel_separation and encoder_counts_per_revolution must be set."
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments; all of them are ROS arguments."""
    parser.epilog = EPILOG


def run(ros_arguments: Sequence[str]) -> int:
    """Run the node until it is stopped; returns the exit code."""
    with ros_started(ros_arguments, NODE_NAME):
        parameters = build(LocalizerParameters, given_parameters(NODE_NAME))
        network = read_membership(parameters.membership_file)
        return spin_until_stopped(lambda: LocalizerNode(parameters, network))
