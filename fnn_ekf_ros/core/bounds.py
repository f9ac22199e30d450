# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The limits of adapted noise."""

from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from fnn_ekf_ros.core.arrays import Constant, FloatArray


class Limits(NamedTuple):
    """Smallest and largest variances.

    Attributes:
        smallest: `(n,)` (m^2 or rad^2).
        largest: `(n,)` (m^2 or rad^2).
    """

    smallest: Constant
    largest: Constant

    def clipped(self, variances: FloatArray) -> FloatArray:
        """Return variances `(n, ...)` clipped to the limits."""
        behind = variances.ndim - 1
        return np.minimum(
            np.maximum(variances, self.smallest.behind(behind)), self.largest.behind(behind)
        )


@dataclass(frozen=True, slots=True)
class NoiseBounds:
    """Limits of adapted noise as variances, all more than 0.

    Attributes:
        process_min: smallest diagonal of Q, distance and rotation (m^2, rad^2).
        process_max: largest diagonal of Q.
        measurement_min: smallest diagonal of R, rows as in `Row` (m^2, m^2, rad^2, rad^2).
        measurement_max: largest diagonal of R.
    """

    process_min: tuple[float, float]
    process_max: tuple[float, float]
    measurement_min: tuple[float, float, float, float]
    measurement_max: tuple[float, float, float, float]

    def within(self, Q: FloatArray, R: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return Q `(2, ...)` and R `(4, ...)` clipped to the limits."""
        return _process_limits(self).clipped(Q), _measurement_limits(self).clipped(R)

    def all_limits(self) -> Limits:
        """Return the limits `(6,)` of Q and then of R."""
        return _all_limits(self)


@lru_cache(maxsize=64)
def _all_limits(bounds: NoiseBounds) -> Limits:
    return Limits(
        smallest=Constant((*bounds.process_min, *bounds.measurement_min)),
        largest=Constant((*bounds.process_max, *bounds.measurement_max)),
    )


@lru_cache(maxsize=64)
def _process_limits(bounds: NoiseBounds) -> Limits:
    return Limits(smallest=Constant(bounds.process_min), largest=Constant(bounds.process_max))


@lru_cache(maxsize=64)
def _measurement_limits(bounds: NoiseBounds) -> Limits:
    return Limits(
        smallest=Constant(bounds.measurement_min), largest=Constant(bounds.measurement_max)
    )
