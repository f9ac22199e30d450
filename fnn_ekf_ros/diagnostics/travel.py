# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Distance and rotation of the pose, over what the wheels count.

Compass and fixes lead the pose to where the robot is even if the wheels are configured wrong, and
adaptation takes what is left for noise. So the pose is compared with the wheels over windows of
time that are long against the time in which measurements correct it. With x by the wheels and y by
the pose in each window (the rotation; the displacement as a vector, along the pose's yaw), the
ratio and its standard deviation are those of least squares through the origin,

    ratio = sum x.y / sum x.x,    std^2 = sum |y - ratio x|^2 / ((n - 1) sum x.x).

An error of the pose at the end of a window is one at the begin of the next, with the other sign, so
that the standard deviation is rather too large. This finds gross errors only: a driver that steers
against slip makes the ratio of rotations too small, by up to 15 %.
"""

import math
from typing import NamedTuple

import numpy as np

from fnn_ekf_ros.core.angles import wrap_angle
from fnn_ekf_ros.core.arrays import FloatArray
from fnn_ekf_ros.timeline.events import Estimate

WINDOW_S = 10.0
"""Length of a window [s]: measurements correct a pose within a few seconds."""
FEWEST_WINDOWS = 4
"""Number of windows from which on there is a ratio: less do not tell its standard deviation."""
LARGEST_ERROR = 0.25
"""Difference of a ratio from 1 up to which wheels may be right: real robots that slip, or whose
drivers steer against slip, stay below it."""
SIGMAS = 4.0
"""Significance from which on a ratio is wrong, in standard deviations: those of five windows, with
Student's t of 4 degrees of freedom, exceed it once in 62 times, most of them within
`LARGEST_ERROR`."""


class TravelRatio(NamedTuple):
    """The pose's distance or rotation over that of the wheels.

    Attributes:
        ratio: 1 where the wheels are configured right.
        std: its standard deviation.
        explained: share of the pose's travel that the wheels explain with this ratio, 0 to 1.
    """

    ratio: float
    std: float
    explained: float

    @property
    def wrong(self) -> bool:
        """Whether the wheels cannot be configured right."""
        error = abs(self.ratio - 1.0)
        return error > LARGEST_ERROR and error > SIGMAS * self.std


class TravelRatios(NamedTuple):
    """Both ratios; None where the robot did not travel far enough, or not long enough."""

    distance: TravelRatio | None
    rotation: TravelRatio | None


class _Sums:
    """Sums over windows."""

    def __init__(self) -> None:
        self.count = 0
        self.xx = self.xy = self.yy = 0.0

    def add(self, x: FloatArray, y: FloatArray) -> None:
        self.count += 1
        self.xx += float(x @ x)
        self.xy += float(x @ y)
        self.yy += float(y @ y)

    def ratio(self) -> TravelRatio | None:
        if self.count < FEWEST_WINDOWS or self.xx <= 0.0:
            return None
        ratio = self.xy / self.xx
        left = max(self.yy - ratio * self.xy, 0.0)
        return TravelRatio(
            ratio=ratio,
            std=math.sqrt(left / ((self.count - 1) * self.xx)),
            explained=1.0 - left / self.yy if self.yy > 0.0 else 0.0,
        )


class _Window:
    """A window that is open.

    Args:
        begin: the estimate at its begin.
    """

    def __init__(self, begin: Estimate) -> None:
        self.begin_ns = begin.stamp_ns
        self.begin_position = begin.state.mean[:2]
        self.wheel_rotation = self.rotation = 0.0
        self.wheel_displacement = np.zeros(2)

    def add(self, before: Estimate, after: Estimate) -> None:
        """Count a period."""
        period_s = (after.stamp_ns - before.stamp_ns) * 1e-9
        distance, rotation = after.twist * period_s
        turned = float(wrap_angle(after.state.mean[2] - before.state.mean[2]))
        middle = before.state.mean[2] + 0.5 * turned
        self.wheel_rotation += float(rotation)
        self.rotation += turned
        self.wheel_displacement += distance * np.array([np.cos(middle), np.sin(middle)])


class Travel:
    """Compares the pose with the wheels, estimate by estimate.

    Args:
        period_s: time between two estimates [s].
    """

    def __init__(self, period_s: float) -> None:
        self._period_ns = round(period_s * 1e9)
        self._distance, self._rotation = _Sums(), _Sums()
        self._last: Estimate | None = None
        self._window: _Window | None = None

    def saw(self, estimate: Estimate, *, moved: bool) -> None:
        """Count a period.

        Args:
            estimate: at its end.
            moved: whether the pose was moved to another place, which is no travel.
        """
        last, self._last = self._last, estimate
        if last is None or moved or estimate.stamp_ns - last.stamp_ns != self._period_ns:
            self._window = _Window(estimate)
            return
        if self._window is None:
            self._window = _Window(last)
        self._window.add(last, estimate)
        if (estimate.stamp_ns - self._window.begin_ns) * 1e-9 >= WINDOW_S:
            self._close(self._window, estimate)

    def ratios(self) -> TravelRatios:
        """Return the ratios so far."""
        return TravelRatios(self._distance.ratio(), self._rotation.ratio())

    def _close(self, window: _Window, end: Estimate) -> None:
        self._rotation.add(np.array([window.wheel_rotation]), np.array([window.rotation]))
        self._distance.add(window.wheel_displacement, end.state.mean[:2] - window.begin_position)
        self._window = _Window(end)
