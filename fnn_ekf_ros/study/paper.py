# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The paper's own trials: both simulations and the experiment's round path.

From the right start, with R assumed 25 times its true variance, and with Q a 25th of its true
variance as well. The paper does not say how wrong its own start was; where it is right, no
adaptive filter can beat the EKF. The command runs the filters on the paper's motion model (eq. 4),
the oracle too.
"""

from fnn_ekf_ros.parameters.fake_robot import FakeRobotParameters
from fnn_ekf_ros.study.scenarios import NOMINAL
from fnn_ekf_ros.study.starts import RIGHT, Cell
from fnn_ekf_ros.study.trials import Size, TrialPlan, halves

TRIALS = {
    "sim1": "simulation 1",
    "sim2": "simulation 2",
    "round": "experiment (simulated)",
}
"""Paths of the fake robot, and what the paper calls them."""
STARTS = (RIGHT, Cell(1.0, 25.0), Cell(1.0 / 25.0, 25.0))
"""Starts of the filters: right, R too large, and Q too small as well."""
FIRST_CORNER, LINE, THIRD_CORNER = (5.7, 0.3), (3.0, 0.0), (4.5, 3.7)
"""Middles of the parts of the experiment's path that the paper enlarges, its corners counted from
the start, (6, 0) and (4.5, 4) [m]."""


def plans(size: Size) -> list[TrialPlan]:
    """Return the two simulations and the experiment."""
    ranges = halves(size.steps)
    return [
        TrialPlan(
            name=path,
            robot=FakeRobotParameters(path=path),
            scenario=NOMINAL,
            cells=STARTS,
            ranges=ranges,
            size=size,
        )
        for path in TRIALS
    ]
