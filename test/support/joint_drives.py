# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Periods for mode `joint`, and views of what it has learned."""

from collections.abc import Callable

import numpy as np
from periods import ALL_ROWS

from fnn_ekf_ros.core.adaptation import Adaptation
from fnn_ekf_ros.core.arrays import FloatArray
from fnn_ekf_ros.core.filter import step
from fnn_ekf_ros.core.joint_state import JointReport, JointState
from fnn_ekf_ros.core.results import Epoch, StepResult
from fnn_ekf_ros.core.state import FilterModel, FilterState, start_filter

MakeModel = Callable[..., FilterModel]
MakeAdaptation = Callable[..., Adaptation]
START_COVARIANCE = np.diag([0.01, 0.01, 0.018])
SETTLED, FAST = 0, 1
SCALE_OF_ROW = [2, 2, 3, 3]
PERIOD_S = 0.375
LEARNED = ("log_scale", "information", "memory", "start_weight")


def learned(state: FilterState) -> tuple[JointState, list[bytes]]:
    assert state.joint is not None
    return state.joint, [getattr(state.joint, name).tobytes() for name in LEARNED]


def report(result: StepResult) -> JointReport:
    assert isinstance(result.joint, JointReport)
    return result.joint


def at_end(
    control: FloatArray, z: FloatArray, rows: FloatArray, duration_s: float = PERIOD_S
) -> list[Epoch]:
    """Return a period with readings at its end only."""
    return [Epoch(np.asarray(control), duration_s, np.asarray(z), rows.astype(np.bool_))]


def joint_periods(rng: np.random.Generator, steps: int, plain: bool = False) -> list[list[Epoch]]:
    """Around the origin, unless plain with readings in between, reported covariances and gaps."""
    periods = []
    for _ in range(steps):
        control = rng.uniform([0.05, -0.3], [0.3, 0.3])
        z = rng.normal(0.0, 0.3, 4)
        if plain:
            periods.append(at_end(control, z, ALL_ROWS))
            continue
        root = 0.1 * rng.standard_normal((3, 3))
        reported = root @ root.T + 0.01 * np.eye(3)
        part = rng.random()
        periods.append(
            [
                Epoch(share * control, share * PERIOD_S, z, rng.random(4) < 0.6, reported)
                for share in (part, 1.0 - part)
            ]
        )
    return periods


def trained(model: FilterModel, seed: int = 90, steps: int = 40) -> FilterState:
    """Return a state of which every part has moved."""
    state = start_filter(model, np.zeros(3), START_COVARIANCE)
    for period in joint_periods(np.random.default_rng(seed), steps, plain=True):
        state, _ = step(model, state, period)
    joint, _ = learned(state)
    assert np.all(joint.log_scale != 0.0)
    assert np.all(joint.lead != 0.0)
    return state
