# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Distances that both wheels have rolled [m], and the robot's motion that follows from them."""

from typing import NamedTuple


class WheelDistances(NamedTuple):
    """Distances of both wheels since counting began, in the order of `Wheel`.

    Attributes:
        left: of the left wheel [m].
        right: of the right wheel [m].
    """

    left: float
    right: float

    def since(self, earlier: "WheelDistances") -> "WheelDistances":
        """Return the distances since an earlier instant."""
        return WheelDistances(self.left - earlier.left, self.right - earlier.right)

    def distance(self) -> float:
        """Return the distance of the robot [m]."""
        return 0.5 * (self.left + self.right)

    def rotation(self, wheel_separation: float) -> float:
        """Return the rotation of the robot [rad] with a distance between its wheels [m]."""
        return (self.right - self.left) / wheel_separation
