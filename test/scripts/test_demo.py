# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""`make demo` and scripts/write_examples.py: what they do with arguments, failures and folders."""

import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from fnn_ekf_ros.errors import FnnEkfError

pytest.importorskip("rclpy")

import demo
import write_examples

IGNORES_SIGTERM = (
    "import signal, time; signal.signal(signal.SIGTERM, signal.SIG_IGN); "
    "print('ready', flush=True); time.sleep(60)"
)


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A demo in a folder of its own whose parts only write a file each."""

    def part(name: str) -> Callable[[Path], None]:
        return lambda out: (out / name).write_text("new") and None

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(demo, "ROOT", tmp_path)
    monkeypatch.setattr(demo, "exit_by_signal", lambda: None)
    monkeypatch.setenv("ROS_DOMAIN_ID", "64")
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    monkeypatch.setattr(demo, "live", lambda out: part("file")(out.parent))
    monkeypatch.setattr(demo, "replay", part("replays"))
    monkeypatch.setattr(demo, "evaluate", part("tracks.png"))
    return tmp_path


def with_results(place: Path) -> Path:
    """Put the results of an earlier demo there."""
    out = place / "demo"
    out.mkdir()
    (out / "old.png").write_text("good")
    return out


@pytest.mark.parametrize("script", [demo, write_examples])
@pytest.mark.parametrize(("argument", "code"), [("--help", 0), ("--bogus", 2), ("bogus", 2)])
def test_arguments_do_not_start_anything(
    place: Path, monkeypatch: pytest.MonkeyPatch, script: object, argument: str, code: int
) -> None:
    out = with_results(place)
    monkeypatch.setattr(write_examples, "SHOWN", (None,))
    with pytest.raises(SystemExit) as ended:
        script.main([argument])  # type: ignore[attr-defined]
    assert ended.value.code == code
    assert [path.name for path in out.iterdir()] == ["old.png"]


def test_results_replace_the_last_ones(place: Path) -> None:
    for _ in range(2):
        assert demo.main([]) == 0
    out = with_results(place / "demo")  # nested, so that it has to go as well
    assert demo.main([]) == 0
    assert not out.exists()
    names = {"file", "replays", "tracks.png"}
    assert {path.name for path in (place / "demo").iterdir()} == names
    assert [path.name for path in place.iterdir()] == ["demo"]


@pytest.mark.parametrize("part", ["live", "replay", "evaluate"])
@pytest.mark.parametrize(
    ("trouble", "code", "line"),
    [
        (FnnEkfError("play failed"), 1, "demo: play failed\n"),
        (OSError(28, "No space left on device"), 1, "demo: No space left on device\n"),
        (KeyboardInterrupt(), 130, "demo: interrupted, demo/ stays as it was\n"),
    ],
)
def test_a_run_that_fails_keeps_the_last_results(
    place: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    part: str,
    trouble: BaseException,
    code: int,
    line: str,
) -> None:
    def fail(_: Path) -> None:
        raise trouble

    out = with_results(place)
    monkeypatch.setattr(demo, part, fail)
    assert demo.main([]) == code
    assert capsys.readouterr().err == line
    assert [path.name for path in place.iterdir()] == ["demo"]
    assert [path.name for path in out.iterdir()] == ["old.png"]


def test_what_is_no_folder_is_not_replaced(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (place / "other").mkdir()
    for make in (
        lambda path: path.write_text("mine"),
        lambda path: path.symlink_to("other"),
        lambda path: path.symlink_to("nowhere"),
    ):
        make(place / "demo")
        assert demo.main([]) == 1
        assert capsys.readouterr().err == "demo: 'demo' is no folder: remove it first\n"
        (place / "demo").unlink()
    assert [path.name for path in place.iterdir()] == ["other"]


def test_a_folder_that_cannot_be_made_is_one_line(
    place: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise PermissionError(13, "Permission denied", "demo")

    monkeypatch.setattr(Path, "mkdir", refuse)
    assert demo.main([]) == 1
    assert capsys.readouterr().err == "demo: 'demo': Permission denied\n"


def test_a_process_that_does_not_end_is_killed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(demo, "STOPPING_S", 0.2)
    arguments = [sys.executable, "-c", IGNORES_SIGTERM]
    with demo.running(arguments, stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        with process.stdout as output:
            assert output.readline() == "ready\n"
    assert process.returncode == -signal.SIGKILL


def test_a_signal_while_a_process_is_started_ends_it(monkeypatch: pytest.MonkeyPatch) -> None:
    started = []

    class Interrupted(subprocess.Popen):  # type: ignore[type-arg]
        def __init__(self, *arguments: object, **options: object) -> None:
            signal.raise_signal(signal.SIGINT)
            super().__init__(*arguments, **options)  # type: ignore[call-overload]
            started.append(self)

    monkeypatch.setattr(demo.subprocess, "Popen", Interrupted)
    handlers = [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)]
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with (
            pytest.raises(KeyboardInterrupt),
            demo.running([sys.executable, "-c", "import time; time.sleep(60)"]),
        ):
            pytest.fail("the block was entered")
    finally:
        signal.signal(signal.SIGINT, before)
    assert [process.returncode for process in started] == [-signal.SIGTERM]
    assert [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)] == handlers
