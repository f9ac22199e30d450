# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Every wrong start: assumed over true variance of Q and of R, in both of the paper's simulations.

The paper does not say what noise its simulated robot really had, and a user does not know what
theirs has; so no single start is the one to look at.
"""

from fnn_ekf_ros.parameters.fake_robot import FakeRobotParameters
from fnn_ekf_ros.study.scenarios import NOMINAL
from fnn_ekf_ros.study.starts import ALL_CELLS
from fnn_ekf_ros.study.trials import Size, TrialPlan, halves

SIMULATIONS = {"sim1": "simulation 1", "sim2": "simulation 2"}
"""Paths of the fake robot, each with the slip of its simulation, and what they are called."""


def plans(size: Size) -> list[TrialPlan]:
    """Return the two simulations with all 25 starts."""
    ranges = halves(size.steps)
    return [
        TrialPlan(
            name=path,
            robot=FakeRobotParameters(path=path),
            scenario=NOMINAL,
            cells=ALL_CELLS,
            ranges=ranges,
            size=size,
        )
        for path in SIMULATIONS
    ]
