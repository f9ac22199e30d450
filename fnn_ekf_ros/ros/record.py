# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Recording of live topics into a bag, as they come over the wire."""

from collections.abc import Mapping
from pathlib import Path
from typing import Self

from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile

from fnn_ekf_ros.recordings.bag_files import Record
from fnn_ekf_ros.recordings.bag_writer import BagWriter
from fnn_ekf_ros.ros.build import message_class

QUEUE_DEPTH = 1000
"""Depth of the queue of each topic [messages]."""


class Recorder:
    """Records topics of other nodes, with a context of its own; a context manager.

    Args:
        path: the bag to write.
        topics: type name by topic.
        use_sim_time: messages are recorded at the time of /clock, and not before its first;
            otherwise at the time of the wall clock.
    """

    def __init__(
        self, path: Path, topics: Mapping[str, str], *, use_sim_time: bool = False
    ) -> None:
        self.counts = dict.fromkeys(topics, 0)
        self._bag = BagWriter(path)
        self._context = Context()
        self._context.init()
        self._node = Node(
            "recorder",
            context=self._context,
            use_global_arguments=False,
            parameter_overrides=[Parameter("use_sim_time", value=use_sim_time)],
        )
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._subscriptions = [
            self._node.create_subscription(
                message_class(type_name),
                topic,
                lambda data, topic=topic, kind=type_name: self._take(topic, kind, data),
                QoSProfile(depth=QUEUE_DEPTH),
                raw=True,
            )
            for topic, type_name in topics.items()
        ]

    def spin_once(self, timeout_s: float) -> None:
        """Take in what has arrived, waiting for it up to a time [s]."""
        self._executor.spin_once(timeout_sec=timeout_s)

    def publisher_count(self, topic: str) -> int:
        """Return how many publishers of a topic are known."""
        return int(self._node.count_publishers(topic))

    def connected(self) -> bool:
        """Return whether every topic has a publisher whose messages arrive here."""
        return all(entry.get_publisher_count() > 0 for entry in self._subscriptions)

    def __enter__(self) -> Self:
        """Open the bag."""
        self._bag.__enter__()
        return self

    def __exit__(self, *problem: object) -> None:
        """Finish the bag and leave ROS."""
        self._executor.shutdown()
        self._node.destroy_node()
        self._context.try_shutdown()
        self._bag.__exit__(*problem)  # type: ignore[arg-type]

    def _take(self, topic: str, kind: str, data: bytes) -> None:
        now_ns = self._node.get_clock().now().nanoseconds
        if now_ns > 0:
            self._bag.write_raw(
                Record(topic=topic, type_name=kind, time_ns=now_ns, data=bytes(data))
            )
            self.counts[topic] += 1
