# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The challenger of the compass's witness: is the witness's yaw right?

Wheels and compass say together how yaw and offset change, but not how large either is: that a fix
tells by where it lies. A witness that is sure of a wrong yaw, and so of a wrong offset, hardly
learns from fixes: lasting errors may explain them, and the learner takes them for noise that grows.
Such a yaw comes from a compass that is off by about pi, to which side of it a fix does not say;
from a pose that somebody set wrong; from sensors that said nonsense for a while.

The challenger is a filter like the witness with another yaw. It begins with the opposite one. A
later one begins where the witness is and as if yaw and offset were unknown, but for their sum,

    P_challenger = P + s^2 d d',     d = 1 at theta, -1 at b_0

and finds its own. Its lead is the sum over the fixes that fit one of the two of

    l_challenger - l_witness,     l = -1/2 log det S - log(e + a)

at most .5 nats each; e is the NIS of x and y. With a = 0 this is the likelihood of a fix whose
noise is known but for a factor: the noise that is assumed is wrong where the witness is. At a lead
of 8 or more they change places, at -2 or less there is no challenger.

A compass that is off is rare: while none is believed to be, the witness needs no challenger but the
first. While one is, or was turned, a challenger begins whenever there is none, or one that has no
lead has become like the witness.
"""

import math
from typing import NamedTuple

import numpy as np

from fnn_ekf_ros.core.angles import wrap_angle
from fnn_ekf_ros.core.arrays import BoolArray, FloatArray
from fnn_ekf_ros.core.bank import Bank
from fnn_ekf_ros.core.lasting.augmented import Component
from fnn_ekf_ros.core.lasting.members import CHALLENGER, WITNESS, WITNESSES

YAW_STD = 1.0
"""s, standard deviation of the yaw that a challenger begins with [rad]."""
WON_AT = 8.0
"""Lead from which on they change places [nats]: odds of 55 (sequential test, Wald 1945) for a
witness that is wrong, which is as rare as that."""
LOST_AT = -2.0
"""Lead from which on there is no challenger [nats]: odds of 7, and the witness is seldom wrong."""
LARGEST_GAIN = 0.5
"""Largest contribution of a fix to it [nats]: errors that last are in several fixes, so that no few
decide alone."""
FITTING_NIS = 5.99
"""NIS of x and y up to which a fix fits a filter: right noise exceeds it in 5 %. A fix that fits
neither does not tell which is right."""
SMALLEST_NIS = 0.1
"""a, NIS below which smaller ones tell little more: right noise has less in 5 %."""
ALIKE = 2.0
"""Root mean square of the difference of the yaws, in standard deviations of that of the witness, up
to which a challenger is like it."""
_YAW, _OFFSET = Component.YAW, Component.YAW_OFFSET


class Challenge(NamedTuple):
    """Witness and challenger after a fix.

    Attributes:
        lead: `(*batch)` log likelihood ratio of the fixes for the challenger [nats]; `LOST_AT`:
            there is none.
        bank: all filters.
        won: `(*batch)` whether they have changed places.
    """

    lead: FloatArray
    bank: Bank
    won: BoolArray


def opposite_of_witness(bank: Bank) -> Bank:
    """Make the challenger the witness with the opposite yaw, in place, and return the filters."""
    bank.mean[:, CHALLENGER] = bank.mean[:, WITNESS]
    bank.covariance[:, :, CHALLENGER] = bank.covariance[:, :, WITNESS]
    bank.mean[_YAW, CHALLENGER] = wrap_angle(bank.mean[_YAW, WITNESS] + math.pi)
    bank.mean[_OFFSET, CHALLENGER] = wrap_angle(bank.mean[_OFFSET, WITNESS] - math.pi)
    return bank


def challenged(
    lead: FloatArray,
    bank: Bank,
    nis: FloatArray,
    determinant: FloatArray,
    fixed: BoolArray,
    needed: BoolArray,
) -> Challenge:
    """Return witness and challenger after a fix.

    Args:
        lead: `(*batch)` of the challenger before it [nats]; `LOST_AT`: there is none.
        bank: all filters after it; not changed.
        nis: `(2, *batch)` NIS of its x and y for both.
        determinant: `(2, *batch)` det S of these [m^4].
        fixed: `(*batch)` whether there is a fix.
        needed: `(*batch)` whether a new challenger begins where there is none.
    """
    begins = fixed & needed & ((lead <= LOST_AT) | ((lead <= 0.0) & _alike(bank)))
    tells = fixed & (lead > LOST_AT) & (nis.min(axis=0) < FITTING_NIS)
    won = np.zeros(lead.shape, dtype=np.bool_)
    if tells.any():
        of_witness, of_challenger = -0.5 * np.log(determinant) - np.log(nis + SMALLEST_NIS)
        gained = np.minimum(np.maximum(of_challenger - of_witness, -LARGEST_GAIN), LARGEST_GAIN)
        lead = lead + np.where(tells, gained, 0.0)
        won = lead >= WON_AT
        lead = np.where(won | ~np.isfinite(lead), LOST_AT, np.maximum(lead, LOST_AT))
        if won.any():
            bank = _exchanged(bank, won)
    if begins.any():
        bank, lead = _with_new_challenger(bank, begins), np.where(begins, 0.0, lead)
    return Challenge(lead, bank, won)


def _alike(bank: Bank) -> BoolArray:
    """Return where the challenger has become like the witness, `(*batch)`."""
    of_witness, of_challenger = bank.covariance[_YAW, _YAW, WITNESSES]
    apart = wrap_angle(bank.mean[_YAW, CHALLENGER] - bank.mean[_YAW, WITNESS])
    return np.asarray(apart * apart + of_challenger <= ALIKE**2 * of_witness)


def _exchanged(bank: Bank, some: BoolArray) -> Bank:
    """Return the filters; witness and challenger have changed places where `some`, `(*batch)`."""
    mean, covariance = bank.mean.copy(), bank.covariance.copy()
    for array, axis in ((mean, 1), (covariance, 2)):
        both = np.moveaxis(array, axis, 0)[WITNESSES]
        both[...] = np.where(some, both[::-1], both)
    return Bank(mean, covariance)


def _with_new_challenger(bank: Bank, some: BoolArray) -> Bank:
    """Return the filters; the challenger begins where the witness is where `some`, `(*batch)`."""
    mean, covariance = bank.mean.copy(), bank.covariance.copy()
    mean[:, CHALLENGER] = np.where(some, mean[:, WITNESS], mean[:, CHALLENGER])
    P = covariance[:, :, WITNESS].copy()
    P[_YAW, _YAW] += YAW_STD**2
    P[_OFFSET, _OFFSET] += YAW_STD**2
    P[_YAW, _OFFSET] -= YAW_STD**2
    P[_OFFSET, _YAW] -= YAW_STD**2
    covariance[:, :, CHALLENGER] = np.where(some, P, covariance[:, :, CHALLENGER])
    return Bank(mean, covariance)
