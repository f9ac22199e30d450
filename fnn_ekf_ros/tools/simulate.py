"""`simulate OUT`: the fake robot straight into a rosbag2, faster than real time."""

import argparse
from dataclasses import asdict
from pathlib import Path

import numpy as np

from fnn_ekf_ros.bag_files import STORAGES, BagWriter, file_beside
from fnn_ekf_ros.errors import FnnEkfError
from fnn_ekf_ros.parameters.fake_robot import NODE_NAME, FakeRobotParameters
from fnn_ekf_ros.parameters.fault_files import read_faults
from fnn_ekf_ros.parameters.files import render_parameter_file
from fnn_ekf_ros.parameters.localizer import NODE_NAME as LOCALIZER
from fnn_ekf_ros.parameters.localizer import LocalizerParameters
from fnn_ekf_ros.parameters.schema import build, default_of
from fnn_ekf_ros.simulation.delivery import STEP_NS
from fnn_ekf_ros.simulation.fake_robot import FakeRobot
from fnn_ekf_ros.tools.arguments import add_parameter_arguments, given_parameters
from fnn_ekf_ros.tools.progress import with_progress

START_NS = 3 * 10**9
"""ROS time at which simulated recordings start: eight periods [ns]."""
FAULTS_NOTE = "faults"
"""Key of the timeline of faults among the notes in a bag's metadata."""
SMALLEST_SLIP = 1e-3
"""A filter needs some process noise even for a robot that never slips (m, rad)."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument("out", metavar="OUT", type=Path, help="the bag to write (a new folder)")
    parser.add_argument(
        "--duration", type=float, default=300.0, metavar="S", help="length [s] (300)"
    )
    parser.add_argument("--storage", choices=STORAGES, default="mcap", help="format (mcap)")
    add_parameter_arguments(parser)


def run(arguments: argparse.Namespace) -> int:
    """Run the command."""
    parameters = build(FakeRobotParameters, given_parameters(arguments, NODE_NAME))
    if not STEP_NS * 1e-9 <= arguments.duration <= 1e6:
        raise FnnEkfError(
            f"--duration {arguments.duration:g}: expected {STEP_NS * 1e-9:g} to 1e6 seconds"
        )
    if parameters.path == "cmd_vel":
        raise FnnEkfError("path 'cmd_vel': simulate has no cmd_vel to listen to; choose a path")
    steps = round(arguments.duration * 1e9) // STEP_NS
    text = render_parameter_file(FakeRobotParameters, asdict(parameters), NODE_NAME)
    head = f"Geometry and true noise of the robot in {arguments.out.name}."
    matching = render_parameter_file(
        LocalizerParameters, asdict(matching_localizer(parameters)), LOCALIZER, head
    )
    timeline = read_faults(parameters.faults_file)
    notes = {NODE_NAME: text} | ({FAULTS_NOTE: timeline.text} if timeline.text else {})
    robot = FakeRobot(parameters, START_NS, timeline.faults)
    with BagWriter(arguments.out, arguments.storage, notes, matching) as bag:
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


def matching_localizer(robot: FakeRobotParameters) -> LocalizerParameters:
    """Return localizer parameters with the fake robot's geometry and its true noise."""
    low, high = (
        default_of(LocalizerParameters, f"measurement_noise_std_{end}") for end in ("min", "max")
    )
    lrf_x, lrf_y, lrf_yaw = np.clip(robot.lrf_std, low, high)
    forward, turn = np.maximum(robot.slip(), SMALLEST_SLIP)
    return LocalizerParameters(
        wheel_radius=robot.wheel_radius,
        wheel_separation=robot.wheel_separation,
        gear_ratio=robot.gear_ratio,
        encoder_counts_per_revolution=robot.encoder_counts_per_revolution,
        encoder_bits=robot.encoder_bits,
        left_joint=robot.left_joint,
        right_joint=robot.right_joint,
        process_noise_std=(float(forward), float(turn)),
        measurement_noise_std=(
            float(lrf_x),
            float(lrf_y),
            float(np.clip(robot.compass_std, low[2], high[2])),
        ),
        lrf_yaw_std=float(lrf_yaw),
        frame_id=robot.frame_id,
        base_frame=robot.base_frame,
    )
