# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Banks of filters for tests, and what a correction gives by dense linear algebra."""

import itertools
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import pytest

from fnn_ekf_ros.core.arrays import FloatArray, Row, components_last
from fnn_ekf_ros.core.bank import (
    Bank,
    Correction,
    Innovations,
    Noise,
    Readings,
    correct,
    innovate,
    wrapped,
)
from fnn_ekf_ros.core.motion import MotionModel
from fnn_ekf_ros.core.rows import FIX_ROWS

Covariances = Callable[[np.random.Generator, int, int], FloatArray]
BOTH_MODELS = pytest.mark.parametrize("model", list(MotionModel))
BOTH_KINDS = pytest.mark.parametrize("reported", [False, True], ids=["own noise", "reported noise"])
ALL_MASKS = list(itertools.product([False, True], repeat=4))
STATE_OF_ROW = [0, 1, 2, 2]
FIX = list(FIX_ROWS)
UNIT = (1.0, 1.0, 1.0, 1.0)
H = np.eye(3)[STATE_OF_ROW]


def one_filter(mean: Any, covariance: Any) -> Bank:
    """Return a bank of one filter of one robot."""
    return Bank(np.array(mean, dtype=np.float64)[:, None], np.array(covariance)[:, :, None])


def corrected(bank: Bank, z: FloatArray, R: Any, available: Any) -> tuple[Innovations, Correction]:
    """Correct one filter by readings with uncorrelated noise; headings are wrapped."""
    noise = Noise(np.ones((2, 1)), np.array(R, dtype=np.float64)[:, None])
    return corrected_by(bank, Readings(np.asarray(z), np.asarray(available)), noise)


def corrected_by(bank: Bank, readings: Readings, noise: Noise) -> tuple[Innovations, Correction]:
    seen = innovate(bank, readings, noise.measurement)
    taken = correct(bank, seen, noise, readings.available)
    return seen, taken._replace(bank=wrapped(taken.bank))


def all_bytes(parts: Any) -> bytes:
    """Return every bit of arrays, in whatever tuples they are."""
    if isinstance(parts, tuple):
        return b"".join(all_bytes(part) for part in parts)
    return np.ascontiguousarray(parts).tobytes()


def assert_symmetric(covariance: FloatArray) -> None:
    assert covariance.tobytes() == np.swapaxes(covariance, 0, 1).tobytes()


def assert_positive_definite(covariance: FloatArray) -> None:
    """In units of its own standard deviations; the Cholesky factorisation refuses what is not."""
    assert np.all(np.isfinite(covariance))
    last = components_last(covariance, 2)
    std = np.sqrt(np.diagonal(last, axis1=-2, axis2=-1))
    np.linalg.cholesky(last / (std[..., :, None] * std[..., None, :]))


def full_noise(fix: FloatArray, compass: float) -> FloatArray:
    """Return R `(4, 4)` of a fix's covariance and the compass' variance."""
    R = np.zeros((4, 4))
    R[np.ix_(FIX, FIX)] = fix
    R[Row.COMPASS_YAW, Row.COMPASS_YAW] = compass
    return R


class Dense(NamedTuple):
    """What one textbook correction by all rows together gives."""

    mean: FloatArray
    covariance: FloatArray
    nis: float
    determinant: float


def dense(mean: FloatArray, P: FloatArray, z: FloatArray, R: FloatArray, rows: list[int]) -> Dense:
    """Correct with the matrices of some rows, S inverted; an ordinary vector as innovation."""
    if not rows:
        return Dense(mean, P, 0.0, 1.0)
    Hr, S = H[rows], H[rows] @ P @ H[rows].T + R[np.ix_(rows, rows)]
    r = z[rows] - Hr @ mean
    K = P @ Hr.T @ np.linalg.inv(S)
    nis = float(r @ np.linalg.inv(S) @ r)
    return Dense(mean + K @ r, P - K @ Hr @ P, nis, float(np.linalg.det(S)))


class Case(NamedTuple):
    """A bank of three filters of 16 robots, to each of which other rows are available."""

    bank: Bank
    noise: Noise
    readings: Readings
    fix: FloatArray


def random_case(rng: np.random.Generator, random_covariances: Covariances, filters: int) -> Case:
    robots = len(ALL_MASKS)
    mean = 0.3 * rng.standard_normal((3, filters, robots))
    P = random_covariances(rng, filters * robots, 3).reshape(3, 3, filters, robots)
    Q, R = np.ones((2, filters, robots)), rng.uniform(0.05, 3.0, (4, filters, robots))
    readings = Readings(0.3 * rng.standard_normal((4, robots)), np.array(ALL_MASKS).T)
    return Case(Bank(mean, P), Noise(Q, R), readings, random_covariances(rng, robots, 3))
