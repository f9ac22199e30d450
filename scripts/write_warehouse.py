# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Makes bags/warehouse, the recording of README's first drive: python3 scripts/write_warehouse.py.

A simulated robot whose fixes err for seconds, as a user would have it: CSV files, and a geometry
with a mistake. Its encoder makes four times the counts that `robot.json` says, and its compass is
mounted a quarter turn to the left.
"""

import json
import math
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from documents import ROOT

from fnn_ekf_ros.cli import run_command
from fnn_ekf_ros.core.angles import wrap_angle
from fnn_ekf_ros.files.text_files import write_text
from fnn_ekf_ros.messages import stamp_ns
from fnn_ekf_ros.parameters.fake_robot import FakeRobotParameters
from fnn_ekf_ros.recordings.bag_files import BagReader

FOLDER = ROOT / "bags" / "warehouse"
"""Where the files are."""
DURATION_S = 150
"""Length of the drive [s]: long enough to tell errors of ten seconds from noise."""
FAULTS = """\
- {fault: wander, topic: lrf_pose, start: 0.0, duration: 300.0, std: 0.2, time_constant: 10.0}
"""
"""Fixes that err alike for about ten seconds, as those of a scan matcher do."""
SETTINGS = ("path:=round", "seed:=11", "slip_std:=[0.01,0.01]", "encoder_rate:=10.0")
"""Parameters of the simulated robot."""
COUNTS_FACTOR = 4
"""Counts of the encoder over those that the geometry says: four edges of each line."""
COMPASS_TURN = math.pi / 2.0
"""By which angle the compass is mounted to the left [rad]."""
TOPICS = ("/left_ticks", "/right_ticks", "/compass", "/lrf_pose", "/ground_truth")
"""What the files are made of."""


def main() -> None:
    """Write the files."""
    readings = simulated()
    write_text(FOLDER / "drive.csv", drive(readings))
    fixes = (f"{t:.3f},{x:.3f},{y:.3f}\n" for t, x, y, _ in readings["/lrf_pose"])
    write_text(FOLDER / "fixes.csv", "t,fix_x,fix_y\n" + "".join(fixes))
    robot = FakeRobotParameters()
    circumference = 2.0 * math.pi * robot.wheel_radius
    per_tick = COUNTS_FACTOR * circumference / robot.encoder_counts_per_revolution
    geometry = {"wheel_base_m": robot.wheel_separation, "metres_per_tick": round(per_tick, 7)}
    write_text(FOLDER / "robot.json", json.dumps(geometry, indent=2) + "\n")


def simulated() -> dict[str, np.ndarray]:
    """Return the readings of each topic, one a row: seconds since the start, then its numbers."""
    with tempfile.TemporaryDirectory() as name:
        faults, run = Path(name) / "faults.yaml", Path(name) / "run"
        faults.write_text(FAULTS)
        settings = [*SETTINGS, f"faults_file:={faults}"]
        words = [word for each in settings for word in ("-p", each)]
        if run_command("simulate", [str(run), "--duration", str(DURATION_S), *words]):
            raise SystemExit("the robot was not simulated")
        with BagReader(run) as bag:
            return rows(bag)


def rows(bag: BagReader) -> dict[str, np.ndarray]:
    """Return the readings of a bag, by topic."""
    found: dict[str, list[tuple[float, ...]]] = {topic: [] for topic in TOPICS}
    first_ns: int | None = None
    for record in bag.records(set(TOPICS)):
        first_ns = record.time_ns if first_ns is None else first_ns
        message = bag.message(record)
        stamped = hasattr(message, "header")
        time_ns = stamp_ns(message) if stamped else record.time_ns
        found[record.topic].append((1e-9 * (time_ns - first_ns), *numbers(message)))
    return {topic: np.array(each) for topic, each in found.items()}


def numbers(message: Any) -> tuple[float, ...]:
    """Return the numbers of a message: counts, a yaw, or x, y and yaw."""
    if hasattr(message, "data"):
        return (float(message.data),)
    pose = None if hasattr(message, "orientation") else message.pose.pose
    q = message.orientation if pose is None else pose.orientation
    yaw = 2.0 * math.atan2(q.z, q.w)
    return (yaw,) if pose is None else (pose.position.x, pose.position.y, yaw)


def drive(readings: dict[str, np.ndarray]) -> str:
    """Return the table of counts, compass and ground truth, each reading at its own time."""
    truth = readings["/ground_truth"]
    x, y, yaw = truth[:, 1], truth[:, 2], np.unwrap(truth[:, 3])
    lines = []
    both = zip(readings["/left_ticks"], readings["/right_ticks"], strict=True)
    for (t, left), (_, right) in both:
        at = [np.interp(t, truth[:, 0], column) for column in (x, y, yaw)]
        pose = f"{at[0]:.3f},{at[1]:.3f},{wrap_angle(at[2]):.3f}"
        lines.append((t, f"{left:.0f},{right:.0f},,{pose}"))
    for t, compass in readings["/compass"]:
        lines.append((t, f",,{wrap_angle(compass + COMPASS_TURN):.4f},,,"))
    table = "".join(f"{t:.3f},{words}\n" for t, words in sorted(lines))
    return "t,left_ticks,right_ticks,heading_meas,gt_x,gt_y,gt_theta\n" + table


if __name__ == "__main__":
    main()
