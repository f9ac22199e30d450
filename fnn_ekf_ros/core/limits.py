# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Limits within which double precision suffices for the filter."""

SMALLEST_STD = 1e-4
"""Smallest standard deviation of any sensor or wheel (m, rad): none is more precise."""
LARGEST_STD = 1e3
"""Largest standard deviation of any sensor or wheel (m, rad): none is less precise."""
LARGEST_POSE_STD = (1e3, 1e3, 10.0)
"""Largest standard deviations of x, y and yaw (m, m, rad): a pose with these is unknown, and its
covariance grows no further."""
CORRELATION_MARGIN = 1e-12
"""Smallest eigenvalue of the correlation of a pose that is nearly unknown: its variances are up to
1e14 times those of the most precise sensor, and rounding would make it indefinite."""
LARGEST_POSITION = 1e8
"""Largest coordinate [m]: larger ones are a wrong unit or a corrupt message."""
SMALLEST_CORRELATION_EIGENVALUE = 1e-6
"""Smallest eigenvalue of the correlation of a covariance from outside: with a smaller one the
message is taken for corrupt."""
