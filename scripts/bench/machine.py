# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Facts about a benchmark: machine, code, versions."""

import importlib.metadata
import os
import platform
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from clone import GitError, git

CODE = (
    "fnn_ekf_ros",
    "scripts/benchmarks.py",
    "scripts/bench",
    "scripts/child_processes.py",
    "requirements-bench.txt",
)
"""Files that decide the numbers; others may be changed."""


def facts(measured: str, packages: Path, against: str, began: str) -> dict[str, Any]:
    """Return what is said of machine, code and versions, by name.

    Args:
        measured: what `commit` said before.
        packages: folder of the packages that only the benchmark uses.
        against: the commit that batches are compared with.
        began: load average before.
    """
    return {
        "date": datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
        "commit": measured,
        "compared with": against,
        "CPU": cpu_model(),
        "cores": len(os.sched_getaffinity(0)),
        "OS": operating_system(),
        "versions": versions(packages),
        "load average before (1, 5, 15 min)": began,
        "load average after": load(),
    }


def commit(root: Path) -> str:
    """Return the commit of a clone, marked if the code that is measured differs from it."""
    try:
        name = git(root, "log", "-1", "--format=%h", "--abbrev=7")
        changed = git(root, "status", "--porcelain", "--", *CODE)
    except GitError:
        return "unknown: no clone"
    return f"{name} with changes that are not committed" if changed else name


def code(root: Path) -> str:
    """Return what is the same before and after only if the code that is measured is."""
    try:
        name = git(root, "log", "-1", "--format=%h", "--", *CODE)
        return name + git(root, "diff", "HEAD", "--", *CODE)
    except GitError:
        return ""


def versions(packages: Path) -> dict[str, str]:
    """Return the versions of what is measured with."""
    found = {"Python": platform.python_version()}
    for shown, names in {
        "numpy": ("numpy",),
        "rclpy": ("ros-jazzy-rclpy", "rclpy"),
        "rosbags": ("rosbags",),
    }.items():
        found[shown] = next(filter(None, map(_installed, names)), "not here")
    for of_bench in importlib.metadata.distributions(path=[str(packages)]):
        found[of_bench.metadata["Name"]] = of_bench.version
    return found


def cpu_model() -> str:
    """Return the CPU's name."""
    with suppress(OSError):
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()


def operating_system() -> str:
    """Return the system's name and that of its kernel."""
    with suppress(OSError):
        return f"{platform.freedesktop_os_release()['PRETTY_NAME']}, Linux {platform.release()}"
    return platform.platform()


def load() -> str:
    """Return the load averages of the last 1, 5 and 15 minutes."""
    return ", ".join(f"{value:.2f}" for value in os.getloadavg())


def _installed(name: str) -> str:
    with suppress(importlib.metadata.PackageNotFoundError):
        return importlib.metadata.version(name)
    return ""
