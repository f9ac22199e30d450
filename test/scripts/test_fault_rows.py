# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""`make faults`: what its rows and the code that records them are called."""

import subprocess
from pathlib import Path

from faults import rows
from faults.recordings import Recordings, chosen, code_version


def test_rows_have_names_and_places_of_their_own() -> None:
    recordings = Recordings(Path("out"), rows.ROWS, rows.UNDISTURBED)
    names = [row.name for row in rows.ROWS]
    assert len(set(names)) == len({recordings.place(row) for row in rows.ROWS}) == len(names)
    assert {row.without for row in rows.ROWS} - {""} <= set(names)
    assert [row.name for row in chosen(rows.ROWS, ["kidnap"])] == ["kidnap, 20 m"]


def test_the_code_is_named_by_its_commit_and_by_its_changes(tmp_path: Path) -> None:
    def git(*arguments: str) -> None:
        who = ["-c", "user.name=a", "-c", "user.email=a@b.example"]
        command = ["git", "-C", str(tmp_path), *who, *arguments]
        subprocess.run(command, check=True, capture_output=True)

    module = tmp_path / "fnn_ekf_ros" / "a.py"
    module.parent.mkdir()
    module.write_text("1\n")
    assert ", no commit, files " in code_version(tmp_path)
    git("init", "--quiet")
    git("add", ".")
    git("commit", "--quiet", "-m", "one")
    first = code_version(tmp_path)
    assert ", commit " in first
    assert "changes" not in first

    (tmp_path / "README.md").write_text("words\n")
    assert code_version(tmp_path) == first
    git("add", ".")
    git("commit", "--quiet", "-m", "words")
    assert code_version(tmp_path) == first, "a document changes no run"

    module.write_text("2\n")
    second = code_version(tmp_path)
    module.write_text("3\n")
    assert len({first, second, code_version(tmp_path)}) == 3
    assert second.startswith(f"{first} with changes ")
    module.write_text("1\n")
    assert code_version(tmp_path) == first
    (tmp_path / "fnn_ekf_ros" / "b.py").write_text("")
    assert "changes" in code_version(tmp_path), "a file that git does not know yet"
