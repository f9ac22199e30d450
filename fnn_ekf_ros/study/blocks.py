# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Taking a filter over a recording: some of the robots at a time, components first."""

from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np

from fnn_ekf_ros.core.arrays import STATE_SIZE, FloatArray, components_first, components_last
from fnn_ekf_ros.core.results import Epoch
from fnn_ekf_ros.study.recording import Estimates, Recording, Start, of_runs

NUMBERS_AT_ONCE = 150_000
"""Floating-point numbers of the robots that go through a filter side by side: more fall out of the
cache and are slower, with fewer the overhead of Python dominates."""
NUMBERS_OF_A_FILTER = 12
"""Floating-point numbers that one filter keeps: its mean and covariance."""


class BlockStart(NamedTuple):
    """Start of a filter of some robots; all arrays have their batch.

    Attributes:
        period_s: length of one step [s].
        mean: `(3, *batch)` start pose (m, m, rad; map frame).
        covariance: `(3, 3, *batch)` its covariance.
        process_noise: `(2, *batch)` assumed diagonal of Q (m^2, rad^2).
        measurement_noise: `(4, *batch)` assumed diagonal of R, rows as in `Row`.
    """

    period_s: float
    mean: FloatArray
    covariance: FloatArray
    process_noise: FloatArray
    measurement_noise: FloatArray


class StepEstimate(NamedTuple):
    """Estimate of some robots' poses after a step.

    Attributes:
        mean: `(3, *batch)` poses (m, m, rad; map frame).
        covariance: `(3, 3, *batch)` their covariances.
        nis: `(*batch)` normalized innovation squared; 0 where nothing was measured.
    """

    mean: FloatArray
    covariance: FloatArray
    nis: FloatArray


BlockFilter = Callable[[BlockStart, Iterator[Epoch]], Iterator[StepEstimate]]
"""Takes some robots over all steps, and yields an estimate after each."""


def block_start(recording: Recording, start: Start) -> BlockStart:
    """Return starts `(..., n)` of a recording as one block."""
    batch = _batch_of(recording, start)
    return BlockStart(
        period_s=recording.period_s,
        mean=_components_first(start.mean, batch),
        covariance=_components_first(start.covariance, batch, 2),
        process_noise=_components_first(start.process_noise, batch),
        measurement_noise=_components_first(start.measurement_noise, batch),
    )


def block_epochs(recording: Recording, start: Start) -> Iterator[Epoch]:
    """Yield the readings of a recording in each step, for starts `(..., n)`."""
    batch = _batch_of(recording, start)
    for control, measurement, available in zip(
        recording.control, recording.measurement, recording.available, strict=True
    ):
        yield Epoch(
            control=_components_first(control, batch),
            duration_s=recording.period_s,
            measurement=_components_first(measurement, batch),
            available=_components_first(available, batch),
        )


def run_in_blocks(
    recording: Recording, start: Start, block_filter: BlockFilter, numbers: int
) -> Estimates:
    """Run a filter over a recording, as many robots at a time as the cache holds.

    Args:
        recording: of n robots.
        start: `(..., n)` starts.
        block_filter: is called once for each block: one run or more, with all their starts.
        numbers: how many the filter remembers of a robot.
    """
    batch = _batch_of(recording, start)
    shape = (len(recording.control), *batch)
    estimates = Estimates(
        mean=np.empty((*shape, STATE_SIZE)),
        covariance=np.empty((*shape, STATE_SIZE, STATE_SIZE)),
        nis=np.empty(shape),
        degrees_of_freedom=np.empty(shape),
    )
    runs = batch[-1]
    at_once = max(NUMBERS_AT_ONCE // numbers * runs // max(estimates.nis[0].size, 1), 1)
    for first in range(0, runs, at_once):
        some = slice(first, first + at_once)
        _run_block(of_runs(recording, some), of_runs(start, some), block_filter, estimates, some)
    return estimates


def _run_block(
    recording: Recording, start: Start, block_filter: BlockFilter, estimates: Estimates, some: slice
) -> None:
    """Run a filter over some of the runs, and fill in their part of the estimates."""
    steps = block_filter(block_start(recording, start), block_epochs(recording, start))
    for t, estimate in enumerate(steps):
        estimates.mean[t][..., some, :] = components_last(estimate.mean)
        estimates.covariance[t][..., some, :, :] = components_last(estimate.covariance, 2)
        estimates.nis[t][..., some] = estimate.nis
        estimates.degrees_of_freedom[t][..., some] = recording.available[t].sum(axis=-1)


def _batch_of(recording: Recording, start: Start) -> tuple[int, ...]:
    """Return the batch that starts and the recording's runs broadcast to."""
    return np.broadcast_shapes(
        recording.control.shape[1:-1],
        start.mean.shape[:-1],
        start.covariance.shape[:-2],
        start.process_noise.shape[:-1],
        start.measurement_noise.shape[:-1],
    )


def _components_first(array: Any, batch: tuple[int, ...], count: int = 1) -> Any:
    """Return an array `(..., n)` for a batch, with its components first."""
    components = array.shape[-count:]
    whole = np.broadcast_to(array, (*batch, *components))
    return np.ascontiguousarray(components_first(whole, count))
