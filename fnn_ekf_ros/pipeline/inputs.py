"""The buffers of what has arrived, and what one period finds in them."""

from bisect import bisect_left, bisect_right
from typing import Generic, NamedTuple, TypeVar

import numpy as np

from fnn_ekf_ros.core.arrays import MEASUREMENT_SIZE, FloatArray, Row
from fnn_ekf_ros.core.filter import StepInput
from fnn_ekf_ros.core.odometry import control_from_counts
from fnn_ekf_ros.parameters.localizer import LocalizerParameters
from fnn_ekf_ros.pipeline.configure import measurement_noise, wheel_geometry
from fnn_ekf_ros.pipeline.events import (
    CompassYaw,
    Event,
    PoseFix,
    PoseReset,
    Wheel,
    WheelCount,
)
from fnn_ekf_ros.pipeline.wheels import WheelTrack

EventT = TypeVar("EventT", CompassYaw, PoseFix, PoseReset)


class Counts(NamedTuple):
    """Counts of both wheels at one instant, as far as the wheels are known."""

    left: float
    right: float


class PeriodInputs(NamedTuple):
    """What the buffers hold for one period.

    Attributes:
        step: for the filter.
        counts: of the wheels at the period's end; the next period begins with them.
        reset: the last pose that was set in the period, if any.
        control_since_reset: `(2,)` [dS, dtheta] from then to the period's end (m, rad).
        wheels_known: whether both wheels had spoken by its begin.
    """

    step: StepInput
    counts: Counts
    reset: PoseReset | None
    control_since_reset: FloatArray
    wheels_known: bool


class _Queue(Generic[EventT]):
    """Events of one kind in the order of their stamps; of equal stamps the last to come wins."""

    def __init__(self) -> None:
        self._stamps: list[int] = []
        self._events: list[EventT] = []

    def add(self, event: EventT) -> None:
        place = bisect_right(self._stamps, event.stamp_ns)
        self._stamps.insert(place, event.stamp_ns)
        self._events.insert(place, event)

    def latest(self, after_ns: int, until_ns: int) -> EventT | None:
        place = bisect_right(self._stamps, until_ns)
        return self._events[place - 1] if place and self._stamps[place - 1] > after_ns else None

    def forget_before(self, stamp_ns: int) -> None:
        first = bisect_left(self._stamps, stamp_ns)
        del self._stamps[:first], self._events[:first]


class InputBuffer:
    """Everything that arrived and may still be needed.

    Args:
        parameters: geometry, encoders, and which rows of the laser are used.
    """

    def __init__(self, parameters: LocalizerParameters) -> None:
        self._parameters = parameters
        self._geometry = wheel_geometry(parameters)
        self._measurement_noise = measurement_noise(parameters)
        modulus = None
        if parameters.encoder_source == "ticks":
            modulus = 2**parameters.encoder_bits
        self._wheels = {wheel: WheelTrack(modulus) for wheel in Wheel}
        self._sign = {
            Wheel.LEFT: -1 if parameters.left_inverted else 1,
            Wheel.RIGHT: -1 if parameters.right_inverted else 1,
        }
        self._compass: _Queue[CompassYaw] = _Queue()
        self._fixes: _Queue[PoseFix] = _Queue()
        self._resets: _Queue[PoseReset] = _Queue()

    def add(self, event: Event) -> int:
        """Take an event in.

        Returns:
            From when on the past looks different [ns].
        """
        if isinstance(event, WheelCount):
            return self._wheels[event.wheel].add(
                event.stamp_ns, self._sign[event.wheel] * event.reading
            )
        if isinstance(event, CompassYaw):
            self._compass.add(event)
        elif isinstance(event, PoseFix):
            self._fixes.add(event)
        else:
            self._resets.add(event)
        return event.stamp_ns

    def wheels_known_until_ns(self) -> int | None:
        """Return until when both wheels are known [ns]; None if one never spoke."""
        left, right = (self._wheels[wheel].last_stamp_ns for wheel in Wheel)
        return None if left is None or right is None else min(left, right)

    def wheels_known_at(self, stamp_ns: int) -> bool:
        """Return whether both wheels had spoken by an instant."""
        firsts = [self._wheels[wheel].first_stamp_ns for wheel in Wheel]
        return all(first is not None and first <= stamp_ns for first in firsts)

    def counts_at(self, stamp_ns: int) -> Counts:
        """Return the counts at an instant."""
        return Counts(*(self._wheels[wheel].at(stamp_ns) for wheel in Wheel))

    def period(self, begin_ns: int, end_ns: int, counts_at_begin: Counts) -> PeriodInputs:
        """Return what the time (begin, end] holds.

        Args:
            begin_ns: begin of the period, not part of it [ns].
            end_ns: its end [ns].
            counts_at_begin: what the period before ended with; what the wheels are known to
                have done before by now, but was not known then, falls into this period.
        """

        def control(stamp_ns: int) -> FloatArray:
            counts = self.counts_at(stamp_ns)
            return control_from_counts(
                self._geometry,
                counts.left - counts_at_begin.left,
                counts.right - counts_at_begin.right,
            )

        measurement = np.zeros(MEASUREMENT_SIZE)
        available = np.zeros(MEASUREMENT_SIZE, dtype=np.bool_)
        whole = control(end_ns)
        at = np.tile(whole, (MEASUREMENT_SIZE, 1))
        covariance = None

        compass = self._compass.latest(begin_ns, end_ns)
        if compass is not None:
            measurement[Row.COMPASS_YAW] = compass.yaw + self._parameters.compass_offset
            available[Row.COMPASS_YAW] = True
            at[Row.COMPASS_YAW] = control(compass.stamp_ns)
        fix = self._fixes.latest(begin_ns, end_ns)
        if fix is not None:
            rows = [Row.X, Row.Y]
            if self._parameters.lrf_use_yaw:
                rows.append(Row.LRF_YAW)
            measurement[rows] = fix.pose[: len(rows)]
            available[rows] = True
            at[rows] = control(fix.stamp_ns)
            if self._parameters.lrf_use_message_covariance:
                covariance = np.diag(self._measurement_noise)
                covariance[np.ix_(rows, rows)] = fix.covariance[: len(rows), : len(rows)]
        reset = self._resets.latest(begin_ns, end_ns)
        return PeriodInputs(
            StepInput(whole, measurement, available, at, covariance),
            self.counts_at(end_ns),
            reset,
            whole - control(reset.stamp_ns) if reset is not None else np.zeros(2),
            self.wheels_known_at(begin_ns),
        )

    def forget_before(self, stamp_ns: int) -> None:
        """Drop what no period that ends after `stamp_ns` needs."""
        for track in self._wheels.values():
            track.forget_before(stamp_ns)
        for queue in (self._compass, self._fixes, self._resets):
            queue.forget_before(stamp_ns)
