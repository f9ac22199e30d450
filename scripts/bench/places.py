# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Contents of the benchmark's build folder: packages and the tree of another commit."""

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from clone import GitError, git

from bench.results import Context
from fnn_ekf_ros.errors import FnnEkfError

REQUIREMENTS = "requirements-bench.txt"
"""File with the packages that only the benchmark uses."""


def packages_folder(build: Path) -> Path:
    """Return the folder of the packages that only the benchmark uses."""
    return build / "packages"


def packages(context: Context) -> Path:
    """Install what the requirements say, unless that is done, and return the folder.

    Raises:
        FnnEkfError: pip fails.
    """
    folder, wanted = packages_folder(context.build), context.root / REQUIREMENTS
    done = folder / REQUIREMENTS
    if done.is_file() and done.read_bytes() == wanted.read_bytes():
        return folder
    context.say(f"installing {REQUIREMENTS} into {folder}")
    command = [
        sys.executable, "-m", "pip", "install", "--disable-pip-version-check", "--quiet",
        "--no-deps", "--upgrade", "--target", str(folder), "-r", str(wanted),
    ]  # fmt: skip
    ran = subprocess.run(command, capture_output=True, text=True, check=False)
    if ran.returncode:
        said = ran.stderr.strip().splitlines()[-1:]
        raise FnnEkfError(f"pip cannot install {REQUIREMENTS}: {' '.join(said)}")
    done.write_bytes(wanted.read_bytes())
    return folder


@contextmanager
def tree_of(context: Context, commit: str) -> Iterator[Path]:
    """Have the tree of a commit in a folder for the length of a block.

    Raises:
        FnnEkfError: the clone does not have the commit.
    """
    folder = context.build / "against"
    _remove(context, folder)
    try:
        git(context.root, "worktree", "add", "--detach", "--force", str(folder), commit)
    except GitError as error:
        raise FnnEkfError(f"--against {commit}: {error}") from None
    try:
        yield folder
    finally:
        _remove(context, folder)


def _remove(context: Context, folder: Path) -> None:
    """Remove a worktree, if there is one, and what git remembers of one that is gone."""
    for arguments in (("remove", "--force", str(folder)), ("prune",)):
        with suppress(GitError):
            git(context.root, "worktree", *arguments)
