# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""A health summary in lines, as JSON and as parameters."""

import json
from dataclasses import asdict
from typing import Any

import pytest
from localizers import START_NS, make_parameters
from places import ROOT

from fnn_ekf_ros.diagnostics.health import (
    HONEST_FACTOR,
    SUSPICIOUS_FACTOR,
    UNHEALTHY_SHARE,
    FoundNoise,
    HealthSummary,
    SensorHealth,
    SensorNis,
    StatusHealth,
    honest_band,
)
from fnn_ekf_ros.diagnostics.health_words import (
    checks,
    found_parameters,
    health_lines,
    plain_summary,
)
from fnn_ekf_ros.diagnostics.messages import fitting_value
from fnn_ekf_ros.diagnostics.travel import LARGEST_ERROR, WINDOW_S, TravelRatio, TravelRatios
from fnn_ekf_ros.diagnostics.wheel_sizes import SIZE_KEYS
from fnn_ekf_ros.parameters.localizer import LocalizerParameters
from fnn_ekf_ros.parameters.schema import build, fields_of
from fnn_ekf_ros.stopping import UNHEALTHY
from fnn_ekf_ros.timeline.events import Level, Move, Sensor

SECOND_NS = 10**9


def noise(name: str, factor: float, unit: str = "m") -> FoundNoise:
    return FoundNoise(name, unit, 0.1, 0.1 * factor, 0.1)


def fine(name: str) -> StatusHealth:
    return StatusHealth(name, 100, 0, 0, Level.OK, "", 0, ())


def healthy(**parameters: Any) -> HealthSummary:
    """Return the summary of a run in which all was well."""
    return HealthSummary(
        parameters=make_parameters(**parameters),
        started_ns=START_NS,
        estimates=300,
        awaited="",
        statuses=tuple(map(fine, ("encoders", "compass", "lrf_pose", "filter", "time"))),
        noise=(
            noise("distance", 1.0), noise("rotation", 1.0, "rad"), noise("fixes' x", 1.0),
            noise("fixes' y", 1.0), noise("compass", 1.0, "rad"),
        ),
        nis=tuple(
            SensorNis(sensor, 1.0, 1000, honest_band(1000))
            for sensor in (Sensor.COMPASS, Sensor.LRF_POSE)
        ),
        travel=TravelRatios(TravelRatio(0.98, 0.05, 0.99), TravelRatio(0.97, 0.05, 0.98)),
        sensors=tuple(SensorHealth(sensor, 1000, 0, 0, 0, 999, 0, 0) for sensor in Sensor),
        lasting="none",
        fitting=(),
        moves=0,
        last_move=None,
    )  # fmt: skip


def test_three_lines_if_all_is_well() -> None:
    assert health_lines(healthy(), START_NS) == [
        "health: good, every status OK",
        "noise found (configured): distance 0.1 m (0.1), rotation 0.1 rad (0.1), fixes' x 0.1 m "
        "(0.1), fixes' y 0.1 m (0.1), compass 0.1 rad (0.1)",
        "NIS per degree of freedom (honest: 0.67 to 1.50): compass 1 honest, lrf_pose 1 honest",
    ]


def test_each_trouble_is_one_line_and_all_of_them_are_readable() -> None:
    offset = (("age [s]", "0.1"), fitting_value("compass_offset", -0.8))
    sizes = tuple(zip(SIZE_KEYS, ("+271", "-5"), strict=True))
    troubled = healthy()._replace(
        started_ns=START_NS + 40 * SECOND_NS,
        awaited="waiting for the first position",
        statuses=(
            StatusHealth("encoders", 1000, 9, 0, Level.OK, "the wheels differ", 9, sizes),
            StatusHealth("compass", 100, 96, 0, Level.WARN, "it is off", 90, offset),
            fine("lrf_pose"),
            StatusHealth("filter", 100, 20, 2, Level.OK, "lost", 2, ()),
            StatusHealth("time", 100, 1, 0, Level.OK, "late", 1, ()),
        ),
        noise=(
            noise("distance", 18.14), noise("rotation", 3.0), noise("fixes' x", 1e4),
            noise("fixes' y", 1.0), noise("compass", 15.0),
        ),
        nis=(
            SensorNis(Sensor.COMPASS, 68555.2, 1000, honest_band(1000)),
            SensorNis(Sensor.LRF_POSE, 0.012, 4, honest_band(4)),
        ),
        sensors=(
            SensorHealth(Sensor.ENCODERS, 9, 0, 0, 0, 0, 0, 0),
            SensorHealth(Sensor.COMPASS, 900, 3, 0, 5, 800, 0, 0),
            SensorHealth(Sensor.LRF_POSE, 90, 0, 2, 0, 80, 0, 7),
        ),
        lasting="fix errors of 0.4 m that last about 10 s",
        moves=2,
        last_move=Move(START_NS + 100 * SECOND_NS, 3.21, -0.5),
    )  # fmt: skip
    lines = health_lines(troubled, START_NS)
    assert lines[:6] == [
        "health: not good",
        "  started 40 s after the begin: waiting for the first position",
        "  filter ERROR 2 % and WARN 20 % of the time: lost",
        "  compass WARN 96 % of the time and at the end: it is off (compass_offset -0.8 would fit)",
        "  time WARN 1 % of the time: late",
        "  encoders WARN less than 1 % of the time: the wheels differ (left wheel's distance "
        "against its counts +271 %, right wheel's distance against its counts -5 %)",
    ]
    assert lines[6].startswith("noise found (configured): distance 1.81 m (0.1), ")
    assert "fixes' x 1000 m (0.1)" in lines[6]
    assert lines[7] == (
        "NIS per degree of freedom (honest: 0.67 to 1.50): compass 68555 too sure (readings are "
        "off by more than the filter expects), lrf_pose 0.012 too cautious (readings are off by "
        "less than the filter expects), of few readings: 0.02 to 5.00"
    )
    assert lines[8:11] == [
        "lasting errors: fix errors of 0.4 m that last about 10 s",
        "not used: compass 3 refused, 5 left out; lrf_pose 7 rejected of 80, 2 dropped for their "
        "stamps",
        "pose moved to the fixes: 2 times, last by 3.2 m and -0.50 rad at 100 s",
    ]
    assert [line.split(",")[0] for line in lines[11:]] == [
        "check wheel_radius",
        "check the unit (m",
        "check the compass's mounting and axes (ENU",
    ]
    assert len(lines) <= 15


def test_a_run_with_every_status_ok_may_be_not_good() -> None:
    (line, *_) = health_lines(healthy()._replace(noise=(noise("rotation", 14.0),)), START_NS)
    assert line == "health: not good, although every status was OK"
    short = StatusHealth("time", 100, 1, 0, Level.OK, "late", 1, ())
    (line, *_) = health_lines(healthy()._replace(statuses=(short,)), START_NS)
    assert line == "health: good, each status OK nearly all the time"


@pytest.mark.parametrize(
    ("found", "parameters", "named"),
    [
        ((noise("distance", 1.0), noise("rotation", 13.4)), {}, ["wheel_separation"]),
        ((noise("distance", 18.0), noise("rotation", 15.0)), {},
         ["wheel_radius", "gear_ratio", "encoder_counts_per_revolution", "wheel_separation",
          "left_inverted", "right_inverted"]),
        ((noise("distance", 18.0), noise("rotation", 1.0)), {"encoder_source": "joint_states"},
         ["wheel_radius", "wheel_separation", "left_inverted", "right_inverted"]),
    ],
)  # fmt: skip
def test_a_check_names_the_parameters_that_could_be_wrong(
    found: tuple[FoundNoise, ...], parameters: dict[str, Any], named: list[str]
) -> None:
    (text,) = checks(healthy(**parameters)._replace(noise=found))
    names, _, rest = text.partition(", or raise process_noise_std: ")
    assert names.split(", ") == named
    known = {name for name, _, _ in fields_of(LocalizerParameters)}
    assert {*named, "process_noise_std"} <= known
    assert rest == " and ".join(
        f"{each.name} noise {each.factor:.3g}" for each in found if each.suspicious
    ) + " times the configured one"  # fmt: skip


@pytest.mark.parametrize(
    ("travelled", "rotated", "explained", "text"),
    [
        (1.0, 2.0, 0.99, "wheel_separation (0.3 would fit): the pose rotates 2.00"),
        (4.0, 3.8, 0.99, "wheel_radius (0.1 would fit), gear_ratio, encoder_counts_per_revolution: "
         "the pose travels 4.00 and rotates 3.80"),
        (0.5, 1.0, 0.99, "wheel_radius (0.0125 would fit), gear_ratio, "
         "encoder_counts_per_revolution, wheel_separation (0.3 would fit): the pose travels 0.50"),
        (1.0, -1.0, 0.99, "left_inverted, right_inverted, whether left and right are swapped: the "
         "pose rotates -1.00"),
        (5.9, 0.3, 0.4, "left_inverted, right_inverted, whether left and right are swapped: the "
         "pose travels 5.90 and rotates 0.30"),
    ],
)  # fmt: skip
def test_a_check_tells_how_the_wheels_travel(
    travelled: float, rotated: float, explained: float, text: str
) -> None:
    """Noise that this explains is not named beside it."""
    ratios = TravelRatios(TravelRatio(travelled, 0.01, explained), TravelRatio(rotated, 0.01, 1.0))
    summary = healthy()._replace(
        travel=ratios, noise=(noise("rotation", 14.0), noise("compass", 20.0))
    )
    assert checks(summary) == [f"{text} times as far as the wheels count"]
    assert not summary._replace(noise=()).healthy


def test_a_sensor_whose_readings_come_late_is_named() -> None:
    """Its NIS is of the few that came in time."""
    encoders, compass, fixes = healthy().sensors
    summary = healthy()._replace(sensors=(encoders, compass, fixes._replace(in_time=200, late=799)))
    assert health_lines(summary, START_NS)[2].endswith(
        "lrf_pose 1 honest, lrf_pose mostly late, see output_delay"
    )
    assert "late" not in health_lines(healthy(), START_NS)[2]


def test_a_run_that_is_too_short_for_a_report_is_not_called_good() -> None:
    (line, *_) = health_lines(healthy()._replace(statuses=()), START_NS)
    assert line == "health: unknown, the run ended before the first report"


def test_no_checks_if_all_is_well() -> None:
    assert checks(healthy()) == []


def test_the_parameters_that_were_found_are_a_valid_set() -> None:
    found = found_parameters(
        healthy()._replace(
            noise=(
                FoundNoise("distance", "m", 0.05, 0.012345678, 0.05),
                noise("fixes' x", 0.98764),
            ),
            fitting=(("compass_offset", -0.8), ("lrf_pose_delay", 0.3)),
        )
    )
    assert found["process_noise_std"] == (0.01235, pytest.approx(0.0524, rel=1e-3))
    assert found["measurement_noise_std"][:2] == (0.09876, 0.1)
    assert (found["compass_offset"], found["lrf_pose_delay"]) == (-0.8, 0.3)
    build(LocalizerParameters, asdict(make_parameters()) | found)


def test_a_compass_that_is_mostly_noise_has_no_offset_that_fits() -> None:
    fitting = (("compass_offset", 1.0), ("compass_delay", 1.0), ("lrf_pose_delay", 0.3))
    summary = healthy()._replace(noise=(noise("compass", 15.0, "rad"),), fitting=fitting)
    found = found_parameters(summary)
    assert not {"compass_offset", "compass_delay"} & set(found)
    assert found["lrf_pose_delay"] == 0.3


def test_noise_of_a_yaw_that_is_not_used_is_not_found() -> None:
    assert "lrf_yaw_std" not in found_parameters(healthy())
    yaw = noise("fixes' yaw", 2.0, "rad")
    summary = healthy(lrf_use_yaw=True)._replace(noise=(yaw,))
    assert found_parameters(summary)["lrf_yaw_std"] == 0.2


def test_a_compass_offset_that_fits_is_left_as_it_is() -> None:
    assert "compass_offset" not in found_parameters(healthy())


def test_found_noise_stays_within_its_bounds_when_it_is_rounded() -> None:
    """0.123444 rounds to less than the smallest, 0.987654 to more than the largest."""
    bounds: dict[str, Any] = {
        "process_noise_std_min": [0.123444, 0.01], "process_noise_std": [0.5, 0.1],
        "process_noise_std_max": [1.0, 0.987654],
    }  # fmt: skip
    summary = healthy(**bounds)._replace(
        noise=(
            FoundNoise("distance", "m", 0.5, 0.123444, 0.05),
            FoundNoise("rotation", "rad", 0.1, 0.987654, 0.05),
        )
    )
    found = found_parameters(summary)
    assert found["process_noise_std"] == (0.123444, 0.987654)
    build(LocalizerParameters, asdict(summary.parameters) | found)


def test_fixes_that_report_their_covariance_keep_the_configured_noise() -> None:
    """Their scale refers to it: a start with the found noise would begin at scale 1 again."""
    summary = healthy(lrf_use_message_covariance=True)._replace(
        noise=(noise("distance", 2.0), noise("fixes' x", 2.0), noise("fixes' y", 2.0))
    )
    assert found_parameters(summary)["measurement_noise_std"][:2] == (0.1, 0.1)
    assert found_parameters(summary)["process_noise_std"][0] == 0.2
    assert "fixes' x 2 times the reported one" in health_lines(summary, START_NS)[1]


def test_the_plain_summary_is_json_and_has_every_number() -> None:
    text = json.dumps(plain_summary(healthy()), allow_nan=False)
    plain = json.loads(text)
    assert plain["healthy"] is True
    assert plain["odom"] == 300
    assert plain["noise_std"]["distance"] == {"unit": "m", "configured": 0.1, "found": 0.1}
    assert plain["statuses"]["time"]["worst"] == "OK"
    assert plain["nis_per_degree_of_freedom"]["compass"]["verdict"] == "honest"
    assert plain["sensors"]["lrf_pose"]["in_time"] == 999
    assert plain["found_parameters"]["process_noise_std"][0] == 0.1


def test_the_document_has_the_numbers_of_the_code() -> None:
    text = " ".join((ROOT / "docs" / "operation.md").read_text(encoding="utf-8").split())
    for words in (
        f"above OK for more than {100.0 * UNHEALTHY_SHARE:g} % of the time",
        f"that is {SUSPICIOUS_FACTOR:g} times the configured one (std) or more",
        f"From {1.0 / HONEST_FACTOR:.2f} to {HONEST_FACTOR:g} the filter is honest",
        f"right within {100.0 * (HONEST_FACTOR**0.5 - 1.0):.0f} %",
        f"over windows of {WINDOW_S:g} s",
        f"differ by more than {100.0 * LARGEST_ERROR:g} % and significantly",
        f"ends with exit code {UNHEALTHY} if",
    ):
        assert words in text, words
