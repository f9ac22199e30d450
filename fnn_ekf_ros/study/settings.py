# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Parameters of a study's filters: what its robot is, and what a user may change."""

from dataclasses import asdict
from pathlib import Path
from typing import Any

from fnn_ekf_ros.errors import FnnEkfError
from fnn_ekf_ros.files.text_files import write_text
from fnn_ekf_ros.parameters.fake_robot import NODE_NAME as FAKE_ROBOT
from fnn_ekf_ros.parameters.fake_robot import FakeRobotParameters
from fnn_ekf_ros.parameters.files import render_parameter_file
from fnn_ekf_ros.parameters.localizer import NODE_NAME as LOCALIZER
from fnn_ekf_ros.parameters.localizer import LocalizerParameters
from fnn_ekf_ros.parameters.matching import matching_localizer
from fnn_ekf_ros.parameters.schema import build
from fnn_ekf_ros.study.filters import SET_BY_NAMES

SET_BY_STUDY = {
    "wheel_radius", "wheel_separation", "gear_ratio", "encoder_counts_per_revolution", "period",
    "process_noise_std", "measurement_noise_std", "lrf_yaw_std", "initial_pose", "initial_pose_std",
    *SET_BY_NAMES,
}  # fmt: skip
"""Parameters that the recordings, the starts and the names of the filters decide."""


def study_localizer(path: str, given: dict[str, Any]) -> LocalizerParameters:
    """Return the localizer's parameters for a robot that drives a path; its noise is the truth.

    Raises:
        FnnEkfError: a given parameter is wrong, or one that the study decides on.
    """
    refused = sorted(SET_BY_STUDY & given.keys())
    if refused:
        raise FnnEkfError(
            f"parameter '{refused[0]}': the study sets it; expected another parameter"
        )
    matching = matching_localizer(FakeRobotParameters(path=path))
    return build(LocalizerParameters, asdict(matching) | given)


def write_settings(out: Path, path: str, given: dict[str, Any]) -> None:
    """Write the parameters of a robot and of a filter with the right start."""
    robot, localizer = FakeRobotParameters(path=path), study_localizer(path, given)
    write_text(
        out / f"fake_robot_{path}.yaml",
        render_parameter_file(FakeRobotParameters, asdict(robot), FAKE_ROBOT),
    )
    write_text(
        out / f"localizer_{path}.yaml",
        render_parameter_file(LocalizerParameters, asdict(localizer), LOCALIZER),
    )
