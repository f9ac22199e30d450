# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Reading of rosbag2 recordings."""

import os
import stat
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from shlex import quote
from typing import Any, NamedTuple, Self

from fnn_ekf_ros.errors import FnnEkfError
from fnn_ekf_ros.recordings.rosbags_api import (
    LARGEST_CHUNK,
    RELIABLE,
    TYPESTORE,
    Connection,
    Qos,
    QosDurability,
    QosReliability,
    Reader,
    TooLargeError,
)

_MCAP_MAGIC = b"\x89MCAP0\r\n"
"""The first and the last bytes of a complete mcap file."""
_ROS_1_MAGIC = b"#ROSBAG V"
"""The first bytes of a recording of ROS 1."""
STORAGE_SUFFIXES = (".mcap", ".db3")
"""Endings of a file that is a recording."""
_EXPECTED = (
    f"expected the folder of a rosbag2 recording, or its {' or '.join(STORAGE_SUFFIXES)} file"
)
"""What is expected in place of something else."""
LAST_STAMP_S = 2**31 - 1
"""Last second that a stamp of ROS can have, in 2038: builtin_interfaces/Time has an int32 [s]."""
_LARGEST_OPEN = 2 * LARGEST_CHUNK
"""Largest size of all chunks that are unpacked at the same time [bytes]: a chunk stays in memory
from its first message to its last, and those of a recorder overlap by one or two."""
_MOST_NAMED = 5
"""Largest number of files that an error names."""


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


def check_bags(paths: Iterable[Path]) -> None:
    """Check that recordings are there, before anything else is asked for.

    Raises:
        BagError: one is not there, no recording of ROS 2, not finished, or holds what is no file.
    """
    for path in paths:
        try:
            _check_bag(path)
        except (OSError, ValueError) as error:
            raise BagError(f"bag '{str(path)[:80]}' cannot be read: {reason(error)}") from None


def _check_bag(path: Path) -> None:
    if not path.exists():
        raise BagError(f"bag '{path}' does not exist: expected a rosbag2 recording")
    if path.is_file():
        _refuse_ros_1(path)
        if path.suffix not in STORAGE_SUFFIXES:
            raise BagError(f"bag '{path}' is no recording: {_EXPECTED}")
        return
    if not path.is_dir():
        raise BagError(f"bag '{path}' is no file: expected a rosbag2 recording")
    entries = sorted(path.iterdir())
    for entry in entries:  # what waits for a writer, or never ends
        if entry.exists() and not (entry.is_file() or entry.is_dir()):
            kind = stat.filemode(entry.stat().st_mode)
            raise BagError(
                f"bag '{path}': '{entry.name}' ({kind}) is no file: expected a recording"
            )
    if not (path / "metadata.yaml").exists():
        raise BagError(f"bag '{path}' has no metadata.yaml: {_what_is_instead(path, entries)}")


def _what_is_instead(path: Path, entries: list[Path]) -> str:
    """Return what to do with a folder that is no finished recording, by what is in it."""
    for entry in entries:
        if entry.is_file() and entry.suffix == ".bag":
            _refuse_ros_1(entry)
    stored = [entry for entry in entries if entry.suffix in STORAGE_SUFFIXES]
    if stored:
        return (
            f"its writer was ended too early; `ros2 bag reindex {quote(str(path))}` makes one, or "
            f"give {_listed(stored)}"
        )
    inner = [entry for entry in entries if (entry / "metadata.yaml").is_file()]
    if inner:
        return f"it is no recording, but holds {_listed(inner)}"
    return _EXPECTED


def _listed(paths: list[Path]) -> str:
    more = len(paths) - _MOST_NAMED
    named = ", ".join(f"'{path}'" for path in paths[:_MOST_NAMED])
    return f"{named} and {more} more" if more > 0 else named


def _refuse_ros_1(path: Path) -> None:
    with path.open("rb") as file:
        if file.read(len(_ROS_1_MAGIC)) == _ROS_1_MAGIC:
            out = path.with_suffix("") if path.suffix == ".bag" else Path("OUT")
            raise BagError(
                f"bag '{path}' is a recording of ROS 1: `rosbags-convert --src {quote(str(path))} "
                f"--dst {quote(str(out))}` makes one of ROS 2, in a new folder"
            )


def _breaks_off(path: Path) -> bool:
    """Return whether a path is an mcap file that begins well and has no end."""
    with suppress(OSError), path.open("rb") as file:
        begin = file.read(len(_MCAP_MAGIC))
        file.seek(-min(len(_MCAP_MAGIC), path.stat().st_size), os.SEEK_END)
        return begin == _MCAP_MAGIC and file.read() != _MCAP_MAGIC
    return False


def _files_of(path: Path) -> list[Path]:
    """Return the files of a recording that may break off."""
    return sorted(path.glob("*.mcap")) if path.is_dir() else [path]


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
        check_bags([path])
        try:
            self._reader = Reader(path)
            self._reader.open()
            self._check_chunks()
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

    def check_stamps(self) -> None:
        """Check that ROS can stamp messages at all times of the recording.

        Raises:
            BagError: it goes on after 2038, or begins before 1902.
        """
        for time_s in (self.start_ns * 1e-9, self.start_ns * 1e-9 + self.duration_s):
            if self.message_count and abs(time_s) > LAST_STAMP_S:
                raise BagError(
                    f"bag '{self.path}' has messages of {time_s:.0f} s: stamps of ROS end in 2038, "
                    f"at {LAST_STAMP_S} s; was the clock set when it was recorded?"
                )

    def _check_chunks(self) -> None:
        """Check by the index how much of the recording would be in memory at the same time.

        Raises:
            TooLargeError: it is too much.
        """
        storage = self._reader.storage
        for each in getattr(storage, "storages", [storage]):
            sizes: dict[int, int] = {}  # by which the size changes, in order of time
            for chunk in getattr(each, "chunks", []):
                begin, end = chunk.message_start_time, chunk.message_end_time + 1
                sizes[begin] = sizes.get(begin, 0) + chunk.uncompressed_size
                sizes[end] = sizes.get(end, 0) - chunk.uncompressed_size
            unpacked = 0
            for time_ns in sorted(sizes):
                unpacked += sizes[time_ns]
                if unpacked > _LARGEST_OPEN:
                    raise TooLargeError(
                        f"chunks of the same time have more than {_LARGEST_OPEN} bytes"
                    )

    def _broken(self, error: Exception) -> BagError:
        if isinstance(error, TooLargeError):
            return BagError(
                f"bag '{self.path}' cannot be unpacked: {error}; it is damaged or made to "
                "fill the memory, or `mcap filter --chunk-size 4194304` writes smaller chunks"
            )
        for path in _files_of(self.path):
            if _breaks_off(path):
                return BagError(
                    f"bag '{self.path}' cannot be read: '{path}' breaks off after "
                    f"{path.stat().st_size / 1e6:.3g} MB, its writer was ended too early; "
                    f"`mcap recover {quote(str(path))} -o recovered.mcap` writes what is complete "
                    "into a file that can be given instead"
                )
        return BagError(
            f"bag '{self.path}' cannot be read ({reason(error)}): expected a complete rosbag2 "
            "recording in mcap or sqlite3"
        )


def reason(error: Exception) -> str:
    """Return the text of a storage's error, in one line."""
    text = " ".join(str(error).split())
    return text.rstrip(".") if text else type(error).__name__
