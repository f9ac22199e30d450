"""Limits between which double precision holds what the filter promises."""

SMALLEST_STD = 1e-4
"""No sensor and no wheel is better than this (m, rad)."""
LARGEST_STD = 1e3
"""None is worse (m, rad)."""
LARGEST_POSE_STD = (1e3, 1e3, 10.0)
"""A pose known worse than this is not known at all; its covariance grows no further (m, m, rad)."""
CORRELATION_MARGIN = 1e-12
"""So far from singular is the correlation of a pose that is nearly lost: its variances are up to
1e14 times those of the best sensor, and rounding alone would make it indefinite."""
LARGEST_POSITION = 1e8
"""Larger coordinates are a wrong unit or a broken message [m]."""
SMALLEST_CORRELATION_EIGENVALUE = 1e-6
"""A covariance whose correlations come closer to being singular is a broken message."""
