# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The topics of the command replay under other names."""

from pathlib import Path

import pytest
from commands import Refuse, Succeed, parameters_of, records

from fnn_ekf_ros import messages
from fnn_ekf_ros.recordings.bag_files import BagReader
from fnn_ekf_ros.recordings.bag_writer import BagWriter


@pytest.mark.slow
def test_replay_remaps_topics(tmp_path: Path, recorded: Path, succeed: Succeed) -> None:
    renamed = tmp_path / "renamed"
    with BagReader(recorded) as source, BagWriter(renamed) as out:
        for record in source.records():
            topic = "/amcl_pose" if record.topic == "/lrf_pose" else record.topic
            out.write_raw(record._replace(topic=topic))
    words = ["--params", parameters_of(recorded)]
    succeed("replay", recorded, tmp_path / "plain", *words)
    succeed(
        "replay", renamed, tmp_path / "out", *words, "-r", "lrf_pose:=amcl_pose",
        "-r", "odom:=/robot/odom",
    )  # fmt: skip
    plain = [r.data for r in records(tmp_path / "plain", "/odom")]
    assert [r.data for r in records(tmp_path / "out", "/robot/odom")] == plain


@pytest.mark.slow
def test_replay_remaps_each_of_its_topics(
    tmp_path: Path, recorded: Path, succeed: Succeed, refuse: Refuse
) -> None:
    words = ["--params", parameters_of(recorded)]
    succeed("replay", recorded, tmp_path / "out", *words, "-r", "~/nis/compass:=nis")
    names = {record.topic for record in records(tmp_path / "out")}
    assert "/nis" in names
    assert "/localizer/nis/compass" not in names
    for pair in ("~/nis/compass:=odom", "~/noise/lrf_x_std:=/compass", "~/noise:=/diagnostics"):
        line = refuse("replay", recorded, tmp_path / "o", *words, "-r", pair)
        assert f"-r: {messages.absolute_name(pair.partition(':=')[2])} would share a name" in line


@pytest.mark.parametrize(
    ("pairs", "line"),
    [
        (["initialpose:=/lrf_pose"], "/lrf_pose would be both lrf_pose and initialpose"),
        (["right_ticks:=left_ticks"], "/left_ticks would be both left_ticks and right_ticks"),
        (["compass:=no", "lrf_pose:=/no"], "/no would be both compass and lrf_pose"),
    ],
)
@pytest.mark.slow
def test_replay_refuses_two_inputs_of_one_topic(
    tmp_path: Path, recorded: Path, refuse: Refuse, pairs: list[str], line: str
) -> None:
    words = [word for pair in pairs for word in ("-r", pair)]
    parameters = ["--params", parameters_of(recorded)]
    assert (
        refuse("replay", recorded, tmp_path / "out", *parameters, *words) == f"replay: -r: {line}"
    )


def test_replay_refuses_a_remapped_compass_that_the_bag_does_not_have(
    tmp_path: Path, recorded: Path, refuse: Refuse
) -> None:
    """Without a remapping a compass may be missing: the fixes may have a yaw."""
    words = ["--params", parameters_of(recorded), "-p", "lrf_use_yaw:=true"]
    line = refuse("replay", recorded, tmp_path / "out", *words, "-r", "compass:=/imu")
    assert "has no topic /imu (sensor_msgs/msg/Imu)" in line


@pytest.mark.slow
def test_replay_lets_inputs_change_places(tmp_path: Path, recorded: Path, succeed: Succeed) -> None:
    words = ["--params", parameters_of(recorded)]
    swapped = ["-r", "left_ticks:=right_ticks", "-r", "right_ticks:=left_ticks"]
    succeed("replay", recorded, tmp_path / "out", *words, *swapped)
