# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The one place where angles are wrapped."""

import math

import numpy as np

from fnn_ekf_ros.core.arrays import FloatArray


def wrap_angle(angle: FloatArray | float) -> FloatArray:
    """Wrap angles to (-pi, pi].

    Args:
        angle: any shape [rad].

    Returns:
        The equivalent angles in (-pi, pi], same shape; angles already inside are unchanged.
    """
    a = np.asarray(angle, dtype=np.float64)
    # The remainder would round; angles inside the interval are not changed by it.
    inside = (a > -math.pi) & (a <= math.pi)
    if inside.all():
        return a
    wrapped = -(np.remainder(np.pi - a, 2.0 * np.pi) - np.pi)
    wrapped = np.where(wrapped <= -np.pi, np.pi, wrapped)  # rounding can reach the open end
    return np.asarray(np.where(inside, a, wrapped), dtype=np.float64)
