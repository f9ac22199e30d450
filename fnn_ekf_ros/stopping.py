# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Exit codes, and signals: a node stops between two messages, a command leaves nothing behind."""

import signal
import sys
import threading
from types import FrameType

FAILURE = 1
"""Exit code after an error that is printed."""
UNHEALTHY = 3
"""Exit code of a command that did its work, but was asked to fail if a run is not healthy; 2 is
that of an unknown option."""
INTERRUPTED = 130
"""Exit code after SIGINT, as shells have it: 128 and the number of the signal."""
STOPPED = threading.Event()
"""Set by SIGINT and SIGTERM after `stop_by_signal`."""


def stop_by_signal() -> None:
    """Let SIGINT and SIGTERM set `STOPPED`, from the first moment on."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: STOPPED.set())


def exit_by_signal() -> None:
    """Let SIGTERM and SIGHUP end the process as SIGINT does, with all cleanup."""
    for number in (signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, _exit)


def _exit(number: int, _: FrameType | None) -> None:
    sys.exit(128 + number)
