# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Parameters that put a robot's mistakes right: with them the filter sees what it should have."""

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from fnn_ekf_ros import messages
from fnn_ekf_ros.core.arrays import Row
from fnn_ekf_ros.core.odometry import control_from_counts
from fnn_ekf_ros.messages import Message
from fnn_ekf_ros.parameters.localizer import LocalizerParameters
from fnn_ekf_ros.simulation.listening import as_object
from fnn_ekf_ros.timeline.epochs import Cutter, Instant
from fnn_ekf_ros.timeline.events import CompassYaw, PoseFix, PoseReset, Rejected
from fnn_ekf_ros.timeline.filter_model import wheel_geometry


def parameters(**changes: Any) -> LocalizerParameters:
    return LocalizerParameters(
        wheel_radius=0.05, wheel_separation=0.4, encoder_counts_per_revolution=1000.0, **changes
    )


def pose_message(pose: list[float], variances: list[float]) -> SimpleNamespace:
    """Return the message of a pose in the map."""
    covariance = messages.planar_covariance(np.diag(variances))
    message: SimpleNamespace = as_object(
        Message(
            messages.POSE_TYPE,
            {
                "header": messages.header(10**9, "map"),
                "pose": messages.pose_with_covariance(np.array(pose), covariance),
            },
        )
    )
    return message


def fix(topic: str, given: LocalizerParameters) -> PoseFix | PoseReset:
    """Return the event of a pose at (2000, -500), yaw 0.4, std 100, 200, 0.1."""
    message = pose_message([2000.0, -500.0, 0.4], [1e4, 4e4, 0.01])
    events = messages.read_input(topic, message, 10**9, given)
    assert isinstance(events, list)
    (event,) = events
    assert isinstance(event, PoseFix | PoseReset)
    return event


@pytest.mark.parametrize("encoder_source", ["ticks", "joint_states"])
def test_multipliers_scale_the_travel_of_their_wheel(encoder_source: str) -> None:
    plain = wheel_geometry(parameters(encoder_source=encoder_source))
    scaled = wheel_geometry(
        parameters(
            encoder_source=encoder_source,
            left_wheel_radius_multiplier=0.5,
            right_wheel_radius_multiplier=1.2,
        )
    )
    expected = control_from_counts(plain, 0.5 * 100.0, 1.2 * 80.0)
    assert control_from_counts(scaled, 100.0, 80.0) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("heading", [0.0, 0.5 * math.pi, 2.0, -3.0])
def test_a_compass_in_ned_reads_like_one_in_enu(heading: float) -> None:
    given = parameters(compass_clockwise=True, compass_offset=0.5 * math.pi)
    ned = 0.5 * math.pi - heading  # clockwise from north
    instants = [Instant(10, (CompassYaw(10, ned),))]
    (epoch,) = Cutter(given).epochs(0, 10, instants, lambda _: np.zeros(2), np.zeros(2))
    assert epoch.measurement[Row.COMPASS_YAW] == pytest.approx(heading)


def test_fixes_are_scaled_with_their_covariance_and_turned() -> None:
    event = fix(messages.LRF_POSE, parameters(lrf_pose_scale=1e-3, lrf_yaw_offset=0.3))
    assert event.pose == pytest.approx([2.0, -0.5, 0.7])
    assert np.diag(event.covariance) == pytest.approx([0.01, 0.04, 0.01])


@pytest.mark.parametrize(
    ("position", "variance", "told"),
    [(1e305, 1.0, "lrf_pose at (inf, -500) m"), (1.0, 1e300, "[inf, 1e+12]")],
)
def test_what_a_scale_makes_infinite_is_refused(
    position: float, variance: float, told: str
) -> None:
    given = parameters(lrf_pose_scale=1e6, lrf_use_message_covariance=True)
    rejected = messages.read_input(
        messages.LRF_POSE, pose_message([position, -5e-4, 0.4], [variance, 1.0, 0.01]), 10**9, given
    )
    assert isinstance(rejected, Rejected)
    assert told in rejected.reason


def test_a_pose_that_is_set_is_taken_as_it_is() -> None:
    event = fix(messages.INITIAL_POSE, parameters(lrf_pose_scale=1e-3, lrf_yaw_offset=0.3))
    assert event.pose == pytest.approx([2000.0, -500.0, 0.4])
