# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The pose as messages of /tf: to the base, or to the frame of somebody else's odometry."""

from typing import Any

from fnn_ekf_ros.diagnostics.messages import TransformMessage
from fnn_ekf_ros.messages.reading import read_transforms
from fnn_ekf_ros.messages.writing import Message, transform_message
from fnn_ekf_ros.parameters.localizer import NO_FRAME, LocalizerParameters
from fnn_ekf_ros.timeline.events import Estimate, Level, Status
from fnn_ekf_ros.timeline.frames import MapToOdom, Transform


class TransformOutputs:
    """Makes the messages that say where the localizer is.

    Args:
        parameters: of the localizer.
    """

    def __init__(self, parameters: LocalizerParameters) -> None:
        self._parameters = parameters
        self._map_to_odom = None if parameters.odom_frame == NO_FRAME else MapToOdom()

    @property
    def listens(self) -> bool:
        """Whether it needs the transforms of somebody else's odometry."""
        return self._map_to_odom is not None

    @property
    def child(self) -> str:
        """The child frame of the transform."""
        return self._parameters.odom_frame if self.listens else self._parameters.base_frame

    def located(self, estimate: Estimate) -> list[Message]:
        """Take in an estimate; return the tf2_msgs/TFMessage of it, or of what it completes."""
        pose = Transform(estimate.stamp_ns, estimate.state.mean)
        if self._map_to_odom is None:
            return [self._message(pose)]
        return self._ahead(self._map_to_odom.located(pose))

    def received(self, message: Any) -> list[Message]:
        """Take in a tf2_msgs/TFMessage of any node; return those that it completes."""
        if self._map_to_odom is None:
            return []
        p = self._parameters
        return [
            made
            for transform in read_transforms(message, p.odom_frame, p.base_frame)
            for made in self._ahead(self._map_to_odom.moved(transform))
        ]

    def status(self) -> Status:
        """Return the status: whether somebody publishes where the base is in odom."""
        p = self._parameters
        values = (("published", f"{p.frame_id} to {self.child}"),)
        missing_s = 0.0 if self._map_to_odom is None else self._map_to_odom.missing_ns * 1e-9
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

    def _ahead(self, found: list[Transform]) -> list[Message]:
        ahead_ns = round(self._parameters.transform_tolerance * 1e9)
        return [self._message(each._replace(stamp_ns=each.stamp_ns + ahead_ns)) for each in found]

    def _message(self, transform: Transform) -> Message:
        return transform_message(
            transform.stamp_ns, self._parameters.frame_id, self.child, transform.pose
        )
