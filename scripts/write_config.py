# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Writes config/*.yaml from the defaults in the code: python3 scripts/write_config.py."""

from pathlib import Path

from fnn_ekf_ros.parameters import fake_robot, localizer
from fnn_ekf_ros.parameters.files import render_parameter_file

CONFIG = Path(__file__).resolve().parents[1] / "config"
"""Folder of the files that are written."""
LOCALIZER_HEAD = """\
Parameters of fnn_ekf_ros localizer, with their defaults.
wheel_radius, wheel_separation and encoder_counts_per_revolution must be set to your robot's."""
"""Comment at the top of the localizer's file."""
FAKE_ROBOT_HEAD = """\
Parameters of fnn_ekf_ros fake_robot, with their defaults: the paper's robot."""
"""Comment at the top of the fake robot's file."""

for kind, node_name, head in (
    (localizer.LocalizerParameters, localizer.NODE_NAME, LOCALIZER_HEAD),
    (fake_robot.FakeRobotParameters, fake_robot.NODE_NAME, FAKE_ROBOT_HEAD),
):
    path = CONFIG / f"{node_name}.yaml"
    path.write_text(render_parameter_file(kind, {}, node_name, head), encoding="utf-8")
    print(path)
