# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Starts that are right or wrong about the noise."""

import dataclasses
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from fnn_ekf_ros.core.angles import wrap_angle
from fnn_ekf_ros.core.arrays import FloatArray
from fnn_ekf_ros.parameters.localizer import LocalizerParameters
from fnn_ekf_ros.study.recording import Recording, Start

FACTORS = (1.0 / 25.0, 1.0 / 4.0, 1.0, 4.0, 25.0)
"""Assumed over true variance: standard deviations are wrong by up to a factor of five."""


class Cell(NamedTuple):
    """Factors by which the noise of a start is wrong.

    Attributes:
        q: assumed over true variance of Q.
        k: assumed over true variance of R.
    """

    q: float
    k: float


RIGHT = Cell(1.0, 1.0)
"""The start with the true noise."""
ALL_CELLS = tuple(Cell(q, k) for q in FACTORS for k in FACTORS)
"""All 25 starts, by q, then k."""
CORNERS = tuple(Cell(q, k) for q in (FACTORS[0], FACTORS[-1]) for k in (FACTORS[0], FACTORS[-1]))
"""The starts whose Q and R are both wrong by 25."""


def starts(
    recording: Recording,
    process_noise: FloatArray,
    measurement_noise: FloatArray,
    cells: Sequence[Cell],
    rng: np.random.Generator,
) -> Start:
    """Return starts `(cells, n)`, one for each cell and run.

    The pose is the true one plus N(0, P0), with P0 the true R of x, y and yaw: the first fix of
    a robot that was just switched on. Every cell has this P0 and starts at the same pose, so
    that cells differ in nothing but Q and R.

    Args:
        recording: of n robots.
        process_noise: `(2,)` the Q that a factor of 1 stands for (m^2, rad^2).
        measurement_noise: `(4,)` the R that a factor of 1 stands for, rows as in `Row`.
        cells: how wrong.
        rng: source of the error of the first pose.
    """
    return starts_at(recording.truth[0], process_noise, measurement_noise, cells, rng)


def starts_at(
    first: FloatArray,
    process_noise: FloatArray,
    measurement_noise: FloatArray,
    cells: Sequence[Cell],
    rng: np.random.Generator,
) -> Start:
    """Return `starts` of robots by their first true poses `(n, 3)` (m, m, rad; map frame)."""
    variance = measurement_noise[:3]
    mean = first + np.sqrt(variance) * rng.standard_normal(first.shape)
    mean[:, 2] = wrap_angle(mean[:, 2])
    batch = (len(cells), len(first))
    q, k = (np.array(factor)[:, None, None] for factor in zip(*cells, strict=True))
    return Start(
        mean=np.broadcast_to(mean, (*batch, 3)),
        covariance=np.broadcast_to(np.diag(variance), (*batch, 3, 3)),
        process_noise=np.broadcast_to(q * process_noise, (*batch, 2)),
        measurement_noise=np.broadcast_to(k * measurement_noise, (*batch, 4)),
    )


def with_noise_factors(parameters: LocalizerParameters, cell: Cell) -> LocalizerParameters:
    """Return parameters whose configured Q and R are as wrong as a cell says.

    Args:
        parameters: with the noise that a factor of 1 stands for.
        cell: the factors on the variances.

    Raises:
        ParameterError: the noise would leave its bounds.
    """
    q, k = math.sqrt(cell.q), math.sqrt(cell.k)
    distance, rotation = parameters.process_noise_std
    x, y, yaw = parameters.measurement_noise_std
    return dataclasses.replace(
        parameters,
        process_noise_std=(q * distance, q * rotation),
        measurement_noise_std=(k * x, k * y, k * yaw),
        lrf_yaw_std=k * parameters.lrf_yaw_std,
    )
