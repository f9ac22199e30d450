# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Many extended Kalman filters of one robot side by side (Nguyen et al., eqs. 5-12).

    prediction   P- = A P A' + W Q W'
    row by row   s = h P h' + d,   K = P h' / s,   x <- x + K e,   P <- P - K s K'

All filters of a bank take the same wheel increments and the same readings; each has its own mean,
covariance, Q and R. The rows of a reading are uncorrelated, or are made uncorrelated
(`Noise.coupling`), so that correcting row by row equals correcting by all rows together, without
inverting a matrix:

    e      the row's innovation after the corrections by the rows before it
    s      the variance of e: the product of all s is det S, the sum of all e^2 / s is r' S^-1 r
    d      the variance of the row's noise
"""

from typing import NamedTuple

import numpy as np

from fnn_ekf_ros.core.angles import wrap_angle
from fnn_ekf_ros.core.arrays import (
    STATE_OF_ROW,
    STATES_OF_ROWS,
    BoolArray,
    FloatArray,
    Row,
    diagonal_of,
)
from fnn_ekf_ros.core.covariance import limit_uncertainty
from fnn_ekf_ros.core.limits import SMALLEST_STD
from fnn_ekf_ros.core.motion import Motion, MotionModel, move
from fnn_ekf_ros.core.row_update import Terms, take_row
from fnn_ekf_ros.core.rows import FIX_ROWS, in_order

Others = tuple[tuple[Row, FloatArray], ...]
"""Rows that are added to another one, each with its coefficient `(F, *batch)`."""


class Bank(NamedTuple):
    """F filters, each a Gaussian.

    Attributes:
        mean: `(3, F, *batch)` x (m, m, rad in (-pi, pi]).
        covariance: `(3, 3, F, *batch)` P.
    """

    mean: FloatArray
    covariance: FloatArray

    def filters(self, which: slice) -> "Bank":
        """Return some of the filters; views."""
        return Bank(self.mean[:, which], self.covariance[:, :, which])


class Noise(NamedTuple):
    """Noise of F filters, as variances.

    Attributes:
        process: `(2, F, *batch)` diagonal of Q (m^2, rad^2).
        measurement: `(4, F, *batch)` diagonal of R, rows as in `Row`.
        coupling: coefficients that make the rows of a fix uncorrelated; None if they are.
    """

    process: FloatArray
    measurement: FloatArray
    coupling: "Coupling | None" = None

    def filters(self, which: slice) -> "Noise":
        """Return the noise of some of the filters; views."""
        coupling = self.coupling
        if coupling is not None:
            coupling = Coupling(*(entry[which] for entry in coupling))
        return Noise(self.process[:, which], self.measurement[:, which], coupling)


class Coupling(NamedTuple):
    """Inverse of the unit lower triangular factor of a fix's R: y + y_x x, yaw + yaw_y y + yaw_x x.

    All are `(F, *batch)`.

    Attributes:
        y_x: coefficient of x that is added to y.
        yaw_y: coefficient of y that is added to the yaw [rad/m].
        yaw_x: coefficient of x that is added to the yaw [rad/m].
        y_left: remaining part of y's variance.
        yaw_left: remaining part of the yaw's variance.
    """

    y_x: FloatArray
    yaw_y: FloatArray
    yaw_x: FloatArray
    y_left: FloatArray
    yaw_left: FloatArray

    def of_row(self, row: Row) -> "tuple[Others, FloatArray | float]":
        """Return the rows that are added to one, with their coefficients, and the rest of its R."""
        if row is Row.Y:
            return ((Row.X, self.y_x),), self.y_left
        if row is Row.LRF_YAW:
            return ((Row.X, self.yaw_x), (Row.Y, self.yaw_y)), self.yaw_left
        return (), 1.0


class Readings(NamedTuple):
    """The measurements of one instant.

    Attributes:
        values: `(4, *batch)` z (m, m, rad, rad), rows as in `Row`; ignored where not available.
        available: `(4, *batch)` which rows are measured.
    """

    values: FloatArray
    available: BoolArray


class Innovations(NamedTuple):
    """Innovations of readings against the predictions of F filters.

    Attributes:
        innovation: `(4, F, *batch)` r (m, m, rad, rad); 0 where not available.
        variance: `(4, F, *batch)` diagonal of S for all rows (m^2, m^2, rad^2, rad^2).
    """

    innovation: FloatArray
    variance: FloatArray

    def filters(self, which: slice) -> "Innovations":
        """Return the innovations against some of the filters; views."""
        return Innovations(self.innovation[:, which], self.variance[:, which])


class Correction(NamedTuple):
    """F filters after readings.

    Attributes:
        bank: the filters.
        nis: `(F, *batch)` normalized innovation squared r' S^-1 r of the rows taken.
        fix_nis: `(F, *batch)` the same of the rows of the fix alone.
        determinant: `(F, *batch)` det S of the rows taken; 1 without any.
    """

    bank: Bank
    nis: FloatArray
    fix_nis: FloatArray
    determinant: FloatArray


def predict(model: MotionModel, bank: Bank, control: FloatArray, process_noise: FloatArray) -> Bank:
    """Return the filters after a step of the wheels, with yaws that are not wrapped.

    Args:
        model: f(x, u).
        bank: before the step.
        control: `(2, *batch)` [dS, dtheta] (m, rad).
        process_noise: `(2, F, *batch)` diagonal of Q for this step (m^2, rad^2).
    """
    motion = move(model, bank.mean, control)
    predicted = predict_covariance(bank.covariance, motion, process_noise)
    return Bank(motion.mean, limit_uncertainty(predicted))


def predict_covariance(
    covariance: FloatArray, motion: Motion, process_noise: FloatArray
) -> FloatArray:
    """Return P- = A P A' + W Q W', exactly symmetric.

    Args:
        covariance: `(3, 3, ...)` P before the step.
        motion: the step, with A and W.
        process_noise: `(2, ...)` diagonal of Q for this step (m^2, rad^2).
    """
    P, (distance_variance, rotation_variance) = covariance, process_noise
    by_heading, by_distance, by_rotation = motion.by_heading, motion.by_distance, motion.by_rotation
    half = (0.5 * P[2, 2]) * by_heading
    cross = P[:2, 2] + half
    # x and y: two outer products of the shear by the heading, then the noise of the wheels.
    shear = by_heading[:, None] * cross[None]
    by_noise = distance_variance * (by_distance[:, None] * by_distance[None])
    by_noise += rotation_variance * (by_rotation[:, None] * by_rotation[None])
    after = np.empty_like(P)
    block = after[:2, :2]
    block[...] = shear + shear.swapaxes(0, 1)
    block += by_noise
    block += P[:2, :2]
    cross += half
    cross += rotation_variance * by_rotation
    after[:2, 2] = cross
    after[2, :2] = cross
    after[2, 2] = P[2, 2] + rotation_variance
    return after


def innovate(bank: Bank, readings: Readings, measurement_noise: FloatArray) -> Innovations:
    """Compare the filters' predictions with readings.

    Args:
        bank: x-, P-.
        readings: z.
        measurement_noise: `(4, F, *batch)` diagonal of R.
    """
    expected = bank.mean[STATES_OF_ROWS]
    r = np.where(readings.available[:, None], readings.values[:, None], expected)
    r -= expected
    r[Row.COMPASS_YAW :] = wrap_angle(r[Row.COMPASS_YAW :])
    return Innovations(r, bank.covariance[STATES_OF_ROWS, STATES_OF_ROWS] + measurement_noise)


def correct(bank: Bank, seen: Innovations, noise: Noise, rows: BoolArray) -> Correction:
    """Return the filters corrected by rows of their innovations.

    Args:
        bank: the filters.
        seen: innovations against the first F of them; the others are not changed.
        noise: of these F filters.
        rows: `(4, *batch)` rows that they are corrected by.
    """
    count = seen.innovation.shape[1]
    mean, covariance = bank.mean.copy(), bank.covariance.copy()
    P = covariance[:, :, :count]
    x = np.zeros((len(P), *P.shape[2:]))
    nis, determinant = np.zeros(x.shape[1:]), np.ones(x.shape[1:])
    fix_nis = nis
    for row, some in in_order(rows):
        if row is Row.COMPASS_YAW:
            fix_nis = nis.copy()
        e, s = take_row(x, P, *_row(seen.innovation, noise, row), some)
        determinant *= s
        e *= e
        nis += e
    mean[:, :count] += x
    return Correction(
        bank=Bank(mean, covariance), nis=nis, fix_nis=fix_nis, determinant=determinant
    )


def _row(innovation: FloatArray, noise: Noise, row: Row) -> tuple[Terms, FloatArray, FloatArray]:
    """Return the terms of a row, its innovation and its noise variance, after whitening.

    Args:
        innovation: `(4, F, *batch)` r of the predictions (m, m, rad, rad).
        noise: of the filters.
        row: which row.
    """
    i, e, d = STATE_OF_ROW[row], innovation[row], noise.measurement[row]
    if noise.coupling is None:
        return ((i, None),), e, d
    others, part_left = noise.coupling.of_row(row)
    terms = tuple((STATE_OF_ROW[other], part) for other, part in others)
    for other, part in others:
        e = e + part * innovation[other]
    return ((i, None), *terms), e, d * part_left


def wrapped(bank: Bank) -> Bank:
    """Return the filters with yaws in (-pi, pi]; the bank is changed in place."""
    bank.mean[2] = wrap_angle(bank.mean[2])
    return bank


def noise_of_readings(
    noise: Noise,
    reference: tuple[float, ...],
    fix_covariance: FloatArray | None,
    available: BoolArray,
) -> Noise:
    """Return the noise with which readings are taken: the filters' own R, or that of a fix.

    The covariance that a fix reports is multiplied, row by row, by the ratio of R in use to the
    configured one. No standard deviation becomes less than `SMALLEST_STD`.

    Args:
        noise: of the filters.
        reference: configured diagonal of R, rows as in `Row` (m^2, m^2, rad^2, rad^2).
        fix_covariance: `(3, 3, *batch)` R of `FIX_ROWS` as reported; None: the filters' own.
        available: `(4, *batch)` which rows are measured.
    """
    if fix_covariance is None:
        return noise
    rows = list(FIX_ROWS)
    measured = available[rows]
    reported = np.where(measured[:, None] & measured[None], fix_covariance, 0.0)
    variance = np.where(measured, diagonal_of(reported), 1.0)
    std = np.sqrt(variance)
    own = noise.measurement[rows]
    known = np.array(reference)[rows].reshape(-1, *(1,) * (own.ndim - 1))
    scale = np.maximum(np.sqrt(own / known), (SMALLEST_STD / std)[:, None])

    taken = noise.measurement.copy()
    taken[rows] = np.where(measured[:, None], scale * scale * variance[:, None], own)
    return Noise(noise.process, taken, _coupling(reported, variance, scale))


def _coupling(reported: FloatArray, variance: FloatArray, scale: FloatArray) -> Coupling:
    """Return the coefficients that make the rows of a fix uncorrelated.

    Args:
        reported: `(3, 3, *batch)` R of `FIX_ROWS` as the fix reported it; 0 where not measured.
        variance: `(3, *batch)` its diagonal; 1 where not measured.
        scale: `(3, F, *batch)` factor on the reported standard deviations, for each filter.
    """
    # L^-1 of reported = L D L', where L is unit lower triangular.
    y_x = -reported[1, 0] / variance[0]
    across = reported[2, 1] + y_x * reported[2, 0]
    yaw_y = -across / (variance[1] + y_x * reported[1, 0])
    yaw_x = -reported[2, 0] / variance[0] + yaw_y * y_x
    y_left = 1.0 + y_x * reported[1, 0] / variance[1]
    yaw_left = 1.0 + (yaw_y * reported[2, 1] + yaw_x * reported[2, 0]) / variance[2]
    return Coupling(
        y_x=y_x * (scale[1] / scale[0]),
        yaw_y=yaw_y * (scale[2] / scale[1]),
        yaw_x=yaw_x * (scale[2] / scale[0]),
        y_left=np.broadcast_to(y_left, scale.shape[1:]),
        yaw_left=np.broadcast_to(yaw_left, scale.shape[1:]),
    )
