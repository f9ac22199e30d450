# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Recordings played into live topics, and what the live localizer makes of them."""

import shutil
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from places import BAGS, RECORDINGS, needs_recordings

from fnn_ekf_ros import messages
from fnn_ekf_ros.cli import run_command
from fnn_ekf_ros.evaluation.errors import TrackErrors
from fnn_ekf_ros.evaluation.evaluation import against_truth
from fnn_ekf_ros.recordings.bag_files import BagReader
from fnn_ekf_ros.recordings.trajectories import read_trajectory
from fnn_ekf_ros.ros.record import Recorder

pytestmark = pytest.mark.live
GOOD_NOISE = [
    "-p", "process_noise_std:=[0.04, 0.08]", "-p", "measurement_noise_std:=[0.8, 0.8, 0.3]",
    "-p", "lrf_yaw_std:=0.3", "-p", "adaptation:=none",
]  # fmt: skip
"""Found by hand for one of the recordings, so that nothing is left to adapt."""
LONGEST_S = 60.0
"""Duration of a real recording that is played [s]; test_real_recordings.py replays all of it."""


def played(
    processes: Any,
    patiently: Callable[..., None],
    bag: Path,
    options: list[str],
    topics: list[str],
    offline: TrackErrors,
    rate: int = 10,
) -> TrackErrors:
    """Play a bag with ticks into a live localizer and score its odom.

    Ticks are stamped on arrival: a stall of the machine shifts them against the fixes by its length
    times the rate. A localizer that differs from the replay is given another go, at half the rate.
    """
    for slower in (1, 2, 4, 8):
        out = processes.folder / f"live{slower}"
        play_once(
            processes, patiently, bag, out, options, topics,
            "--rate", rate / slower, "--keep-pace-with", "odom",
        )  # fmt: skip
        live = scored(out, bag)
        if same(live, offline):
            break
        print(f"rate {rate / slower:g}: {live}, offline {offline}")
    return live


def same(live: TrackErrors, offline: TrackErrors) -> bool:
    """Return whether live and replay agree but for when ticks arrived."""
    return live.poses >= 0.9 * offline.poses and all(
        a == pytest.approx(b, rel=0.05, nan_ok=True)
        for a, b in (
            (live.position.rmse, offline.position.rmse),
            (live.yaw.rmse, offline.yaw.rmse),
        )
    )


def play_once(
    processes: Any,
    patiently: Callable[..., None],
    bag: Path,
    out: Path,
    options: list[str],
    topics: list[str],
    *playing: object,
    expected: int = 0,
) -> None:
    """Play a bag into a live localizer and record what it publishes, so much odom at least."""
    with Recorder(out, {"/odom": messages.ODOMETRY_TYPE}) as recorder:
        localizer = processes.start("localizer", "--ros-args", *options, "-p", "use_sim_time:=true")
        patiently(lambda: recorder.spin_once(0.05) or recorder.connected(), "the localizer")
        player = processes.start(
            "play", bag, *playing, "--clock", "--topics", *topics,
            "--wait-for-subscribers", 60, "--delay", 1,
        )  # fmt: skip
        patiently(
            lambda: recorder.spin_once(0.05) or player.poll() is not None, "the player", 800.0
        )
        assert player.returncode == 0, processes.output(player)
        patiently(
            lambda: recorder.spin_once(0.05) or recorder.counts["/odom"] >= expected,
            "the last odom",
        )
        processes.stop(localizer)
        until = time.monotonic() + 0.5
        while time.monotonic() < until:
            recorder.spin_once(0.05)


def scored(estimate: Path, truth: Path) -> TrackErrors:
    with BagReader(estimate) as live, BagReader(truth) as recorded:
        track, true = read_trajectory(live, "/odom"), read_trajectory(recorded, "/ground_truth")
    result = against_truth(track, true)
    assert result is not None
    return result.errors


def replayed(processes: Any, bag: Path, options: list[str]) -> TrackErrors:
    out = processes.folder / "replayed"
    done = processes.run("replay", bag, out, *options)
    assert done.returncode == 0, done.stderr
    return scored(out, bag)


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Half a simulated minute, with its parameters beside it."""
    bag = tmp_path_factory.mktemp("drive") / "bag"
    words = ["--duration", "30", "-p", "seed:=7", "-p", "path:=sim1"]
    assert run_command("simulate", [str(bag), *words]) == 0
    return bag


def test_live_equals_replay_to_the_last_bit_where_the_player_keeps_pace(
    processes: Any, ros_environment: None, patiently: Callable[..., None], drive: Path
) -> None:
    """Stamped wheels, all else as shipped; however fast it is played, on however busy a machine."""
    options = ["-p", "encoder_source:=joint_states"]
    offline, live = processes.folder / "replayed", processes.folder / "live"
    replayed(processes, drive, ["--params", f"{drive}.yaml", *options])
    with BagReader(offline) as bag:
        computed = read_trajectory(bag, "/odom")
    play_once(
        processes, patiently, drive, live, ["--params-file", f"{drive}.yaml", *options],
        ["compass", "lrf_pose", "joint_states"], "--rate", 100, "--keep-pace-with", "odom",
        expected=len(computed.time_ns),
    )  # fmt: skip
    with BagReader(live) as bag:
        published = read_trajectory(bag, "/odom")
    np.testing.assert_array_equal(published.time_ns, computed.time_ns)
    np.testing.assert_array_equal(published.pose, computed.pose)
    np.testing.assert_array_equal(published.covariance, computed.covariance)


def test_live_equals_replay_with_ticks(
    processes: Any, ros_environment: None, patiently: Callable[..., None], drive: Path
) -> None:
    """They are stamped on arrival: played at a low rate, so that hiccups count 8 times only."""
    options = ["-p", "adaptation:=r"]
    offline = replayed(processes, drive, ["--params", f"{drive}.yaml", *options])
    live = played(
        processes, patiently, drive, ["--params-file", f"{drive}.yaml", *options],
        ["compass", "lrf_pose", "left_ticks", "right_ticks"], offline, 8,
    )  # fmt: skip
    assert live.poses >= 0.9 * offline.poses
    assert live.position.rmse == pytest.approx(offline.position.rmse, rel=0.05)
    assert live.yaw.rmse == pytest.approx(offline.yaw.rmse, rel=0.05)


@needs_recordings
@pytest.mark.parametrize(
    ("name", "truth", "worst_position"),
    [
        ("mrclam1_robot1", ["gt_x", "gt_y", "gt_theta"], 0.15),
        ("brenner_robot4", ["gt_x_aligned", "gt_y_aligned"], 0.25),
    ],
)
def test_live_equals_replay_on_a_real_robot(
    processes: Any,
    ros_environment: None,
    patiently: Callable[..., None],
    name: str,
    truth: list[str],
    worst_position: float,
) -> None:
    bag, folder = processes.folder / "bag", processes.folder
    for file in (f"{name}.csv", f"{name}_fixes.csv"):
        first, *rows = (RECORDINGS / file).read_text().splitlines(keepends=True)
        short = [row for row in rows if float(row.split(",")[0]) < LONGEST_S]
        (folder / file).write_text("".join([first, *short]))
    shutil.copy(RECORDINGS / f"{name}.json", folder)
    made = processes.run(
        "import-csv", folder / f"{name}.csv", bag, "--fixes", folder / f"{name}_fixes.csv",
        "--geometry", folder / f"{name}.json", "--truth-columns", *truth,
    )  # fmt: skip
    assert made.returncode == 0, made.stderr
    offline = replayed(processes, bag, ["--params", f"{bag}.yaml", *GOOD_NOISE])
    live = played(
        processes, patiently, bag, ["--params-file", f"{bag}.yaml", *GOOD_NOISE],
        ["left_ticks", "right_ticks", "lrf_pose"], offline,
    )  # fmt: skip
    print(f"{name}: live {live}, offline {offline}")
    assert offline.position.rmse <= worst_position
    assert live.position.rmse == pytest.approx(offline.position.rmse, rel=0.05)


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["nowhere"], "bag 'nowhere' does not exist"),
        (["BAG", "--topics", "moon"], "has no topic /moon"),
        (["BAG", "--rate", "0"], "--rate 0: expected"),
        (["BAG", "--wait-for-subscribers", "0.1"], "no subscriber after 0.1 s on"),
        (["BAG", "--lead", "0"], "--lead 0: expected"),
        (["BAG", "--patience", "-1"], "--patience -1: expected"),
        (
            ["BAG", "--keep-pace-with", "odom", "--patience", "0.1"],
            "no publisher after 0.1 s on /odom",
        ),
        (["BAG", "--keep-pace-with", "compass"], "--keep-pace-with /compass: it is played itself"),
        (
            ["BAG", "--keep-pace-with", "/rosout"],
            "rcl_interfaces/msg/Log: expected one with a header",
        ),
    ],
)
def test_wrong_play_arguments_end_it_with_one_line(
    run: Callable[..., Any],
    ros_environment: None,
    arguments: list[str],
    expected: str,
) -> None:
    ended = run("play", *[BAGS / "round" if word == "BAG" else word for word in arguments])
    assert ended.code == 1
    lines = ended.err.strip().splitlines()
    assert len(lines) == 1, ended.err
    assert expected in lines[0]
