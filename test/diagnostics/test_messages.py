# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The messages of /diagnostics are a finite set, and so are the keys of their values."""

import re
from collections.abc import Sequence

import numpy as np
import pytest
from diagnostic_tables import message_tables
from localizers import SECOND_NS, make_localizer

from fnn_ekf_ros import messages
from fnn_ekf_ros.diagnostics.messages import (
    MESSAGES,
    SEPARATOR,
    EncoderMessage,
    FilterMessage,
    fill,
    join,
    possible_texts,
    texts_of,
)
from fnn_ekf_ros.parameters.fake_robot import FakeRobotParameters
from fnn_ekf_ros.simulation.listening import listen
from fnn_ekf_ros.study.fault_naming import NAMING_CASES, START_NS, FaultCase
from fnn_ekf_ros.timeline.events import CompassYaw, Output, PoseReset, Status, Wheel, WheelCount

POSSIBLE = {status: set(possible_texts(status)) for status in MESSAGES}
LEVELS = {
    status: {text: levels for message, levels in messages.items() for text in texts_of(message)}
    for status, messages in message_tables().items()
}
MOST_KEYS = 30


def assert_listed(statuses: Sequence[Status]) -> None:
    """Compare messages and levels with the lists; values may change, keys are distinct."""
    for status in statuses:
        parts = status.message.split(SEPARATOR)
        assert set(parts) <= POSSIBLE[status.name], status
        assert len(set(parts)) == len(parts), status
        possible = [LEVELS[status.name][part] for part in parts]
        assert any(status.level in levels for levels in possible), status
        assert status.level >= max(map(min, possible)), status
        keys = [key for key, _ in status.values]
        assert len(set(keys)) == len(keys) <= MOST_KEYS, status


def test_no_message_has_a_number_or_the_separator_in_it() -> None:
    for texts in POSSIBLE.values():
        for text in texts:
            assert not re.search(r"\d", text), text
            assert SEPARATOR not in text
            assert "<" not in text
    assert sum(map(len, POSSIBLE.values())) < 150


def test_messages_are_filled_and_joined() -> None:
    text = fill(FilterMessage.PROCESS_LOW, process_noise="distance")
    assert text == "distance noise at its lower bound process_noise_std_min"
    assert join([text, FilterMessage.MOVED]) == f"{text}; {FilterMessage.MOVED}"
    silent = fill(EncoderMessage.WHEEL_SILENT, wheel="left")
    assert silent == "left wheel silent"
    assert silent in POSSIBLE["encoders"]
    assert silent not in POSSIBLE["filter"]


@pytest.mark.parametrize("case", NAMING_CASES, ids=lambda case: case.name)
@pytest.mark.slow
def test_every_message_in_a_run_with_a_fault_is_listed(case: FaultCase) -> None:
    localizer = make_localizer()
    robot = FakeRobotParameters(path="sim1", seed=3)
    told = []
    for heard in listen(robot, localizer.parameters, START_NS, 24.0, case.faults(8.0)):
        for output in localizer.receive(heard.topic, heard.message, heard.now_ns).outputs:
            assert_listed(output.statuses or ())
            told += [s.message for s in output.statuses or () if s.level > 0]
    assert told


def test_the_messages_of_clocks_and_stamps_are_listed() -> None:
    localizer = make_localizer(initial_pose=[0.0, 0.0, 0.0])
    now_ns = 100 * SECOND_NS
    localizer.advance(now_ns)
    found: list[str] = []

    def note(outputs: Sequence[Output]) -> None:
        for statuses in (*(output.statuses or () for output in outputs), localizer.report()):
            assert_listed(statuses)
            found.extend(s.message for s in statuses if s.name == "time" and s.level > 0)

    pose, covariance = np.zeros(3), np.eye(3)
    for event in (
        CompassYaw(now_ns - 50 * SECOND_NS, 0.0),
        WheelCount(now_ns - 50 * SECOND_NS, Wheel.LEFT, 0),
        CompassYaw(now_ns + 2 * SECOND_NS, 0.0),
        PoseReset(now_ns + 2 * SECOND_NS, pose, covariance),
    ):
        note(localizer.add(event, now_ns))
    for jump_ns in (20 * SECOND_NS, -60 * SECOND_NS, 5000 * SECOND_NS):
        now_ns += jump_ns
        note(localizer.advance(now_ns))
    localizer.overran(0.5)
    note([])
    assert found == [
        "compass message dropped: later than history",
        "encoders message dropped: later than history",
        "compass message dropped: stamped ahead of the clock",
        "initialpose message dropped: stamped ahead of the clock",
        "the clock jumped ahead, or no message arrived for a while",
        "the clock went back: the localizer starts anew",
        "the clock jumped ahead: the localizer starts anew",
        "the node was late by more than a period",
    ]
    values = dict(next(s for s in localizer.report() if s.name == "time").values)
    assert values["last dropped, delay [s]"] == "-2.000"
    assert values["last jump of the clock [s]"] == "5000.000"
    assert values["last overrun [s]"] == "0.50"


def test_every_message_of_a_status_is_text() -> None:
    made = messages.diagnostics(SECOND_NS, "localizer", make_localizer().report())
    assert {type(status.fields["message"]) for status in made.fields["status"]} == {str}
