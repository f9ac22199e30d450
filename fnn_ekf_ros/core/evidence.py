# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Likelihood, score and information of the noise, from filters with slightly different noise.

A star of filters is run beside one with noise exp(theta): for each of the four log scales
theta_i (distance, rotation, position, yaw) a neighbor at theta_i + h and one at theta_i - h. The
difference of their log likelihoods gives the score of a measurement, the differences of their
predictions its information about the scale (Fisher's, in Gauss-Newton form):

    d_i  = (l_i+ - l_i-) / 2h
    i_ij = (nu + n)/(nu + n + 2) sum over rows of  1/2 s_i s_j + g_i g_j
           s_i = (log S_i+ - log S_i-) / 2h,   g_i = (r_i+ - r_i-) / (2h sqrt(S))

The first term comes from the size of the innovations, the second from their correlation, which
distinguishes a gain that is too large from noise that is (Gupta and Mehra 1974 have the same two
terms).

The likelihood is Student's t (nu degrees of freedom) of the normalized innovation squared e,

    l = -1/2 log det S - (nu + n)/2 log(1 + e / c)

whose tail limits the influence of an outlier. c makes the expected score of Gaussian innovations
0: (nu + n) E[e / (c + e)] = n for e ~ chi-square(n). Otherwise R would be learned too large.
"""

import math
from enum import IntEnum
from typing import NamedTuple

import numpy as np

from fnn_ekf_ros.core.angles import wrap_angle
from fnn_ekf_ros.core.arrays import FloatArray, Row
from fnn_ekf_ros.core.rows import Rows


class Scale(IntEnum):
    """Log scales theta: of Q of distance and rotation, of R of the fixes' position and of yaws."""

    DISTANCE = 0
    ROTATION = 1
    POSITION = 2
    YAW = 3


SCALES = ("forward", "heading", "position", "yaw")
"""Names of the log scales in messages, in the order of `Scale`."""
SCALE_COUNT = len(Scale)
"""Number of log scales."""
NEIGHBOR_STEP = 0.25
"""h, difference to a neighbor in log variance: about 25 % in variance. With 1 the differences would
be biased by a factor of sinh(1)."""
TAIL_DEGREES_OF_FREEDOM = 8.0
"""nu, degrees of freedom of the likelihood: it limits the influence of a single outlier."""
CONSISTENT_SCALE: FloatArray = np.array([1.0, 6.4929, 6.6099, 6.7111, 6.7994])
"""c for n = 0 to 4 rows, from (nu + n) E[e / (c + e)] = n; 1 for no row, which has e = 0."""
STAR_SIZE = 1 + 2 * SCALE_COUNT
"""Filters of a star."""
STAR: FloatArray = NEIGHBOR_STEP * np.concatenate(
    [np.zeros((SCALE_COUNT, 1)), np.kron(np.eye(SCALE_COUNT), [1.0, -1.0])], axis=1
)
"""Differences of a star's filters in theta, `(4, 9)`: the center, then +h and -h in each scale."""


class Evidence(NamedTuple):
    """Score and information of the log scales by one measurement.

    Attributes:
        score: `(4, ...)` derivative of the log likelihood with respect to the log scales.
        information: `(4, 4, ...)` its expected curvature, apart from the effect of the tails on
            several rows together; positive semidefinite.
    """

    score: FloatArray
    information: FloatArray


def log_likelihood(nis: FloatArray, determinant: FloatArray, rows: FloatArray) -> FloatArray:
    """Return the log likelihood `(...)` of readings; 0 where nothing was measured.

    Args:
        nis: `(...)` e; 0 where nothing was measured.
        determinant: `(...)` det S; 1 where nothing was measured.
        rows: n, number of rows; broadcasts against the others.
    """
    c = CONSISTENT_SCALE[rows.astype(np.intp)]
    return -0.5 * (np.log(determinant) + (TAIL_DEGREES_OF_FREEDOM + rows) * np.log1p(nis / c))


def star_evidence(
    innovation: FloatArray,
    variance: FloatArray,
    likelihood: FloatArray,
    taught: Rows,
) -> Evidence:
    """Return score `(4, L, *batch)` and information `(4, 4, L, *batch)` of L learners.

    Args:
        innovation: `(4, 9, L, *batch)` r (m, m, rad, rad), 0 where not available; filters as in
            `STAR`.
        variance: `(4, 9, L, *batch)` diagonal of S.
        likelihood: `(9, L, *batch)` log likelihood of all rows together.
        taught: rows that are learned from.
    """
    by_size = _slope(np.log(variance), 1)
    by_prediction = innovation[:, 1::2] - innovation[:, 2::2]
    by_prediction[Row.COMPASS_YAW :] = wrap_angle(by_prediction[Row.COMPASS_YAW :])
    by_prediction /= 2.0 * NEIGHBOR_STEP * np.sqrt(variance[:, :1])
    by_size *= math.sqrt(0.5)
    both = np.concatenate([by_size, by_prediction])
    if not taught.each.all():
        both *= np.concatenate([taught.each, taught.each])[:, None, None]
    nu, n = TAIL_DEGREES_OF_FREEDOM, taught.total
    information = (both[:, :, None] * both[:, None]).sum(axis=0)
    # The factor of Student's t on Fisher's information.
    return Evidence(_slope(likelihood, 0), information * ((nu + n) / (nu + n + 2.0)))


def _slope(of_star: FloatArray, axis: int) -> FloatArray:
    """Return the derivatives by the log scales of values of a star's filters, along an axis."""
    before = (slice(None),) * axis
    difference = of_star[(*before, slice(1, None, 2))] - of_star[(*before, slice(2, None, 2))]
    return difference / (2.0 * NEIGHBOR_STEP)
