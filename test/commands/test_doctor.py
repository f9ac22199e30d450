# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The command doctor: what it prints and writes, and whether its corrections are right."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import Refuse, Succeed
from examined_drives import RADIUS, SEPARATION, drive
from recorded_drives import write_bag

from fnn_ekf_ros import cli
from fnn_ekf_ros.parameters.files import read_parameter_file
from fnn_ekf_ros.parameters.localizer import NODE_NAME

GEOMETRY = [
    "-p", f"wheel_radius:={RADIUS}", "-p", f"wheel_separation:={SEPARATION}",
    "-p", "encoder_counts_per_revolution:=2000.0",
]  # fmt: skip


def report(path: Path, *words: object) -> dict[str, Any]:
    """Return the JSON of a run, and whether its exit code says that replay would work."""
    result = path.with_suffix(".json")
    words = ("--json", result, "--force", *words)
    code = cli.run_command("doctor", [str(path), *map(str, words)])
    content: dict[str, Any] = json.loads(result.read_text())
    assert code == (0 if content["replay_works"] else 1)
    return content


def names(content: dict[str, Any]) -> list[str]:
    return [each["name"] for each in content["findings"] if each["certainty"] != "possible"]


def test_a_right_robot_gets_a_clean_bill(tmp_path: Path, succeed: Succeed) -> None:
    write_bag(tmp_path / "bag", drive(1, 40.0))
    out = succeed("doctor", tmp_path / "bag", *GEOMETRY)
    assert "Nothing is wrong with robot, wiring or configuration" in out
    assert "replay would work." in out
    row = next(line for line in out.splitlines() if line.startswith("/lrf_pose"))
    assert row.split()[1:] == [
        "geometry_msgs/msg/PoseWithCovarianceStamped", "100", "2.50", "0.40", "0.000", "map",
    ]  # fmt: skip


def test_corrections_that_it_writes_give_a_clean_bill(tmp_path: Path) -> None:
    write_bag(tmp_path / "bag", drive(2, 40.0))
    wrong = [*GEOMETRY, "-p", "left_inverted:=true", "-p", f"wheel_radius:={2 * RADIUS}"]
    fixed = tmp_path / "fixed.yaml"
    first = report(tmp_path / "bag", *wrong, "--write-params", fixed)
    assert set(names(first)) == {"left_inverted", "meters_per_count"}
    assert read_parameter_file(fixed, NODE_NAME)["left_inverted"] is False
    assert names(report(tmp_path / "bag", "--params", fixed)) == []


def test_lengths_in_millimeters_are_put_right(tmp_path: Path) -> None:
    write_bag(tmp_path / "bag", drive(3, 40.0))
    wrong = [*GEOMETRY, "-p", f"wheel_separation:={1000.0 * SEPARATION}"]
    fixed = tmp_path / "fixed.yaml"
    content = report(tmp_path / "bag", *wrong, "--write-params", fixed)
    assert names(content) == ["not_set", "wheel_separation"]
    assert "wheel_separation" in content["obstacle"]
    values = read_parameter_file(fixed, NODE_NAME)
    assert values["wheel_separation"] == pytest.approx(SEPARATION, rel=0.05)


def test_without_parameters_it_says_what_they_would_be(tmp_path: Path) -> None:
    write_bag(tmp_path / "bag", drive(1, 40.0))
    fixed = tmp_path / "fixed.yaml"
    content = report(tmp_path / "bag", "--write-params", fixed)
    assert {*names(content)} == {"not_set"}
    values = read_parameter_file(fixed, NODE_NAME)
    per_count = values["wheel_radius"] / values["encoder_counts_per_revolution"]
    assert per_count == pytest.approx(RADIUS / 2000.0, rel=0.03)
    assert values["wheel_separation"] == pytest.approx(SEPARATION, rel=0.05)


def test_topics_of_other_names_get_the_remapping_that_fits(tmp_path: Path) -> None:
    write_bag(tmp_path / "bag", drive(1, 40.0), {"lrf_pose": "amcl_pose", "compass": "imu/data"})
    content = report(tmp_path / "bag", *GEOMETRY)
    remaps = [remap for each in content["findings"] for remap in each["remaps"]]
    assert sorted(remaps) == ["compass:=/imu/data", "lrf_pose:=/amcl_pose"]
    assert not content["replay_works"]
    words = [word for remap in remaps for word in ("-r", remap)]
    assert names(report(tmp_path / "bag", *GEOMETRY, *words)) == []


def test_joints_of_other_names_are_found(tmp_path: Path) -> None:
    joints = ("wheel_left_joint", "wheel_right_joint")
    write_bag(tmp_path / "bag", drive(1, 40.0), joints=joints)
    content = report(tmp_path / "bag", *GEOMETRY)
    changes = {
        change["parameter"]: change["value"]
        for each in content["findings"]
        for change in each["changes"]
    }
    assert changes == {
        "encoder_source": "joint_states", "left_joint": joints[0], "right_joint": joints[1]
    }  # fmt: skip
    words = [word for name, value in changes.items() for word in ("-p", f"{name}:={value}")]
    assert names(report(tmp_path / "bag", *GEOMETRY, *words)) == []


def test_joint_states_of_another_name_are_found_where_there_are_no_ticks(tmp_path: Path) -> None:
    joints = ("left_wheel_joint", "right_wheel_joint")
    others = {"joint_states": "robot/joint_states"}
    write_bag(tmp_path / "bag", drive(1, 40.0), others, joints=joints)
    content = report(tmp_path / "bag", "-p", f"wheel_separation:={SEPARATION}")
    remaps = [remap for each in content["findings"] for remap in each["remaps"]]
    assert remaps == ["joint_states:=/robot/joint_states"]
    changes = {c["parameter"]: c["value"] for each in content["findings"] for c in each["changes"]}
    assert changes["encoder_source"] == "joint_states"
    assert changes["wheel_radius"] == pytest.approx(RADIUS, rel=0.03)
    assert "encoder_counts_per_revolution" not in changes


def test_a_bag_without_wheels_cannot_be_replayed(tmp_path: Path, capsys: Any) -> None:
    write_bag(tmp_path / "bag", drive(1, 20.0), {"left_ticks": "", "right_ticks": ""})
    content = report(tmp_path / "bag", *GEOMETRY)
    assert names(content).count("missing_topic") == 2
    assert "replay would not work" in capsys.readouterr().out


def test_another_frame_of_the_fixes_is_found(tmp_path: Path) -> None:
    write_bag(tmp_path / "bag", drive(1, 40.0), frame="world")
    content = report(tmp_path / "bag", *GEOMETRY)
    assert names(content) == ["frame"]
    assert not content["replay_works"]
    assert names(report(tmp_path / "bag", *GEOMETRY, "-p", "frame_id:=world")) == []


@pytest.mark.parametrize(("topic", "parameter"), [("compass", "compass_delay"),
                                                  ("lrf_pose", "lrf_pose_delay")])  # fmt: skip
def test_stamps_ahead_of_the_bag_are_found(tmp_path: Path, topic: str, parameter: str) -> None:
    write_bag(tmp_path / "bag", drive(1, 40.0), stamp_errors_s={topic: 0.6})
    fixed = tmp_path / "fixed.yaml"
    content = report(tmp_path / "bag", *GEOMETRY, "--write-params", fixed)
    (finding,) = [each for each in content["findings"] if each["certainty"] != "possible"]
    assert finding["name"] == "clock_skew"
    assert finding["changes"][0]["parameter"] == parameter
    assert finding["changes"][0]["value"] == pytest.approx(0.6, abs=0.01)
    assert names(report(tmp_path / "bag", "--params", fixed)) == []


@pytest.mark.parametrize(("part", "word"), [(0.004, "slow"), (0.0, "")])
def test_a_clock_that_drifts_is_found(tmp_path: Path, part: float, word: str) -> None:
    write_bag(tmp_path / "bag", drive(1, 40.0), drifts={"compass": part})
    content = report(tmp_path / "bag", *GEOMETRY)
    found = [each for each in content["findings"] if each["name"] == "clock_skew"]
    assert len(found) == (1 if word else 0)
    assert all(f"is {word} by 4000 ppm" in each["sentence"] for each in found)


def test_a_bag_without_any_yaw_gets_lrf_use_yaw(tmp_path: Path) -> None:
    write_bag(tmp_path / "bag", drive(1, 40.0), {"compass": ""})
    content = report(tmp_path / "bag", *GEOMETRY)
    assert names(content) == ["no_yaw"]
    assert content["findings"][0]["changes"][0]["parameter"] == "lrf_use_yaw"
    assert names(report(tmp_path / "bag", *GEOMETRY, "-p", "lrf_use_yaw:=true")) == []


def test_a_standing_robot_is_said_to_stand(tmp_path: Path) -> None:
    given = drive(1, 20.0)
    still = given._replace(
        left=given.left * [1.0, 0.0], right=given.right * [1.0, 0.0],
        fixes=np.column_stack([given.fixes[:, 0], 0.0 * given.fixes[:, 1:]]),
    )  # fmt: skip
    write_bag(tmp_path / "bag", still)
    assert names(report(tmp_path / "bag", *GEOMETRY)) == ["standing"]


def test_what_it_cannot_use_is_refused(tmp_path: Path, refuse: Refuse) -> None:
    write_bag(tmp_path / "bag", drive(1, 2.0))
    assert "wheel_radius" in refuse("doctor", tmp_path / "bag", "-p", "wheel_radius:=big")
    line = refuse("doctor", tmp_path / "bag", *GEOMETRY, "--json", tmp_path / "bag" / "x.json")
    assert "lies inside a bag" in line
