"""The paper's numbers that are defaults of more than one executable (Nguyen et al.)."""

import math

WHEEL_RADIUS = 0.025
"""D / 2 [m]."""
WHEEL_SEPARATION = 0.6
"""L [m]."""
ENCODER_COUNTS_PER_REVOLUTION = 500.0
"""C_e."""
SIMULATION_1_STD = (0.02, math.radians(1.0))
"""Noise of way and turn in simulation 1, per 375 ms (m, rad)."""
SIMULATION_2_STD = (0.05, math.radians(3.0))
"""The same in simulation 2 and in the experiment (m, rad)."""
MEASUREMENT_STD = (0.1, 0.1, math.sqrt(0.018))
"""Noise of x, y (laser) and theta (compass), the roots of eq. (25)'s R, diag(0.01 m^2, 0.01 m^2,
0.018 rad^2) (m, m, rad)."""
YAW_STD = MEASUREMENT_STD[2]
"""Noise of every yaw [rad]."""
