# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Mistakes of robot, wiring and configuration on /diagnostics, while the localizer runs."""

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

import pytest

from fnn_ekf_ros.calibration.findings import KINDS, Certainty, Change, Finding
from fnn_ekf_ros.diagnostics.messages import (
    FITTING,
    MESSAGES,
    EncoderMessage,
    FilterMessage,
    fill,
    fitting_parameters,
)
from fnn_ekf_ros.diagnostics.mistakes import (
    MESSAGES_OF_FINDINGS,
    Mistakes,
    filter_messages,
    with_mistakes,
    without_remedy,
)
from fnn_ekf_ros.localizer.localizer import Localizer
from fnn_ekf_ros.membership.files import networks_for
from fnn_ekf_ros.parameters.fake_robot import FakeRobotParameters
from fnn_ekf_ros.parameters.localizer import LocalizerParameters
from fnn_ekf_ros.parameters.matching import matching_localizer
from fnn_ekf_ros.parameters.schema import build
from fnn_ekf_ros.simulation.listening import listen
from fnn_ekf_ros.study.mistakes import MISTAKES
from fnn_ekf_ros.timeline.events import Level, Status, Wheel, WheelCount
from fnn_ekf_ros.timeline.wheels import BufferChange

START_NS = 3 * 10**9
OF_BAGS = {
    "not_set", "missing_topic", "wrong_type", "joint_names", "frame", "no_yaw", "clock_skew",
    "late_messages", "standing", "never_turning", "one_rate", "too_short",
    "frozen_sensor", "stuck_wheel", "encoder_bits", "counter_resets",
}  # fmt: skip
"""Findings of bags, or that other parts of diagnostics tell."""
SLOW_COUNTS = Finding(
    "meters_per_count", "wheels travel 4 times as far", "path of 50 fixes", Certainty.CERTAIN,
    (Change("encoder_counts_per_revolution", 501.234, 480.0, 520.0, "counts"),),
)  # fmt: skip
INVERTED = Finding(
    "left_inverted", "the left counter runs the other way", "path of 50 fixes", Certainty.CERTAIN,
    (Change("left_inverted", value=True),),
)  # fmt: skip


def test_every_finding_of_readings_has_a_message_of_its_sensor() -> None:
    assert MESSAGES_OF_FINDINGS.keys() == KINDS.keys() - OF_BAGS
    for sensor, message in MESSAGES_OF_FINDINGS.values():
        assert message in MESSAGES[sensor]


def test_a_sensor_is_warn_with_what_puts_it_right() -> None:
    fine = Status("encoders", Level.OK, "received", (("received", "7"),))
    told = with_mistakes(fine, (SLOW_COUNTS, INVERTED))
    assert told.level is Level.WARN
    assert told.message == f"{EncoderMessage.WRONG_SIZE}; {EncoderMessage.LEFT_BACKWARD}"
    values = dict(told.values)
    assert values["received"] == "7"
    assert values[FITTING] == "encoder_counts_per_revolution: 501.23; left_inverted: true"
    assert "501.23 counts (95 %: 480 to 520)" in values["with its interval"]
    assert fitting_parameters(told.values) == {
        "encoder_counts_per_revolution": 501.23, "left_inverted": True
    }  # fmt: skip
    assert filter_messages((SLOW_COUNTS, INVERTED)) == [
        fill(FilterMessage.MISTAKE, sensor="encoders")
    ]


def test_a_status_without_its_remedy_keeps_the_rest() -> None:
    told = Status("compass", Level.WARN, "off", (("yaw offset [rad]", "1"), (FITTING, "x: 1")))
    assert without_remedy(told) == told._replace(values=(("yaw offset [rad]", "1"),))


def test_a_fault_comes_before_a_mistake_and_other_sensors_stay_as_they_are() -> None:
    silent = Status("encoders", Level.ERROR, "left wheel silent", ())
    assert with_mistakes(silent, (SLOW_COUNTS,)).message == "left wheel silent"
    assert FITTING in dict(with_mistakes(silent, (SLOW_COUNTS,)).values)
    jumped = Status("encoders", Level.WARN, "jumped", ())
    told = with_mistakes(jumped, (SLOW_COUNTS,)).message
    assert told == f"{EncoderMessage.WRONG_SIZE}; jumped"
    compass = Status("compass", Level.OK, "received", ())
    assert with_mistakes(compass, (SLOW_COUNTS,)) == compass


def test_names_and_switches_are_parameters_that_fit_as_well() -> None:
    text = "left_joint: right_wheel; compass_clockwise: false; compass_offset: -0.5"
    assert fitting_parameters([(FITTING, text), ("age [s]", "0.1")]) == {
        "left_joint": "right_wheel", "compass_clockwise": False, "compass_offset": -0.5
    }  # fmt: skip


def test_counts_are_unwrapped_and_jumps_are_no_motion() -> None:
    parameters = LocalizerParameters(
        wheel_radius=0.1, wheel_separation=0.5, encoder_counts_per_revolution=100.0,
        encoder_bits=8, left_inverted=True,
    )  # fmt: skip
    seen: list[float] = []

    class _Examined:
        def wheel(self, side: str, time_s: float, counts: float) -> None:
            assert (side, time_s) == ("left", pytest.approx(0.1 * len(seen)))
            seen.append(counts)

    mistakes = Mistakes(parameters)
    mistakes._examination = _Examined()  # type: ignore[assignment]
    came = [(100, 0.0), (120, 0.0), (-126, 0.0), (7, 5.0), (9, 0.0), (11, 0.0)]
    for place, (reading, jump) in enumerate(came):
        event = WheelCount(START_NS + place * 10**8, Wheel.LEFT, reading)
        mistakes.took(event, BufferChange(event.stamp_ns, jump=jump))
    assert seen == [0.0, -20.0, -30.0, -30.0, -30.0, -32.0]


def statuses(
    given: Mapping[str, Any], swapped: str, seconds: float
) -> list[tuple[float, dict[str, Status]]]:
    """Return what is reported of a simulated robot on good ground, with the time [s]."""
    robot = FakeRobotParameters(
        path="figure_eight", seed=4, slip_std=(0.005, 0.005), compass_rate=4.0
    )
    right = asdict(matching_localizer(robot)) | {"adaptation": "none"}
    parameters = build(LocalizerParameters, right | given)
    localizer = Localizer(parameters, networks_for(parameters))
    mistake = next((each for each in MISTAKES if each.name == swapped), None)
    found = []
    for heard in listen(robot, parameters, START_NS, seconds):
        topic = heard.topic if mistake is None else mistake.topic(heard.topic)
        for output in localizer.receive(topic, heard.message, heard.now_ns).outputs:
            if output.statuses is not None and output.estimate is not None:
                by_name = {status.name: status for status in output.statuses}
                found.append(((output.stamp_ns - START_NS) * 1e-9, by_name))
    return found


@pytest.mark.parametrize(
    ("given", "mistake", "fitting"),
    [
        ({"left_inverted": True}, "", {"left_inverted": False}),
        pytest.param(
            {"encoder_counts_per_revolution": 125.0},
            "",
            {"encoder_counts_per_revolution": 500.0},
            marks=pytest.mark.slow,
        ),
        pytest.param({}, "swapped", {}, marks=pytest.mark.slow),
    ],
)
def test_a_mistake_is_named_with_its_parameter_to_the_end_and_nothing_else(
    given: Mapping[str, Any], mistake: str, fitting: Mapping[str, Any]
) -> None:
    reports = statuses(given, mistake, 60.0)
    told = [time for time, by_name in reports if "mistake" in dict(by_name["encoders"].values)]
    assert told[0] < 50.0
    for time, by_name in reports:
        if time < told[0]:
            continue
        assert by_name["encoders"].level is Level.WARN
        assert fill(FilterMessage.MISTAKE, sensor="encoders") in by_name["filter"].message
        assert "disagree" not in by_name["filter"].message
        assert by_name["compass"].level is by_name["lrf_pose"].level is Level.OK
    found = fitting_parameters(reports[-1][1]["encoders"].values)
    assert found.keys() == fitting.keys()
    for name, value in fitting.items():
        assert found[name] == pytest.approx(value, rel=0.1)


def test_parameters_that_change_begin_the_examination_anew() -> None:
    robot = FakeRobotParameters(seed=4)
    parameters = matching_localizer(robot)
    localizer = Localizer(parameters, networks_for(parameters))
    before = localizer._diagnostics._mistakes
    localizer.change(parameters, networks_for(parameters))
    assert localizer._diagnostics._mistakes is not before
