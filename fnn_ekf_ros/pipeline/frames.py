"""Planar transforms, and the one from the map to the frame that wheel odometry lives in.

Poses and transforms are `(3,)` [x, y, yaw] (m, m, rad). Somebody else says where base is in odom;
the localizer knows where it is in map, at the ends of its periods. At the same instant

    map -> odom  =  (map -> base) (odom -> base)^-1
"""

from bisect import bisect_left
from collections import deque
from typing import NamedTuple

import numpy as np

from fnn_ekf_ros.core.angles import wrap_angle
from fnn_ekf_ros.core.arrays import FloatArray
from fnn_ekf_ros.pipeline.events import STALE_NS

BUFFER_NS = 10 * 10**9
"""So much of odom -> base is kept [ns]."""
SET_BACK_NS = 10**9
"""Stamps of odom -> base that go back by more are those of a clock that was set [ns]."""
MOST_PENDING = 8
"""So many of the newest poses wait for their odom -> base."""


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
    """Return the pose at an instant between two; the yaw takes the shorter way."""
    part = (stamp_ns - before.stamp_ns) / (after.stamp_ns - before.stamp_ns)
    way = after.pose - before.pose
    turn = float(wrap_angle(way[2]))
    x, y = before.pose[:2] + part * way[:2]
    return np.array([x, y, float(wrap_angle(before.pose[2] + part * turn))])


class Track:
    """A transform over the last seconds."""

    def __init__(self) -> None:
        self._transforms: list[Transform] = []

    def add(self, transform: Transform) -> None:
        """Take one in; of two at the same instant the last to come counts."""
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
        """Return the pose at an instant; None outside of what is known."""
        known = self._transforms
        place = bisect_left(known, stamp_ns, key=_stamp)
        if place == len(known):
            return None
        if known[place].stamp_ns == stamp_ns:
            return known[place].pose
        return between(known[place - 1], known[place], stamp_ns) if place else None


class MapToOdom:
    """Brings together the localizer's poses and somebody else's odom -> base.

    Whichever of the two comes last gives map -> odom. A pose whose odom -> base is not there yet
    waits for it, the newest few of them.
    """

    def __init__(self) -> None:
        self._odom_to_base = Track()
        self._pending: deque[Transform] = deque(maxlen=MOST_PENDING)
        self._answered_ns: int | None = None
        self._newest_ns: int | None = None

    def located(self, pose: Transform) -> list[Transform]:
        """Take in where the localizer is (map -> base); return the map -> odom known now."""
        if self._newest_ns is not None and pose.stamp_ns <= self._newest_ns:  # the clock was set
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
        """For how long poses have been waiting in vain [ns]; 0 if not longer than is usual."""
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
