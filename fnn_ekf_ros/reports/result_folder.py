# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Folders for results: checked before anything is computed or written."""

import os
from collections.abc import Collection, Iterable
from pathlib import Path

from fnn_ekf_ros.errors import FnnEkfError, reason_of


def make_folder(path: Path, option: str = "--out") -> None:
    """Make the folder of an option if it is not there.

    Raises:
        FnnEkfError: it cannot be made, is a bag or lies inside one.
    """
    try:
        if _is_bag(path) or _is_bag(path.parent):
            raise FnnEkfError(f"{option} '{path}': is a bag's folder, expected another")
        path.mkdir(parents=True, exist_ok=True)
    except (OSError, ValueError) as error:
        raise FnnEkfError(f"{option} '{path}': {reason_of(error)}") from None


def check_result_file(option: str, path: Path, others: Iterable[Path] = ()) -> None:
    """Check that a result can get its name, so that no work is done in vain.

    Args:
        option: what the name is from, for the error.
        path: the file to write; one that is there is replaced.
        others: inputs and other results of the command, which it must not replace.

    Raises:
        FnnEkfError: its folder is not there or is a bag, or it is a folder, no regular file, one of
            the others or no possible name.
    """
    try:
        if not path.parent.is_dir():
            raise FnnEkfError(f"{option} '{path}': there is no folder '{path.parent}'")
        if path.is_dir():
            raise FnnEkfError(f"{option} '{path}': is a folder, expected the name of a file")
        if path.exists() and not path.is_file():
            raise FnnEkfError(f"{option} '{path}': is no file, expected the name of a file")
        if _is_bag(path.parent):
            raise FnnEkfError(f"{option} '{path}': lies inside a bag, expected another folder")
        if any(_same(path, other) for other in others):
            raise FnnEkfError(
                f"{option} '{path}': is an input or another result, expected a name of its own"
            )
    except (OSError, ValueError) as error:
        raise FnnEkfError(f"{option} '{path}': {reason_of(error)}") from None


def prepare_study(
    out: Path, names: Collection[str], numbers: Path | None = None, inputs: Iterable[Path] = ()
) -> Path:
    """Make the folder of a study's `--out`, once its results can be written; return `--json`.

    Args:
        out: the folder.
        names: files in it that are written after the work is done.
        numbers: the file of `--json`; None for `results.json` in the folder.
        inputs: files that `--json` must not replace.

    Raises:
        FnnEkfError: a result cannot get its name.
    """
    chosen = numbers or out / "results.json"
    if numbers is not None and not _same(numbers.parent, out):
        check_result_file("--json", numbers, [*inputs, out, *out.absolute().parents])
    elif chosen.suffix != ".json":
        raise FnnEkfError(
            f"--json '{chosen}': expected a name that ends in .json beside the other results"
        )
    make_folder(out)
    for name in names:
        check_result_file("--out", out / name)
    check_result_file("--out" if numbers is None else "--json", chosen, inputs)
    return chosen


def _same(one: Path, other: Path) -> bool:
    return os.path.realpath(one) == os.path.realpath(other)


def _is_bag(folder: Path) -> bool:
    return (folder / "metadata.yaml").exists()
