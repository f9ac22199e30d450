# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Exit codes, and signals: a node stops between two messages, a command leaves nothing behind.

Only the first signal counts: a later one must not interrupt the cleanup. While Python ends it takes
its handlers back, so that signals have to be ignored by then, or one would end the process.
"""

import atexit
import signal
import sys
import time
from collections.abc import Callable, Sequence
from types import FrameType

FAILURE = 1
"""Exit code after an error that is printed."""
UNHEALTHY = 3
"""Exit code of a command that did its work, but was asked to fail if a run is not healthy; 2 is
that of an unknown option."""
INTERRUPTED = 130
"""Exit code after SIGINT, as shells have it: 128 and the number of the signal."""
SLICE_S = 0.05
"""Longest time between two looks of `Stop.wait` [s]: a node that is told to stop waits so long."""


class Stop:
    """A flag that a signal handler may set at any moment.

    It has no lock, as that of `threading.Event` has: a handler that interrupts the thread which
    holds the lock, be it another handler, would wait for it forever.
    """

    def __init__(self) -> None:
        self._set = False

    def is_set(self) -> bool:
        """Return whether it was set."""
        return self._set

    def set(self) -> None:
        """Set it."""
        self._set = True

    def wait(self, timeout_s: float) -> bool:
        """Wait until it is set or a time [s] is over; return whether it is set."""
        end_s = time.monotonic() + timeout_s
        while not self._set and (left_s := end_s - time.monotonic()) > 0.0:
            time.sleep(min(left_s, SLICE_S))
        return self._set


STOPPED = Stop()
"""Set by SIGINT and SIGTERM after `stop_by_signal`."""
_EXITS: list[int] = []
"""The signal that ends this command, once it has come."""
_STOPPING = signal.SIGINT, signal.SIGTERM
"""Signals that stop a node; SIGHUP ends it at once, as its terminal is gone."""
_EXITING = signal.SIGTERM, signal.SIGHUP
"""Signals that end a command by an exception, as Python lets SIGINT do."""


def stop_by_signal() -> None:
    """Let SIGINT and SIGTERM set `STOPPED`, from the first moment to the last."""
    _handle(_STOPPING, _stop)


def exit_by_signal() -> None:
    """Let SIGTERM and SIGHUP end the process as SIGINT does, with all cleanup."""
    _EXITS.clear()
    _handle(_EXITING, _exit)


def _handle(
    numbers: Sequence[signal.Signals], handler: Callable[[int, FrameType | None], None]
) -> None:
    for number in numbers:
        signal.signal(number, handler)
    atexit.register(_ignore, numbers)


def _stop(_: int, __: FrameType | None) -> None:
    STOPPED.set()


def _exit(number: int, _: FrameType | None) -> None:
    if not _EXITS:
        _EXITS.append(number)
        sys.exit(128 + number)


def _ignore(numbers: Sequence[signal.Signals]) -> None:
    for number in numbers:
        signal.signal(number, signal.SIG_IGN)
