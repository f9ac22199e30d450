# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Times at which a sensor of the fake robot is read."""

from fractions import Fraction

from fnn_ekf_ros.simulation.delivery import STEP_NS

WHOLE_STEPS_TOLERANCE = Fraction(2, 10**5)
"""Largest relative difference of an interval from a whole number of steps that is taken as that
number: 2.6667 Hz is a reading every 375 ms, and never drifts from it. Five digits of a rate are
that exact."""


class ReadingTimes:
    """The times phase + k / rate of ROS time, k any integer, without rounding errors.

    Args:
        rate: readings per second, the decimal number that is written [Hz].
        phase_ns: see above [ns].
    """

    def __init__(self, rate: float, phase_ns: int = 0) -> None:
        interval = 10**9 / Fraction(repr(rate))
        whole = round(interval / STEP_NS) * STEP_NS
        if abs(interval - whole) <= WHOLE_STEPS_TOLERANCE * interval:
            interval = Fraction(whole)
        self._numerator, self._denominator = interval.as_integer_ratio()
        self._phase_ns = phase_ns

    def within(self, after_ns: int, until_ns: int) -> list[int]:
        """Return the times in `(after_ns, until_ns]`, each rounded up to a nanosecond [ns]."""
        first, end = self._last_index(after_ns) + 1, self._last_index(until_ns) + 1
        return [
            self._phase_ns - (-index * self._numerator // self._denominator)
            for index in range(first, end)
        ]

    def _last_index(self, time_ns: int) -> int:
        return (time_ns - self._phase_ns) * self._denominator // self._numerator
