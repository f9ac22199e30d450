# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Recordings of `study real`: read once by the localizer, then through every filter."""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from fnn_ekf_ros.core.arrays import STATE_SIZE, FloatArray, Row
from fnn_ekf_ros.errors import FnnEkfError
from fnn_ekf_ros.parameters.localizer import LocalizerParameters
from fnn_ekf_ros.recordings.bag_files import BagError, BagReader
from fnn_ekf_ros.recordings.inputs import TopicNames, inputs_in, no_start, take
from fnn_ekf_ros.recordings.trajectories import read_trajectory
from fnn_ekf_ros.reports.progress import with_progress
from fnn_ekf_ros.study.ablations import RealFilter, real_filters
from fnn_ekf_ros.study.filters import EKF_GATED, FIXED
from fnn_ekf_ros.study.real import (
    BatchStart,
    RealScore,
    Run,
    batch_start,
    collect,
    diverged,
    recording_localizer,
    rows_measured,
    run_starts,
    score_starts,
)
from fnn_ekf_ros.study.starts import ALL_CELLS
from fnn_ekf_ros.study.taught import Teacher, taught_by
from fnn_ekf_ros.timeline.initialization import AwaitingStart
from fnn_ekf_ros.timeline.period import Period
from fnn_ekf_ros.timeline.trajectory import interpolate


class RealRecording(NamedTuple):
    """A bag, ready to be run.

    Attributes:
        label: the bag's name.
        parameters: of the localizer; their noise is what a factor of 1 stands for.
        parameter_files: where they are from.
        periods: of the localizer, with its wait for the start.
        batch: starts and periods.
        truth: `(T, 3)` true poses at the start and at each period's end; NaN where not known.
    """

    label: str
    parameters: LocalizerParameters
    parameter_files: list[str]
    periods: tuple[Period, ...]
    batch: BatchStart
    truth: FloatArray


class FilterResult(NamedTuple):
    """Results of a filter from every start.

    Attributes:
        name: what `--filters` calls it.
        label: what tables and figures call it.
        score: `(n,)` errors.
        diverged: `(n,)` 1 where it was lost, else 0.
        process_noise_std: `(n, 2)` in use at the end (m, rad).
        measurement_noise_std: `(n, 4)` in use at the end (m, m, rad, rad).
        position_with_noise_found: `(n,)` position RMSE of EKFs with that noise [m].
    """

    name: str
    label: str
    score: RealScore
    diverged: FloatArray
    process_noise_std: FloatArray
    measurement_noise_std: FloatArray
    position_with_noise_found: FloatArray


class Reference(NamedTuple):
    """The fixed EKF with the gate that is best in position, which takes a ground truth to find.

    Attributes:
        start: index of its start in `ALL_CELLS`.
        position: its position RMSE [m].
        yaw: its yaw RMSE [rad]; NaN if truth has none.
    """

    start: int
    position: float
    yaw: float


class BagResult(NamedTuple):
    """Results of the filters on a recording.

    Attributes:
        label: the bag's name.
        parameter_files: where the parameters are from.
        process_noise_std: that a factor of 1 stands for (m, rad).
        measurement_noise_std: that a factor of 1 stands for (m, m, rad, rad).
        rows: that were measured.
        duration_s: from the first estimate to the last [s].
        estimates: how many.
        scored: how many of them with a known truth.
        taught_by: what the filters that adapt have learned from before; empty for the starts' own
            noise.
        reference: what the filters are compared with.
        filters: the fixed EKFs first.
    """

    label: str
    parameter_files: tuple[str, ...]
    process_noise_std: tuple[float, ...]
    measurement_noise_std: tuple[float, ...]
    rows: tuple[Row, ...]
    duration_s: float
    estimates: int
    scored: int
    taught_by: str
    reference: Reference
    filters: tuple[FilterResult, ...]


def read_recording(
    path: Path,
    label: str,
    parameters: LocalizerParameters,
    files: list[str],
    truth_topic: str,
    remappings: list[str],
) -> RealRecording:
    """Take a bag through the localizer once, for its periods, and read the truth.

    Args:
        path: the bag.
        label: its name.
        parameters: of the localizer.
        files: names of the files that the parameters are from.
        truth_topic: topic of the ground truth.
        remappings: `FROM:=TO` of the command line.

    Raises:
        BagError: the bag cannot be used.
    """
    with BagReader(path) as bag:
        truth = read_trajectory(bag, truth_topic)
    periods = read_periods(path, label, parameters, remappings)
    batch = batch_start(parameters, periods, ALL_CELLS)
    true_pose = np.full((1 + len(batch.inputs), 3), np.nan)
    if len(truth.time_ns) > 1:
        true_pose = interpolate(truth, np.array([batch.stamp_ns, *batch.stamps_ns]))
    if not np.any(np.isfinite(true_pose[1:, 0])):
        raise BagError(f"bag '{path}': odom and {truth_topic} have no time in common")
    return RealRecording(
        label=label,
        parameters=parameters,
        parameter_files=files,
        periods=periods,
        batch=batch,
        truth=true_pose,
    )


def read_periods(
    path: Path, label: str, parameters: LocalizerParameters, remappings: list[str]
) -> tuple[Period, ...]:
    """Take a bag through the localizer once; return the periods, a filter starts in one of them.

    Args:
        path: the bag.
        label: its name.
        parameters: of the localizer.
        remappings: `FROM:=TO` of the command line.

    Raises:
        BagError: the bag cannot be used.
    """
    localizer, recorder = recording_localizer(parameters)
    names = TopicNames(remappings)
    with BagReader(path) as bag:
        inputs = inputs_in(bag, parameters, names)
        for record in with_progress(bag.records(), bag.message_count, f"{label}: reading"):
            take(localizer, bag, record, inputs)
        periods = recorder.periods
        if recorder.broken_ns is not None:
            raise BagError(
                f"bag '{path}': the localizer starts anew at {recorder.broken_ns * 1e-9:.3f} s; "
                "expected a recording without jumps of the clock"
            )
        if not periods or isinstance(periods[-1].after, AwaitingStart):
            raise no_start(localizer, bag, inputs)
    return tuple(periods)


def run_filters(
    recording: RealRecording, names: Sequence[str], teacher: Teacher | None = None
) -> BagResult:
    """Run the filters and score them.

    Args:
        recording: the bag.
        names: of the filters; the fixed EKFs first.
        teacher: gives the filters that adapt what they start with; None for the starts' own noise.

    Raises:
        FnnEkfError: a filter failed.
    """
    known = real_filters(recording.parameters)
    runs = {name: _run(_prepared(recording, name, teacher), name, known[name]) for name in names}
    scores = {name: score_starts(each, recording.truth) for name, each in runs.items()}
    reference = _reference(scores[EKF_GATED])
    filters = []
    for name, ended in runs.items():
        found = scores[name].position
        if name not in FIXED:
            start = recording.batch.start._replace(
                process_noise=ended.process_noise, measurement_noise=ended.measurement_noise
            )
            again = recording._replace(batch=recording.batch._replace(start=start))
            rerun = _run(again, f"EKF on noise of {name}", known[EKF_GATED])
            found = score_starts(rerun, recording.truth).position
        filters.append(
            FilterResult(
                name=name,
                label=known[name].label,
                score=scores[name],
                diverged=diverged(scores[name], reference.position),
                process_noise_std=np.sqrt(ended.process_noise),
                measurement_noise_std=np.sqrt(ended.measurement_noise),
                position_with_noise_found=found,
            )
        )
    p, stamps = recording.parameters, recording.batch.stamps_ns
    return BagResult(
        label=recording.label,
        parameter_files=tuple(recording.parameter_files),
        process_noise_std=p.process_noise_std,
        measurement_noise_std=(*p.measurement_noise_std, p.lrf_yaw_std),
        rows=rows_measured(recording.batch),
        duration_s=1e-9 * (stamps[-1] - recording.batch.stamp_ns),
        estimates=len(recording.truth),
        scored=int(np.sum(np.isfinite(recording.truth[:, 0]))),
        taught_by="" if teacher is None else teacher.label,
        reference=reference,
        filters=tuple(filters),
    )


def _reference(score: RealScore) -> Reference:
    """Return the best of the fixed EKFs with the gate."""
    best = int(np.argmin(score.position))
    return Reference(
        start=best,
        position=float(score.position[best]),
        yaw=float(score.rmse[best, STATE_SIZE - 1]),
    )


def _prepared(recording: RealRecording, name: str, teacher: Teacher | None) -> RealRecording:
    """Return a recording with the starts of a filter, of what it was taught if it adapts."""
    if teacher is None or name in FIXED:
        return recording
    learned = taught_by(teacher, name)
    batch = batch_start(recording.parameters, recording.periods, ALL_CELLS, learned)
    return recording._replace(batch=batch)


def _run(recording: RealRecording, name: str, which: RealFilter) -> Run:
    states = run_starts(which.model, recording.batch, which.hold)
    try:
        return collect(with_progress(states, len(recording.truth), f"{recording.label}: {name}"))
    except (ArithmeticError, np.linalg.LinAlgError) as error:
        raise FnnEkfError(f"'{recording.label}': the filter {name} failed ({error})") from None
