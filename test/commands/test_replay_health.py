# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""What replay says of the health of a run: lines, exit code, parameters, JSON."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import Refuse, Succeed, parameters_of

from fnn_ekf_ros.parameters.files import read_parameter_file
from fnn_ekf_ros.parameters.localizer import LocalizerParameters
from fnn_ekf_ros.parameters.schema import build
from fnn_ekf_ros.recordings.bag_files import BagReader
from fnn_ekf_ros.stopping import UNHEALTHY

Run = Callable[..., Any]
INVERTED = ("-p", "left_inverted:=true")


@pytest.mark.slow
def test_a_healthy_run_is_four_lines_and_passes_strictly(
    tmp_path: Path, recorded: Path, succeed: Succeed
) -> None:
    words = ["--params", parameters_of(recorded), "--strict"]
    lines = succeed("replay", recorded, tmp_path / "out", *words).splitlines()
    assert len(lines) == 4
    assert " odom from " in lines[0]
    assert lines[1] == "health: good, every status OK"


@pytest.mark.slow
def test_a_wrong_configuration_fails_strictly_and_is_said(
    tmp_path: Path, succeed: Succeed, run: Run
) -> None:
    driven = tmp_path / "driven"
    succeed("simulate", driven, "--duration", "45")
    words = ["--params", parameters_of(driven), *INVERTED, "-p", "adaptation:=none"]
    ran = run("replay", driven, tmp_path / "out", *words, "--strict")
    assert (ran.code, ran.err) == (UNHEALTHY, "")
    _, health, *rest = ran.out.splitlines()
    assert health.startswith("health: not good")
    assert rest[-1].startswith("certain: the left counter runs the other way ")
    assert rest[-1].endswith("; left_inverted: false")
    assert (tmp_path / "out").is_dir(), "the work was done"


def test_a_recording_that_is_too_short_to_tell_is_no_fault(
    tmp_path: Path, succeed: Succeed
) -> None:
    driven, findings = tmp_path / "driven", tmp_path / "findings.json"
    succeed("simulate", driven, "--duration", "6")
    words = ["--params", parameters_of(driven)]
    assert "too few readings" in succeed("doctor", driven, *words)
    succeed("replay", driven, tmp_path / "out", *words, "--strict", "--json", findings)
    assert json.loads(findings.read_text())["findings"] == []


@pytest.mark.slow
def test_saved_parameters_are_those_that_were_found_and_can_be_replayed(
    tmp_path: Path, recorded: Path, succeed: Succeed
) -> None:
    """The noise at the end of the run is that of ~/noise, as no alarm is active."""
    file, numbers = tmp_path / "found.yaml", tmp_path / "health.json"
    words = ["--params", parameters_of(recorded), "-p", "measurement_noise_std:=[0.5, 0.5, 0.67]"]
    words += ["-p", "adaptation:=rq"]
    out = tmp_path / "out"
    succeed("replay", recorded, out, *words, "--save-params", file, "--json", numbers)
    with BagReader(out) as bag:
        *_, last = (bag.message(record).data for record in bag.records({"/localizer/noise"}))
    saved = build(LocalizerParameters, read_parameter_file(file, "localizer"))
    assert file.read_text().startswith("# Localizer parameters for the robot of recorded.\n")
    assert saved.process_noise_std == pytest.approx(np.sqrt(last[4:6]), rel=1e-3)
    assert saved.measurement_noise_std == pytest.approx(np.sqrt(last[:3]), rel=1e-3)
    assert saved.measurement_noise_std[0] < 0.45
    assert (saved.adaptation, saved.wheel_separation) == ("rq", 0.6)
    plain = json.loads(numbers.read_text())
    assert tuple(plain["found_parameters"]["process_noise_std"]) == saved.process_noise_std
    assert plain["odom"] > 30
    again = ["--params", file, "--json", tmp_path / "again.json"]
    succeed("replay", recorded, tmp_path / "again", *again)
    configured = json.loads((tmp_path / "again.json").read_text())["noise_std"]["distance"]
    assert configured["configured"] == saved.process_noise_std[0]


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["--json", "{tmp}/a", "--save-params", "{tmp}/a"], "--json '{tmp}/a': is an input or"),
        (["--json", "{tmp}/no/a"], "--json '{tmp}/no/a': there is no folder '{tmp}/no'"),
        (["--save-params", "{params}"], "--save-params '{params}': is an input or another result"),
        (["--save-params", "{tmp}"], "--save-params '{tmp}': is a folder"),
    ],
)
def test_files_that_cannot_be_written_are_refused_before_the_work(
    tmp_path: Path, recorded: Path, refuse: Refuse, words: list[str], expected: str
) -> None:
    names = {"tmp": str(tmp_path), "params": str(parameters_of(recorded))}
    given = [word.format(**names) for word in words]
    line = refuse("replay", recorded, tmp_path / "out", "--params", parameters_of(recorded), *given)
    assert expected.format(**names) in line


@pytest.mark.slow
def test_a_replay_that_fails_writes_no_files(
    tmp_path: Path, recorded: Path, refuse: Refuse
) -> None:
    words = ["--params", parameters_of(recorded), "-p", "frame_id:=elsewhere"]
    files = ["--json", tmp_path / "a.json", "--save-params", tmp_path / "a.yaml"]
    assert "gives no odom" in refuse("replay", recorded, tmp_path / "out", *words, *files)
