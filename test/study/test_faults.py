# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""`study faults`: what it measures, what it writes, and what it refuses."""

import json
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from fnn_ekf_ros.membership.files import networks_for
from fnn_ekf_ros.parameters.fake_robot import FakeRobotParameters
from fnn_ekf_ros.parameters.localizer import LocalizerParameters
from fnn_ekf_ros.parameters.matching import matching_localizer
from fnn_ekf_ros.study.fault_naming import (
    NAMED_WITHIN_S,
    NAMING_CASES,
    ONSET_S,
    Setting,
    quiet_run,
    reports,
)
from fnn_ekf_ros.study.starts import RIGHT, Cell, with_noise_factors
from fnn_ekf_ros.timeline.events import Level, Sensor

SUBSET = ("compass_bias", "lrf_pose_nan")


def setting(seed: int, cell: Cell = RIGHT) -> Setting:
    robot = FakeRobotParameters(path="sim1", seed=seed)
    localizer = with_noise_factors(matching_localizer(robot), cell)
    return Setting(robot, localizer, networks_for(localizer))


def test_faults_have_names_of_their_own_and_every_sensor_has_some() -> None:
    assert len({case.name for case in NAMING_CASES}) == len(NAMING_CASES)
    assert {case.sensor for case in NAMING_CASES} == set(Sensor)
    for case in NAMING_CASES:
        assert all(fault.start == 50.0 for fault in case.faults(50.0))
        for fault in case.faults(50.0):
            wheels = case.sensor is Sensor.ENCODERS
            assert wheels or fault.targets() == (case.sensor,)


@pytest.mark.slow
def test_a_flat_tyre_is_told_by_its_wheel_and_its_size() -> None:
    (case,) = (case for case in NAMING_CASES if case.name == "flat_tyre")
    said = [
        status
        for report in reports(setting(2), 80.0, case.faults(40.0))
        if report.time_s >= 40.0
        for status in report.statuses
        if status.name == Sensor.ENCODERS and status.level is Level.WARN
    ]
    sizes = [
        float(dict(status.values)["left wheel's distance against its counts [%]"])
        for status in said
        if "the left wheel travels less than it counts" in status.message
    ]
    assert sizes, said
    assert min(sizes) < -5.0


@pytest.mark.slow
def test_a_robot_without_faults_is_well() -> None:
    quiet = quiet_run(setting(5), 40.0)
    assert 30 <= quiet.reports <= 40
    assert quiet.warned == 0, quiet.words


def test_a_start_is_told_a_wrong_noise() -> None:
    right, wrong = (setting(1, cell).localizer for cell in (RIGHT, Cell(25.0, 0.04)))
    assert wrong.process_noise_std == pytest.approx(np.multiply(right.process_noise_std, 5.0))
    assert wrong.measurement_noise_std == pytest.approx(
        np.multiply(right.measurement_noise_std, 0.2)
    )
    assert isinstance(wrong, LocalizerParameters)


@pytest.mark.slow
def test_the_command_names_each_failing_sensor_and_writes_tables_and_numbers(
    tmp_path: Path, succeed: Callable[..., str]
) -> None:
    out = tmp_path / "out"
    said = succeed(
        "study", "faults", "--out", out, "--runs", 1, "--faults", ",".join(SUBSET),
        "--quiet-runs", 1, "--quiet-seconds", 5, "--jobs", 2,
    )  # fmt: skip
    shares = (
        "of 2 faults named in time 2 (100.0%), before any other sensor 2 (100.0%), "
        "and no other at all 2 (100.0%)"
    )
    assert said == f"{out}: {shares}\n{out / 'results.md'}: the tables\n"
    found = json.loads((out / "results.json").read_text())
    assert found["faults"] == list(SUBSET)
    assert [row["fault"] for row in found["results"]] == list(SUBSET)
    assert all(row["alone"] and row["first"] and row["named"] for row in found["results"])
    assert all(0.0 <= row["named_s"] < NAMED_WITHIN_S / 3.0 for row in found["results"])
    (onset_s,) = {row["onset_s"] for row in found["results"]}
    assert ONSET_S[0] <= onset_s <= ONSET_S[1]
    assert len(found["quiet"]) == 5 * 2
    assert all(2 <= row["reports"] <= 5 for row in found["quiet"])
    tables = (out / "results.md").read_text()
    assert "`study faults --runs 1 --quiet-runs 1 --quiet-seconds 5 --seed 1 --faults" in tables
    assert "| compass_bias | off by 1.5 rad | compass | 1 of 1 | 1 | 1 |" in tables
    assert f"All: {shares}." in tables
    assert tables.count("| right start |") == 2
    assert len(re.findall(r"\| Q [x/] 25, R [x/] 25 \|", tables)) == 8


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (("--runs", 0), "--runs 0: expected 1 to 1000"),
        (("--jobs", 0), "--jobs 0: expected 1 to"),
        (("--quiet-seconds", 0), "--quiet-seconds 0: expected 1 to 3600"),
        (("--faults", "rust"), "--faults rust: expected some of stuck_wheel, "),
        (("-p", "period:=0"), "parameter 'period'"),
    ],
)
def test_what_makes_no_sense_is_refused(
    tmp_path: Path, refuse: Callable[..., str], words: tuple[object, ...], expected: str
) -> None:
    assert expected in refuse("study", "faults", "--out", tmp_path / "out", *words)
