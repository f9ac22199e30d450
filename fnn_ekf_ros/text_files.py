"""Small text files: read with one clear error, written whole or not at all."""

import os
from pathlib import Path

from fnn_ekf_ros.errors import FnnEkfError


def read_text(path: Path, what: str, kind: type[FnnEkfError]) -> str:
    """Return a text file's content.

    Args:
        path: the file.
        what: what it is, for the error's first words.
        kind: the error to raise.

    Raises:
        FnnEkfError: it is not there, no regular file or no text.
    """
    try:
        if path.exists() and not path.is_file():
            raise kind(f"{what} '{path}' is no file: expected a text file")
        return path.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise kind(f"{what} '{path}': {error.strerror}") from None
    except ValueError:  # not UTF-8, or a NUL byte in the name
        raise kind(f"{what} '{path}' is no text file") from None


def write_text(path: Path, text: str) -> None:
    """Write a file so that it is there completely or not at all.

    Raises:
        FnnEkfError: the file cannot be written.
    """
    if path.exists() and not path.is_file():
        raise FnnEkfError(f"'{path}' is no file: expected the name of a file to write")
    partial = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        partial.write_text(text, encoding="utf-8")
        partial.replace(path)
    except OSError as error:
        raise FnnEkfError(f"'{path}' cannot be written: {error.strerror}") from None
    finally:
        partial.unlink(missing_ok=True)
