# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The pose as a transform on /tf: to the base, or to the frame of somebody else's odometry."""

from typing import Any

from fnn_ekf_ros import messages
from fnn_ekf_ros.diagnostics.messages import TransformMessage
from fnn_ekf_ros.errors import FnnEkfError
from fnn_ekf_ros.parameters.localizer import NO_FRAME, LocalizerParameters
from fnn_ekf_ros.ros.build import build_message, message_class
from fnn_ekf_ros.timeline.events import Estimate, Level, Status
from fnn_ekf_ros.timeline.frames import MapToOdom, Transform

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
        self._parameters = parameters
        self._publisher = node.create_publisher(kind, messages.TF, TF_QOS)
        self._map_to_odom: MapToOdom | None = None
        if parameters.odom_frame != NO_FRAME:
            self._map_to_odom = MapToOdom()
            node.create_subscription(kind, messages.TF, self._receive, TF_QOS)

    def located(self, estimate: Estimate) -> None:
        """Publish an estimate, or what waits for it no longer."""
        pose = Transform(estimate.stamp_ns, estimate.state.mean)
        if self._map_to_odom is None:
            self._publish(pose, self._parameters.base_frame)
        else:
            self._publish_ahead(self._map_to_odom.located(pose))

    def status(self) -> Status:
        """Return the status: whether somebody publishes where the base is in odom."""
        p = self._parameters
        if self._map_to_odom is None:
            published = (("published", f"{p.frame_id} to {p.base_frame}"),)
            return Status(
                name="tf", level=Level.OK, message=TransformMessage.PUBLISHED, values=published
            )
        values = (("published", f"{p.frame_id} to {p.odom_frame}"),)
        missing_s = self._map_to_odom.missing_ns * 1e-9
        if missing_s > 0.0:
            missing = (
                ("missing", f"{p.odom_frame} to {p.base_frame}"),
                ("missing for [s]", f"{missing_s:.1f}"),
            )
            return Status(
                name="tf",
                level=Level.WARN,
                message=TransformMessage.MISSING,
                values=(*values, *missing),
            )
        return Status(name="tf", level=Level.OK, message=TransformMessage.PUBLISHED, values=values)

    def _receive(self, message: Any) -> None:
        assert self._map_to_odom is not None
        p = self._parameters
        for transform in messages.read_transforms(message, p.odom_frame, p.base_frame):
            self._publish_ahead(self._map_to_odom.moved(transform))

    def _publish_ahead(self, found: list[Transform]) -> None:
        ahead_ns = round(self._parameters.transform_tolerance * 1e9)
        for transform in found:
            stamp_ns = transform.stamp_ns + ahead_ns
            self._publish(transform._replace(stamp_ns=stamp_ns), self._parameters.odom_frame)

    def _publish(self, transform: Transform, child: str) -> None:
        message = messages.transform_message(
            transform.stamp_ns, self._parameters.frame_id, child, transform.pose
        )
        self._publisher.publish(build_message(message))
