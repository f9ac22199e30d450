# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The package's version.

The modules that look it up are imported in the functions: they would take 2 MB of every node.
"""

import re
from pathlib import Path

PACKAGE = "fnn_ekf_ros"
"""Name of the package."""
_ROOT = Path(__file__).resolve().parents[1]
"""Folder that holds the package: the clone's, or that of installed packages."""


def version() -> str:
    """Return the version of the code that runs; in a clone the commit too."""
    import subprocess

    manifest = _ROOT / "package.xml"
    if not ((_ROOT / ".git").exists() and manifest.is_file()):
        return _installed()
    stated = re.search(r"<version>(.*?)</version>", manifest.read_text(encoding="utf-8"))
    number = stated[1] if stated else _installed()
    command = ["git", "-C", str(_ROOT), "describe", "--always", "--dirty"]
    try:
        said = subprocess.run(command, capture_output=True, text=True, check=True)  # noqa: S603
    except (OSError, subprocess.CalledProcessError):
        return number
    return f"{number}, commit {said.stdout.strip()}"


def _installed() -> str:
    import importlib.metadata

    try:
        return importlib.metadata.version(PACKAGE)
    except importlib.metadata.PackageNotFoundError:
        return "not installed"
