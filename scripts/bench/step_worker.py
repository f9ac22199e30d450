# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Times steps of one robot's filter, the package's and filterpy's, in blocks that take turns."""

from collections.abc import Callable
from typing import Any

import numpy as np

from bench.robot import GEOMETRY, MEASUREMENT_STD, PERIOD_S, FloatArray, drive
from bench.workers import cpu_s, serve

START_COVARIANCE = np.diag(np.square(MEASUREMENT_STD[:3]))
"""Covariance of the start (m^2, m^2, rad^2): that of a fix."""
ALL_ROWS = np.ones(4, dtype=bool)
"""Rows that are measured in every step: all four."""
SEED = 1
"""Seed of the drive, fixed: every run measures the same work."""
Stepper = Callable[[FloatArray, FloatArray], FloatArray]
"""Takes control and measurement of a step; returns the mean after it."""


def own(adaptation: str, mean: FloatArray) -> Stepper:
    """Return the package's filter as a function that takes a step and returns the mean."""
    from fnn_ekf_ros.core.filter import step
    from fnn_ekf_ros.core.results import Epoch
    from fnn_ekf_ros.core.state import start_filter
    from fnn_ekf_ros.membership.files import networks_for
    from fnn_ekf_ros.parameters.localizer import LocalizerParameters
    from fnn_ekf_ros.timeline.filter_model import filter_model

    parameters = LocalizerParameters(**GEOMETRY, adaptation=adaptation)
    model = filter_model(parameters, networks_for(parameters))
    state = start_filter(model, mean, START_COVARIANCE)

    def advance(control: FloatArray, measurement: FloatArray) -> FloatArray:
        nonlocal state
        state, _ = step(model, state, [Epoch(control, PERIOD_S, measurement, ALL_ROWS)])
        return state.mean

    return advance


def filterpy(mean: FloatArray) -> Stepper:
    """Return filterpy's EKF as such a function."""
    from bench.textbook import RobotEkf

    return RobotEkf(mean, START_COVARIANCE).step


def measure(blocks: int, steps: int) -> dict[str, Any]:
    """Return the CPU time of a step in each block [us], by filter.

    A block more is run first and not counted. Also returns the largest difference between the
    means of `none` and of filterpy's EKF at the ends of blocks, which should be rounding (m, rad).
    """
    drove = drive((blocks + 1) * steps, 1, PERIOD_S, SEED)
    controls, measurements = drove.control[:, 0], drove.measurement[:, 0]
    start = drove.truth[0, 0]
    filters = {
        "none": own("none", start),
        "joint": own("joint", start),
        "filterpy": filterpy(start),
    }
    times: dict[str, list[float]] = {name: [] for name in filters}
    difference = 0.0
    for block in range(blocks + 1):
        part = slice(block * steps, (block + 1) * steps)
        inputs = list(zip(controls[part], measurements[part], strict=True))
        means = {}
        for name, advance in filters.items():
            began = cpu_s()
            for control, measurement in inputs:
                mean = advance(control, measurement)
            times[name].append(1e6 * (cpu_s() - began) / steps)
            means[name] = mean
        apart = np.abs(means["none"] - means["filterpy"])
        difference = max(difference, float(np.max(np.minimum(apart, np.abs(apart - 2.0 * np.pi)))))
    return {"us": {name: of[1:] for name, of in times.items()}, "difference": difference}


if __name__ == "__main__":
    serve(measure)
