# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Stamps that are late: the sensor's status says so, and which value would put it right."""

import dataclasses

import pytest

from fnn_ekf_ros.core.rows import COMPASS, LRF_POSE
from fnn_ekf_ros.core.sensor_lag import Evidence, Lags, SensorLag
from fnn_ekf_ros.diagnostics.late_stamps import late_stamps
from fnn_ekf_ros.diagnostics.messages import SensorMessage
from fnn_ekf_ros.diagnostics.recent_periods import RecentPeriods, begin_recent
from fnn_ekf_ros.localizer.localizer import Localizer
from fnn_ekf_ros.membership.files import networks_for
from fnn_ekf_ros.parameters.fake_robot import FakeRobotParameters
from fnn_ekf_ros.parameters.faults import Delay
from fnn_ekf_ros.parameters.localizer import LocalizerParameters
from fnn_ekf_ros.parameters.matching import matching_localizer
from fnn_ekf_ros.simulation.listening import listen
from fnn_ekf_ros.timeline.events import Level, Sensor, Status

START_NS = 3 * 10**9
"""ROS time at which the robot starts [ns]."""


def parameters(**changes: float) -> LocalizerParameters:
    matching = matching_localizer(FakeRobotParameters())
    return dataclasses.replace(matching, **changes)  # type: ignore[arg-type]


def recent(compass: float, lrf_pose: float, *, believed: bool) -> RecentPeriods:
    """Return periods with lags whose blocks all agree."""
    sensors = tuple(
        SensorLag(place, evidence=Evidence(100.0, 100.0 * lag, lag**2, lag, 1.0), believed=believed)
        for place, lag in ((COMPASS, compass), (LRF_POSE, lrf_pose))
    )
    return begin_recent(START_NS)._replace(lags=Lags(sensors=sensors))


def test_nothing_is_said_before_a_lag_is_believed() -> None:
    assert late_stamps(parameters(), None) == {}
    assert late_stamps(parameters(), begin_recent(START_NS)) == {}
    assert late_stamps(parameters(), recent(0.4, 0.4, believed=False)) == {}


def test_the_value_that_would_fit_adds_to_the_configured_one() -> None:
    found = late_stamps(parameters(lrf_pose_delay=0.1), recent(-0.4, 0.25, believed=True))
    assert found[Sensor.COMPASS].message is SensorMessage.STAMPS_EARLY
    assert found[Sensor.COMPASS].values() == (
        ("lag of the stamps [s]", "-0.40"),
        ("its standard error [s]", "0.00"),
        ("parameter that would fit", "compass_delay: -0.40"),
    )
    assert found[Sensor.LRF_POSE].message is SensorMessage.STAMPS_LATE
    assert found[Sensor.LRF_POSE].values()[2] == (
        "parameter that would fit",
        "lrf_pose_delay: 0.35",
    )


def reported(lag_s: float, seconds: float, **changes: float) -> list[tuple[Status, ...]]:
    """Return the reports of a drive whose fixes are stamped at their arrival."""
    robot = FakeRobotParameters(path="round", seed=1)
    own = parameters(lrf_pose_delay=changes.pop("lrf_pose_delay", 0.0) - lag_s, **changes)
    localizer = Localizer(own, networks_for(own))
    faults = [Delay(topic="lrf_pose", start=0.0, duration=seconds, size=lag_s)]
    reports = []
    for topic, message, now_ns in listen(robot, own, START_NS, seconds, faults):
        outputs = localizer.receive(topic, message, now_ns).outputs
        reports += [output.statuses for output in outputs if output.statuses is not None]
    return reports


@pytest.mark.slow
def test_late_fixes_are_named_and_no_other_sensor_is() -> None:
    *_, last = reported(1.0, 100.0)
    statuses = {status.name: status for status in last}
    late = statuses["lrf_pose"]
    assert late.level is Level.WARN
    assert late.message == SensorMessage.STAMPS_LATE
    values = dict(late.values)
    assert float(values["lag of the stamps [s]"]) == pytest.approx(1.0, abs=0.25)
    assert {statuses[name].level for name in ("encoders", "compass", "filter")} == {Level.OK}


@pytest.mark.slow
def test_with_the_value_that_fits_nothing_is_said() -> None:
    for report in reported(1.0, 60.0, lrf_pose_delay=1.0)[10:]:
        assert {status.level for status in report} == {Level.OK}
