# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The log of the localizer names publishers and subscribers whose QoS does not fit."""

from collections.abc import Callable
from typing import Any

import pytest
import rclpy
from nav_msgs.msg import Odometry
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import Imu

pytestmark = pytest.mark.live
ARGUMENTS = [
    "--ros-args", "-p", "wheel_radius:=0.025", "-p", "wheel_separation:=0.6",
    "-p", "encoder_counts_per_revolution:=500.0",
    "-p", "qos_overrides./compass.subscription.reliability:=reliable",
]  # fmt: skip


def test_a_warning_names_a_publisher_and_a_subscription_that_do_not_fit(
    processes: Any, ros_environment: None, patiently: Callable[..., None]
) -> None:
    localizer = processes.start("localizer", *ARGUMENTS)
    context = rclpy.Context()
    context.init()
    node = Node("other", context=context)
    try:
        node.create_publisher(
            Imu, "compass", QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
        )
        node.create_subscription(
            Odometry,
            "odom",
            print,
            QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL),
        )
        patiently(
            lambda: processes.output(localizer).count("incompatible QoS") >= 2, "both warnings"
        )
    finally:
        node.destroy_node()
        context.try_shutdown()
    text = processes.stop(localizer)
    assert "New publisher discovered on topic 'compass'" in text
    assert "New subscription discovered on topic 'odom'" in text
