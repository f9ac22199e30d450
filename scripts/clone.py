# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Git in a clone."""

import subprocess
from pathlib import Path

from fnn_ekf_ros.errors import FnnEkfError


class GitError(FnnEkfError):
    """Git is not installed, or refuses; its message is git's last line."""


def git(root: Path, *arguments: str) -> str:
    """Return what git prints in a clone, without blanks at the ends.

    Args:
        root: the clone's folder.
        arguments: the git command and its arguments.

    Raises:
        GitError: git is not installed, or refuses.
    """
    command = ["git", "-C", str(root), *arguments]
    try:
        ended = subprocess.run(command, capture_output=True, text=True, check=True)
    except OSError as error:
        raise GitError(f"git cannot be run: {error.strerror}") from None
    except subprocess.CalledProcessError as error:
        said = error.stderr.strip().splitlines()[-1:] or [f"exit code {error.returncode}"]
        raise GitError(f"git {arguments[0]}: {said[0]}") from None
    return ended.stdout.strip()
