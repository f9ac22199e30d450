# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""A robot on a circle: what its wheels and sensors say, as it arrives."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from localizers import PERIOD_NS, SECOND_NS, Arrival

from fnn_ekf_ros.core.arrays import FloatArray
from fnn_ekf_ros.timeline.events import CompassYaw, Event, PoseFix, Wheel, WheelCount

MS = 10**6
BEGIN_NS, END_NS = 80 * PERIOD_NS, 81 * PERIOD_NS  # 30 s
WHEEL_STEP_NS = 25 * MS
SPEED, RATE, RADIUS, SEPARATION = 0.5, 0.6, 0.025, 0.6


def compass(stamp_ns: int, yaw: float = 0.0) -> CompassYaw:
    return CompassYaw(stamp_ns, yaw)


def fix(stamp_ns: int, x: float = 0.0, y: float = 0.0) -> PoseFix:
    return PoseFix(stamp_ns, np.array([x, y, 0.0]), np.eye(3))


def wheels(stamp_ns: int, rate: float = RATE, from_ns: int = BEGIN_NS) -> list[WheelCount]:
    """Return how far the wheels of a robot on a circle have turned [rad]."""
    time = (stamp_ns - from_ns) * 1e-9
    ways = (SPEED - 0.5 * SEPARATION * rate) * time, (SPEED + 0.5 * SEPARATION * rate) * time
    return [WheelCount(stamp_ns, w, way / RADIUS) for w, way in zip(Wheel, ways, strict=True)]


def pose_at(stamp_ns: int) -> FloatArray:
    """Return where the robot on the circle is; it begins at the origin."""
    turn, radius = RATE * (stamp_ns - BEGIN_NS) * 1e-9, SPEED / RATE
    return np.array([radius * math.sin(turn), radius * (1.0 - math.cos(turn)), turn])


def readings(
    seconds: float, compass_hz: float = 8.0, fix_hz: float = 2.5, offset_ns: int = 0
) -> list[Event]:
    """Return noisy readings of the robot on the circle; both sensors read at its begin, too."""
    rng = np.random.default_rng(12)
    found: list[Event] = []
    for rate_hz in (compass_hz, fix_hz):
        for number in range(int(seconds * rate_hz)):
            stamp = BEGIN_NS + round(number * 1e9 / rate_hz) + (offset_ns if number else 0)
            pose = pose_at(stamp) + rng.standard_normal(3) * [0.1, 0.1, 0.134]
            if rate_hz == fix_hz:
                found.append(fix(stamp, pose[0], pose[1]))
            else:
                found.append(compass(stamp, pose[2]))
    return found


def in_time(events: Sequence[Event], seconds: float) -> list[Any]:
    """Return readings and the wheels' as arriving at their stamps, until a little later."""
    begin, end = BEGIN_NS - 2 * SECOND_NS, BEGIN_NS + round(seconds * 1e9) + SECOND_NS
    turned = [e for stamp in range(begin, end, WHEEL_STEP_NS) for e in wheels(stamp)]
    ordered = sorted([*events, *turned], key=lambda event: event.stamp_ns)
    return [Arrival(event.stamp_ns, event) for event in ordered]
