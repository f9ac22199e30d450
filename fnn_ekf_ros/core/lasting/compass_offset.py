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
1954), rises. Slipping wheels or a stuck one surprise it as well; the fixes tell them apart. The
advocate of the compass, a filter that takes the wheels for wrong, follows the compass. While the
sum is not 0 the fixes' log likelihood ratio of witness to advocate is added up. From 9 on, and
unless the fixes take its side, the compass was turned: its offset is unknown again, and the other
filters do without the compass until the witness knows it: until its readings have agreed for a
while. A compass that says anything makes the offset unknown with each reading that disagrees.
A witness that is sure of a wrong offset is replaced by its challenger (`challenger`).
"""

import math
from typing import NamedTuple

import numpy as np

from fnn_ekf_ros.core.angles import wrap_angle
from fnn_ekf_ros.core.arrays import BoolArray, FloatArray
from fnn_ekf_ros.core.bank import Bank
from fnn_ekf_ros.core.evidence import log_likelihood
from fnn_ekf_ros.core.lasting.augmented import Component
from fnn_ekf_ros.core.lasting.challenger import LOST_AT, challenged
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
KNOWN_AFTER_S = 3.0
"""Time for which readings have to agree with it until it is [s]: random ones do for one or two."""
DISAGREES_AT = 3.0
"""Normalized innovation of the witness from which on a reading disagrees with an offset that is not
known yet: the offset is unknown again, and the reading does not pull the witness's yaw."""
SUPPORT_NEEDED = 0.0
"""Log likelihood ratio of the fixes since the surprise began, for the wheels against the compass,
from which on the compass was turned [nats]: they do not take its side. Soon the filters take a
turned compass for slip and follow it; from then on fixes hardly tell."""
_POSITION_ROWS = np.array(2.0)
_OFFSET = Component.YAW_OFFSET


class CompassOffset(NamedTuple):
    """What is believed of the compass's offset.

    Attributes:
        believed: `(*batch)` whether it is believed.
        likely_s: `(*batch)` time for which it has been likely [s].
        suspected: `(*batch)` whether the last yaw makes it likely, and it is not believed yet.
        doubted: `(*batch)` whether its offset is not known any more, and not known again yet.
        turned: `(*batch)` whether that is because the compass was turned, and not because an offset
            was believed that was wrong.
        agreeing_s: `(*batch)` time for which readings have agreed with the offset meanwhile [s].
        surprise: `(2, *batch)` sums of normalized innovations to the left and to the right.
        surprised_s: `(*batch)` time for which one of them has been more than 0 [s].
        support: `(*batch)` log likelihood ratio of the fixes meanwhile, for the wheels against the
            compass [nats].
        challenger: `(*batch)` lead of the witness's challenger [nats]; `challenger.LOST_AT`: there
            is none.
    """

    believed: BoolArray
    likely_s: FloatArray
    suspected: BoolArray
    doubted: BoolArray
    turned: BoolArray
    agreeing_s: FloatArray
    surprise: FloatArray
    surprised_s: FloatArray
    support: FloatArray
    challenger: FloatArray

    @property
    def unknown(self) -> BoolArray:
        """`(*batch)` whether all but the witness do without the compass.

        The settled learner does not learn meanwhile: filters whose yaw is off take it for noise of
        the fixes, and the witness would then need many more of them. Alarms act, so that the pose
        stays at the fixes.
        """
        return self.doubted | self.suspected


def start_offset(batch: tuple[int, ...], *, from_readings: bool = True) -> CompassOffset:
    """Return the belief before the first reading.

    Args:
        batch: its shape.
        from_readings: whether the yaw is that of a reading; a yaw that was given has no opposite.
    """
    none, no = np.zeros(batch), np.zeros(batch, dtype=np.bool_)
    return CompassOffset(
        believed=no, likely_s=none, suspected=no, doubted=no, turned=no, agreeing_s=none,
        surprise=np.zeros((2, *batch)), surprised_s=none, support=none,
        challenger=none if from_readings else np.full(batch, LOST_AT),
    )  # fmt: skip


def offset_of(bank: Bank) -> tuple[FloatArray, FloatArray]:
    """Return the witness's offset [rad] and its variance [rad^2], each `(*batch)`."""
    offset = wrap_angle(bank.mean[_OFFSET, WITNESS])
    return offset, bank.covariance[_OFFSET, _OFFSET, WITNESS]


def log_odds(bank: Bank) -> FloatArray:
    """Return D, `(*batch)` [nats]."""
    return _log_odds(*offset_of(bank))


def _log_odds(offset: FloatArray, variance: FloatArray) -> FloatArray:
    """Return D, `(*batch)` [nats], of an offset [rad] with a variance [rad^2]."""
    v = variance + USUAL_OFFSET_STD**2
    return np.asarray(0.5 * offset * offset / v - 0.5 * np.log(WITNESS_OFFSET_STD**2 / v))


def suspected_with(
    offset: CompassOffset, bank: Bank, yaw: FloatArray, noise: FloatArray, read: BoolArray
) -> tuple[CompassOffset, Bank]:
    """Return the belief and the filters before a yaw is taken, with what it would make likely.

    While the offset is not known after a surprise, one that disagrees with it makes it unknown.

    Args:
        offset: the belief before it.
        bank: all filters before it; not changed.
        yaw: `(*batch)` of the compass, or of a fix where there is none [rad].
        noise: `(*batch)` its R [rad^2].
        read: `(*batch)` whether there is a reading.
    """
    if not read.any():
        return offset, bank
    x, P = bank.mean[:, WITNESS], bank.covariance[:, :, WITNESS]
    HP = P[Component.YAW] + P[Component.YAW_DRIFT] + P[_OFFSET]
    s = HP[Component.YAW] + HP[Component.YAW_DRIFT] + HP[_OFFSET] + noise
    e = wrap_angle(yaw - x[Component.YAW] - x[Component.YAW_DRIFT] - x[_OFFSET])
    gain = HP[_OFFSET] / s
    D = _log_odds(wrap_angle(x[_OFFSET] + gain * e), P[_OFFSET, _OFFSET] - gain * HP[_OFFSET])
    suspected = (D > LIKELY_AT) & ~offset.believed
    offset = offset._replace(suspected=np.where(read, suspected, offset.suspected))
    disagrees = read & offset.doubted & (e * e > DISAGREES_AT**2 * s)
    if not disagrees.any():
        return offset, bank
    agreeing_s = np.where(disagrees, 0.0, offset.agreeing_s)
    return offset._replace(agreeing_s=agreeing_s), _with_unknown_offset(bank, disagrees)


def later(offset: CompassOffset, duration_s: float) -> CompassOffset:
    """Return the belief after a duration [s], before the readings at its end."""
    return offset._replace(surprised_s=offset.surprised_s + duration_s)


def after_fix(
    offset: CompassOffset,
    bank: Bank,
    nis: FloatArray,
    determinant: FloatArray,
    fixed: BoolArray,
) -> tuple[CompassOffset, Bank]:
    """Return the belief and the filters after a fix.

    It takes the side of the wheels or of the compass, and of the witness or of its challenger. If
    that wins they change places, and what was known of the witness and its offset ends.

    Args:
        offset: the belief before it.
        bank: all filters after it; not changed.
        nis: `(3, *batch)` NIS of its x and y for witness, challenger and advocate.
        determinant: `(3, *batch)` det S of these [m^4].
        fixed: `(*batch)` whether there is a fix.
    """
    witness, _, advocate = log_likelihood(nis, determinant, _POSITION_ROWS)
    support = offset.support + np.where(fixed, witness - advocate, 0.0)
    needed = offset.believed | offset.doubted
    challenge = challenged(offset.challenger, bank, nis[:2], determinant[:2], fixed, needed)
    after = offset._replace(support=support, challenger=challenge.lead)
    won = challenge.won
    if not won.any():
        return after, challenge.bank
    after = after._replace(
        likely_s=np.where(won, 0.0, after.likely_s),
        doubted=after.doubted | (won & after.believed),
        believed=after.believed & ~won,
        agreeing_s=np.where(won, 0.0, after.agreeing_s),
        surprise=np.where(won, 0.0, after.surprise),
        surprised_s=np.where(won, 0.0, after.surprised_s),
        support=np.where(won, 0.0, after.support),
    )
    return after, challenge.bank


def after_compass(
    offset: CompassOffset,
    bank: Bank,
    innovation: FloatArray,
    std: FloatArray,
    read: BoolArray,
    elapsed: float,
    fixes_last: FloatArray,
) -> tuple[CompassOffset, Bank]:
    """Return the belief and the filters after a compass reading.

    Args:
        offset: the belief before it.
        bank: all filters after it; not changed.
        innovation: `(*batch)` of the witness [rad].
        std: `(*batch)` its standard deviation [rad].
        read: `(*batch)` whether there is a reading.
        elapsed: since the instant before [nominal periods]; more than 1 counts as 1.
        fixes_last: `(*batch)` weight of the members whose fix errors last.
    """
    normalized = _to_both_sides(innovation) / std
    limited = np.minimum(np.maximum(normalized, -LARGEST_SURPRISE), LARGEST_SURPRISE)
    gained = min(elapsed, 1.0) * (limited - USUAL_SURPRISE)
    surprise = np.where(read, np.maximum(offset.surprise + gained, 0.0), offset.surprise)
    largest = surprise.max(axis=0)
    surprised_s = np.where(largest > 0.0, offset.surprised_s, 0.0)
    support = np.where(largest > 0.0, offset.support, 0.0)
    offset = offset._replace(surprise=surprise, surprised_s=surprised_s, support=support)
    if not (largest > TURNED_AT).any():
        return offset, bank
    needed = TURNED_AT / np.maximum(1.0 - fixes_last, SMALLEST_WEIGHT)
    turned = read & (largest > needed) & (surprised_s >= TURNED_AFTER_S)
    turned &= support >= SUPPORT_NEEDED
    after = offset._replace(
        surprise=np.where(turned, 0.0, surprise),
        doubted=offset.doubted | turned,
        turned=offset.turned | turned,
        agreeing_s=np.where(turned, 0.0, offset.agreeing_s),
    )
    return after, _with_unknown_offset(bank, turned) if turned.any() else bank


def _to_both_sides(innovation: FloatArray) -> FloatArray:
    """Return how far innovations are to the left and to the right, `(2, *batch)` [rad].

    From -pi/2 to 3 pi/2: what is off by about pi is far off to either side, whatever its sign.
    """
    quarter = 0.5 * math.pi
    both = np.stack([innovation, -innovation])
    return np.where(both < -quarter, both + math.tau, both)


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
    agreeing_s = offset.agreeing_s + duration_s
    known = (variance < KNOWN_STD**2) & (agreeing_s >= KNOWN_AFTER_S)
    decided = offset.doubted & known & (believed | (D < GIVEN_UP_AT))
    changed = (believed != offset.believed) | decided
    after = offset._replace(
        believed=believed,
        likely_s=likely_s,
        doubted=offset.doubted & ~decided,
        turned=offset.turned & ~decided,
        agreeing_s=agreeing_s,
    )
    return after, changed
