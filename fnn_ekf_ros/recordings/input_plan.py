# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Which topics of a bag fit the localizer, and which of those it needs are missing."""

from collections.abc import Mapping
from typing import Any, NamedTuple

from fnn_ekf_ros import messages
from fnn_ekf_ros.calibration.findings import Certainty, Change, Finding
from fnn_ekf_ros.recordings.bag_files import BagReader
from fnn_ekf_ros.recordings.inputs import TopicNames

_PREFERRED = {
    messages.LRF_POSE: ("amcl_pose", "pose"),
    messages.COMPASS: ("imu/data", "imu"),
    messages.JOINT_STATES: ("joint_states",),
    messages.LEFT_TICKS: ("left",),
    messages.RIGHT_TICKS: ("right",),
}
"""Ends, or parts, of names that topics have on many robots, the most usual first."""


class InputPlan(NamedTuple):
    """The topics to read.

    Attributes:
        topics: the bag's topic for each of the localizer's that can be read.
        source: where wheel motion comes from, `encoder_source`.
        findings: what is missing, with what fits.
    """

    topics: dict[str, str]
    source: str
    findings: tuple[Finding, ...]


def plan_inputs(bag: BagReader, configured: Mapping[str, Any], names: TopicNames) -> InputPlan:
    """Return which topics to read for the localizer's, and what is missing.

    Args:
        bag: the recording.
        configured: parameters of the localizer, by name.
        names: its topics, remapped.
    """
    found: dict[str, str] = {}
    findings: list[Finding] = []
    source = str(configured["encoder_source"])
    wheels = _wheel_topics(source)
    other = "ticks" if source == "joint_states" else "joint_states"
    if not _can_be_read(bag, names, wheels) and _can_be_read(bag, names, _wheel_topics(other)):
        findings.append(_other_source(source, other))
        source, wheels = other, _wheel_topics(other)
    for topic in (*wheels, messages.LRF_POSE, messages.COMPASS):
        name = names.of(topic)
        recorded = bag.topics.get(name)
        if recorded is not None and recorded.type_name == messages.INPUT_TYPES[topic]:
            found[topic] = name
            if recorded.message_count == 0:
                findings.append(_empty(topic, name))
            continue
        candidates = _candidates(bag, topic, {*found.values()})
        if recorded is not None:
            findings.append(_wrong_type(topic, name, recorded.type_name))
        elif topic != messages.COMPASS or (candidates and not configured["lrf_use_yaw"]):
            findings.append(_missing(bag, topic, name, candidates))
        if candidates:
            found[topic] = candidates[0]
    return InputPlan(found, source, tuple(findings))


def _wheel_topics(source: str) -> tuple[str, ...]:
    if source == "joint_states":
        return (messages.JOINT_STATES,)
    return (messages.LEFT_TICKS, messages.RIGHT_TICKS)


def _can_be_read(bag: BagReader, names: TopicNames, topics: tuple[str, ...]) -> bool:
    """Return whether topics are there, by their own names or by others."""
    for topic in topics:
        recorded = bag.topics.get(names.of(topic))
        own = recorded is not None and recorded.type_name == messages.INPUT_TYPES[topic]
        if not own and not _candidates(bag, topic, set()):
            return False
    return True


def _candidates(bag: BagReader, topic: str, taken: set[str]) -> list[str]:
    """Return topics of the right type, the one whose name fits best first."""
    kind = messages.INPUT_TYPES[topic]
    own = {messages.absolute_name(name) for name in messages.INPUT_TYPES} | taken
    same = [
        name
        for name, recorded in bag.topics.items()
        if recorded.type_name == kind and recorded.message_count and name not in own
    ]
    if topic in (messages.LEFT_TICKS, messages.RIGHT_TICKS):
        side = topic.split("_", maxsplit=1)[0]
        same = [name for name in same if side in name.lower()]
    preferred = _PREFERRED[topic]

    def rank(name: str) -> tuple[int, str]:
        fits = [at for at, part in enumerate(preferred) if part in name.lower()]
        return min(fits, default=len(preferred)), name

    return sorted(same, key=rank)


def _missing(bag: BagReader, topic: str, name: str, candidates: list[str]) -> Finding:
    kind = messages.INPUT_TYPES[topic]
    if candidates:
        others = f"; also {', '.join(candidates[1:])}" if len(candidates) > 1 else ""
        return Finding(
            "missing_topic",
            f"there is no topic {name}; {candidates[0]} has its type",
            f"{bag.topics[candidates[0]].message_count} messages of {kind}{others}",
            Certainty.CERTAIN if len(candidates) == 1 else Certainty.LIKELY,
            remaps=(f"{topic}:={candidates[0]}",),
        )
    evidence = f"the bag has {', '.join(sorted(bag.topics)) or 'no topics'}"
    odometry = [n for n, t in bag.topics.items() if t.type_name == messages.ODOMETRY_TYPE]
    wheels = topic in (messages.LEFT_TICKS, messages.RIGHT_TICKS, messages.JOINT_STATES)
    if wheels and odometry:
        evidence = (
            f"{', '.join(sorted(odometry))} is wheel odometry, already integrated: record ticks "
            "or /joint_states instead"
        )
    return Finding("missing_topic", f"there is no topic {name} ({kind})", evidence,
                   Certainty.CERTAIN)  # fmt: skip


def _empty(topic: str, name: str) -> Finding:
    return Finding(
        "missing_topic",
        f"topic {name} has no messages",
        f"{messages.INPUT_TYPES[topic]}, announced and never sent; its QoS may not fit the "
        "recorder's",
        Certainty.CERTAIN,
    )


def _wrong_type(topic: str, name: str, kind: str) -> Finding:
    return Finding(
        "wrong_type",
        f"topic {name} is {kind}",
        f"expected {messages.INPUT_TYPES[topic]}",
        Certainty.CERTAIN,
    )


def _other_source(source: str, other: str) -> Finding:
    return Finding(
        "missing_topic",
        f"the bag has no {source.replace('_', ' ')}, but {other.replace('_', ' ')}",
        f"encoder_source is {source}",
        Certainty.CERTAIN,
        (Change("encoder_source", other),),
    )
