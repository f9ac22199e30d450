# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""What a node does with its queues: all messages are taken out before time passes.

rclpy gives a node one message of each topic at a time, and its timers before them: after a stop the
timers would let time pass, and a topic with many messages would run ahead of one with few.
"""

import time
from collections.abc import Iterator
from typing import Any

from rclpy.node import Node
from rclpy.subscription import Subscription
from rclpy.time import Time

from fnn_ekf_ros.messages import CLOCK
from fnn_ekf_ros.ros.arrivals import Message, Moment

MOST_WAITING = 20_000
"""Largest number of messages that wait in a node [messages]: five seconds of four topics at 1 kHz.
Further ones stay in the queues, which drop the oldest ones if they overflow."""


def now_of(node: Node) -> Moment:
    """Return what the clocks of a node show."""
    clock = node.get_clock()
    ros_ns = None if clock.ros_time_is_active else int(clock.now().nanoseconds)
    return Moment(time.monotonic(), time.time_ns(), ros_ns)


def take_all(subscriptions: dict[str, Subscription], room: int) -> list[Message]:
    """Return all messages that wait in queues, by topic, at most as many as there is room for.

    The queues are looked at until all are empty: what reached one while others were looked at may
    have been sent before what was found there.
    """
    found: list[Message] = []
    before = -1
    while len(found) > before:
        before = len(found)
        for topic, subscription in subscriptions.items():
            for content, info in _taken(subscription):
                found.append(as_message(topic, content, info))
                if len(found) >= room:
                    return found
    return found


def as_message(topic: str, content: Any, info: dict[str, int]) -> Message:
    """Return a message with its times."""
    if topic == CLOCK:
        content = int(Time.from_msg(content.clock).nanoseconds)
    return Message(topic, content, info["source_timestamp"], info["received_timestamp"])


def _taken(subscription: Subscription) -> Iterator[tuple[Any, dict[str, int]]]:
    """Yield the messages of a queue, as the executor takes them."""
    with subscription.handle:
        while True:
            taken = subscription.handle.take_message(subscription.msg_type, subscription.raw)
            if taken is None:
                return
            yield taken
