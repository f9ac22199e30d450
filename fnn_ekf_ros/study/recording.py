# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Inputs and results of every filter of a study; time first, then the batch."""

from typing import NamedTuple, TypeVar

from fnn_ekf_ros.core.arrays import BoolArray, FloatArray


class Recording(NamedTuple):
    """Measurements of a batch of robots, with the truth; T steps, n runs.

    Attributes:
        period_s: length of one step [s].
        truth: `(T + 1, n, 3)` true poses, the start first (m, m, rad; map frame).
        control: `(T, n, 2)` [dS, dtheta] from the encoders (m, rad).
        measurement: `(T, n, 4)` z at the end of each step, rows as in `Row` (m, m, rad, rad).
        available: `(T, n, 4)` which rows were measured.
        process_noise: `(T, 2)` diagonal of the true Q of each step (m^2, rad^2).
        measurement_noise: `(T, 4)` diagonal of the true R of each step.
    """

    period_s: float
    truth: FloatArray
    control: FloatArray
    measurement: FloatArray
    available: BoolArray
    process_noise: FloatArray
    measurement_noise: FloatArray


class Start(NamedTuple):
    """Start of a filter; leading dimensions broadcast to the batch.

    Attributes:
        mean: `(..., n, 3)` start pose (m, m, rad; map frame).
        covariance: `(..., n, 3, 3)` its covariance.
        process_noise: `(..., n, 2)` assumed diagonal of Q (m^2, rad^2).
        measurement_noise: `(..., n, 4)` assumed diagonal of R, rows as in `Row`.
    """

    mean: FloatArray
    covariance: FloatArray
    process_noise: FloatArray
    measurement_noise: FloatArray


class Estimates(NamedTuple):
    """Estimates of a filter after each of the T steps.

    Attributes:
        mean: `(T, ..., n, 3)` poses (m, m, rad; map frame).
        covariance: `(T, ..., n, 3, 3)` their covariances.
        nis: `(T, ..., n)` normalized innovation squared; 0 where nothing was measured.
        degrees_of_freedom: `(T, ..., n)` of `nis`.
    """

    mean: FloatArray
    covariance: FloatArray
    nis: FloatArray
    degrees_of_freedom: FloatArray


ValueT = TypeVar("ValueT", Recording, Start)
"""Recording or start."""


def of_runs(value: ValueT, some: slice) -> ValueT:
    """Return some of the runs of a recording or of starts; views. What all runs share is kept."""
    if isinstance(value, Start):
        return Start(
            mean=_of_runs(value.mean, some),
            covariance=_of_runs(value.covariance, some, 2),
            process_noise=_of_runs(value.process_noise, some),
            measurement_noise=_of_runs(value.measurement_noise, some),
        )
    return value._replace(
        truth=value.truth[:, some],
        control=value.control[:, some],
        measurement=value.measurement[:, some],
        available=value.available[:, some],
    )


def _of_runs(array: FloatArray, some: slice, components: int = 1) -> FloatArray:
    """Return an array `(..., n, *components)` of some runs; itself where all runs share one."""
    if array.ndim == components or array.shape[-1 - components] == 1:
        return array
    return array[..., some, :] if components == 1 else array[..., some, :, :]
