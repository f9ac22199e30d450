# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Recordings whose readings have instants of their own, and the filter over their periods.

In the other recordings everything is read at the end of a period of 375 ms. Here fixes and compass
come at rates and phases of their own, as to the localizer: a period consists of the epochs between
the instants at which something is read, and ends at its boundary. Truth and encoder counts are
known every 12.5 ms and interpolated linearly in between; the counts there are whole ones.
"""

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fnn_ekf_ros.core.angles import wrap_angle
from fnn_ekf_ros.core.arrays import (
    MEASUREMENT_SIZE,
    STATE_OF_ROW,
    STATE_SIZE,
    BoolArray,
    FloatArray,
    Row,
    components_first,
    components_last,
)
from fnn_ekf_ros.core.filter import step
from fnn_ekf_ros.core.odometry import control_from_counts
from fnn_ekf_ros.core.results import Epoch
from fnn_ekf_ros.core.rows import FIX_ROWS, POSITION_ROWS
from fnn_ekf_ros.core.state import FilterModel, start_filter
from fnn_ekf_ros.parameters.fake_robot import FakeRobotParameters
from fnn_ekf_ros.simulation.delivery import STEP_NS
from fnn_ekf_ros.simulation.paths import scripted_path
from fnn_ekf_ros.simulation.reading_times import ReadingTimes
from fnn_ekf_ros.simulation.robot import (
    RobotState,
    advance,
    at_rest,
    encoder_counts,
    follow,
    wheel_geometry,
)
from fnn_ekf_ros.study.recording import Estimates, Start, of_runs
from fnn_ekf_ros.study.scenarios import NOMINAL_MEASUREMENT_NOISE, Drive
from fnn_ekf_ros.timeline.trajectory import pose_errors

TimeArray = NDArray[np.int64]
"""Array of times [ns]."""

NS_PER_S = 10**9
"""Nanoseconds per second."""
ROBOTS_AT_ONCE = 200
"""Number of robots that go through a filter side by side: as many of mode joint as fit the
cache."""
COMPASS_ROWS = (Row.COMPASS_YAW,)
"""Rows that the compass measures."""


class Timing(NamedTuple):
    """Times at which the sensors are read.

    Attributes:
        fix_rate: fixes per second [Hz].
        compass_rate: readings of the compass per second [Hz]; 0 if there is none.
        fix_phase: by which part of its interval each fix comes after a multiple of it.
        compass_phase: the same of the compass.
        fix_yaw: whether the yaw of the fixes is used.
    """

    fix_rate: float
    compass_rate: float
    fix_phase: float = 0.0
    compass_phase: float = 0.0
    fix_yaw: bool = False


class Readings(NamedTuple):
    """Measurements of the sensors of n robots, at K instants.

    Attributes:
        time_ns: `(K,)` when, in ascending order [ns since the start].
        measurement: `(K, 4, n)` z, rows as in `Row` (m, m, rad, rad).
        available: `(K, 4)` which rows were measured.
    """

    time_ns: TimeArray
    measurement: FloatArray
    available: BoolArray


class TimedRecording(NamedTuple):
    """Inputs of a filter for n robots, with the truth; E epochs in T periods.

    Attributes:
        period_s: length of a period [s].
        truth: `(T + 1, n, 3)` true poses at the start and the ends of the periods (m, m, rad).
        duration_s: `(E,)` of the epochs [s].
        ends_period: `(E,)` whether an epoch ends at the boundary of a period.
        control: `(E, 2, n)` [dS, dtheta] from the encoders (m, rad).
        measurement: `(E, 4, n)` z at the end of the epoch (m, m, rad, rad).
        available: `(E, 4)` which rows were measured.
    """

    period_s: float
    truth: FloatArray
    duration_s: FloatArray
    ends_period: BoolArray
    control: FloatArray
    measurement: FloatArray
    available: BoolArray


def drive_steps(
    robot: FakeRobotParameters, steps: int, runs: int, rng: np.random.Generator
) -> Drive:
    """Drive robots along their path; the drive has every step of 12.5 ms.

    Args:
        robot: geometry, path, speed and slip.
        steps: S, of 12.5 ms.
        runs: n, robots that differ in what is random.
        rng: source of slip and of the motor control's error.
    """
    path = scripted_path(robot.path)
    state = at_rest(np.tile(path.start(), (runs, 1)))
    truth, travel = np.empty((steps + 1, runs, 3)), np.empty((steps + 1, runs, 2))
    truth[0], travel[0] = state.pose, state.travel
    for k in range(steps):
        state, command = follow(path, state, robot.speed)
        state = advance(robot, state, command, rng)
        truth[k + 1], travel[k + 1] = state.pose, state.travel
    return Drive(truth, travel)


def true_poses(driven: Drive, time_ns: TimeArray) -> FloatArray:
    """Return the true poses `(K, n, 3)` at instants `(K,)` [ns] of a drive of 12.5 ms steps."""
    first, last, part = _between(driven.truth, time_ns)
    pose = first + part * pose_errors(last, first)
    pose[..., 2] = wrap_angle(pose[..., 2])
    return pose


def counts_at(robot: FakeRobotParameters, driven: Drive, time_ns: TimeArray) -> FloatArray:
    """Return the counts `(K, n, 2)` [left, right] at instants `(K,)`; whole at each 12.5 ms."""
    counts = encoder_counts(
        robot, RobotState(pose=driven.truth, travel=driven.travel, progress=np.zeros(()))
    )
    first, last, part = _between(counts, time_ns)
    return np.asarray(first + part * (last - first))


def read_sensors(driven: Drive, timing: Timing, rng: np.random.Generator) -> Readings:
    """Return what the sensors measure on a drive: z = truth + N(0, R), R the paper's.

    Each sensor draws from a stream of its own.

    Args:
        driven: the drive, of 12.5 ms steps.
        timing: when the sensors are read.
        rng: source of their noise.
    """
    end_ns = STEP_NS * (len(driven.truth) - 1)
    sensors = (
        (FIX_ROWS if timing.fix_yaw else POSITION_ROWS, timing.fix_rate, timing.fix_phase),
        (COMPASS_ROWS, timing.compass_rate, timing.compass_phase),
    )
    times = [reading_times(rate, phase, end_ns) for _, rate, phase in sensors]
    instants = np.unique(np.concatenate(times))
    measurement = np.zeros((len(instants), MEASUREMENT_SIZE, driven.truth.shape[1]))
    available = np.zeros((len(instants), MEASUREMENT_SIZE), dtype=np.bool_)
    for (rows, _, _), own, own_rng in zip(sensors, times, rng.spawn(len(sensors)), strict=True):
        where, pose = np.searchsorted(instants, own), true_poses(driven, own)
        for row in rows:
            noise = np.sqrt(NOMINAL_MEASUREMENT_NOISE[row]) * own_rng.standard_normal(
                pose.shape[:2]
            )
            measurement[where, row] = pose[..., STATE_OF_ROW[row]] + noise
            available[where, row] = True
    measurement[:, Row.COMPASS_YAW :] = wrap_angle(measurement[:, Row.COMPASS_YAW :])
    return Readings(instants, measurement, available)


def reading_times(rate: float, phase: float, end_ns: int) -> TimeArray:
    """Return when a sensor is read after the start and until an end [ns].

    Args:
        rate: readings per second [Hz]; none if 0.
        phase: by which part of the interval they come after a multiple of it.
        end_ns: the end [ns].
    """
    if rate == 0.0:
        return np.zeros(0, dtype=np.int64)
    times = ReadingTimes(rate, round(phase * NS_PER_S / rate))
    return np.array(times.within(0, end_ns), dtype=np.int64)


def in_periods(
    robot: FakeRobotParameters, driven: Drive, readings: Readings, period_s: float
) -> TimedRecording:
    """Return a drive and its readings as a filter gets them, cut into periods.

    Args:
        robot: its geometry and encoders.
        driven: the drive, of 12.5 ms steps.
        readings: what was measured.
        period_s: length of a period [s]; what is left after the last whole one is left out.
    """
    period_ns = round(period_s * NS_PER_S)
    count = STEP_NS * (len(driven.truth) - 1) // period_ns
    ends = period_ns * np.arange(1, count + 1, dtype=np.int64)
    kept = readings.time_ns <= ends[-1]
    read_ns = readings.time_ns[kept]
    instants = np.union1d(read_ns, ends)
    where, n = np.searchsorted(instants, read_ns), driven.truth.shape[1]
    measurement = np.zeros((len(instants), MEASUREMENT_SIZE, n))
    available = np.zeros((len(instants), MEASUREMENT_SIZE), dtype=np.bool_)
    measurement[where], available[where] = readings.measurement[kept], readings.available[kept]
    start_ns = np.zeros(1, dtype=np.int64)
    counts = counts_at(robot, driven, np.concatenate([start_ns, instants]))
    left, right = np.moveaxis(np.diff(counts, axis=0), -1, 0)
    control = control_from_counts(wheel_geometry(robot), left, right)
    return TimedRecording(
        period_s=period_s,
        truth=true_poses(driven, np.concatenate([start_ns, ends])),
        duration_s=np.diff(instants, prepend=0) / NS_PER_S,
        ends_period=np.isin(instants, ends),
        control=np.ascontiguousarray(np.swapaxes(control, 0, 1)),
        measurement=measurement,
        available=available,
    )


def period_epochs(recording: TimedRecording, cells: int, some: slice) -> Iterator[list[Epoch]]:
    """Yield the epochs of each period, for a batch `(cells, n)`.

    Args:
        recording: the recording.
        cells: so many filters get the same readings.
        some: runs of the batch.
    """

    def for_batch(values: Any) -> Any:
        own = values[:, None, some]
        return np.ascontiguousarray(np.broadcast_to(own, (len(own), cells, own.shape[-1])))

    epochs = []
    runs = recording.control.shape[-1]
    for k, (duration_s, ends) in enumerate(
        zip(recording.duration_s.tolist(), recording.ends_period.tolist(), strict=True)
    ):
        available = np.broadcast_to(recording.available[k, :, None], (MEASUREMENT_SIZE, runs))
        epochs.append(
            Epoch(
                control=for_batch(recording.control[k]),
                duration_s=duration_s,
                measurement=for_batch(recording.measurement[k]),
                available=for_batch(available),
            )
        )
        if ends:
            yield epochs
            epochs = []


def run_periods(model: FilterModel, recording: TimedRecording, start: Start) -> Estimates:
    """Run the localizer's filter over a recording; estimates at the periods' ends.

    Args:
        model: the filter.
        recording: of n robots.
        start: `(cells, n)` starts.

    Returns:
        `(T, cells, n)` estimates.
    """
    cells, runs = start.mean.shape[:2]
    shape = (len(recording.truth) - 1, cells, runs)
    estimates = Estimates(
        mean=np.empty((*shape, STATE_SIZE)),
        covariance=np.empty((*shape, STATE_SIZE, STATE_SIZE)),
        nis=np.empty(shape),
        degrees_of_freedom=np.empty(shape),
    )
    at_once = max(ROBOTS_AT_ONCE // cells, 1)
    for first in range(0, runs, at_once):
        some = slice(first, first + at_once)
        own = of_runs(start, some)
        state = start_filter(
            model,
            *(
                np.ascontiguousarray(components_first(array, count))
                for array, count in zip(own, (1, 2, 1, 1), strict=True)
            ),
        )
        for t, epochs in enumerate(period_epochs(recording, cells, some)):
            state, result = step(model, state, epochs)
            estimates.mean[t][:, some] = components_last(state.mean)
            estimates.covariance[t][:, some] = components_last(state.covariance, 2)
            estimates.nis[t][:, some] = result.nis
            estimates.degrees_of_freedom[t][:, some] = result.degrees_of_freedom
    return estimates


def _between(values: FloatArray, time_ns: TimeArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the values before and after instants, and which part of the step has passed."""
    step_index, rest = np.divmod(time_ns, STEP_NS)
    after = np.minimum(step_index + 1, len(values) - 1)
    part = (rest / STEP_NS)[:, None, None]
    return values[step_index], values[after], part
