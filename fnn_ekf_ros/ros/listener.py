# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The stamps of what another node publishes, for a player that keeps pace with it."""

import time
from typing import Any

from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile

from fnn_ekf_ros.errors import FnnEkfError
from fnn_ekf_ros.ros.build import message_class
from fnn_ekf_ros.stopping import STOPPED

QUEUE_DEPTH = 1000
"""Depth of the queue of the topic that is listened to [messages]."""
HEADER = "std_msgs/Header"
"""Type of the field that has the stamp, as message classes name it."""


class StampListener:
    """Receives the header stamps of a topic of another node, whatever its type.

    Args:
        node: gets the subscription, and is spun by `next_ns`.
        topic: absolute name of the topic.
        patience_s: how long to wait for its publisher [s].

    Raises:
        FnnEkfError: nobody publishes the topic, or its messages have no header.
    """

    def __init__(self, node: Node, topic: str, patience_s: float) -> None:
        self._stamp_ns: int | None = None
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(node)
        publisher = self._wait(
            lambda: next(iter(node.get_publishers_info_by_topic(topic)), None), topic, patience_s
        )
        if publisher is None:
            return
        try:
            kind = message_class(publisher.topic_type)
        except (ImportError, AttributeError, ValueError):
            raise FnnEkfError(f"{topic}: type {publisher.topic_type} is not installed") from None
        if kind.get_fields_and_field_types().get("header") != HEADER:
            raise FnnEkfError(
                f"{topic} is of type {publisher.topic_type}: expected one with a header"
            )
        qos = QoSProfile(depth=QUEUE_DEPTH, reliability=publisher.qos_profile.reliability)
        subscription = node.create_subscription(kind, topic, self._take, qos)
        self._wait(subscription.get_publisher_count, topic, patience_s)

    def next_ns(self, timeout_s: float) -> int | None:
        """Return the stamp of the next message [ns]; None if there is none in time."""
        self._stamp_ns = None
        self._executor.spin_once(timeout_sec=timeout_s)
        return self._stamp_ns

    def close(self) -> None:
        """Let the node go."""
        self._executor.shutdown()

    def _take(self, message: Any) -> None:
        self._stamp_ns = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec

    def _wait(self, look: Any, topic: str, patience_s: float) -> Any:
        """Return what a look finds once it finds something; None if the process is stopped."""
        until = time.monotonic() + patience_s
        while not STOPPED.is_set():
            found = look()
            if found:
                return found
            if time.monotonic() > until:
                raise FnnEkfError(f"no publisher after {patience_s:g} s on {topic}")
            self._executor.spin_once(timeout_sec=0.02)
        return None
