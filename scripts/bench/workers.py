# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Worker processes: a module of this folder in a process of its own, asked line by line.

A worker imports the package from a given tree, which may be that of another commit.
It answers a request, a line of JSON, with a line of JSON.
"""

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from child_processes import wait_or_kill

from bench.results import Context
from fnn_ekf_ros.errors import FnnEkfError

SCRIPTS = Path(__file__).resolve().parents[1]
"""Folder of the scripts."""
PATIENCE_S = 10.0
"""Longest wait for a process to end before it is killed [s]."""


class Worker:
    """A process that answers requests; a context manager.

    Args:
        context: has the folder for logs.
        module: the module of this folder that the process runs.
        tree: where it imports the package from.
        packages: folders of further packages that it sees.
    """

    def __init__(
        self, context: Context, module: str, tree: Path, packages: Sequence[Path] = ()
    ) -> None:
        self.name, self._log = module, context.build / "log" / f"{module}.log"
        self._log.parent.mkdir(parents=True, exist_ok=True)
        with self._log.open("wb") as log:
            self._process = subprocess.Popen(
                [sys.executable, "-m", f"bench.{module}"],
                cwd=context.build,  # not a folder that has a package of this name
                env=environment(tree, *packages),
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=log,
                text=True,
            )
        found = Path(self._answer()["package"])
        if not found.is_relative_to(tree):
            self.close()
            raise FnnEkfError(f"{module} finds the package in {found}, not in {tree}")

    def ask(self, **request: Any) -> Any:
        """Return the answer to a request.

        Raises:
            FnnEkfError: the process has ended.
        """
        if self._process.stdin is not None:
            self._process.stdin.write(json.dumps(request) + "\n")
            self._process.stdin.flush()
        return self._answer()

    def close(self) -> None:
        """End the process."""
        if self._process.stdin is not None:
            self._process.stdin.close()
        wait_or_kill(self._process, PATIENCE_S)
        if self._process.stdout is not None:
            self._process.stdout.close()

    def __enter__(self) -> Self:
        """Return the worker."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """End the process."""
        if error is not None:
            self._process.kill()
        self.close()

    def _answer(self) -> Any:
        line = self._process.stdout.readline() if self._process.stdout is not None else ""
        if not line:
            self._process.wait()
            said = self._log.read_text(errors="replace").strip().splitlines()[-1:]
            raise FnnEkfError(
                f"the process {self.name} ended with {self._process.returncode}: {' '.join(said)}"
            )
        return json.loads(line)


def environment(tree: Path, *packages: Path) -> dict[str, str]:
    """Return the environment of a process that imports the package from a tree."""
    path = os.pathsep.join(map(str, (tree, SCRIPTS, *packages)))
    return {**os.environ, "PYTHONPATH": path}


def serve(answer: Callable[..., Any]) -> None:
    """Answer requests from standard input until it ends; what a worker does.

    Args:
        answer: takes the fields of a request; returns what can be written as JSON.
    """
    import fnn_ekf_ros

    replies = os.fdopen(os.dup(sys.stdout.fileno()), "w")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())  # what the code under test prints is no reply
    replies.write(json.dumps({"package": str(Path(fnn_ekf_ros.__file__).resolve())}) + "\n")
    replies.flush()
    for line in sys.stdin:
        replies.write(json.dumps(answer(**json.loads(line))) + "\n")
        replies.flush()


def cpu_s() -> float:
    """Return the CPU time of this process since its start, of all its threads [s]."""
    return time.process_time()


def peak_mib(process: str = "self") -> float:
    """Return the largest resident memory of a process so far [MiB].

    `ru_maxrss` would not do: a child inherits it from the process that started it.
    """
    return _memory(process, "VmHWM")


def resident_mib(process: str = "self") -> float:
    """Return the resident memory of a process now [MiB]."""
    return _memory(process, "VmRSS")


def _memory(process: str, field: str) -> float:
    text = Path(f"/proc/{process}/status").read_text(encoding="ascii", errors="replace")
    (kib,) = (line.split()[1] for line in text.splitlines() if line.startswith(f"{field}:"))
    return int(kib) / 1024.0
