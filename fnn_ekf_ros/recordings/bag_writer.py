# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Writing of rosbag2 recordings, whole or not at all."""

import os
import secrets
import shutil
import struct
from collections.abc import Iterable, Mapping
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from fnn_ekf_ros.messages import Message
from fnn_ekf_ros.recordings.bag_files import LAST_STAMP_S, BagError, Record, Topic, reason
from fnn_ekf_ros.recordings.rosbags_api import (
    RELIABLE,
    TYPESTORE,
    CompressionFormat,
    CompressionMode,
    Connection,
    StoragePlugin,
    Writer,
)

STORAGES = ("mcap", "sqlite3")
"""Storage formats of rosbag2 that can be written, the default first."""
_NESTED = (Message, list)
"""Types of the fields of a message tree that are built themselves."""


class BagWriter:
    """A recording that appears under its name only once it is complete; a context manager.

    Until then it grows in a hidden folder beside its place, `.NAME.xxxxxxxx`, which is all that a
    process that is killed leaves behind.

    Args:
        path: the bag's folder; must not exist, unless it is a bag and is replaced.
        storage: one of `STORAGES`.
        notes: texts to keep in the bag's metadata, such as the parameters that made it.
        beside: text of a file to go with the bag, `NAME.yaml` beside `NAME`; empty for none.
        replaces: whether a bag that is there is replaced, once the new one is complete.

    Raises:
        BagError: the path exists or cannot be written to.
    """

    def __init__(
        self,
        path: Path,
        storage: str = "mcap",
        notes: Mapping[str, str] = {},
        beside: str = "",
        *,
        replaces: bool = False,
    ) -> None:
        self.path = path
        refuse_existing(path, replaces=replaces)
        self._results = [path]
        if beside:
            refuse_existing(file_beside(path), replaces=replaces)
            self._results.append(file_beside(path))
        self._replaces = replaces
        self._storage, self._notes, self._beside = storage, notes, beside
        self._connections: dict[str, Connection] = {}

    def add_topic(self, topic: Topic) -> None:
        """Announce a topic; `write` does so by itself for topics of ROS 2 Jazzy's types.

        Raises:
            BagError: neither ROS 2 Jazzy nor the topic itself has a definition of its type.
        """
        if topic.name in self._connections:
            return
        known = topic.type_name in TYPESTORE.types
        if not known and not (topic.definition and topic.digest):
            raise BagError(f"topic {topic.name}: the definition of {topic.type_name} is not known")
        self._connections[topic.name] = self._writer.add_connection(
            topic.name,
            topic.type_name,
            typestore=TYPESTORE,
            msgdef=None if known else topic.definition,
            rihs01=None if known else topic.digest,
            offered_qos_profiles=topic.qos or (RELIABLE,),
        )

    def write(self, topic: str, message: Message, time_ns: int) -> None:
        """Write a message; `topic` is absolute, `time_ns` the time of recording [ns].

        Raises:
            BagError: a number in it is beyond its type, such as a stamp after 2038; or see
                `write_raw`.
        """
        try:
            data = TYPESTORE.serialize_cdr(_built(message), message.type_name)
        except (struct.error, OverflowError) as error:
            late = abs(time_ns) > LAST_STAMP_S * 10**9
            why = "stamps of ROS end in 2038" if late else reason(error)
            raise BagError(
                f"bag '{self.path}': the message on {topic} at {time_ns * 1e-9:.3f} s cannot be "
                f"written as {message.type_name} ({why})"
            ) from None
        self.write_raw(
            Record(topic=topic, type_name=message.type_name, time_ns=time_ns, data=bytes(data))
        )

    def rewrite(self, record: Record, message: Any) -> None:
        """Write a record with another message of its type, its fields as attributes."""
        data = TYPESTORE.serialize_cdr(message, record.type_name)
        self.write_raw(record._replace(data=bytes(data)))

    def write_raw(self, record: Record) -> None:
        """Write a record as it is.

        Raises:
            BagError: the disk is full, or the topic has another type.
        """
        connection = self._connections.get(record.topic)
        if connection is None:
            self.add_topic(Topic(name=record.topic, type_name=record.type_name, message_count=0))
            connection = self._connections[record.topic]
        if connection.msgtype != record.type_name:
            raise BagError(
                f"bag '{self.path}': topic {record.topic} is {connection.msgtype}, a "
                f"{record.type_name} cannot be written to it"
            )
        try:
            self._writer.write(connection, record.time_ns, record.data)
        except Exception as error:  # the storages raise errors of many kinds
            raise self._broken(error) from None

    def __enter__(self) -> Self:
        """Open the bag in a hidden folder beside its place."""
        # It is named before it is made: a signal may come at any moment.
        self._work = self.path.parent / f".{self.path.name}.{secrets.token_hex(4)}"
        try:
            self._work.mkdir(mode=0o700)
            self._open()
        except Exception as error:  # the storages raise errors of many kinds
            self._clean_up()
            raise self._broken(error) from None
        except BaseException:  # a signal
            self._clean_up()
            raise
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Put the bag in its place, or leave nothing if something went wrong."""
        begun: list[Path] = []
        try:
            if error is not None:
                with suppress(Exception):
                    self._writer.abort()
                return
            self._writer.close()
            for result in self._results:
                refuse_existing(result, replaces=self._replaces)
                begun.append(result)
                if os.path.lexists(result):
                    result.rename(self._old(result))
                self._new(result).rename(result)
        except BaseException as failure:  # the storages raise errors of many kinds; a signal
            for result in begun:
                self._put_back(result)
            if not isinstance(failure, Exception):
                raise
            if isinstance(failure, BagError):
                raise
            raise self._broken(failure) from None
        finally:
            self._clean_up()

    def _clean_up(self) -> None:
        shutil.rmtree(self._work, ignore_errors=True)

    def _new(self, result: Path) -> Path:
        """Return where a result lies until it is complete."""
        return self._work / result.name

    def _old(self, result: Path) -> Path:
        """Return where what a result replaces lies until the new one is in its place."""
        return self._work / f"{result.name}.old"

    def _put_back(self, result: Path) -> None:
        """Undo what has been done to give a result its place, wherever it broke off."""
        if not os.path.lexists(self._new(result)):
            shutil.rmtree(result) if result.is_dir() else result.unlink()
        if os.path.lexists(self._old(result)):
            self._old(result).rename(result)

    def _open(self) -> None:
        if self._beside:
            (self._work / file_beside(self.path).name).write_text(self._beside, encoding="utf-8")
        mcap = self._storage == "mcap"
        plugin = StoragePlugin.MCAP if mcap else StoragePlugin.SQLITE3
        self._writer = Writer(self._work / self.path.name, version=9, storage_plugin=plugin)
        if mcap:
            self._writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
        for key, text in self._notes.items():
            self._writer.set_custom_data(key, text)
        self._writer.open()

    def _broken(self, error: Exception) -> BagError:
        return BagError(f"bag '{self.path}' cannot be written ({reason(error)})")


def file_beside(bag: Path) -> Path:
    """Return where the parameter file that goes with a bag lies: `NAME.yaml` beside `NAME`.

    Raises:
        BagError: the path is the root of the file system.
    """
    named = bag.resolve() if bag.name in ("", "..") else bag
    if not named.name:
        raise BagError(f"'{bag}' has no name: expected the folder or the file of a recording")
    return named.with_name(f"{named.name}.yaml")


def refuse_existing(path: Path, *, replaces: bool = False) -> None:
    """Check that a result can get its name.

    Args:
        path: of the result, a bag or the file beside it.
        replaces: whether a bag that is there may be replaced, or such a file.

    Raises:
        BagError: something has it, its folder does not exist or is itself a bag, or it is none.
    """
    shown = f"'{str(path)[:80]}'"
    if (
        path.name in ("", "..", "-")
        or not path.name.isprintable()
        or len(os.fsencode(path.name)) > 200
    ):
        raise BagError(f"{shown} cannot be the name of a result: choose another")
    if os.path.lexists(path):
        if not replaces:
            raise BagError(f"{shown} exists already: choose another name, or --force to replace it")
        is_bag = (path / "metadata.yaml").is_file()
        if path.is_symlink() or not (is_bag or (path.is_file() and path.suffix == ".yaml")):
            raise BagError(f"{shown} is there and no bag: --force replaces nothing else")
    folder = path.absolute().parent
    if not folder.is_dir():
        raise BagError(f"{shown} cannot be written: folder '{path.parent}' does not exist")
    if (folder / "metadata.yaml").exists():
        raise BagError(f"{shown} would lie inside the bag '{path.parent}': choose another place")


def refuse_inputs(path: Path, inputs: Iterable[Path]) -> None:
    """Check that a bag that is to be written, and the file beside it, hold no input.

    Raises:
        BagError: an input has its name, or is in it.
    """
    results = [path, file_beside(path)] if path.name else [path]
    places = {os.path.realpath(result) for result in results}
    for each in inputs:
        real = Path(os.path.realpath(each))
        if places & {str(place) for place in (real, *real.parents)}:
            raise BagError(f"'{path}' would replace the input '{each}': choose another name")


def _built(message: Message) -> Any:
    """Return the rosbags message of a tree."""
    fields = message.fields
    built = {name: _value(field) for name, field in fields.items() if isinstance(field, _NESTED)}
    return TYPESTORE.types[message.type_name](**(fields | built if built else fields))


def _value(field: Message | list[Any]) -> Any:
    if isinstance(field, Message):
        return _built(field)
    return [_value(entry) if isinstance(entry, _NESTED) else entry for entry in field]
