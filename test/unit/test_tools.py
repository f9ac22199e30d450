"""The commands, as from a shell: what they make, and how they refuse what cannot be used."""

import json
import math
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from fnn_ekf_ros import messages
from fnn_ekf_ros.bag_files import BagReader, BagWriter, Record
from fnn_ekf_ros.messages import Message
from fnn_ekf_ros.parameters.files import read_parameter_file
from fnn_ekf_ros.parameters.localizer import LocalizerParameters
from fnn_ekf_ros.parameters.schema import build
from fnn_ekf_ros.pipeline.events import Output, Rejected
from fnn_ekf_ros.pipeline.pipeline import Pipeline

Refuse = Callable[..., str]
Succeed = Callable[..., str]
ARC_GEOMETRY = {"wheel_base_m": 0.5, "metres_per_tick": 1e-5}


def contents(folder: Path) -> dict[str, bytes]:
    """Return what a bag's folder holds."""
    return {path.name: path.read_bytes() for path in sorted(folder.iterdir())}


def records(path: Path, *topics: str) -> list[Record]:
    with BagReader(path) as bag:
        return list(bag.records(set(topics) or None))


def table_rows(out: str) -> dict[str, list[str]]:
    """Return the numbers of the table that evaluate prints, by label."""
    return {line.split()[0]: line.split()[1:] for line in out.splitlines()[2:]}


def copy_without(source: Path, out: Path, *topics: str) -> Path:
    """Copy a bag without some of its topics."""
    with BagReader(source) as bag, BagWriter(out) as copy:
        for record in bag.records():
            if record.topic not in topics:
                copy.write_raw(record)
    return out


def write_arc(folder: Path, truth_yaw: bool = True) -> tuple[Path, Path]:
    """Write an exact recording of a robot on a circle, and its geometry; returns the two files."""
    names = ["t", "left_ticks", "right_ticks", "gt_x", "gt_y", "fix_x", "fix_y", "heading_meas"]
    names += ["gt_theta"] if truth_yaw else []
    lines = [",".join(names)]
    speed, rate = 0.4, 0.25
    for number in range(801):
        time = 0.05 * number
        turn = rate * time
        x, y = speed / rate * math.sin(turn), speed / rate * (1.0 - math.cos(turn))
        left, right = (round((speed + s * 0.25 * rate) * time / 1e-5) for s in (-1.0, 1.0))
        yaw = math.remainder(turn, 2.0 * math.pi)
        values = [time + 100.0, left, right, x, y, x, y, yaw]
        values += [yaw] if truth_yaw else []
        cells = [repr(value) for value in values]
        if number % 5:
            cells[5] = cells[6] = ""
        if number % 3:
            cells[7] = "nan"
        lines.append(",".join(cells))
    table, geometry = folder / "arc.csv", folder / "arc.json"
    table.write_text("\n".join(lines) + "\n")
    geometry.write_text(json.dumps(ARC_GEOMETRY))
    return table, geometry


# --- simulate ------------------------------------------------------------------------------------


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
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
        (["-p", "path:=off"], "parameter 'path' is False: expected one of square, "),
        (["-p", "path:=cmd_vel"], "simulate has no cmd_vel"),
        (["-p", "slip_std:=[1]"], "parameter 'slip_std' is [1]: expected a list of 2 numbers"),
        (["-p", "seed"], "-p seed: expected name:=value"),
        (["--duration", "0"], "--duration 0: expected"),
        (["--duration", "nan"], "--duration nan: expected"),
        (["--duration", "1e9"], "--duration 1e+09: expected"),
        (["--params", "missing.yaml"], "parameter file 'missing.yaml': No such file"),
    ],
)
def test_simulate_refuses(tmp_path: Path, refuse: Refuse, words: list[str], expected: str) -> None:
    assert expected in refuse("simulate", tmp_path / "bag", *words)


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


# --- replay --------------------------------------------------------------------------------------


def parameters_of(bag: Path) -> Path:
    return bag.with_name(f"{bag.name}.yaml")


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
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


def test_replay_copies_all_and_adds_its_own(
    tmp_path: Path, recorded: Path, succeed: Succeed
) -> None:
    out = tmp_path / "out"
    said = succeed("replay", recorded, out, "--params", parameters_of(recorded))
    own = {"/odom", "/localizer/noise", "/diagnostics"}
    added = [r for r in records(out) if r.topic in own]
    assert [r for r in records(out) if r.topic not in own] == records(recorded)
    kinds = {r.topic: r.type_name for r in added}
    assert kinds == {
        "/odom": "nav_msgs/msg/Odometry", "/localizer/noise": "std_msgs/msg/Float64MultiArray",
        "/diagnostics": "diagnostic_msgs/msg/DiagnosticArray",
    }  # fmt: skip
    with BagReader(out) as bag:
        odoms = [bag.message(r) for r in added if r.topic == "/odom"]
        noises = [bag.message(r) for r in added if r.topic == "/localizer/noise"]
        health = [bag.message(r) for r in added if r.topic == "/diagnostics"]
    assert len(odoms) == len(noises) == pytest.approx(15.0 / 0.375, abs=3)
    assert f": {len(odoms)} odom from " in said
    assert {messages.stamp_ns(odom) % 375_000_000 for odom in odoms} == {0}
    assert {(o.header.frame_id, o.child_frame_id) for o in odoms} == {("map", "base_link")}
    assert {s.name for m in health for s in m.status} == {
        f"localizer: {part}" for part in ("encoders", "compass", "lrf_pose", "filter", "time")
    }
    assert {len(m.data) for m in noises} == {len(messages.NOISE_FIELDS)}


def test_replay_gives_what_the_pipeline_gives(
    tmp_path: Path, recorded: Path, succeed: Succeed, make_pipeline: Callable[..., Pipeline]
) -> None:
    out = tmp_path / "out"
    succeed("replay", recorded, out, "--params", parameters_of(recorded), "-p", "adaptation:=r")
    values = read_parameter_file(parameters_of(recorded), "localizer")
    pipeline = make_pipeline(**values | {"adaptation": "r"})
    topics = messages.input_topics(pipeline.parameters)
    outputs: list[Output] = []
    with BagReader(recorded) as bag:
        for record in bag.records():
            outputs += pipeline.advance(record.time_ns)
            topic = record.topic.removeprefix("/")
            if topic in topics:
                events = messages.read_input(
                    topic, bag.message(record), record.time_ns, pipeline.parameters
                )
                assert not isinstance(events, Rejected)
                for event in events:
                    outputs += pipeline.add(event, record.time_ns)
    expected = [o.estimate for o in outputs if o.estimate is not None]
    with BagReader(out) as bag:
        odoms = [bag.message(record) for record in bag.records({"/odom"})]
    for odom, estimate in zip(odoms, expected, strict=True):
        assert messages.stamp_ns(odom) == estimate.stamp_ns
        block = messages.planar_block(odom.pose.covariance)
        np.testing.assert_array_equal(block, estimate.state.covariance)
        assert odom.pose.pose.position.x == estimate.state.mean[0]


def test_replaying_a_replay_changes_nothing(
    tmp_path: Path, recorded: Path, succeed: Succeed
) -> None:
    for source, name in ((recorded, "one"), (tmp_path / "one", "two")):
        succeed("replay", source, tmp_path / name, "--params", parameters_of(recorded))
    assert records(tmp_path / "one") == records(tmp_path / "two")


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
        (["-p", "adaptation:=r", "-p", "membership_file:=nowhere.yaml"], "membership_file 'nowhere.yaml': No such file"),
        (["-p", "encoder_source:=joint_states", "-r", "joint_states:=nothing"],
         "has no topic /nothing (sensor_msgs/msg/JointState)"),
        (["-r", "lrf_pose"], "-r lrf_pose: expected FROM:=TO"),
        (["-r", "lrf_pose:=compass"],
         "topic /compass is sensor_msgs/msg/Imu, expected "
         "geometry_msgs/msg/PoseWithCovarianceStamped"),
        (["-r", "left_ticks:=ground_truth"],
         "topic /ground_truth is nav_msgs/msg/Odometry, expected std_msgs/msg/Int32"),
        (["-p", "frame_id:=elsewhere"], "gives no odom"),
    ],
)  # fmt: skip
def test_replay_refuses(
    tmp_path: Path, recorded: Path, refuse: Refuse, words: list[str], expected: str
) -> None:
    line = refuse("replay", recorded, tmp_path / "o", "--params", parameters_of(recorded), *words)
    assert expected in line


def test_replay_needs_geometry(tmp_path: Path, recorded: Path, refuse: Refuse) -> None:
    line = refuse("replay", recorded, tmp_path / "out")
    assert line.startswith("replay: parameter 'wheel_radius' is not set: expected a number")


@pytest.mark.parametrize("topic", ["/left_ticks", "/right_ticks", "/lrf_pose"])
def test_replay_needs_its_topics(
    tmp_path: Path, recorded: Path, refuse: Refuse, topic: str
) -> None:
    bag = copy_without(recorded, tmp_path / "bag", topic)
    line = refuse("replay", bag, tmp_path / "out", "--params", parameters_of(recorded))
    assert f"has no topic {topic} (" in line
    assert "it has /compass, " in line


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


# --- simulate, replay, evaluate ------------------------------------------------------------------


def test_simulate_replay_evaluate(tmp_path: Path, recorded: Path, succeed: Succeed) -> None:
    words = ["--params", parameters_of(recorded)]
    succeed("replay", recorded, tmp_path / "ekf", *words)
    succeed("replay", recorded, tmp_path / "wheels", *words, "--dead-reckoning")
    said = succeed(
        "evaluate", tmp_path / "ekf", tmp_path / "wheels", "--labels", "EKF", "wheels",
        "--json", tmp_path / "scores.json",
    )  # fmt: skip
    scores = json.loads((tmp_path / "scores.json").read_text())
    assert list(scores) == ["EKF", "wheels"]
    rows = table_rows(said)
    assert rows["EKF"][0] == str(scores["EKF"]["count"])
    for column, key in enumerate(("rmse_x", "rmse_y", "rmse_theta", "rmse_position"), start=1):
        assert float(rows["EKF"][column]) == pytest.approx(scores["EKF"][key], abs=6e-5)
    ekf = scores["EKF"]
    assert ekf["count"] > 35
    assert 0.01 < ekf["rmse_position"] < 0.14
    assert ekf["rmse_position"] == pytest.approx(math.hypot(ekf["rmse_x"], ekf["rmse_y"]))
    assert 0.01 < ekf["rmse_theta"] < 0.12
    assert 1.0 < ekf["mean_nees"] < 6.0
    assert scores["wheels"]["rmse_position"] > 2.0 * ekf["rmse_position"]


def test_evaluate_agrees_with_a_score_by_hand(
    tmp_path: Path, recorded: Path, succeed: Succeed
) -> None:
    out = tmp_path / "out"
    succeed("replay", recorded, out, "--params", parameters_of(recorded))
    succeed("evaluate", out, "--json", tmp_path / "scores.json")
    (found,) = json.loads((tmp_path / "scores.json").read_text()).values()
    with BagReader(out) as bag:
        truth = {messages.stamp_ns(m): messages.planar_pose(m)
                 for m in map(bag.message, bag.records({"/ground_truth"}))}  # fmt: skip
        odoms = [bag.message(record) for record in bag.records({"/odom"})]
    errors, nees = [], []
    for odom in odoms:  # truth is known at every boundary
        error = messages.planar_pose(odom) - truth[messages.stamp_ns(odom)]
        error[2] = math.remainder(error[2], 2.0 * math.pi)
        errors.append(error)
        P = messages.planar_block(odom.pose.covariance)
        nees.append(error @ np.linalg.inv(P) @ error)
    rmse = np.sqrt(np.mean(np.square(errors), axis=0))
    assert found["count"] == len(odoms)
    for key, value in zip(("rmse_x", "rmse_y", "rmse_theta"), rmse, strict=True):
        assert found[key] == pytest.approx(value, rel=1e-9)
    assert found["mean_nees"] == pytest.approx(np.mean(nees), rel=1e-6)


def test_evaluate_refuses(
    tmp_path: Path, recorded: Path, refuse: Refuse, run: Callable[..., Any]
) -> None:
    line = refuse("evaluate", recorded)
    assert "topic /odom is missing, expected nav_msgs/msg/Odometry; it has /compass, " in line
    line = refuse("evaluate", recorded, "--odom-topic", "/compass")
    assert "topic /compass is of type sensor_msgs/msg/Imu" in line
    words = ["--truth-topic", "/nothing", "--odom-topic", "/ground_truth"]
    line = refuse("evaluate", recorded, *words)
    assert "topic /nothing is missing" in line
    assert "--labels: 2 labels, expected 1" in refuse("evaluate", recorded, "--labels", "a", "b")
    missing = tmp_path / "no" / "x.json"
    # The table is out already, but nothing is left behind.
    ran = run("evaluate", recorded, "--odom-topic", "/ground_truth", "--json", missing)
    assert (ran.code, ran.err.count("\n")) == (1, 1)
    assert "cannot be written" in ran.err
    assert list(tmp_path.iterdir()) == []


def test_evaluate_truth_against_itself_is_without_error(recorded: Path, succeed: Succeed) -> None:
    said = succeed("evaluate", recorded, "--odom-topic", "/ground_truth", "--labels", "truth")
    assert table_rows(said)["truth"][1:] == ["0.0000", "0.0000", "0.0000", "0.0000", "n/a"]


def test_evaluate_of_bags_without_common_time(tmp_path: Path, refuse: Refuse) -> None:
    zeros = np.zeros((6, 6))
    with BagWriter(tmp_path / "bag") as bag:
        for topic, start in (("/odom", 0), ("/ground_truth", 10**12)):
            for number in range(3):
                stamp = start + number * 10**9
                message = messages.odometry_message(
                    stamp, "map", "base_link", np.zeros(3), np.zeros(2), zeros, zeros
                )
                bag.write(topic, message, stamp)
    assert "have no time in common" in refuse("evaluate", tmp_path / "bag")


def test_runs_of_the_same_name_are_all_shown(recorded: Path, run: Callable[..., Any]) -> None:
    words = ["--odom-topic", "/ground_truth"]
    ran = run("evaluate", recorded, recorded, *words)
    assert ran.code == 1 or len(ran.out.splitlines()) == 4


def test_an_odom_that_is_no_number_is_not_passed_over(
    tmp_path: Path, run: Callable[..., Any]
) -> None:
    zeros = np.zeros((6, 6))
    with BagWriter(tmp_path / "bag") as bag:
        for number in range(5):
            for topic, x in (("/odom", math.nan), ("/ground_truth", 1.0)):
                message = messages.odometry_message(
                    number * 10**9, "map", "base_link", np.array([x, 0.0, 0.0]), np.zeros(2),
                    zeros, zeros,
                )  # fmt: skip
                bag.write(topic, message, number * 10**9)
    ran = run("evaluate", tmp_path / "bag")
    assert ran.code == 1 or "nan" in ran.out


def test_evaluate_draws(tmp_path: Path, recorded: Path, succeed: Succeed) -> None:
    pytest.importorskip("matplotlib")
    succeed("replay", recorded, tmp_path / "out", "--params", parameters_of(recorded))
    for name in ("one.png", "two.png"):
        succeed("evaluate", tmp_path / "out", "--plot", tmp_path / name)
    assert (tmp_path / "one.png").read_bytes().startswith(b"\x89PNG")
    assert (tmp_path / "one.png").read_bytes() == (tmp_path / "two.png").read_bytes()


# --- import-csv ----------------------------------------------------------------------------------


def test_an_exact_arc_imported_replayed_and_evaluated(tmp_path: Path, succeed: Succeed) -> None:
    table, geometry = write_arc(tmp_path)
    said = succeed("import-csv", table, tmp_path / "bag", "--geometry", geometry)
    for part in ("801 left_ticks", "801 right_ticks", "161 lrf_pose", "267 compass",
                 "801 ground_truth"):  # fmt: skip
        assert part in said
    parameters = build(LocalizerParameters, read_parameter_file(tmp_path / "bag.yaml", "localizer"))
    assert parameters.wheel_separation == 0.5
    way = 2.0 * math.pi * parameters.wheel_radius / parameters.encoder_counts_per_revolution
    assert way == pytest.approx(1e-5)
    assert not parameters.lrf_use_yaw
    words = ["--params", tmp_path / "bag.yaml"]
    succeed("replay", tmp_path / "bag", tmp_path / "out", *words)
    succeed("evaluate", tmp_path / "out", "--labels", "arc", "--json", tmp_path / "arc.json")
    arc = json.loads((tmp_path / "arc.json").read_text())["arc"]
    assert arc["count"] > 100
    # Truth is interpolated linearly between samples 2 cm apart, on a radius of 1.6 m: 31 um.
    assert arc["rmse_position"] < 1e-4
    assert arc["rmse_theta"] < 1e-4


def test_truth_without_heading_gives_no_theta(tmp_path: Path, succeed: Succeed) -> None:
    table, geometry = write_arc(tmp_path, truth_yaw=False)
    succeed("import-csv", table, tmp_path / "bag", "--geometry", geometry)
    succeed("replay", tmp_path / "bag", tmp_path / "out", "--params", tmp_path / "bag.yaml")
    said = succeed(
        "evaluate", tmp_path / "out", "--labels", "arc", "--json", tmp_path / "scores.json"
    )
    row = table_rows(said)["arc"]
    assert (row[3], row[5]) == ("n/a", "n/a")
    assert float(row[4]) < 1e-3
    scores = json.loads((tmp_path / "scores.json").read_text())["arc"]
    assert scores["rmse_theta"] is None
    assert scores["mean_nees"] is None
    assert scores["rmse_position"] < 1e-4


def test_recordings_from_before_zero_are_shifted(tmp_path: Path, succeed: Succeed) -> None:
    table, geometry = write_arc(tmp_path)
    lines = table.read_text().splitlines()
    moved = [lines[0]]
    for line in lines[1:]:
        time, _, rest = line.partition(",")
        moved.append(f"{float(time) - 120.0!r},{rest}")
    table.write_text("\n".join(moved))
    succeed("import-csv", table, tmp_path / "bag", "--geometry", geometry)
    with BagReader(tmp_path / "bag") as bag:
        assert bag.start_ns == 3 * 10**9
        assert bag.duration_s == pytest.approx(40.0)


def test_ticks_beyond_32_bits_wrap(tmp_path: Path, succeed: Succeed) -> None:
    table, geometry = write_arc(tmp_path)
    lines = table.read_text().splitlines()
    far = [lines[0]]
    for line in lines[1:]:
        cells = line.split(",")
        cells[1] = repr(int(cells[1]) + 2**31 - 400_000)
        cells[2] = repr(int(cells[2]) + 5 * 2**32)
        far.append(",".join(cells))
    wide = tmp_path / "wide.csv"
    wide.write_text("\n".join(far) + "\n")
    for source, name in ((table, "plain"), (wide, "far")):
        succeed("import-csv", source, tmp_path / name, "--geometry", geometry)
        words = ["--params", tmp_path / f"{name}.yaml"]
        succeed("replay", tmp_path / name, tmp_path / f"{name}_out", *words)
    plain, wrapped = (records(tmp_path / f"{name}_out", "/odom") for name in ("plain", "far"))
    assert [record.data for record in plain] == [record.data for record in wrapped]


def test_fixes_of_their_own_with_covariances(tmp_path: Path, succeed: Succeed) -> None:
    table, geometry = write_arc(tmp_path)
    fixes = tmp_path / "fixes.csv"
    fixes.write_text(
        "t,fix_x,fix_y,fix_theta,sig_x,sig_y,sig_theta,rho_xy\n"
        "101.5,1.0,2.0,0.5,0.1,0.2,0.05,0.5\n"
        "102.5,,2.0,0.5,0.1,0.2,0.05,0.5\n"
        "103.5,1.0,2.0,0.5,nan,0.2,0.05,0.5\n"
    )
    succeed("import-csv", table, tmp_path / "bag", "--geometry", geometry, "--fixes", fixes)
    with BagReader(tmp_path / "bag") as bag:
        first, second = [bag.message(record) for record in bag.records({"/lrf_pose"})]
    assert messages.stamp_ns(first) == 101_500_000_000
    np.testing.assert_allclose(messages.planar_pose(first), [1.0, 2.0, 0.5])
    np.testing.assert_allclose(
        messages.planar_block(first.pose.covariance),
        [[0.01, 0.01, 0.0], [0.01, 0.04, 0.0], [0.0, 0.0, 0.0025]],
    )
    np.testing.assert_array_equal(messages.planar_block(second.pose.covariance), 0.0)
    values = read_parameter_file(tmp_path / "bag.yaml", "localizer")
    assert values["lrf_use_yaw"] is True


CSV = "t,left_ticks,right_ticks\n1,0,0\n2,1,1\n"


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("", "has no data"),
        ("t,left_ticks,right_ticks\n", "has no data"),
        ("t,left_ticks\n1,0\n2,1\n", "has no column 'right_ticks': it has t, left_ticks"),
        ("time,left_ticks,right_ticks\n1,0,0\n", "has no column 't'"),
        ("t,left_ticks,right_ticks\n1,0,0\n2,one,1\n", "line 3: left_ticks is 'one', expected a"),
        ("t,left_ticks,right_ticks\n1,0,0\n2,1\n", "line 3: 2 fields, expected 3"),
        ("t,left_ticks,right_ticks\n1,0,0\n,1,1\n", "line 3: t is "),
        ("t,left_ticks,right_ticks\n1,0,0\ninf,1,1\n", "line 3: t is 'inf'"),
        ("t,left_ticks,right_ticks,gt_x\n1,0,0,0\n", "has no column 'gt_y'"),
        ("t,left_ticks,right_ticks,fix_y\n1,0,0,0\n", "has no column 'fix_x'"),
    ],
)
def test_import_refuses_tables(tmp_path: Path, refuse: Refuse, text: str, expected: str) -> None:
    (tmp_path / "table.csv").write_text(text)
    (tmp_path / "geometry.json").write_text(json.dumps(ARC_GEOMETRY))
    words = [tmp_path / "table.csv", tmp_path / "out", "--geometry", tmp_path / "geometry.json"]
    assert expected in refuse("import-csv", *words)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (None, "--geometry is needed"),
        ("", "is not JSON"),
        ("{", "is not JSON"),
        ("[1]", "expected an object"),
        ('{"metres_per_tick": 0.1}', "wheel_base_m is None, expected a number"),
        ('{"wheel_base_m": "0.5", "metres_per_tick": 0.1}', "wheel_base_m is '0.5'"),
        ('{"wheel_base_m": true, "metres_per_tick": 0.1}', "wheel_base_m is True"),
        ('{"wheel_base_m": 0.5, "metres_per_tick": 0}', "metres_per_tick is 0,"),
        ('{"wheel_base_m": 0.5, "metres_per_tick": NaN}', "metres_per_tick is nan"),
        ('{"wheel_base_m": 5000, "metres_per_tick": 1e-3}', "wheel_base_m is 5000, expected"),
    ],
)
def test_import_refuses_geometries(
    tmp_path: Path, refuse: Refuse, text: str | None, expected: str
) -> None:
    (tmp_path / "table.csv").write_text(CSV)
    words: list[object] = [tmp_path / "table.csv", tmp_path / "out"]
    if text is not None:
        (tmp_path / "geometry.json").write_text(text)
        words += ["--geometry", tmp_path / "geometry.json"]
    assert expected in refuse("import-csv", *words)


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["--truth-columns", "gt_x"], "--truth-columns gt_x: expected two or three columns"),
        (["--truth-columns", "a", "b"], "has no column 'a'"),
        (["--fix-columns", "t", "b"], "has no column 'b'"),
        (["--compass-column", "yaw"], "has no column 'yaw'"),
        (["--fixes", "nowhere.csv"], "'nowhere.csv': No such file"),
        (["--geometry", "nowhere.json"], "'nowhere.json': No such file"),
    ],
)
def test_import_refuses_options(
    tmp_path: Path, refuse: Refuse, words: list[str], expected: str
) -> None:
    (tmp_path / "table.csv").write_text(CSV)
    (tmp_path / "geometry.json").write_text(json.dumps(ARC_GEOMETRY))
    line = refuse(
        "import-csv", tmp_path / "table.csv", tmp_path / "out", "--geometry",
        tmp_path / "geometry.json", *words,
    )  # fmt: skip
    assert expected in line


def test_import_overwrites_nothing(tmp_path: Path, refuse: Refuse) -> None:
    table, geometry = write_arc(tmp_path)
    (tmp_path / "bag").mkdir()
    (tmp_path / "other.yaml").write_text("mine")
    for name in ("bag", "other"):
        line = refuse("import-csv", table, tmp_path / name, "--geometry", geometry)
        assert "exists already" in line
    assert "No such file" in refuse("import-csv", tmp_path / "no.csv", tmp_path / "new")


def test_import_refuses_times_that_are_no_seconds(tmp_path: Path, refuse: Refuse) -> None:
    (tmp_path / "table.csv").write_text("t,left_ticks,right_ticks\n1.5e18,0,0\n1.6e18,1,1\n")
    (tmp_path / "geometry.json").write_text(json.dumps(ARC_GEOMETRY))
    refuse(
        "import-csv", tmp_path / "table.csv", tmp_path / "out", "--geometry",
        tmp_path / "geometry.json",
    )  # fmt: skip


def test_a_blank_line_at_the_end_does_no_harm(tmp_path: Path, succeed: Succeed) -> None:
    (tmp_path / "table.csv").write_text(CSV + "\n")
    (tmp_path / "geometry.json").write_text(json.dumps(ARC_GEOMETRY))
    succeed(
        "import-csv", tmp_path / "table.csv", tmp_path / "out", "--geometry",
        tmp_path / "geometry.json",
    )  # fmt: skip
