# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""How a command ends that runs out of memory or cannot write what it has to say."""

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fnn_ekf_ros.commands import simulate

FULL = Path("/dev/full")


@pytest.mark.parametrize(
    ("error", "line"),
    [
        (MemoryError(), "simulate: out of memory"),
        (np.zeros, "simulate: out of memory"),
        (OSError(28, "No space left on device"), "simulate: No space left on device"),
        (
            PermissionError(13, "Permission denied", "a file"),
            "simulate: 'a file': Permission denied",
        ),
    ],
)
def test_what_the_machine_has_not_is_one_line(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    refuse: Callable[..., str],
    error: Any,
    line: str,
) -> None:
    def fail(_: object) -> int:
        if error is np.zeros:
            np.zeros(2**50)
        raise error

    monkeypatch.setattr(simulate, "run", fail)
    assert refuse("simulate", tmp_path / "out") == line


@pytest.mark.skipif(not FULL.exists(), reason="no /dev/full")
@pytest.mark.parametrize("words", [["--version"], ["--help"]])
def test_output_that_cannot_be_written_is_one_line(words: list[str]) -> None:
    with FULL.open("w") as full:
        ran = subprocess.run(
            [sys.executable, "-m", "fnn_ekf_ros", "replay", *words],
            stdout=full, stderr=subprocess.PIPE, text=True,
        )  # fmt: skip
    assert (ran.returncode, ran.stderr) == (1, "replay: No space left on device\n")


def test_output_that_nobody_reads_is_no_trouble() -> None:
    process = subprocess.Popen(
        [sys.executable, "-m", "fnn_ekf_ros", "replay", "--version"],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    assert process.stdout is not None
    process.stdout.close()
    assert process.stderr is not None
    with process.stderr as errors:
        assert errors.read() == ""
    assert process.wait(timeout=60.0) == 1
