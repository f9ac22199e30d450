# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Runs read from bags: noise beside its odom, statuses, fixes and parameters."""

from pathlib import Path

import numpy as np
import pytest
from commands import parameters_of

from fnn_ekf_ros import messages
from fnn_ekf_ros.cli import run_command
from fnn_ekf_ros.core.arrays import Row
from fnn_ekf_ros.localizer.localizer import Localizer
from fnn_ekf_ros.membership.files import networks_for
from fnn_ekf_ros.parameters.files import read_parameter_file
from fnn_ekf_ros.parameters.localizer import NODE_NAME, LocalizerParameters
from fnn_ekf_ros.parameters.schema import build
from fnn_ekf_ros.recordings.bag_files import BagReader
from fnn_ekf_ros.recordings.bag_writer import BagWriter
from fnn_ekf_ros.recordings.inputs import TopicNames, inputs_in
from fnn_ekf_ros.recordings.run_record import RunRecord, StatusReport, noise_at
from fnn_ekf_ros.recordings.runs import read_run, run_localizer
from fnn_ekf_ros.timeline.events import Level, Status
from fnn_ekf_ros.timeline.trajectory import Trajectory

LAYOUT = messages.Message("std_msgs/msg/MultiArrayLayout", {"dim": [], "data_offset": 0})


@pytest.mark.slow
def test_a_bag_of_replay_and_a_localizer_that_runs_give_the_same(
    tmp_path: Path, recorded: Path
) -> None:
    out, file = tmp_path / "out", parameters_of(recorded)
    assert run_command("replay", [str(recorded), str(out), "--params", str(file)]) == 0
    with BagReader(out) as bag:
        read = read_run(bag, "/odom")
    parameters = build(LocalizerParameters, read_parameter_file(file, NODE_NAME))
    with BagReader(recorded) as bag:
        inputs = inputs_in(bag, parameters, TopicNames([]))
        localizer = Localizer(parameters, networks_for(parameters))
        ran = run_localizer(bag, bag.records(), localizer, inputs)
    for one, other in (
        (read.track.time_ns, ran.track.time_ns), (read.track.covariance, ran.track.covariance),
        (read.twist, ran.twist), (read.track.pose[:, :2], ran.track.pose[:, :2]),
    ):  # fmt: skip
        np.testing.assert_array_equal(one, other)
    np.testing.assert_allclose(read.track.pose, ran.track.pose, atol=1e-12)
    assert read.noise is not None
    assert ran.noise is not None
    assert list(read.noise.values) == list(messages.NOISE_FIELDS)
    np.testing.assert_array_equal(read.noise.time_ns, read.track.time_ns)
    for name in messages.NOISE_FIELDS:
        np.testing.assert_array_equal(read.noise.values[name], ran.noise.values[name])
    assert read.noise.measured(Row.COMPASS_YAW).mean() > 0.9
    assert read.statuses == ran.statuses
    assert set(read.statuses) >= {"encoders", "compass", "lrf_pose", "filter", "time"}
    assert read.fixes is not None
    with BagReader(recorded) as bag:
        assert len(read.fixes.time_ns) == bag.topics["/lrf_pose"].message_count
    assert "wheel_separation" in read.parameters


@pytest.mark.parametrize(
    ("odom", "node"),
    [("/odom", "localizer"), ("/robot1/odom", "robot1/localizer"), ("/pose", "robot1/localizer")],
)
def test_a_node_in_a_namespace_is_found_beside_its_odom(
    tmp_path: Path, odom: str, node: str
) -> None:
    pose, covariance = np.zeros(3), np.eye(6)
    with BagWriter(tmp_path / "bag") as bag:
        for second in range(3):
            time_ns = second * 10**9
            message = messages.odometry_message(
                time_ns, "map", "base_link", pose, np.zeros(2), covariance, covariance
            )
            bag.write(odom, message, time_ns)
            fields = {"layout": LAYOUT, "data": np.full(len(messages.NOISE_FIELDS), 0.5)}
            noise = messages.Message(messages.NOISE_TYPE, fields)
            bag.write(f"/{node}/noise", noise, time_ns)
            for name, message_text in ((node, "running"), ("robot2/localizer", "lost")):
                status = Status("filter", Level.OK, message_text, ())
                bag.write("/diagnostics", messages.diagnostics(time_ns, name, (status,)), time_ns)
    with BagReader(tmp_path / "bag") as bag_read:
        run = read_run(bag_read, odom)
    assert run.noise is not None
    assert run.noise.get("nis").tolist() == [0.5, 0.5, 0.5]
    assert [report.message for report in run.statuses["filter"]] == ["running"] * 3


def test_noise_has_the_stamps_of_the_odom_that_it_came_with() -> None:
    rows = [np.array([1.0, 2.0]), np.array([3.0, 4.0])]
    both = noise_at([10, 20], [0, 1], rows, ["a", "b"])  # recorded before its odom
    assert both is not None
    assert both.time_ns.tolist() == [10, 20]
    assert both.values["b"].tolist() == [2.0, 4.0]
    late = noise_at([10, 20, 30], [2, 3], rows, ["a", "b", "of a later version"])
    assert late is not None
    assert late.time_ns.tolist() == [20, 30]
    assert late.get("of a later version").tolist() == [0.0, 0.0]
    assert noise_at([10], [], [], ["a"]) is None
    assert noise_at([], [0], rows[:1], ["a", "b"]) is None


def test_the_worst_status_is_the_worst_for_longest() -> None:
    def reports(levels: list[int]) -> list[StatusReport]:
        return [StatusReport(time, level, f"level {level}") for time, level in enumerate(levels)]

    track = Trajectory(np.zeros(1, dtype=np.int64), np.zeros((1, 3)), np.zeros((1, 3, 3)))
    statuses = {"a": reports([0, 1, 1, 1]), "b": reports([0, 2, 0, 0]), "c": reports([2, 2, 0, 0])}
    worst = RunRecord(track, np.zeros((1, 2)), statuses=statuses).worst_status()
    assert worst is not None
    assert (worst.name, worst.word, worst.share) == ("c", "ERROR", 0.5)
    assert str(worst) == "c: level 2 (50.0% of the reports)"
    fine = RunRecord(track, np.zeros((1, 2)), statuses={"a": reports([0, 0])})
    assert fine.worst_status() is None
