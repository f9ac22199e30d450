# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Errors of fixes and compass that last: what do they cost, and does the covariance say so?

The robots of the paper's simulations 1 and 2, whose fixes and compass have white noise of the right
size and, beside it, errors that last: a Gauss-Markov process in x and in y of the fixes, a constant
offset of the compass, both, or none. Runs of all cases are the same but for these errors. The pose
at the start has none of them: it is the true one plus N(0, R), as if it had been given.
"""

from functools import partial
from typing import NamedTuple

import numpy as np

from fnn_ekf_ros.core.angles import wrap_angle
from fnn_ekf_ros.core.arrays import FloatArray, Row
from fnn_ekf_ros.parameters.fake_robot import FakeRobotParameters
from fnn_ekf_ros.parameters.localizer import LocalizerParameters
from fnn_ekf_ros.study import grid
from fnn_ekf_ros.study.filters import EKF_GATED, JOINT, ORACLE, study_filters
from fnn_ekf_ros.study.recording import Estimates, Recording, Start
from fnn_ekf_ros.study.rivals import known_errors
from fnn_ekf_ros.study.rivals.known_errors import ErrorModel
from fnn_ekf_ros.study.scenarios import NOMINAL, NOMINAL_MEASUREMENT_NOISE, POSITION_SLICE, record
from fnn_ekf_ros.study.scores import compare
from fnn_ekf_ros.study.starts import CORNERS, RIGHT, Cell, starts
from fnn_ekf_ros.study.trials import halves

SIMULATIONS = grid.SIMULATIONS
"""Titles of the simulations, by the path that is driven."""
FIX_STD = 0.3
"""Stationary standard deviation of the lasting errors of x and of y [m]: three times the white
noise."""
TIME_CONSTANTS_S = (3.0, 10.0, 30.0, 100.0)
"""Time constants of the lasting errors of the fixes [s]: eight periods to a sixth of a run."""
BOTH_TIME_CONSTANT_S = 30.0
"""Time constant where the compass is offset, too [s]."""
COMPASS_OFFSET = 0.2
"""Offset of the compass [rad], and its standard deviation for the EKF that knows: one and a half
times the white noise."""
KNOWS = "knows_errors"
"""Name of the EKF that knows the model of the lasting errors."""
LABELS = {
    KNOWS: "EKF that knows the errors",
    ORACLE: "oracle EKF, white",
    EKF_GATED: "EKF with gate",
    JOINT: "FNN-EKF joint",
}
"""What tables and figures call the filters, in their order."""
CELLS = (RIGHT, *CORNERS)
"""Starts of the filters that do not know the noise."""


class LastingCase(NamedTuple):
    """A case of `study lasting`.

    Attributes:
        about: in words.
        model: of the errors, for the EKF that knows them.
        compass_offset: true offset of the compass [rad].
    """

    about: str
    model: ErrorModel
    compass_offset: float = 0.0


CASES = {
    "none": LastingCase("none", ErrorModel()),
    **{
        f"fixes_{time_s:g}s": LastingCase(
            f"fixes, {time_s:g} s", ErrorModel(fix_std=FIX_STD, time_constant_s=time_s)
        )
        for time_s in TIME_CONSTANTS_S
    },
    "compass": LastingCase("compass", ErrorModel(offset_std=COMPASS_OFFSET), COMPASS_OFFSET),
    "both": LastingCase(
        f"both, {BOTH_TIME_CONSTANT_S:g} s",
        ErrorModel(
            fix_std=FIX_STD, time_constant_s=BOTH_TIME_CONSTANT_S, offset_std=COMPASS_OFFSET
        ),
        COMPASS_OFFSET,
    ),
}
"""The cases by name."""


class FilterErrors(NamedTuple):
    """Means over the steps of a range, of n runs.

    Attributes:
        position: `(ranges, cells, n)` squared distance [m^2].
        yaw: likewise, squared error [rad^2].
        nees: likewise, e' P^-1 e.
    """

    position: FloatArray
    yaw: FloatArray
    nees: FloatArray


def cells_of(name: str) -> tuple[Cell, ...]:
    """Return the starts of a filter; those that know the noise have one."""
    return (RIGHT,) if name in (KNOWS, ORACLE) else CELLS


def with_lasting_errors(recording: Recording, case: LastingCase, white: FloatArray) -> Recording:
    """Return a recording with lasting errors.

    Args:
        recording: with white noise, of n robots.
        case: the errors.
        white: `(T, n, 2)` independent N(0, 1), of which those of the fixes are made.
    """
    z = recording.measurement.copy()
    z[..., POSITION_SLICE] += gauss_markov(white, case.model, recording.period_s)
    z[..., Row.COMPASS_YAW] = wrap_angle(z[..., Row.COMPASS_YAW] + case.compass_offset)
    return recording._replace(measurement=z)


def gauss_markov(white: FloatArray, model: ErrorModel, period_s: float) -> FloatArray:
    """Return stationary Gauss-Markov processes `(T, ...)` [m], of N(0, 1) of the same shape."""
    phi = model.decay(period_s)
    errors = white.copy()  # the first one is stationary
    for k in range(1, len(errors)):
        errors[k] = phi * errors[k - 1] + (1.0 - phi**2) ** 0.5 * white[k]
    return model.fix_std * errors


def run_cases(
    localizer: LocalizerParameters, path: str, steps: int, runs: int, seed: tuple[int, ...]
) -> dict[str, dict[str, FilterErrors]]:
    """Run every filter in every case, on the same drive; errors by case and filter.

    Args:
        localizer: parameters of the filters.
        path: that is driven, one of `SIMULATIONS`.
        steps: T, periods of 375 ms.
        runs: n.
        seed: of everything random.
    """
    record_rng, start_rng, error_rng = np.random.default_rng(seed).spawn(3)
    robot = FakeRobotParameters(path=path)
    clean = record(robot, NOMINAL, steps, runs, record_rng)
    Q, R = np.square(robot.slip()), NOMINAL_MEASUREMENT_NOISE
    start = starts(clean, Q, R, CELLS, start_rng)
    white = error_rng.standard_normal((steps, runs, 2))
    filters = study_filters(localizer)
    found = {}
    for name, case in CASES.items():
        recording = with_lasting_errors(clean, case, white)
        run_of = {each: filters[each].run for each in LABELS if each != KNOWS}
        run_of[KNOWS] = partial(_run_known, case.model)
        found[name] = {
            each: _errors(run_of[each](recording, _some(start, each)), recording, steps)
            for each in LABELS
        }
    return found


def _run_known(model: ErrorModel, recording: Recording, start: Start) -> Estimates:
    """Run the EKF that knows the errors from its one start `(1, n)`."""
    found = known_errors.run(recording, Start(*(array[0] for array in start)), model)
    return Estimates(*(array[:, None] for array in found))


def _some(start: Start, name: str) -> Start:
    """Return the starts of a filter, the first of `CELLS`."""
    return Start(*(array[: len(cells_of(name))] for array in start))


def _errors(estimates: Estimates, recording: Recording, steps: int) -> FilterErrors:
    """Return what estimates `(T, cells, n)` come to in each range."""
    errors = compare(estimates, recording.truth)
    squares = errors.error**2
    ranges = halves(steps).values()
    return FilterErrors(
        position=np.stack([squares[some, ..., :2].sum(axis=-1).mean(axis=0) for some in ranges]),
        yaw=np.stack([squares[some, ..., 2].mean(axis=0) for some in ranges]),
        nees=np.stack([errors.nees[some].mean(axis=0) for some in ranges]),
    )
