"""Reading and writing of rosbag2 recordings; the only module that knows rosbags."""

import shutil
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple, Self

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

from fnn_ekf_ros.errors import FnnEkfError
from fnn_ekf_ros.messages import Message

STORAGES = ("mcap", "sqlite3")
_TYPESTORE = get_typestore(Stores.ROS2_JAZZY)
_ANY_TIME = QosTime(0, 0)
_RELIABLE = Qos(
    QosHistory.KEEP_LAST, 10, QosReliability.RELIABLE, QosDurability.VOLATILE,
    _ANY_TIME, _ANY_TIME, QosLiveliness.AUTOMATIC, _ANY_TIME, False,
)  # fmt: skip


class BagError(FnnEkfError):
    """A recording that cannot be read or written."""


class Topic(NamedTuple):
    """A topic of a recording.

    Attributes:
        name: absolute, such as `/odom`.
        type_name: such as `nav_msgs/msg/Odometry`.
        message_count: number of messages.
        qos: profiles its publishers offered.
    """

    name: str
    type_name: str
    message_count: int
    qos: tuple[Qos, ...] = (_RELIABLE,)

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


class BagReader:
    """A recording that is open for reading; a context manager.

    Args:
        path: the bag's folder, or a single `.mcap` or `.db3` file.

    Raises:
        BagError: it does not exist, is truncated or is no bag.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        if not path.exists():
            raise BagError(f"bag '{path}' does not exist")
        if path.is_dir() and not (path / "metadata.yaml").exists():
            raise BagError(
                f"bag '{path}' has no metadata.yaml: expected the folder of a finished rosbag2 "
                "recording (of an unfinished one, give the .mcap or .db3 file or reindex it)"
            )
        try:
            self._reader = Reader(path)
            self._reader.open()
        except Exception as error:  # rosbags and its storages raise errors of many kinds
            raise self._broken(error) from None
        self.topics: Mapping[str, Topic] = {}
        for connection in self._reader.connections:
            before = self.topics.get(connection.topic)
            qos = tuple(getattr(connection.ext, "offered_qos_profiles", ()))
            if before is not None and before.type_name != connection.msgtype:
                raise BagError(
                    f"bag '{path}': topic {connection.topic} has two types, "
                    f"{before.type_name} and {connection.msgtype}"
                )
            self.topics[connection.topic] = Topic(  # type: ignore[index]
                connection.topic,
                connection.msgtype,
                connection.msgcount + (before.message_count if before else 0),
                qos + (before.qos if before else ()),
            )

    @property
    def message_count(self) -> int:
        """Number of messages."""
        return int(self._reader.message_count)

    @property
    def start_ns(self) -> int:
        """Time of the first message [ns]."""
        return int(self._reader.start_time)

    @property
    def duration_s(self) -> float:
        """Time between the first message and the last [s]."""
        return float(self._reader.duration) * 1e-9

    def records(self, topics: set[str] | None = None) -> Iterator[Record]:
        """Yield the messages in the order of recording, of all topics or of some.

        Raises:
            BagError: the recording breaks off or a chunk of it is damaged.
        """
        connections = [c for c in self._reader.connections if topics is None or c.topic in topics]
        if not connections:
            return
        source = self._reader.messages(connections)
        while True:
            try:
                connection, time_ns, data = next(source)
            except StopIteration:
                return
            except Exception as error:  # see above
                raise self._broken(error) from None
            yield Record(connection.topic, connection.msgtype, time_ns, data)

    def message(self, record: Record) -> Any:
        """Return a record's message, its fields as attributes.

        Raises:
            BagError: the message is damaged or of a type that ROS 2 Jazzy does not have.
        """
        try:
            return _TYPESTORE.deserialize_cdr(record.data, record.type_name)
        except Exception as error:  # see above
            raise BagError(
                f"bag '{self.path}': a message on {record.topic} at {record.time_ns} ns cannot "
                f"be read as {record.type_name} ({_reason(error)})"
            ) from None

    def __enter__(self) -> Self:
        """Return the reader."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close the recording."""
        with suppress(Exception):
            self._reader.close()

    def _broken(self, error: Exception) -> BagError:
        return BagError(
            f"bag '{self.path}' cannot be read ({_reason(error)}): expected a complete rosbag2 "
            "recording in mcap or sqlite3"
        )


class BagWriter:
    """A recording that appears under its name only once it is complete; a context manager.

    Args:
        path: the bag's folder; must not exist.
        storage: one of `STORAGES`.
        notes: texts to keep in the bag's metadata, such as the command that made it.

    Raises:
        BagError: the path exists or cannot be written to.
    """

    def __init__(self, path: Path, storage: str = "mcap", notes: Mapping[str, str] = {}) -> None:
        self.path = path
        refuse_existing(path)
        try:
            self._folder = Path(tempfile.mkdtemp(prefix=f".{path.name}.", dir=path.parent))
        except OSError as error:
            raise BagError(f"bag '{path}' cannot be written: {error.strerror}") from None
        plugin = StoragePlugin.MCAP if storage == "mcap" else StoragePlugin.SQLITE3
        self._writer = Writer(self._folder / path.name, version=9, storage_plugin=plugin)
        if storage == "mcap":
            self._writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
        for key, text in notes.items():
            self._writer.set_custom_data(key, text)
        self._writer.open()
        self._connections: dict[str, Connection] = {}

    def add_topic(self, topic: Topic) -> None:
        """Announce a topic; `write` does so by itself for topics of ROS 2 Jazzy's types."""
        if topic.name not in self._connections:
            self._connections[topic.name] = self._writer.add_connection(
                topic.name,
                topic.type_name,
                typestore=_TYPESTORE,
                offered_qos_profiles=topic.qos or (_RELIABLE,),
            )

    def write(self, topic: str, message: Message, time_ns: int) -> None:
        """Write a message; `topic` is absolute, `time_ns` the time of recording [ns]."""
        data = _TYPESTORE.serialize_cdr(_built(message), message.type_name)
        self.write_raw(Record(topic, message.type_name, time_ns, bytes(data)))

    def write_raw(self, record: Record) -> None:
        """Write a record as it is."""
        if record.topic not in self._connections:
            self.add_topic(Topic(record.topic, record.type_name, 0))
        self._writer.write(self._connections[record.topic], record.time_ns, record.data)

    def __enter__(self) -> Self:
        """Return the writer."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Put the bag in its place, or leave nothing if something went wrong."""
        try:
            if error is None:
                self._writer.close()
                refuse_existing(self.path)
                (self._folder / self.path.name).rename(self.path)
            else:
                with suppress(Exception):
                    self._writer.abort()
        except OSError as failure:
            raise BagError(f"bag '{self.path}' cannot be written: {failure}") from None
        finally:
            shutil.rmtree(self._folder, ignore_errors=True)


def refuse_existing(path: Path) -> None:
    """Raise a `BagError` if something has the path's name, or its folder does not exist."""
    if path.exists():
        raise BagError(f"'{path}' exists already: choose another name, or remove it first")
    if not path.absolute().parent.is_dir():
        raise BagError(f"'{path}' cannot be written: folder '{path.parent}' does not exist")


def _built(message: Message) -> Any:
    """Return the rosbags message of a tree."""

    def value(field: Any) -> Any:
        if isinstance(field, Message):
            return _built(field)
        if isinstance(field, list):
            return [value(entry) for entry in field]
        return field

    kind = _TYPESTORE.types[message.type_name]
    return kind(**{name: value(field) for name, field in message.fields.items()})


def _reason(error: Exception) -> str:
    text = " ".join(str(error).split())
    return text.rstrip(".") if text else type(error).__name__
