# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Mistakes that are put into a drive: what counts as named, and how far off a value is."""

import math
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest
from commands import Succeed
from examined_drives import drive, parameters

from fnn_ekf_ros.calibration.examination import Drive
from fnn_ekf_ros.parameters.fake_robot import FakeRobotParameters
from fnn_ekf_ros.recordings.drive_readings import DriveReadings
from fnn_ekf_ros.simulation.listening import listen
from fnn_ekf_ros.study.diagnosed_mistakes import (
    diagnosed,
    fits,
    numbers_of,
    true_numbers,
    with_effects,
    with_mistake,
)
from fnn_ekf_ros.study.mistakes import MISTAKES, Mistake, configured

BY_NAME = {mistake.name: mistake for mistake in MISTAKES}


@pytest.mark.parametrize("mistake", MISTAKES, ids=BY_NAME)
def test_each_mistake_is_named_in_a_good_drive_and_its_value_is_near(mistake: Mistake) -> None:
    """Signs and sizes of what faults do to the right numbers, and of their errors."""
    given = drive(3, 180.0, slip=(0.002, 0.002), compass_std=0.02)
    values = parameters(lrf_use_yaw=False)
    true = with_effects(numbers_of(values), mistake)
    found = diagnosed(mistake, with_mistake(given, mistake), mistake.configured(values), true)
    assert found.certainty
    assert found.others == ()
    if not math.isnan(found.error):
        assert abs(found.error) < 0.05


def test_a_value_that_is_off_and_another_finding_are_told() -> None:
    given = drive(3, 180.0, slip=(0.002, 0.002), compass_std=0.02)
    values, mistake = parameters(), BY_NAME["separation"]
    true = numbers_of(values)
    wrong = mistake.configured(values)
    double = true | {"wheel_separation": 2.0 * true["wheel_separation"]}
    assert diagnosed(mistake, given, wrong, double).error == pytest.approx(-0.5, abs=0.03)
    assert diagnosed(mistake, given, wrong, double).covered is False
    assert diagnosed(mistake, given, wrong, true).covered is True
    assert diagnosed(None, given, wrong, true).others == ("wheel_separation",)
    assert diagnosed(None, given, wrong, true, ["wheel_separation"]).others == ()
    missed = diagnosed(BY_NAME["swapped"], given, values, true)
    assert (missed.certainty, missed.covered) == ("", None)


IN_MESSAGES = [each.name for each in MISTAKES if each.faults or each.swapped]


@pytest.mark.parametrize("name", [name for name in IN_MESSAGES if name != "ratio"])
def test_mistakes_in_readings_are_those_in_messages(name: str) -> None:
    """What is put into a recorded drive is what the simulated robot sends.

    But for the one whose robot drives another way.
    """
    mistake, robot = BY_NAME[name], FakeRobotParameters(path="square", seed=4)

    def readings(made: Mistake | None) -> Drive:
        parameters = configured({}, robot, made)
        collected = DriveReadings(asdict(parameters))
        for heard in listen(robot, parameters, 10**9, 12.0, made.faults if made else ()):
            topic = made.topic(heard.topic) if made else heard.topic
            collected.take(topic, heard.message, heard.now_ns)
        return collected.drive()

    sent, put = readings(mistake), with_mistake(readings(None), mistake)
    for has, expected in zip(sent, put, strict=True):
        common = min(len(has), len(expected))  # late ones are still on their way
        assert common > 20
        np.testing.assert_allclose(has[:common], expected[:common], rtol=1e-9, atol=1e-9)


def test_right_numbers_of_a_robot_are_those_of_its_configuration_and_its_faults() -> None:
    robot = FakeRobotParameters()
    right = true_numbers(robot, None)
    assert true_numbers(robot, BY_NAME["ratio"])["right_over_left"] == pytest.approx(1.0 / 0.9)
    assert true_numbers(robot, BY_NAME["compass_ned"])["compass_offset"] == pytest.approx(
        right["compass_offset"] + 0.5 * math.pi
    )
    assert true_numbers(robot, BY_NAME["radius"]) == right


def test_a_mistake_needs_the_sensor_that_it_is_about() -> None:
    given = drive(1, 20.0)
    blind = given._replace(compass=given.compass[:0])
    fixed = given._replace(fixes=given.fixes * [1.0, 1.0, 1.0, 0.0])
    assert all(fits(mistake, given) for mistake in MISTAKES)
    assert not fits(BY_NAME["compass_offset"], blind)
    assert fits(BY_NAME["radius"], blind)
    assert not fits(BY_NAME["fix_yaw"], fixed)
    assert fits(BY_NAME["fixes_mm"], fixed)


def test_the_command_puts_mistakes_into_a_recording(tmp_path: Path, succeed: Succeed) -> None:
    bag, out = tmp_path / "drive", tmp_path / "out"
    succeed("simulate", bag, "--duration", 90, "-p", "slip_std:=[0.002, 0.002]")
    said = succeed("study", "mistakes", bag, "--out", out, "--mistakes", "counts_x4,swapped")
    assert said.startswith(
        f"{out}: 2 of 2 mistakes named by doctor, 1 of 1 values within 5%, 0 with another finding"
    )
    assert "| drive | counts_x4 |" in (out / "results.md").read_text()
