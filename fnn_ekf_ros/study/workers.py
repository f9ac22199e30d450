# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Processes that work for a command, one request at a time each.

They are started anew instead of forked, so that they hold nothing of the command's but what is
sent to them, and end with it, however it ends.
"""

import os
import pickle
import signal
import threading
import traceback
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from multiprocessing import connection, get_context, parent_process, resource_tracker
from multiprocessing.connection import Connection
from multiprocessing.context import SpawnProcess
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple, Self

from fnn_ekf_ros.errors import FnnEkfError

SPAWN = get_context("spawn")
"""Way in which processes are started: anew, not forked."""
ONE_THREAD = dict.fromkeys(
    ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "BLIS_NUM_THREADS"), "1"
)
"""Environment of the processes: each has one CPU, and small matrices gain nothing by threads."""
ENDING = {
    getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)
}
"""Signals that end a command."""

Serve = Callable[[Any], Any]
"""Answers a request."""


class WorkError(FnnEkfError):
    """Work that failed; in one sentence."""


class _Failure(NamedTuple):
    """Reply of a process that has no answer.

    Attributes:
        message: what is wrong.
        out_of_memory: whether that is all there is to say.
    """

    message: str
    out_of_memory: bool = False


class Worker(NamedTuple):
    """A process that answers requests.

    Attributes:
        process: the process.
        pipe: to it.
    """

    process: SpawnProcess
    pipe: Connection


def available_cpus() -> int:
    """Return the number of CPUs that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


@contextmanager
def one_line(what: str) -> Iterator[None]:
    """Turn every error into one sentence that names what failed, but for a lack of memory.

    Raises:
        WorkError: in place of an error that is none of the user's.
    """
    try:
        yield
    except (FnnEkfError, MemoryError, OSError):
        raise
    except Exception as error:
        at = traceback.extract_tb(error.__traceback__)[-1]
        said = " ".join(f"{type(error).__name__}: {error}".split())
        where = f"{Path(at.filename).name}:{at.lineno}"
        raise WorkError(f"{what} failed: {said} ({where})") from error


class Workers:
    """Processes that answer requests; leaving the context ends them, whatever they do.

    Attributes:
        idle: those that have no request.
        busy: those that have one, each with what it does, in words.
    """

    def __init__(self, count: int, make: Callable[..., Serve], *arguments: object) -> None:
        """Start the processes.

        Args:
            count: how many.
            make: called in each process; returns what answers the requests.
            arguments: for `make`; these, requests and answers can be pickled.
        """
        self.idle: list[Worker] = []
        self.busy: dict[Worker, str] = {}
        self._all: list[Worker] = []
        try:
            with _inherited():
                for _ in range(count):
                    self._start(make, arguments)
        except BaseException:
            self.end()
            raise
        self.idle += self._all

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        at: TracebackType | None,
    ) -> None:
        self.end()

    def _start(self, make: Callable[..., Serve], arguments: Sequence[object]) -> None:
        own, theirs = SPAWN.Pipe()
        with theirs:  # the end of a process then shows as the end of what can be read
            process = SPAWN.Process(target=_work, args=(theirs, make, arguments), daemon=True)
            process.start()
            self._all.append(Worker(process, own))

    def give(self, worker: Worker, request: object, what: str) -> None:
        """Send a request to an idle process.

        Args:
            worker: the process.
            request: for it.
            what: what it does, in words.

        Raises:
            WorkError: the process has ended.
        """
        self.idle.remove(worker)
        self.busy[worker] = what
        packed = pickle.dumps((what, request), pickle.HIGHEST_PROTOCOL)
        try:
            worker.pipe.send_bytes(packed)
        except OSError:
            raise self._ended(worker) from None

    def answers(self) -> list[tuple[Worker, Any]]:
        """Wait until some of the busy processes have answered; they are idle then.

        Raises:
            WorkError: work failed, or a process has ended.
            MemoryError: in one of the processes.
        """
        ready = connection.wait([worker.pipe for worker in self.busy])
        found = []
        for worker in [worker for worker in self.busy if worker.pipe in ready]:
            try:
                answer = worker.pipe.recv()
            except (EOFError, OSError):
                raise self._ended(worker) from None
            if isinstance(answer, _Failure):
                raise MemoryError if answer.out_of_memory else WorkError(answer.message)
            del self.busy[worker]
            self.idle.append(worker)
            found.append((worker, answer))
        return found

    def _ended(self, worker: Worker) -> WorkError:
        worker.process.join()
        code = worker.process.exitcode or 0
        how = f"exit code {code}"
        if code < 0:
            how = signal.Signals(-code).name
            if how == "SIGKILL":
                how += ", as where memory runs out: expected fewer --jobs, or less work"
        return WorkError(f"{self.busy[worker]}: its process ended with {how}")

    def end(self) -> None:
        """End the processes; they have nothing to clean up."""
        for worker in self._all:
            worker.process.kill()
        for worker in self._all:
            worker.process.join()
            worker.pipe.close()


def in_any_order(
    jobs: int, make: Callable[..., Serve], requests: Sequence[tuple[str, Any]], *arguments: object
) -> Generator[tuple[int, Any], None, None]:
    """Yield the number of each request and its answer, as they come.

    Args:
        jobs: processes; with one, the work is done here.
        make: returns what answers, in each process.
        requests: each with what it is, in words; those that take long should be the first.
        arguments: for `make`.
    """
    count = min(jobs, len(requests))
    if count <= 1:
        serve = make(*arguments)
        for number, (what, request) in enumerate(requests):
            with one_line(what):
                answer = serve(request)
            yield number, answer
        return
    waiting = iter(enumerate(requests))
    given: dict[Worker, int] = {}
    with Workers(count, make, *arguments) as workers:
        while True:
            for worker in list(workers.idle):
                for number, (what, request) in waiting:
                    given[worker] = number
                    workers.give(worker, request, what)
                    break
            if not workers.busy:
                return
            for worker, answer in workers.answers():
                yield given[worker], answer


@contextmanager
def _inherited() -> Iterator[None]:
    """Start processes that use one thread and leave Ctrl-C to this one, from their first moment.

    Signals wait until all are started: a process that is half started would report an error.
    """
    with ExitStack() as after:
        if threading.current_thread() is threading.main_thread():
            came: list[int] = []
            after.callback(_raise_signals, came)
            for number in ENDING:
                handler = signal.getsignal(number)
                if handler is not None:  # None: it is not one of Python's
                    after.callback(signal.signal, number, handler)
                    signal.signal(number, lambda number, _: came.append(number))
        if hasattr(signal, "pthread_sigmask"):
            resource_tracker.ensure_running()  # its start unblocks signals
            mask = signal.pthread_sigmask(signal.SIG_BLOCK, ENDING)
            after.callback(signal.pthread_sigmask, signal.SIG_SETMASK, mask)
        for name, value in ONE_THREAD.items():
            after.callback(_set_environment, name, os.environ.get(name))
            os.environ[name] = value
        yield


def _raise_signals(numbers: Sequence[int]) -> None:
    for number in numbers:
        signal.raise_signal(number)


def _set_environment(name: str, value: str | None) -> None:
    if value is None:
        del os.environ[name]
    else:
        os.environ[name] = value


def _work(pipe: Connection, make: Callable[..., Serve], arguments: Sequence[object]) -> None:
    """Answer requests until there are no more; in a process of its own."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # at a terminal it comes to all processes
    if hasattr(signal, "pthread_sigmask"):
        signal.pthread_sigmask(signal.SIG_UNBLOCK, ENDING)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    serve: Serve | None = None
    while True:
        try:
            what, request = pipe.recv()
        except (EOFError, OSError):
            return
        answer: object
        try:
            with one_line(what):
                serve = serve or make(*arguments)
                answer = serve(request)
        except MemoryError:
            answer = _Failure("", out_of_memory=True)
        except (FnnEkfError, OSError) as error:
            answer = _Failure(str(error))
        pipe.send(answer)


def _end_with_parent() -> None:
    """End this process once the one that started it has ended, even if that was killed."""
    parent = parent_process()
    if parent is not None:
        connection.wait([parent.sentinel])
        os._exit(1)
