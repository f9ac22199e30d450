# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Nodes and commands that are ended, by one signal or by many, keep what they should."""

import itertools
import re
import signal
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from fnn_ekf_ros.recordings.bag_files import BagError, BagReader

pytestmark = pytest.mark.live
CHUNK = 150_000
"""An MCAP file that is so large has a chunk of messages [bytes]; the next one is being made."""


def end_impatiently(process: subprocess.Popen[str], numbers: tuple[int, ...]) -> int:
    """Send one signal after the other until a process has ended; return its exit code."""
    for number in itertools.cycle(numbers):
        process.send_signal(number)
        try:
            return process.wait(timeout=0.002)
        except subprocess.TimeoutExpired:
            pass
    raise AssertionError


@pytest.mark.parametrize(
    "numbers", [(signal.SIGINT,), (signal.SIGTERM,), (signal.SIGINT, signal.SIGTERM)]
)
def test_a_node_that_is_told_twice_stops_once(
    processes: Any, patiently: Callable[..., None], numbers: tuple[int, ...]
) -> None:
    """Also while Python ends: exit code 0, and the state is kept."""
    kept = processes.folder / "state.yaml"
    started = processes.start(
        "localizer", "--ros-args", "-p", "wheel_radius:=0.025", "-p", "wheel_separation:=0.6",
        "-p", "encoder_counts_per_revolution:=500.0", "-p", "initial_pose:=[1.0, 2.0, 0.5]",
        "-p", f"state_file:={kept}", "-p", "period:=0.05",
    )  # fmt: skip
    patiently(lambda: "encoders: no message" in processes.output(started), "a period")
    assert end_impatiently(started, numbers) == 0, processes.output(started)
    assert "Traceback" not in processes.output(started)
    assert "pose: [1.0, 2.0, 0.5]" in kept.read_text()


@pytest.mark.parametrize(
    ("number", "code", "again"),
    [
        (signal.SIGINT, 130, False),
        (signal.SIGTERM, 143, False),
        (signal.SIGTERM, 143, True),
        (signal.SIGHUP, 129, True),
    ],
)
def test_an_ended_command_leaves_nothing(
    processes: Any, patiently: Callable[..., None], number: int, code: int, again: bool
) -> None:
    """Ended once, or told again and again."""
    place = processes.folder / "place"
    place.mkdir()
    started = processes.start("simulate", place / "bag", "--duration", 100000)
    patiently(lambda: any(place.iterdir()), "the first file")
    if again:
        assert end_impatiently(started, (number,)) == code
    else:
        started.send_signal(number)
        assert started.wait(timeout=60.0) == code
    assert "Traceback" not in processes.output(started)
    assert not list(place.iterdir())


def grown(place: Path, size: int) -> bool:
    files = [file for kind in ("mcap", "db3") for file in place.glob(f".bag.????????/*/*.{kind}")]
    return sum(file.stat().st_size for file in files) >= size


@pytest.mark.parametrize(
    ("storage", "size"), [("mcap", 0), ("mcap", CHUNK), ("sqlite3", 1), ("sqlite3", 120_000)]
)
def test_a_killed_command_leaves_no_bag_under_its_name_and_hinders_no_other(
    processes: Any,
    patiently: Callable[..., None],
    storage: str,
    size: int,
) -> None:
    """The kill that no process can answer, at several moments of the writing."""
    place = processes.folder / "place"
    place.mkdir()
    killed = processes.start("simulate", place / "bag", "--duration", 100000, "--storage", storage)
    patiently(lambda: any(place.glob(".bag.????????")) and grown(place, size), "the file to grow")
    killed.send_signal(signal.SIGKILL)
    assert killed.wait(timeout=60.0) == -signal.SIGKILL
    (left,) = place.iterdir()
    assert left.name.startswith(".bag.")

    again = processes.run("simulate", place / "bag", "--duration", 5)
    assert (again.returncode, again.stderr) == (0, "")
    assert {entry.name for entry in place.iterdir()} == {left.name, "bag", "bag.yaml"}
    with BagReader(place / "bag") as bag:
        assert sum(1 for _ in bag.records()) == bag.message_count > 100


def test_what_a_killed_command_has_left_is_no_bag(
    processes: Any, patiently: Callable[..., None]
) -> None:
    place = processes.folder / "place"
    place.mkdir()
    killed = processes.start("simulate", place / "bag", "--duration", 100000)
    patiently(lambda: grown(place, CHUNK), "the file to grow")
    killed.send_signal(signal.SIGKILL)
    killed.wait(timeout=60.0)
    (file,) = place.glob(".bag.????????/**/*.mcap")
    with pytest.raises(BagError) as caught:
        BagReader(file)
    assert re.fullmatch(
        rf"bag '{re.escape(str(file))}' cannot be read: '{re.escape(str(file))}' breaks off after "
        r"[\d.]+ MB, its writer was ended too early; `mcap recover \S+ -o recovered.mcap` writes "
        "what is complete into a file that can be given instead",
        str(caught.value),
    )
    with pytest.raises(BagError, match=r"has no metadata\.yaml"):
        BagReader(file.parent)
