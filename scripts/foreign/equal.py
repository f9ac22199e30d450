# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Runs that should equal another one, and how far apart they are."""

import contextlib
import io
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import yaml

from fnn_ekf_ros import messages
from fnn_ekf_ros.cli import run_command
from fnn_ekf_ros.commands.simulate import START_NS as BAG_START_NS
from fnn_ekf_ros.errors import FnnEkfError
from fnn_ekf_ros.parameters.fault_files import faults_from
from fnn_ekf_ros.recordings.bag_files import BagReader
from fnn_ekf_ros.simulation.fake_robot import FakeRobot
from fnn_ekf_ros.simulation.listening import Heard
from foreign.runs import (
    PATH,
    START_NS,
    Measured,
    Odom,
    Spoil,
    drive,
    heard,
    largest_difference,
    listened,
    localizer_of,
    recovery,
    robot_of,
)

SETTLED_S = 15.0
"""Time of a drive from which on errors count [s]: the start is as bad as a fault."""
DURATION_S = 60.0
"""Duration of the drives, and of a lap of a recording that plays in a loop [s]."""
LOOP_S = 5.0
"""Time of a lap from which on it is compared with the lap before [s]: the localizer has started."""


def undisturbed(
    seed: int,
    timeline: Sequence[Mapping[str, Any]] = (),
    spoil: Spoil | None = None,
    **localizer: Any,
) -> Measured:
    """Compare a run with the one in which nothing goes wrong.

    Args:
        seed: of the robot.
        timeline: the faults.
        spoil: changes messages.
        localizer: parameters of both runs that differ from the defaults.
    """
    faults = faults_from(list(timeline), "scenario")
    run = drive(seed, DURATION_S, faults, localizer=localizer, spoil=spoil)
    usual = drive(seed, DURATION_S, localizer=localizer)
    compared = (
        [odom for odom in each.odom if odom.stamp_ns >= START_NS + round(SETTLED_S * 1e9)]
        for each in (run, usual)
    )
    return Measured(recovery(run, SETTLED_S, SETTLED_S), largest_difference(*compared))


def replayed(seed: int, timeline: Sequence[Mapping[str, Any]]) -> Measured:
    """Compare a run with the replay of its recording, by the commands `simulate` and `replay`."""
    faults = faults_from(list(timeline), "scenario")
    run = drive(seed, DURATION_S, faults, start_ns=BAG_START_NS)
    with TemporaryDirectory() as made:
        folder = Path(made)
        (folder / "faults.yaml").write_text(yaml.safe_dump(list(timeline)), encoding="utf-8")
        _run(
            "simulate", folder / "bag", "--duration", DURATION_S, "-p", f"path:={PATH}",
            "-p", f"seed:={seed}", "-p", f"faults_file:={folder / 'faults.yaml'}",
        )  # fmt: skip
        geometry = localizer_of(robot_of(seed))
        given = [
            word
            for name in ("wheel_radius", "wheel_separation", "encoder_counts_per_revolution")
            for word in ("-p", f"{name}:={getattr(geometry, name)}")
        ]
        _run("replay", folder / "bag", folder / "out", *given)
        again = _odom_of(folder / "out")
    published = [odom for odom in run.odom if np.all(np.isfinite(odom.pose))]
    return Measured(recovery(run, SETTLED_S, SETTLED_S), largest_difference(published, again))


def looped(seed: int) -> Measured:
    """Compare the second lap of a recording that plays in a loop with the first."""
    robot = robot_of(seed)
    lap = list(heard(FakeRobot(robot, BAG_START_NS), DURATION_S))
    run = listened(localizer_of(robot), _laps(lap))
    first, second = (
        [o for o in run.odom if LOOP_S <= o.time_s - begin_s < DURATION_S - LOOP_S]
        for begin_s in (0.0, DURATION_S)
    )
    return Measured(recovery(run, DURATION_S, DURATION_S), largest_difference(first, second))


def _laps(lap: Sequence[tuple[Heard, float]]) -> Iterator[tuple[Heard, float]]:
    for begin_s in (0.0, DURATION_S):
        for arrival, time_s in lap:
            yield arrival, begin_s + time_s


def _odom_of(bag: Path) -> list[Odom]:
    """Return the odom of a bag; times and truth are not in it."""
    unknown = np.full(3, np.nan)
    with BagReader(bag) as reader:
        found = [reader.message(record) for record in reader.records({"/odom"})]
    return [
        Odom(
            time_s=0.0,
            stamp_ns=messages.stamp_ns(message),
            pose=messages.planar_pose(message),
            truth=unknown,
            finite=True,
        )
        for message in found
    ]


def _run(*words: object) -> None:
    """Run one of the package's commands.

    Raises:
        FnnEkfError: it failed.
    """
    name, *given = map(str, words)
    said = io.StringIO()
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
        code = run_command(name, given)
    if code:
        raise FnnEkfError(f"{name} ended with {code}: {said.getvalue().strip()}")
