# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Frozen sensors: diagnostics say what the filter decided, and name nobody else."""

import numpy as np
import pytest

from fnn_ekf_ros.core.state import start_filter
from fnn_ekf_ros.diagnostics.frozen import frozen_sensors
from fnn_ekf_ros.membership.files import networks_for
from fnn_ekf_ros.parameters.fake_robot import FakeRobotParameters
from fnn_ekf_ros.parameters.faults import Frozen
from fnn_ekf_ros.parameters.matching import matching_localizer
from fnn_ekf_ros.study.fault_naming import Setting, reports
from fnn_ekf_ros.timeline.events import Level, Sensor
from fnn_ekf_ros.timeline.filter_model import filter_model
from fnn_ekf_ros.timeline.initialization import AwaitingStart

ONSET_S = 15.0


@pytest.mark.parametrize(
    ("topic", "message", "quantity"),
    [
        (
            "lrf_pose",
            "frozen: the position does not change while the wheels move the robot",
            "distance by the wheels meanwhile [m]",
        ),
        (
            "compass",
            "frozen: the yaw does not change while the wheels rotate the robot",
            "rotation by the wheels meanwhile [rad]",
        ),
    ],
)
@pytest.mark.slow
def test_a_sensor_that_is_frozen_with_jitter_is_warned_about_and_nobody_else(
    topic: str, message: str, quantity: str
) -> None:
    robot = FakeRobotParameters(path="round", seed=4)
    localizer = matching_localizer(robot)
    setting = Setting(robot, localizer, networks_for(localizer))
    faults = [Frozen(start=ONSET_S, topic=topic, jitter=1e-3)]
    found = [r for r in reports(setting, ONSET_S + 15.0, faults) if r.time_s >= ONSET_S]
    assert all(report.named() <= {topic} for report in found)
    said = [
        (report.time_s - ONSET_S, dict(status.values))
        for report in found
        for status in report.statuses
        if status.name == topic and (status.level, status.message) == (Level.WARN, message)
    ]
    assert said[0][0] < 8.0  # until the next bend of the path, for the compass
    assert len(said) >= len(found) - 8
    counts = [int(values["identical readings"]) for _, values in said]
    assert counts == sorted(counts)
    assert counts[0] >= 5
    assert float(said[-1][1][quantity]) >= 0.3


def test_each_frozen_sensor_is_told_with_its_own_numbers() -> None:
    localizer = matching_localizer(FakeRobotParameters())
    model = filter_model(localizer, networks_for(localizer))
    state = start_filter(model, np.zeros(3), np.diag([0.01, 0.01, 0.018]))
    unchanged = state.unchanged._replace(
        readings=np.array([7.0, 11.0]),
        travel=np.array([0.1, 1.25, -0.4, 0.2, 0.0, 0.0, 0.0, 0.0]),
    )
    assert frozen_sensors(state._replace(unchanged=unchanged)) == {}
    only_fixes = unchanged._replace(frozen=np.array([False, True]))
    found = frozen_sensors(state._replace(unchanged=only_fixes))
    assert found.keys() == {Sensor.LRF_POSE}
    assert found[Sensor.LRF_POSE].values() == (
        ("identical readings", "11"),
        ("distance by the wheels meanwhile [m]", "1.25"),
        ("rotation by the wheels meanwhile [rad]", "0.20"),
    )
    only_compass = unchanged._replace(frozen=np.array([True, False]))
    found = frozen_sensors(state._replace(unchanged=only_compass))
    assert found.keys() == {Sensor.COMPASS}
    assert dict(found[Sensor.COMPASS].values())["rotation by the wheels meanwhile [rad]"] == "0.40"


def test_no_sensor_is_frozen_before_the_filter_runs() -> None:
    assert frozen_sensors(AwaitingStart(np.ones(2), np.ones(4))) == {}
