# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""What tests of commands share: the types of their fixtures, and views of bags and tables."""

from collections.abc import Callable
from pathlib import Path

from fnn_ekf_ros.recordings.bag_files import BagReader, Record

Refuse = Callable[..., str]
Succeed = Callable[..., str]
HEARS_SIGINT = ["env", "--default-signal=INT"]
"""A test run that a shell started in the background has SIGINT ignored, and hands that down."""


def contents(folder: Path) -> dict[str, bytes]:
    """Return the bytes of the files in a bag's folder by name."""
    return {path.name: path.read_bytes() for path in sorted(folder.iterdir())}


def records(path: Path, *topics: str) -> list[Record]:
    """Return the records of a bag on some topics, or on all."""
    with BagReader(path) as bag:
        return list(bag.records(set(topics) or None))


def parameters_of(bag: Path) -> Path:
    """Return the parameter file beside a bag."""
    return bag.with_name(f"{bag.name}.yaml")


def table_rows(out: str) -> dict[str, list[str]]:
    """Return the numbers of the first table that evaluate prints, by label."""
    rows = out.partition("\n\n")[0].splitlines()[2:]
    return {line.split()[0]: line.split()[1:] for line in rows}
