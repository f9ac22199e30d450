"""Small text results, written whole or not at all."""

import os
from pathlib import Path

from fnn_ekf_ros.errors import FnnEkfError


def parameter_file_beside(bag: Path) -> Path:
    """Return where the parameter file that goes with a bag lies: `NAME.yaml` beside `NAME`."""
    return bag.with_name(f"{bag.name}.yaml")


def write_text(path: Path, text: str) -> None:
    """Write a file so that it is there completely or not at all.

    Raises:
        FnnEkfError: the file cannot be written.
    """
    partial = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        partial.write_text(text, encoding="utf-8")
        partial.replace(path)
    except OSError as error:
        partial.unlink(missing_ok=True)
        raise FnnEkfError(f"'{path}' cannot be written: {error.strerror}") from None
