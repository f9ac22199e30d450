# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The callback group of a node with one thread: it seldom waits for events, which costs time.

rclpy warns of publishers and subscriptions whose QoS or type does not fit, by two events of each
endpoint. It waits for all of them whenever it waits for a message, which takes a localizer more
time than what it does with the message. An event stays until it is taken, so that looking for them
now and then gives the same warnings, a few seconds later.
"""

import time
from typing import Any

from rclpy.callback_groups import CallbackGroup
from rclpy.event_handler import EventHandler

EVENT_INTERVAL_S = 5.0
"""Interval at whose begin a node waits for events of the middleware [s]: a warning of a QoS that
does not fit may come that late."""
EVENT_WINDOW_S = 0.25
"""Part of each interval in which it waits for events [s]: longer than a single wait of a node."""


class EventGroup(CallbackGroup):  # type: ignore[misc]
    """Lets everything be executed, but events of the middleware only now and then."""

    def can_execute(self, entity: Any) -> bool:
        """Return whether an entity is to be waited for, and executed."""
        return not isinstance(entity, EventHandler) or (
            time.monotonic() % EVENT_INTERVAL_S < EVENT_WINDOW_S
        )

    def beginning_execution(self, entity: Any) -> bool:  # noqa: ARG002
        """Return whether an entity may be executed: yes, as nothing else is at the same time."""
        return True

    def ending_execution(self, entity: Any) -> None:
        """Do nothing: no entity waits for the end of another one."""
