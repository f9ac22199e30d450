# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Counters of the encoders: their width, their resets, and their readings without wraps."""

from typing import NamedTuple

import numpy as np

from fnn_ekf_ros.core.arrays import FloatArray

NARROWEST, WIDEST = 8, 32
"""Widths of counters that are looked for [bits]."""
LARGEST_STEP = 0.25
"""Largest step between two readings that is no wrap, as a part of the counter's range."""
RESET_FACTOR = 20.0
"""Step from which on a counter was reset, as a multiple of the largest usual one."""


class Counter(NamedTuple):
    """A counter as it was read.

    Attributes:
        readings: `(n, 2)` times [s] and counts without wraps and resets.
        wraps: how often it wrapped.
        resets: how often it jumped otherwise.
        bits: its width, if it wrapped or exceeds the configured one; otherwise the configured one.
        exceeds: whether a reading lies outside of the configured range.
    """

    readings: FloatArray
    wraps: int
    resets: int
    bits: int
    exceeds: bool


def read_counter(readings: FloatArray, bits: int | None) -> Counter:
    """Return a counter's readings without wraps.

    Args:
        readings: `(n, 2)` times, rising [s], and readings as they came.
        bits: the configured width; None for positions in radians, which do not wrap.
    """
    values = readings[:, 1]
    steps = np.diff(values)
    if bits is None:
        kept, resets = _without_resets(steps)
        return Counter(_summed(readings, kept), 0, resets, 0, exceeds=False)
    width = _width(values, steps) or bits
    exceeds = bool(values.max() >= 2.0**bits or values.min() < -(2.0 ** (bits - 1)))
    if exceeds and width == bits:
        width = WIDEST
    span = 2.0**width
    wrapped = np.abs(steps) > (1.0 - LARGEST_STEP) * span
    steps = np.where(wrapped, steps - np.sign(steps) * span, steps)
    kept, resets = _without_resets(steps)
    return Counter(_summed(readings, kept), int(wrapped.sum()), resets, width, exceeds)


def _width(values: FloatArray, steps: FloatArray) -> int | None:
    """Return the width that explains the large steps: their size and the range of the readings."""
    usual = float(np.quantile(np.abs(steps), 0.95)) + 1.0 if len(steps) else 1.0
    large = np.abs(steps)[np.abs(steps) > RESET_FACTOR * usual]
    for bits in range(NARROWEST, WIDEST + 1):
        span = 2.0**bits
        if len(large) and np.all(np.abs(large - span) <= max(3.0 * usual, 2.0)):
            signed = values.min() >= -span / 2 and values.max() < span / 2
            unsigned = values.min() >= 0.0 and values.max() < span
            if signed or unsigned:
                return bits
    return None


def _without_resets(steps: FloatArray) -> tuple[FloatArray, int]:
    """Return steps with 0 in place of those that are no motion, and the number of these."""
    moved = np.abs(steps[steps != 0.0])
    if len(moved) == 0:
        return steps, 0
    jumps = np.abs(steps) > RESET_FACTOR * float(np.quantile(moved, 0.9)) + 1.0
    return np.where(jumps, 0.0, steps), int(jumps.sum())


def _summed(readings: FloatArray, steps: FloatArray) -> FloatArray:
    counts = np.concatenate([[0.0], np.cumsum(steps)])
    return np.stack([readings[:, 0], counts], axis=-1)
