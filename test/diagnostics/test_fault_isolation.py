# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Fault isolation: symptoms of the sensors and the suspects' leads together name one sensor."""

import math

import numpy as np
import pytest

from fnn_ekf_ros.core.suspects import SUSPECTS
from fnn_ekf_ros.diagnostics.fault_isolation import (
    AGREEING,
    CLEAR_LEAD,
    CLEARED_LEAD,
    MANY_REJECTIONS,
    NO_FAULT,
    SUSPECTED_LEAD,
    FaultIsolation,
    Scatter,
    isolate_fault,
    symptoms_of,
    without_unused,
)
from fnn_ekf_ros.diagnostics.frozen import FrozenReadings
from fnn_ekf_ros.diagnostics.messages import SensorMessage
from fnn_ekf_ros.diagnostics.recent_periods import (
    LASTING,
    READINGS,
    Leads,
    Readings,
    RecentPeriods,
    SensorReadings,
)
from fnn_ekf_ros.diagnostics.sensor_status import measuring_status
from fnn_ekf_ros.timeline.events import Level, Sensor, Status

ALL = READINGS + LASTING
RIGHT = Readings((1.0,) * ALL, (1,) * ALL, (False,) * READINGS)
WIDE = RIGHT._replace(nis=(2.5,) * ALL)
NARROW = RIGHT._replace(nis=(0.2,) * ALL)
FINE = Status("", Level.OK, "received", ())


def isolated(recent: RecentPeriods) -> FaultIsolation:
    return isolate_fault(recent, 0.6)


def rejecting(count: int) -> Readings:
    return RIGHT._replace(rejected=(True,) * count + (False,) * (READINGS - count))


def periods(
    leads: tuple[float, float, float] = (0.0, 0.0, 0.0),
    compass: Readings = RIGHT,
    lrf_pose: Readings = RIGHT,
) -> RecentPeriods:
    return RecentPeriods(SensorReadings(compass, lrf_pose), 0, 0, 0, leads=(Leads(0, leads),))


def test_nothing_wrong_names_nobody() -> None:
    assert isolated(periods()) == NO_FAULT


def test_a_sensor_without_readings_is_no_suspect() -> None:
    leads = (SUSPECTED_LEAD, SUSPECTED_LEAD - 1.0, 0.0)
    both = FaultIsolation(None, (Sensor.ENCODERS, Sensor.COMPASS), leads)
    assert without_unused(both, set()) is both
    left = without_unused(both, {Sensor.COMPASS})
    assert (left.named, left.suspects) == (Sensor.ENCODERS, (Sensor.ENCODERS,))
    alone = FaultIsolation(Sensor.COMPASS, (Sensor.COMPASS,), leads)
    assert without_unused(alone, {Sensor.COMPASS}).suspects == ()
    assert without_unused(alone, {Sensor.COMPASS}).named is None


@pytest.mark.parametrize("index", range(len(SUSPECTS)))
def test_a_clear_lead_names_the_sensor(index: int) -> None:
    leads = [0.0] * 3
    leads[index] = SUSPECTED_LEAD
    leads[index - 1] = SUSPECTED_LEAD - CLEAR_LEAD
    both_abnormal = periods((leads[0], leads[1], leads[2]), rejecting(9), rejecting(9))
    assert isolated(both_abnormal).named == SUSPECTS[index]


@pytest.mark.parametrize(
    "earlier",
    [
        (SUSPECTED_LEAD - 0.1, 0.0, 0.0),
        (SUSPECTED_LEAD + 9.0, 0.0, SUSPECTED_LEAD + 9.0 - CLEAR_LEAD + 0.1),
        (0.0, 0.0, SUSPECTED_LEAD),
    ],
)
def test_a_clear_lead_has_to_last(earlier: tuple[float, float, float]) -> None:
    now = (SUSPECTED_LEAD, 0.0, 0.0)
    recent = periods(now)._replace(leads=(Leads(1, earlier), Leads(2, now), Leads(3, now)))
    found = isolated(recent)
    assert found.named is None
    assert found.suspects[0] is Sensor.ENCODERS
    assert len(found.suspects) == 2
    assert isolated(recent._replace(leads=recent.leads[1:])).named is Sensor.ENCODERS


def test_a_small_lead_names_nobody() -> None:
    assert isolated(periods((SUSPECTED_LEAD - 0.1, 0.0, 0.0))).named is None


def test_leads_that_are_close_name_nobody_and_say_who_it_may_be() -> None:
    found = isolated(periods((SUSPECTED_LEAD + 2.0, SUSPECTED_LEAD + 5.0, 1.0), rejecting(9)))
    assert found.named is None
    assert found.suspects == (Sensor.ENCODERS, Sensor.COMPASS)


def test_rejections_name_a_sensor_from_three_of_twenty_on() -> None:
    assert isolated(periods(compass=rejecting(MANY_REJECTIONS - 1))).named is None
    assert isolated(periods(compass=rejecting(MANY_REJECTIONS))).named is Sensor.COMPASS
    assert isolated(periods(lrf_pose=rejecting(MANY_REJECTIONS))).named is Sensor.LRF_POSE


def test_symptoms_name_nobody_while_another_one_is_suspected() -> None:
    found = isolated(periods((CLEARED_LEAD, 0.0, 0.0), compass=rejecting(9)))
    assert found.named is None
    assert found.suspects == (Sensor.ENCODERS, Sensor.COMPASS)
    assert isolated(periods((0.0, CLEARED_LEAD, 0.0), compass=rejecting(9))).named is Sensor.COMPASS
    assert isolated(periods((CLEARED_LEAD, 0.0, 0.0))).suspects == ()


def test_symptoms_of_both_name_nobody() -> None:
    found = isolated(periods(compass=rejecting(9), lrf_pose=WIDE))
    assert found.named is None
    assert found.suspects == (Sensor.COMPASS, Sensor.LRF_POSE)


def test_scatter_is_judged_by_the_chi_square_band_of_twenty_readings() -> None:
    """99.9 % of the sums of 20 chi-square variables lie between 5.398 and 47.498 (tables)."""
    for nis, expected in (
        (5.39 / 20, Scatter.LESS),
        (5.41 / 20, Scatter.AS_ASSUMED),
        (47.4 / 20, Scatter.AS_ASSUMED),
        (47.6 / 20, Scatter.MORE),
    ):
        found = symptoms_of(RIGHT._replace(nis=(nis,) * ALL))
        assert found.scatter is expected
        assert found.nis == pytest.approx(nis)
        np.testing.assert_allclose(found.band, (5.398 / 20, 47.498 / 20), rtol=1e-4)


def test_too_few_readings_have_no_scatter() -> None:
    few = Readings((9.0,) * (ALL - 1), (1,) * (ALL - 1), (False,) * READINGS)
    assert symptoms_of(few).scatter is Scatter.AS_ASSUMED
    assert math.isnan(symptoms_of(Readings()).nis)


def test_a_scatter_has_to_last() -> None:
    """The band is left by a reading that is 30 times too large, for as long as it is looked at."""
    for place in range(ALL):
        nis = [1.0] * ALL
        nis[place] = 30.0
        found = symptoms_of(RIGHT._replace(nis=tuple(nis))).scatter
        assert (found is Scatter.MORE) == (LASTING <= place < READINGS)


def test_wheels_are_not_named_for_fixes_that_seem_to_have_jumped() -> None:
    slipping = periods((30.0, 0.0, 5.0), lrf_pose=rejecting(3))
    assert isolated(slipping._replace(agreeing=AGREEING - 1)).named is Sensor.ENCODERS
    found = isolated(slipping._replace(agreeing=AGREEING))
    assert found.named is None
    assert found.suspects == (Sensor.ENCODERS, Sensor.LRF_POSE)


def test_only_rejections_name_a_sensor_while_the_noise_is_learned_first() -> None:
    for recent in (periods((30.0, 0.0, 0.0)), periods(compass=WIDE)):
        assert isolated(recent).named is not None
        found = isolate_fault(recent, 0.5, learning=True)
        assert found == NO_FAULT._replace(leads=recent.leads[-1].leads)
    rejected = periods(lrf_pose=rejecting(MANY_REJECTIONS))
    assert isolate_fault(rejected, 0.5, learning=True).named is Sensor.LRF_POSE


def status_of(sensor: Sensor, readings: Readings, found: FaultIsolation) -> Status:
    return measuring_status(
        FINE._replace(name=sensor), None, None, None, symptoms_of(readings), found
    )


@pytest.mark.parametrize(
    ("readings", "words"),
    [
        (rejecting(5), "many readings rejected: they disagree with the other sensors"),
        (WIDE, "readings scatter more than the assumed noise"),
        (RIGHT, "disagrees with the other sensors"),
    ],
)
def test_the_named_sensor_is_warned_about_with_its_symptom(readings: Readings, words: str) -> None:
    found = FaultIsolation(Sensor.COMPASS, (Sensor.COMPASS,), (0.0, 20.0, 0.0))
    status = status_of(Sensor.COMPASS, readings, found)
    assert status.level is Level.WARN
    assert status.message == words


def test_a_sensor_that_is_merely_affected_is_not_warned_about() -> None:
    found = FaultIsolation(Sensor.ENCODERS, (Sensor.ENCODERS,), (20.0, 0.0, 0.0))
    for readings in (rejecting(9), WIDE, NARROW):
        assert status_of(Sensor.LRF_POSE, readings, found).level is Level.OK


def test_readings_that_scatter_less_than_assumed_are_no_trouble_but_said_in_calm_times() -> None:
    status = status_of(Sensor.LRF_POSE, NARROW, NO_FAULT)
    assert status.level is Level.OK
    assert ("scatter", "less than the assumed noise") in status.values
    assert ("NIS per degree of freedom", "0.20") in status.values
    assert status.message == "received, readings scatter less than the assumed noise"
    stirred = NO_FAULT._replace(leads=(0.0, CLEARED_LEAD, 0.0))
    assert "scatter" not in status_of(Sensor.LRF_POSE, NARROW, stirred).message


def test_other_troubles_of_a_sensor_come_first() -> None:
    refused = Status(Sensor.COMPASS, Level.WARN, "message refused: frame", ())
    frozen = FrozenReadings(SensorMessage.FROZEN_YAW, 7, 0.0, 0.6)
    found = FaultIsolation(Sensor.COMPASS, (Sensor.COMPASS,), (0.0, 20.0, 0.0))
    status = measuring_status(refused, frozen, None, None, symptoms_of(rejecting(9)), found)
    assert status.message == "message refused: frame"
    assert ("rejected of the last readings", "9") in status.values
    assert ("last readings", "20") in status.values
    assert ("identical readings", "7") in status.values
