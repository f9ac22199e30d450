# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Signals that come at any moment, also while the handler of another one runs."""

import signal
import subprocess
import sys
from collections.abc import Iterator

import pytest
from places import ROOT

from fnn_ekf_ros.stopping import STOPPED, Stop, exit_by_signal, stop_by_signal

INTERRUPTED_ANYWHERE = """
import signal, sys
from fnn_ekf_ros.stopping import STOPPED, stop_by_signal

def interrupt(frame, event, _):
    global count
    if event == "line":
        sys.settrace(None)
        signal.raise_signal(signal.SIGTERM)
        count += 1
        sys.settrace(interrupt)
    return interrupt

count = 0
stop_by_signal()
sys.settrace(interrupt)
signal.raise_signal(signal.SIGINT)
STOPPED.wait(0.001)
sys.settrace(None)
assert STOPPED.is_set()
print(count)
"""
"""Sends a signal before each line of the handler of another one, and of a wait."""


@pytest.fixture
def handlers() -> Iterator[None]:
    """Puts the handlers back that the test run had."""
    numbers = signal.SIGINT, signal.SIGTERM, signal.SIGHUP
    before = [signal.getsignal(number) for number in numbers]
    yield
    for number, handler in zip(numbers, before, strict=True):
        signal.signal(number, handler)


def test_a_signal_in_the_handler_of_another_one_waits_for_no_lock() -> None:
    run = subprocess.run(
        [sys.executable, "-c", INTERRUPTED_ANYWHERE],
        env={"PYTHONPATH": str(ROOT)}, capture_output=True, text=True, timeout=60.0,
    )  # fmt: skip
    assert run.returncode == 0, run.stderr
    assert int(run.stdout) >= 2


def test_a_stop_that_is_set_ends_a_wait() -> None:
    stop = Stop()
    assert not stop.wait(0.0)
    stop.set()
    assert stop.is_set()
    assert stop.wait(3600.0)


def test_the_second_signal_does_not_interrupt_the_cleanup(handlers: None) -> None:
    exit_by_signal()
    cleaned = False
    with pytest.raises(SystemExit) as ended:  # noqa: PT012
        try:
            signal.raise_signal(signal.SIGTERM)
        finally:
            signal.raise_signal(signal.SIGHUP)
            signal.raise_signal(signal.SIGTERM)
            cleaned = True
    assert cleaned
    assert ended.value.code == 128 + signal.SIGTERM


def test_signals_stop_a_node_as_often_as_they_come(
    handlers: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(STOPPED, "_set", False)
    stop_by_signal()
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGINT):
        signal.raise_signal(number)
        assert STOPPED.is_set()
