# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""`simulate OUT`: the fake robot straight into a rosbag2, faster than real time."""

import argparse
from dataclasses import asdict
from pathlib import Path

from fnn_ekf_ros.commands.arguments import (
    Range,
    add_force_argument,
    add_parameter_arguments,
    check_ranges,
    given_parameters,
)
from fnn_ekf_ros.errors import FnnEkfError
from fnn_ekf_ros.parameters.fake_robot import NODE_NAME, FakeRobotParameters
from fnn_ekf_ros.parameters.fault_files import read_faults
from fnn_ekf_ros.parameters.files import render_parameter_file
from fnn_ekf_ros.parameters.localizer import NODE_NAME as LOCALIZER
from fnn_ekf_ros.parameters.localizer import LocalizerParameters
from fnn_ekf_ros.parameters.matching import matching_localizer
from fnn_ekf_ros.parameters.schema import NO_FILE, build
from fnn_ekf_ros.recordings.bag_writer import STORAGES, BagWriter, file_beside, refuse_inputs
from fnn_ekf_ros.reports.progress import with_progress
from fnn_ekf_ros.simulation.delivery import STEP_NS
from fnn_ekf_ros.simulation.fake_robot import FakeRobot

START_NS = 3 * 10**9
"""ROS time at which simulated recordings begin, eight periods [ns]: ROS time 0 means no time."""
LONGEST_S = 1e6
"""Largest duration of a simulated recording, eleven days [s]."""
FAULTS_NOTE = "faults"
"""Key of the timeline of faults in a bag's metadata."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument("out", metavar="OUT", type=Path, help="the bag to write (a new folder)")
    parser.add_argument(
        "--duration", type=float, default=300.0, metavar="S", help="duration [s] (300)"
    )
    parser.add_argument(
        "--storage", choices=STORAGES, default="mcap", help="storage format of the bag (mcap)"
    )
    add_force_argument(parser)
    add_parameter_arguments(parser, FakeRobotParameters)


def run(arguments: argparse.Namespace) -> int:
    """Run the command."""
    parameters = build(FakeRobotParameters, given_parameters(arguments, NODE_NAME))
    check_ranges(vars(arguments), {"duration": Range(STEP_NS * 1e-9, LONGEST_S, "s")})
    if parameters.path == "cmd_vel":
        raise FnnEkfError("path 'cmd_vel': simulate has no cmd_vel to listen to; choose a path")
    inputs = [*arguments.params]
    if parameters.faults_file != NO_FILE:
        inputs.append(Path(parameters.faults_file))
    refuse_inputs(arguments.out, inputs)
    steps = round(arguments.duration * 1e9) // STEP_NS
    text = render_parameter_file(FakeRobotParameters, asdict(parameters), NODE_NAME)
    head = f"Geometry and true noise of the robot in {arguments.out.name}."
    matching = render_parameter_file(
        LocalizerParameters, asdict(matching_localizer(parameters)), LOCALIZER, head
    )
    timeline = read_faults(parameters.faults_file)
    notes = {NODE_NAME: text} | ({FAULTS_NOTE: timeline.text} if timeline.text else {})
    robot = FakeRobot(parameters, START_NS, timeline.faults)
    writer = BagWriter(arguments.out, arguments.storage, notes, matching, replaces=arguments.force)
    with writer as bag:
        for _ in with_progress(range(steps), steps, "simulate"):
            for sent in robot.step():
                # Recorded when it is sent, by a clock that no fault sets: readers sort by it.
                bag.write(f"/{sent.topic}", sent.message, robot.time_ns)
    count = len(timeline.faults)
    with_faults = f", faults of {parameters.faults_file}: {count}" if count else ""
    print(
        f"{arguments.out}: {arguments.duration:g} s of path '{parameters.path}', seed "
        f"{parameters.seed}{with_faults}; {file_beside(arguments.out)}: matching localizer "
        "parameters"
    )
    return 0
