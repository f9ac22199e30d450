# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Work in several processes: what comes back, how it fails, and that nothing is left."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from multiprocessing import active_children
from pathlib import Path

import pytest
from answering import adding
from commands import HEARS_SIGINT

from fnn_ekf_ros.errors import FnnEkfError
from fnn_ekf_ros.study.monte_carlo import STUDIES
from fnn_ekf_ros.study.workers import Workers, available_cpus, in_any_order

ENDS_WITHIN_S = 30.0


@pytest.mark.parametrize("jobs", [1, 2])
def test_every_request_is_answered(jobs: int) -> None:
    requests = [(f"request {number}", number) for number in range(5)]
    found = dict(in_any_order(jobs, adding, requests, 100))
    assert found == {number: 100 + number for number in range(5)}
    assert not list(in_any_order(jobs, adding, [], 100))
    assert not active_children()


@pytest.mark.parametrize("jobs", [1, 2])
def test_an_error_is_one_line(jobs: int) -> None:
    requests = [("the first", 1), ("the second", "bug")]
    expected = r"^the second failed: ZeroDivisionError: one line and another \(answering.py:\d+\)$"
    with pytest.raises(FnnEkfError, match=expected):
        list(in_any_order(jobs, adding, requests, 0))
    assert not active_children()


def test_a_lack_of_memory_and_a_killed_process_end_the_work() -> None:
    with Workers(1, adding, 0) as workers:
        workers.give(workers.idle[0], "memory", "much")
        with pytest.raises(MemoryError):
            workers.answers()
    with Workers(1, adding, 0) as workers:
        workers.give(workers.idle[0], "killed", "bad luck")
        with pytest.raises(FnnEkfError, match=r"^bad luck: its process ended with SIGKILL, as"):
            workers.answers()
    assert not active_children()


def test_processes_use_one_thread_and_leave_ctrl_c_to_the_command() -> None:
    before = signal.getsignal(signal.SIGINT), os.environ.get("OPENBLAS_NUM_THREADS")
    with Workers(1, adding, 0) as workers:
        workers.give(workers.idle[0], "state", "")
        ((_, said),) = workers.answers()
    assert said == (signal.SIG_IGN, "1")
    assert (signal.getsignal(signal.SIGINT), os.environ.get("OPENBLAS_NUM_THREADS")) == before


@pytest.mark.slow
def test_a_study_comes_out_the_same_with_any_number_of_processes(
    tmp_path: Path, succeed: Callable[..., str], monkeypatch: pytest.MonkeyPatch
) -> None:
    undrawn = STUDIES["grid"]._replace(figures=lambda *_: None)
    monkeypatch.setitem(STUDIES, "grid", undrawn)
    written = []
    for jobs in (1, 2):
        out = tmp_path / str(jobs)
        succeed(
            "study", "grid", "--out", out, "--runs", 2, "--steps", 10, "--jobs", jobs,
            "--filters", "dead_reckoning,joint,rq_published",
        )  # fmt: skip
        written.append({path.name: path.read_bytes() for path in out.iterdir()})
    assert written[0] == written[1]
    assert not active_children()


def test_the_default_is_the_number_of_cpus_that_may_be_used() -> None:
    assert 1 <= available_cpus() <= (os.cpu_count() or 1)


@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="looks into /proc")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGKILL])
@pytest.mark.slow
def test_no_process_outlives_the_command(tmp_path: Path, number: signal.Signals) -> None:
    words = ["study", "grid", "--out", str(tmp_path), "--jobs", "2", "--runs", "50"]
    command = subprocess.Popen(
        [*HEARS_SIGINT, sys.executable, "-m", "fnn_ekf_ros", *words],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True,
    )  # fmt: skip
    try:
        children = Path(f"/proc/{command.pid}/task/{command.pid}/children")
        while len(children.read_text().split()) < 3:  # two, and that of multiprocessing itself
            assert command.poll() is None
            time.sleep(0.02)
        os.killpg(command.pid, number) if number is signal.SIGINT else command.send_signal(number)
        out, err = command.communicate(timeout=ENDS_WITHIN_S)  # all who could write have ended
        assert out == ""
        if number is signal.SIGINT:
            assert (command.returncode, err) == (130, "")
        until = time.monotonic() + ENDS_WITHIN_S
        while group_exists(command.pid):
            assert time.monotonic() < until
            time.sleep(0.02)
    finally:
        if group_exists(command.pid):
            os.killpg(command.pid, signal.SIGKILL)
        command.wait()


def group_exists(group: int) -> bool:
    try:
        os.killpg(group, 0)
    except ProcessLookupError:
        return False
    return True
