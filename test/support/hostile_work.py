# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The work and the memory that messages cost a localizer, counted, and what they may be."""

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

from fnn_ekf_ros.core import filter as filter_module
from fnn_ekf_ros.localizer.history import LONGEST_KEPT, MOST_REDONE, History
from fnn_ekf_ros.localizer.localizer import Localizer
from fnn_ekf_ros.parameters.localizer import LocalizerParameters
from fnn_ekf_ros.timeline import period as period_module
from fnn_ekf_ros.timeline.epochs import MOST_READINGS, MOST_READINGS_A_SECOND
from fnn_ekf_ros.timeline.wheels import MOST_KEPT

STEPS = [0]
"""Number of filter steps, and of epochs of waiting filters, inside `counted_steps`."""
RUNS = 2
"""Runs of a period: one that fails is run again without its measurements."""
REDOS = 3
"""Times that one message may have periods run again: once for the time that has passed, and once
for each of its two wheels."""


@contextmanager
def counted_steps() -> Iterator[None]:
    """Count the steps of all filters in here."""
    fuse, wait = filter_module.fuse, period_module.wait

    def counting(step: Callable[..., Any]) -> Callable[..., Any]:
        def counted(*arguments: Any) -> Any:
            STEPS[0] += 1
            return step(*arguments)

        return counted

    filter_module.fuse, period_module.wait = counting(fuse), counting(wait)
    try:
        yield
    finally:
        filter_module.fuse, period_module.wait = fuse, wait


class Totals(NamedTuple):
    """What some localizers were given and did.

    Attributes:
        messages: number of messages.
        periods: that were closed.
        steps: of their filters.
        worst_steps: of one message.
        most_checkpoints: that one of them has kept.
        most_readings: of a sensor or wheel that one of them has kept.
    """

    messages: int = 0
    periods: int = 0
    steps: int = 0
    worst_steps: int = 0
    most_checkpoints: int = 0
    most_readings: int = 0

    def with_more(self, other: "Totals") -> "Totals":
        """Return the totals of both."""
        return Totals(
            messages=self.messages + other.messages,
            periods=self.periods + other.periods,
            steps=self.steps + other.steps,
            worst_steps=max(self.worst_steps, other.worst_steps),
            most_checkpoints=max(self.most_checkpoints, other.most_checkpoints),
            most_readings=max(self.most_readings, other.most_readings),
        )


class Work:
    """Checks what each message costs one localizer, in filter steps and in what is kept.

    Attributes:
        totals: so far.
    """

    def __init__(self, parameters: LocalizerParameters) -> None:
        self.totals = Totals()
        self._period_s = parameters.period
        readings = max(MOST_READINGS, math.ceil(MOST_READINGS_A_SECOND * parameters.period))
        # Of two sensors, and the ends of the period and of the time before a pose that is set.
        self._longest_period = 2 * readings + 2
        self._most_checkpoints = LONGEST_KEPT * parameters.history / parameters.period + 2
        self._history: History | None = None
        self._begun = 0
        self._most_steps_kept = 0
        self._set_back = 0
        self._now_ns = 0

    def check(self, localizer: Localizer, now_ns: int, message: Callable[[], Any]) -> Any:
        """Give a localizer a message, check what it cost and return what it gave."""
        before, kept = STEPS[0], len(localizer._history._checkpoints)
        received = message()
        steps, closed = STEPS[0] - before, len(received.outputs)
        assert steps <= RUNS * self._longest_period * (closed + REDOS * kept)

        history = localizer._history
        self._begun += history is not self._history
        self._history = history
        # A clock that is set back makes one period shorter than the others.
        self._set_back += now_ns < self._now_ns
        self._now_ns = now_ns
        checkpoints = history._checkpoints
        assert len(checkpoints) <= self._most_checkpoints + self._set_back
        readings = most_readings(history)
        assert readings <= MOST_KEPT
        steps_kept = sum(each.steps for each in checkpoints)
        self._most_steps_kept = max(self._most_steps_kept, steps_kept)
        one = Totals(1, closed, steps, steps, len(checkpoints), readings)
        self.totals = self.totals.with_more(one)
        assert self.totals.steps <= self._most_steps()
        return received

    def _most_steps(self) -> float:
        """Return the largest number of steps of all messages so far.

        Each message is an epoch at most, each period one more. The steps that are run again
        are limited by `MOST_REDONE`, but the last run may go beyond by all that is kept, and a
        period may have become longer by then.
        """
        totals, begun = self.totals, self._begun
        redone = MOST_REDONE * (totals.periods * self._period_s + begun)
        beyond = 2 * begun * self._most_steps_kept
        return RUNS * (totals.messages + totals.periods + redone + beyond)


def most_readings(history: History) -> int:
    """Return how many readings are kept of the sensor or wheel with the most."""
    buffer = history.inputs
    queues = buffer._compass, buffer._fixes, buffer._resets, *buffer._wheels.values()
    return max(len(queue._stamps) for queue in queues)
