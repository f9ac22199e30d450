# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Drives of the simulated robot with faults, and what is heard of them."""

import functools
import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from localizers import START_NS
from rosbags.typesys import Stores, get_typestore

from fnn_ekf_ros.core.angles import wrap_angle
from fnn_ekf_ros.core.arrays import FloatArray
from fnn_ekf_ros.messages import Message
from fnn_ekf_ros.parameters.fake_robot import FakeRobotParameters
from fnn_ekf_ros.parameters.faults import Fault
from fnn_ekf_ros.parameters.schema import build
from fnn_ekf_ros.simulation.delivery import Delivery, Sent
from fnn_ekf_ros.simulation.fake_robot import FakeRobot

QUIET: dict[str, Any] = {"slip_std": (0.0, 0.0), "wheel_speed_error": 0.0}
TYPESTORE = get_typestore(Stores.ROS2_JAZZY)


class Heard(NamedTuple):
    """A message as a listener gets it: when, in seconds since the start, and what."""

    time: float
    topic: str
    message: Message

    @property
    def fields(self) -> dict[str, Any]:
        return self.message.fields

    @property
    def stamp(self) -> float:
        """The stamp, in seconds since the start."""
        stamp = self.fields["header"].fields["stamp"].fields
        return (stamp["sec"] * 10**9 + stamp["nanosec"] - START_NS) * 1e-9


def drive(seconds: float, faults: Sequence[Fault] = (), **changes: Any) -> list[Heard]:
    """Return what a robot sends; messages change nothing, so runs are kept."""
    return list(_drive(seconds, tuple(faults), tuple(sorted(changes.items()))))


@functools.cache
def _drive(
    seconds: float, faults: tuple[Fault, ...], changes: tuple[tuple[str, Any], ...]
) -> list[Heard]:
    robot = FakeRobot(build(FakeRobotParameters, dict(changes)), START_NS, faults)
    heard: list[Heard] = []
    for _ in range(round(seconds * 80)):
        sent = robot.step()
        heard += [Heard((robot.time_ns - START_NS) * 1e-9, *entry) for entry in sent]
    return heard


def on(heard: Sequence[Heard], *topics: str) -> list[Heard]:
    return [entry for entry in heard if entry.topic in topics]


def plain(field: Any) -> Any:
    """Return a message as text that tells every bit of it."""
    if isinstance(field, Message):
        return (field.type_name, [(name, plain(value)) for name, value in field.fields.items()])
    if isinstance(field, list):
        return [plain(entry) for entry in field]
    return repr(field.tolist() if isinstance(field, np.ndarray) else field)


def same(one: Sequence[Heard], other: Sequence[Heard]) -> bool:
    return [(e.time, e.topic, plain(e.message)) for e in one] == [
        (e.time, e.topic, plain(e.message)) for e in other
    ]


def pose(entry: Heard) -> FloatArray:
    """Return [x, y, yaw] of a fix or of the truth; of the compass with NaN for x and y."""
    if entry.topic == "compass":
        q = entry.fields["orientation"].fields
        return np.array([math.nan, math.nan, 2.0 * math.atan2(q["z"], q["w"])])
    whole = entry.fields["pose"].fields["pose"].fields
    place, q = whole["position"].fields, whole["orientation"].fields
    return np.array([place["x"], place["y"], 2.0 * math.atan2(q["z"], q["w"])])


def off(one: Sequence[Heard], other: Sequence[Heard]) -> FloatArray:
    """Return by how much poses `(n, 3)` differ, yaw wrapped."""
    assert len(one) == len(other) > 0
    change = np.array([pose(a) - pose(b) for a, b in zip(one, other, strict=True)])
    change[:, 2] = wrap_angle(change[:, 2])
    return change


def counts(heard: Sequence[Heard], topic: str = "left_ticks") -> list[int]:
    return [entry.fields["data"] for entry in on(heard, topic)]


LASTING = {"start": 4.0, "duration": 2.0}


def through(fault: Fault, count: int) -> tuple[Heard, list[Heard]]:
    """Return a message and what a fault makes of it again and again."""
    one = on(drive(1.0), *fault.targets())[0]
    delivery = Delivery([fault], [np.random.default_rng(8)])
    sent = (
        entry
        for step in range(1, count + 1)
        for entry in delivery.sent(step, [Sent(one.topic, one.message)])
    )
    return one, [Heard(0.0, entry.topic, entry.message) for entry in sent]


def within(heard: Sequence[Heard], first: float = 4.0, end: float = 6.0) -> list[Heard]:
    return [e for e in heard if first <= e.time < end]


def faulty_and_true(fault: Any) -> tuple[list[Heard], list[Heard]]:
    """Return the faulty messages and what they should have been."""
    with_it, without = drive(9.0, [fault]), drive(9.0)
    return within(on(with_it, fault.topic)), within(on(without, fault.topic))
