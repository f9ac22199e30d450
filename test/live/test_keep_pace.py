# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Playing that keeps pace with a node that is as slow as the test wants it to be."""

import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from nav_msgs.msg import Odometry
from own_nodes import OwnNode
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Imu

from fnn_ekf_ros import messages
from fnn_ekf_ros.cli import run_command
from fnn_ekf_ros.recordings.bag_files import BagReader

pytestmark = pytest.mark.live

S = 10**9
LEAD_NS = 6 * S // 10


class SlowNode(OwnNode):
    """Hears what is played, and publishes odom when the test says so."""

    def __init__(self, reliability: ReliabilityPolicy = ReliabilityPolicy.RELIABLE) -> None:
        super().__init__("slow")
        self._odom = self.node.create_publisher(
            Odometry, "/odom", QoSProfile(depth=10, reliability=reliability)
        )
        self.node.create_subscription(Clock, "/clock", self._hear_clock, 10000)
        self.node.create_subscription(Imu, "/compass", self._hear_compass, 10000)
        self.clock_ns = self.repeated = 0
        self.compass_ns: list[int] = []
        self.follows = False

    def publish(self, stamp_ns: int) -> None:
        message = Odometry()
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp_ns, S)
        self._odom.publish(message)

    def heard(self) -> bool:
        """Return whether somebody has subscribed to odom."""
        return self._odom.get_subscription_count() > 0

    def held(self) -> bool:
        """Spin; return whether the clock stands, and goes on being told."""
        self.spin()
        return self.repeated >= 3

    def _hear_clock(self, message: Clock) -> None:
        now_ns = message.clock.sec * S + message.clock.nanosec
        self.repeated = self.repeated + 1 if now_ns == self.clock_ns else 0
        self.clock_ns = now_ns
        if self.follows:
            self.publish(now_ns)

    def _hear_compass(self, message: Imu) -> None:
        self.compass_ns.append(messages.stamp_ns(message))


@pytest.fixture
def slow_node(ros_environment: None) -> Iterator[Callable[..., SlowNode]]:
    """Makes a slow node."""
    opened: list[SlowNode] = []

    def make(*arguments: Any) -> SlowNode:
        opened.append(SlowNode(*arguments))
        return opened[-1]

    yield make
    for each in opened:
        each.close()


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording of some seconds."""
    bag = tmp_path_factory.mktemp("drive") / "bag"
    assert run_command("simulate", [str(bag), "--duration", "4"]) == 0
    return bag


def start_playing(processes: Any, bag: Path, *options: object) -> Any:
    return processes.start(
        "play", bag, "--clock", "--topics", "compass", "--wait-for-subscribers", 60,
        "--keep-pace-with", "odom", "--lead", LEAD_NS / S, *options,
    )  # fmt: skip


@pytest.mark.parametrize("reliability", [ReliabilityPolicy.RELIABLE, ReliabilityPolicy.BEST_EFFORT])
def test_play_waits_for_who_is_behind_and_loses_nothing(
    processes: Any,
    slow_node: Callable[..., SlowNode],
    patiently: Callable[..., None],
    drive: Path,
    reliability: ReliabilityPolicy,
) -> None:
    with BagReader(drive) as reader:
        recorded = [
            messages.stamp_ns(reader.message(record)) for record in reader.records({"/compass"})
        ]
    node = slow_node(reliability)
    player = start_playing(processes, drive, "--rate", 1000)
    patiently(lambda: node.spin() or node.compass_ns, "the first compass reading")
    stamp_ns = node.clock_ns
    node.publish(stamp_ns)
    for _ in range(3):
        patiently(node.held, "the player to wait")
        assert stamp_ns < node.clock_ns <= stamp_ns + LEAD_NS
        assert node.compass_ns[-1] <= stamp_ns + LEAD_NS
        stamp_ns, node.repeated = node.clock_ns, 0
        node.publish(stamp_ns)
    node.follows = True
    patiently(lambda: node.spin() or player.poll() is not None, "the player's end")
    assert player.returncode == 0, processes.output(player)
    patiently(lambda: node.spin() or len(node.compass_ns) >= len(recorded), "all readings")
    assert node.compass_ns == recorded


def test_play_ends_where_nothing_new_comes(
    processes: Any,
    slow_node: Callable[..., SlowNode],
    patiently: Callable[..., None],
    drive: Path,
) -> None:
    node = slow_node()
    player = start_playing(processes, drive, "--patience", 5)
    patiently(lambda: node.spin() or node.compass_ns, "the first compass reading")
    patiently(lambda: node.spin() or node.heard(), "the player's subscription")
    stamp_ns = node.clock_ns
    node.publish(stamp_ns)
    patiently(lambda: node.spin() or player.poll() is not None, "the player's end")
    assert player.returncode == 1
    assert processes.output(player) == (
        f"play: nothing new on /odom for 5 s after {stamp_ns / S:.3f} s, with a --lead of 0.6 s\n"
    )


def test_play_says_at_the_end_that_nothing_ever_came(
    processes: Any,
    slow_node: Callable[..., SlowNode],
    patiently: Callable[..., None],
    drive: Path,
) -> None:
    node = slow_node()
    player = start_playing(processes, drive)
    patiently(lambda: node.spin() or player.poll() is not None, "the player's end")
    assert player.returncode == 1
    assert processes.output(player) == (
        "play: nothing came on /odom to keep pace with: does its node have use_sim_time:=true, and "
        "play --clock?\n"
    )


@pytest.mark.parametrize("patience_s", [1, 60])
def test_play_says_that_the_node_is_ahead_of_the_recording(
    processes: Any,
    slow_node: Callable[..., SlowNode],
    patiently: Callable[..., None],
    drive: Path,
    patience_s: int,
) -> None:
    node = slow_node()
    player = start_playing(processes, drive, "--patience", patience_s)
    patiently(lambda: node.spin() or node.compass_ns, "the first compass reading")
    patiently(
        lambda: node.publish(1000 * S) or node.spin() or player.poll() is not None,
        "the player's end",
    )
    assert player.returncode == 1
    found = re.fullmatch(
        r"play: /odom is stamped 1000\.000 s while (\d+\.\d{3}) s is played: does its node have "
        r"use_sim_time:=true, and play --clock\?\n",
        processes.output(player),
    )
    assert found
    with BagReader(drive) as reader:
        last_s = reader.start_ns * 1e-9 + reader.duration_s
    if patience_s == 1:
        assert float(found.group(1)) < last_s - 1.0, "it is said before the end"
