"""Periods of the filter and of the robot's sensors; without imports, for the bare node."""

PERIOD_NS = 375_000_000
"""The filter's period."""
STEP_NS = 20_000_000
"""Ticks of each wheel at 50 Hz."""
EVERY_COMPASS, EVERY_FIX = 5, 10
"""In steps: compass at 10 Hz, fixes at 5 Hz."""
