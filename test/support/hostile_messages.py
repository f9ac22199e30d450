# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Streams of hostile and ordinary messages, grown from recipes of a few numbers.

A robot drives a winding path and sends what a real one sends. A recipe says for how long which
attacks are made on that, and on how large a share of the messages. Everything else comes from the
recipe's seed, so that a recipe of one line stands for thousands of messages.
"""

import copy
import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from hostile_attacks import ATTACKS, Random, covariance_from, log_uniform, pick, time_fields

from fnn_ekf_ros import messages
from fnn_ekf_ros.messages import Message
from fnn_ekf_ros.parameters.localizer import LocalizerParameters

TICK_NS = 50_000_000
"""The encoders speak so often; compass and fixes every 2nd and 8th time [ns]."""
SPEED = 0.3
"""Of the robot [m/s]."""
METERS_PER_COUNT = 2.0 * math.pi * 0.025 / 500.0
WHEEL_SEPARATION = 0.6
FIX_STD, COMPASS_STD = 0.05, 0.05
BEGIN_NS = 1_700_000_000 * 10**9
LATEST_NS = (2**31 - 100) * 10**9
"""A little before the end of what a stamp can hold [ns]."""
CLOCK_RATES = {"slow": 0.05, "fast": 20.0}
"""ROS time that passes with a tick, over that of a clock that is right."""
FLOOD = 30
"""Messages of a sensor that floods, for one of its own."""
FLOOD_S = 0.1
"""Largest difference of their stamps from its stamp [s]."""
MOST_HELD = 400
"""Largest number of messages that are delayed at a time."""


class Segment(NamedTuple):
    """A stretch of the drive.

    Attributes:
        attacks: names in `ATTACKS`, `SENDING` and `COMMANDS`; none: ordinary driving.
        share: of the messages that are attacked.
        ticks: its length in encoder messages of one wheel.
    """

    attacks: tuple[str, ...]
    share: float
    ticks: int


class Recipe(NamedTuple):
    """A whole drive."""

    seed: int
    segments: tuple[Segment, ...]


class Sent(NamedTuple):
    """A message as it arrives.

    Attributes:
        now_ns: ROS time of its arrival [ns].
        topic: one of `messages.INPUT_TYPES`.
        message: a tree of the topic's type; perhaps not of its lengths and ranges.
    """

    now_ns: int
    topic: str
    message: Message


class Command(NamedTuple):
    """A service call or a change of parameters, before the next message."""

    name: str
    number: int


class Truth(NamedTuple):
    """Where the robot is at an instant of ROS time."""

    stamp_ns: int
    pose: np.ndarray


SENDING = (
    "lost", "twice", "flood", "late", "burst", "silence", "clock", "slow", "fast", "kidnapped",
    "lying",
)  # fmt: skip
"""What happens to the sending of messages, to the clock, to the robot, and to all its sensors."""
COMMANDS = ("reset", "hold", "learn", "change")
"""What is asked of the localizer meanwhile."""
EVERYTHING = (*ATTACKS, *SENDING, *COMMANDS)


class Robot:
    """Drives a winding path for ever.

    Attributes:
        pose: `(3,)` true [x, y, yaw] (m, m, rad).
        way: `(2,)` of the left and the right wheel [m].
    """

    def __init__(self, rng: Random) -> None:
        self._rng = rng
        self.pose = np.array([*rng.uniform(-5.0, 5.0, 2), rng.uniform(-math.pi, math.pi)])
        self.way = np.zeros(2)
        self._ticks = 0
        self._offset = np.zeros(3)

    def step(self) -> None:
        """Drive for one tick."""
        self._ticks += 1
        way = SPEED * TICK_NS * 1e-9
        turn = 0.4 * math.sin(self._ticks / 60.0) * TICK_NS * 1e-9
        middle = self.pose[2] + 0.5 * turn
        step = np.array([way * math.cos(middle), way * math.sin(middle), turn])
        self.pose = self.pose + step
        self.way = self.way + way + np.array([-0.5, 0.5]) * turn * WHEEL_SEPARATION

    def set_apart(self, attacks: tuple[str, ...]) -> None:
        """Carry the robot off, or let all its sensors say that it is elsewhere."""
        rng = self._rng
        self._offset = np.zeros(3)
        if "lying" in attacks:
            self._offset = rng.normal(size=3) * log_uniform(rng, 0.01, 1e3, 1)
        if "kidnapped" in attacks:
            self.pose = self.pose + rng.normal(size=3) * log_uniform(rng, 0.1, 1e6, 1)

    def speak(self, now_ns: int, parameters: LocalizerParameters) -> list[tuple[str, Message]]:
        """Return what is sent now."""
        sent = []
        pose = self.pose + self._offset
        if self._ticks % 2 == 0:
            yaw = pose[2] + self._rng.normal() * COMPASS_STD
            sent.append((messages.COMPASS, compass(now_ns, yaw)))
        if self._ticks % 8 == 0:
            noisy = pose + self._rng.normal(size=3) * FIX_STD
            fix = pose_message(now_ns, noisy, FIX_STD**2 * np.eye(6))
            sent.append((messages.LRF_POSE, fix))
        if parameters.encoder_source == "joint_states":
            radians = self.way / parameters.wheel_radius
            names = [parameters.left_joint, parameters.right_joint]
            return [*sent, (messages.JOINT_STATES, joint_states(now_ns, names, radians))]
        left, right = (
            wrapped(round(way / METERS_PER_COUNT), parameters.encoder_bits) for way in self.way
        )
        return [
            *sent,
            (messages.LEFT_TICKS, Message(messages.TICKS_TYPE, {"data": left})),
            (messages.RIGHT_TICKS, Message(messages.TICKS_TYPE, {"data": right})),
        ]


def wrapped(count: int, bits: int) -> int:
    """Return a counter of so many bits, signed."""
    return (count + 2 ** (bits - 1)) % 2**bits - 2 ** (bits - 1)


def _header(stamp_ns: int, frame: str) -> Message:
    stamp = Message("builtin_interfaces/msg/Time", time_fields(stamp_ns))
    return Message("std_msgs/msg/Header", {"stamp": stamp, "frame_id": frame})


def compass(stamp_ns: int, yaw: float) -> Message:
    """Return the sensor_msgs/Imu of a compass."""
    none = Message("geometry_msgs/msg/Vector3", {"x": 0.0, "y": 0.0, "z": 0.0})
    return Message(
        messages.COMPASS_TYPE,
        {
            "header": _header(stamp_ns, "imu_link"),
            "orientation": messages.quaternion(float(yaw)),
            "orientation_covariance": np.zeros(9),
            "angular_velocity": none,
            "linear_acceleration": none,
        },
    )


def pose_message(stamp_ns: int, pose: np.ndarray, covariance: np.ndarray) -> Message:
    """Return a geometry_msgs/PoseWithCovarianceStamped in frame map."""
    return Message(
        messages.POSE_TYPE,
        {
            "header": _header(stamp_ns, "map"),
            "pose": messages.pose_with_covariance(pose, covariance.copy()),
        },
    )


def joint_states(stamp_ns: int, names: list[str], radians: np.ndarray) -> Message:
    """Return the sensor_msgs/JointState of the two wheels."""
    return Message(
        messages.JOINT_STATES_TYPE,
        {
            "header": _header(stamp_ns, ""),
            "name": list(names),
            "position": radians.copy(),
            "velocity": np.empty(0),
            "effort": np.empty(0),
        },
    )


def stream(recipe: Recipe, parameters: LocalizerParameters) -> Iterator[Sent | Command | Truth]:
    """Grow a recipe into what arrives, in order of arrival.

    Args:
        recipe: what is to happen.
        parameters: of the localizer: its encoders and its history.

    Yields:
        Messages and commands; the truth before the messages of each tick of an ordinary segment.
    """
    rng = np.random.default_rng(recipe.seed)
    robot = Robot(rng)
    clock = _Clock(rng, parameters)
    held: list[Sent] = []
    for segment in recipe.segments:
        commands = [name for name in segment.attacks if name in COMMANDS]
        robot.set_apart(segment.attacks)
        for _ in range(segment.ticks):
            robot.step()
            clock.step(segment.attacks)
            if commands and rng.random() < 0.02:
                yield Command(pick(rng, commands), int(rng.integers(1000)))
            if not segment.attacks:
                yield Truth(clock.now_ns, robot.pose)
            for sent in _spoken(rng, robot, clock.now_ns, segment, parameters):
                held.append(sent)
                for each in _released(rng, held, segment):
                    yield each._replace(now_ns=clock.now_ns)


class _Clock:
    """ROS time, which may stand still, leap and go back."""

    def __init__(self, rng: Random, parameters: LocalizerParameters) -> None:
        self.now_ns = BEGIN_NS
        self._rng = rng
        self._jumps_ns = _jumps_ns(parameters)
        self._frozen = 0

    def step(self, attacks: tuple[str, ...]) -> None:
        rng = self._rng
        if self._frozen:
            self._frozen -= 1
        else:
            rate = math.prod(CLOCK_RATES.get(name, 1.0) for name in attacks)
            self.now_ns += round(rate * TICK_NS)
        if "burst" in attacks and rng.random() < 0.05:
            self._frozen = int(rng.integers(60))
        if "silence" in attacks and rng.random() < 0.01:
            self.now_ns += round(rng.exponential(5.0) * 1e9)
        if "clock" in attacks and rng.random() < 0.02:
            jump_ns = pick(rng, (*self._jumps_ns, 1 - self.now_ns, BEGIN_NS - self.now_ns))
            # Never before 0, where the node does not listen.
            self.now_ns = min(max(self.now_ns + jump_ns, 1), LATEST_NS)


def _jumps_ns(parameters: LocalizerParameters) -> tuple[int, ...]:
    history_ns, ten_periods_ns = round(parameters.history * 1e9), round(parameters.period * 1e10)
    return (
        -1, -history_ns // 2, -history_ns, -history_ns - 1, history_ns, ten_periods_ns,
        -3_600 * 10**9, 3_600 * 10**9, -(10**16), 10**16,
    )  # fmt: skip


def _spoken(
    rng: Random, robot: Robot, now_ns: int, segment: Segment, parameters: LocalizerParameters
) -> Iterator[Sent]:
    """Yield what the robot and somebody with RViz say, attacked."""
    said = robot.speak(now_ns, parameters)
    if segment.attacks and rng.random() < 0.02 * segment.share:
        pose = robot.pose + rng.normal(size=3)
        covariance = covariance_from(rng) if rng.random() < 0.5 else np.zeros((6, 6))
        said.append((messages.INITIAL_POSE, pose_message(now_ns, pose, covariance)))
    attacks = [ATTACKS[name] for name in segment.attacks if name in ATTACKS]
    for topic, message in said:
        for attack in attacks:
            if rng.random() < segment.share:
                attack(rng, message)
        yield Sent(now_ns, topic, message)
        if "flood" in segment.attacks and rng.random() < 0.2 * segment.share:
            for _ in range(int(rng.integers(FLOOD))):
                yield Sent(now_ns, topic, _stamped_otherwise(rng, message))


def _stamped_otherwise(rng: Random, message: Message) -> Message:
    """Return a copy with another stamp, if it has one."""
    copied = copy.deepcopy(message)
    if "header" in copied.fields:
        stamp = copied.fields["header"].fields["stamp"].fields
        shift_ns = round(rng.uniform(-FLOOD_S, FLOOD_S) * 1e9)
        stamp.update(time_fields(stamp["sec"] * 10**9 + stamp["nanosec"] + shift_ns))
    return copied


def _released(rng: Random, held: list[Sent], segment: Segment) -> Iterator[Sent]:
    """Yield what is held and leaves now: all of it if nothing holds it up."""
    share = segment.share
    if "late" in segment.attacks and len(held) < MOST_HELD and rng.random() < 0.9 * share + 0.1:
        if rng.random() < 0.5:
            yield held.pop(int(rng.integers(len(held))))
        return
    while held:
        each = held.pop(0)
        if "lost" in segment.attacks and rng.random() < share:
            continue
        if "twice" in segment.attacks and rng.random() < share:
            yield Sent(each.now_ns, each.topic, copy.deepcopy(each.message))
        yield each
