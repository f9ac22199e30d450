"""`play BAG`: publishes a recorded bag where `ros2 bag` is not installed."""

import argparse
import sys
import time
from pathlib import Path
from typing import Any

from fnn_ekf_ros import messages
from fnn_ekf_ros.bag_files import BagError, BagReader, Topic
from fnn_ekf_ros.errors import FnnEkfError
from fnn_ekf_ros.ros.build import build_message, message_class
from fnn_ekf_ros.ros.runtime import ros_started
from fnn_ekf_ros.stopping import STOPPED
from fnn_ekf_ros.tools.progress import with_progress

from rclpy.duration import Duration  # isort: skip  (runtime explains it if ROS is not here)
from rclpy.node import Node  # isort: skip
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy  # isort: skip

NODE_NAME = "player"
QUEUE_DEPTH = 1000
LONGEST_SLEEP_S = 0.1
DELIVERY_PATIENCE_S = 5.0
"""A subscriber that does not take its messages is waited for at the end no longer [s]."""
CLOCK_INTERVAL_NS = 10_000_000
"""With --clock, time is published with every message, and this often where there is none [ns]."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument("bag", metavar="BAG", type=Path, help="the recording to publish")
    parser.add_argument("--rate", type=float, default=1.0, help="times real time (1.0)")
    parser.add_argument(
        "--clock", action="store_true", help="publish /clock, for nodes with use_sim_time"
    )
    parser.add_argument("--loop", action="store_true", help="begin again at the end")
    parser.add_argument("--topics", nargs="+", metavar="TOPIC", help="only these")
    parser.add_argument(
        "--exclude-topics", nargs="+", metavar="TOPIC", default=[], help="all but these"
    )
    parser.add_argument(
        "--delay", type=float, default=0.0, metavar="S",
        help="begin so much later (0); /clock stands at the beginning meanwhile",
    )  # fmt: skip
    parser.add_argument(
        "--wait-for-subscribers", type=float, metavar="S",
        help="begin when every topic (and /clock) has a subscriber; fail after S seconds",
    )  # fmt: skip


def run(arguments: argparse.Namespace) -> int:
    """Run the command."""
    if not 1e-3 <= arguments.rate <= 1e4:
        raise FnnEkfError(f"--rate {arguments.rate:g}: expected 0.001 to 10000")
    if not 0.0 <= arguments.delay <= 1e6:
        raise FnnEkfError(f"--delay {arguments.delay:g}: expected 0 to 1e6 seconds")
    patience_s = arguments.wait_for_subscribers
    if patience_s is not None and not 0.0 <= patience_s <= 1e6:
        raise FnnEkfError(f"--wait-for-subscribers {patience_s:g}: expected 0 to 1e6 seconds")
    with BagReader(arguments.bag) as bag, ros_started([], NODE_NAME):
        topics = _chosen(bag, arguments)
        node = Node(NODE_NAME)
        try:
            player = _Player(node, topics, arguments)
            if patience_s is not None:
                player.wait_for_subscribers(patience_s)
            player.wait(arguments.delay, bag.start_ns)
            while True:
                player.play(bag)
                if not arguments.loop or STOPPED.is_set():
                    break
            player.wait_for_delivery()
        finally:
            node.destroy_node()
    return 0


class _Player:
    """Publishes records at the pace they were recorded at, times the rate."""

    def __init__(
        self,
        node: Node,
        topics: list[Topic],
        arguments: argparse.Namespace,
    ) -> None:
        self._rate = arguments.rate
        self._publishers: dict[str, Any] = {}
        for topic in topics:
            try:
                kind = message_class(topic.type_name)
            except (ImportError, AttributeError, ValueError):
                print(
                    f"play: {topic.name} is left out: type {topic.type_name} is not installed",
                    file=sys.stderr,
                )
                continue
            self._publishers[topic.name] = node.create_publisher(kind, topic.name, _qos(topic))
        self._clock = None
        if arguments.clock:
            self._clock = node.create_publisher(
                message_class(messages.CLOCK_TYPE), messages.CLOCK, QoSProfile(depth=10)
            )

    def wait_for_subscribers(self, patience_s: float) -> None:
        """Return when all publishers are matched.

        Raises:
            FnnEkfError: some are not after the given time.
        """
        waiting = {**self._publishers}
        if self._clock is not None:
            waiting[messages.CLOCK] = self._clock
        until = time.monotonic() + patience_s
        while not STOPPED.is_set():
            missing = [name for name, p in waiting.items() if p.get_subscription_count() == 0]
            if not missing:
                return
            if time.monotonic() > until:
                raise FnnEkfError(
                    f"no subscriber after {patience_s:g} s on {', '.join(sorted(missing))}"
                )
            STOPPED.wait(0.02)

    def wait(self, delay_s: float, begin_ns: int) -> None:
        """Let the clock stand at the beginning for a while."""
        until = time.monotonic() + delay_s
        while time.monotonic() < until and not STOPPED.wait(CLOCK_INTERVAL_NS * 1e-9):
            self._tell_clock(begin_ns)

    def play(self, bag: BagReader) -> None:
        """Publish the recording once."""
        began: float | None = None
        begin_ns = clock_ns = 0
        records = bag.records(set(self._publishers))
        for record in with_progress(records, self._count(bag), "play"):
            if began is None:
                began, begin_ns, clock_ns = time.monotonic(), record.time_ns, record.time_ns
                self._tell_clock(clock_ns)
            while not STOPPED.is_set():
                due_ns = record.time_ns
                if self._clock is not None:
                    due_ns = min(due_ns, clock_ns + CLOCK_INTERVAL_NS)
                ahead_s = (due_ns - begin_ns) * 1e-9 / self._rate - (time.monotonic() - began)
                if ahead_s > 0.0:
                    STOPPED.wait(min(ahead_s, LONGEST_SLEEP_S))
                    continue
                if due_ns > clock_ns:
                    clock_ns = due_ns
                    self._tell_clock(clock_ns)
                if due_ns == record.time_ns:
                    break
            if STOPPED.is_set():
                return
            self._publishers[record.topic].publish(bytes(record.data))

    def wait_for_delivery(self) -> None:
        """Give reliable subscribers the chance to fetch what is still queued."""
        until = time.monotonic() + DELIVERY_PATIENCE_S
        for publisher in self._publishers.values():
            while not STOPPED.is_set() and time.monotonic() < until:
                if publisher.wait_for_all_acked(Duration(seconds=LONGEST_SLEEP_S)):
                    break

    def _count(self, bag: BagReader) -> int:
        return sum(bag.topics[name].message_count for name in self._publishers)

    def _tell_clock(self, now_ns: int) -> None:
        if self._clock is not None:
            fields = {"clock": messages.time(now_ns)}
            self._clock.publish(build_message(messages.Message(messages.CLOCK_TYPE, fields)))


def _chosen(bag: BagReader, arguments: argparse.Namespace) -> list[Topic]:
    """Return the topics to publish: those asked for, never a recorded clock beside our own."""
    asked = [messages.absolute_name(name) for name in (arguments.topics or [])]
    excluded = {messages.absolute_name(name) for name in arguments.exclude_topics}
    for name in [*asked, *excluded]:
        if name not in bag.topics:
            raise BagError(
                f"bag '{bag.path}' has no topic {name}: it has {', '.join(sorted(bag.topics))}"
            )
    if arguments.clock:
        excluded.add(messages.CLOCK)
    chosen = [
        topic
        for name, topic in bag.topics.items()
        if (not asked or name in asked) and name not in excluded
    ]
    if not chosen:
        raise BagError(f"bag '{bag.path}': no topic is left to publish")
    return chosen


def _qos(topic: Topic) -> QoSProfile:
    return QoSProfile(
        depth=QUEUE_DEPTH,
        reliability=(
            ReliabilityPolicy.RELIABLE if topic.reliable else ReliabilityPolicy.BEST_EFFORT
        ),
        durability=(
            DurabilityPolicy.TRANSIENT_LOCAL if topic.transient_local else DurabilityPolicy.VOLATILE
        ),
    )
