# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The `localizer` node: messages into the localizer, its estimates out."""

import argparse
import copy
import functools
import math
import time
from collections.abc import Sequence
from typing import Any

from fnn_ekf_ros import messages
from fnn_ekf_ros.core.adaptation import Networks
from fnn_ekf_ros.diagnostics.messages import FilterMessage
from fnn_ekf_ros.localizer.localizer import Localizer
from fnn_ekf_ros.localizer.outputs import output_messages
from fnn_ekf_ros.membership.files import networks_for
from fnn_ekf_ros.parameters.localizer import NODE_NAME, LocalizerParameters
from fnn_ekf_ros.ros.arrivals import Arrival, Arrivals, Message, Moment
from fnn_ekf_ros.ros.build import build_message, message_class
from fnn_ekf_ros.ros.changes import Changes
from fnn_ekf_ros.ros.event_group import EventGroup
from fnn_ekf_ros.ros.intake import MOST_WAITING, as_message, now_of, take_all
from fnn_ekf_ros.ros.level_changes import LevelChanges
from fnn_ekf_ros.ros.other_publishers import OtherPublishers
from fnn_ekf_ros.ros.pace import LOOKS_PER_PERIOD, Pace
from fnn_ekf_ros.ros.runtime import (
    LOG_INTERVAL_S,
    as_overrides,
    checked_parameters,
    declare,
    ros_started,
    spin_until_stopped,
)
from fnn_ekf_ros.ros.state_keeper import StateKeeper
from fnn_ekf_ros.ros.transforms import Transforms
from fnn_ekf_ros.timeline.events import Level, Output, Rejected, Status

from rclpy.clock import Clock, ClockType  # isort: skip
from rclpy.node import Node  # isort: skip  (runtime explains it if ROS is not here)
from rclpy.qos import QoSProfile, ReliabilityPolicy  # isort: skip
from rclpy.qos_overriding_options import QoSOverridingOptions  # isort: skip
from rclpy.subscription import Subscription  # isort: skip
from std_srvs.srv import SetBool, Trigger  # isort: skip

INPUT_QOS = QoSProfile(depth=5000, reliability=ReliabilityPolicy.BEST_EFFORT)
"""Best effort as for sensor data, but deep enough for five seconds of messages at 1 kHz, in which
the node may get no share of the processor."""
OUTPUT_QOS = QoSProfile(depth=10)
"""QoS of what the localizer sends; a subscriber may lag behind by ten periods."""
LONGEST_LOOK_S = 0.1
"""Longest interval of looks into the queues, in steady time [s]: a longer one is a stop."""
SHED = (messages.COMPASS, messages.LRF_POSE)
"""Topics of which messages may be left out where the node is too slow."""
MOST_PERIODS = 10
"""Number of periods that are closed at once; services and signals are answered in between."""


class LocalizerNode(Node):  # type: ignore[misc]
    """Feeds a `Localizer` from topics and publishes what comes out.

    Args:
        parameters: checked.
        networks: the membership functions.

    Attributes:
        localizer: the localizer proper.
    """

    def __init__(self, parameters: LocalizerParameters, networks: Networks) -> None:
        self._group = EventGroup()
        super().__init__(NODE_NAME, parameter_overrides=as_overrides(parameters))
        declare(self, LocalizerParameters)
        self._settings = parameters
        self._transforms = Transforms(self, parameters) if parameters.publish_tf else None
        self._state_keeper = StateKeeper(self, parameters)
        self.localizer = Localizer(parameters, networks, warm_start=self._state_keeper.warm_start)
        self._pace = Pace(self, parameters.period, self.localizer.overran)
        self._look_s = min(parameters.period / LOOKS_PER_PERIOD, LONGEST_LOOK_S)
        self._arrivals = Arrivals()
        self._more_to_do = self.create_guard_condition(self._work)
        self._levels = LevelChanges(LOG_INTERVAL_S)
        self._logged_s: dict[str, float] = {}
        outputs = messages.output_topics() | {messages.DIAGNOSTICS: messages.DIAGNOSTICS_TYPE}
        self._outputs = {
            topic: self.create_publisher(
                message_class(type_name),
                topic,
                copy.copy(OUTPUT_QOS),
                qos_overriding_options=QoSOverridingOptions.with_default_policies(),
            )
            for topic, type_name in outputs.items()
        }
        self._inputs: dict[str, Subscription] = {}
        for topic in messages.input_topics(parameters):
            self._listen_to(topic, messages.INPUT_TYPES[topic])
        self._listen_to_simulated_time()
        Changes(self, parameters, networks_for, self._change)
        self.create_service(Trigger, "~/reset", self._reset)
        self.create_service(SetBool, "~/enable_adaptation", self._enable_adaptation)
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(self._look_s, self._look_at_clock, clock=steady)
        self._other_publishers = OtherPublishers(self, self._outputs[messages.ODOM].topic_name)
        self._state_keeper.write_regularly(self.localizer.saved)
        self.get_logger().info(
            f"adaptation {parameters.adaptation}, odom every {parameters.period:g} s in "
            f"{parameters.frame_id}"
        )

    @property
    def default_callback_group(self) -> EventGroup:
        """The group of everything that is made without one."""
        return self._group

    def destroy_node(self) -> None:
        """Keep the state and leave ROS."""
        self._state_keeper.write(self.localizer.saved())
        self._state_keeper.close()
        super().destroy_node()

    def _listen_to(self, topic: str, type_name: str) -> None:
        self._inputs[topic] = self.create_subscription(
            message_class(type_name),
            topic,
            functools.partial(self._receive, topic),
            copy.copy(INPUT_QOS),  # an override is written into it
            qos_overriding_options=QoSOverridingOptions.with_default_policies(),
        )

    def _listen_to_simulated_time(self) -> None:
        """Listen to /clock, if the clock follows it; rclpy keeps the last message of it only."""
        if self.get_clock().ros_time_is_active and messages.CLOCK not in self._inputs:
            self._listen_to(messages.CLOCK, messages.CLOCK_TYPE)

    def _receive(self, topic: str, content: Any, info: dict[str, int]) -> None:
        self._look(as_message(topic, content, info))
        self._work()

    def _look_at_clock(self) -> None:
        """Let time pass up to a look into the queues, if everything that came before was taken.

        Not up to the time after it: a node that is stopped between the two would let the time of
        the stop pass before it takes what was sent in it.
        """
        looked_ns = self._look().ros_ns
        self._work()
        if looked_ns is not None and self._arrivals.time_may_pass:
            self._advance(looked_ns)

    def _look(self, *first: Message) -> Moment:
        """Take all messages out of the queues; return when."""
        room = MOST_WAITING - len(self._arrivals) - len(first)
        found = [*first, *take_all(self._inputs, room)] if room > 0 else list(first)
        moment = now_of(self)
        self._listen_to_simulated_time()
        self._arrivals.look(moment, found)
        shed = self._arrivals.shed(moment.steady_s, SHED)
        if shed:
            self.localizer.shed(shed)
            self.get_logger().warning(
                f"the node is too slow for its inputs: {shed} readings are left out; lower the "
                "sensors' rates, raise period or shorten history",
                throttle_duration_sec=LOG_INTERVAL_S,
            )
        return moment

    def _work(self) -> None:
        """Take what waits, for less than a period, and let the executor look before the rest."""
        until_s = time.monotonic() + self._look_s
        while (arrival := self._arrivals.first) is not None:
            if time.monotonic() > until_s or self._advance(arrival.ros_ns):
                self._more_to_do.trigger()
                return
            self._take(self._arrivals.take())

    def _advance(self, now_ns: int) -> bool:
        """Let time pass; return whether there is more to do until then."""
        if now_ns <= 0:  # simulated time has not begun
            return False
        self._publish(self.localizer.advance(now_ns, MOST_PERIODS))
        if self.localizer.is_behind:
            self._more_to_do.trigger()
            return True
        return False

    def _take(self, arrival: Arrival) -> None:
        topic, content, _, received_ns = arrival.message
        if topic == messages.CLOCK:
            return
        if arrival.ros_ns <= 0:
            self.get_logger().warning(
                f"{topic} before the first /clock is dropped", throttle_duration_sec=LOG_INTERVAL_S
            )
            return
        received = self.localizer.receive(topic, content, arrival.ros_ns)
        if received.rejected is not None:
            self._log_refusal(topic, received.rejected)
        self._publish(received.outputs)
        if received.outputs:
            self._pace.waited(received_ns)

    def _publish(self, outputs: Sequence[Output]) -> None:
        for output in outputs:
            if output.moved is not None:
                moved = output.moved
                self.get_logger().warning(
                    f"at {moved.stamp_ns * 1e-9:.1f} s {FilterMessage.MOVED} "
                    f"(distance {moved.distance:.1f} m, rotation {moved.rotation:.2f} rad)"
                )
            if self._transforms is not None and output.estimate is not None:
                self._transforms.located(output.estimate)
            more = [self._transforms.status()] if self._transforms is not None else []
            more += self._other_publishers.statuses()
            if output.statuses is not None:
                self._log_changes([*output.statuses, *more])
            name = self.get_fully_qualified_name().lstrip("/")
            made = output_messages(output, self._settings, name, more)
            for topic, content in made.items():
                self._outputs[topic].publish(build_message(content))

    def _log_refusal(self, topic: str, rejected: Rejected) -> None:
        """Log a refused message, of each topic once in a while."""
        if self._may_log(topic):
            self.get_logger().warning(f"refused: {rejected.reason}")

    def _may_log(self, subject: str) -> bool:
        now_s = time.monotonic()
        if now_s - self._logged_s.get(subject, -math.inf) < LOG_INTERVAL_S:
            return False
        self._logged_s[subject] = now_s
        return True

    def _log_changes(self, statuses: Sequence[Status]) -> None:
        """Log a status when it gets better or worse, but not all the time; /diagnostics does."""
        for status in self._levels.worth_a_line(statuses, time.monotonic()):
            text = f"{status.name}: {status.message}"
            log = self.get_logger()
            # One call for each level: a logger refuses to change the level of a call.
            if status.level is Level.OK:
                log.info(text)
            elif status.level is Level.WARN:
                log.warning(text)
            else:
                log.error(text)

    def _change(self, parameters: LocalizerParameters, networks: Networks) -> None:
        self._settings = parameters
        self.localizer.change(parameters, networks)

    def _reset(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self.localizer.reset()
        response.success = True
        response.message = "pose and adapted noise are forgotten; waiting for the start"
        self.get_logger().info(response.message)
        return response

    def _enable_adaptation(
        self, request: SetBool.Request, response: SetBool.Response
    ) -> SetBool.Response:
        mode = self._settings.adaptation
        self.localizer.enable_adaptation(request.data)
        response.success = not (request.data and mode == "none")
        if not request.data:
            response.message = "the noise is held where it is"
        elif response.success:
            response.message = f"adaptation {mode} is on"
        else:
            response.message = (
                f"adaptation is 'none': `ros2 param set {self.get_fully_qualified_name()} "
                "adaptation joint` (or rq, r, q) first"
            )
        self.get_logger().info(response.message)
        return response


EPILOG = (
    f"Listens to {', '.join(messages.INPUT_TYPES)}; "
    f"publishes {', '.join(messages.output_topics())}, /diagnostics; serves ~/reset, "
    "~/enable_adaptation. Parameters: share/fnn_ekf_ros/config/localizer.yaml lists them; "
    "wheel_radius, wheel_separation and encoder_counts_per_revolution must be set."
)
"""Last paragraph of `localizer --help`."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments; all of them are ROS arguments."""
    parser.epilog = EPILOG


def run(ros_arguments: Sequence[str]) -> int:
    """Run the node until it is stopped; returns the exit code."""
    with ros_started(ros_arguments, NODE_NAME):
        parameters = checked_parameters(LocalizerParameters, ros_arguments, NODE_NAME)
        networks = networks_for(parameters)
        return spin_until_stopped(lambda: LocalizerNode(parameters, networks))
