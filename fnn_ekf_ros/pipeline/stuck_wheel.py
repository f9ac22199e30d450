"""A wheel whose counter stands still although the wheel turns.

A robot that pivots about one wheel is no fault: that wheel's counts stand still, and the robot
turns as both wheels say. If the counter is stuck the wheels say a turn that the robot does not
make, and compass and fixes keep the filter from it. So the filter's own turn is held against the
wheels'.
"""

import math
from typing import NamedTuple

from fnn_ekf_ros.core.angles import wrap_angle
from fnn_ekf_ros.pipeline.events import STALE_NS, Wheel

SMALLEST_TURN = 0.5
"""So far the other wheel has to turn the robot about it, half the wheels' distance [rad]: less
says little against the noise of any compass."""
SIGMAS = 5.0
"""The contradiction has to be so many standard deviations of yaw and wheel noise: a right pair of
wheels is accused once in two million looks."""
SMALLEST_PART = 0.5
"""It has to be so large a part of the wheels' turn as well, because the noise may be set wrong: a
stuck wheel's turn is all wrong, and even a filter that follows it halfway shows that much."""


class Look(NamedTuple):
    """What is known at the end of a period.

    Attributes:
        stamp_ns: the period's end [ns].
        ways: of the left and the right wheel since counting began [m].
        yaw: the filter's [rad].
        yaw_variance: its variance [rad^2].
        turn_variance: what the wheels' noise adds to it in one period [rad^2].
    """

    stamp_ns: int
    ways: tuple[float, float]
    yaw: float
    yaw_variance: float
    turn_variance: float


class _Stand(NamedTuple):
    """A wheel that stands while the other one moves: since when, and the turn so far [rad]."""

    begin: Look
    turn: float = 0.0
    periods: int = 0


class StuckWheels:
    """Watches both wheels, a period at a time.

    Args:
        wheel_separation: distance between the wheels [m].
    """

    def __init__(self, wheel_separation: float) -> None:
        self._separation = wheel_separation
        self._last: Look | None = None
        self._stands: dict[Wheel, _Stand] = {}

    def forget(self) -> None:
        """Begin anew: the pose does not go on from where it was."""
        self._last = None
        self._stands.clear()

    def look(self, now: Look) -> None:
        """Take the next period in."""
        last, self._last = self._last, now
        if last is None:
            return
        for wheel in Wheel:
            other = Wheel(1 - wheel)
            if now.ways[wheel] != last.ways[wheel]:
                self._stands.pop(wheel, None)
                continue
            stand = self._stands.get(wheel)
            moved = now.ways[other] != last.ways[other]
            turned = float(wrap_angle(now.yaw - last.yaw))
            if stand is not None:
                self._stands[wheel] = stand._replace(
                    turn=stand.turn + turned, periods=stand.periods + moved
                )
            elif moved:
                self._stands[wheel] = _Stand(last, turned, 1)

    def accusation(self) -> str:
        """Return which wheel is stuck, and why; empty if none is."""
        if self._last is None:
            return ""
        for wheel, stand in self._stands.items():
            begin, now, other = stand.begin, self._last, Wheel(1 - wheel)
            way = now.ways[other] - begin.ways[other]
            turn = (way if wheel is Wheel.LEFT else -way) / self._separation
            duration_ns = now.stamp_ns - begin.stamp_ns
            if duration_ns < STALE_NS or abs(turn) < SMALLEST_TURN:
                continue
            std = math.sqrt(
                begin.yaw_variance + now.yaw_variance + stand.periods * begin.turn_variance
            )
            if abs(turn - stand.turn) > max(SIGMAS * std, SMALLEST_PART * abs(turn)):
                return (
                    f"{wheel.name.lower()} wheel stuck: unchanged for {duration_ns * 1e-9:.1f} s "
                    f"while the {other.name.lower()} one moved {way:.2f} m, but the robot turned "
                    f"{stand.turn:.2f} rad, not {turn:.2f} rad"
                )
        return ""
