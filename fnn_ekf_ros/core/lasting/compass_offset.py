# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The compass's witness: whether the compass is off by a constant, and by how much.

The witness is a filter whose yaw has an offset of unknown size, b_0, beside lasting errors of fixes
and yaw. It takes the readings as they come. The log odds of an offset of any size against one that
is usual,

    D = b_0^2 / 2 v - 1/2 log(sigma_0^2 / v),     v = P_b0 + .07^2

tell whether the offset is believed: from D > 4 for 10 s until D < 0. While it is believed all other
filters see z - b_0 with the variance R + P_b0. A compass that is turned while the robot drives
surprises the witness: the sum of its normalized innovations to one side, each less .7 (CUSUM, Page
1954), rises. From 9 on its offset is unknown again, and the other filters do without the compass
until the witness knows it.
"""

from typing import NamedTuple

import numpy as np

from fnn_ekf_ros.core.arrays import BoolArray, FloatArray
from fnn_ekf_ros.core.bank import Bank
from fnn_ekf_ros.core.lasting.augmented import Component
from fnn_ekf_ros.core.lasting.members import WITNESS, WITNESS_OFFSET_STD

USUAL_OFFSET_STD = 0.07
"""Standard deviation of the offset of a compass mounted with care [rad]: four degrees."""
BELIEVED_AT = 4.0
"""D from which on an offset is believed, if it lasts for `BELIEVED_AFTER_S` [nats]: odds of 55."""
BELIEVED_AFTER_S = 10.0
"""Time for which D has to be that large [s]: lasting yaw errors look like an offset for less."""
LIKELY_AT = 0.05
"""D from which on an offset may be the cause of what does not fit [nats]: it is as likely as none.
Before the first reading D is 0."""
GIVEN_UP_AT = 0.0
"""D below which an offset is no longer believed [nats]: both are then as likely."""
USUAL_SURPRISE = 0.7
"""Normalized innovation of the witness that is subtracted from each: noise of either sign and small
lasting errors do not add up."""
LARGEST_SURPRISE = 3.0
"""Largest normalized innovation that counts: one reading alone does not turn a compass."""
TURNED_AT = 9.0
"""Sum from which on the compass was turned, and its offset is unknown again: four readings in a row
that are off by three standard deviations to the same side. Where fix errors last it is divided by
the weight of the members for which they do not: such fixes are poor evidence of the yaw."""
SMALLEST_WEIGHT = 0.05
"""Smallest of these weights that counts: a compass that is turned for good is found."""
TURNED_AFTER_S = 2.0
"""Time that it takes at least [s]: a magnet that the robot passes does not turn the compass."""
KNOWN_STD = 0.3
"""Standard deviation of the offset below which it is known again after a surprise [rad]."""
_OFFSET = Component.YAW_OFFSET


class CompassOffset(NamedTuple):
    """What is believed of the compass's offset.

    Attributes:
        believed: `(*batch)` whether it is believed.
        likely_s: `(*batch)` time for which it has been likely [s].
        doubted: `(*batch)` whether the compass was turned and its offset is not known yet.
        surprise: `(2, *batch)` sums of normalized innovations to the left and to the right.
        surprised_s: `(*batch)` time for which one of them has been more than 0 [s].
    """

    believed: BoolArray
    likely_s: FloatArray
    doubted: BoolArray
    surprise: FloatArray
    surprised_s: FloatArray


def start_offset(batch: tuple[int, ...]) -> CompassOffset:
    """Return the belief before the first reading."""
    none, no = np.zeros(batch), np.zeros(batch, dtype=np.bool_)
    return CompassOffset(
        believed=no, likely_s=none, doubted=no, surprise=np.zeros((2, *batch)), surprised_s=none
    )


def offset_of(bank: Bank) -> tuple[FloatArray, FloatArray]:
    """Return the witness's offset [rad] and its variance [rad^2], each `(*batch)`."""
    return bank.mean[_OFFSET, WITNESS], bank.covariance[_OFFSET, _OFFSET, WITNESS]


def log_odds(bank: Bank) -> FloatArray:
    """Return D, `(*batch)` [nats]."""
    offset, variance = offset_of(bank)
    v = variance + USUAL_OFFSET_STD**2
    return np.asarray(0.5 * offset * offset / v - 0.5 * np.log(WITNESS_OFFSET_STD**2 / v))


def is_likely(offset: CompassOffset, bank: Bank) -> BoolArray:
    """Return where an offset is likely, `(*batch)`, but not believed yet."""
    return np.asarray((log_odds(bank) > LIKELY_AT) & ~offset.believed)


def later(offset: CompassOffset, duration_s: float) -> CompassOffset:
    """Return the belief after a duration [s], before the readings at its end."""
    return offset._replace(surprised_s=offset.surprised_s + duration_s)


def after_compass(
    offset: CompassOffset,
    bank: Bank,
    normalized: FloatArray,
    read: BoolArray,
    elapsed: float,
    fixes_last: FloatArray,
) -> tuple[CompassOffset, Bank]:
    """Return the belief and the filters after a compass reading.

    Args:
        offset: the belief before it.
        bank: all filters after it; not changed.
        normalized: `(*batch)` innovation of the witness over its standard deviation.
        read: `(*batch)` whether there is a reading.
        elapsed: since the instant before [nominal periods]; more than 1 counts as 1.
        fixes_last: `(*batch)` weight of the members whose fix errors last.
    """
    limited = np.minimum(np.maximum(normalized, -LARGEST_SURPRISE), LARGEST_SURPRISE)
    gained = np.empty(offset.surprise.shape)
    gained[0], gained[1] = limited, -limited
    gained = min(elapsed, 1.0) * (gained - USUAL_SURPRISE)
    surprise = np.where(read, np.maximum(offset.surprise + gained, 0.0), offset.surprise)
    largest = surprise.max(axis=0)
    surprised_s = np.where(largest > 0.0, offset.surprised_s, 0.0)
    if not (largest > TURNED_AT).any():
        return offset._replace(surprise=surprise, surprised_s=surprised_s), bank
    needed = TURNED_AT / np.maximum(1.0 - fixes_last, SMALLEST_WEIGHT)
    turned = read & (largest > needed) & (surprised_s >= TURNED_AFTER_S)
    after = offset._replace(
        surprise=np.where(turned, 0.0, surprise),
        surprised_s=surprised_s,
        doubted=offset.doubted | turned,
    )
    return after, _with_unknown_offset(bank, turned) if turned.any() else bank


def _with_unknown_offset(bank: Bank, some: BoolArray) -> Bank:
    """Return the filters; the witness's offset is unknown where `some`, `(*batch)`."""
    mean, covariance = bank.mean.copy(), bank.covariance.copy()
    P = covariance[:, :, WITNESS]
    P[_OFFSET] = np.where(some, 0.0, P[_OFFSET])
    P[:, _OFFSET] = np.where(some, 0.0, P[:, _OFFSET])
    P[_OFFSET, _OFFSET] = np.where(some, WITNESS_OFFSET_STD**2, P[_OFFSET, _OFFSET])
    return Bank(mean, covariance)


def reconsidered(
    offset: CompassOffset, bank: Bank, duration_s: float
) -> tuple[CompassOffset, BoolArray]:
    """Return the belief after readings, and where it has changed, `(*batch)`.

    Where it has changed all other filters have to start again from the witness's pose.

    Args:
        offset: the belief before.
        bank: all filters after the readings.
        duration_s: since the readings before [s].
    """
    D = log_odds(bank)
    likely = D > BELIEVED_AT
    if not (likely | offset.believed | offset.doubted | (offset.likely_s > 0.0)).any():
        return offset, likely
    _, variance = offset_of(bank)
    likely_s = np.where(likely, offset.likely_s + duration_s, 0.0)
    believed = np.where(offset.believed, D >= GIVEN_UP_AT, likely_s >= BELIEVED_AFTER_S)
    decided = offset.doubted & (variance < KNOWN_STD**2) & (believed | (D < GIVEN_UP_AT))
    changed = (believed != offset.believed) | decided
    after = offset._replace(believed=believed, likely_s=likely_s, doubted=offset.doubted & ~decided)
    return after, changed
