# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Small text files: read with one clear error, written whole or not at all."""

import hashlib
import json
import os
import re
import secrets
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO, Any

from fnn_ekf_ros.errors import FnnEkfError, reason_of

_TOKEN_BYTES = 6
"""Length of the random end of a partial file's name [bytes, two digits each]: nobody can guess it
and put a link there."""
_LONGEST_NAME = 255 - 2 - 2 * _TOKEN_BYTES
"""Longest name of a file that a partial file is named after [bytes]: a file system allows 255, and
two dots and the random end have to fit."""


def read_text(path: Path, what: str, kind: type[FnnEkfError], expected: str = "a text file") -> str:
    """Return a text file's content.

    Args:
        path: the file.
        what: what it is, for the error's first words.
        kind: the error to raise.
        expected: what should be there, for the error's last words.

    Raises:
        FnnEkfError: it is not there, no regular file or no text.
    """
    try:
        if path.exists() and not path.is_file():
            raise kind(f"{what} '{path}' is no file: expected {expected}")
        return path.read_text(encoding="utf-8-sig")
    except FileNotFoundError:
        raise kind(f"{what} '{path}' does not exist: expected {expected}") from None
    except OSError as error:
        raise kind(
            f"{what} '{path}' cannot be read ({reason_of(error)}): expected {expected}"
        ) from None
    except ValueError:  # not UTF-8, or a NUL byte in the name
        raise kind(f"{what} '{path}' is no text file: expected {expected}") from None


def write_text(path: Path, text: str) -> None:
    """Write a file so that it is there completely or not at all, whatever ends the process.

    Raises:
        FnnEkfError: the file cannot be written.
    """
    with written_whole(path) as file:
        file.write(text.encode())
        file.flush()
        os.fsync(file.fileno())


def write_json(path: Path, content: Any, indent: int = 1) -> None:
    """Write a JSON file as `write_text` does; no number in it is NaN or infinite.

    Raises:
        FnnEkfError: the file cannot be written.
    """
    write_text(path, json_text(content, indent))


def json_text(content: Any, indent: int = 1) -> str:
    """Return the text of a JSON file; no number in it is NaN or infinite."""
    return json.dumps(content, indent=indent, allow_nan=False) + "\n"


@contextmanager
def written_whole(path: Path) -> Iterator[IO[bytes]]:
    """Yield a hidden file to write, which then replaces a file or is removed.

    It is new and its name is random, so that no link which somebody has put there is followed.

    Raises:
        FnnEkfError: the file cannot be written.
    """
    partial = path.parent / f".{_stem(path)}.{secrets.token_hex(_TOKEN_BYTES)}"
    try:
        if path.exists() and not path.is_file():
            raise FnnEkfError(f"'{path}' is no file: expected the name of a file to write")
        with open(partial, "xb", opener=_open_new) as file:
            yield file
        partial.replace(path)
    except FileNotFoundError:
        raise FnnEkfError(
            f"'{path}' cannot be written: folder '{path.parent}' does not exist"
        ) from None
    except (OSError, ValueError) as error:
        raise FnnEkfError(f"'{path}' cannot be written: {reason_of(error)}") from None
    finally:
        with suppress(OSError, ValueError):
            partial.unlink(missing_ok=True)


def _open_new(path: str, flags: int) -> int:
    """Open a file that must not be there; `O_EXCL`, which mode x asks for, follows no link."""
    return os.open(path, flags | os.O_NOFOLLOW | os.O_CLOEXEC, 0o666)


def remove_partials(path: Path) -> int:
    """Remove what writers that were killed have left of a file; return how many there were.

    Raises:
        FnnEkfError: one cannot be removed.
    """
    name = re.compile(rf"\.{re.escape(_stem(path))}\.[0-9a-f]{{{2 * _TOKEN_BYTES}}}")
    try:
        found = [entry for entry in path.absolute().parent.iterdir() if name.fullmatch(entry.name)]
        for partial in found:
            partial.unlink(missing_ok=True)
    except OSError as error:
        raise FnnEkfError(f"remains of '{path}' cannot be removed: {reason_of(error)}") from None
    return len(found)


def _stem(path: Path) -> str:
    """Return what the names of a file's partials begin with, short enough for more to follow."""
    name = os.fsencode(path.name)
    return path.name if len(name) <= _LONGEST_NAME else hashlib.sha256(name).hexdigest()


def readable(text: str) -> str:
    """Return a name that can be printed: U+FFFD stands for bytes that are not UTF-8."""
    return re.sub("[\ud800-\udfff]", "\N{REPLACEMENT CHARACTER}", text)
