# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The limits of adapted noise."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from fnn_ekf_ros.core.arrays import Constant, FloatArray


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
        low_Q, high_Q, low_R, high_R = _limits(self)
        n = Q.ndim - 1
        return (
            np.minimum(np.maximum(Q, low_Q.behind(n)), high_Q.behind(n)),
            np.minimum(np.maximum(R, low_R.behind(n)), high_R.behind(n)),
        )

    def all_limits(self) -> tuple[Constant, Constant]:
        """Return the smallest and the largest variances `(6,)`, of Q and then of R."""
        return _all_limits(self)


@lru_cache(maxsize=64)
def _all_limits(bounds: NoiseBounds) -> tuple[Constant, Constant]:
    return (
        Constant((*bounds.process_min, *bounds.measurement_min)),
        Constant((*bounds.process_max, *bounds.measurement_max)),
    )


@lru_cache(maxsize=64)
def _limits(bounds: NoiseBounds) -> tuple[Constant, Constant, Constant, Constant]:
    return (
        Constant(bounds.process_min),
        Constant(bounds.process_max),
        Constant(bounds.measurement_min),
        Constant(bounds.measurement_max),
    )
