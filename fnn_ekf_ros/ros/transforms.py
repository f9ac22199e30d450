# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The localizer's transform on /tf."""

from collections.abc import Iterable
from typing import Any

from fnn_ekf_ros import messages
from fnn_ekf_ros.errors import FnnEkfError
from fnn_ekf_ros.localizer.transforms import TransformOutputs
from fnn_ekf_ros.parameters.localizer import LocalizerParameters
from fnn_ekf_ros.ros.build import build_message, message_class
from fnn_ekf_ros.timeline.events import Estimate, Status

from rclpy.node import Node  # isort: skip
from rclpy.qos import QoSProfile  # isort: skip

TF_QOS = QoSProfile(depth=100)
"""As tf2_ros has it: reliable, 100 deep."""


class Transforms:
    """Publishes where the localizer is on /tf.

    Args:
        node: publishes and, with an `odom_frame`, listens to /tf.
        parameters: of the localizer.

    Raises:
        FnnEkfError: tf2_msgs is not installed.
    """

    def __init__(self, node: Node, parameters: LocalizerParameters) -> None:
        try:
            kind = message_class(messages.TF_TYPE)
        except ImportError as error:
            raise FnnEkfError(
                f"publish_tf needs tf2_msgs, which is not here ({error}): install "
                "ros-jazzy-tf2-msgs, or set publish_tf to false"
            ) from None
        self._outputs = TransformOutputs(parameters)
        self._publisher = node.create_publisher(kind, messages.TF, TF_QOS)
        if self._outputs.listens:
            node.create_subscription(kind, messages.TF, self._receive, TF_QOS)

    def located(self, estimate: Estimate) -> None:
        """Publish an estimate, or what waits for it no longer."""
        self._publish(self._outputs.located(estimate))

    def status(self) -> Status:
        """Return the status: whether somebody publishes where the base is in odom."""
        return self._outputs.status()

    def _receive(self, message: Any) -> None:
        self._publish(self._outputs.received(message))

    def _publish(self, made: Iterable[messages.Message]) -> None:
        for message in made:
            self._publisher.publish(build_message(message))
