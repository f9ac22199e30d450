# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""`make release-check`: what it finds, and that this clone states one version."""

import shutil
import subprocess
from pathlib import Path

import pytest
import release_check
from places import ROOT

from fnn_ekf_ros.errors import FnnEkfError

STATING = ("package.xml", "setup.py", "CHANGELOG.rst", "CITATION.cff")


@pytest.fixture
def clone(tmp_path: Path) -> Path:
    """A clone with the files that state a version, all committed."""
    for name in STATING:
        shutil.copy(ROOT / name, tmp_path / name)
    for words in (["init", "-q"], ["add", "-A"], ["commit", "-qm", "all"]):
        subprocess.run(
            ["git", "-C", tmp_path, "-c", "user.name=a", "-c", "user.email=a@b", *words], check=True
        )
    return tmp_path


def test_this_clone_states_one_version() -> None:
    stated = release_check.versions(ROOT)
    assert set(stated) == set(STATING)
    assert release_check.one_version(stated) == stated["package.xml"]


@pytest.mark.parametrize(
    ("name", "old", "new"),
    [
        ("package.xml", "<version>0", "<version>7"),
        ("CHANGELOG.rst", "\n0.", "\n7."),
        ("CITATION.cff", "\nversion: 0", "\nversion: 7"),
    ],
)
def test_versions_that_differ_are_named(clone: Path, name: str, old: str, new: str) -> None:
    text = (clone / name).read_text()
    assert old in text
    (clone / name).write_text(text.replace(old, new, 1))
    with pytest.raises(FnnEkfError, match=rf"versions differ: .*{name} 7\."):
        release_check.one_version(release_check.versions(clone))


def test_a_file_without_a_version_is_named(clone: Path) -> None:
    (clone / "CHANGELOG.rst").write_text("Changelog\n")
    with pytest.raises(FnnEkfError, match=r"CHANGELOG\.rst states no version"):
        release_check.versions(clone)


def test_what_is_not_committed_is_named(clone: Path) -> None:
    release_check.check_clean(clone)
    (clone / "setup.py").write_text("changed")
    with pytest.raises(FnnEkfError, match=r"setup\.py is not committed"):
        release_check.check_clean(clone)


def test_work_left_to_do_is_named(tmp_path: Path) -> None:
    (tmp_path / "done.py").write_text("# nothing\n")
    (tmp_path / "picture.png").write_bytes(b"\xff\xfe")
    release_check.check_finished(tmp_path, ["done.py", "picture.png"])
    release_check.check_finished(ROOT, ["scripts/release_check.py"])  # which names the marks
    (tmp_path / "open.py").write_text("# first\n# TO" + "DO: more\n")
    with pytest.raises(FnnEkfError, match=r"open\.py, line 2"):
        release_check.check_finished(tmp_path, ["done.py", "open.py"])
