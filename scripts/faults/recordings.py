# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Recordings of the rows of the fault matrix, and the document that is made of them.

A recording has a note beside it that says which code made it. The document is made of recordings
of one code only.
"""

import hashlib
import os
import re
import shutil
from collections.abc import Collection, Sequence
from pathlib import Path

from clone import GitError, git
from documents import SCENARIOS, section, with_section

from faults import tables as fault_tables
from faults.matrix import fault_effect
from faults.scenarios import FaultScenario, Run, read_run
from fnn_ekf_ros.errors import FnnEkfError
from fnn_ekf_ros.files.text_files import write_text
from fnn_ekf_ros.version import version

CODE = ("fnn_ekf_ros", "scripts/fault_matrix.py", "scripts/faults", "scripts/child_processes.py")
"""Files that decide how a run goes."""
NOTE = "made_by"
"""The file beside a recording that names the code."""
NEW = ".new"
"""Ending of the names of hidden folders that may be removed when nothing runs."""


def code_version(root: Path, code: Sequence[str] = CODE) -> str:
    """Return what the code of a clone is called: the same for the same code only.

    Args:
        root: the clone's folder, or that of an archive without git.
        code: files and folders of it that count.
    """
    package = version().partition(",")[0]
    try:
        commit = git(root, "log", "-1", "--format=%h", "--abbrev=7", "--", *code)
        changed = git(root, "status", "--porcelain", "--", *code)
    except GitError:
        commit, changed = "", ""
    if commit and not changed:
        return f"{package}, commit {commit}"
    digest = hashlib.sha256()
    for path in sorted(path for name in code for path in [root / name, *(root / name).rglob("*")]):
        if path.is_file() and path.suffix != ".pyc":
            digest.update(f"{path.relative_to(root)}\0".encode() + path.read_bytes())
    origin = f"commit {commit} with changes" if commit else "no commit, files"
    return f"{package}, {origin} {digest.hexdigest()[:8]}"


def chosen(rows: Sequence[FaultScenario], words: Sequence[str]) -> list[FaultScenario]:
    """Return the rows with one of some words in their names.

    Raises:
        FnnEkfError: a word is in no name.
    """
    for word in words:
        if not word or not any(word in row.name for row in rows):
            raise FnnEkfError(
                f"--only '{word}': no row has this in its name; docs/faults.md lists the names"
            )
    return [row for row in rows if any(word in row.name for word in words)]


class Recordings:
    """The recordings of rows in a folder.

    Args:
        folder: where they are.
        rows: all rows of the matrix, in the document's order; the first is without a fault.
        undisturbed: the rows without a fault, by whether the encoders are ticks.
    """

    def __init__(
        self, folder: Path, rows: Sequence[FaultScenario], undisturbed: dict[bool, FaultScenario]
    ) -> None:
        self._folder, self._rows, self._undisturbed = folder, rows, undisturbed

    def place(self, row: FaultScenario) -> Path:
        """Return the folder of a row's recording."""
        return self._folder / re.sub(r"[^a-z0-9]+", "-", row.name.lower()).strip("-")

    def new_place(self, row: FaultScenario) -> Path:
        """Return the folder to run a row in, empty; a recording it may have stays as it is."""
        place = self.place(row)
        new = place.with_name(f".{place.name}{NEW}")
        shutil.rmtree(new, ignore_errors=True)
        return new

    def keep(self, row: FaultScenario, made_by: str) -> None:
        """Put what was recorded in a row's new place into the place of its recording.

        Raises:
            OSError: it cannot be written there.
        """
        place = self.place(row)
        new, old = (place.with_name(f".{place.name}{end}") for end in (NEW, f".old{NEW}"))
        (new / NOTE).write_text(made_by, encoding="utf-8")
        shutil.rmtree(old, ignore_errors=True)
        if place.exists():
            place.replace(old)
        new.replace(place)
        shutil.rmtree(old, ignore_errors=True)

    def remove_new(self) -> None:
        """Remove what is left of runs that failed or were interrupted."""
        for new in self._folder.glob(f".*{NEW}"):
            shutil.rmtree(new, ignore_errors=True)

    def made_by(self, row: FaultScenario) -> str:
        """Return which code has made a row's recording; empty if there is none or a damaged one."""
        note = self.place(row) / NOTE
        try:
            return note.read_text(encoding="utf-8") if note.is_file() else ""
        except UnicodeDecodeError:
            return ""

    def missing(self, made_by: str, but: Collection[str] = ()) -> list[FaultScenario]:
        """Return the rows that a code has not recorded, but for those with some names."""
        return [r for r in self._rows if r.name not in but and self.made_by(r) != made_by]

    def one_code(self) -> str:
        """Return which code has made all recordings.

        Raises:
            FnnEkfError: there are none of some rows, or not all are of one code.
        """
        notes = [self.made_by(row) for row in self._rows]
        without = notes.count("")
        if without:
            raise FnnEkfError(f"{without} of {len(notes)} rows have no recording")
        if len(set(notes)) > 1:
            counts = [f"{notes.count(note)} of {note}" for note in sorted(set(notes))]
            raise FnnEkfError(f"the recordings are not of one version: {'; '.join(counts)}")
        return notes[0]

    def write(self, table: Path, picture: str) -> None:
        """Write the document, and the picture beside it, of the recordings: both or none.

        The section that `make scenarios` writes stays.

        Raises:
            FnnEkfError: the recordings are not whole, not of one code, or cannot be read.
        """
        made_by = self.one_code()
        runs: dict[str, Run] = {}
        for row in self._rows:
            runs[row.name] = read_run(self.place(row) / "run", row)
        lines = []
        for row in self._rows:
            usual = runs[self._undisturbed[row.ticks].name]
            without = runs[row.without] if row.without else usual
            lines.append((row, fault_effect(row, runs[row.name], usual, without)))
        text = fault_tables.document(lines, runs[self._rows[0].name], made_by, picture)
        scenarios = section(table.read_text(encoding="utf-8"), SCENARIOS) if table.exists() else ""
        if scenarios:
            text = with_section(text, SCENARIOS, scenarios)
        partial = table.with_name(f".{os.getpid()}.{picture}")
        try:
            fault_tables.draw(partial, [(row, runs[row.name]) for row in self._rows])
            write_text(table, text)
            partial.replace(table.with_name(picture))
        finally:
            partial.unlink(missing_ok=True)
