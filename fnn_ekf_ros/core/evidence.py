"""What neighbouring filters say about the noise: likelihood, score and information.

A star of filters is run beside one with noise exp(theta): for each of the four log scales
theta_i (way, turn, fixes, yaw) one neighbour at theta_i + h and one at theta_i - h. How much
better the one predicts a measurement than the other is the score, and how differently they
predict it is the information a measurement holds about the scale (Fisher's, Gauss-Newton form):

    d_i  = (l_i+ - l_i-) / 2h
    i_ij = sum over rows of  1/2 s_i s_j + g_i g_j
           s_i = (log S_i+ - log S_i-) / 2h,   g_i = (r_i+ - r_i-) / (2h sqrt(S))

The first term is the mismatch's share, the second the whiteness': it tells a gain that is too
large from noise that is (Gupta and Mehra 1974 have the same two terms).

The likelihood is Student's t (nu degrees of freedom) on the normalised innovation squared e,

    l = -1/2 log det S - (nu + n)/2 log(1 + e / c)

which lets one wild fix say only so much. c makes the expected score of Gaussian innovations 0:
(nu + n) E[e / (c + e)] = n for e ~ chi-square(n). Without it R would be learned too large.
"""

from typing import NamedTuple

import numpy as np

from fnn_ekf_ros.core.angles import wrap_angle
from fnn_ekf_ros.core.arrays import FloatArray, Row
from fnn_ekf_ros.core.kalman import Innovation

SCALES = ("forward", "heading", "position", "yaw")
"""The log scales: Q of way and turn, R of the fixes' position, R of compass and fixes' yaw."""
SCALE_COUNT = len(SCALES)
NEIGHBOUR_STEP = 0.25
"""h, in log variance: neighbours 25 % apart. With 1 the differences would be biased by sinh(1)."""
TAIL_DEGREES_OF_FREEDOM = 8.0
"""nu."""
CONSISTENT_SCALE = (1.0, 6.4929, 6.6099, 6.7111, 6.7994)
"""c for n = 0 ... 4 rows."""
STAR_SIZE = 1 + 2 * SCALE_COUNT
STAR: FloatArray = NEIGHBOUR_STEP * np.concatenate(
    [np.zeros((1, SCALE_COUNT)), np.kron(np.eye(SCALE_COUNT), [[1.0], [-1.0]])]
)
"""`(9, 4)` offsets in theta: the centre, then + and - of each scale."""


class Evidence(NamedTuple):
    """What one measurement says about the log scales.

    Attributes:
        log_likelihood: `(...)` of the star's centre.
        score: `(..., 4)` derivative of the log likelihood by the log scales.
        information: `(..., 4, 4)` its expected curvature, but for what the tails take from
            several rows together; positive semidefinite.
    """

    log_likelihood: FloatArray
    score: FloatArray
    information: FloatArray


def log_likelihood(seen: Innovation) -> FloatArray:
    """Return the heavy-tailed log likelihood `(...)` of innovations; 0 where nothing was seen."""
    n = seen.degrees_of_freedom
    c = np.asarray(CONSISTENT_SCALE)[n.astype(np.int64)]
    log_determinant = np.linalg.slogdet(seen.innovation_covariance)[1]
    tail = (TAIL_DEGREES_OF_FREEDOM + n) * np.log1p(seen.nis / c)
    return np.asarray(-0.5 * np.where(n > 0.0, log_determinant + tail, 0.0))


def star_evidence(seen: Innovation) -> Evidence:
    """Return what a star's innovations say; their last batch axis is `STAR`'s."""
    likelihood = log_likelihood(seen)
    S = np.diagonal(seen.innovation_covariance, axis1=-2, axis2=-1)
    share = _slope(np.log(S))
    r = seen.innovation
    lead = _difference(r)
    lead = np.concatenate(
        [lead[..., : Row.COMPASS_YAW], wrap_angle(lead[..., Row.COMPASS_YAW :])], axis=-1
    ) / (2.0 * NEIGHBOUR_STEP * np.sqrt(S[..., :1, :]))
    n = seen.degrees_of_freedom[..., 0]
    nu = TAIL_DEGREES_OF_FREEDOM
    information = 0.5 * share @ np.swapaxes(share, -1, -2) + lead @ np.swapaxes(lead, -1, -2)
    return Evidence(
        log_likelihood=likelihood[..., 0],
        score=_slope(likelihood[..., None])[..., 0],
        # Fisher's information of Student's t is smaller by this factor.
        information=information * ((nu + n) / (nu + n + 2.0))[..., None, None],
    )


def side_by_side(one: Innovation, other: Innovation) -> Innovation:
    """Return two stars' innovations as one batch `(..., 2, 9)`."""
    return Innovation(
        np.stack([one.innovation, other.innovation], axis=-3),
        np.stack([one.innovation_covariance, other.innovation_covariance], axis=-4),
        np.stack([one.kalman_gain, other.kalman_gain], axis=-4),
        np.stack([one.nis, other.nis], axis=-2),
        np.stack([one.degrees_of_freedom, other.degrees_of_freedom], axis=-2),
    )


def filters_of(seen: Innovation, filters: slice) -> Innovation:
    """Return the innovations of some filters of the last batch axis."""
    return Innovation(
        seen.innovation[..., filters, :],
        seen.innovation_covariance[..., filters, :, :],
        seen.kalman_gain[..., filters, :, :],
        seen.nis[..., filters],
        np.broadcast_to(seen.degrees_of_freedom, seen.nis.shape)[..., filters],
    )


def _difference(of_star: FloatArray) -> FloatArray:
    """Return + minus - for each scale: `(..., 9, m)` to `(..., 4, m)`."""
    return of_star[..., 1::2, :] - of_star[..., 2::2, :]


def _slope(of_star: FloatArray) -> FloatArray:
    return _difference(of_star) / (2.0 * NEIGHBOUR_STEP)
