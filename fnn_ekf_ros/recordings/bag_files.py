# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Reading of rosbag2 recordings."""

import os
from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple, Self

from fnn_ekf_ros.errors import FnnEkfError
from fnn_ekf_ros.recordings.rosbags_api import (
    RELIABLE,
    TYPESTORE,
    Connection,
    Qos,
    QosDurability,
    QosReliability,
    Reader,
)

_MCAP_MAGIC = b"\x89MCAP0\r\n"
"""The first and the last bytes of a complete mcap file."""


class BagError(FnnEkfError):
    """A recording that cannot be read or written."""


class Topic(NamedTuple):
    """A topic of a recording.

    Attributes:
        name: absolute, such as `/odom`.
        type_name: such as `nav_msgs/msg/Odometry`.
        message_count: number of messages.
        qos: profiles its publishers offered.
        definition: the type's definition as it was recorded; empty if it was not.
        digest: the type's hash as it was recorded; empty if it was not.
    """

    name: str
    type_name: str
    message_count: int
    qos: tuple[Qos, ...] = (RELIABLE,)
    definition: str = ""
    digest: str = ""

    @property
    def reliable(self) -> bool:
        """Whether no publisher offered less than reliable delivery."""
        return all(q.reliability is not QosReliability.BEST_EFFORT for q in self.qos)

    @property
    def transient_local(self) -> bool:
        """Whether its publishers kept messages for late joiners."""
        return any(q.durability is QosDurability.TRANSIENT_LOCAL for q in self.qos)


class Record(NamedTuple):
    """A recorded message.

    Attributes:
        topic: the topic's name.
        type_name: the message's type.
        time_ns: when it was recorded [ns].
        data: the message in CDR.
    """

    topic: str
    type_name: str
    time_ns: int
    data: bytes


def _topic_of(connection: Connection) -> Topic:
    return Topic(
        name=connection.topic,
        type_name=connection.msgtype,
        message_count=int(connection.msgcount),
        qos=tuple(getattr(connection.ext, "offered_qos_profiles", ())),
        definition=connection.msgdef.data,
        digest=connection.digest,
    )


def _check_readable(path: Path) -> None:
    try:
        if not path.exists():
            raise BagError(f"bag '{path}' does not exist: expected a rosbag2 recording")
        if not path.is_dir() and not path.is_file():
            raise BagError(f"bag '{path}' is no file: expected a rosbag2 recording")
        finished = not path.is_dir() or (path / "metadata.yaml").exists()
    except (OSError, ValueError) as error:
        raise BagError(f"bag '{str(path)[:80]}' cannot be read: {reason(error)}") from None
    if not finished:
        raise BagError(
            f"bag '{path}' has no metadata.yaml: expected the folder of a finished rosbag2 "
            "recording (of an unfinished one, give the .db3 file, or use `ros2 bag reindex`)"
        )


def _breaks_off(path: Path) -> bool:
    """Return whether a path is an mcap file that begins well and has no end."""
    with suppress(OSError), path.open("rb") as file:
        begin = file.read(len(_MCAP_MAGIC))
        file.seek(-min(len(_MCAP_MAGIC), path.stat().st_size), os.SEEK_END)
        return begin == _MCAP_MAGIC and file.read() != _MCAP_MAGIC
    return False


class BagReader:
    """A recording that is open for reading; a context manager.

    Args:
        path: the bag's folder, or a single `.mcap` or `.db3` file.

    Attributes:
        topics: topics by name.
        message_count: number of messages.
        start_ns: time of the first message [ns].
        duration_s: time between the first message and the last [s].
        notes: texts in the bag's metadata by key, such as the parameters that made it.

    Raises:
        BagError: it does not exist, is truncated or is no bag.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        _check_readable(path)
        try:
            self._reader = Reader(path)
            self._reader.open()
            self.message_count = int(self._reader.message_count)
            self.start_ns = int(self._reader.start_time)
            self.duration_s = float(self._reader.duration) * 1e-9
            found = [_topic_of(connection) for connection in self._reader.connections]
            custom = getattr(self._reader.storage.metadata, "custom", None) or {}
            self.notes: Mapping[str, str] = {str(key): str(text) for key, text in custom.items()}
        except Exception as error:  # rosbags and its storages raise errors of many kinds
            self.close()
            raise self._broken(error) from None
        topics: dict[str, Topic] = {}
        for topic in found:
            before = topics.get(topic.name, topic._replace(message_count=0, qos=()))
            if before.type_name != topic.type_name:
                self.close()
                raise BagError(
                    f"bag '{path}': topic {topic.name} has two types, {before.type_name} and "
                    f"{topic.type_name}"
                )
            topics[topic.name] = topic._replace(
                message_count=topic.message_count + before.message_count,
                qos=topic.qos + before.qos,
            )
        self.topics: Mapping[str, Topic] = topics

    def close(self) -> None:
        """Close the recording."""
        with suppress(Exception):
            self._reader.close()

    def records(self, topics: set[str] | None = None) -> Iterator[Record]:
        """Yield the messages in the order of recording, of all topics or of some.

        Raises:
            BagError: the recording breaks off or a chunk of it is damaged.
        """
        connections = [c for c in self._reader.connections if topics is None or c.topic in topics]
        if not connections:
            return
        try:  # errors of the caller's loop are not raised in here
            for connection, time_ns, data in self._reader.messages(connections):
                yield Record(
                    topic=connection.topic, type_name=connection.msgtype, time_ns=time_ns, data=data
                )
        except Exception as error:  # see above
            raise self._broken(error) from None

    def message(self, record: Record) -> Any:
        """Return a record's message, its fields as attributes.

        Raises:
            BagError: the message is damaged or of a type that ROS 2 Jazzy does not have.
        """
        try:
            return TYPESTORE.deserialize_cdr(record.data, record.type_name)
        except Exception as error:  # see above
            raise BagError(
                f"bag '{self.path}': a message on {record.topic} at {record.time_ns} ns cannot "
                f"be read as {record.type_name} ({reason(error)})"
            ) from None

    def __enter__(self) -> Self:
        """Return the reader."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close the recording."""
        self.close()

    def _broken(self, error: Exception) -> BagError:
        if _breaks_off(self.path):
            return BagError(
                f"bag '{self.path}' cannot be read: it breaks off after "
                f"{self.path.stat().st_size / 1e6:.1f} MB, its writer was ended too early; "
                "`mcap recover` writes what is complete into a new file"
            )
        return BagError(
            f"bag '{self.path}' cannot be read ({reason(error)}): expected a complete rosbag2 "
            "recording in mcap or sqlite3"
        )


def reason(error: Exception) -> str:
    """Return the text of a storage's error, in one line."""
    text = " ".join(str(error).split())
    return text.rstrip(".") if text else type(error).__name__
