# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Names of rosbags that the package uses; the only module that imports it.

What rosbags unpacks is bounded here: a chunk of 200 kB can hold 6 GB of zeros.
"""

import os
from types import SimpleNamespace
from typing import Any, BinaryIO, Self

from fnn_ekf_ros.errors import FnnEkfError

try:
    import lz4.frame as lz4  # type: ignore[import-untyped]
    import rosbags.rosbag2.reader as reader_of_folders
    import rosbags.rosbag2.storage_mcap as mcap
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
    "LARGEST_CHUNK", "RELIABLE", "TYPESTORE", "CompressionFormat", "CompressionMode", "Connection",
    "Qos", "QosDurability", "QosReliability", "Reader", "StoragePlugin", "TooLargeError", "Writer",
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
LARGEST_CHUNK = 2**28
"""Largest size to which a chunk or a message is unpacked [bytes]: recorders write chunks of some
MB, and the largest messages, point clouds and maps, have some ten MB."""


_LARGEST_RATIO = 1000
"""Largest ratio to which a compressed file is unpacked on the disk, if it is more than a chunk:
messages of robots are compressed to a half or a tenth."""


class TooLargeError(Exception):
    """What would be unpacked to more than a recording has; the text says what."""


def _unpacked(decompressor: Any, data: bytes, limit: int) -> bytes:
    """Return what a compressed text holds, frame by frame; more than the limit is not unpacked.

    Args:
        decompressor: makes a decompressor of one frame.
        data: the frames.
        limit: largest size of the result [bytes].

    Raises:
        TooLargeError: it is larger.
        EOFError: the last frame is incomplete.
    """
    parts: list[bytes] = []
    limit = min(limit, LARGEST_CHUNK)
    room = limit
    while data:
        frame = decompressor()
        parts.append(frame.decompress(data, max_length=room + 1))
        room -= len(parts[-1])
        if room < 0:
            raise TooLargeError(f"a chunk or a message has more than {limit} bytes")
        if not frame.eof:
            raise EOFError("a compressed chunk or message breaks off")
        data = frame.unused_data or b""
    return b"".join(parts)


class _BoundedFile:
    """A compressed file that is read block by block, up to a size.

    Args:
        file: the compressed file.
    """

    def __init__(self, file: BinaryIO, _mode: str) -> None:
        self._file = mcap.zstd.open(file, "rb")  # type: ignore[attr-defined]
        self._largest = max(LARGEST_CHUNK, _LARGEST_RATIO * os.fstat(file.fileno()).st_size)
        self._room = self._largest

    def read(self, size: int) -> bytes:
        """Return the next block.

        Raises:
            TooLargeError: it is beyond the size.
        """
        block = bytes(self._file.read(size))
        self._room -= len(block)
        if self._room < 0:
            raise TooLargeError(f"a compressed file has more than {self._largest} bytes")
        return block

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()


def _bound_what_is_unpacked() -> None:
    """Put bounded functions in the place of those with which rosbags unpacks.

    rosbags has no option for it. It passes a chunk's decompressor the size that the recording says.
    """
    zstd = mcap.zstd  # type: ignore[attr-defined]
    mcap.DECOMPRESSORS.update(
        zstd=lambda data, size: _unpacked(zstd.ZstdDecompressor, data, size),
        lz4=lambda data, size: _unpacked(lz4.LZ4FrameDecompressor, data, size),
    )
    reader_of_folders.zstd = SimpleNamespace(  # type: ignore[assignment,attr-defined]
        open=_BoundedFile,
        decompress=lambda data: _unpacked(zstd.ZstdDecompressor, data, LARGEST_CHUNK),
    )


_bound_what_is_unpacked()
