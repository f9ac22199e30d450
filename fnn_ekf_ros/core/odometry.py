# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""From encoder counts to the control input of the filter (Nguyen et al., eqs. 1-3)."""

import math
from dataclasses import dataclass

import numpy as np

from fnn_ekf_ros.core.arrays import FloatArray


@dataclass(frozen=True, slots=True)
class WheelGeometry:
    """Geometry of a differential drive.

    Attributes:
        wheel_radius: nominal radius of both wheels [m]; D / 2.
        wheel_separation: distance between the contact points of the wheels [m]; L.
        gear_ratio: encoder turns per wheel turn; n.
        encoder_counts_per_revolution: counts per encoder turn; C_e.
        left_multiplier: radius of the left wheel over `wheel_radius`.
        right_multiplier: radius of the right wheel over `wheel_radius`.
    """

    wheel_radius: float
    wheel_separation: float
    gear_ratio: float
    encoder_counts_per_revolution: float
    left_multiplier: float = 1.0
    right_multiplier: float = 1.0

    @property
    def meters_per_count(self) -> float:
        """Distance of a rim of `wheel_radius` per count [m] (eq. 1): C_m = pi D / (n C_e)."""
        return (
            2.0 * math.pi * self.wheel_radius
            / (self.gear_ratio * self.encoder_counts_per_revolution)
        )  # fmt: skip

    def rolled(
        self, left_counts: FloatArray | float, right_counts: FloatArray | float
    ) -> tuple[FloatArray | float, FloatArray | float]:
        """Return the distances of the rims of the left and the right wheel [m]."""
        return (
            self.meters_per_count * self.left_multiplier * left_counts,
            self.meters_per_count * self.right_multiplier * right_counts,
        )


def control_from_counts(
    geometry: WheelGeometry, left_counts: FloatArray | float, right_counts: FloatArray | float
) -> FloatArray:
    """Return the wheel increments as the filter's control input (eqs. 2 and 3).

        dS_L = C_m m_L N_L, dS_R = C_m m_R N_R, dS = (dS_L + dS_R) / 2, dtheta = (dS_R - dS_L) / L

    with the multipliers m of the wheels' radii, 1 in the paper.

    Args:
        geometry: the robot's wheels.
        left_counts: counts of the left wheel over the step, `(...)`; fractions allowed.
        right_counts: counts of the right wheel over the step, `(...)`.

    Returns:
        `(2, ...)`: [dS, dtheta], distance of the axle's center [m] and rotation, counter-clockwise
        [rad].
    """
    left, right = geometry.rolled(left_counts, right_counts)
    return np.array([0.5 * (left + right), (right - left) / geometry.wheel_separation])
