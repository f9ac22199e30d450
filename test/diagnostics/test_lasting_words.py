# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""What diagnostics say about errors that last, and about a yaw that is off."""

import numpy as np
import pytest
from localizers import (
    PERIOD_NS,
    Arrival,
    feed,
    make_localizer,
    make_parameters,
    simulated,
    statuses,
)

from fnn_ekf_ros.core.filter import step
from fnn_ekf_ros.core.lasting.report import LastingReport
from fnn_ekf_ros.core.results import Epoch
from fnn_ekf_ros.core.state import start_filter
from fnn_ekf_ros.diagnostics.fault_isolation import (
    NO_FAULT,
    FaultIsolation,
    symptoms_of,
    with_doubtful_yaw,
)
from fnn_ekf_ros.diagnostics.lasting_words import doubtful_yaw, lasting_in_words, yaw_offset
from fnn_ekf_ros.diagnostics.messages import FixMessage
from fnn_ekf_ros.diagnostics.recent_periods import Readings, begin_recent, recent_after
from fnn_ekf_ros.diagnostics.sensor_status import measuring_status
from fnn_ekf_ros.membership.files import networks_for
from fnn_ekf_ros.timeline.events import CompassYaw, Level, Output, PoseFix, Sensor, Status
from fnn_ekf_ros.timeline.filter_model import filter_model
from fnn_ekf_ros.timeline.inputs import Counts, LeftOut, PeriodInputs

OFFSET = "the yaw is off by a constant angle, which is corrected"
TURNED = "the yaw was turned: it is not used until the angle is known"
YES, NO = np.array(True), np.array(False)
WHITE = LastingReport(
    weights=np.eye(10)[0],
    fixes_last=np.array(0.0),
    fix_std=np.array(0.0),
    time_constant_s=10.0,
    yaws_last=np.array(0.0),
    yaw_std=np.array(0.0),
    offset=np.array(-0.12),
    offset_std=np.array(0.05),
    believed=NO,
    likely=NO,
    doubted=NO,
    of_fix_yaw=NO,
)
BELIEVED = WHITE._replace(believed=YES)


@pytest.mark.parametrize(
    ("report", "words"),
    [
        (WHITE, "none"),
        (WHITE._replace(fixes_last=np.array(0.4), fix_std=np.array(0.4)), "none"),
        (WHITE._replace(yaws_last=np.array(0.9), yaw_std=np.array(0.095)),
         "yaw errors of 0.095 rad that last about 10 s"),
        (BELIEVED._replace(fixes_last=np.array(0.8), fix_std=np.array(0.4)),
         "fix errors of 0.4 m that last about 10 s; compass offset -0.12 rad"),
        (BELIEVED._replace(of_fix_yaw=YES), "fixes' yaw offset -0.12 rad"),
        (BELIEVED._replace(doubted=YES), "compass turned"),
    ],
)  # fmt: skip
def test_what_is_believed_is_put_into_words(report: LastingReport, words: str) -> None:
    assert lasting_in_words(report) == (("lasting errors", words),)


def test_the_remedy_is_the_parameter_with_its_value() -> None:
    for offset, parameter, fitting in (
        (1.57, 0.0, "-1.57"), (-0.12, 0.5, "0.62"), (3.0, -1.0, "2.28"),
    ):  # fmt: skip
        found = yaw_offset(BELIEVED._replace(offset=np.array(offset)), parameter)
        assert found is not None
        assert (found.sensor, found.message) == (Sensor.COMPASS, OFFSET)
        assert dict(found.values) == {
            "yaw offset [rad]": f"{offset:.3f}",
            "yaw offset std [rad]": "0.050",
            "parameter that would fit": f"compass_offset: {fitting}",
        }
    assert yaw_offset(WHITE, 0.0) is None


def test_without_a_compass_the_yaw_of_the_fixes_is_off() -> None:
    found = yaw_offset(BELIEVED._replace(of_fix_yaw=YES), 0.0)
    assert found is not None
    assert found.sensor is Sensor.LRF_POSE
    assert "parameter that would fit" not in dict(found.values)
    assert doubtful_yaw(WHITE._replace(likely=YES, of_fix_yaw=YES)) is Sensor.LRF_POSE


def test_the_status_of_that_sensor_alone_tells_it() -> None:
    found = yaw_offset(WHITE._replace(doubted=YES), 0.0)
    levels = {}
    for sensor in (Sensor.COMPASS, Sensor.LRF_POSE):
        common = Status(sensor, Level.OK, "received", ())
        status = measuring_status(common, None, found, None, symptoms_of(Readings()), NO_FAULT)
        levels[status.name] = (status.level, status.message)
    assert levels == {"compass": (Level.WARN, TURNED), "lrf_pose": (Level.OK, "received")}
    slip = FaultIsolation(Sensor.ENCODERS, (Sensor.ENCODERS,), (20.0, 0.0, 0.0))
    common = Status(Sensor.COMPASS, Level.OK, "received", ())
    assert (
        measuring_status(common, None, found, None, symptoms_of(Readings()), slip).level is Level.OK
    )
    silent = Status(Sensor.COMPASS, Level.WARN, "silent", ())
    status = measuring_status(silent, None, found, None, symptoms_of(Readings()), NO_FAULT)
    assert status.message == "silent"
    assert ("yaw offset std [rad]", "0.050") in status.values


@pytest.mark.parametrize("change", ["believed", "likely", "doubted"])
def test_nobody_else_is_named_while_a_yaw_is_off(change: str) -> None:
    sensor = doubtful_yaw(WHITE._replace(**{change: YES}))
    assert sensor is Sensor.COMPASS
    slip = FaultIsolation(Sensor.ENCODERS, (Sensor.ENCODERS,), (20.0, 0.0, 0.0))
    found = with_doubtful_yaw(slip, sensor, turned=False)
    assert found.named is None
    assert found.suspects == (Sensor.ENCODERS, Sensor.COMPASS)
    assert with_doubtful_yaw(NO_FAULT, sensor, turned=False) == NO_FAULT
    compass = FaultIsolation(Sensor.COMPASS, (Sensor.COMPASS,), (0.0, 20.0, 0.0))
    assert with_doubtful_yaw(compass, sensor, turned=False) == compass
    assert with_doubtful_yaw(slip, sensor, turned=True).named is Sensor.COMPASS
    assert doubtful_yaw(WHITE) is None


def named(outputs: list[Output]) -> set[str]:
    """Return the sensors whose status was not OK once the filter ran."""
    return {
        s.name for o in outputs if o.estimate for s in o.statuses or ()
        if s.level and s.name in tuple(Sensor)
    }  # fmt: skip


@pytest.mark.slow
def test_a_compass_that_is_off_from_the_start_is_named_with_its_remedy() -> None:
    """By 1.57 rad from the first reading on; `compass_offset` was 0.3.

    The parameter is not named before the examination could have found another cause.
    """
    arrivals = [
        Arrival(now_ns, event._replace(yaw=event.yaw + 1.27))
        if isinstance(event, CompassYaw)
        else Arrival(now_ns, event)
        for now_ns, event in simulated(11, 45.0).arrivals
    ]
    outputs = feed(make_localizer(compass_offset=0.3), arrivals)
    assert named(outputs) == {"compass"}
    said = statuses(outputs, "compass")
    first = next(status for status in said if status.message == OFFSET)
    assert "parameter that would fit" not in dict(first.values)
    last = said[-1]
    assert last.level is Level.WARN
    assert OFFSET in last.message
    remedy = dict(last.values)["parameter that would fit"]
    assert remedy.startswith("compass_offset: ")
    assert float(remedy.split()[1]) == pytest.approx(0.3 - 1.57, abs=0.3)
    words = dict(statuses(outputs, "filter")[-1].values)["lasting errors"]
    assert words.startswith("compass offset 1.")


@pytest.mark.slow
def test_without_a_compass_the_fixes_yaw_is_named() -> None:
    """Fixes whose yaw, the only one, is off by 1.57 rad."""
    yaw = 0.0
    arrivals = []
    for now_ns, event in simulated(11, 60.0).arrivals:
        if isinstance(event, CompassYaw):
            yaw = event.yaw
        elif isinstance(event, PoseFix):
            pose = np.array([*event.pose[:2], yaw + 1.57])
            arrivals.append(Arrival(now_ns, event._replace(pose=pose)))
        else:
            arrivals.append(Arrival(now_ns, event))
    outputs = feed(make_localizer(lrf_use_yaw=True, lrf_yaw_std=0.1342), arrivals)
    assert named(outputs) == {"lrf_pose"}
    said = statuses(outputs, "lrf_pose")
    found = [status for status in said if status.message == OFFSET][-1]
    assert float(dict(found.values)["yaw offset [rad]"]) == pytest.approx(1.57, abs=0.2)
    # Once it is known to be there since the start, the parameter is named.
    assert said[-1].message == FixMessage.YAW_OFF
    fitting = dict(said[-1].values)["parameter that would fit"].removeprefix("lrf_yaw_offset: ")
    assert float(fitting) == pytest.approx(-1.57, abs=0.2)


def test_filters_that_follow_no_lasting_errors_say_nothing_of_them() -> None:
    outputs = feed(make_localizer(lasting_errors=False), simulated(11, 30.0).arrivals[:300])
    assert "lasting errors" not in dict(statuses(outputs, "filter")[-1].values)


def test_corrections_before_an_offset_was_found_show_no_wheel_sizes() -> None:
    """All filters start again from the witness's pose then."""
    parameters = make_parameters()
    model = filter_model(parameters, networks_for(parameters))
    epoch = Epoch(np.array([0.1, 0.02]), 0.375, np.zeros(4), np.zeros(4, dtype=bool))
    inputs = PeriodInputs((epoch,), (), epoch.control, Counts(), None, True, True, LeftOut())
    before = start_filter(model, np.zeros(3), 0.01 * np.eye(3))
    after, result = step(model, before, [epoch])
    recent = recent_after(model, begin_recent(0), before, after, inputs, result, PERIOD_NS)
    assert recent is not None
    assert len(recent.corrections) == 1
    assert after.lasting is not None
    offset = after.lasting.offset._replace(believed=YES)
    found = after._replace(lasting=after.lasting._replace(offset=offset))
    again = recent_after(model, recent, after, found, inputs, result, 2 * PERIOD_NS)
    assert again is not None
    assert again.corrections == ()
    assert [leads.stamp_ns for leads in again.leads] == [2 * PERIOD_NS]
