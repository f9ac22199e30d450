# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Simulated robots whose sensors have rates of their own, for tests of the core."""

import math
from typing import NamedTuple

import numpy as np

from fnn_ekf_ros.core.arrays import FloatArray
from fnn_ekf_ros.core.filter import fuse
from fnn_ekf_ros.core.motion import MotionModel, displacement
from fnn_ekf_ros.core.pace import NOMINAL_PERIOD_S, STEP_INTERVAL
from fnn_ekf_ros.core.results import Epoch, Shown
from fnn_ekf_ros.core.state import FilterModel, FilterState, start_filter

TRUE_Q = np.array([0.02, math.radians(1.0)]) ** 2
"""The paper's simulation 1, (25), per 375 ms (m^2, rad^2)."""
TRUE_R = np.array([0.01, 0.01, 0.018, 0.018])
"""Variances of its sensors by row (m^2, m^2, rad^2, rad^2)."""
UNEVEN_Q, UNEVEN_R = np.array([4e-4, 3e-4]), np.array([0.01, 0.012, 0.018, 0.02])
"""Noise that is another one in every row: rows that are mixed up show."""


class Drive(NamedTuple):
    """A batch of robots; epochs in time's order, with the truth `(3, runs)` at the end of each."""

    epochs: list[Epoch]
    truth: list[FloatArray]


def times(interval_s: float, first_s: float, end_s: float = 12.0) -> list[float]:
    return [round(t, 6) for t in np.arange(first_s, end_s, interval_s).tolist()]


def steps_of(fixes: list[float]) -> list[float]:
    """Return the fixes that are steps: the first, and then none sooner than `STEP_INTERVAL`."""
    found: list[float] = []
    for fix in fixes:
        if not found or fix - found[-1] >= STEP_INTERVAL * NOMINAL_PERIOD_S:
            found.append(fix)
    return found


def drive(
    seed: int,
    runs: int,
    seconds: float,
    fix_s: float | None,
    compass_s: float,
    late_s: float = 0.0,
    start: FloatArray | None = None,
) -> Drive:
    """Return robots on a bent path from `(3, runs)`; each fix is `late_s` later than in step."""
    rng = np.random.default_rng(seed)
    fixes = [] if fix_s is None else times(fix_s, fix_s + late_s, seconds + 1e-9)
    compass = times(compass_s, compass_s, seconds + 1e-9)
    truth, now, found = np.zeros((3, runs)) if start is None else start, 0.0, Drive([], [])
    for t in sorted({*fixes, *compass}):
        duration_s, now = t - now, t
        size = duration_s / NOMINAL_PERIOD_S
        turn = 0.03 + 0.05 * math.sin(0.05 * t / NOMINAL_PERIOD_S)
        control = size * np.repeat([[0.11], [turn]], runs, axis=1)
        driven = control + np.sqrt(size * TRUE_Q)[:, None] * rng.standard_normal((2, runs))
        truth = truth + displacement(MotionModel.EXACT_ARC, truth[2], driven)
        z = truth[[0, 1, 2, 2]] + np.sqrt(TRUE_R)[:, None] * rng.standard_normal((4, runs))
        rows = np.array([t in fixes, t in fixes, t in compass, False])
        found.epochs.append(Epoch(control, duration_s, z, np.repeat(rows[:, None], runs, axis=1)))
        found.truth.append(truth)
    return found


def fused(
    model: FilterModel, epochs: list[Epoch], state: FilterState
) -> tuple[list[FilterState], list[Shown | None]]:
    states, shown = [], []
    for epoch in epochs:
        state, seen = fuse(model, state, epoch)
        states.append(state)
        shown.append(seen)
    return states, shown


def start_of(model: FilterModel, runs: int, **noise: FloatArray) -> FilterState:
    return start_filter(model, np.zeros((3, runs)), np.diag([0.01, 0.01, 0.018]), **noise)
