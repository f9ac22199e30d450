# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""What is in a bag: its topics with their rates, gaps, stamps, frames and delivery."""

import struct
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from fnn_ekf_ros import messages
from fnn_ekf_ros.recordings.bag_files import BagReader, Record, Topic

_HEADERS = ("std_msgs/Header header", "std_msgs/msg/Header header")
"""First field of the definition of a type with stamps."""
_STAMPED = {
    messages.COMPASS_TYPE, messages.JOINT_STATES_TYPE, messages.ODOMETRY_TYPE, messages.POSE_TYPE,
}  # fmt: skip
"""Types with stamps, also where their definition was not recorded."""
MOST_KEPT = 1_000_000
"""Largest number of times that are kept of one topic; of more, the first ones."""


class TopicFacts(NamedTuple):
    """What was recorded of a topic.

    Attributes:
        name: absolute.
        type_name: of its messages.
        messages: number of messages.
        bytes: size of all of them.
        rate_hz: messages per second between the first and the last one; 0 with fewer than two.
        longest_gap_s: between two messages; 0 with fewer than two.
        latency_s: median of recording time minus stamp [s]; NaN without stamps.
        latency_spread_s: between the 5th and the 95th percentile of that [s].
        drift_ppm: by how much the stamps' clock is slow against the bag's [1e-6]; NaN without.
        backward: number of stamps that are before the one before.
        frames: frames of the messages, in alphabetic order.
        reliable: whether its publishers offered reliable delivery, ROS's default.
        transient_local: whether they kept messages for late joiners.
    """

    name: str
    type_name: str
    messages: int
    bytes: int
    rate_hz: float
    longest_gap_s: float
    latency_s: float
    latency_spread_s: float
    drift_ppm: float
    backward: int
    frames: tuple[str, ...]
    reliable: bool
    transient_local: bool


class FactsCollector:
    """Facts of a bag, record by record.

    Args:
        bag: the recording.
    """

    def __init__(self, bag: BagReader) -> None:
        self._topics = {name: _Collected(topic) for name, topic in bag.topics.items()}

    def add(self, record: Record) -> None:
        """Take a record in."""
        self._topics[record.topic].add(record)

    def facts(self) -> tuple[TopicFacts, ...]:
        """Return the facts of all topics, by name."""
        return tuple(self._topics[name].facts() for name in sorted(self._topics))


class _Collected:
    def __init__(self, topic: Topic) -> None:
        self._topic = topic
        self._stamped = topic.type_name in _STAMPED or _has_header(topic.definition)
        self._times: list[int] = []
        self._stamps: list[int] = []
        self._frames: set[str] = set()
        self._count = self._bytes = 0

    def add(self, record: Record) -> None:
        self._count += 1
        self._bytes += len(record.data)
        if self._count > MOST_KEPT:
            return
        self._times.append(record.time_ns)
        if self._stamped and len(record.data) >= 16:
            order = "<" if record.data[1] % 2 else ">"
            seconds, nanoseconds, length = struct.unpack_from(f"{order}iII", record.data, 4)
            self._stamps.append(seconds * 10**9 + nanoseconds)
            if len(self._frames) < 20:
                frame = bytes(record.data[16 : 16 + max(length - 1, 0)])
                self._frames.add(frame.decode(errors="replace"))

    def facts(self) -> TopicFacts:
        times = np.array(self._times, dtype=np.int64)
        gaps = np.diff(times) * 1e-9
        span = float(gaps.sum()) if len(gaps) else 0.0
        latency, spread, drift, backward = np.nan, np.nan, np.nan, 0
        if len(self._stamps) == len(times) and len(times):
            stamps = np.array(self._stamps, dtype=np.int64)
            late = (times - stamps) * 1e-9
            latency = float(np.median(late))
            low, high = np.quantile(late, [0.05, 0.95])
            spread = float(high - low)
            backward = int(np.sum(np.diff(stamps) < 0))
            if span > 10.0:
                drift = 1e6 * float(np.polyfit((times - times[0]) * 1e-9, late - latency, 1)[0])
        return TopicFacts(
            name=self._topic.name,
            type_name=self._topic.type_name,
            messages=self._count,
            bytes=self._bytes,
            rate_hz=len(gaps) / span if span > 0.0 else 0.0,
            longest_gap_s=float(gaps.max()) if len(gaps) else 0.0,
            latency_s=latency,
            latency_spread_s=spread,
            drift_ppm=drift,
            backward=backward,
            frames=tuple(sorted(self._frames)),
            reliable=self._topic.reliable,
            transient_local=self._topic.transient_local,
        )


def _has_header(definition: str) -> bool:
    for line in definition.splitlines():
        field = " ".join(line.split("#")[0].split())
        if field:
            return field in _HEADERS
    return False


def by_name(facts: Iterable[TopicFacts]) -> dict[str, TopicFacts]:
    """Return facts by the topics' names."""
    return {each.name: each for each in facts}
