# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Other nodes that publish a node's topic: listeners get both, and cannot tell them apart."""

from fnn_ekf_ros.diagnostics.messages import OdomMessage
from fnn_ekf_ros.ros.runtime import LOG_INTERVAL_S
from fnn_ekf_ros.timeline.events import Level, Status

from rclpy.clock import Clock, ClockType  # isort: skip
from rclpy.node import Node  # isort: skip

LOOK_INTERVAL_S = 2.0
"""Interval at which other publishers are looked for [s]: it costs about a millisecond."""


class OtherPublishers:
    """Watches for other publishers of a topic of a node; ROS itself refuses no second name.

    Args:
        node: publishes the topic once; its log gets the warnings.
        topic: absolute name.
    """

    def __init__(self, node: Node, topic: str) -> None:
        self._node, self._topic = node, topic
        self._others: list[str] = []
        self._seen = False
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        node.create_timer(LOOK_INTERVAL_S, self._look, clock=steady)

    def statuses(self) -> list[Status]:
        """Return the status of the topic; none while no other publisher has been seen."""
        if not self._seen:
            return []
        if not self._others:
            return [Status(name="odom", level=Level.OK, message=OdomMessage.ALONE, values=())]
        values = (("other publishers", ", ".join(self._others)),)
        return [Status(name="odom", level=Level.WARN, message=OdomMessage.SHARED, values=values)]

    def _look(self) -> None:
        own = self._node.get_fully_qualified_name()
        infos = self._node.get_publishers_info_by_topic(self._topic)
        names = [f"{info.node_namespace.rstrip('/')}/{info.node_name}" for info in infos]
        if own in names:
            names.remove(own)
        self._others = sorted(
            {f"{name} (of the same name)" if name == own else name for name in names}
        )
        if self._others:
            self._seen = True
            self._node.get_logger().warning(
                f"{self._topic} is also published by {', '.join(self._others)}: "
                "end one of the two, or give it another name and another topic",
                throttle_duration_sec=LOG_INTERVAL_S,
            )
