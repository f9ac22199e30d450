# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Rows of the fault matrix as processes: `fake_robot` and `localizer`, recorded."""

import os
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import yaml
from child_processes import running_with_log

from faults.scenarios import (
    END_S,
    RECORDED,
    SWITCHED_ON_S,
    TRUTH_INTERVAL_NS,
    FaultScenario,
    Run,
    read_run,
)
from fnn_ekf_ros.errors import FnnEkfError
from fnn_ekf_ros.parameters.faults import TOPICS
from fnn_ekf_ros.ros.record import Recorder

SEED = 1
"""Seed of `fake_robot`: the runs of all rows have the same noise."""
PATIENCE_S = 60.0
"""Longest wait for a process to appear, or to end before it is killed [s]."""
GEOMETRY = ("wheel_radius:=0.025", "wheel_separation:=0.6", "encoder_counts_per_revolution:=500.0")
"""Parameters of the localizer that have no usable default: those of `fake_robot`."""
DISCOVERY = """<?xml version="1.0" encoding="UTF-8"?>
<profiles xmlns="http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles">
  <participant profile_name="soon" is_default_profile="true"><rtps><builtin><discovery_config>
    <initialAnnouncements>
      <count>20</count><period><sec>0</sec><nanosec>50000000</nanosec></period>
    </initialAnnouncements>
    <leaseAnnouncement><sec>0</sec><nanosec>250000000</nanosec></leaseAnnouncement>
  </discovery_config></builtin></rtps></participant>
</profiles>
"""
"""The processes announce themselves often: simulated time does not wait until they have met."""


def command(name: str, parameters: Sequence[str]) -> list[str]:
    """Return the command line of a node; a shell's ignored SIGINT is not handed down."""
    given = [word for text in parameters for word in ("-p", text)]
    start = [sys.executable, "-m", "fnn_ekf_ros", name]
    return ["env", "--default-signal=INT", *start, "--ros-args", *given]


def record(given: FaultScenario, folder: Path, rate: float) -> None:
    """Run a row's processes in a folder and record them until the robot's time is over.

    Raises:
        FnnEkfError: a node ended or did not come up.
    """
    timeline = folder / "faults.yaml"
    silent = [
        {"fault": "dropout", "topic": topic, "start": 0.0, "duration": SWITCHED_ON_S}
        for topic in TOPICS
    ]
    timeline.write_text(yaml.safe_dump([*silent, *map(dict, given.timeline)]))
    source = "ticks" if given.ticks else "joint_states"
    localizer = command("localizer", [
        *GEOMETRY, "use_sim_time:=true", f"encoder_source:={source}", *given.localizer,
    ])  # fmt: skip
    robot = command("fake_robot", [
        "publish_clock:=true", f"real_time_factor:={rate}", f"seed:={SEED}", "path:=round",
        f"faults_file:={timeline}", *given.robot,
    ])  # fmt: skip
    needed = round(END_S * 1e9) // TRUTH_INTERVAL_NS
    logs = {name: folder / f"{name}.log" for name in ("localizer", "fake_robot")}
    with (
        Recorder(folder / "run", RECORDED) as recorder,
        running_with_log(logs["localizer"], localizer, PATIENCE_S) as node,
    ):
        others = {"/odom", "/localizer/noise", "/diagnostics"}
        there = lambda: all(recorder.publisher_count(topic) for topic in others)  # noqa: E731
        wait(there, recorder, [node], logs, PATIENCE_S)
        with running_with_log(logs["fake_robot"], robot, PATIENCE_S) as hardware:
            patience_s = PATIENCE_S + 5.0 * END_S / rate
            whole = lambda: recorder.counts["/ground_truth"] >= needed  # noqa: E731
            wait(whole, recorder, [node, hardware], logs, patience_s)


def wait(
    condition: Callable[[], bool],
    recorder: Recorder,
    processes: Sequence[subprocess.Popen[bytes]],
    logs: dict[str, Path],
    patience_s: float,
) -> None:
    """Record until a condition holds.

    Raises:
        FnnEkfError: a process ended, or it took too long.
    """
    deadline = time.monotonic() + patience_s
    while not condition():
        recorder.spin_once(0.05)
        for name, process in zip(logs, processes, strict=False):
            if process.poll() is not None:
                said = logs[name].read_text(errors="replace").strip().splitlines()[-1:]
                raise FnnEkfError(f"{name} ended with {process.returncode}: {' '.join(said)}")
        if time.monotonic() > deadline:
            raise FnnEkfError(f"not done after {patience_s:g} s")


def run_row(given: FaultScenario, folder: Path, rate: float) -> Run:
    """Run a row in a folder, so many times as fast as real time, and return what was recorded.

    Raises:
        FnnEkfError: it did not run.
    """
    folder.mkdir(parents=True)
    profile = folder / "discovery.xml"
    profile.write_text(DISCOVERY)
    os.environ["FASTRTPS_DEFAULT_PROFILES_FILE"] = str(profile)
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    os.environ["ROS_LOG_DIR"] = str(folder / "log")
    record(given, folder, rate)
    return read_run(folder / "run", given)
