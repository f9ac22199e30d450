# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""A localizer that does not run for a while publishes what it would have published."""

import signal
import time
from collections import Counter
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from localizers import GEOMETRY, as_object, make_parameters
from nav_msgs.msg import Odometry
from own_nodes import OwnNode
from rclpy.qos import QoSProfile
from std_srvs.srv import Trigger

from fnn_ekf_ros import messages
from fnn_ekf_ros.diagnostics.messages import RECEIVED
from fnn_ekf_ros.localizer.localizer import Localizer
from fnn_ekf_ros.membership.files import networks_for
from fnn_ekf_ros.parameters.fake_robot import FakeRobotParameters
from fnn_ekf_ros.parameters.schema import build
from fnn_ekf_ros.ros import localizer as node_module
from fnn_ekf_ros.ros.arrivals import Moment
from fnn_ekf_ros.ros.build import build_message, message_class
from fnn_ekf_ros.simulation.fake_robot import FakeRobot

pytestmark = pytest.mark.live

S = 10**9
PERIOD_NS = S // 10
PARAMETERS = {"encoder_source": "joint_states", "period": 0.1, "initial_pose": [0.0, 0.0, 0.0]}
DRIVEN_S = 0.8
"""Time before and after the stop, recorded too [s]."""
SENSORS = {
    messages.JOINT_STATES: "encoders",
    messages.COMPASS: "compass",
    messages.LRF_POSE: "lrf_pose",
}
"""Status that counts the readings of each topic."""
READINGS = {messages.JOINT_STATES: 2, messages.COMPASS: 1, messages.LRF_POSE: 1}
"""Number of readings of a message."""


class Sent(NamedTuple):
    """A message as it was published."""

    time_ns: int
    topic: str
    content: Any


class Driver(OwnNode):
    """A simulated robot in real time, that keeps what it has sent and what it hears.

    Attributes:
        sent: in the order of sending.
        heard: x, y, yaw by stamp.
        counted: number of readings that the localizer has taken so far, by sensor.
        counted_ns: the period's end at which it has told so [ns].
    """

    def __init__(self) -> None:
        super().__init__("driver")
        self.sent: list[Sent] = []
        self.heard: dict[int, tuple[float, ...]] = {}
        self.counted: Counter[str] = Counter()
        self.counted_ns = 0
        parameters = make_parameters(**PARAMETERS)
        qos = QoSProfile(depth=1000)
        self._publishers = {
            topic: self.node.create_publisher(
                message_class(messages.INPUT_TYPES[topic]), topic, qos
            )
            for topic in messages.input_topics(parameters)
            if topic != messages.INITIAL_POSE
        }
        self.node.create_subscription(Odometry, messages.ODOM, self._hear, qos)
        self.node.create_subscription(DiagnosticArray, messages.DIAGNOSTICS, self._count, qos)
        self._robot: FakeRobot | None = None

    @property
    def topics(self) -> list[str]:
        """The topics that it sends."""
        return list(self._publishers)

    def met(self) -> bool:
        """Return whether the localizer listens to every topic, and is heard."""
        self.spin()
        return self.node.count_publishers(messages.ODOM) > 0 and all(
            each.get_subscription_count() > 0 for each in self._publishers.values()
        )

    def forget(self, patiently: Callable[..., None]) -> None:
        """Let the localizer forget what it has heard, as some of the first messages are lost."""
        client = self.node.create_client(Trigger, "localizer/reset")
        patiently(lambda: self.spin() or client.service_is_ready(), "the service")
        self.wait_for_counts(patiently)
        self.sent.clear()
        self._robot = None
        future = client.call_async(Trigger.Request())
        patiently(lambda: self.spin() or future.done(), "the answer")

    def wait_for_counts(self, patiently: Callable[..., None]) -> None:
        """Wait until the localizer has told what it took of all that was sent."""
        last_ns = max(messages.stamp_ns(each.content) for each in self.sent)
        patiently(lambda: self.spin() or self.counted_ns >= last_ns, "/diagnostics")

    def drive(self, seconds: float) -> None:
        """Send what the robot's sensors send, at its time."""
        if self._robot is None:
            asked = build(FakeRobotParameters, {"path": "figure_eight", "lrf_rate": 5.0})
            self._robot = FakeRobot(asked, time.time_ns())
        end_ns = self._robot.stamp_ns + round(seconds * S)
        while self._robot.stamp_ns < end_ns:
            if time.time_ns() < self._robot.stamp_ns:
                self.spin(0.005)
                continue
            for each in self._robot.step():
                if each.topic in self._publishers:
                    content = build_message(each.message)
                    self.sent.append(Sent(time.time_ns(), each.topic, content))
                    self._publishers[each.topic].publish(content)

    def _hear(self, message: Odometry) -> None:
        self.heard[messages.stamp_ns(message)] = tuple(messages.planar_pose(message))

    def _count(self, message: DiagnosticArray) -> None:
        self.counted_ns = messages.stamp_ns(message)
        for status in message.status:
            for each in status.values:
                if each.key == RECEIVED:
                    self.counted[status.name.rpartition(" ")[2]] = int(each.value)


@pytest.fixture
def driver(ros_environment: None) -> Iterator[Driver]:
    made = Driver()
    yield made
    made.close()


def replayed(sent: list[Sent]) -> dict[int, tuple[float, ...]]:
    """Return what a localizer that hears every message at once gives, by stamp."""
    parameters = make_parameters(**PARAMETERS)
    localizer = Localizer(parameters, networks_for(parameters))
    outputs = [
        output
        for time_ns, topic, content in sent
        for output in localizer.receive(topic, content, time_ns).outputs
    ]
    return {
        output.stamp_ns: tuple(
            messages.planar_pose(as_object(messages.odometry(output.estimate, "map", "base")))
        )
        for output in outputs
        if output.estimate is not None
    }


@pytest.mark.parametrize("stop_s", [0.7, 5.0])
def test_a_node_that_was_stopped_publishes_what_a_replay_does(
    processes: Any, driver: Driver, patiently: Callable[..., None], stop_s: float
) -> None:
    """All of the queues is taken before time passes, in the order in which it was sent."""
    arguments = [
        argument
        for name, value in {**GEOMETRY, **PARAMETERS}.items()
        for argument in ("-p", f"{name}:={value}")
    ]
    # What waits in shared memory for more than a second, as on a busy machine even after the short
    # stop, is dropped unless it can be asked for.
    arguments += [
        argument
        for topic in driver.topics
        for argument in ("-p", f"qos_overrides./{topic}.subscription.reliability:=reliable")
    ]
    localizer = processes.start("localizer", "--ros-args", *arguments)
    patiently(driver.met, "the localizer")
    patiently(lambda: driver.drive(0.1) or len(driver.heard) > 3, "odom from all sensors")
    driver.forget(patiently)
    counted_before = driver.counted.copy()
    driver.drive(DRIVEN_S)
    localizer.send_signal(signal.SIGSTOP)
    driver.drive(stop_s)
    localizer.send_signal(signal.SIGCONT)
    driver.drive(DRIVEN_S)
    expected = replayed(driver.sent)
    last_ns = max(expected)
    patiently(lambda: driver.spin() or last_ns in driver.heard, "the last odom")
    driver.wait_for_counts(patiently)
    processes.stop(localizer)

    sent: Counter[str] = Counter()
    for each in driver.sent:
        sent[SENSORS[each.topic]] += READINGS[each.topic]
    assert driver.counted - counted_before == sent, "the middleware lost messages"
    assert len(expected) > 10 * stop_s
    first_ns = min(expected)
    heard = sorted(stamp_ns for stamp_ns in driver.heard if first_ns <= stamp_ns <= last_ns)
    assert heard == sorted(expected)
    differing = {
        stamp_ns: np.linalg.norm(np.subtract(driver.heard[stamp_ns], pose)[:2])
        for stamp_ns, pose in expected.items()
        if driver.heard[stamp_ns] != pose
    }
    assert not differing, f"{len(differing)} of {len(expected)}, up to {max(differing.values())} m"


def test_a_stop_after_the_look_lets_no_time_pass(
    bench: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Time passes up to the look; what is sent between it and the next one is taken before."""
    node = bench().localizer
    moments = [Moment(5.0 * place, 5 * S * place, 5 * S * place) for place in range(1, 9)]
    clock = iter(moments)
    monkeypatch.setattr(node_module, "now_of", lambda _: next(clock))
    monkeypatch.setattr(node_module.time, "monotonic", lambda: moments[0].steady_s)
    passed = []
    monkeypatch.setattr(node.localizer, "advance", lambda now_ns, _: passed.append(now_ns) or [])
    node._look_at_clock()
    monkeypatch.undo()
    assert passed == [moments[0].ros_ns]
