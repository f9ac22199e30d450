# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Processes that a script starts, and how they are ended."""

import signal
import subprocess
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any


def wait_or_kill(process: subprocess.Popen[Any], patience_s: float) -> None:
    """Wait until a process has ended; end it by SIGKILL if that takes too long.

    Args:
        process: the process.
        patience_s: how long to wait before SIGKILL [s].
    """
    try:
        process.wait(timeout=patience_s)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


def end(process: subprocess.Popen[Any], number: signal.Signals, patience_s: float) -> None:
    """End a process by a signal, or by SIGKILL if that takes too long.

    Args:
        process: the process; it may have ended already.
        number: the signal.
        patience_s: how long to wait before SIGKILL [s].
    """
    process.send_signal(number)
    wait_or_kill(process, patience_s)


@contextmanager
def running_with_log(
    log: Path, arguments: Sequence[str], patience_s: float, **options: Any
) -> Iterator[subprocess.Popen[bytes]]:
    """Run a process for the length of a block, ended by SIGINT.

    Args:
        log: the file for what it prints.
        arguments: its command line.
        patience_s: how long to wait before SIGKILL [s].
        options: further arguments of `subprocess.Popen`.
    """
    with log.open("wb") as output:
        process = subprocess.Popen(arguments, stdout=output, stderr=subprocess.STDOUT, **options)
    try:
        yield process
    finally:
        end(process, signal.SIGINT, patience_s)
