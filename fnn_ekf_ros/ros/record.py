"""Recording of live topics into a bag, as they come over the wire."""

import time
from collections.abc import Mapping
from pathlib import Path
from typing import Self

from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile

from fnn_ekf_ros.bag_files import BagWriter, Record
from fnn_ekf_ros.ros.build import message_class

QUEUE_DEPTH = 1000


class Recorder:
    """Records topics of other nodes, with a context of its own; a context manager.

    The time of recording is the recorder's wall clock.

    Args:
        path: the bag to write.
        topics: type name by topic.
    """

    def __init__(self, path: Path, topics: Mapping[str, str]) -> None:
        self.counts = dict.fromkeys(topics, 0)
        self._bag = BagWriter(path)
        self._context = Context()
        self._context.init()
        self._node = Node("recorder", context=self._context, use_global_arguments=False)
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
        self._bag.write_raw(Record(topic, kind, time.time_ns(), bytes(data)))
        self.counts[topic] += 1
