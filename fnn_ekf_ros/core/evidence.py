"""What neighbouring filters say about the noise: likelihood, score and information.

A star of filters is run beside one with noise exp(theta): for each of the four log scales
theta_i (way, turn, fixes, yaw) one neighbour at theta_i + h and one at theta_i - h. How much
better the one predicts a measurement than the other is the score, and how differently they
predict it is the information a measurement holds about the scale (Fisher's, Gauss-Newton form):

    d_i  = (l_i+ - l_i-) / 2h
    i_ij = (nu + n)/(nu + n + 2) sum over rows of  1/2 s_i s_j + g_i g_j
           s_i = (log S_i+ - log S_i-) / 2h,   g_i = (r_i+ - r_i-) / (2h sqrt(S))

The first term is the mismatch's share, the second the whiteness': it tells a gain that is too
large from noise that is (Gupta and Mehra 1974 have the same two terms).

The likelihood is Student's t (nu degrees of freedom) on the normalised innovation squared e,

    l = -1/2 log det S - (nu + n)/2 log(1 + e / c)

which lets one wild fix say only so much. c makes the expected score of Gaussian innovations 0:
(nu + n) E[e / (c + e)] = n for e ~ chi-square(n). Without it R would be learned too large.
"""

import math
from typing import NamedTuple

import numpy as np

from fnn_ekf_ros.core.angles import wrap_angle
from fnn_ekf_ros.core.arrays import FloatArray, Row
from fnn_ekf_ros.core.rows import Rows

SCALES = ("forward", "heading", "position", "yaw")
"""The log scales: Q of way and turn, R of the fixes' position, R of compass and fixes' yaw."""
SCALE_COUNT = len(SCALES)
NEIGHBOUR_STEP = 0.25
"""h, in log variance: neighbours 25 % apart. With 1 the differences would be biased by sinh(1)."""
TAIL_DEGREES_OF_FREEDOM = 8.0
"""nu."""
CONSISTENT_SCALE: FloatArray = np.array([1.0, 6.4929, 6.6099, 6.7111, 6.7994])
"""c for n = 0 ... 4 rows."""
STAR_SIZE = 1 + 2 * SCALE_COUNT
STAR: FloatArray = NEIGHBOUR_STEP * np.concatenate(
    [np.zeros((SCALE_COUNT, 1)), np.kron(np.eye(SCALE_COUNT), [1.0, -1.0])], axis=1
)
"""`(4, 9)` offsets in theta: the centre, then + and - of each scale."""


class Evidence(NamedTuple):
    """What one measurement says about the log scales.

    Attributes:
        score: `(4, ...)` derivative of the log likelihood by the log scales.
        information: `(4, 4, ...)` its expected curvature, but for what the tails take from
            several rows together; positive semidefinite.
    """

    score: FloatArray
    information: FloatArray


def log_likelihood(nis: FloatArray, determinant: FloatArray, rows: FloatArray) -> FloatArray:
    """Return the heavy-tailed log likelihood `(...)` of readings; 0 where nothing was read.

    Args:
        nis: `(...)` e; 0 where nothing was read.
        determinant: `(...)` det S; 1 where nothing was read.
        rows: n, how many rows; broadcasts against the others.
    """
    c = CONSISTENT_SCALE[rows.astype(np.intp)]
    return -0.5 * (np.log(determinant) + (TAIL_DEGREES_OF_FREEDOM + rows) * np.log1p(nis / c))


def star_evidence(
    innovation: FloatArray,
    variance: FloatArray,
    likelihood: FloatArray,
    taught: Rows,
) -> Evidence:
    """Return what the stars of L learners say, `(4, L, *batch)` and `(4, 4, L, *batch)`.

    Args:
        innovation: `(4, 9, L, *batch)` r, 0 where not available; filters as in `STAR`.
        variance: `(4, 9, L, *batch)` diagonal of S.
        likelihood: `(9, L, *batch)` of all rows together.
        taught: which rows are learned from.
    """
    share = _slope(np.log(variance), 1)
    lead = innovation[:, 1::2] - innovation[:, 2::2]
    lead[Row.COMPASS_YAW :] = wrap_angle(lead[Row.COMPASS_YAW :])
    lead /= 2.0 * NEIGHBOUR_STEP * np.sqrt(variance[:, :1])
    share *= math.sqrt(0.5)
    both = np.concatenate([share, lead])
    if not taught.each.all():
        both *= np.concatenate([taught.each, taught.each])[:, None, None]
    nu, n = TAIL_DEGREES_OF_FREEDOM, taught.total
    information = (both[:, :, None] * both[:, None]).sum(axis=0)
    # Fisher's information of Student's t is smaller by this factor.
    return Evidence(_slope(likelihood, 0), information * ((nu + n) / (nu + n + 2.0)))


def _slope(of_star: FloatArray, axis: int) -> FloatArray:
    before = (slice(None),) * axis
    difference = of_star[(*before, slice(1, None, 2))] - of_star[(*before, slice(2, None, 2))]
    return difference / (2.0 * NEIGHBOUR_STEP)
