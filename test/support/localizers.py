# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Localizers of the paper's robot, what they hear, and views of what they give."""

import functools
import itertools
from collections.abc import Iterable, Iterator
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np

from fnn_ekf_ros import messages
from fnn_ekf_ros.core.arrays import FloatArray
from fnn_ekf_ros.localizer.localizer import Localizer
from fnn_ekf_ros.membership.files import networks_for
from fnn_ekf_ros.messages import Message
from fnn_ekf_ros.parameters.fake_robot import FakeRobotParameters
from fnn_ekf_ros.parameters.localizer import LocalizerParameters
from fnn_ekf_ros.parameters.schema import build
from fnn_ekf_ros.simulation.delivery import STEP_NS, Sent
from fnn_ekf_ros.simulation.fake_robot import FakeRobot
from fnn_ekf_ros.timeline.events import Event, Output, Rejected, Status

PERIOD_NS = 375_000_000
"""The paper's period [ns]."""
SECOND_NS = 10**9
"""A second [ns]."""
START_NS = 3 * SECOND_NS
"""ROS time at which simulated runs begin [ns]: ROS time 0 means no time."""
GEOMETRY = {
    "wheel_radius": 0.025,
    "wheel_separation": 0.6,
    "encoder_counts_per_revolution": 500.0,
}
"""The paper's robot, as parameters."""
JOINTS = {"encoder_source": "joint_states"}
"""Parameters with joint states in place of ticks."""


class Arrival(NamedTuple):
    """An event and the ROS time at which it came in [ns]."""

    now_ns: int
    event: Event


class Run(NamedTuple):
    """What a simulated robot sent: events as they arrive, and the true pose by stamp."""

    arrivals: tuple[Arrival, ...]
    truth: dict[int, FloatArray]


def make_parameters(**changes: Any) -> LocalizerParameters:
    """Return parameters for the paper's robot, with changes."""
    return build(LocalizerParameters, GEOMETRY | changes)


def make_localizer(**changes: Any) -> Localizer:
    """Return a localizer for the paper's robot, with changed parameters."""
    parameters = make_parameters(**changes)
    return Localizer(parameters, networks_for(parameters))


def joints_localizer(**changes: Any) -> Localizer:
    """Return one that listens to joint states, which have no steps."""
    return make_localizer(**JOINTS, **changes)


def feed(localizer: Localizer, arrivals: Iterable[Arrival]) -> list[Output]:
    """Feed arrivals to a localizer; return all it gives."""
    return [output for now, event in arrivals for output in localizer.add(event, now)]


def as_object(field: Any) -> Any:
    """Return an object with attributes of a message tree, as rclpy or rosbags would give it."""
    if isinstance(field, Message):
        return SimpleNamespace(**{name: as_object(v) for name, v in field.fields.items()})
    if isinstance(field, list):
        return [as_object(entry) for entry in field]
    return field


class _Drive:
    """What a simulated robot sends: kept, and driven on as far as somebody asks."""

    def __init__(self, seed: int, **robot: Any) -> None:
        self._fake = FakeRobot(build(FakeRobotParameters, {"seed": seed, **robot}), START_NS)
        self._sent: list[tuple[int, Sent]] = []

    def until(self, end_ns: int) -> Iterator[tuple[int, Sent]]:
        """Return the messages of the steps that begin before a time, each with its step's end."""
        while self._fake.stamp_ns < end_ns:
            sent = self._fake.step()
            self._sent += [(self._fake.stamp_ns, each) for each in sent]
        return itertools.takewhile(lambda each: each[0] - STEP_NS < end_ns, self._sent)


_drive = functools.cache(_Drive)


@functools.cache
def simulated(seed: int, seconds: float, source: str = "ticks", **robot: Any) -> Run:
    """Return a simulated run, as a localizer with ticks or joint_states would read it; kept."""
    listening = make_parameters(encoder_source=source)
    topics = messages.input_topics(listening)
    arrivals: list[Arrival] = []
    truth: dict[int, FloatArray] = {}
    for now_ns, sent in _drive(seed, **robot).until(START_NS + round(seconds * 1e9)):
        if sent.topic == messages.GROUND_TRUTH:
            truth[now_ns] = messages.planar_pose(as_object(sent.message))
        elif sent.topic in topics:
            events = messages.read_input(sent.topic, as_object(sent.message), now_ns, listening)
            assert not isinstance(events, Rejected)
            arrivals += [Arrival(now_ns, event) for event in events]
    return Run(tuple(arrivals), truth)


def same_estimates(first: list[Output], second: list[Output]) -> None:
    """Assert that two lists of outputs hold the same states, bit for bit."""
    assert [o.stamp_ns for o in first] == [o.stamp_ns for o in second]
    for one, other in zip(first, second, strict=True):
        assert (one.estimate is None) == (other.estimate is None)
        if one.estimate is None or other.estimate is None:
            continue
        np.testing.assert_array_equal(one.estimate.twist, other.estimate.twist)
        for name in ("mean", "covariance", "process_noise", "measurement_noise"):
            np.testing.assert_array_equal(
                getattr(one.estimate.state, name),
                getattr(other.estimate.state, name),
                err_msg=f"{name} at {one.stamp_ns} ns",
            )


def estimates(outputs: list[Output]) -> list[Output]:
    """Return the outputs with an estimate: those from the filter's start on."""
    return [output for output in outputs if output.estimate is not None]


def status_at_end(localizer: Localizer, name: str) -> Status:
    """Return the current status of a name."""
    return next(status for status in localizer.report() if status.name == name)


def time_values(localizer: Localizer) -> dict[str, str]:
    """Return the values of the status `time` by key."""
    return dict(status_at_end(localizer, "time").values)


def statuses(outputs: list[Output], name: str) -> list[Status]:
    """Return all statuses of a name in outputs."""
    return [s for output in outputs for s in output.statuses or () if s.name == name]
