"""Many extended Kalman filters of one robot side by side (Nguyen et al., eqs. 5-12).

    prediction   P- = A P A' + W Q W'
    row by row   s = h P h' + d,   K = P h' / s,   x <- x + K e,   P <- P - K s K'

All filters of a bank see the same wheels and the same readings; each has its own mean, covariance,
Q and R. The rows of a reading are uncorrelated, or have been made so (`Noise.coupling`), so that
one after the other does what all together would, without a matrix to invert:

    e      what is left of the row's innovation after the rows before it
    s      the variance of e: the product of all s is det S, the sum of all e^2 / s is r' S^-1 r

A row h that measures component i leaves the entries P_i: at P_i: d / s. They are set to that, and
not calculated as a difference: a good fix of a pose that was almost lost leaves a covariance that
is positive definite.
"""

from typing import NamedTuple

import numpy as np

from fnn_ekf_ros.core.angles import wrap_angle
from fnn_ekf_ros.core.arrays import (
    STATE_OF_ROW,
    BoolArray,
    FloatArray,
    Row,
)
from fnn_ekf_ros.core.covariance import limit_uncertainty
from fnn_ekf_ros.core.limits import SMALLEST_STD
from fnn_ekf_ros.core.motion import Motion, MotionModel, move
from fnn_ekf_ros.core.rows import FIX_ROWS, in_order

_COMPONENTS = np.array(STATE_OF_ROW)


class Bank(NamedTuple):
    """F filters, each of them a Gaussian.

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
        coupling: the coefficients by which the rows of a fix are made uncorrelated, each
            `(F, *batch)`; None where they are.
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

    Attributes:
        y_x: how much of x is added to y.
        yaw_y: how much of y is added to the yaw (rad/m).
        yaw_x: how much of x is.
        y_left: part of y's variance that is left.
        yaw_left: part of the yaw's.
    """

    y_x: FloatArray
    yaw_y: FloatArray
    yaw_x: FloatArray
    y_left: FloatArray
    yaw_left: FloatArray

    def of_row(self, row: Row) -> "tuple[tuple[tuple[Row, FloatArray], ...], FloatArray | float]":
        """Return which rows are added to one, with how much of each, and what is left of its R."""
        if row is Row.Y:
            return ((Row.X, self.y_x),), self.y_left
        if row is Row.LRF_YAW:
            return ((Row.X, self.yaw_x), (Row.Y, self.yaw_y)), self.yaw_left
        return (), 1.0


class Readings(NamedTuple):
    """What is measured at one instant.

    Attributes:
        values: `(4, *batch)` z (m, m, rad, rad), rows as in `Row`; ignored where not available.
        available: `(4, *batch)` which rows are measured.
    """

    values: FloatArray
    available: BoolArray


class Innovations(NamedTuple):
    """What readings say against the predictions of F filters, row by row.

    Attributes:
        innovation: `(4, F, *batch)` r (m, m, rad, rad); 0 where not available.
        variance: `(4, F, *batch)` diagonal of S, of all rows.
    """

    innovation: FloatArray
    variance: FloatArray

    def filters(self, which: slice) -> "Innovations":
        """Return what they say against some of the filters; views."""
        return Innovations(self.innovation[:, which], self.variance[:, which])


class Correction(NamedTuple):
    """F filters after a reading.

    Attributes:
        bank: all filters; those rows of a fix that are coupled were taken together.
        nis: `(F, *batch)` normalised innovation squared r' S^-1 r of the rows taken.
        fix_nis: `(F, *batch)` the same of the rows of the fix alone.
        determinant: `(F, *batch)` det S of the rows taken; 1 without any.
    """

    bank: Bank
    nis: FloatArray
    fix_nis: FloatArray
    determinant: FloatArray


def predict(model: MotionModel, bank: Bank, control: FloatArray, process_noise: FloatArray) -> Bank:
    """Return the filters after a step of the wheels; headings are not wrapped.

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
    P, (forward, turn) = covariance, process_noise
    by_heading, by_way, by_turn = motion.by_heading, motion.by_way, motion.by_turn
    half = (0.5 * P[2, 2]) * by_heading
    lean = P[:2, 2] + half
    # x and y: two outer products of the shear by the heading, then the noise of way and turn.
    shear = by_heading[:, None] * lean[None]
    by_noise = forward * (by_way[:, None] * by_way[None])
    by_noise += turn * (by_turn[:, None] * by_turn[None])
    after = np.empty_like(P)
    block = after[:2, :2]
    block[...] = shear + shear.swapaxes(0, 1)
    block += by_noise
    block += P[:2, :2]
    lean += half
    lean += turn * by_turn
    after[:2, 2] = lean
    after[2, :2] = lean
    after[2, 2] = P[2, 2] + turn
    return after


def innovate(bank: Bank, readings: Readings, measurement_noise: FloatArray) -> Innovations:
    """Compare the filters' predictions with readings.

    Args:
        bank: x-, P-.
        readings: z.
        measurement_noise: `(4, F, *batch)` diagonal of R.
    """
    expected = bank.mean[_COMPONENTS]
    r = np.where(readings.available[:, None], readings.values[:, None], expected)
    r -= expected
    r[Row.COMPASS_YAW :] = wrap_angle(r[Row.COMPASS_YAW :])
    return Innovations(r, bank.covariance[_COMPONENTS, _COMPONENTS] + measurement_noise)


def correct(bank: Bank, seen: Innovations, noise: Noise, rows: BoolArray) -> Correction:
    """Return the filters corrected by rows of their innovations.

    Args:
        bank: the filters.
        seen: of the first F of them; the others stay as they are.
        noise: of these F.
        rows: `(4, *batch)` which rows they are corrected by.
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
        i, d = STATE_OF_ROW[row], noise.measurement[row]
        column = P[:, i]
        e = seen.innovation[row] - x[i]
        others: tuple[tuple[Row, FloatArray], ...] = ()
        if noise.coupling is not None:
            others, part_left = noise.coupling.of_row(row)
            column, d = column.copy(), d * part_left
            for other, part in others:
                j = STATE_OF_ROW[other]
                column += part * P[:, j]
                e += part * (seen.innovation[other] - x[j])
        s = column[i] + d
        for other, part in others:
            s += part * column[STATE_OF_ROW[other]]
        left = d / s
        root = np.sqrt(s)
        w = column / root
        e /= root
        if some is not None:
            w, e, s = np.where(some, w, 0.0), np.where(some, e, 0.0), np.where(some, s, 1.0)
            left = np.where(some, left, 1.0)
        x += w * e
        kept = left * column
        before = P[:, i].copy() if others else kept
        P -= w[:, None] * w[None]
        if others:
            kept = _solved_for(i, kept, others, P)
            if some is not None:  # where the row is not taken nothing changes, not by rounding
                kept = np.where(some, kept, before)
        P[:, i] = kept
        P[i] = kept
        determinant *= s
        e *= e
        nis += e
    mean[:, :count] += x
    return Correction(Bank(mean, covariance), nis, fix_nis, determinant)


def _solved_for(
    i: int, product: FloatArray, others: tuple[tuple[Row, FloatArray], ...], P: FloatArray
) -> FloatArray:
    """Return the entries P_:i of which P h' is a given product, for a row h of several components.

    Args:
        i: the component whose part of h is 1.
        product: `(3, F, *batch)` P h'.
        others: the rows of the other components, with their parts of h.
        P: `(3, 3, F, *batch)`; its entries that have nothing to do with i are right.
    """
    entries = product.copy()
    for other, part in others:
        entries -= part * P[:, STATE_OF_ROW[other]]
    entries[i] = product[i]
    for other, part in others:
        entries[i] -= part * entries[STATE_OF_ROW[other]]
    return entries


def wrapped(bank: Bank) -> Bank:
    """Return the filters with headings in (-pi, pi]; of a bank that nobody else holds."""
    bank.mean[2] = wrap_angle(bank.mean[2])
    return bank


def noise_of_readings(
    noise: Noise,
    reference: tuple[float, ...],
    fix_covariance: FloatArray | None,
    available: BoolArray,
) -> Noise:
    """Return the noise that readings are taken with: the filters' own, or what a fix reported.

    What a fix reports is multiplied, row by row, by what R in use is to the reference. No scale
    makes a report better than `SMALLEST_STD`, as no report is.

    Args:
        noise: of the filters.
        reference: diagonal of R that reports are scaled against.
        fix_covariance: `(3, 3, *batch)` R of `FIX_ROWS` as reported; None: the filters' own.
        available: `(4, *batch)` which rows are measured.
    """
    if fix_covariance is None:
        return noise
    rows = list(FIX_ROWS)
    measured = available[rows]
    reported = np.where(measured[:, None] & measured[None], fix_covariance, 0.0)
    variance = np.where(measured, reported[[0, 1, 2], [0, 1, 2]], 1.0)
    std = np.sqrt(variance)
    own = noise.measurement[rows]
    known = np.array(reference)[rows].reshape(-1, *(1,) * (own.ndim - 1))
    scale = np.maximum(np.sqrt(own / known), (SMALLEST_STD / std)[:, None])

    y_x = -reported[1, 0] / variance[0]
    across = reported[2, 1] + y_x * reported[2, 0]
    yaw_y = -across / (variance[1] + y_x * reported[1, 0])
    yaw_x = -reported[2, 0] / variance[0] + yaw_y * y_x
    y_left = 1.0 + y_x * reported[1, 0] / variance[1]
    yaw_left = 1.0 + (yaw_y * reported[2, 1] + yaw_x * reported[2, 0]) / variance[2]
    taken = noise.measurement.copy()
    taken[rows] = np.where(measured[:, None], scale * scale * variance[:, None], own)
    return Noise(
        noise.process,
        taken,
        Coupling(
            y_x * (scale[1] / scale[0]),
            yaw_y * (scale[2] / scale[1]),
            yaw_x * (scale[2] / scale[0]),
            np.broadcast_to(y_left, scale.shape[1:]),
            np.broadcast_to(yaw_left, scale.shape[1:]),
        ),
    )
