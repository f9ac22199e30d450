# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The travel of both wheels as functions of time, in counts as they came."""

from typing import NamedTuple

import numpy as np

from fnn_ekf_ros.core.arrays import BoolArray, FloatArray

FINEST_STEP_S = 0.02
"""Smallest step of the common time grid [s]: no wheel's speed changes much within it."""
LONGEST_HOLE_S = 1.5
"""Time without readings of a wheel after which its motion is unknown [s], unless that is usual."""


class WheelTravel(NamedTuple):
    """Travel of both wheels.

    Attributes:
        times: `(n,)` of the grid, rising [s].
        counts: `(n, 2)` unwrapped counts of left and right since the start [counts or rad].
        holes: `(n,)` how many holes there were up to each time.
    """

    times: FloatArray
    counts: FloatArray
    holes: FloatArray

    def at(self, times: FloatArray) -> FloatArray:
        """Return the counts `(..., 2)` at instants, linear in between, held beyond the ends."""
        return np.stack(
            [np.interp(times, self.times, self.counts[:, wheel]) for wheel in (0, 1)], axis=-1
        )

    def mean_and_half_difference(self, times: FloatArray) -> FloatArray:
        """Return s = (N_l + N_r) / 2 and d = (N_r - N_l) / 2 `(..., 2)` at instants [counts]."""
        left, right = (np.interp(times, self.times, self.counts[:, wheel]) for wheel in (0, 1))
        return np.stack([0.5 * (left + right), 0.5 * (right - left)], axis=-1)

    def breaks(self, times: FloatArray) -> BoolArray:
        """Return for each instant whether a hole lies between it and the one before."""
        before = np.interp(times, self.times, self.holes)
        return np.diff(before, prepend=before[:1]) > 0.0

    def covers(self, times: FloatArray) -> BoolArray:
        """Return which instants the readings of both wheels cover."""
        return np.asarray((times >= self.times[0]) & (times <= self.times[-1]))


def usual_interval(left: FloatArray, right: FloatArray) -> float:
    """Return the usual time between two readings of a wheel, of the slower one [s].

    Args:
        left: `(n,)` stamps of the left wheel, rising [s].
        right: `(k,)` of the right one.
    """
    return max(float(np.median(np.diff(stamps))) for stamps in (left, right))


def wheel_travel(left: FloatArray, right: FloatArray) -> WheelTravel:
    """Return the travel of two wheels.

    Args:
        left: `(n, 2)` times [s] and unwrapped counts of the left wheel.
        right: the same of the right one.
    """
    begin, end = max(left[0, 0], right[0, 0]), min(left[-1, 0], right[-1, 0])
    times = np.unique(np.concatenate([left[:, 0], right[:, 0]]))
    times = times[(times >= begin) & (times <= end)]
    if len(times) > 1 and len(times) * FINEST_STEP_S > times[-1] - times[0]:
        kept = np.unique(np.floor((times - times[0]) / FINEST_STEP_S), return_index=True)[1]
        times = times[kept]
    counts = np.stack([np.interp(times, w[:, 0], w[:, 1]) for w in (left, right)], axis=-1)
    holes = np.zeros(len(times))
    for wheel in (left, right):
        gaps = np.diff(wheel[:, 0])
        longest = max(LONGEST_HOLE_S, 3.0 * float(np.quantile(gaps, 0.99)) if len(gaps) else 0.0)
        ends = wheel[1:][gaps > longest, 0]
        holes += np.searchsorted(ends, times, side="right")
    return WheelTravel(times, counts - counts[0], holes)
