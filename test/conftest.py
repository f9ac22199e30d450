# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""What the unit tests share: parameters, localizers, simulated runs, commands and bags."""

import signal
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import hypothesis
import pytest

from fnn_ekf_ros.cli import run_command

# The same cases on every machine, however slow it is.
hypothesis.settings.register_profile("project", derandomize=True, deadline=None)
hypothesis.settings.load_profile("project")

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
"""What commands and nodes handle themselves."""


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Processes of pytest-xdist share the files, but live tests are run one after the other."""
    for item in items:
        live = item.get_closest_marker("live") is not None
        item.add_marker(pytest.mark.xdist_group("live" if live else item.path.name))


class Ran(NamedTuple):
    """How a command ended."""

    code: int
    out: str
    err: str


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str]) -> Iterator[Callable[..., Ran]]:
    """Runs a command as from a shell; afterwards signals do again what they did."""
    before = {number: signal.getsignal(number) for number in SIGNALS}

    def command(name: str, *argv: object) -> Ran:
        capsys.readouterr()
        code = run_command(name, [str(word) for word in argv])
        caught = capsys.readouterr()
        return Ran(code, caught.out, caught.err)

    yield command
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.fixture
def succeed(run: Callable[..., Ran]) -> Callable[..., str]:
    """Runs a command that must succeed and say nothing on stderr; returns what it prints."""

    def command(name: str, *argv: object) -> str:
        ran = run(name, *argv)
        assert (ran.code, ran.err) == (0, "")
        return ran.out

    return command


@pytest.fixture
def refuse(run: Callable[..., Ran], tmp_path: Path) -> Callable[..., str]:
    """Runs a command that must fail in one line and leave nothing behind; returns the line."""

    def command(name: str, *argv: object) -> str:
        before = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*")}
        ran = run(name, *argv)
        assert ran.code == 1
        assert ran.out == ""
        assert ran.err.startswith(f"{name}: ")
        assert ran.err.endswith("\n")
        assert ran.err.count("\n") == 1, ran.err
        assert "Traceback" not in ran.err
        after = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*")}
        assert after == before
        return ran.err.rstrip("\n")

    return command


@pytest.fixture(scope="session")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A simulated recording of 15 s; `recorded.yaml` beside it has the matching parameters."""
    out = tmp_path_factory.mktemp("recorded") / "recorded"
    assert run_command("simulate", [str(out), "--duration", "15", "-p", "seed:=5"]) == 0
    return out
