# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""A wheel whose counter stands still although the wheel turns.

A robot that pivots about one wheel is no fault: the counts of that wheel do not change, and the
robot rotates as both wheels say. If the counter is stuck, the wheels report a rotation that the
robot does not make, and compass and fixes keep the filter from it. The rotation of the filter is
therefore compared with that of the wheels.
"""

import math
from typing import NamedTuple

from fnn_ekf_ros.core.angles import wrap_angle
from fnn_ekf_ros.diagnostics.messages import EncoderMessage, fill
from fnn_ekf_ros.diagnostics.noise_words import Values
from fnn_ekf_ros.diagnostics.wheel_distances import WheelDistances
from fnn_ekf_ros.timeline.events import STALE_NS, Wheel

SMALLEST_ROTATION = 0.5
"""Rotation about the standing wheel that the other one has to report [rad]: its distance is half
that between the wheels then; less says little against the noise of any compass."""
SIGMAS = 5.0
"""Least difference of the rotations of wheels and filter, in standard deviations of yaw and wheel
noise: a right pair of wheels exceeds it once in two million periods."""
SMALLEST_PART = 0.5
"""Least difference as a part of the wheels' rotation, because the noise may be set wrong: all of a
stuck wheel's rotation is wrong, and even a filter that follows it halfway shows that much."""


class WheelObservation(NamedTuple):
    """Observation of both wheels and of the yaw at the end of a period.

    Attributes:
        stamp_ns: the period's end [ns].
        wheels: distances of both wheels.
        yaw: of the filter [rad].
        yaw_variance: its variance [rad^2].
        rotation_variance: variance that the wheels' noise adds to it in one period [rad^2].
    """

    stamp_ns: int
    wheels: WheelDistances
    yaw: float
    yaw_variance: float
    rotation_variance: float


class _Standstill(NamedTuple):
    """A wheel that stands while the other one moves.

    Attributes:
        begin: the period's end since when it stands.
        rotation: of the filter since then [rad].
        periods: in which the other wheel moved.
    """

    begin: WheelObservation
    rotation: float = 0.0
    periods: int = 0


class StuckWheel(NamedTuple):
    """A wheel whose counter is stuck.

    Attributes:
        wheel: which.
        duration_ns: for how long its count is constant [ns].
        distance: of the other wheel meanwhile [m].
        wheels_rotation: that both wheels report [rad].
        rotation: of the filter [rad].
    """

    wheel: Wheel
    duration_ns: int
    distance: float
    wheels_rotation: float
    rotation: float

    def message(self) -> str:
        """Return what diagnostics say of it."""
        return fill(EncoderMessage.WHEEL_STUCK, wheel=self.wheel.name.lower())

    def values(self) -> Values:
        """Return the numbers behind the message."""
        return (
            ("count constant for [s]", f"{self.duration_ns * 1e-9:.1f}"),
            ("distance of the other wheel meanwhile [m]", f"{self.distance:.2f}"),
            ("rotation by the wheels meanwhile [rad]", f"{self.wheels_rotation:.2f}"),
            ("rotation of the filter meanwhile [rad]", f"{self.rotation:.2f}"),
        )


class StuckWheels:
    """Observes both wheels, a period at a time.

    Args:
        wheel_separation: distance between the wheels [m].
    """

    def __init__(self, wheel_separation: float) -> None:
        self._separation = wheel_separation
        self._last: WheelObservation | None = None
        self._standing: dict[Wheel, _Standstill] = {}

    def forget(self) -> None:
        """Begin anew: the pose does not continue from where it was."""
        self._last = None
        self._standing.clear()

    def observe(self, now: WheelObservation) -> None:
        """Take the next period in."""
        last, self._last = self._last, now
        if last is None:
            return
        for wheel in Wheel:
            other = Wheel(1 - wheel)
            if now.wheels[wheel] != last.wheels[wheel]:
                self._standing.pop(wheel, None)
                continue
            standing = self._standing.get(wheel)
            moved = now.wheels[other] != last.wheels[other]
            rotation = float(wrap_angle(now.yaw - last.yaw))
            if standing is not None:
                self._standing[wheel] = standing._replace(
                    rotation=standing.rotation + rotation, periods=standing.periods + moved
                )
            elif moved:
                self._standing[wheel] = _Standstill(last, rotation, 1)

    def fault(self) -> StuckWheel | None:
        """Return the wheel that is stuck; None if none is."""
        if self._last is None:
            return None
        for wheel, standing in self._standing.items():
            begin, now = standing.begin, self._last
            driven = now.wheels.since(begin.wheels)
            distance = driven[Wheel(1 - wheel)]
            by_wheels = (distance if wheel is Wheel.LEFT else -distance) / self._separation
            duration_ns = now.stamp_ns - begin.stamp_ns
            if duration_ns < STALE_NS or abs(by_wheels) < SMALLEST_ROTATION:
                continue
            std = math.sqrt(
                begin.yaw_variance + now.yaw_variance + standing.periods * begin.rotation_variance
            )
            difference = abs(by_wheels - standing.rotation)
            if difference > max(SIGMAS * std, SMALLEST_PART * abs(by_wheels)):
                return StuckWheel(
                    wheel=wheel,
                    duration_ns=duration_ns,
                    distance=distance,
                    wheels_rotation=by_wheels,
                    rotation=standing.rotation,
                )
        return None
