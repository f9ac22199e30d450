# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Student-t likelihood of forecasts, with its derivatives by what is tuned.

The reading i of n rows has the innovations e_j after the rows before them, and their variances s_j
(`core.evidence` has the likelihood and its constant c):

    q_i = sum_j e_j^2 / s_j,   l_i = -1/2 sum_j log s_j - (nu + n)/2 log(1 + q_i / c)

Derivatives by coordinates u of the models are differences of the forecasts of two neighbors. With
a_j = d log s_j / du and g_j = (d e_j / du) / sqrt(s_j), the expected curvature for Gaussian
innovations is

    I = sum_j (1/2 - 2 w) a_j a_j' - w (sum_j a_j)(sum_j a_j)' + b sum_j g_j g_j'
    w = (nu + n) / (2 n (n + 2)) E[(q / (c + q))^2]
    b = (nu + n) (E[1 / (c + q)] - 2/n E[q / (c + q)^2])              q ~ chi-square(n)
"""

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from fnn_ekf_ros.core.arrays import FloatArray
from fnn_ekf_ros.core.evidence import CONSISTENT_SCALE, TAIL_DEGREES_OF_FREEDOM, log_likelihood
from fnn_ekf_ros.tuning.forecasts import Items

_NODES = 4000
"""Nodes of the integrals over chi-square, which then are exact to 1e-6."""
_LARGEST_NORM = 12.0
"""Largest norm of a Gaussian vector that the integrals go to [standard deviations]."""


class Evidence(NamedTuple):
    """Log likelihood of K readings, and its derivatives by p coordinates.

    Attributes:
        value: `(K,)` log likelihood [nats].
        score: `(K, p)` its derivative.
        information: `(K, p, p)` summed over K: `(p, p)` its expected curvature.
    """

    value: FloatArray
    score: FloatArray
    information: FloatArray


@lru_cache(maxsize=8)
def curvature_factors(rows: int) -> tuple[float, float]:
    """Return w and b for n rows."""
    nu, n, c = TAIL_DEGREES_OF_FREEDOM, rows, CONSISTENT_SCALE[rows]
    norm = (np.arange(_NODES) + 0.5) * (_LARGEST_NORM / _NODES)
    q = norm * norm
    density = norm ** (n - 1) * np.exp(-0.5 * q)
    density /= density.sum()
    w = (nu + n) / (2.0 * n * (n + 2.0)) * float(density @ (q / (c + q)) ** 2)
    b = (nu + n) * float(density @ (1.0 / (c + q) - 2.0 / n * q / (c + q) ** 2))
    return w, b


def values(items: Items) -> FloatArray:
    """Return the log likelihoods `(K, S)` of readings under each model [nats]."""
    n = items.taken.sum(axis=1)[:, None]
    nis = (items.normalized**2).sum(axis=1)
    # An outage's variances are far from 1; the product of three is still a number.
    return log_likelihood(nis, items.variance.prod(axis=1), n)


def evidence(items: Items, steps: FloatArray, weight: FloatArray) -> Evidence:
    """Return the evidence of readings at the first model of a star of models.

    Args:
        items: forecasts of S = 1 + 2p models: the center, then for each coordinate the neighbors at
            plus and minus its step.
        steps: `(p,)` of the coordinates.
        weight: `(K,)` of the readings.
    """
    likelihood = values(items)
    up, down = slice(1, None, 2), slice(2, None, 2)
    score = (likelihood[:, up] - likelihood[:, down]) / (2.0 * steps)
    log_s = np.log(items.variance)
    a = (log_s[..., up] - log_s[..., down]) / (2.0 * steps)
    innovation = items.normalized * np.sqrt(items.variance)
    g = (innovation[..., up] - innovation[..., down]) / (2.0 * steps)
    g /= np.sqrt(items.variance[..., :1])
    information = np.zeros((len(steps), len(steps)))
    n = items.taken.sum(axis=1)
    for rows in range(1, items.taken.shape[1] + 1):
        some = (n == rows) & (weight > 0.0)
        if not some.any():
            continue
        w, b = curvature_factors(rows)
        root = np.sqrt(weight[some])[:, None]
        by_size, by_mean = root[..., None] * a[some], root[..., None] * g[some]
        together = root * a[some].sum(axis=1)
        p = len(steps)
        by_size, by_mean = by_size.reshape(-1, p), by_mean.reshape(-1, p)
        information += (0.5 - 2.0 * w) * by_size.T @ by_size + b * by_mean.T @ by_mean
        information -= w * together.T @ together
    measured = np.asarray(n > 0.0) * weight
    return Evidence(
        value=likelihood[:, 0] * measured,
        score=score * measured[:, None],
        information=information,
    )


def largest_step(information: FloatArray) -> float:
    """Return the largest standard deviation that an information leaves; infinite if singular."""
    smallest = float(np.linalg.eigvalsh(information)[0])
    return 1.0 / math.sqrt(smallest) if smallest > 0.0 else math.inf
