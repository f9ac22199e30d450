# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Drives for examinations: a driver who steers back, wheels that slip, three sensors."""

import math
from dataclasses import asdict
from typing import Any

import numpy as np

from fnn_ekf_ros.calibration.examination import Drive
from fnn_ekf_ros.core.arrays import FloatArray
from fnn_ekf_ros.parameters.localizer import LocalizerParameters

RADIUS, SEPARATION, COUNTS = 0.05, 0.4, 2000.0
"""True geometry (m, m, counts)."""
STEP_S = 0.05
"""Step of the simulation, and interval of the wheels' readings [s]."""


def parameters(**changes: Any) -> dict[str, Any]:
    """Return the parameters that fit the drives, with changes."""
    right = LocalizerParameters(
        wheel_radius=RADIUS, wheel_separation=SEPARATION, encoder_counts_per_revolution=COUNTS
    )
    return asdict(right) | changes


def laps(seed: int, lap_s: tuple[float, ...], duration_s: float) -> Drive:
    """Return the readings of a robot that drives laps of one turn each, at constant rates.

    Args:
        seed: of slip and noise.
        lap_s: durations of the laps, which follow each other again and again; to the right if
            negative [s].
        duration_s: how long it drives [s].
    """
    rng = np.random.default_rng(seed)
    times = STEP_S * np.arange(1, round(duration_s / STEP_S) + 1)
    ends = np.cumsum(np.abs(lap_s))
    which = np.searchsorted(ends, times % ends[-1], side="right") % len(lap_s)
    turn = 2.0 * math.pi * STEP_S / np.array(lap_s)[which]
    ahead = np.full(len(times), 0.3 * STEP_S)
    wheels = np.cumsum([ahead - 0.5 * SEPARATION * turn, ahead + 0.5 * SEPARATION * turn], axis=1)
    slips = rng.standard_normal((2, len(times))) * [[0.05], [0.05]] * math.sqrt(STEP_S / 0.375)
    heading = np.cumsum(turn + slips[1])
    middle = heading - 0.5 * (turn + slips[1])
    x, y = (np.cumsum((ahead + slips[0]) * f(middle)) for f in (np.cos, np.sin))
    counts = np.floor(wheels * COUNTS / (2.0 * math.pi * RADIUS))
    compass = _wrapped(heading + 0.13 * rng.standard_normal(len(times)))
    noise = [0.1, 0.1, 0.13] * rng.standard_normal((len(times), 3))
    fixes = np.column_stack([x, y, heading]) + noise
    fixes[:, 2] = _wrapped(fixes[:, 2])
    some = slice(None, None, 7)
    return Drive(
        _table(times, counts[0]),
        _table(times, counts[1]),
        _table(times[some], compass[some]),
        np.column_stack([times[some], fixes[some]]),
    )


def drive(
    seed: int,
    duration_s: float = 60.0,
    slip: tuple[float, float] = (0.01, 0.01),
    compass_std: float = 0.05,
    turning: bool = True,
) -> Drive:
    """Return the readings of a drive.

    Args:
        seed: of course, slip and noise.
        duration_s: how long it lasts [s].
        slip: motion that the encoders do not see, per square root of a second (m, rad).
        compass_std: noise of the compass and of the fixes' yaw [rad].
        turning: whether the course turns at all.
    """
    rng = np.random.default_rng(seed)
    steps = round(duration_s / STEP_S)
    course, heading, x, y = 0.0, 0.0, 0.0, 0.0
    poses, travel = np.empty((steps, 3)), np.zeros((steps, 2))
    left = right = rate = 0.0
    until = 0
    slips = rng.standard_normal((steps, 2)) * slip * math.sqrt(STEP_S)
    for k in range(steps):
        if turning and k >= until:
            rate = float(rng.uniform(-0.8, 0.8))
            until = k + int(rng.uniform(1.0, 4.0) / STEP_S)
        course += rate * STEP_S
        # The driver sees the true heading and steers back: slips of the past change the travel.
        turn = (rate + 1.5 * (course - heading)) * STEP_S
        ahead = 0.4 * STEP_S
        left += ahead - 0.5 * SEPARATION * turn
        right += ahead + 0.5 * SEPARATION * turn
        distance, rotation = ahead + slips[k, 0], turn + slips[k, 1]
        middle = heading + 0.5 * rotation
        x, y = x + distance * math.cos(middle), y + distance * math.sin(middle)
        heading += rotation
        poses[k], travel[k] = (x, y, heading), (left, right)
    times = STEP_S * np.arange(1, steps + 1)
    counts = np.floor(travel * COUNTS / (2.0 * math.pi * RADIUS))
    compass = poses[::2, 2] + compass_std * rng.standard_normal(len(poses[::2]))
    fixes = poses[::8] + [0.1, 0.1, compass_std] * rng.standard_normal((len(poses[::8]), 3))
    fixes[:, 2] = _wrapped(fixes[:, 2])
    return Drive(
        _table(times, counts[:, 0]),
        _table(times, counts[:, 1]),
        _table(times[::2], _wrapped(compass)),
        np.column_stack([times[::8], fixes]),
    )


def _table(times: FloatArray, values: FloatArray) -> FloatArray:
    return np.column_stack([times, values])


def _wrapped(angle: FloatArray) -> FloatArray:
    return np.asarray(np.remainder(angle + np.pi, 2.0 * np.pi) - np.pi)
