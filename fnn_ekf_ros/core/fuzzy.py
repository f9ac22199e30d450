# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The fuzzy neural network from mismatch to noise change (Nguyen et al., eqs. 17-24).

Input is the mismatch D = S - C_hat of one axis, output the change dR of its noise variance, both
in the unit of the membership sets (mm^2 and mrad^2 for the paper's). The rules:

    D is N(egative) -> dR is I(ncrease)     alpha_1 = N(D)    z_1 = I^-1(alpha_1)
    D is Z(ero)     -> dR is M(aintain)     alpha_2 = Z(D)    z_2 = M^-1(alpha_2)
    D is P(ositive) -> dR is D(ecrease)     alpha_3 = P(D)    z_3 = D^-1(alpha_3)

    beta_k = alpha_k / sum(alpha),   dR = sum beta_k z_k                       (20)-(22)

with sigmoids 1 / (1 + exp(-a (x - b))) and Gaussians exp(-(x - c)^2 / (2 sigma^2)) (17). As the
paper prints them, P falls and N rises with its argument: the printed pair fits the argument
x = C_hat - S = -D, and that is what the sets are evaluated at here.

A sigmoid antecedent into a sigmoid consequent is exactly linear, I^-1(N(x)) = b_I + (a_N/a_I)
(x - b_N). This closed form is used because the logarithm of the paper's form overflows far from the
center. M^-1 has two values; the branch M^-1(Z(x)) = c_M + (sigma_M/sigma_Z) (x - c_Z) makes all
three rules linear. A consequent of slope 0 (the initial D) has no inverse; its center is taken.
"""

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from fnn_ekf_ros.core.arrays import Constant, FloatArray

_FAR = 1e100
"""Largest distance from a Gaussian's center that is distinguished [widths]: its square does not
overflow."""


class FuzzySets(NamedTuple):
    """The six membership functions; the letters are the paper's.

    Attributes:
        positive_slope: a1 of P, the antecedent "S is larger than the innovations show".
        positive_center: b1 of P.
        negative_slope: a2 of N, the antecedent "S is smaller".
        negative_center: b2 of N.
        decrease_slope: a3 of D, the consequent "decrease the noise"; 0 means a crisp D at b3.
        decrease_center: b3 of D.
        increase_slope: a4 of I, the consequent "increase the noise"; not 0.
        increase_center: b4 of I.
        maintain_center: c1 of M, the consequent "leave the noise".
        maintain_width: sigma1 of M, at least 0; 0 means a crisp M at c1.
        zero_center: c2 of Z, the antecedent "S is right".
        zero_width: sigma2 of Z, more than 0.
    """

    positive_slope: float
    positive_center: float
    negative_slope: float
    negative_center: float
    decrease_slope: float
    decrease_center: float
    increase_slope: float
    increase_center: float
    maintain_center: float
    maintain_width: float
    zero_center: float
    zero_width: float


class Inference(NamedTuple):
    """The output of the network; the first axis is that of the rules I, M, D.

    Attributes:
        change: `(...)` dR in the sets' unit.
        firing_strength: `(3, ...)` alpha, each in [0, 1].
        normalized_firing: `(3, ...)` beta, sums to 1.
        consequent: `(3, ...)` z, each rule's own dR.
    """

    change: FloatArray
    firing_strength: FloatArray
    normalized_firing: FloatArray
    consequent: FloatArray


def sigmoid(x: FloatArray, slope: float, center: float) -> FloatArray:
    """Return the sigmoid membership 1 / (1 + exp(-a (x - b))) without overflow (eq. 17)."""
    return np.exp(_log_sigmoid(x, slope, center))


def gaussian(x: FloatArray, center: float, width: float) -> FloatArray:
    """Return the Gaussian membership exp(-(x - c)^2 / (2 sigma^2)) (eq. 17); crisp if sigma = 0."""
    if width == 0.0:
        return np.where(x == center, 1.0, 0.0)
    return np.exp(_log_gaussian(x, center, width))


def infer(sets: FuzzySets, mismatch: FloatArray) -> Inference:
    """Run the five layers on mismatches (eqs. 19-22, Tsukamoto's inference).

    Args:
        sets: the membership functions.
        mismatch: `(...)` D = S - C_hat in the sets' unit.
    """
    x = -mismatch
    log_alpha = _log_firing(sets, x)
    # Normalized in logarithms: far from all sets, the nearest one decides.
    beta = np.exp(log_alpha - log_alpha.max(axis=0))
    beta /= beta.sum(axis=0)
    z = _consequents(sets, x)
    return Inference(
        change=(beta * z).sum(axis=0),
        firing_strength=np.exp(log_alpha),
        normalized_firing=beta,
        consequent=z,
    )


def infer_gradient(sets: FuzzySets, mismatch: FloatArray) -> FloatArray:
    """Return the derivatives of the network's output with respect to its parameters (for eq. 24).

        d dR/dp = sum_k beta_k ( (z_k - dR) dln(alpha_k)/dp + dz_k/dp )

    Args:
        sets: the membership functions.
        mismatch: `(...)` D in the sets' unit.

    Returns:
        `(12, ...)`, in the order of `FuzzySets`. Where D is crisp (slope 0) the derivative with
        respect to its slope is 0: there is no inverse to differentiate.
    """
    x = -mismatch
    s = sets
    output = infer(sets, mismatch)
    beta, z, dR = output.normalized_firing, output.consequent, output.change
    weight_i, weight_m, weight_d = beta * (z - dR)
    beta_i, beta_m, beta_d = beta

    p_rest = sigmoid(x, -s.positive_slope, s.positive_center)  # 1 - P
    n_rest = sigmoid(x, -s.negative_slope, s.negative_center)  # 1 - N
    from_p, from_n = x - s.positive_center, x - s.negative_center
    from_z = np.clip(x - s.zero_center, -_FAR, _FAR)
    zeros = np.zeros_like(x)
    crisp_d = s.decrease_slope == 0.0
    a3 = 1.0 if crisp_d else s.decrease_slope
    live_d = zeros if crisp_d else beta_d
    ratio_m = s.maintain_width / s.zero_width

    return np.stack(
        [
            weight_d * p_rest * from_p + live_d * from_p / a3,
            -weight_d * p_rest * s.positive_slope - live_d * s.positive_slope / a3,
            weight_i * n_rest * from_n + beta_i * from_n / s.increase_slope,
            -weight_i * n_rest * s.negative_slope - beta_i * s.negative_slope / s.increase_slope,
            -live_d * s.positive_slope * from_p / a3**2,
            beta_d,
            -beta_i * s.negative_slope * from_n / s.increase_slope**2,
            beta_i,
            beta_m,
            beta_m * from_z / s.zero_width,
            weight_m * from_z / s.zero_width**2 - beta_m * ratio_m,
            weight_m * from_z**2 / s.zero_width**3 - beta_m * ratio_m * from_z / s.zero_width,
        ]
    )


def infer_centroid(
    sets: FuzzySets, mismatch: FloatArray, change_limit: float, points: int = 201
) -> Inference:
    """Run the plain fuzzy system: clipped consequents, centroid defuzzification (eq. 18).

        dR = sum z mu(z) / sum mu(z),   mu(z) = max_k min(alpha_k, consequent_k(z))

    Args:
        sets: the membership functions.
        mismatch: `(...)` D in the sets' unit.
        change_limit: half width of the universe of dR [the sets' unit]; the paper does not give
            it, and sigmoid consequents have no centroid without one.
        points: samples of the universe.
    """
    alpha = np.exp(_log_firing(sets, -mismatch))
    z = np.linspace(-change_limit, change_limit, points)
    narrowest = 2.0 * change_limit / (points - 1)  # a crisp set would fall between two samples
    if sets.decrease_slope == 0.0:
        decrease = gaussian(z, sets.decrease_center, narrowest)
    else:
        decrease = sigmoid(z, sets.decrease_slope, sets.decrease_center)
    consequents = np.stack(
        [
            sigmoid(z, sets.increase_slope, sets.increase_center),
            gaussian(z, sets.maintain_center, max(sets.maintain_width, narrowest)),
            decrease,
        ]
    )
    clipped = np.minimum(alpha[..., None], consequents.reshape(3, *(1,) * (alpha.ndim - 1), -1))
    mu = np.max(clipped, axis=0)
    change = _weighted_mean(z, mu)
    consequent = _weighted_mean(z, clipped)
    total = np.sum(alpha, axis=0)
    beta = np.where(total > 0.0, alpha, 1.0) / np.where(total > 0.0, total, len(alpha))
    return Inference(
        change=change, firing_strength=alpha, normalized_firing=beta, consequent=consequent
    )


def _weighted_mean(z: FloatArray, weight: FloatArray) -> FloatArray:
    total = np.sum(weight, axis=-1)
    return np.asarray(
        np.sum(z * weight, axis=-1) / np.where(total > 0.0, total, 1.0), dtype=np.float64
    )


def _log_sigmoid(x: FloatArray, slope: float, center: float) -> FloatArray:
    return np.asarray(-np.logaddexp(0.0, -slope * (x - center)), dtype=np.float64)


def _log_gaussian(x: FloatArray, center: float, width: float) -> FloatArray:
    return -0.5 * np.clip((x - center) / width, -_FAR, _FAR) ** 2


def _log_firing(sets: FuzzySets, x: FloatArray) -> FloatArray:
    linear = _linear(sets)
    log_alpha = np.empty((3, *x.shape))
    steepness, center = linear.steepness.behind(x.ndim), linear.center.behind(x.ndim)
    np.logaddexp(0.0, -steepness * (x - center), out=log_alpha[::2])
    np.negative(log_alpha[::2], out=log_alpha[::2])
    log_alpha[1] = _log_gaussian(x, sets.zero_center, sets.zero_width)
    return log_alpha


def _consequents(sets: FuzzySets, x: FloatArray) -> FloatArray:
    linear = _linear(sets)
    z = linear.slope.behind(x.ndim) * (x - linear.origin.behind(x.ndim))
    z += linear.level.behind(x.ndim)
    return z


class _Linear(NamedTuple):
    """The sets as arrays: sigmoids N and P, and z = level + slope (x - origin) of each rule."""

    steepness: Constant
    center: Constant
    slope: Constant
    origin: Constant
    level: Constant


@lru_cache(maxsize=64)
def _linear(sets: FuzzySets) -> _Linear:
    crisp = sets.decrease_slope == 0.0
    return _Linear(
        steepness=Constant([sets.negative_slope, sets.positive_slope]),
        center=Constant([sets.negative_center, sets.positive_center]),
        slope=Constant(
            [
                sets.negative_slope / sets.increase_slope,
                sets.maintain_width / sets.zero_width,
                0.0 if crisp else sets.positive_slope / sets.decrease_slope,
            ]
        ),
        origin=Constant([sets.negative_center, sets.zero_center, sets.positive_center]),
        level=Constant([sets.increase_center, sets.maintain_center, sets.decrease_center]),
    )
