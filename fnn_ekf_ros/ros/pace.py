"""Whether a node keeps pace: what it does with a message or a timer must not take a period."""

import time
from collections.abc import Callable

from rclpy.clock import Clock, ClockType
from rclpy.node import Node

LOOKS_PER_PERIOD = 4
"""Timers of a node look so many times a period: at the clock, to close periods that wait for the
wheels, and at whether anything keeps the node busy."""


class Pace:
    """Tells of every time that a node was late by more than a period, in wall time.

    Args:
        node: a timer of its own shows whether anything keeps it busy.
        period_s: a period [s].
        late: is called with the delay [s].
    """

    def __init__(self, node: Node, period_s: float, late: Callable[[float], None]) -> None:
        self._period_s, self._late = period_s, late
        self._looked_s: float | None = None
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        node.create_timer(period_s / LOOKS_PER_PERIOD, self._look, clock=steady)

    def waited(self, received_ns: int) -> None:
        """Tell of a message that closed a period, if it had waited too long.

        Args:
            received_ns: system time at which it had reached the process [ns].
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
