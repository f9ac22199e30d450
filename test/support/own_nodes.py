# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Nodes of live tests, each with a context of its own."""

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node


class OwnNode:
    """A node that a test spins itself.

    Attributes:
        node: for publishers, subscriptions and clients.
    """

    def __init__(self, name: str) -> None:
        self._context = rclpy.Context()
        self._context.init()
        self.node = Node(name, context=self._context)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)

    def spin(self, timeout_s: float = 0.05) -> None:
        """Do one piece of work, or wait for it so long [s]."""
        self._executor.spin_once(timeout_sec=timeout_s)

    def close(self) -> None:
        """End node and context."""
        self._executor.shutdown()
        self.node.destroy_node()
        self._context.try_shutdown()
