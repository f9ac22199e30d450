# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The buffers of the inputs, and the inputs of one period."""

from bisect import bisect_left, bisect_right
from collections.abc import Callable
from typing import Generic, NamedTuple, TypeVar

import numpy as np

from fnn_ekf_ros.core.arrays import FloatArray
from fnn_ekf_ros.core.odometry import control_from_counts
from fnn_ekf_ros.core.results import Epoch
from fnn_ekf_ros.parameters.localizer import LocalizerParameters
from fnn_ekf_ros.timeline.epochs import Cutter, instants, thinned
from fnn_ekf_ros.timeline.events import (
    CompassYaw,
    Event,
    PoseFix,
    PoseReset,
    Wheel,
    WheelCount,
)
from fnn_ekf_ros.timeline.filter_model import wheel_geometry
from fnn_ekf_ros.timeline.wheels import MOST_KEPT, BufferChange, UnwrappedWheel

MOST_AT_ONCE = 100
"""Largest number of readings of one sensor with the same stamp that are kept, those of the smallest
numbers: more than there are sources of fixes, and few enough to cost nothing."""
EventT = TypeVar("EventT", CompassYaw, PoseFix, PoseReset)
"""Event of one kind."""


class Measured(NamedTuple):
    """The last accepted measurements of the pose.

    Attributes:
        position_ns: end of the last period in which a position was accepted [ns].
        yaw_ns: end of the last period in which a yaw was accepted [ns].
    """

    position_ns: int
    yaw_ns: int


class Counts(NamedTuple):
    """Counts of both wheels at one instant, as far as they are known; None before the first."""

    left: float | None = None
    right: float | None = None


class LeftOut(NamedTuple):
    """Readings of a period that were too many to be used, by sensor."""

    compass: int = 0
    lrf_pose: int = 0


class PeriodInputs(NamedTuple):
    """The inputs of one period.

    Attributes:
        epochs: up to the end, or to the pose that was set.
        epochs_after_reset: those after the pose that was set; none without one.
        control: `(2,)` [dS, dtheta] of the whole period (m, rad).
        counts: of the wheels at the period's end, with which the next period begins.
        reset: the last pose that was set in the period, if any.
        wheels_known: whether both wheels had sent a reading by its begin.
        wheels_known_at_end: whether both had by its end.
        left_out: readings that were too many to be used.
    """

    epochs: tuple[Epoch, ...]
    epochs_after_reset: tuple[Epoch, ...]
    control: FloatArray
    counts: Counts
    reset: PoseReset | None
    wheels_known: bool
    wheels_known_at_end: bool
    left_out: LeftOut


class _Queue(Generic[EventT]):
    """Events of one kind in the order of their stamps.

    Args:
        content: the numbers of a measurement, which order those with equal stamps, so that the
            order of arrival does not matter; None for commands, of which the last one counts.
    """

    def __init__(self, content: Callable[[EventT], tuple[float, ...]] | None = None) -> None:
        self._content: Callable[[EventT], tuple[float, ...]] | None = content
        self._stamps: list[int] = []
        self._contents: list[tuple[float, ...]] = []
        self._events: list[EventT] = []

    def add(self, event: EventT) -> BufferChange:
        content = () if self._content is None else self._content(event)
        last = place = len(self._stamps)
        left_out = 0
        if place and event.stamp_ns <= self._stamps[-1]:  # seldom
            first = bisect_left(self._stamps, event.stamp_ns)
            last = bisect_right(self._stamps, event.stamp_ns, first)
            place = bisect_left(self._contents, content, first, last)
            if place < last and self._contents[place] == content:
                if self._content is None:
                    self._events[place] = event
                    return BufferChange(event.stamp_ns)
                return BufferChange(None)
            if last - first >= MOST_AT_ONCE:
                if place == last:
                    return BufferChange(None, left_out=1)
                self._delete(slice(last - 1, last))
                last, left_out = last - 1, 1
        self._stamps.insert(place, event.stamp_ns)
        self._contents.insert(place, content)
        self._events.insert(place, event)
        out_of_order = last < len(self._stamps) - 1
        if len(self._stamps) > MOST_KEPT:
            before = len(self._stamps)
            self._delete(slice(1, -1, 2))
            left_out += before - len(self._stamps)
        return BufferChange(event.stamp_ns, out_of_order, left_out=left_out)

    def between(self, after_ns: int, until_ns: int) -> list[EventT]:
        first = bisect_right(self._stamps, after_ns)
        return self._events[first : bisect_right(self._stamps, until_ns, first)]

    def forget_before(self, stamp_ns: int) -> None:
        first = bisect_left(self._stamps, stamp_ns)
        self._delete(slice(first))

    def move(self, by_ns: int) -> None:
        self._stamps = [stamp_ns + by_ns for stamp_ns in self._stamps]
        self._events = [
            event._replace(stamp_ns=stamp_ns)
            for event, stamp_ns in zip(self._events, self._stamps, strict=True)
        ]

    def _delete(self, which: slice) -> None:
        del self._stamps[which], self._contents[which], self._events[which]


class InputBuffer:
    """All inputs that may still be needed.

    Args:
        parameters: geometry, encoders, and which rows of the laser are used.
    """

    def __init__(self, parameters: LocalizerParameters) -> None:
        self._parameters = parameters
        self._geometry = wheel_geometry(parameters)
        self._cutter = Cutter(parameters)
        ticks = parameters.encoder_source == "ticks"
        self._wheels = {
            wheel: UnwrappedWheel(
                2**parameters.encoder_bits if ticks else None,
                stamped=not ticks,
                fastest=parameters.max_wheel_speed / self._geometry.meters_per_count,
                resolution=1.0 if ticks else 0.0,
            )
            for wheel in Wheel
        }
        self._sign = {
            Wheel.LEFT: -1 if parameters.left_inverted else 1,
            Wheel.RIGHT: -1 if parameters.right_inverted else 1,
        }
        self._compass: _Queue[CompassYaw] = _Queue(lambda event: (event.yaw,))
        self._fixes: _Queue[PoseFix] = _Queue(_pose_content)
        self._resets: _Queue[PoseReset] = _Queue()

    def add(self, event: Event) -> BufferChange:
        """Take an event in."""
        if isinstance(event, WheelCount):
            stamp_ns, wheel, reading = event
            return self._wheels[wheel].add(stamp_ns, self._sign[wheel] * reading)
        if isinstance(event, CompassYaw):
            return self._compass.add(event)
        if isinstance(event, PoseFix):
            return self._fixes.add(event)
        return self._resets.add(event)

    def wheels_known_until_ns(self) -> int | None:
        """Return until when both wheels are known [ns]; None if one has sent no reading."""
        left, right = (self._wheels[wheel].last_stamp_ns for wheel in Wheel)
        return None if left is None or right is None else min(left, right)

    def wheels_known_at(self, stamp_ns: int) -> bool:
        """Return whether both wheels had sent a reading by an instant."""
        since_ns = self._wheels_known_since_ns()
        return since_ns is not None and since_ns <= stamp_ns

    def _wheels_known_since_ns(self) -> int | None:
        left, right = (self._wheels[wheel].first_stamp_ns for wheel in Wheel)
        return None if left is None or right is None else max(left, right)

    def counts_at(self, stamp_ns: int) -> Counts:
        """Return the counts at an instant."""
        return Counts(*(self._count_at(wheel, stamp_ns) for wheel in Wheel))

    def _count_at(self, wheel: Wheel, stamp_ns: int) -> float | None:
        first_ns = self._wheels[wheel].first_stamp_ns
        if first_ns is None or stamp_ns < first_ns:
            return None
        return self._wheels[wheel].at(stamp_ns)

    def counts_to_go_on_from(self, stamp_ns: int, counts: Counts, measured: Measured) -> Counts:
        """Return the counts with which the period from an instant on begins.

        Motion before the instant that was not known then falls into this period. After a silence
        longer than `history` a fix or the compass may have measured that motion meanwhile:
        the distance is counted only where no position was measured since the wheels fell silent,
        and the rotation where no yaw was.

        Args:
            stamp_ns: the period's begin [ns].
            counts: what the period before ended with.
            measured: when a position and when a yaw was accepted last.
        """
        known = self.counts_at(stamp_ns)
        heard_ns = [self._wheels[wheel].heard_ns(stamp_ns) or stamp_ns for wheel in Wheel]
        if (
            known == counts
            or known.left is None
            or known.right is None
            or counts.left is None
            or counts.right is None
        ):
            return counts
        left, right = known.left - counts.left, known.right - counts.right
        distance = 0.0 if measured.position_ns > min(heard_ns) else 0.5 * (left + right)
        rotation = 0.0 if measured.yaw_ns > min(heard_ns) else 0.5 * (right - left)
        return Counts(known.left - distance + rotation, known.right - distance - rotation)

    def period(self, begin_ns: int, end_ns: int, counts_at_begin: Counts) -> PeriodInputs:
        """Return the inputs of the time (begin, end].

        Args:
            begin_ns: begin of the period, not part of it [ns].
            end_ns: its end [ns].
            counts_at_begin: with which the period before ended; motion before the begin that was
                not known then falls into this period. There is no motion before both wheels have
                sent a reading: one alone would look like a rotation.
        """
        left, right = counts_at_begin
        since_ns = begin_ns
        if left is None or right is None:
            known_ns = self._wheels_known_since_ns()
            since_ns = end_ns if known_ns is None else min(max(known_ns, begin_ns), end_ns)
            left, right = (self._wheels[wheel].at(since_ns) for wheel in Wheel)

        def control(stamp_ns: int) -> FloatArray:
            stamp_ns = max(stamp_ns, since_ns)
            return control_from_counts(
                self._geometry,
                self._wheels[Wheel.LEFT].at(stamp_ns) - left,
                self._wheels[Wheel.RIGHT].at(stamp_ns) - right,
            )

        compass = self._compass.between(begin_ns, end_ns)
        fixes = self._fixes.between(begin_ns, end_ns)
        period_s = self._parameters.period
        compass_used, fixes_used = thinned(compass, period_s), thinned(fixes, period_s)
        used = compass_used, fixes_used
        resets = self._resets.between(begin_ns, end_ns)
        reset = resets[-1] if resets else None
        until_ns = end_ns if reset is None else reset.stamp_ns
        counts = [sum(each.stamp_ns <= until_ns for each in readings) for readings in used]
        before = instants(*(all_of[:n] for all_of, n in zip(used, counts, strict=True)))
        after = instants(*(all_of[n:] for all_of, n in zip(used, counts, strict=True)))
        before_reset = control(until_ns)
        cut = self._cutter.epochs
        return PeriodInputs(
            epochs=tuple(cut(begin_ns, until_ns, before, control, np.zeros(2))),
            epochs_after_reset=tuple(cut(until_ns, end_ns, after, control, before_reset)),
            control=control(end_ns),
            counts=self.counts_at(end_ns),
            reset=reset,
            wheels_known=self.wheels_known_at(begin_ns),
            wheels_known_at_end=self.wheels_known_at(end_ns),
            left_out=LeftOut(len(compass) - len(compass_used), len(fixes) - len(fixes_used)),
        )

    def readings_between(self, after_ns: int, until_ns: int) -> int:
        """Return the number of readings of compass and fixes in a time [ns]."""
        sensors = self._compass, self._fixes
        return sum(len(queue.between(after_ns, until_ns)) for queue in sensors)

    def forget_before(self, stamp_ns: int) -> None:
        """Drop the inputs that no period which ends after `stamp_ns` needs."""
        for track in self._wheels.values():
            track.forget_before(stamp_ns)
        for queue in (self._compass, self._fixes, self._resets):
            queue.forget_before(stamp_ns)

    def move(self, by_ns: int) -> None:
        """Move all inputs in time [ns], as the clock was set."""
        for track in self._wheels.values():
            track.move(by_ns)
        for queue in (self._compass, self._fixes, self._resets):
            queue.move(by_ns)


def _pose_content(event: PoseFix) -> tuple[float, ...]:
    return (*event.pose.tolist(), *event.covariance.ravel().tolist())
