# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Recordings of real robots, where they are at hand, and a long recording."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
from commands import Succeed, table_rows
from places import RECORDINGS, needs_recordings

from fnn_ekf_ros import messages
from fnn_ekf_ros.messages import Message
from fnn_ekf_ros.recordings.bag_files import BagReader, Record
from fnn_ekf_ros.recordings.bag_writer import BagWriter


def imported(succeed: Succeed, folder: Path, name: str, *words: str) -> Path:
    """Import a recording with its fixes."""
    bag = folder / name
    succeed(
        "import-csv", RECORDINGS / f"{name}.csv", bag, "--fixes", RECORDINGS / f"{name}_fixes.csv",
        "--geometry", RECORDINGS / f"{name}.json", *words,
    )  # fmt: skip
    return bag


@needs_recordings
@pytest.mark.slow
def test_mrclam_with_noise_found_by_hand(tmp_path: Path, succeed: Succeed) -> None:
    bag = imported(succeed, tmp_path, "mrclam1_robot1")
    succeed(
        "replay", bag, tmp_path / "out", "--params", tmp_path / "mrclam1_robot1.yaml",
        "-p", "adaptation:=none", "-p", "process_noise_std:=[0.04, 0.08]",
        "-p", "measurement_noise_std:=[0.8, 0.8, 0.3]", "-p", "lrf_yaw_std:=0.3",
    )  # fmt: skip
    succeed("evaluate", tmp_path / "out", "--labels", "it", "--json", tmp_path / "it.json")
    scores = json.loads((tmp_path / "it.json").read_text())["it"]
    assert scores["count"] > 3900
    assert scores["rmse_position"] <= 0.25
    assert scores["rmse_theta"] <= 0.20
    with BagReader(tmp_path / "out") as result:
        poses = np.array(
            [messages.planar_pose(result.message(r)) for r in result.records({"/odom"})]
        )
    assert np.all(np.isfinite(poses))


@needs_recordings
@pytest.mark.slow
def test_brenner_with_positions_for_truth(tmp_path: Path, succeed: Succeed) -> None:
    bag = imported(
        succeed, tmp_path, "brenner_robot4", "--truth-columns", "gt_x_aligned", "gt_y_aligned"
    )
    succeed("replay", bag, tmp_path / "out", "--params", tmp_path / "brenner_robot4.yaml")
    said = succeed("evaluate", tmp_path / "out", "--labels", "it", "--json", tmp_path / "it.json")
    scores = json.loads((tmp_path / "it.json").read_text())["it"]
    assert scores["rmse_theta"] is None
    assert table_rows(said)["it"][3] == "n/a"
    assert "it: NEES: not known" in said
    assert "it: NEES of position: " in said
    assert scores["count"] > 130
    assert math.isfinite(scores["rmse_position"])
    assert scores["rmse_position"] < 0.15


@pytest.mark.slow
def test_a_long_recording_is_replayed_to_its_end(tmp_path: Path, succeed: Succeed) -> None:
    """10 minutes of ticks at 10 Hz, a compass, fixes every period; the robot drives on a circle."""
    start, length_ns = 3 * 10**9, 600 * 10**9
    speed, rate = 0.3, 0.1
    rng = np.random.default_rng(6)
    with BagWriter(tmp_path / "long") as bag:
        measured = iter(range(start, start + length_ns, 375_000_000))
        due = next(measured)
        for now in range(start, start + length_ns, 100_000_000):
            while due is not None and due <= now:
                t = (due - start) * 1e-9
                pose = np.array([3.0 * math.sin(rate * t), 3.0 - 3.0 * math.cos(rate * t), 0.0])
                pose += 0.1 * rng.standard_normal(3)
                fields = {
                    "header": messages.header(due, "map"),
                    "pose": messages.pose_with_covariance(pose, np.zeros((6, 6))),
                }
                yaw = rate * t + 0.13 * rng.standard_normal()
                compass = messages.compass_message(due, "base_link", yaw, 0.0)
                bag.write("/compass", compass, due)
                bag.write("/lrf_pose", Message(messages.POSE_TYPE, fields), due)
                due = next(measured, None)
            for topic, side in (("/left_ticks", -1.0), ("/right_ticks", 1.0)):
                way = (speed + side * 0.3 * rate) * (now - start) * 1e-9
                count = int(way / (math.pi * 0.05 / 500.0))
                data = b"\x00\x01\x00\x00" + count.to_bytes(4, "little", signed=True)
                bag.write_raw(Record(topic, messages.TICKS_TYPE, now, data))
    succeed(
        "replay", tmp_path / "long", tmp_path / "out", "-p", "adaptation:=r",
        "-p", "wheel_radius:=0.025", "-p", "wheel_separation:=0.6",
        "-p", "encoder_counts_per_revolution:=500",
    )  # fmt: skip
    with BagReader(tmp_path / "out") as result:
        assert result.topics["/odom"].message_count >= 1595
        last = [result.message(r) for r in result.records({"/odom"})][-1]
    t = (messages.stamp_ns(last) - start) * 1e-9
    truth = [3.0 * math.sin(rate * t), 3.0 - 3.0 * math.cos(rate * t)]
    assert np.linalg.norm(messages.planar_pose(last)[:2] - truth) < 0.3
