# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The chi-square distribution for whole degrees of freedom, in closed form."""

import math


def upper_tail(value: float, degrees_of_freedom: int) -> float:
    """Return the probability that a chi-square variable exceeds a value.

    From Q(x; n + 2) = Q(x; n) + (x/2)^(n/2) e^(-x/2) / Gamma(n/2 + 1), with
    Q(x; 1) = erfc(sqrt(x/2)) and Q(x; 2) = e^(-x/2) (Abramowitz and Stegun 1964, 26.4.4-8).
    """
    if value <= 0.0:
        return 1.0
    half = 0.5 * value
    odd = degrees_of_freedom % 2
    tail = math.erfc(math.sqrt(half)) if odd else math.exp(-half)
    for n in range(2 - odd, degrees_of_freedom, 2):
        tail += math.exp(0.5 * n * math.log(half) - half - math.lgamma(0.5 * n + 1.0))
    return tail


def exceeded_with(probability: float, degrees_of_freedom: int) -> float:
    """Return the value that a chi-square variable exceeds with a probability; infinite for 0."""
    if probability <= 0.0:
        return math.inf
    low, high = 0.0, 1.0
    while upper_tail(high, degrees_of_freedom) > probability:
        low, high = high, 2.0 * high
    while high - low > 1e-12 * high:
        middle = 0.5 * (low + high)
        if not low < middle < high:
            break
        if upper_tail(middle, degrees_of_freedom) > probability:
            low = middle
        else:
            high = middle
    return high
