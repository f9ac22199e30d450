# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The state file of a live localizer."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from std_srvs.srv import Trigger

from fnn_ekf_ros.localizer.state_file import read_state
from fnn_ekf_ros.ros import state_keeper as memory

pytestmark = pytest.mark.live

MakeBench = Callable[..., Any]
START = ("-p", "initial_pose:=[1.0, 2.0, 0.5]")


@pytest.fixture
def file(tmp_path: Path) -> Path:
    folder = tmp_path / "kept"
    folder.mkdir()
    return folder / "state.yaml"


def test_the_state_of_one_node_starts_the_next(
    bench: MakeBench, file: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    keep = ("-p", f"state_file:={file}")
    first = bench(*keep, *START)
    assert not file.exists()
    first.set_clock(5 * 10**9)
    first.spin_until(first.localizer.localizer.saved, "the start")
    first.close()
    saved = read_state(file, first.localizer.localizer.parameters).state
    np.testing.assert_array_equal(saved.pose, [1.0, 2.0, 0.5])

    second = bench(*keep, "-p", "warm_start:=true")
    said = capfd.readouterr().err
    assert "starting from the state of 20" in said
    assert re.search(r"; its pose is of \d+ s, which this clock has not reached", said)
    second.set_clock(7 * 10**9)
    second.spin_until(second.localizer.localizer.saved, "the warm start")
    np.testing.assert_array_equal(second.localizer.localizer.saved().pose, saved.pose)
    assert second.call(Trigger, "localizer/reset", Trigger.Request()).success
    assert second.localizer.localizer.saved() is None


def test_without_warm_start_the_file_is_written_only(bench: MakeBench, file: Path) -> None:
    keep = ("-p", f"state_file:={file}")
    first = bench(*keep, *START)
    first.set_clock(5 * 10**9)
    first.spin_until(first.localizer.localizer.saved, "the start")
    first.close()
    second = bench(*keep)
    second.set_clock(7 * 10**9)
    assert second.localizer.localizer.saved() is None


def test_the_state_is_written_while_the_node_runs(
    bench: MakeBench, file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(memory, "WRITE_INTERVAL_S", 0.02)
    opened = bench("-p", f"state_file:={file}", *START)
    opened.set_clock(5 * 10**9)
    opened.spin_until(file.exists, "the first write")
    opened.set_clock(9 * 10**9)

    def stamp_ns() -> int:
        return int(read_state(file, opened.localizer.localizer.parameters).state.stamp_ns)

    opened.spin_until(lambda: stamp_ns() > 8 * 10**9, "the next writes")


def test_a_broken_state_is_a_cold_start_and_said(
    bench: MakeBench, file: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    file.write_text("format_version: 1\n")
    (file.parent / ".state.yaml.0123456789ab").write_text("format_v")
    opened = bench("-p", f"state_file:={file}", "-p", "warm_start:=true", *START)
    warnings = [line for line in capfd.readouterr().err.splitlines() if "[WARN]" in line]
    assert len(warnings) == 2
    assert f"the last write of state_file '{file}' was cut off; there is no other" in warnings[0]
    assert f"state_file '{file}'" in warnings[1]
    assert "expected the parameters of the robot" in warnings[1]
    left = {entry.name for entry in file.parent.iterdir()}
    assert left == {file.name, f"{file.name}.lock"}
    opened.set_clock(5 * 10**9)
    opened.spin_until(opened.localizer.localizer.saved, "the cold start")
    opened.close()
    assert file.with_name("state.yaml.broken").read_text() == "format_version: 1\n"
    np.testing.assert_array_equal(
        read_state(file, opened.localizer.localizer.parameters).state.pose, [1.0, 2.0, 0.5]
    )


def test_a_write_that_fails_is_an_error_in_the_log(
    bench: MakeBench, file: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    opened = bench("-p", f"state_file:={file}", *START)
    opened.set_clock(5 * 10**9)
    opened.spin_until(opened.localizer.localizer.saved, "the start")
    file.with_name(f"{file.name}.lock").unlink()
    file.parent.rmdir()
    opened.close()
    errors = [line for line in capfd.readouterr().err.splitlines() if "[ERROR]" in line]
    assert len(errors) == 1
    assert f"the state is not kept: '{file}' cannot be written" in errors[0]


def test_a_second_node_does_not_use_the_same_file(
    bench: MakeBench, file: Path, processes: Any
) -> None:
    bench("-p", f"state_file:={file}", *START)
    ended = processes.run(
        "localizer", "--ros-args", "-r", "__ns:=/second", "-p", "wheel_radius:=0.025",
        "-p", "wheel_separation:=0.6", "-p", "encoder_counts_per_revolution:=500.0",
        "-p", f"state_file:={file}",
    )  # fmt: skip
    assert ended.returncode == 1
    assert ended.stderr.strip() == (
        f"localizer: parameter 'state_file' is '{file}', which another localizer uses: expected a "
        "file of its own for each"
    )


def test_a_place_without_a_folder_ends_the_node_with_one_line(processes: Any) -> None:
    ended = processes.run(
        "localizer", "--ros-args", "-p", "wheel_radius:=0.025", "-p", "wheel_separation:=0.6",
        "-p", "encoder_counts_per_revolution:=500.0", "-p", "state_file:=/nowhere/state.yaml",
    )  # fmt: skip
    assert ended.returncode == 1
    assert ended.stderr.strip() == (
        "localizer: parameter 'state_file' is '/nowhere/state.yaml': expected a file in a folder "
        "that is there and can be written to"
    )
