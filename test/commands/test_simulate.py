# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The command simulate, as from a shell."""

import math
import re
from collections import Counter
from pathlib import Path

import pytest
import yaml
from commands import Refuse, Succeed, contents
from places import FAULTS_EXAMPLE

from fnn_ekf_ros.messages import stamp_ns
from fnn_ekf_ros.parameters.files import read_parameter_file
from fnn_ekf_ros.parameters.localizer import LocalizerParameters
from fnn_ekf_ros.parameters.schema import build
from fnn_ekf_ros.recordings.bag_files import BagReader


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
@pytest.mark.slow
def test_simulate_twice_makes_the_same_bytes(
    tmp_path: Path, succeed: Succeed, storage: str
) -> None:
    made = []
    for folder, seed in (("one", 3), ("two", 3), ("three", 4)):
        (tmp_path / folder).mkdir()
        out = tmp_path / folder / "bag"
        succeed("simulate", out, "--duration", 5, "--storage", storage, "-p", f"seed:={seed}")
        assert sorted(p.name for p in out.parent.iterdir()) == ["bag", "bag.yaml"]
        made.append(contents(out) | {"yaml": out.with_name("bag.yaml").read_bytes()})
    assert made[0] == made[1]
    assert made[0] != made[2]


def test_simulate_writes_what_a_localizer_needs(tmp_path: Path, succeed: Succeed) -> None:
    out = tmp_path / "bag"
    said = succeed(
        "simulate", out, "--duration", 10, "-p", "wheel_radius:=0.1", "-p", "encoder_bits:=16",
        "-p", "path:=sim1", "-p", "compass_std:=0.3",
    )  # fmt: skip
    assert said.count("\n") == 1
    with BagReader(out) as bag:
        assert bag.duration_s == pytest.approx(10.0, abs=0.1)
        assert set(bag.topics) == {
            "/left_ticks", "/right_ticks", "/joint_states", "/compass", "/lrf_pose",
            "/ground_truth",
        }  # fmt: skip
    values = read_parameter_file(tmp_path / "bag.yaml", "localizer")
    parameters = build(LocalizerParameters, values)
    assert (parameters.wheel_radius, parameters.encoder_bits) == (0.1, 16)
    assert parameters.process_noise_std == (0.02, math.radians(1.0))
    assert parameters.measurement_noise_std == (0.1, 0.1, 0.3)


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["-p", "sede:=1"], "unknown parameter 'sede': did you mean 'seed'?"),
        (["-p", "seed:=one"], "parameter 'seed' is 'one': expected a whole number"),
        (["-p", "speed:=-1"], "parameter 'speed' is -1: expected a number from "),
        (
            ["-p", "lrf_rate:=0"],
            "parameter 'lrf_rate' is 0: expected a number from 0.1 to 100 [Hz]",
        ),
        (
            ["-p", "compass_rate:=101"],
            "parameter 'compass_rate' is 101: expected a number from 0.1",
        ),
        (
            ["-p", "encoder_rate:=100"],
            "parameter 'encoder_rate' is 100: expected a number from 0.1 to 80 [Hz]",
        ),
        (["-p", "path:=off"], "parameter 'path' is False: expected one of square, "),
        (["-p", "path:=cmd_vel"], "simulate has no cmd_vel"),
        (["-p", "slip_std:=[1]"], "parameter 'slip_std' is [1]: expected a list of 2 numbers"),
        (["-p", "seed"], "-p seed: expected name:=value"),
        (["--duration", "0"], "--duration 0: expected"),
        (["--duration", "nan"], "--duration nan: expected"),
        (["--duration", "1e9"], "--duration 1e+09: expected"),
        (["--params", "missing.yaml"], "parameter file 'missing.yaml' does not exist"),
        (["-p", "faults_file:=missing.yaml"], "faults_file 'missing.yaml' does not exist"),
    ],
)
def test_simulate_refuses(tmp_path: Path, refuse: Refuse, words: list[str], expected: str) -> None:
    assert expected in refuse("simulate", tmp_path / "bag", *words)


@pytest.mark.slow
def test_simulate_at_rates_of_its_own(tmp_path: Path, succeed: Succeed) -> None:
    out = tmp_path / "bag"
    rates = {"encoder_rate": 50, "compass_rate": 100, "lrf_rate": 0.5}
    words = [word for name, rate in rates.items() for word in ("-p", f"{name}:={rate}")]
    succeed("simulate", out, "--duration", 10, *words)
    with BagReader(out) as bag:
        counts = Counter(record.topic for record in bag.records())
    assert counts == {
        "/left_ticks": 500, "/right_ticks": 500, "/joint_states": 500, "/compass": 1000,
        "/lrf_pose": 5, "/ground_truth": 80,
    }  # fmt: skip


def test_simulate_overwrites_nothing(tmp_path: Path, refuse: Refuse) -> None:
    (tmp_path / "there").mkdir()
    (tmp_path / "other.yaml").write_text("mine")
    assert "exists already" in refuse("simulate", tmp_path / "there", "--duration", "1")
    assert "exists already" in refuse("simulate", tmp_path / "other", "--duration", "1")
    assert "does not exist" in refuse("simulate", tmp_path / "no" / "bag", "--duration", "1")


def test_simulate_into_the_folder_itself_is_refused(
    tmp_path: Path, refuse: Refuse, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for name in (".", "/"):
        assert "cannot be the name of a result" in refuse("simulate", name, "--duration", "1")


def test_simulate_refuses_a_wrong_timeline_of_faults(tmp_path: Path, refuse: Refuse) -> None:
    faults = tmp_path / "faults.yaml"
    faults.write_text("- {fault: slip, start: 1}\n- {fault: slip, start: -2}\n")
    said = refuse("simulate", tmp_path / "bag", "-p", f"faults_file:={faults}")
    assert said == (
        f"simulate: faults_file '{faults}', entry 2 (slip): parameter 'start' is -2: expected a "
        "number from 0 to 1000000000 [s]"
    )


@pytest.mark.slow
def test_simulate_with_faults_makes_the_same_bytes_twice(tmp_path: Path, succeed: Succeed) -> None:
    faults = tmp_path / "faults.yaml"
    # Ten times as fast, so that each fault has its turn.
    faults.write_text(
        re.sub(r"(start|duration): (\d+)\.0", r"\1: \2e-1", FAULTS_EXAMPLE.read_text())
    )
    made = []
    for name in ("one", "two"):
        (tmp_path / name).mkdir()
        out = tmp_path / name / "bag"
        said = succeed("simulate", out, "--duration", 30, "-p", f"faults_file:={faults}")
        assert f", faults of {faults}: 25; " in said
        made.append(contents(out))
    assert made[0] == made[1]
    metadata = yaml.safe_load((tmp_path / "one" / "bag" / "metadata.yaml").read_text())
    notes = metadata["rosbag2_bagfile_information"]["custom_data"]
    assert notes["faults"] == faults.read_text()
    assert f'faults_file: "{faults}"' in notes["fake_robot"]


@pytest.mark.slow
def test_bags_are_in_order_of_sending_whatever_the_stamps_say(
    tmp_path: Path, succeed: Succeed
) -> None:
    """A delayed fix is recorded when it is sent; a clock that jumps moves stamps only."""
    faults = tmp_path / "faults.yaml"
    faults.write_text(
        "- {fault: delay, topic: lrf_pose, start: 0, size: 0.5}\n"
        "- {fault: clock_jump, start: 5, size: -2}\n"
    )
    succeed("simulate", tmp_path / "bag", "--duration", 10, "-p", f"faults_file:={faults}")
    with BagReader(tmp_path / "bag") as bag:
        records = list(bag.records({"/lrf_pose", "/compass", "/left_ticks"}))
        times = [record.time_ns for record in records]
        assert times == sorted(times)
        assert times[-1] == 13 * 10**9
        lags = {
            topic: [
                record.time_ns - stamp_ns(bag.message(record))
                for record in records
                if record.topic == topic
            ]
            for topic in ("/lrf_pose", "/compass")
        }
    assert lags["/lrf_pose"] == [500_000_000] * 13 + [2_500_000_000] * 12
    assert lags["/compass"] == [0] * 39 + [2 * 10**9] * 41
