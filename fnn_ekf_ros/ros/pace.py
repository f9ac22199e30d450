# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The pace of a node: the work for a message or a timer must take less than a period."""

import time
from collections.abc import Callable

from rclpy.clock import Clock, ClockType
from rclpy.node import Node

LOOKS_PER_PERIOD = 4
"""Rate of a node's timers [1 / period]: they read the clock, to close periods that wait for the
wheels, and detect that the node was busy."""


class Pace:
    """Reports each time that a node was late by more than a period, in wall time.

    Args:
        node: gets a timer, whose delay shows that the node was busy.
        period_s: a period [s].
        late: is called with the delay [s].
    """

    def __init__(self, node: Node, period_s: float, late: Callable[[float], None]) -> None:
        self._period_s, self._late = period_s, late
        self._looked_s: float | None = None
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        node.create_timer(period_s / LOOKS_PER_PERIOD, self._look, clock=steady)

    def waited(self, received_ns: int) -> None:
        """Report a message that closed a period, if it had waited for more than a period.

        Args:
            received_ns: system time at which it reached the process [ns].
        """
        waited_s = (time.time_ns() - received_ns) * 1e-9
        if received_ns > 0 and waited_s > self._period_s:
            self._late(waited_s)

    def _look(self) -> None:
        now_s = time.monotonic()
        if self._looked_s is not None:
            late_s = now_s - self._looked_s - self._period_s / LOOKS_PER_PERIOD
            if late_s > self._period_s:
                self._late(late_s)
        self._looked_s = now_s
