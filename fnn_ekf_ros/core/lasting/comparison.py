# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Readings against the members: innovations, and the NIS of their mixture for the gate.

    S = sum_k w_k (S_k + (r_k - r) (r_k - r)'),   r = sum_k w_k r_k,   NIS = r' S^-1 r

with the yaws' innovations within pi of the first member's: a yaw that is off by about pi is to the
left for some members and to the right for others, and their mean would say that it fits.

One gate for all members: a gate of each member's own would reject what it does not expect, and its
weight would be that of a filter that agrees with itself. A compass reading is compared with the
witness, too, and the smaller NIS counts: what the witness expects is no outlier.

A fix's yaw has the lasting errors of a yaw where no compass has been read; beside a compass it is
the reference that tells the compass's errors.
"""

from typing import NamedTuple

import numpy as np

from fnn_ekf_ros.core.angles import wrap_angle
from fnn_ekf_ros.core.arrays import STATE_SIZE, BoolArray, FloatArray, Row
from fnn_ekf_ros.core.bank import Bank, Noise, Readings
from fnn_ekf_ros.core.lasting.augmented import POSE, Component, observe
from fnn_ekf_ros.core.lasting.members import OF_MEMBERS, WITNESS, WITNESSES
from fnn_ekf_ros.core.rows import (
    COMPASS,
    FIX_ROWS,
    LRF_POSE,
    POSITION_ROWS,
    SENSOR_COUNT,
    in_order,
)

_FIX = list(FIX_ROWS)


class Correcting(NamedTuple):
    """The offset of the compass that is believed; all but the witness take readings without it.

    Attributes:
        offset: `(*batch)` b_0; 0 where none is believed [rad].
        variance: `(*batch)` its variance; 0 where none is believed, very large while the compass is
            doubted [rad^2].
        fix_yaw: `(*batch)` 1 where the fix's yaw has the errors of a yaw, else 0.
    """

    offset: FloatArray
    variance: FloatArray
    fix_yaw: FloatArray


class Comparison(NamedTuple):
    """Readings of an instant against the filters of lasting errors.

    Attributes:
        correcting: the offset that is believed, and which errors a fix's yaw has.
        innovation: `(4, F, *batch)` r, 0 where not available (m, m, rad, rad).
        compass_noise: `(F, *batch)` R of the compass [rad^2].
        position_nis: `(F, *batch)` NIS of a fix's x and y.
        position_determinant: `(F, *batch)` det S of these [m^4].
        nis: `(2, *batch)` NIS of each sensor against the mixture; 0 where it measured nothing.
        witness_variance: `(2, *batch)` variance of the innovation of the compass against the
            witness and its challenger [rad^2].
        mixed: `(4, *batch)` innovation of the mixture (m, m, rad, rad).
        variance: `(4, *batch)` diagonal of its S.
    """

    correcting: Correcting
    innovation: FloatArray
    compass_noise: FloatArray
    position_nis: FloatArray
    position_determinant: FloatArray
    nis: FloatArray
    witness_variance: FloatArray
    mixed: FloatArray
    variance: FloatArray

    @property
    def witness_innovation(self) -> FloatArray:
        """`(2, *batch)` that innovation; 0 without a reading [rad]."""
        innovation: FloatArray = self.innovation[Row.COMPASS_YAW, WITNESSES]
        return innovation


def compare(
    bank: Bank, weights: FloatArray, correcting: Correcting, readings: Readings, noise: Noise
) -> Comparison:
    """Compare the filters' predictions with readings.

    Args:
        bank: the filters.
        weights: `(M, *batch)` of the members.
        correcting: the offset that is believed.
        readings: z, as the sensors sent it.
        noise: R of the readings without lasting errors, of one filter.
    """
    expected, HPH = observe(bank)
    available, R = readings.available, noise.measurement
    r = _innovation(bank, expected, correcting, readings)
    compass_noise = np.empty(r.shape[1:])
    compass_noise[...] = R[Row.COMPASS_YAW] + correcting.variance
    compass_noise[WITNESSES] = R[Row.COMPASS_YAW]
    fix_noise = _fix_noise(noise)

    members = OF_MEMBERS
    of_members = _around_the_first(r[:, members])
    mixed = (weights * of_members).sum(axis=1)
    d = of_members - mixed[:, None]
    yaw_variance = HPH[Component.YAW, Component.YAW, members] + compass_noise[members]
    compass_S = (weights * (yaw_variance + d[Row.COMPASS_YAW] ** 2)).sum(axis=0)
    fix_HPH = _fix_covariance(bank, HPH, correcting, available)[:, :, members]
    S = (weights * (fix_HPH + fix_noise + d[_FIX, None] * d[None, _FIX])).sum(axis=2)

    witness_S = HPH[Component.YAW, Component.YAW, WITNESSES] + compass_noise[WITNESSES]
    nis = np.empty((SENSOR_COUNT, *compass_S.shape))
    nis[COMPASS] = np.minimum(
        mixed[Row.COMPASS_YAW] ** 2 / compass_S, r[Row.COMPASS_YAW, WITNESS] ** 2 / witness_S[0]
    )
    nis[LRF_POSE] = _fix_nis(mixed[_FIX], S, available)
    position_nis, determinant = two_row_nis(r[:2], HPH[:2, :2] + fix_noise[:2, :2])
    variance = np.empty(mixed.shape)
    variance[Row.X], variance[Row.Y], variance[Row.LRF_YAW] = S[0, 0], S[1, 1], S[2, 2]
    variance[Row.COMPASS_YAW] = compass_S
    return Comparison(
        correcting=correcting,
        innovation=r,
        compass_noise=compass_noise,
        position_nis=position_nis,
        position_determinant=determinant,
        nis=nis,
        witness_variance=witness_S,
        mixed=mixed,
        variance=variance,
    )


def _around_the_first(r: FloatArray) -> FloatArray:
    """Return innovations `(4, M, *batch)` whose yaws are within pi of the first member's."""
    yaws = [Row.COMPASS_YAW, Row.LRF_YAW]
    first = r[yaws, :1]
    apart = r[yaws] - first
    if (np.abs(apart) <= np.pi).all():
        return r
    around = r.copy()
    around[yaws] = first + wrap_angle(apart)
    return around


def two_row_nis(r: FloatArray, S: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return r' S^-1 r and det S, `(...)`, for r `(2, ...)` and S `(2, 2, ...)`."""
    determinant = S[0, 0] * S[1, 1] - S[0, 1] * S[0, 1]
    nis = r[0] * r[0] * S[1, 1] - 2.0 * r[0] * r[1] * S[0, 1] + r[1] * r[1] * S[0, 0]
    return nis / determinant, determinant


def _innovation(
    bank: Bank, expected: FloatArray, correcting: Correcting, readings: Readings
) -> FloatArray:
    """Return r, `(4, F, *batch)`; 0 where not available."""
    z, mean = readings.values, bank.mean
    r = np.zeros((len(z), *expected.shape[1:]))
    for row, some in in_order(readings.available):
        if row in POSITION_ROWS:
            e = z[row] - expected[row]
        elif row is Row.COMPASS_YAW:
            e = z[row] - correcting.offset - expected[Component.YAW]
            e[WITNESSES] += correcting.offset
            e = wrap_angle(e)
        else:
            offset = correcting.fix_yaw * correcting.offset
            errors = mean[Component.YAW_DRIFT] + mean[Component.YAW_OFFSET]
            e = z[row] - offset - mean[Component.YAW] - correcting.fix_yaw * errors
            e[WITNESSES] += offset
            e = wrap_angle(e)
        r[row] = e if some is None else np.where(some, e, 0.0)
    return r


def _fix_covariance(
    bank: Bank, HPH: FloatArray, correcting: Correcting, available: BoolArray
) -> FloatArray:
    """Return H P H' of x, y and yaw of a fix, `(3, 3, F, *batch)`."""
    part = correcting.fix_yaw
    if part.all() or not available[Row.LRF_YAW].any():
        return HPH
    P, yaw = bank.covariance, Component.YAW
    own = P[yaw, POSE].copy()
    own[:2] += P[yaw, STATE_SIZE : STATE_SIZE + 2]
    covariance = HPH.copy()
    covariance[yaw] = np.where(part > 0.0, HPH[yaw], own)
    covariance[:, yaw] = covariance[yaw]
    return covariance


def _fix_nis(r: FloatArray, S: FloatArray, available: BoolArray) -> FloatArray:
    """Return the NIS of a fix's rows that are available, `(*batch)`: x and y, then the yaw."""
    by_position, determinant = two_row_nis(r, S)
    both = available[Row.X]
    nis = np.where(both, by_position, 0.0)
    if not available[Row.LRF_YAW].any():
        return nis
    cross = S[2, :2]
    gain_x = (cross[0] * S[1, 1] - cross[1] * S[0, 1]) / determinant
    gain_y = (cross[1] * S[0, 0] - cross[0] * S[0, 1]) / determinant
    e = r[2] - np.where(both, gain_x * r[0] + gain_y * r[1], 0.0)
    s = S[2, 2] - np.where(both, gain_x * cross[0] + gain_y * cross[1], 0.0)
    return np.asarray(nis + np.where(available[Row.LRF_YAW], e * e / s, 0.0))


def _fix_noise(noise: Noise) -> FloatArray:
    """Return R of x, y and yaw of a fix, `(3, 3, F, *batch)`."""
    R, coupling = noise.measurement, noise.coupling
    matrix = np.zeros((len(FIX_ROWS),) * 2 + R.shape[1:])
    for place, row in enumerate(FIX_ROWS):
        matrix[place, place] = R[row]
    if coupling is not None:
        matrix[1, 0] = -coupling.y_x * matrix[0, 0]
        matrix[2, 0] = (coupling.yaw_y * coupling.y_x - coupling.yaw_x) * matrix[0, 0]
        rest = matrix[1, 1] + coupling.y_x * matrix[1, 0]
        matrix[2, 1] = -coupling.yaw_y * rest - coupling.y_x * matrix[2, 0]
        matrix[0, 1], matrix[0, 2], matrix[1, 2] = matrix[1, 0], matrix[2, 0], matrix[2, 1]
    return matrix
