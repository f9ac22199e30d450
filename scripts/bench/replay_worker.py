# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Copies a bag as it is, or runs a command of the package, in a process that does nothing else."""

import runpy
import sys
from pathlib import Path
from typing import Any

from bench.workers import cpu_s, peak_mib, serve


def measure(bag: str = "", out: str = "", command: tuple[str, ...] = ()) -> dict[str, Any]:
    """Copy a bag, or run a command; return CPU time [s] and peak memory [MiB] of the process.

    The CPU time of a command includes its imports; that of a copy does not.
    """
    from bench import recording

    began = cpu_s()
    if command:
        run(list(command))
    else:
        recording.copy(Path(bag), Path(out))
    return {"cpu_s": cpu_s() - began, "peak_mib": peak_mib()}


def run(command: list[str]) -> None:
    """Run `python -m fnn_ekf_ros` with these words in this process.

    Raises:
        RuntimeError: it fails.
    """
    sys.argv = ["fnn_ekf_ros", *command]
    try:
        runpy.run_module("fnn_ekf_ros", run_name="__main__", alter_sys=True)
    except SystemExit as ended:
        if ended.code:
            raise RuntimeError(f"{' '.join(command)} ended with {ended.code}") from None


if __name__ == "__main__":
    serve(measure)
