# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Names of rosbags that the package uses; the only module that imports it."""

from fnn_ekf_ros.errors import FnnEkfError

try:
    from rosbags.interfaces import (
        Connection,
        Qos,
        QosDurability,
        QosHistory,
        QosLiveliness,
        QosReliability,
        QosTime,
    )
    from rosbags.rosbag2 import CompressionFormat, CompressionMode, Reader, StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore
except ImportError as error:
    raise FnnEkfError(
        f"recordings need rosbags, which is not installed ({error}): "
        "pip install 'rosbags>=0.11.9,<0.12'"
    ) from None

__all__ = [
    "RELIABLE", "TYPESTORE", "CompressionFormat", "CompressionMode", "Connection", "Qos",
    "QosDurability", "QosReliability", "Reader", "StoragePlugin", "Writer",
]  # fmt: skip

TYPESTORE = get_typestore(Stores.ROS2_JAZZY)
"""The message types of ROS 2 Jazzy."""
_ANY_TIME = QosTime(0, 0)
"""The duration 0, which stands for no limit."""
RELIABLE = Qos(
    QosHistory.KEEP_LAST, 10, QosReliability.RELIABLE, QosDurability.VOLATILE,
    _ANY_TIME, _ANY_TIME, QosLiveliness.AUTOMATIC, _ANY_TIME, False,
)  # fmt: skip
"""The profile of topics whose own is not known: ROS's default."""
