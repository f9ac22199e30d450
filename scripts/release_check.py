# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Check what a release needs: one version everywhere, a clean tree, nothing left to do.

`make release-check` runs ruff and mypy first.
"""

import argparse
import re
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import yaml
from clone import git

from fnn_ekf_ros.errors import FnnEkfError

ROOT = Path(__file__).resolve().parents[1]
"""Folder of the clone."""
UNFINISHED = re.compile("|".join(rf"\b{word.upper()}\b" for word in ("todo", "fixme", "xxx")))
"""Marks of unfinished work, written so that this file has none."""


def versions(root: Path) -> dict[str, str]:
    """Return the version that each file of a clone states, by the file's name.

    Args:
        root: the clone's folder.

    Raises:
        FnnEkfError: a file states none.
    """
    setup = subprocess.run(
        [sys.executable, "setup.py", "--version"],
        cwd=root, capture_output=True, text=True, check=False,
    )  # fmt: skip
    changes = (root / "CHANGELOG.rst").read_text(encoding="utf-8")
    top = re.search(r"^(\d\S*) \(.*\)\n-+$", changes, flags=re.MULTILINE)
    citation = yaml.safe_load((root / "CITATION.cff").read_text(encoding="utf-8"))
    found = {
        "package.xml": ElementTree.parse(root / "package.xml").getroot().findtext("version"),  # noqa: S314
        "setup.py": setup.stdout.strip(),
        "CHANGELOG.rst": top and top[1],
        "CITATION.cff": citation.get("version"),
    }
    for name, stated in found.items():
        if not stated:
            raise FnnEkfError(f"{name} states no version: expected one as in package.xml")
    return {name: str(stated) for name, stated in found.items()}


def one_version(stated: Mapping[str, str]) -> str:
    """Return the version that all files state.

    Raises:
        FnnEkfError: they differ.
    """
    if len(set(stated.values())) > 1:
        listed = ", ".join(f"{name} {version}" for name, version in stated.items())
        raise FnnEkfError(f"versions differ: {listed}; expected the same in each")
    return next(iter(stated.values()))


def check_clean(root: Path) -> None:
    """Check that everything in a clone is committed.

    Raises:
        FnnEkfError: there are changes, or it is no clone.
    """
    changed = git(root, "status", "--porcelain")
    if changed:
        raise FnnEkfError(
            f"{changed.splitlines()[0].split()[-1]} is not committed: expected a clean tree"
        )


def check_finished(root: Path, names: Iterable[str]) -> None:
    """Check that no text file has a mark of unfinished work.

    Args:
        root: the clone's folder.
        names: the files below it.

    Raises:
        FnnEkfError: one has.
    """
    for name in names:
        try:
            lines = (root / name).read_text(encoding="utf-8").splitlines()
        except UnicodeDecodeError:
            continue  # a picture or a recording
        for number, line in enumerate(lines, start=1):
            if mark := UNFINISHED.search(line):
                raise FnnEkfError(f"{name}, line {number}: {mark[0]}; expected no work left to do")


def main(argv: Sequence[str] | None = None) -> int:
    """Check this clone; return the exit code."""
    argparse.ArgumentParser(description=__doc__).parse_args(argv)
    try:
        version = one_version(versions(ROOT))
        check_clean(ROOT)
        check_finished(ROOT, git(ROOT, "ls-files").splitlines())
    except (FnnEkfError, OSError) as error:
        print(f"release_check: {error}", file=sys.stderr)
        return 1
    print(f"release_check: {version} is ready")
    return 0


if __name__ == "__main__":
    sys.exit(main())
