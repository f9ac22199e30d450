# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The simulated robot's messages as a localizer takes them in, without ROS and without a bag."""

from collections.abc import Iterator, Sequence
from types import SimpleNamespace
from typing import Any, NamedTuple

from fnn_ekf_ros import messages
from fnn_ekf_ros.messages import Message
from fnn_ekf_ros.parameters.fake_robot import FakeRobotParameters
from fnn_ekf_ros.parameters.faults import Fault
from fnn_ekf_ros.parameters.localizer import LocalizerParameters
from fnn_ekf_ros.simulation.delivery import STEP_NS
from fnn_ekf_ros.simulation.fake_robot import FakeRobot


class Heard(NamedTuple):
    """A message that a localizer hears.

    Attributes:
        topic: of the localizer.
        message: with attributes, as rclpy or rosbags would give it.
        now_ns: ROS time of arrival [ns].
    """

    topic: str
    message: Any
    now_ns: int


def listen(
    robot: FakeRobotParameters,
    localizer: LocalizerParameters,
    start_ns: int,
    duration_s: float,
    faults: Sequence[Fault] = (),
) -> Iterator[Heard]:
    """Yield what a localizer hears of a simulated robot, in the order of arrival.

    Args:
        robot: drives a scripted path; its seed decides on everything.
        localizer: which topics it listens to.
        start_ns: ROS time of the robot's start [ns].
        duration_s: how long it drives [s].
        faults: what goes wrong.
    """
    topics = set(messages.input_topics(localizer))
    fake = FakeRobot(robot, start_ns, faults)
    for _ in range(round(duration_s * 1e9) // STEP_NS):
        for sent in fake.step():
            if sent.topic in topics:
                yield Heard(topic=sent.topic, message=as_object(sent.message), now_ns=fake.time_ns)


def as_object(field: Any) -> Any:
    """Return a message tree as an object with attributes, as rclpy or rosbags would give it."""
    if isinstance(field, Message):
        return SimpleNamespace(**{name: as_object(v) for name, v in field.fields.items()})
    if isinstance(field, list):
        return [as_object(entry) for entry in field]
    return field
