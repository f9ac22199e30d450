# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Delivery of the messages from the sensors to the listeners, and its faults.

Every fault is a stage. What a stage lets through enters the next one in the same step; whether a
fault is on is asked when a message enters its stage.
"""

import math
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from typing import Any, Generic, NamedTuple, TypeVar

import numpy as np

from fnn_ekf_ros.messages import Message
from fnn_ekf_ros.parameters.faults import (
    Burst,
    Delay,
    Dropout,
    Duplicates,
    Fault,
    Frozen,
    Reordered,
    Wander,
)
from fnn_ekf_ros.simulation.robot import STEP_S
from fnn_ekf_ros.simulation.spoiling import SPOILERS, jittered, shifted, spoiled, with_stamp

STEP_NS = round(STEP_S * 1e9)
"""Length of a step of the simulation [ns]."""
FaultT = TypeVar("FaultT", bound=Fault)
"""A kind of fault."""


class Sent(NamedTuple):
    """A message the robot sends."""

    topic: str
    message: Message


def step_at(time_s: float) -> int:
    """Return the first of the robot's steps that ends at or after a time since its start [s]."""
    return -(-round(time_s * 1e9) // STEP_NS)


class Stage(ABC, Generic[FaultT]):
    """A fault of a topic's messages.

    Args:
        fault: with a `topic`.
        rng: of its own, so that nothing else of the run depends on it.
    """

    def __init__(self, fault: FaultT, rng: np.random.Generator) -> None:
        (self._topic,) = fault.targets()
        self._first, self._end = step_at(fault.start), step_at(fault.end)
        self._rate = float(getattr(fault, "rate", 1.0))
        self._fault: FaultT = fault
        self._rng = rng

    def passed(self, step: int, entering: Iterable[Sent]) -> Iterator[Sent]:
        """Yield what leaves the stage in a step, of what enters it or is held back in it."""
        on = self._first <= step < self._end
        yield from self._released(step, on)
        for sent in entering:
            if sent.topic != self._topic:
                yield sent
            elif on and self._rng.random() < self._rate:
                yield from self._suffering(step, sent)
            else:
                yield from self._healthy(sent)

    def _released(self, step: int, on: bool) -> Iterable[Sent]:  # noqa: ARG002
        return ()

    def _healthy(self, sent: Sent) -> Iterable[Sent]:
        return (sent,)

    @abstractmethod
    def _suffering(self, step: int, sent: Sent) -> Iterable[Sent]:
        """Return what leaves the stage when the fault meets a message."""


class _Spoiling(Stage[Fault]):
    def _suffering(self, step: int, sent: Sent) -> Iterable[Sent]:  # noqa: ARG002
        return (sent._replace(message=spoiled(self._fault, sent.message, self._rng)),)


class _Freezing(Stage[Frozen]):
    _last: Message | None = None

    def _healthy(self, sent: Sent) -> Iterable[Sent]:
        self._last = sent.message
        return (sent,)

    def _suffering(self, step: int, sent: Sent) -> Iterable[Sent]:  # noqa: ARG002
        if self._last is None:  # it was frozen from the start
            self._last = sent.message
        header = sent.message.fields.get("header")
        frozen = self._last if header is None else with_stamp(self._last, header.fields["stamp"])
        if self._fault.jitter:
            frozen = jittered(frozen, self._fault.jitter, self._rng)
        return (sent._replace(message=frozen),)


class _Wandering(Stage[Wander]):
    def __init__(self, fault: Wander, rng: np.random.Generator) -> None:
        super().__init__(fault, rng)
        self._error = np.zeros(2)
        self._step = self._first

    def _suffering(self, step: int, sent: Sent) -> Iterable[Sent]:
        kept = math.exp(-(step - self._step) * STEP_S / self._fault.time_constant)
        added = self._fault.std * math.sqrt(1.0 - kept * kept)
        self._error = kept * self._error + added * self._rng.standard_normal(2)
        self._step = step
        return (sent._replace(message=shifted(sent.message, self._error)),)


class _Losing(Stage[Dropout]):
    def _suffering(self, step: int, sent: Sent) -> Iterable[Sent]:  # noqa: ARG002
        return ()


class _Doubling(Stage[Duplicates]):
    def _suffering(self, step: int, sent: Sent) -> Iterable[Sent]:  # noqa: ARG002
        return (sent, sent)


class _Delaying(Stage[Delay]):
    def __init__(self, fault: Delay, rng: np.random.Generator) -> None:
        super().__init__(fault, rng)
        self._late = step_at(fault.size)
        self._held: deque[tuple[int, Sent]] = deque()

    def _released(self, step: int, on: bool) -> Iterable[Sent]:  # noqa: ARG002
        while self._held and self._held[0][0] <= step:
            yield self._held.popleft()[1]

    def _suffering(self, step: int, sent: Sent) -> Iterable[Sent]:
        if self._late == 0:
            return (sent,)
        self._held.append((step + self._late, sent))
        return ()


class _Holding(Stage[Burst | Reordered]):
    def __init__(self, fault: Burst | Reordered, rng: np.random.Generator) -> None:
        super().__init__(fault, rng)
        self._held: list[Sent] = []

    def _released(self, step: int, on: bool) -> Iterable[Sent]:  # noqa: ARG002
        if not on:
            yield from self._held
            self._held = []

    def _suffering(self, step: int, sent: Sent) -> Iterable[Sent]:  # noqa: ARG002
        self._held.append(sent)
        return ()


class _Swapping(_Holding):
    def _suffering(self, step: int, sent: Sent) -> Iterable[Sent]:
        if not self._held:
            return super()._suffering(step, sent)
        return (sent, self._held.pop())


_STAGES: tuple[dict[type[Fault], type[Stage[Any]]], ...] = (
    {**dict.fromkeys(SPOILERS, _Spoiling), Frozen: _Freezing, Wander: _Wandering},
    {
        Dropout: _Losing,
        Duplicates: _Doubling,
        Delay: _Delaying,
        Burst: _Holding,
        Reordered: _Swapping,
    },
)
"""The stages of a message: first what is measured, then when it is sent."""


class Delivery:
    """All stages between the sensors and the subscribers.

    Faults of the measured values come before those of the delivery; otherwise in the order of the
    faults.

    Args:
        faults: of any kind; those that are no stages are ignored.
        rngs: one for each.
    """

    def __init__(self, faults: Sequence[Fault], rngs: Sequence[np.random.Generator]) -> None:
        self._stages = [
            kinds[type(fault)](fault, rng)
            for kinds in _STAGES
            for fault, rng in zip(faults, rngs, strict=True)
            if type(fault) in kinds
        ]

    def sent(self, step: int, measured: Iterable[Sent]) -> list[Sent]:
        """Return what is sent in a step of what is measured in it and what was held back."""
        found = list(measured)
        for stage in self._stages:
            found = list(stage.passed(step, found))
        return found
