# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""`play BAG`: publishes a recorded bag where `ros2 bag` is not installed."""

import argparse
import math
import sys
import time
from contextlib import closing
from pathlib import Path
from typing import Any

from fnn_ekf_ros import messages
from fnn_ekf_ros.errors import FnnEkfError
from fnn_ekf_ros.recordings.bag_files import BagError, BagReader, Topic, check_bags
from fnn_ekf_ros.reports.progress import with_progress
from fnn_ekf_ros.ros.build import build_message, message_class
from fnn_ekf_ros.ros.runtime import ros_started
from fnn_ekf_ros.ros.timetable import Timetable
from fnn_ekf_ros.stopping import STOPPED

from rclpy.duration import Duration  # isort: skip  (runtime explains it if ROS is not here)
from fnn_ekf_ros.ros.listener import StampListener  # isort: skip
from rclpy.node import Node  # isort: skip
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy  # isort: skip

NODE_NAME = "player"
"""Name of the node."""
QUEUE_DEPTH = 1000
"""Depth of the queue of each topic [messages]."""
LONGEST_SLEEP_S = 0.1
"""Longest sleep between two checks for signals [s]."""
DELIVERY_PATIENCE_S = 5.0
"""Longest wait at the end for a subscriber that does not take its messages [s]."""
DEFAULT_LEAD_S = 0.7
"""Default of the largest lead with --keep-pace-with [s].

The localizer publishes a period (0.375 s) after the first reading of the wheels after its end, so
the lead has to be longer than a period and the interval of the wheels. It closes a period without
the wheels 0.5 s after its end, whatever still waits in its queues: the lead has to be shorter than
0.875 s.
"""
DEFAULT_PATIENCE_S = 30.0
"""Default of the longest wait for the other node with --keep-pace-with [s]."""
CLOCK_INTERVAL_NS = 10_000_000
"""Longest time between two messages of /clock with --clock [ns]; there is also one with every
message."""


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
    parser.add_argument(
        "--keep-pace-with", metavar="TOPIC",
        help="play slower than --rate where the node that publishes TOPIC cannot keep up: never "
        "further ahead than --lead of the newest header stamp on TOPIC, and not faster than real "
        "time before the first",
    )  # fmt: skip
    parser.add_argument(
        "--lead", type=float, default=DEFAULT_LEAD_S, metavar="S",
        help=f"longest lead in recorded time, with --keep-pace-with ({DEFAULT_LEAD_S:g}: longer "
        "than the localizer's period, shorter than its period and encoder_timeout together)",
    )  # fmt: skip
    parser.add_argument(
        "--patience", type=float, default=DEFAULT_PATIENCE_S, metavar="S",
        help="with --keep-pace-with: fail if TOPIC has no publisher, or nothing new while it is "
        f"waited for, after S seconds ({DEFAULT_PATIENCE_S:g})",
    )  # fmt: skip


def run(arguments: argparse.Namespace) -> int:
    """Run the command."""
    check_bags([arguments.bag])
    _check(arguments)
    with BagReader(arguments.bag) as bag, ros_started([], NODE_NAME):
        if arguments.clock:
            bag.check_stamps()
        topics = _chosen(bag, arguments)
        node = Node(NODE_NAME)
        try:
            with closing(_Player(node, topics, arguments)) as player:
                if arguments.wait_for_subscribers is not None:
                    player.wait_for_subscribers(arguments.wait_for_subscribers)
                player.wait(arguments.delay, bag.start_ns)
                while True:
                    player.play(bag)
                    if not arguments.loop or STOPPED.is_set():
                        break
                player.wait_for_delivery()
        finally:
            node.destroy_node()
    return 0


def _check(arguments: argparse.Namespace) -> None:
    """Refuse numbers out of range and what is no topic's name."""
    for option, value, least, most, unit in (
        ("--rate", arguments.rate, 1e-3, 1e4, ""),
        ("--delay", arguments.delay, 0.0, 1e6, " seconds"),
        ("--wait-for-subscribers", arguments.wait_for_subscribers, 0.0, 1e6, " seconds"),
        ("--lead", arguments.lead, 1e-3, 1e6, " seconds"),
        ("--patience", arguments.patience, 0.0, 1e6, " seconds"),
    ):
        if value is not None and not least <= value <= most:
            raise FnnEkfError(f"{option} {value:g}: expected {least:g} to {most:.0f}{unit}")
    topic = arguments.keep_pace_with
    if topic is not None and not messages.is_topic_name(topic):
        raise FnnEkfError(f"--keep-pace-with {topic[:80]!r}: expected a topic's name")


class _Player:
    """Publishes records at the pace they were recorded at, times the rate.

    Raises:
        FnnEkfError: there is nobody to keep pace with.
    """

    def __init__(
        self,
        node: Node,
        topics: list[Topic],
        arguments: argparse.Namespace,
    ) -> None:
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
        self._patience_s, self._lead_s = arguments.patience, arguments.lead
        self._listener, self._topic, lead_ns = None, "", None
        if arguments.keep_pace_with is not None:
            self._topic = node.resolve_topic_name(arguments.keep_pace_with)
            if self._topic in self._publishers:
                raise FnnEkfError(
                    f"--keep-pace-with {self._topic}: it is played itself, see --exclude-topics"
                )
            self._listener = StampListener(node, self._topic, arguments.patience)
            lead_ns = round(arguments.lead * 1e9)
        self._timetable = Timetable(arguments.rate, lead_ns)
        self._patient_until_s = math.inf
        self._ahead_ns: int | None = None

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
        """Publish the recording once.

        Raises:
            FnnEkfError: who is kept pace with publishes nothing any more, or never did, or what is
                ahead of the recording.
        """
        timetable = self._timetable
        records = bag.records(set(self._publishers))
        started = False
        for record in with_progress(records, self._count(bag), "play"):
            if not started:
                timetable.start(record.time_ns)
                self._patient_until_s = time.monotonic() + self._patience_s
                self._ahead_ns = None
                self._tell_clock(record.time_ns)
                started = True
            while not STOPPED.is_set():
                due_ns = record.time_ns
                if self._clock is not None:
                    due_ns = min(due_ns, timetable.played_ns + CLOCK_INTERVAL_NS)
                self._wait_until(due_ns)
                if due_ns > timetable.played_ns:
                    timetable.played(due_ns)
                    self._tell_clock(due_ns)
                if due_ns == record.time_ns:
                    break
            if STOPPED.is_set():
                return
            self._publishers[record.topic].publish(bytes(record.data))
        if self._listener is not None and timetable.heard_ns is None:
            raise FnnEkfError(self._nothing_to_keep_pace_with())

    def close(self) -> None:
        """Stop listening."""
        if self._listener is not None:
            self._listener.close()

    def _wait_until(self, due_ns: int) -> None:
        """Return when a time [ns] of the recording is due, or the process is stopped."""
        timetable = self._timetable
        patient_until = time.monotonic() + self._patience_s
        if self._listener is not None and timetable.heard_ns is None:
            self._listen(0.0)
        while not STOPPED.is_set():
            wait_s = min(timetable.wait_s(due_ns), LONGEST_SLEEP_S)
            if wait_s <= 0.0:
                return
            if self._listen(wait_s):
                patient_until = time.monotonic() + self._patience_s
            elif timetable.held(due_ns):
                self._tell_clock(timetable.played_ns)  # the last one may have been lost
                if time.monotonic() > patient_until:
                    raise FnnEkfError(self._silence(timetable.heard_ns or 0))

    def _listen(self, timeout_s: float) -> bool:
        """Wait, at most until the next message to keep pace with; return whether it was new."""
        if self._listener is None:
            STOPPED.wait(timeout_s)
            return False
        stamp_ns = self._listener.next_ns(timeout_s)
        if stamp_ns is None:
            return False
        timetable = self._timetable
        if timetable.heard_ns is None and stamp_ns > timetable.played_ns:
            self._ahead_ns = stamp_ns
            if time.monotonic() > self._patient_until_s:
                raise FnnEkfError(self._nothing_to_keep_pace_with())
        return timetable.heard(stamp_ns)

    def _nothing_to_keep_pace_with(self) -> str:
        came = f"nothing came on {self._topic} to keep pace with"
        if self._ahead_ns is not None:
            came = (
                f"{self._topic} is stamped {self._ahead_ns * 1e-9:.3f} s while "
                f"{self._timetable.played_ns * 1e-9:.3f} s is played"
            )
        return f"{came}: does its node have use_sim_time:=true, and play --clock?"

    def _silence(self, heard_ns: int) -> str:
        return (
            f"nothing new on {self._topic} for {self._patience_s:g} s after "
            f"{heard_ns * 1e-9:.3f} s, with a --lead of {self._lead_s:g} s"
        )

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
