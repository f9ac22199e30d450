# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Noise that changes, and errors that are no white noise: one case each, in simulation 1."""

import math
from typing import NamedTuple

from fnn_ekf_ros.core.arrays import Row
from fnn_ekf_ros.parameters.fake_robot import FakeRobotParameters
from fnn_ekf_ros.study.scenarios import NOMINAL, Scenario
from fnn_ekf_ros.study.starts import ALL_CELLS, CORNERS, RIGHT, Cell
from fnn_ekf_ros.study.trials import Size, TrialPlan, around_event


class Case(NamedTuple):
    """Case of `study dynamic`.

    Attributes:
        about: in words.
        scenario: in numbers.
        has_event: whether it happens in the event only; else all the time, or never.
        cells: starts that are tried; all of them where no noise is right by definition, and the
            best fixed EKF in hindsight is the measure.
    """

    about: str
    scenario: Scenario
    has_event: bool
    cells: tuple[Cell, ...] = (RIGHT, *CORNERS)


CASES = {
    "nominal": Case("nothing goes wrong", NOMINAL, has_event=False),
    "slip": Case(
        "wheel slip of 100 times the variance", Scenario(process_scale=100.0), has_event=True
    ),
    "noisy_sensors": Case(
        "fixes and compass of 25 times the variance",
        Scenario(measurement_scale=25.0),
        has_event=True,
    ),
    "unequal_wheels": Case(
        "wheel diameters unequal by 2 %", Scenario(wheel_inequality=0.02), has_event=False
    ),
    "compass_bias": Case(
        "compass off by 5 deg", Scenario(compass_bias=math.radians(5.0)), has_event=True
    ),
    "outliers": Case(
        "5 % of the fixes with 10 times the standard deviation",
        Scenario(outlier_share=0.05, outlier_scale=10.0),
        has_event=False,
        cells=ALL_CELLS,
    ),
    "coloured_fixes": Case(
        "fixes with a lag-1 correlation of 0.5",
        Scenario(fix_correlation=0.5),
        has_event=False,
        cells=ALL_CELLS,
    ),
    "fixes_lost": Case("no fixes", Scenario(lost=(Row.X, Row.Y)), has_event=True),
    "compass_lost": Case("no compass", Scenario(lost=(Row.COMPASS_YAW,)), has_event=True),
}  # fmt: skip
"""The cases by name."""

PATH = "sim1"
"""Name of the path that is driven, that of simulation 1."""
STARTS = (RIGHT, *CORNERS)
"""Starts that the pictures show."""


def plans(size: Size) -> list[TrialPlan]:
    """Return the cases, each from the starts that it asks for."""
    robot, ranges = FakeRobotParameters(path=PATH), around_event(size.steps)
    return [
        TrialPlan(
            name=name,
            robot=robot,
            scenario=case.scenario,
            cells=case.cells,
            ranges=ranges,
            size=size,
        )
        for name, case in CASES.items()
    ]
