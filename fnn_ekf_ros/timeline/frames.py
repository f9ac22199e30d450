# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Planar transforms, and the one from the map to the frame that wheel odometry lives in.

Poses and transforms are `(3,)` [x, y, yaw] (m, m, rad). Another node publishes where base is in
odom; the localizer knows where it is in map, at the ends of its periods. At the same instant

    map -> odom  =  (map -> base) (odom -> base)^-1
"""

from bisect import bisect_left
from collections import deque
from typing import NamedTuple

import numpy as np

from fnn_ekf_ros.core.angles import wrap_angle
from fnn_ekf_ros.core.arrays import FloatArray
from fnn_ekf_ros.timeline.events import STALE_NS

BUFFER_NS = 10 * 10**9
"""Length of the history of odom -> base that is kept [ns]: longer than any delay of a pose that is
still published."""
SET_BACK_NS = 10**9
"""Step backwards of the stamps of odom -> base from which on the clock was set [ns]; smaller steps
are messages that arrive out of order."""
MOST_PENDING = 8
"""Number of the newest poses that wait for their odom -> base; older ones are out of date."""


class Transform(NamedTuple):
    """A transform at an instant.

    Attributes:
        stamp_ns: ROS time [ns].
        pose: `(3,)` of the child frame in the parent frame (m, m, rad).
    """

    stamp_ns: int
    pose: FloatArray


def compose(first: FloatArray, second: FloatArray) -> FloatArray:
    """Return a -> c from a -> b and b -> c."""
    c, s = np.cos(first[2]), np.sin(first[2])
    return np.array(
        [
            first[0] + c * second[0] - s * second[1],
            first[1] + s * second[0] + c * second[1],
            float(wrap_angle(first[2] + second[2])),
        ]
    )


def inverse(pose: FloatArray) -> FloatArray:
    """Return b -> a from a -> b."""
    c, s = np.cos(pose[2]), np.sin(pose[2])
    return np.array([-c * pose[0] - s * pose[1], s * pose[0] - c * pose[1], -pose[2]])


def between(before: Transform, after: Transform, stamp_ns: int) -> FloatArray:
    """Return the pose at an instant between two; the yaw takes the shorter arc."""
    part = (stamp_ns - before.stamp_ns) / (after.stamp_ns - before.stamp_ns)
    difference = after.pose - before.pose
    rotation = float(wrap_angle(difference[2]))
    x, y = before.pose[:2] + part * difference[:2]
    return np.array([x, y, float(wrap_angle(before.pose[2] + part * rotation))])


class TransformBuffer:
    """A transform over the last seconds."""

    def __init__(self) -> None:
        self._transforms: list[Transform] = []

    def add(self, transform: Transform) -> None:
        """Take a transform in; of two at the same instant the last one counts."""
        known = self._transforms
        if known and transform.stamp_ns < known[-1].stamp_ns - SET_BACK_NS:
            known.clear()
        place = bisect_left(known, transform.stamp_ns, key=_stamp)
        if place < len(known) and known[place].stamp_ns == transform.stamp_ns:
            known[place] = transform
        else:
            known.insert(place, transform)
        del known[: bisect_left(known, known[-1].stamp_ns - BUFFER_NS, key=_stamp)]

    def at(self, stamp_ns: int) -> FloatArray | None:
        """Return the pose at an instant; None outside of the known time."""
        known = self._transforms
        place = bisect_left(known, stamp_ns, key=_stamp)
        if place == len(known):
            return None
        if known[place].stamp_ns == stamp_ns:
            return known[place].pose
        return between(known[place - 1], known[place], stamp_ns) if place else None


class MapToOdom:
    """Combines the localizer's poses with odom -> base of another node.

    The later of the two gives map -> odom. The newest few poses wait if their odom -> base is not
    known yet.
    """

    def __init__(self) -> None:
        self._odom_to_base = TransformBuffer()
        self._pending: deque[Transform] = deque(maxlen=MOST_PENDING)
        self._answered_ns: int | None = None
        self._newest_ns: int | None = None

    def located(self, pose: Transform) -> list[Transform]:
        """Take in a pose of the localizer (map -> base); return the map -> odom known now."""
        if (
            self._newest_ns is not None and pose.stamp_ns <= self._newest_ns
        ):  # the clock was set back
            self._pending.clear()
            self._answered_ns = None
        if self._answered_ns is None:
            self._answered_ns = pose.stamp_ns
        self._newest_ns = pose.stamp_ns
        self._pending.append(pose)
        return self._answer()

    def moved(self, transform: Transform) -> list[Transform]:
        """Take in an odom -> base; return the map -> odom known now, the oldest first."""
        self._odom_to_base.add(transform)
        return self._answer()

    @property
    def missing_ns(self) -> int:
        """Time for which poses have been waiting in vain [ns]; 0 up to `STALE_NS`."""
        if self._newest_ns is None or self._answered_ns is None:
            return 0
        waited_ns = self._newest_ns - self._answered_ns
        return waited_ns if waited_ns > STALE_NS else 0

    def _answer(self) -> list[Transform]:
        answers = []
        waiting = list(self._pending)
        self._pending.clear()
        for pose in waiting:
            moved = self._odom_to_base.at(pose.stamp_ns)
            if moved is None:
                self._pending.append(pose)
            else:
                answers.append(Transform(pose.stamp_ns, compose(pose.pose, inverse(moved))))
                self._answered_ns = pose.stamp_ns
        return answers


def _stamp(transform: Transform) -> int:
    return transform.stamp_ns
