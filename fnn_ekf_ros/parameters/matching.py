# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Parameters of a localizer that fit a simulated robot."""

import numpy as np

from fnn_ekf_ros.parameters.fake_robot import FakeRobotParameters
from fnn_ekf_ros.parameters.localizer import LocalizerParameters
from fnn_ekf_ros.parameters.schema import default_of

SMALLEST_SLIP = 1e-3
"""Smallest configured process noise of 375 ms, as a standard deviation (m, rad): a filter needs
some even for a robot that never slips."""


def matching_localizer(robot: FakeRobotParameters) -> LocalizerParameters:
    """Return localizer parameters with the fake robot's geometry and its true noise."""
    low, high = (
        default_of(LocalizerParameters, f"measurement_noise_std_{end}") for end in ("min", "max")
    )
    lrf_x, lrf_y, lrf_yaw = np.clip(robot.lrf_std, low, high)
    distance, rotation = np.maximum(robot.slip(), SMALLEST_SLIP)
    return LocalizerParameters(
        wheel_radius=robot.wheel_radius,
        wheel_separation=robot.wheel_separation,
        gear_ratio=robot.gear_ratio,
        encoder_counts_per_revolution=robot.encoder_counts_per_revolution,
        encoder_bits=robot.encoder_bits,
        left_joint=robot.left_joint,
        right_joint=robot.right_joint,
        process_noise_std=(float(distance), float(rotation)),
        measurement_noise_std=(
            float(lrf_x),
            float(lrf_y),
            float(np.clip(robot.compass_std, low[2], high[2])),
        ),
        lrf_yaw_std=float(lrf_yaw),
        frame_id=robot.frame_id,
        base_frame=robot.base_frame,
    )
