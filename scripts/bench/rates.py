# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Periods of the filter and of the robot's sensors; without imports, for the bare node."""

PERIOD_NS = 375_000_000
"""The filter's period [ns]."""
STEP_NS = 20_000_000
"""Interval of the ticks of each wheel [ns]: 50 Hz."""
EVERY_COMPASS, EVERY_FIX = 5, 10
"""Intervals of the compass and of the fixes [steps]: 10 Hz and 5 Hz."""
