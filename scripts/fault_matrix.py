# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The fault matrix: every fault through the live localizer, what it said and how far it was off.

Each row is a run of `fake_robot` and `localizer` as processes, on a ROS domain of its own, recorded
from their topics. Writes docs/faults.md and docs/faults.png if all rows are recorded by the same
code, and nothing otherwise. Recordings stay in build/faults.
"""

import argparse
import multiprocessing
import os
import signal
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from contextlib import contextmanager
from multiprocessing.connection import Connection
from multiprocessing.context import SpawnProcess
from pathlib import Path
from typing import Any

from command_line import exit_code
from faults.processes import run_row
from faults.recordings import Recordings, chosen, code_version
from faults.rows import ROWS, UNDISTURBED
from faults.scenarios import FaultScenario

import fnn_ekf_ros
from fnn_ekf_ros.errors import FnnEkfError
from fnn_ekf_ros.files.locks import lock
from fnn_ekf_ros.reports.pictures import require_matplotlib
from fnn_ekf_ros.stopping import exit_by_signal

ROOT = Path(__file__).resolve().parents[1]
"""Folder of the clone."""
OUT, TABLE, PICTURE = ROOT / "build" / "faults", ROOT / "docs" / "faults.md", "faults.png"
"""Folder of the recordings, the document, and the name of the picture beside it."""
SPAWN = multiprocessing.get_context("spawn")
"""Way in which processes are started: rclpy does not survive a fork."""
RATE, TICKS_SHARE = 6.0, 0.5
"""Rate of the first attempt [times real time], and the factor on it of rows with ticks: these are
stamped on arrival, which is less precise at a high rate."""
ATTEMPTS = 4
"""Largest number of attempts of a run whose processes met too late or were too slow; each is slower
than the one before."""


def tried(row: FaultScenario, domain: int, rate: float, made_by: str) -> str:
    """Run a row, several times if need be, and keep what was recorded.

    Returns:
        What was wrong, or nothing. Then an earlier recording of the row is kept.
    """
    recordings = Recordings(OUT, ROWS, UNDISTURBED)
    if row.ticks:
        rate *= TICKS_SHARE
    for attempt in range(ATTEMPTS):
        os.environ["ROS_DOMAIN_ID"] = str(1 + (domain + 37 * attempt) % 90)
        try:
            run_row(row, recordings.new_place(row), rate / 1.5**attempt)
        except FnnEkfError as error:
            reason = str(error)
            continue
        if code_version(ROOT) != made_by:
            return "the code was changed while it ran"
        recordings.keep(row, made_by)
        return ""
    return reason


def send_outcome(sender: Connection, *task: Any) -> None:
    """Run a row in this process and send what was wrong."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the command ends this process by SIGTERM
    exit_by_signal()
    try:
        reason = tried(*task)
    except Exception as error:
        reason = f"{type(error).__name__}: {error}"
    sender.send(reason)


class Processes:
    """Processes that are ended together; none is started after that."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._started: list[SpawnProcess] = []
        self._ended = False

    def start(self, process: SpawnProcess) -> None:
        """Start a process.

        Raises:
            FnnEkfError: the processes have been ended.
        """
        with self._lock:
            if self._ended:
                raise FnnEkfError("interrupted")
            process.start()
            self._started.append(process)

    def end(self) -> None:
        """Terminate all processes."""
        with self._lock:
            self._ended = True
            for process in self._started:
                process.terminate()


def in_a_process(processes: Processes, *task: Any) -> str:
    """Run a row in a process of its own; return what was wrong, or nothing.

    Raises:
        FnnEkfError: the processes have been ended.
    """
    receiver, sender = SPAWN.Pipe(duplex=False)
    process = SPAWN.Process(target=send_outcome, args=(sender, *task))
    processes.start(process)
    sender.close()
    try:
        return str(receiver.recv())
    except EOFError:
        process.join()
        return f"its process ended with {process.exitcode}"
    finally:
        process.join()
        receiver.close()


def run_all(rows: Sequence[FaultScenario], jobs: int, rate: float, made_by: str) -> list[str]:
    """Run rows, each in a process and on a domain of its own; show progress.

    Returns:
        The names of those that did not run.
    """
    began = time.monotonic()
    failed = []
    processes = Processes()
    with ThreadPoolExecutor(jobs) as pool:
        waiting = {
            pool.submit(in_a_process, processes, row, os.getpid() + number, rate, made_by): row
            for number, row in enumerate(rows)
        }
        try:
            for done, future in enumerate(as_completed(waiting), start=1):
                row, reason = waiting[future], future.result()
                if reason:
                    failed.append(row.name)
                seconds = time.monotonic() - began
                said = f": did not run: {reason}" if reason else ""
                print(f"{done:3d} of {len(rows)}, {seconds:4.0f} s: {row.name}{said}", flush=True)
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            processes.end()
            raise
    return failed


def rows_to_run(
    arguments: argparse.Namespace, recordings: Recordings, made_by: str
) -> list[FaultScenario]:
    """Return the rows that the arguments ask for.

    Raises:
        FnnEkfError: there are no such rows, or no document could be made with them.
    """
    if arguments.missing:
        return recordings.missing(made_by)
    if not arguments.only:
        return list(ROWS)
    rows = chosen(ROWS, arguments.only)
    missing = recordings.missing(made_by, but={row.name for row in rows})
    if missing:
        raise FnnEkfError(
            f"--only: {len(missing)} of the other {len(ROWS) - len(rows)} rows have no recording "
            f"by this code ({made_by}) in {OUT}, and docs/faults.md is made of "
            "one code's only: run `make faults`, or --missing for what is missing"
        )
    return rows


def parsed(argv: Sequence[str] | None) -> argparse.Namespace:
    """Return the command line, checked."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--jobs", type=int, default=1, help="rows at a time (1)")
    rate = f"times real time ({RATE:g}); a row that is too fast for the machine is run slower"
    parser.add_argument("--rate", type=float, default=RATE, help=rate)
    which = parser.add_mutually_exclusive_group()
    only = "run the rows with one of these in their names; all others have to be recorded already"
    which.add_argument("--only", nargs="+", metavar="WORD", help=only)
    missing = "run the rows that this code has not recorded yet, as after an interrupted run"
    which.add_argument("--missing", action="store_true", help=missing)
    recorded = "run nothing: write what the last recordings hold, whichever code has made them"
    which.add_argument("--recorded", action="store_true", help=recorded)
    arguments = parser.parse_args(argv)
    if arguments.jobs < 1:
        parser.error(f"--jobs {arguments.jobs}: expected 1 or more")
    if not 0.0 < arguments.rate <= 100.0:
        parser.error(f"--rate {arguments.rate:g}: expected more than 0, 100 at most")
    return arguments


@contextmanager
def alone() -> Iterator[None]:
    """Have the recordings to itself for the length of a block.

    Raises:
        FnnEkfError: another run has them.
        OSError: the folder cannot be made or used.
    """
    OUT.mkdir(parents=True, exist_ok=True)
    taken = FnnEkfError(f"another run is writing in {OUT}")
    with lock(OUT, os.O_RDONLY | os.O_DIRECTORY, taken):
        yield


@alone()
def made(arguments: argparse.Namespace) -> None:
    """Run what is asked for, and write the document if all rows are there.

    Raises:
        FnnEkfError: it cannot be done.
        OSError: a folder or a file cannot be written.
    """
    require_matplotlib()  # said before 20 minutes of runs, not after
    recordings = Recordings(OUT, ROWS, UNDISTURBED)
    recordings.remove_new()
    if not arguments.recorded:
        package = Path(fnn_ekf_ros.__file__).resolve().parent
        if package != ROOT / "fnn_ekf_ros":
            raise FnnEkfError(f"Python finds the package in {package}, not in this clone")
        made_by = code_version(ROOT)
        rows = rows_to_run(arguments, recordings, made_by)
        try:
            failed = run_all(rows, arguments.jobs, arguments.rate, made_by)
        finally:
            recordings.remove_new()
        if failed:
            raise FnnEkfError(
                f"{len(failed)} of {len(rows)} rows did not run, docs/faults.md stays as it was: "
                f"{'; '.join(failed)}"
            )
    recordings.write(TABLE, PICTURE)
    print(f"{TABLE}: {len(ROWS)} rows, {recordings.one_code()}")


def main(argv: Sequence[str] | None = None) -> int:
    """Run the matrix, or some rows of it, and write what came of it; return the exit code."""
    arguments = parsed(argv)
    exit_by_signal()
    interrupted = "docs/faults.md stays as it was; --missing goes on"
    return exit_code("fault_matrix", lambda: made(arguments), interrupted)


if __name__ == "__main__":
    sys.exit(main())
