# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Does accuracy depend on the period, and on rates and phases of the sensors?

Robots on the round path with the slip of simulation 2; fixes and compass have the paper's noise,
a reading's whatever its rate. Two questions:

- With the right noise and no adaptation, is the estimate the same for every period, and that of an
  EKF which takes every reading at its instant and knows no periods?
- Does joint adaptation find the noise from wrong starts, whatever the period, the rates and phases?
"""

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from fnn_ekf_ros.core.arrays import FloatArray
from fnn_ekf_ros.core.pace import NOMINAL_PERIOD_S
from fnn_ekf_ros.parameters.fake_robot import FakeRobotParameters
from fnn_ekf_ros.parameters.localizer import LocalizerParameters
from fnn_ekf_ros.simulation.robot import STEP_S
from fnn_ekf_ros.study.filters import EKF, JOINT, localizer_models
from fnn_ekf_ros.study.instants import (
    Timing,
    drive_steps,
    in_periods,
    read_sensors,
    run_periods,
)
from fnn_ekf_ros.study.recording import Start
from fnn_ekf_ros.study.rivals import plain_ekf
from fnn_ekf_ros.study.scenarios import NOMINAL_MEASUREMENT_NOISE, Drive
from fnn_ekf_ros.study.scores import compare
from fnn_ekf_ros.study.starts import CORNERS, RIGHT, starts_at
from fnn_ekf_ros.timeline.trajectory import pose_errors

PATH = "round"
"""Name of the path that is driven."""
PERIODS_S = (0.02, 0.1, 0.375, 1.0)
"""Periods that are compared [s]; the others are compared with the first."""
COMMON_S = 3.0
"""Interval at which all these periods end at the same instant [s]; runs are whole multiples of
it."""
FIX_RATE, COMPASS_RATE = 10.0, 50.0
"""Rates where the period is in question [Hz]."""
SHORT_RUNS_SHARE = 2.0
"""Factor on the number of runs where many fixes a second make them short: their intervals become as
narrow as the others."""
FIX_RATES = {1.0: 0.5, 2.6667: 1.0, 5.0: 1.0, 20.0: SHORT_RUNS_SHARE}
"""Further rates of the fixes [Hz], each with a factor on the number of runs."""
PHASES = {"aligned": (0.0, 0.0), "shifted": (0.3, 0.6)}
"""Phases of fixes and compass, as parts of their intervals: at multiples of the intervals, or
later."""
CELLS = (RIGHT, *CORNERS)
"""Starts of joint adaptation."""
SAME_WITHIN = 0.03
"""Largest relative difference of the RMSE of two periods, or of two filters, that count as the
same."""
LARGEST_RATIO = 1.05
"""Largest RMSE of mode joint, as a ratio to the EKF that knows the noise, that meets the bar."""
NEES_RANGE = (2.5, 3.8)
"""Range of the mean NEES that meets the bar; 3 is ideal."""


class RateCase(NamedTuple):
    """A setting that joint adaptation is tried in.

    Attributes:
        phases: a name in `PHASES`.
        timing: when the sensors are read.
        period_s: of the filter [s].
        has_bar: whether it has to meet `LARGEST_RATIO` and `NEES_RANGE`; else it is only reported.
        run_share: part of the runs: more where they are short, fewer where they are long.
        fix_share: part of the fixes of each run, where it would take too long.
    """

    phases: str
    timing: Timing
    period_s: float = NOMINAL_PERIOD_S
    has_bar: bool = True
    run_share: float = 1.0
    fix_share: float = 1.0


def _timing(fix_rate: float, compass_rate: float, phases: str, *, fix_yaw: bool = False) -> Timing:
    fix_phase, compass_phase = PHASES[phases]
    return Timing(
        fix_rate=fix_rate,
        compass_rate=compass_rate,
        fix_phase=fix_phase,
        compass_phase=compass_phase,
        fix_yaw=fix_yaw,
    )


RATE_CASES = (
    *(
        RateCase(
            phases, _timing(FIX_RATE, COMPASS_RATE, phases), period_s, run_share=SHORT_RUNS_SHARE
        )
        for period_s in PERIODS_S
        for phases in PHASES
    ),
    *(
        RateCase(phases, _timing(fix_rate, COMPASS_RATE, phases), run_share=run_share)
        for fix_rate, run_share in FIX_RATES.items()
        for phases in PHASES
    ),
    RateCase(
        "aligned", _timing(0.2, COMPASS_RATE, "aligned"), has_bar=False,
        run_share=0.25, fix_share=0.5,
    ),
    *(
        RateCase(
            phases, _timing(FIX_RATE, 1.0, phases), has_bar=False, run_share=SHORT_RUNS_SHARE
        )
        for phases in PHASES
    ),
    *(
        RateCase(
            phases, _timing(FIX_RATE, 0.0, phases, fix_yaw=True), has_bar=False,
            run_share=SHORT_RUNS_SHARE,
        )
        for phases in PHASES
    ),
)  # fmt: skip
"""The period at one pair of rates, the rates at one period, and what is only reported."""


class PeriodErrors(NamedTuple):
    """Mean square errors of n runs at the instants that all periods have in common.

    Attributes:
        position: `(periods, n)` without adaptation, in the order of `PERIODS_S` [m^2].
        yaw: likewise [rad^2].
        plain_position: `(n,)` of the independent EKF [m^2].
        plain_yaw: likewise [rad^2].
    """

    position: FloatArray
    yaw: FloatArray
    plain_position: FloatArray
    plain_yaw: FloatArray


class RateErrors(NamedTuple):
    """Mean square errors of n runs over the ends of the periods of their last half.

    Attributes:
        position: `(cells, n)` of joint adaptation [m^2].
        yaw: likewise [rad^2].
        nees: `(cells, n)` means of its NEES.
        oracle_position: `(n,)` of the EKF that knows the noise [m^2].
        oracle_yaw: likewise [rad^2].
        oracle_nees: `(n,)` means of its NEES.
    """

    position: FloatArray
    yaw: FloatArray
    nees: FloatArray
    oracle_position: FloatArray
    oracle_yaw: FloatArray
    oracle_nees: FloatArray


def run_length(least_s: float) -> float:
    """Return the time of a run that is to be this long at least: a multiple of `COMMON_S` [s]."""
    return COMMON_S * max(math.ceil(least_s / COMMON_S - 1e-3), 1)


def case_length(case: RateCase, fixes: int) -> float:
    """Return how long the runs of a case are that have so many fixes in the others [s]."""
    return run_length(case.fix_share * fixes / case.timing.fix_rate)


def case_runs(case: RateCase, runs: int) -> int:
    """Return how many runs a case has where the others have so many; an interval needs two."""
    return max(round(case.run_share * runs), 2)


def period_errors(
    localizer: LocalizerParameters, phases: str, seconds: float, runs: int, seed: tuple[int, ...]
) -> PeriodErrors:
    """Run the filter without adaptation at every period, and the independent EKF.

    Args:
        localizer: parameters of the filter.
        phases: a name in `PHASES`.
        seconds: length of the runs, a multiple of `COMMON_S` [s].
        runs: n.
        seed: of everything random.
    """
    robot, timing = FakeRobotParameters(path=PATH), _timing(FIX_RATE, COMPASS_RATE, phases)
    drive_rng, sensor_rng, start_rng = np.random.default_rng(seed).spawn(3)
    driven = _drive(robot, seconds, runs, drive_rng)
    readings = read_sensors(driven, timing, sensor_rng)
    Q, R = np.square(robot.slip()), NOMINAL_MEASUREMENT_NOISE
    start = starts_at(driven.truth[0], Q, R, (RIGHT,), start_rng)
    squares = []
    for period_s in PERIODS_S:
        model = localizer_models(replace(localizer, period=period_s))[EKF].model
        recording = in_periods(robot, driven, readings, period_s)
        errors = compare(run_periods(model, recording, start), recording.truth)
        every = round(COMMON_S / period_s)
        squares.append(_squares(errors.error[every - 1 :: every, 0]))
    recording = in_periods(robot, driven, readings, COMMON_S)
    mean, _ = plain_ekf.run(recording, Start(*(array[0] for array in start)))
    error = pose_errors(mean, recording.truth[1:])
    plain = _squares(error)
    return PeriodErrors(
        position=np.array([each.position for each in squares]),
        yaw=np.array([each.yaw for each in squares]),
        plain_position=plain.position,
        plain_yaw=plain.yaw,
    )


def rate_errors(
    localizer: LocalizerParameters,
    case: RateCase,
    seconds: float,
    runs: int,
    seed: tuple[int, ...],
) -> RateErrors:
    """Run joint adaptation from all `CELLS`, and the EKF that knows the noise.

    Args:
        localizer: parameters of the filters.
        case: period, rates and phases.
        seconds: length of the runs [s].
        runs: n.
        seed: of everything random.
    """
    robot = FakeRobotParameters(path=PATH)
    drive_rng, sensor_rng, start_rng = np.random.default_rng(seed).spawn(3)
    driven = _drive(robot, seconds, runs, drive_rng)
    readings = read_sensors(driven, case.timing, sensor_rng)
    recording = in_periods(robot, driven, readings, case.period_s)
    Q, R = np.square(robot.slip()), NOMINAL_MEASUREMENT_NOISE
    start = starts_at(driven.truth[0], Q, R, CELLS, start_rng)
    models = localizer_models(replace(localizer, period=case.period_s))
    oracle_start = Start(*(array[:1] for array in start))
    oracle = compare(run_periods(models[EKF].model, recording, oracle_start), recording.truth)
    joint = compare(run_periods(models[JOINT].model, recording, start), recording.truth)
    half = slice(len(joint.error) // 2, None)
    squares, oracle_squares = _squares(joint.error[half]), _squares(oracle.error[half])
    return RateErrors(
        position=squares.position,
        yaw=squares.yaw,
        nees=np.mean(joint.nees[half], axis=0),
        oracle_position=oracle_squares.position[0],
        oracle_yaw=oracle_squares.yaw[0],
        oracle_nees=np.mean(oracle.nees[half], axis=0)[0],
    )


def _drive(
    robot: FakeRobotParameters, seconds: float, runs: int, rng: np.random.Generator
) -> Drive:
    return drive_steps(robot, round(seconds / STEP_S), runs, rng)


class _Squares(NamedTuple):
    """Mean squares of errors.

    Attributes:
        position: `(..., n)` [m^2].
        yaw: `(..., n)` [rad^2].
    """

    position: FloatArray
    yaw: FloatArray


def _squares(error: FloatArray) -> _Squares:
    """Return the mean squares of position and yaw, of errors `(T, ..., n, 3)`."""
    return _Squares(
        position=np.sum(np.mean(error[..., :2] ** 2, axis=0), axis=-1),
        yaw=np.mean(error[..., 2] ** 2, axis=0),
    )
