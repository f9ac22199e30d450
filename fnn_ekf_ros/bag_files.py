"""Reading and writing of rosbag2 recordings; the only module that knows rosbags."""

import os
import shutil
from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple, Self

from fnn_ekf_ros.errors import FnnEkfError
from fnn_ekf_ros.messages import Message
from fnn_ekf_ros.work_folders import WorkFolder

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
        f"recordings need rosbags, which is not here ({error}): pip install 'rosbags>=0.11.9,<0.12'"
    ) from None

_MCAP_MAGIC = b"\x89MCAP0\r\n"
"""Every mcap file begins and ends with it."""
STORAGES = ("mcap", "sqlite3")
_TYPESTORE = get_typestore(Stores.ROS2_JAZZY)
_ANY_TIME = QosTime(0, 0)
_RELIABLE = Qos(
    QosHistory.KEEP_LAST, 10, QosReliability.RELIABLE, QosDurability.VOLATILE,
    _ANY_TIME, _ANY_TIME, QosLiveliness.AUTOMATIC, _ANY_TIME, False,
)  # fmt: skip


_NESTED = (Message, list)
"""What of a tree's fields has to be built."""


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
    qos: tuple[Qos, ...] = (_RELIABLE,)
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
        connection.topic,
        connection.msgtype,
        int(connection.msgcount),
        tuple(getattr(connection.ext, "offered_qos_profiles", ())),
        connection.msgdef.data,
        connection.digest,
    )


def _check_readable(path: Path) -> None:
    try:
        if not path.exists():
            raise BagError(f"bag '{path}' does not exist")
        if not path.is_dir() and not path.is_file():
            raise BagError(f"bag '{path}' is no file: expected a rosbag2 recording")
        finished = not path.is_dir() or (path / "metadata.yaml").exists()
    except (OSError, ValueError) as error:
        raise BagError(f"bag '{str(path)[:80]}' cannot be read: {_reason(error)}") from None
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
        try:  # what whoever takes the records raises does not come by here
            for connection, time_ns, data in self._reader.messages(connections):
                yield Record(connection.topic, connection.msgtype, time_ns, data)
        except Exception as error:  # see above
            raise self._broken(error) from None

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
        self.close()

    def _broken(self, error: Exception) -> BagError:
        if _breaks_off(self.path):
            return BagError(
                f"bag '{self.path}' cannot be read: it breaks off after "
                f"{self.path.stat().st_size / 1e6:.1f} MB, its writer was ended too early; "
                "`mcap recover` writes what is complete into a new file"
            )
        return BagError(
            f"bag '{self.path}' cannot be read ({_reason(error)}): expected a complete rosbag2 "
            "recording in mcap or sqlite3"
        )


class BagWriter:
    """A recording that appears under its name only once it is complete; a context manager.

    Args:
        path: the bag's folder; must not exist.
        storage: one of `STORAGES`.
        notes: texts to keep in the bag's metadata, such as the parameters that made it.
        beside: text of a file to go with the bag, `NAME.yaml` beside `NAME`; empty for none.

    Raises:
        BagError: the path exists or cannot be written to.
    """

    def __init__(
        self,
        path: Path,
        storage: str = "mcap",
        notes: Mapping[str, str] = {},
        beside: str = "",
    ) -> None:
        self.path = path
        refuse_existing(path)
        self._results = [path]
        if beside:
            refuse_existing(file_beside(path))
            self._results.append(file_beside(path))
        self._storage, self._notes, self._beside = storage, notes, beside
        self._connections: dict[str, Connection] = {}

    def add_topic(self, topic: Topic) -> None:
        """Announce a topic; `write` does so by itself for topics of ROS 2 Jazzy's types.

        Raises:
            BagError: neither ROS 2 Jazzy nor the topic itself has a definition of its type.
        """
        if topic.name in self._connections:
            return
        known = topic.type_name in _TYPESTORE.types
        if not known and not (topic.definition and topic.digest):
            raise BagError(f"topic {topic.name}: the definition of {topic.type_name} is not known")
        self._connections[topic.name] = self._writer.add_connection(
            topic.name,
            topic.type_name,
            typestore=_TYPESTORE,
            msgdef=None if known else topic.definition,
            rihs01=None if known else topic.digest,
            offered_qos_profiles=topic.qos or (_RELIABLE,),
        )

    def write(self, topic: str, message: Message, time_ns: int) -> None:
        """Write a message; `topic` is absolute, `time_ns` the time of recording [ns]."""
        data = _TYPESTORE.serialize_cdr(_built(message), message.type_name)
        self.write_raw(Record(topic, message.type_name, time_ns, bytes(data)))

    def write_raw(self, record: Record) -> None:
        """Write a record as it is.

        Raises:
            BagError: the disk is full, or the topic has another type.
        """
        topic, type_name, time_ns, data = record
        connection = self._connections.get(topic)
        if connection is None:
            self.add_topic(Topic(topic, type_name, 0))
            connection = self._connections[topic]
        if connection.msgtype != type_name:
            raise BagError(
                f"bag '{self.path}': topic {topic} is {connection.msgtype}, a {type_name} cannot "
                "be written to it"
            )
        try:
            self._writer.write(connection, time_ns, data)
        except Exception as error:  # see above
            raise self._broken(error) from None

    def __enter__(self) -> Self:
        """Open the bag in a hidden folder beside its place."""
        self._work = WorkFolder(self.path)
        try:
            self._work.make()
            self._open()
        except Exception as error:  # the storages raise errors of many kinds
            self._work.remove()
            raise self._broken(error) from None
        except BaseException:  # a signal
            self._work.remove()
            raise
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Put the bag in its place, or leave nothing if something went wrong."""
        placed: list[Path] = []
        try:
            if error is not None:
                with suppress(Exception):
                    self._writer.abort()
                return
            self._writer.close()
            for result in self._results:
                refuse_existing(result)
                (self._work.path / result.name).rename(result)
                placed.append(result)
        except Exception as failure:  # see above
            for result in placed:
                shutil.rmtree(result, ignore_errors=True)
            if isinstance(failure, BagError):
                raise
            raise self._broken(failure) from None
        finally:
            self._work.remove()

    def _open(self) -> None:
        if self._beside:
            beside = self._work.path / file_beside(self.path).name
            beside.write_text(self._beside, encoding="utf-8")
        mcap = self._storage == "mcap"
        plugin = StoragePlugin.MCAP if mcap else StoragePlugin.SQLITE3
        self._writer = Writer(self._work.path / self.path.name, version=9, storage_plugin=plugin)
        if mcap:
            self._writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
        for key, text in self._notes.items():
            self._writer.set_custom_data(key, text)
        self._writer.open()

    def _broken(self, error: Exception) -> BagError:
        return BagError(f"bag '{self.path}' cannot be written ({_reason(error)})")


def file_beside(bag: Path) -> Path:
    """Return where the parameter file that goes with a bag lies: `NAME.yaml` beside `NAME`.

    Raises:
        BagError: the path is the root of the file system.
    """
    named = bag.resolve() if bag.name in ("", "..") else bag
    if not named.name:
        raise BagError(f"'{bag}' has no name: expected the folder or the file of a recording")
    return named.with_name(f"{named.name}.yaml")


def refuse_existing(path: Path) -> None:
    """Check that a result can get its name.

    Raises:
        BagError: something has it, its folder does not exist or is itself a bag, or it is none.
    """
    shown = f"'{str(path)[:80]}'"
    if path.name in ("", "..") or not path.name.isprintable() or len(os.fsencode(path.name)) > 200:
        raise BagError(f"{shown} cannot be the name of a result: choose another")
    if os.path.lexists(path):
        raise BagError(f"{shown} exists already: choose another name, or remove it first")
    folder = path.absolute().parent
    if not folder.is_dir():
        raise BagError(f"{shown} cannot be written: folder '{path.parent}' does not exist")
    if (folder / "metadata.yaml").exists():
        raise BagError(f"{shown} would lie inside the bag '{path.parent}': choose another place")


def _built(message: Message) -> Any:
    """Return the rosbags message of a tree."""
    fields = message.fields
    built = {name: _value(field) for name, field in fields.items() if isinstance(field, _NESTED)}
    return _TYPESTORE.types[message.type_name](**(fields | built if built else fields))


def _value(field: Message | list[Any]) -> Any:
    if isinstance(field, Message):
        return _built(field)
    return [_value(entry) if isinstance(entry, _NESTED) else entry for entry in field]


def _reason(error: Exception) -> str:
    text = " ".join(str(error).split())
    return text.rstrip(".") if text else type(error).__name__
