# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""What wheels say of the motion between odoms: corrections, and forecasts without any fix."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fnn_ekf_ros.core.arrays import BoolArray, FloatArray
from fnn_ekf_ros.evaluation.errors import Statistics, statistics
from fnn_ekf_ros.recordings.run_record import RunRecord

OUTAGES_S = (10.0, 100.0)
"""Durations without fixes after which forecasts are scored [s]: a tunnel, and a lost map."""
LONGEST_STEP = 3.0
"""Longest time between two odoms, in multiples of the usual one, that the speed bridges."""


class Forecasts(NamedTuple):
    """Forecasts of positions by the wheels alone, from poses some time before.

    Attributes:
        time_ns: `(n,)` when they are scored [ns].
        error: `(n,)` distance from where a fix, or the truth, then is [m].
    """

    time_ns: NDArray[np.int64]
    error: FloatArray


def wheel_path(run: RunRecord) -> tuple[FloatArray, BoolArray]:
    """Return the poses `(n, 3)` that the wheels alone lead to, from the origin (m, m, rad).

    On exact arcs by the twist of odom, the mean over the period before it. Second, whether each
    step `(n - 1,)` is short enough to be bridged.
    """
    steps_s = np.diff(run.track.time_ns) * 1e-9
    usual = float(np.median(steps_s)) if len(steps_s) else 0.0
    moved = run.twist[1:] * steps_s[:, None]
    yaw = np.concatenate([[0.0], np.cumsum(moved[:, 1])])
    half = 0.5 * moved[:, 1]
    chord = moved[:, 0] * np.sinc(half / np.pi)  # sin(h) / h, 1 on a line
    middle = yaw[:-1] + half
    xy = np.cumsum(np.stack([chord * np.cos(middle), chord * np.sin(middle)], axis=1), axis=0)
    path = np.column_stack([np.vstack([np.zeros(2), xy]), yaw])
    return path, np.asarray(steps_s <= LONGEST_STEP * usual)


def corrections(run: RunRecord) -> Statistics:
    """Return how far odom moves from one period to the next beyond what the wheels say [m]."""
    path, bridged = wheel_path(run)
    if len(path) < 2:
        return statistics(np.zeros(0))
    expected = _carried(run.track.pose[:-1], path[:-1], path[1:])
    jump = np.hypot(*(run.track.pose[1:, :2] - expected).T)
    return statistics(jump[bridged])


def forecasts(
    run: RunRecord, target_ns: NDArray[np.int64], xy: FloatArray, gap_s: float
) -> Forecasts:
    """Score forecasts of positions, each from the last odom that is so much older.

    Args:
        run: gives odom and the wheels' motion.
        target_ns: `(n,)` stamps of the positions [ns].
        xy: `(n, 2)` positions, of fixes or true ones [m]; NaN where not known.
        gap_s: time without fixes [s].
    """
    track = run.track
    if len(track.time_ns) < 2:
        return Forecasts(np.zeros(0, dtype=np.int64), np.zeros(0))
    path, bridged = wheel_path(run)
    start = np.searchsorted(track.time_ns, target_ns - round(gap_s * 1e9), side="right") - 1
    after = np.searchsorted(track.time_ns, target_ns, side="left")
    fine = (
        (start >= 0) & (after < len(track.time_ns)) & (after > 0) & np.all(np.isfinite(xy), axis=1)
    )
    start, after, target_ns, xy = start[fine], after[fine], target_ns[fine], xy[fine]
    holes = np.concatenate([[0], np.cumsum(~bridged)])
    whole = holes[start] == holes[after]
    start, after, target_ns, xy = start[whole], after[whole], target_ns[whole], xy[whole]
    t0, t1 = track.time_ns[after - 1], track.time_ns[after]
    part = ((target_ns - t0) / (t1 - t0))[:, None]
    end = path[after - 1] + part * (path[after] - path[after - 1])
    predicted = _carried(track.pose[start], path[start], end)
    return Forecasts(target_ns, np.hypot(*(predicted - xy).T))


def _carried(pose: FloatArray, begin: FloatArray, end: FloatArray) -> FloatArray:
    """Return positions `(n, 2)` after the wheels' motion from one of their poses to another [m]."""
    turn = pose[:, 2] - begin[:, 2]
    d = (end - begin)[:, :2]
    c, s = np.cos(turn), np.sin(turn)
    return pose[:, :2] + np.stack([c * d[:, 0] - s * d[:, 1], s * d[:, 0] + c * d[:, 1]], axis=1)
