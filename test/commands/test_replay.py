# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The command replay, as from a shell."""

import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import Refuse, Succeed, contents, parameters_of, records
from localizers import make_localizer
from places import ROOT
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from fnn_ekf_ros import messages
from fnn_ekf_ros.localizer.saved_state import SavedState
from fnn_ekf_ros.localizer.state_file import StateFile
from fnn_ekf_ros.messages import Message
from fnn_ekf_ros.parameters.files import read_parameter_file
from fnn_ekf_ros.parameters.localizer import LocalizerParameters
from fnn_ekf_ros.parameters.schema import build
from fnn_ekf_ros.recordings.bag_files import BagReader
from fnn_ekf_ros.recordings.bag_writer import BagWriter
from fnn_ekf_ros.timeline.events import Output, Rejected


def copy_without(source: Path, out: Path, *topics: str) -> Path:
    """Copy a bag without some of its topics."""
    with BagReader(source) as bag, BagWriter(out) as copy:
        for record in bag.records():
            if record.topic not in topics:
                copy.write_raw(record)
    return out


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
@pytest.mark.slow
def test_replay_twice_makes_the_same_bytes(
    tmp_path: Path, recorded: Path, succeed: Succeed, storage: str
) -> None:
    made = []
    for folder in ("one", "two"):
        (tmp_path / folder).mkdir()
        out = tmp_path / folder / "out"
        succeed(
            "replay", recorded, out, "--params", parameters_of(recorded), "--storage", storage,
            "-p", "adaptation:=r",
        )  # fmt: skip
        assert [p.name for p in out.parent.iterdir()] == ["out"]
        made.append(contents(out))
    assert made[0] == made[1]


@pytest.mark.slow
def test_replay_makes_the_same_bytes_in_every_process(
    tmp_path: Path, recorded: Path, succeed: Succeed
) -> None:
    """In this process, and in two with sets and dicts of strings in another order."""
    given = ["--params", str(parameters_of(recorded))]
    succeed("replay", recorded, tmp_path / "out", *given)
    for seed in ("8", "9"):
        out = tmp_path / seed / "out"
        out.parent.mkdir()
        ended = subprocess.run(
            [sys.executable, "-m", "fnn_ekf_ros", "replay", str(recorded), str(out), *given],
            env=os.environ | {"PYTHONHASHSEED": seed, "PYTHONPATH": str(ROOT)},
            capture_output=True, text=True,
        )  # fmt: skip
        assert ended.returncode == 0, ended.stderr
        assert contents(out) == contents(tmp_path / "out")


@pytest.mark.slow
def test_replay_starts_from_a_saved_state_and_leaves_it_as_it_is(
    tmp_path: Path, recorded: Path, succeed: Succeed, run: Callable[..., Any]
) -> None:
    file = tmp_path / "kept" / "state.yaml"
    file.parent.mkdir()
    given = [
        "--params", parameters_of(recorded), "-p", f"state_file:={file}", "-p", "warm_start:=true",
    ]  # fmt: skip
    cold = run("replay", recorded, tmp_path / "cold", *given)
    assert cold.code == 0
    assert cold.err == f"replay: state_file '{file}' does not exist: " + (
        "expected a text file; starting without it\n"
    )
    parameters = build(
        LocalizerParameters,
        read_parameter_file(parameters_of(recorded), "localizer")
        | {"state_file": str(file), "initial_pose_std": [1e-3, 1e-3, 1e-3]},
    )
    state = SavedState(
        0, np.array([50.0, 60.0, 0.7]), 1e-6 * np.eye(3), np.full(2, 1e-4), np.full(4, 0.04)
    )
    StateFile(parameters).write(state, datetime(2026, 11, 22, tzinfo=UTC))
    before = contents(file.parent)
    warm = ["-p", "initial_pose_std:=[0.001, 0.001, 0.001]", "-p", "adaptation:=none"]
    succeed("replay", recorded, tmp_path / "warm", *given, *warm)
    assert contents(file.parent) == before
    with BagReader(tmp_path / "warm") as bag:
        first = bag.message(next(bag.records({"/odom"})))
        noise = bag.message(next(bag.records({"/localizer/noise"})))
    assert np.hypot(*(messages.planar_pose(first)[:2] - [50.0, 60.0])) < 0.5
    np.testing.assert_array_equal(noise.data[:6], [*state.measurement_noise, *state.process_noise])


@pytest.mark.slow
def test_replay_copies_all_and_adds_its_own(
    tmp_path: Path, recorded: Path, succeed: Succeed
) -> None:
    out = tmp_path / "out"
    said = succeed("replay", recorded, out, "--params", parameters_of(recorded))
    numbers = {f"/localizer/{topic}" for topic in messages.NUMBER_TOPICS}
    own = {"/odom", "/localizer/noise", "/diagnostics", *numbers}
    added = [r for r in records(out) if r.topic in own]
    assert [r for r in records(out) if r.topic not in own] == records(recorded)
    kinds = {r.topic: r.type_name for r in added}
    assert kinds == {
        "/odom": "nav_msgs/msg/Odometry", "/localizer/noise": "std_msgs/msg/Float64MultiArray",
        "/diagnostics": "diagnostic_msgs/msg/DiagnosticArray",
        **dict.fromkeys(numbers, "std_msgs/msg/Float64"),
    }  # fmt: skip
    with BagReader(out) as bag:
        odoms = [bag.message(r) for r in added if r.topic == "/odom"]
        noises = [bag.message(r) for r in added if r.topic == "/localizer/noise"]
        health = [bag.message(r) for r in added if r.topic == "/diagnostics"]
        stds = [bag.message(r).data for r in added if r.topic == "/localizer/noise/lrf_x_std"]
    assert len(odoms) == len(noises) == pytest.approx(15.0 / 0.375, abs=3)
    assert f": {len(odoms)} odom from " in said
    assert {messages.stamp_ns(odom) % 375_000_000 for odom in odoms} == {0}
    assert {(o.header.frame_id, o.child_frame_id) for o in odoms} == {("map", "base_link")}
    assert {s.name for m in health for s in m.status} == {
        f"localizer: {part}" for part in ("encoders", "compass", "lrf_pose", "filter", "time")
    }
    assert {len(m.data) for m in noises} == {len(messages.NOISE_FIELDS)}
    np.testing.assert_allclose(np.square(stds), [m.data[0] for m in noises], rtol=1e-12)


@pytest.mark.slow
def test_replay_gives_what_the_localizer_gives(
    tmp_path: Path, recorded: Path, succeed: Succeed
) -> None:
    out = tmp_path / "out"
    succeed("replay", recorded, out, "--params", parameters_of(recorded), "-p", "adaptation:=r")
    values = read_parameter_file(parameters_of(recorded), "localizer")
    localizer = make_localizer(**values | {"adaptation": "r"})
    topics = messages.input_topics(localizer.parameters)
    outputs: list[Output] = []
    with BagReader(recorded) as bag:
        for record in bag.records():
            outputs += localizer.advance(record.time_ns)
            topic = record.topic.removeprefix("/")
            if topic in topics:
                events = messages.read_input(
                    topic, bag.message(record), record.time_ns, localizer.parameters
                )
                assert not isinstance(events, Rejected)
                for event in events:
                    outputs += localizer.add(event, record.time_ns)
    expected = [o.estimate for o in outputs if o.estimate is not None]
    with BagReader(out) as bag:
        odoms = [bag.message(record) for record in bag.records({"/odom"})]
    for odom, estimate in zip(odoms, expected, strict=True):
        assert messages.stamp_ns(odom) == estimate.stamp_ns
        block = messages.planar_block(odom.pose.covariance)
        np.testing.assert_array_equal(block, estimate.state.covariance)
        assert odom.pose.pose.position.x == estimate.state.mean[0]


@pytest.mark.slow
def test_replaying_a_replay_changes_nothing(
    tmp_path: Path, recorded: Path, succeed: Succeed
) -> None:
    said = [
        succeed("replay", source, tmp_path / name, "--params", parameters_of(recorded))
        for source, name in ((recorded, "one"), (tmp_path / "one", "two"))
    ]
    assert "not copied" not in said[0]
    left_out = said[1].splitlines()[0].removeprefix("replay: ").partition(" of ")[0].split(", ")
    assert left_out == sorted(map(messages.absolute_name, messages.output_topics()))
    assert records(tmp_path / "one") == records(tmp_path / "two")


@pytest.mark.slow
def test_replay_takes_parameters_in_the_order_of_ros(
    tmp_path: Path, recorded: Path, succeed: Succeed
) -> None:
    later = tmp_path / "later.yaml"
    later.write_text("localizer:\n  ros__parameters: {frame_id: late, base_frame: late}\n")
    out_bag = tmp_path / "out"
    with BagReader(recorded) as source, BagWriter(tmp_path / "with_fixes") as out:
        for record in source.records():
            if record.topic == "/lrf_pose":
                message = source.message(record)
                pose = messages.planar_pose(message)
                fields = {
                    "header": messages.header(messages.stamp_ns(message), "late"),
                    "pose": messages.pose_with_covariance(pose, np.eye(6)),
                }
                out.write("/lrf_pose", Message(messages.POSE_TYPE, fields), record.time_ns)
            else:
                out.write_raw(record)
    succeed(
        "replay", tmp_path / "with_fixes", out_bag, "--params", parameters_of(recorded),
        "--params", later, "-p", "base_frame:=last",
    )  # fmt: skip
    with BagReader(out_bag) as result:
        frames = {
            (m.header.frame_id, m.child_frame_id)
            for m in map(result.message, result.records({"/odom"}))
        }
    assert frames == {("late", "last")}


def after_ten_seconds(recorded: Path, out: Path, *kept: str) -> Path:
    """Copy a recording in which, from its 11th second on, only some topics go on."""
    with BagReader(recorded) as source, BagWriter(out) as copy:
        for record in source.records():
            if record.topic in kept or record.time_ns < source.start_ns + 10**10:
                copy.write_raw(record)
    return out


@pytest.mark.slow
def test_time_passes_in_a_replay_with_whatever_is_recorded(
    tmp_path: Path, recorded: Path, succeed: Succeed
) -> None:
    """The wheels fall silent: periods close all the same, as on the robot."""
    bag = after_ten_seconds(recorded, tmp_path / "bag", "/ground_truth")
    succeed("replay", bag, tmp_path / "out", "--params", parameters_of(recorded))
    with BagReader(tmp_path / "out") as result:
        last = [result.message(r) for r in result.records({"/odom"})][-1]
        end_ns = result.start_ns + round(result.duration_s * 1e9)
    assert messages.stamp_ns(last) > end_ns - 900_000_000


@pytest.mark.slow
def test_time_passes_in_a_replay_with_messages_that_hold_nothing(
    tmp_path: Path, recorded: Path, succeed: Succeed
) -> None:
    with BagReader(recorded) as source, BagWriter(tmp_path / "bag") as copy:
        for record in source.records():
            if record.time_ns < source.start_ns + 10**10:
                copy.write_raw(record)
            elif record.topic == "/compass":
                stamp = messages.stamp_ns(source.message(record))
                empty = messages.compass_message(stamp, "base_link", 0.0, 0.1)
                empty.fields["orientation_covariance"][0] = -1.0
                copy.write("/compass", empty, record.time_ns)
    succeed("replay", tmp_path / "bag", tmp_path / "out", "--params", parameters_of(recorded))
    with BagReader(tmp_path / "out") as result:
        last = [result.message(r) for r in result.records({"/odom"})][-1]
        end_ns = result.start_ns + round(result.duration_s * 1e9)
    assert messages.stamp_ns(last) > end_ns - 900_000_000


@pytest.mark.slow
def test_replay_of_wheels_only_starts_and_then_drifts(
    tmp_path: Path, recorded: Path, succeed: Succeed
) -> None:
    out = tmp_path / "out"
    succeed("replay", recorded, out, "--params", parameters_of(recorded), "--dead-reckoning")
    with BagReader(out) as bag:
        spreads = [
            float(messages.planar_block(m.pose.covariance)[2, 2])
            for m in map(bag.message, bag.records({"/odom"}))
        ]
    assert len(spreads) > 30
    assert np.all(np.diff(spreads) > 0.0)


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["-p", "adaption:=r"], "unknown parameter 'adaption': did you mean 'adaptation'?"),
        (["-p", "adaptation:=off"], "(a bare off, no, on or yes is a truth value in YAML)"),
        (["-p", "period:=fast"], "parameter 'period' is 'fast': expected a number"),
        (["-p", "period:=1e-3"], "parameter 'period' is 0.001: expected a number from 0.01"),
        (["-p", "process_noise_std:=[0.1]"], "expected a list of 2 numbers [m, rad]"),
        (["-p", "measurement_noise_std:=[.nan, 1, 1]"], "parameter 'measurement_noise_std'"),
        (["-p", "wheel_radius:=0.0"], "parameter 'wheel_radius' is not set"),
        (["-p", "period"], "-p period: expected name:=value"),
        (["-p", "membership_file:=nowhere.yaml"],
         "membership_file 'nowhere.yaml' does not exist"),
        (["-p", "encoder_source:=joint_states", "-r", "joint_states:=nothing"],
         "has no topic /nothing (sensor_msgs/msg/JointState)"),
        (["-r", "lrf_pose"], "-r lrf_pose: expected FROM:=TO"),
        (["-r", "/lrf_poze:=x"], "unknown topic '/lrf_poze': did you mean 'lrf_pose'?"),
        (["-r", "lrf_pose:=compass"], "-r: /compass would be both compass and lrf_pose"),
        (["-r", "left_ticks:=ground_truth"],
         "topic /ground_truth is nav_msgs/msg/Odometry, expected std_msgs/msg/Int32"),
        (["-p", "frame_id:=elsewhere"], "gives no odom"),
    ],
)  # fmt: skip
@pytest.mark.slow
def test_replay_refuses(
    tmp_path: Path, recorded: Path, refuse: Refuse, words: list[str], expected: str
) -> None:
    line = refuse("replay", recorded, tmp_path / "o", "--params", parameters_of(recorded), *words)
    assert expected in line


def test_replay_needs_geometry(tmp_path: Path, recorded: Path, refuse: Refuse) -> None:
    line = refuse("replay", recorded, tmp_path / "out")
    assert line.startswith("replay: parameter 'wheel_radius' is not set: expected a number")


@pytest.mark.parametrize("topic", ["/left_ticks", "/right_ticks", "/lrf_pose"])
@pytest.mark.slow
def test_replay_needs_its_topics(
    tmp_path: Path, recorded: Path, refuse: Refuse, topic: str
) -> None:
    bag = copy_without(recorded, tmp_path / "bag", topic)
    line = refuse("replay", bag, tmp_path / "out", "--params", parameters_of(recorded))
    assert f"has no topic {topic} (" in line
    assert "it has /compass, " in line


@pytest.mark.slow
def test_replay_without_a_yaw_says_what_is_missing(
    tmp_path: Path, recorded: Path, refuse: Refuse, succeed: Succeed
) -> None:
    bag = copy_without(recorded, tmp_path / "bag", "/compass")
    words = ["--params", parameters_of(recorded)]
    line = refuse("replay", bag, tmp_path / "out", *words)
    assert "waiting for the first yaw" in line
    succeed("replay", bag, tmp_path / "out", *words, "-p", "lrf_use_yaw:=true")


@pytest.mark.parametrize("name", ["replay", "evaluate"])
def test_bags_that_cannot_be_read_are_refused(
    tmp_path: Path, recorded: Path, refuse: Refuse, name: str
) -> None:
    words = [tmp_path / "out", "--params", parameters_of(recorded)] if name == "replay" else []
    assert "does not exist" in refuse(name, tmp_path / "missing", *words)
    (tmp_path / "empty").mkdir()
    assert "has no metadata.yaml" in refuse(name, tmp_path / "empty", *words)
    shutil.copytree(recorded, tmp_path / "cut")
    (file,) = (tmp_path / "cut").glob("*.mcap")
    file.write_bytes(file.read_bytes()[:-2000])
    assert "cannot be read" in refuse(name, tmp_path / "cut", *words)
    assert "cannot be read" in refuse(name, file, *words)


def test_replay_overwrites_nothing(tmp_path: Path, recorded: Path, refuse: Refuse) -> None:
    (tmp_path / "there").write_text("mine")
    words = ["--params", parameters_of(recorded)]
    assert "exists already" in refuse("replay", recorded, tmp_path / "there", *words)
    assert "does not exist" in refuse("replay", recorded, tmp_path / "no" / "out", *words)


@pytest.mark.slow
def test_replay_leaves_out_diagnostics_of_another_type(
    tmp_path: Path, recorded: Path, succeed: Succeed
) -> None:
    with BagReader(recorded) as source, BagWriter(tmp_path / "bag") as out:
        for record in source.records():
            out.write_raw(record)
            if record.topic == "/left_ticks":
                out.write_raw(record._replace(topic="/diagnostics"))
    words = ["--params", parameters_of(recorded)]
    said = succeed("replay", tmp_path / "bag", tmp_path / "out", *words).splitlines()
    assert said[0] == (f"replay: /diagnostics of {tmp_path / 'bag'} not copied: OUT gets new ones")
    succeed("replay", recorded, tmp_path / "plain", *words)
    assert records(tmp_path / "out") == records(tmp_path / "plain")


@pytest.mark.slow
def test_replay_copies_topics_of_types_it_does_not_know(
    tmp_path: Path, recorded: Path, succeed: Succeed
) -> None:
    store = get_typestore(Stores.ROS2_JAZZY)
    store.register(get_types_from_msg("int32 number\n", "my_msgs/msg/Own"))
    with (
        BagReader(recorded) as source,
        Writer(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.MCAP) as out,
    ):
        topics = {
            name: out.add_connection(name, topic.type_name, typestore=store)
            for name, topic in source.topics.items()
        }
        own = out.add_connection("/own", "my_msgs/msg/Own", typestore=store)
        message = store.types["my_msgs/msg/Own"](number=7)
        out.write(own, 3 * 10**9, store.serialize_cdr(message, "my_msgs/msg/Own"))
        for record in source.records():
            out.write(topics[record.topic], record.time_ns, record.data)
    out_bag = tmp_path / "out"
    succeed("replay", tmp_path / "bag", out_bag, "--params", parameters_of(recorded))
    assert len(records(out_bag, "/odom")) > 30
