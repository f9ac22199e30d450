# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Publishes the robot's messages in real time and hears the odom of the node that is measured."""

import os
import time
from pathlib import Path
from typing import Any

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.signals import SignalHandlerOptions

from bench.rates import PERIOD_NS
from bench.recording import RIGHT_TICKS, START_NS, TYPES, Sent, sent, stamped
from bench.workers import resident_mib, serve

GRID_NS = 1_500_000_000
"""Common multiple of the periods of filter and ticks."""
PHASE_NS = 2_500_000
"""Ticks are sent so long after a multiple of 5 ms: never at the end of a period, which is one."""
PATIENCE_S = 30.0
"""Longest wait for the node to appear [s]."""


class Feeder(Node):  # type: ignore[misc]
    """The feeding node.

    Attributes:
        heard: stamp and time of reception of every odom [ns].
        closing: time before the publication of every message of the right wheel [ns].
    """

    def __init__(self) -> None:
        from fnn_ekf_ros.ros.build import message_class

        super().__init__("feeder")
        self.heard: list[tuple[int, int]] = []
        self.closing: list[int] = []
        qos = QoSProfile(depth=1000)
        self._inputs = {
            topic: self.create_publisher(message_class(kind), topic, qos)
            for topic, kind in TYPES.items()
        }
        kind = message_class("nav_msgs/msg/Odometry")
        self._odom = self.create_subscription(kind, "odom", self._hear, QoSProfile(depth=100))

    def matched(self) -> bool:
        """Return whether the measured node hears this one and is heard."""
        inputs = self._inputs.values()
        return bool(self._odom.get_publisher_count()) and all(
            publisher.get_subscription_count() for publisher in inputs
        )

    def send(self, message: Sent) -> None:
        """Publish a message as if it were measured now."""
        now_ns = time.time_ns()
        if message.topic == RIGHT_TICKS:
            self.closing.append(now_ns)
        self._inputs[message.topic].publish(stamped(message, now_ns))

    def _hear(self, message: Any, info: Any) -> None:
        stamp = message.header.stamp
        self.heard.append((stamp.sec * 10**9 + stamp.nanosec, int(info["received_timestamp"])))


def measure(pid: int, settle_s: float, window_s: float) -> dict[str, Any]:
    """Feed a node and measure it.

    Args:
        pid: the node's process.
        settle_s: time before the window in which nothing is measured [s].
        window_s: length of the window [s].

    Returns:
        Of the window: CPU time of the process as a part of one core, its memory at the end [MiB],
        delays from the message that ended a period to its odom and from the end of the period to
        its odom [ms], and the numbers of periods and of odom.
    """
    messages = list(sent(settle_s + window_s))
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    node = Feeder()
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    deadline = time.monotonic() + PATIENCE_S
    while not node.matched():
        executor.spin_once(timeout_sec=0.05)
        if time.monotonic() > deadline:
            raise TimeoutError("the node and its feeder do not find each other")
    start_ns = (time.time_ns() // GRID_NS + 1) * GRID_NS + PHASE_NS
    opens_ns = start_ns + round(settle_s * 1e9)
    cpu, opened_s = 0.0, 0.0
    for message in messages:
        due_ns = start_ns + message.time_ns - START_NS
        if not opened_s and due_ns >= opens_ns:
            cpu, opened_s = process_cpu_s(pid), time.monotonic()
        while (left_s := 1e-9 * (due_ns - time.time_ns())) > 0.0:
            executor.spin_once(timeout_sec=left_s)
        node.send(message)
    used, took_s = process_cpu_s(pid) - cpu, time.monotonic() - opened_s
    memory = resident_mib(str(pid))
    ended_ns = time.monotonic() + 0.2
    while time.monotonic() < ended_ns:
        executor.spin_once(timeout_sec=0.05)
    work, after_end, expected = delays(node, opens_ns)
    executor.shutdown()
    node.destroy_node()
    rclpy.try_shutdown()
    return {
        "cpu": used / took_s, "mib": memory, "work_ms": work, "after_end_ms": after_end,
        "periods": expected,
    }  # fmt: skip


def delays(node: Feeder, opens_ns: int) -> tuple[list[float], list[float], int]:
    """Return delays from the closing message and from the period's end [ms], and the periods.

    The closing message of a period is the first one of the right wheel that is sent after its
    end. If an odom is there before it, a message sent just before the end was late and closed the
    period: that one is left out of the first list.
    """
    work, after_end = [], []
    for stamp_ns, received_ns in node.heard:
        if stamp_ns < opens_ns:
            continue
        after_end.append(1e-6 * (received_ns - stamp_ns))
        closing = next((at for at in node.closing if at >= stamp_ns), None)
        if closing is not None and received_ns > closing:
            work.append(1e-6 * (received_ns - closing))
    last_ns = node.closing[-1]
    return work, after_end, last_ns // PERIOD_NS - -(-opens_ns // PERIOD_NS) + 1


def process_cpu_s(pid: int) -> float:
    """Return user and system time of a process, of all its threads [s]."""
    fields = Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


if __name__ == "__main__":
    serve(measure)
