# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""A node with the localizer's subscriptions that does nothing but publish an Odometry a period.

It publishes where the localizer would: at the message of the right wheel that is the first one of a
new period.
"""

import functools
import signal
import threading
import time
from typing import Any

import rclpy
from geometry_msgs.msg import PoseWithCovarianceStamped
from nav_msgs.msg import Odometry
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import Imu
from std_msgs.msg import Int32

from bench.rates import PERIOD_NS

NAME = "bare"
"""Name of the node."""
INPUTS = {
    "compass": Imu,
    "lrf_pose": PoseWithCovarianceStamped,
    "initialpose": PoseWithCovarianceStamped,
    "left_ticks": Int32,
    "right_ticks": Int32,
}
"""Types of the messages that it takes, by topic: those of the localizer."""
CLOSES = "right_ticks"
"""Topic whose messages close a period, as in the localizer."""


class BareNode(Node):  # type: ignore[misc]
    """Takes every message and looks at the time of one topic's."""

    def __init__(self) -> None:
        super().__init__(NAME)
        self._period = time.time_ns() // PERIOD_NS
        self._odom = self.create_publisher(Odometry, "odom", QoSProfile(depth=10))
        qos = QoSProfile(depth=1000, reliability=ReliabilityPolicy.BEST_EFFORT)
        for topic, kind in INPUTS.items():
            self.create_subscription(kind, topic, functools.partial(self._take, topic), qos)

    def _take(self, topic: str, _: Any) -> None:
        if topic != CLOSES:
            return
        period = time.time_ns() // PERIOD_NS
        if period != self._period:
            self._period = period
            message = Odometry()
            message.header.stamp.sec, message.header.stamp.nanosec = divmod(
                period * PERIOD_NS, 10**9
            )
            message.header.frame_id, message.child_frame_id = "map", "base_link"
            self._odom.publish(message)


def main() -> None:
    """Run the node until SIGINT."""
    stopped = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stopped.set())
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    node = BareNode()
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    while not stopped.is_set():
        executor.spin_once(timeout_sec=0.2)
    executor.shutdown()
    node.destroy_node()
    rclpy.try_shutdown()


if __name__ == "__main__":
    main()
