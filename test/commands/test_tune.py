# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The command tune: from a recording to a parameter file that replay takes."""

import json
from pathlib import Path

import pytest
from commands import Refuse, Succeed
from places import BAGS

from fnn_ekf_ros.parameters.files import read_parameter_file
from fnn_ekf_ros.parameters.localizer import NODE_NAME


@pytest.mark.slow
def test_what_is_tuned_can_be_replayed(tmp_path: Path, succeed: Succeed) -> None:
    pytest.importorskip("matplotlib")
    bag, out = tmp_path / "drive", tmp_path / "localizer.yaml"
    succeed("simulate", bag, "--duration", 60, "-p", "path:=round", "-p", "compass_rate:=2.6667")
    said = succeed(
        "tune", bag, "--output", out, "--plot", tmp_path / "p.png", "--json", tmp_path / "n.json"
    )
    first, header, *_ = said.splitlines()
    assert first == "drive: white errors"
    assert header.split() == ["parameter", "now", "found", "95", "%", "interval", "unit"]
    for name in ("process_noise_std[1]", "measurement_noise_std[0]", "measurement_noise_std[2]"):
        assert name in said
    assert "The longest recording has" in said
    assert (tmp_path / "p.png").read_bytes().startswith(b"\x89PNG")
    numbers = json.loads((tmp_path / "n.json").read_text())
    assert numbers["errors_last"] is False
    assert {model["next_readings_trusted"] for model in numbers["models"].values()} <= {True, False}
    found = read_parameter_file(out, NODE_NAME)
    assert found["measurement_noise_std"] == numbers["parameters"]["measurement_noise_std"]
    assert found["measurement_noise_std"][0] == pytest.approx(0.1, rel=0.35)
    assert (
        found["wheel_radius"]
        == read_parameter_file(tmp_path / "drive.yaml", NODE_NAME)["wheel_radius"]
    )
    replayed = succeed("replay", bag, tmp_path / "again", "--params", out)
    assert "odom" in replayed


def test_recordings_of_different_robots_are_refused(tmp_path: Path, refuse: Refuse) -> None:
    line = refuse("tune", BAGS / "round", BAGS / "sim1", "--output", tmp_path / "o.yaml")
    assert "round and sim1 have different parameters: expected recordings of one robot" in line


def test_results_that_cannot_be_written_are_refused_before_any_work(
    tmp_path: Path, refuse: Refuse
) -> None:
    nowhere = tmp_path / "missing" / "o.yaml"
    assert "there is no folder" in refuse("tune", BAGS / "round", "--output", nowhere)
    same = tmp_path / "same"
    line = refuse("tune", BAGS / "round", "--output", same, "--json", same)
    assert "is an input or another result" in line


def test_a_bag_without_fixes_is_refused(tmp_path: Path, refuse: Refuse) -> None:
    line = refuse("tune", BAGS / "round", "-r", "lrf_pose:=/nothing")
    assert "has no topic /nothing" in line
