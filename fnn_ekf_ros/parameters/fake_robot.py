# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The parameters of `fake_robot` and `simulate`."""

import math
from dataclasses import dataclass

from fnn_ekf_ros.parameters.paper import (
    ENCODER_COUNTS_PER_REVOLUTION,
    MEASUREMENT_STD,
    SIMULATION_1_STD,
    SIMULATION_2_STD,
    WHEEL_RADIUS,
    WHEEL_SEPARATION,
    YAW_STD,
)
from fnn_ekf_ros.parameters.schema import NO_FILE, Parameters, parameter

NODE_NAME = "fake_robot"
"""The node's name, which parameter files have as their section."""


@dataclass(frozen=True, slots=True)
class FakeRobotParameters(Parameters):
    """Parameters of the simulated robot; geometry and noise are the paper's."""

    # Geometry
    wheel_radius: float = parameter(
        WHEEL_RADIUS, "Radius of the wheels, D / 2.", "m", at_least=1e-4, at_most=10.0
    )
    wheel_separation: float = parameter(
        WHEEL_SEPARATION,
        "Distance between the wheels' contact points, L.",
        "m",
        at_least=1e-3,
        at_most=100.0,
    )
    gear_ratio: float = parameter(
        1.0, "Encoder turns per wheel turn, n.", "", at_least=1e-6, at_most=1e6
    )
    encoder_counts_per_revolution: float = parameter(
        ENCODER_COUNTS_PER_REVOLUTION,
        "Counts per turn of the encoder, C_e.",
        "counts",
        at_least=1e-3,
        at_most=1e9,
    )

    # Rates
    encoder_rate: float = parameter(
        20.0,
        "Rate of ticks and joint_states; the counters are read at the ends of steps of 12.5 ms, "
        "so 80 is the most.",
        "Hz",
        at_least=0.1,
        at_most=80.0,
    )
    compass_rate: float = parameter(
        8.0,
        "Rate of the compass; its stamps are multiples of 1 / compass_rate.",
        "Hz",
        at_least=0.1,
        at_most=100.0,
    )
    lrf_rate: float = parameter(
        2.6667,
        "Rate of the laser fixes; their stamps are multiples of 1 / lrf_rate, with 2.6667 "
        "exactly of 375 ms.",
        "Hz",
        at_least=0.1,
        at_most=100.0,
    )

    # Encoders
    encoder_bits: int = parameter(
        32, "Width of the counters; they wrap at 2^bits, signed.", "bits", at_least=8, at_most=32
    )
    left_start_count: int = parameter(
        0, "Left counter at the start.", "counts", at_least=-(2**31), at_most=2**31 - 1
    )
    right_start_count: int = parameter(
        0, "Right counter at the start.", "counts", at_least=-(2**31), at_most=2**31 - 1
    )
    left_joint: str = parameter("left_wheel_joint", "Name of the left wheel in joint_states.")
    right_joint: str = parameter("right_wheel_joint", "Name of the right wheel in joint_states.")

    # Drive
    path: str = parameter(
        "square",
        "What is driven: a scripted path, or cmd_vel to follow that topic.",
        choices=("square", "round", "figure_eight", "sim1", "sim2", "cmd_vel"),
    )
    speed: float = parameter(
        0.3, "Speed along a scripted path.", "m/s", at_least=1e-3, at_most=10.0
    )
    cmd_vel_timeout: float = parameter(
        0.5,
        "The robot stops when cmd_vel has been silent for so long.",
        "s",
        at_least=1e-3,
        at_most=3600.0,
    )
    wheel_speed_error: float = parameter(
        0.05,
        "Motor control holds each wheel's speed within this part of the command.",
        "",
        at_least=0.0,
        at_most=0.5,
    )

    # Noise
    slip_std: tuple[float, float] = parameter(
        (math.nan, math.nan),
        "Motion the encoders do not see, per 375 ms: distance, rotation; .nan: [0.02, 0.01745] on "
        "path sim1, [0.05, 0.05236] on the others.",
        "[m, rad]",
        at_least=0.0,
        at_most=1e3,
        may_be_nan=True,
    )
    lrf_std: tuple[float, float, float] = parameter(
        MEASUREMENT_STD, "Noise of the laser fixes.", "[m, m, rad]", at_least=0.0, at_most=1e3
    )
    compass_std: float = parameter(
        YAW_STD, "Noise of the compass.", "rad", at_least=0.0, at_most=1e3
    )
    seed: int = parameter(
        1,
        "Seed of everything random: the same seed gives the same run.",
        "",
        at_least=0,
        at_most=2**31 - 1,
    )

    # Faults
    faults_file: str = parameter(
        NO_FILE, "Timeline of faults (YAML; docs/faults.md lists them); none: nothing goes wrong."
    )

    # Time
    publish_clock: bool = parameter(
        False, "Run on a clock of its own, from 0, and publish it as /clock for use_sim_time."
    )
    real_time_factor: float = parameter(
        1.0, "Speed of that clock.", "", at_least=1e-3, at_most=1000.0
    )

    # Frames
    frame_id: str = parameter("map", "Frame of the fixes and of ground_truth.")
    base_frame: str = parameter("base_link", "Frame of the robot: the middle of the axle.")

    def slip(self) -> tuple[float, float]:
        """Return the slip per 375 ms: as set, or the path's own (m, rad)."""
        if not math.isnan(self.slip_std[0]):
            return self.slip_std
        return SIMULATION_1_STD if self.path == "sim1" else SIMULATION_2_STD
