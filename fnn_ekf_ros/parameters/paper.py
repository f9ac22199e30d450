# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The paper's numbers that are defaults of more than one executable (Nguyen et al.)."""

import math

WHEEL_RADIUS = 0.025
"""Radius of the wheels, D / 2 [m]."""
WHEEL_SEPARATION = 0.6
"""Distance between the wheels' contact points, L [m]."""
ENCODER_COUNTS_PER_REVOLUTION = 500.0
"""Counts per revolution of an encoder, C_e."""
SIMULATION_1_STD = (0.02, math.radians(1.0))
"""Standard deviations of distance and rotation in simulation 1, per 375 ms (m, rad)."""
SIMULATION_2_STD = (0.05, math.radians(3.0))
"""Standard deviations of distance and rotation in simulation 2 and the experiment, per 375 ms (m,
rad)."""
MEASUREMENT_STD = (0.1, 0.1, math.sqrt(0.018))
"""Standard deviations of x and y (laser) and theta (compass), the roots of eq. (25)'s R, diag(0.01
m^2, 0.01 m^2, 0.018 rad^2) (m, m, rad)."""
YAW_STD = MEASUREMENT_STD[2]
"""Standard deviation of every yaw [rad]."""
