# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Steepest descent on a network's parameters (Nguyen et al., eqs. 23 and 24).

    E_k = (z_k - t_k)^2 / 2                                                     (23)
    p <- p - eta dE/dp,   E = mean of E_k,   dE/dp = mean of (z_k - t_k) dz_k/dp   (24)

with the network's output z_k for input k, the target t_k and every parameter p. The paper does not
say whether p is changed after each pair or after all of them. Here it is changed after all: the
result does not depend on the order of the pairs, and with a small rate the loss decreases. The
means may be weighted.

One rate is used for all parameters, so the caller has to scale inputs and outputs to order 1. The
network is given by its output and its gradient as functions of a vector of parameters.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from fnn_ekf_ros.core.arrays import FloatArray


@dataclass(frozen=True, slots=True)
class LearningNetwork:
    """A network with a vector p `(m,)` of parameters.

    Attributes:
        output: takes p and inputs `(n, ...)`, returns outputs `(n,)`.
        gradient: takes the same, returns the derivatives `(m, n)` of the outputs with respect to p.
        feasible: takes p, returns the nearest valid parameters.
    """

    output: Callable[[FloatArray, FloatArray], FloatArray]
    gradient: Callable[[FloatArray, FloatArray], FloatArray]
    feasible: Callable[[FloatArray], FloatArray]


class Epoch(NamedTuple):
    """The parameters after some steps of descent.

    Attributes:
        parameters: `(m,)` p.
        loss: E of these parameters.
    """

    parameters: FloatArray
    loss: float


def descend(
    network: LearningNetwork,
    start: FloatArray,
    inputs: FloatArray,
    targets: FloatArray,
    rate: float,
    weight: FloatArray | None = None,
) -> Iterator[Epoch]:
    """Yield the start, then the parameters after each step, without end.

    Args:
        network: the network that learns.
        start: `(m,)` parameters to start from; not changed.
        inputs: `(n, ...)` of the training set.
        targets: `(n,)` of the training set.
        rate: eta.
        weight: `(n,)` of the pairs, with the sum 1; None for equal ones.
    """

    def mean(of_pairs: FloatArray) -> FloatArray:
        if weight is None:
            return np.asarray(np.mean(of_pairs, axis=-1))
        return np.asarray(of_pairs @ weight)

    p = np.asarray(start, dtype=np.float64)
    while True:
        with np.errstate(all="ignore"):  # a rate far too large overflows, which shows in the loss
            excess = network.output(p, inputs) - targets
            loss = 0.5 * float(mean(excess**2))
        yield Epoch(p, loss)
        slope = mean(excess * network.gradient(p, inputs))
        p = network.feasible(p - rate * slope)
