# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""`make demo` that is ended while it plays leaves no process and no file behind."""

import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from places import ROOT

pytestmark = pytest.mark.live


def children(process: int) -> dict[int, str]:
    """Return the command lines of the processes that a process has started."""
    found: dict[int, str] = {}
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            parent = int(stat.read_text().rpartition(")")[2].split()[1])
            if parent == process:
                found[int(stat.parent.name)] = (stat.parent / "cmdline").read_text()
        except (OSError, IndexError):
            continue  # it has just ended
    return found


def alive(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    return True


@pytest.mark.parametrize(
    ("word", "number", "code", "line"),
    [
        ("play", signal.SIGINT, 130, "demo: interrupted, demo/ stays as it was\n"),
        ("localizer", signal.SIGTERM, 143, ""),
    ],
)
def test_an_ended_demo_leaves_nothing(
    processes: Any,
    patiently: Callable[..., None],
    word: str,
    number: int,
    code: int,
    line: str,
) -> None:
    def hidden() -> set[Path]:
        return set(ROOT.glob(".demo.*"))

    before = hidden()
    process = subprocess.Popen(
        ["env", "--default-signal=INT", sys.executable, ROOT / "scripts" / "demo.py"],
        env={**processes.environment, "PYTHONPATH": str(ROOT)},
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    started: dict[int, str] = {}
    try:
        patiently(
            lambda: (
                started.update(children(process.pid))
                or any(f"fnn_ekf_ros\0{word}\0" in text for text in started.values())
            ),
            word,
        )
        process.send_signal(number)
        _, err = process.communicate(timeout=60.0)
    finally:
        process.kill()
        process.wait()
    assert (process.returncode, err) == (code, line)
    assert not [text for child, text in started.items() if alive(child)]
    assert hidden() == before
