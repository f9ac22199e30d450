# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Where results go: checked before anything is computed, written whole or not at all."""

import errno
import os
import secrets
import shutil
import sys
from collections.abc import Collection, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple, TextIO

from fnn_ekf_ros.errors import FnnEkfError, reason_of
from fnn_ekf_ros.files.text_files import json_text, write_json, write_text

STANDARD_OUTPUT = "-"
"""The word for standard output in place of a file's name."""


@dataclass(frozen=True, slots=True)
class TextResult:
    """Where a text that was asked for goes.

    Attributes:
        path: the file.
        stream: standard output, if the text goes there; None for the file.
    """

    path: Path
    stream: TextIO | None = None

    def write(self, text: str) -> None:
        """Write the text; a file is there completely or not at all.

        Raises:
            FnnEkfError: the file cannot be written.
        """
        if self.stream is None:
            write_text(self.path, text)
        else:
            self.stream.write(text)

    def write_json(self, content: Any, indent: int = 1) -> None:
        """Write JSON, in which no number is NaN or infinite.

        Raises:
            FnnEkfError: the file cannot be written.
        """
        self.write(json_text(content, indent))

    def __str__(self) -> str:
        return str(self.path)


def text_result(word: str) -> TextResult:
    """Return where a text goes, as a word of the command line says."""
    return TextResult(Path(word), sys.stdout if word == STANDARD_OUTPUT else None)


def check_results(
    results: Mapping[str, Path | TextResult | None],
    inputs: Iterable[Path] = (),
    *,
    replaces: bool = False,
) -> None:
    """Check that all results of a command can get their names.

    Args:
        results: by option; None for those that were not asked for.
        inputs: what the command reads, which no result may replace.
        replaces: whether files that are there may be replaced.

    Raises:
        FnnEkfError: one cannot, or two go to the same place.
    """
    taken, on_stdout = list(inputs), []
    for option, result in results.items():
        if result is None:
            continue
        if isinstance(result, TextResult) and result.stream is not None:
            on_stdout.append(option)
            continue
        path = result.path if isinstance(result, TextResult) else result
        if not isinstance(result, TextResult) and str(path) == STANDARD_OUTPUT:
            raise FnnEkfError(f"{option} {path}: is no text, expected the name of a file")
        check_result_file(option, path, taken, replaces=replaces)
        taken.append(path)
    if len(on_stdout) > 1:
        raise FnnEkfError(
            f"{' and '.join(on_stdout)}: both go to standard output, expected one of them at most"
        )


def check_result_file(
    option: str, path: Path, others: Iterable[Path] = (), *, replaces: bool = False
) -> None:
    """Check that a result can get its name, so that no work is done in vain.

    Args:
        option: what the name is from, for the error.
        path: the file to write.
        others: inputs and other results of the command, which it must not replace.
        replaces: whether a file that is there may be replaced.

    Raises:
        FnnEkfError: its folder is not there or is a bag, or it is there, a folder, no regular file,
            one of the others or no possible name.
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
        if os.path.lexists(path) and not replaces:
            raise FnnEkfError(
                f"{option} '{path}': exists already, expected a new name, or --force to replace it"
            )
    except (OSError, ValueError) as error:
        raise FnnEkfError(f"{option} '{path}': {reason_of(error)}") from None


def check_result_folder(
    option: str,
    path: Path,
    *,
    replaces: bool,
    names: Collection[str] | None = None,
) -> None:
    """Check that results can be written into a folder, which need not be there.

    Args:
        option: what the name is from, for the error.
        path: the folder.
        replaces: whether files that are there may be replaced.
        names: the files to write; None if all of the folder is theirs.

    Raises:
        FnnEkfError: it cannot be made or written to, is a bag or lies inside one, or something is
            there already.
    """
    try:
        if str(path) == STANDARD_OUTPUT:
            raise FnnEkfError(f"{option} {path}: is no text, expected the name of a folder")
        if _is_bag(path) or _is_bag(path.parent):
            raise FnnEkfError(f"{option} '{path}': is a bag's folder, expected another")
        if not os.access(_first_that_is_there(path), os.W_OK | os.X_OK):
            raise FnnEkfError(f"{option} '{path}': Permission denied")
        if path.is_dir() and names is None and not replaces and any(path.iterdir()):
            raise FnnEkfError(
                f"{option} '{path}': is there and not empty, expected a new folder, or --force to "
                "replace files of the same name"
            )
        for name in names or () if path.is_dir() else ():
            check_result_file(option, path / name, replaces=replaces)
    except (OSError, ValueError) as error:
        raise FnnEkfError(f"{option} '{path}': {reason_of(error)}") from None


@contextmanager
def result_folder(path: Path, option: str = "--out") -> Iterator[Path]:
    """Yield a hidden folder to write into; its files get their place when all of them are written.

    It lies where it can be moved from, and is removed if something goes wrong. What else is in the
    folder stays.

    Args:
        path: the folder of the results, which `check_result_folder` has checked.
        option: what its name is from, for the error.

    Raises:
        FnnEkfError: the results cannot be written.
    """
    try:
        place = path if path.is_dir() else _first_that_is_there(path)
        # It is named before it is made: a signal may come at any moment.
        work = place / f".results.{secrets.token_hex(4)}"
        inner = work / "results"
        try:
            work.mkdir(mode=0o700)
            inner.mkdir()
            yield inner
            if path.is_dir():
                for file in sorted(inner.iterdir()):
                    file.replace(path / file.name)
            else:
                path.parent.mkdir(parents=True, exist_ok=True)
                inner.rename(path)
        finally:
            shutil.rmtree(work, ignore_errors=True)
    except (OSError, ValueError) as error:
        raise FnnEkfError(f"{option} '{path}': {reason_of(error)}") from None


class StudyResults(NamedTuple):
    """Where the results of a study go.

    Attributes:
        folder: of tables, figures and settings.
        numbers: what `--json` says; `results.json` in the folder without.
    """

    folder: Path
    numbers: TextResult

    @contextmanager
    def written(self, content: Mapping[str, Any]) -> Iterator[Path]:
        """Write the numbers, and yield the folder to write the others into, as `result_folder`.

        Raises:
            FnnEkfError: something cannot be written.
        """
        path = self.numbers.path
        inside = self.numbers.stream is None and _same(path.parent, self.folder)
        with result_folder(self.folder) as work:
            if inside:
                write_json(work / path.name, content)
            yield work
        if not inside:
            self.numbers.write_json(content)


def study_results(
    out: Path,
    numbers: TextResult | None = None,
    inputs: Iterable[Path] = (),
    *,
    replaces: bool = False,
) -> StudyResults:
    """Return where the results of a study go, once they can be written there.

    Args:
        out: the folder of `--out`.
        numbers: the file of `--json`; None for `results.json` in the folder.
        inputs: files that `--json` must not replace.
        replaces: whether files that are there may be replaced.

    Raises:
        FnnEkfError: a result cannot get its name.
    """
    chosen = numbers or TextResult(out / "results.json")
    own = numbers is not None and chosen.stream is None
    if own and not _same(chosen.path.parent, out):
        others = [*inputs, out, *out.absolute().parents]
        check_result_file("--json", chosen.path, others, replaces=replaces)
    elif chosen.stream is None and chosen.path.suffix != ".json":
        raise FnnEkfError(
            f"--json '{chosen}': expected a name that ends in .json beside the other results"
        )
    check_result_folder("--out", out, replaces=replaces)
    if replaces and out.is_dir():
        for name in {"results.md", chosen.path.name}:
            check_result_file("--out", out / name, inputs, replaces=True)
    return StudyResults(out, chosen)


def _first_that_is_there(path: Path) -> Path:
    """Return a folder, or the next above it that is there.

    Raises:
        OSError: it is no folder.
    """
    for each in (path.absolute(), *path.absolute().parents):
        if os.path.lexists(each):
            if not each.is_dir():
                raise NotADirectoryError(errno.ENOTDIR, os.strerror(errno.ENOTDIR))
            return each
    return Path("/")


def _same(one: Path, other: Path) -> bool:
    return os.path.realpath(one) == os.path.realpath(other)


def _is_bag(folder: Path) -> bool:
    return (folder / "metadata.yaml").exists()
