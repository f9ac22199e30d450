# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The readings of a drive in a bag, as the examination of it takes them."""

import math
from collections import Counter
from collections.abc import Mapping
from typing import Any

import numpy as np

from fnn_ekf_ros import messages
from fnn_ekf_ros.calibration.examination import Drive
from fnn_ekf_ros.calibration.findings import Certainty, Change, Finding
from fnn_ekf_ros.core.arrays import FloatArray
from fnn_ekf_ros.core.limits import LARGEST_POSITION
from fnn_ekf_ros.parameters.localizer import LARGEST_DELAY_S
from fnn_ekf_ros.recordings.bag_facts import TopicFacts
from fnn_ekf_ros.recordings.input_plan import InputPlan

AHEAD_S = 0.05
"""Largest time by which stamps are ahead of the bag's clock [s]: synchronized ones are closer."""
_DELAYS = {messages.COMPASS: "compass_delay", messages.LRF_POSE: "lrf_pose_delay"}
"""Parameter that is subtracted from the stamps of a topic."""
DRIFTED_S = 0.1
"""Largest drift of a sensor's clock in a recording [s]: that of a delay that is no finding."""
LONGEST_AGE_S = 5.0
"""Largest age of stamps [s]: no sensor computes for so long."""


class DriveReadings:
    """Readings of a drive, message by message.

    Args:
        configured: parameters of the localizer, by name.
    """

    def __init__(self, configured: Mapping[str, Any]) -> None:
        self._joints = (str(configured["left_joint"]), str(configured["right_joint"]))
        self._left: list[tuple[float, ...]] = []
        self._right: list[tuple[float, ...]] = []
        self._compass: list[tuple[float, ...]] = []
        self._fixes: list[tuple[float, ...]] = []
        self._names: Counter[str] = Counter()
        self._renamed: tuple[str, str] | None = None
        self._start_ns: int | None = None

    def take(self, topic: str, message: Any, now_ns: int) -> None:
        """Take a message in.

        Args:
            topic: of the localizer.
            message: with attributes.
            now_ns: ROS time at which it came [ns].
        """
        if self._start_ns is None:
            self._start_ns = now_ns
        if topic == messages.LEFT_TICKS:
            self._left.append((self._seconds(now_ns), float(message.data)))
        elif topic == messages.RIGHT_TICKS:
            self._right.append((self._seconds(now_ns), float(message.data)))
        elif topic == messages.JOINT_STATES:
            self._add_joints(message)
        elif topic == messages.COMPASS:
            yaw = messages.yaw_of(message.orientation)
            if yaw is not None and message.orientation_covariance[0] != -1.0:
                self._compass.append((self._seconds(messages.stamp_ns(message)), yaw))
        elif topic == messages.LRF_POSE:
            pose = messages.planar_pose(message).tolist()
            if abs(pose[0]) < LARGEST_POSITION and abs(pose[1]) < LARGEST_POSITION:
                self._fixes.append((self._seconds(messages.stamp_ns(message)), *pose))

    def drive(self, skews: Mapping[str, float] = {}) -> Drive:
        """Return the readings.

        Args:
            skews: by how much the stamps of a topic are ahead of the bag's clock [s]; they are put
                right by that.
        """
        return Drive(
            _sorted(self._left, 2, skews.get(messages.JOINT_STATES, 0.0)),
            _sorted(self._right, 2, skews.get(messages.JOINT_STATES, 0.0)),
            _sorted(self._compass, 2, skews.get(messages.COMPASS, 0.0)),
            _sorted(self._fixes, 4, skews.get(messages.LRF_POSE, 0.0)),
        )

    def joint_findings(self) -> list[Finding]:
        """Return whether joints have other names than the configured ones."""
        if self._renamed is None or self._renamed == self._joints:
            return []
        return [
            Finding(
                "joint_names",
                f"joint_states has no joint '{self._joints[0]}' and '{self._joints[1]}'",
                f"it has {', '.join(sorted(self._names))}",
                Certainty.LIKELY,
                (Change("left_joint", self._renamed[0]), Change("right_joint", self._renamed[1])),
            )
        ]

    @property
    def fixes_have_yaw(self) -> bool:
        """Whether the yaw of the fixes ever changes."""
        yaws = {fix[3] for fix in self._fixes if not math.isnan(fix[3])}
        return len(yaws) > 1

    def _seconds(self, time_ns: int) -> float:
        return (time_ns - (self._start_ns or 0)) * 1e-9

    def _add_joints(self, message: Any) -> None:
        names = list(message.name)
        self._names.update(names)
        joints = self._joints
        if not all(joint in names for joint in joints):
            self._renamed = self._renamed or _wheel_joints(names)
            joints = self._renamed or joints
        time = self._seconds(messages.stamp_ns(message))
        for joint, readings in zip(joints, (self._left, self._right), strict=True):
            if joint in names and names.index(joint) < len(message.position):
                position = float(message.position[names.index(joint)])
                if abs(position) < LARGEST_POSITION:
                    readings.append((time, position))


def _wheel_joints(names: list[str]) -> tuple[str, str] | None:
    """Return the joints that look like a left and a right wheel."""
    found = []
    for side in ("left", "right"):
        fitting = [name for name in names if side in name.lower()]
        wheels = [name for name in fitting if "wheel" in name.lower()] or fitting
        if not wheels:
            return None
        found.append(wheels[0])
    return found[0], found[1]


def clock_findings(
    plan: InputPlan, facts: Mapping[str, TopicFacts], configured: Mapping[str, Any]
) -> tuple[list[Finding], dict[str, float]]:
    """Return what is wrong with stamps against the bag's clock, and the skews to put right [s].

    Args:
        plan: the topics that are read.
        facts: of the bag, by topic.
        configured: parameters of the localizer, by name.
    """
    findings: list[Finding] = []
    skews: dict[str, float] = {}
    for topic, name in plan.topics.items():
        fact = facts[name]
        if math.isnan(fact.latency_s):
            continue
        delay_s = float(configured.get(_DELAYS.get(topic, ""), 0.0))
        ahead = -fact.latency_s - delay_s
        if ahead > AHEAD_S or ahead < -LONGEST_AGE_S:
            skews[topic] = ahead
            findings.append(_skew(topic, fact, ahead, ahead + delay_s))
        elif _drifted_s(fact) > DRIFTED_S:
            findings.append(_drift(fact))
        elif delay_s - ahead + 0.5 * fact.latency_spread_s > float(configured["history"]):
            findings.append(_late(fact, float(configured["history"])))
    return findings, skews


def _skew(topic: str, fact: TopicFacts, ahead: float, delay_s: float) -> Finding:
    parameter = _DELAYS.get(topic)
    half = 0.5 * fact.latency_spread_s
    changes: tuple[Change, ...] = ()
    if parameter is not None and abs(delay_s) <= LARGEST_DELAY_S:
        changes = (Change(parameter, delay_s, delay_s - half, delay_s + half, "s"),)
    where = "ahead of" if ahead > 0.0 else "behind"
    return Finding(
        "clock_skew",
        f"the stamps of {fact.name} are {abs(ahead):.3g} s {where} the bag's clock",
        f"median of {fact.messages} messages, spread {fact.latency_spread_s:.2g} s, drift "
        f"{fact.drift_ppm:.0f} ppm; synchronize the computers (chrony) rather than set a delay",
        Certainty.CERTAIN,
        changes,
    )


def _drifted_s(fact: TopicFacts) -> float:
    """Return by how much a sensor's clock went away from the bag's [s]; 0 if it only scatters."""
    if math.isnan(fact.drift_ppm) or fact.rate_hz == 0.0:
        return 0.0
    drifted = abs(fact.drift_ppm) * 1e-6 * fact.messages / fact.rate_hz
    return drifted if drifted > 0.5 * fact.latency_spread_s else 0.0


def _drift(fact: TopicFacts) -> Finding:
    return Finding(
        "clock_skew",
        f"the clock of {fact.name} is {'slow' if fact.drift_ppm > 0.0 else 'fast'} by "
        f"{abs(fact.drift_ppm):.0f} ppm against the bag's",
        f"{_drifted_s(fact):.2g} s in this recording; synchronize the computers (chrony)",
        Certainty.CERTAIN,
    )


def _late(fact: TopicFacts, history_s: float) -> Finding:
    needed = min(fact.latency_s + fact.latency_spread_s, 10.0)
    return Finding(
        "late_messages",
        f"messages of {fact.name} come {fact.latency_s:.3g} s after their stamp and are dropped",
        f"history is {history_s:g} s",
        Certainty.CERTAIN,
        (Change("history", round(1.2 * needed, 1), unit="s"),),
    )


def _sorted(readings: list[tuple[float, ...]], width: int, ahead: float) -> FloatArray:
    table = np.array(readings, dtype=np.float64).reshape(-1, width)
    table = table[np.argsort(table[:, 0], kind="stable")]
    table[:, 0] -= ahead
    keep = np.ones(len(table), dtype=np.bool_)
    keep[1:] = np.diff(table[:, 0]) > 0.0
    return table[keep]
