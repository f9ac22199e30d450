# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Hostile messages to a real localizer: it lives on, says nothing wrong and forgets nothing.

`make hostile` sends a hundred thousand messages, from other seeds than the few that are sent
otherwise; only so many show whether the node's memory grows.
"""

import math
import os
from collections import deque
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray
from hostile_attacks import ATTACKS
from hostile_messages import COMMANDS, SENDING, Command, Recipe, Segment, Sent, stream
from nav_msgs.msg import Odometry
from own_nodes import OwnNode
from rcl_interfaces.srv import GetParameters, SetParameters
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile
from rosgraph_msgs.msg import Clock
from std_srvs.srv import SetBool, Trigger

from fnn_ekf_ros import messages
from fnn_ekf_ros.parameters.localizer import LocalizerParameters
from fnn_ekf_ros.parameters.schema import build
from fnn_ekf_ros.ros.build import build_message, message_class

pytestmark = pytest.mark.live

IN_FULL = "FNN_EKF_ROS_HOSTILE_LIVE_MESSAGES" in os.environ
MESSAGES = int(os.environ.get("FNN_EKF_ROS_HOSTILE_LIVE_MESSAGES", "2500"))
FIRST_SEED = int(os.environ.get("FNN_EKF_ROS_HOSTILE_SEED", "0"))
CHUNK = 150
"""Number of messages between two checks whether the node still answers."""
PAGE = os.sysconf("SC_PAGE_SIZE")
GEOMETRY = {"wheel_radius": 0.025, "wheel_separation": 0.6, "encoder_counts_per_revolution": 500.0}
UNSENDABLE = (AssertionError, OverflowError, TypeError, ValueError)
"""What rclpy refuses to build or to send."""


class Sender(OwnNode):
    """A node that sends streams and listens to odom.

    Attributes:
        sent: how many messages left.
        odom: how many arrived, all of them sound.
    """

    def __init__(self, patiently: Callable[..., None]) -> None:
        super().__init__("sender")
        self._patiently = patiently
        qos = QoSProfile(depth=2 * CHUNK)
        self._publishers = {
            topic: self.node.create_publisher(message_class(kind), topic, qos)
            for topic, kind in messages.INPUT_TYPES.items()
            if topic != messages.JOINT_STATES
        }
        self._clock = self.node.create_publisher(Clock, "/clock", qos)
        self.node.create_subscription(Odometry, messages.ODOM, self._hear, 5000)
        self.node.create_subscription(DiagnosticArray, messages.DIAGNOSTICS, self._keep, 100)
        self.sent = self.unsendable = self.odom = 0
        self.last: deque[Odometry] = deque(maxlen=20)
        self.statuses: dict[str, dict[str, str]] = {}
        self._clients: dict[str, Any] = {}
        self._now_ns = 0
        self._chunk = CHUNK

    def connect(self) -> None:
        """Wait until the localizer listens to all of it and is listened to."""
        self._patiently(
            lambda: (
                self.spin()
                or all(
                    p.get_subscription_count() for p in [*self._publishers.values(), self._clock]
                )
            ),
            "the localizer",
        )
        self.call(GetParameters, "get_parameters", GetParameters.Request(names=["period"]))

    def call(self, kind: Any, name: str, request: Any) -> Any:
        """Call a service of the localizer; it answers as long as it lives."""
        if name not in self._clients:
            self._clients[name] = self.node.create_client(kind, f"localizer/{name}")
        client = self._clients[name]
        self._patiently(lambda: client.service_is_ready() or self.spin(), f"service {name}")
        future = client.call_async(request)
        self._patiently(lambda: future.done() or self.spin(), f"answer of {name}")
        return future.result()

    def play(self, recipe: Recipe, parameters: LocalizerParameters) -> list[tuple[int, np.ndarray]]:
        """Send a whole stream; returns where the robot was, when nothing was attacked."""
        truth: list[tuple[int, np.ndarray]] = []
        for each in stream(recipe, parameters):
            if isinstance(each, Sent):
                self._send(each)
            elif isinstance(each, Command):
                self._command(each)
            else:
                truth.append((each.stamp_ns, each.pose))
        self._catch_up()
        return truth

    def take_time(self) -> None:
        """From now on send nothing before the last has been read: ticks have no stamp."""
        self._chunk = 1

    def _send(self, sent: Sent) -> None:
        if sent.topic not in self._publishers:
            return
        if sent.now_ns != self._now_ns:
            sec, nanosec = divmod(sent.now_ns, 10**9)
            self._clock.publish(Clock(clock=Time(sec=sec, nanosec=nanosec)))
            self._now_ns = sent.now_ns
        try:
            self._publishers[sent.topic].publish(build_message(sent.message))
        except UNSENDABLE:
            self.unsendable += 1
            return
        self.sent += 1
        if self.sent % self._chunk == 0:
            self._catch_up()

    def _catch_up(self) -> None:
        """Go on when the node has answered, and has had the time to read what was sent."""
        asked = GetParameters.Request(names=["period"])
        for _ in range(self._chunk // 3 + 1):
            assert self.call(GetParameters, "get_parameters", asked).values

    def _command(self, command: Command) -> None:
        if command.name == "reset":
            assert self.call(Trigger, "reset", Trigger.Request()).success
        elif command.name == "change":
            mode = ("none", "r", "q", "joint")[command.number % 4]
            wanted = Parameter("adaptation", value=mode).to_parameter_msg()
            request = SetParameters.Request(parameters=[wanted])
            assert self.call(SetParameters, "set_parameters", request).results[0].successful
        else:
            request = SetBool.Request(data=command.name == "learn")
            self.call(SetBool, "enable_adaptation", request)

    def _hear(self, odom: Odometry) -> None:
        pose, twist = odom.pose.pose, odom.twist.twist
        numbers = [
            pose.position.x, pose.position.y, pose.orientation.z, pose.orientation.w,
            twist.linear.x, twist.angular.z,
        ]  # fmt: skip
        assert all(map(math.isfinite, numbers)), numbers
        for flat in (odom.pose.covariance, odom.twist.covariance):
            covariance = np.reshape(flat, (6, 6))
            assert np.all(np.isfinite(covariance)), covariance
            assert np.array_equal(covariance, covariance.T)
            assert np.linalg.eigvalsh(covariance)[0] > 0.0, covariance
        self.odom += 1
        self.last.append(odom)

    def _keep(self, array: DiagnosticArray) -> None:
        for status in array.status:
            self.statuses[status.name] = {entry.key: entry.value for entry in status.values}


@pytest.fixture
def sender(ros_environment: None, patiently: Callable[..., None]) -> Iterator[Sender]:
    opened = Sender(patiently)
    yield opened
    opened.close()


def resident_bytes(pid: int) -> int:
    """Return how much memory a process has."""
    return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * PAGE


def recipe_of(number: int) -> Recipe:
    """Return a drive through many attacks, with ordinary driving in between."""
    rng = np.random.default_rng([number, FIRST_SEED])
    attacks = (*ATTACKS, *SENDING, *COMMANDS)
    segments = []
    for _ in range(6):
        chosen = tuple(str(name) for name in rng.choice(attacks, rng.integers(1, 5), replace=False))
        share = float(rng.choice([0.02, 0.1, 0.5, 1.0]))
        segments += [Segment(chosen, share, int(rng.integers(20, 80))), Segment((), 0.0, 20)]
    return Recipe(int(rng.integers(2**32)), tuple(segments))


@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="no /proc here")
def test_a_node_outlives_hostile_messages(processes: Any, sender: Sender) -> None:
    """Then it finds the robot again on ordinary ones, and stops cleanly."""
    localizer = processes.start(
        "localizer", "--ros-args", "-p", "use_sim_time:=true",
        *(word for name, value in GEOMETRY.items() for word in ("-p", f"{name}:={value}")),
    )  # fmt: skip
    sender.connect()
    parameters = build(LocalizerParameters, GEOMETRY)
    resident: list[int] = []
    number = 0
    while sender.sent < MESSAGES:
        sender.play(recipe_of(number), parameters)
        number += 1
        assert localizer.poll() is None
        resident.append(resident_bytes(localizer.pid))
    assert sender.odom > sender.sent / 200  # the filter was running
    arrived = sum(
        int(values[key])
        for values in sender.statuses.values()
        for key in ("received", "refused", "dropped", "duplicates")
        if key in values
    )
    assert arrived > 0.9 * sender.sent

    settled = resident[len(resident) // 2]
    print(
        f"{sender.sent} messages, {sender.unsendable} that rclpy does not build, {sender.odom} "
        f"odom, {number} drives; MB resident: {resident[0] / 1e6:.1f} first, "
        f"{settled / 1e6:.1f} half, {resident[-1] / 1e6:.1f} last"
    )
    if IN_FULL:
        assert resident[-1] - settled < 2e6, [size / 1e6 for size in resident]

    wanted = Parameter("adaptation", value="joint").to_parameter_msg()
    request = SetParameters.Request(parameters=[wanted])
    assert sender.call(SetParameters, "set_parameters", request).results[0].successful
    sender.call(SetBool, "enable_adaptation", SetBool.Request(data=True))
    sender.take_time()
    truth = sender.play(Recipe(FIRST_SEED, (Segment((), 0.0, 400),)), parameters)
    stamps, poses = zip(*truth, strict=True)
    for odom in sender.last:
        stamp_ns = messages.stamp_ns(odom)
        assert stamps[0] < stamp_ns < stamps[-1]
        found = messages.planar_pose(odom)
        error = [np.interp(stamp_ns, stamps, [p[i] for p in poses]) - found[i] for i in (0, 1)]
        assert math.hypot(*error) < 0.3
    processes.stop(localizer)
