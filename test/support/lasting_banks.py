# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Banks of all filters of lasting errors, for tests, and their rows as full matrices."""

from typing import NamedTuple

import numpy as np
from augmented_ekf import H_FIX, H_PLAIN_YAW, H_YAW, SIZE, random_bank
from banks import Covariances

from fnn_ekf_ros.core.arrays import BoolArray, FloatArray, Row
from fnn_ekf_ros.core.bank import Bank, Noise, Readings, noise_of_readings
from fnn_ekf_ros.core.lasting.comparison import Correcting
from fnn_ekf_ros.core.lasting.members import (
    CHALLENGER,
    FILTER_COUNT,
    MEMBER_COUNT,
    MEMBERS,
    WITNESS,
    error_variances,
)

OWN_R = (0.3, 0.4, 0.2, 0.25)
"""R of the filters, rows as in `Row` (m^2, m^2, rad^2, rad^2)."""


class Seen(NamedTuple):
    """All filters of some robots, and readings."""

    bank: Bank
    weights: FloatArray
    correcting: Correcting
    readings: Readings
    noise: Noise
    fix: FloatArray | None
    """R of the fix `(3, 3)`."""


def all_filters(
    rng: np.random.Generator, random_covariances: Covariances, batch: tuple[int, ...]
) -> Bank:
    """Return filters that have only the errors that their members assume."""
    bank = random_bank(rng, random_covariances, FILTER_COUNT, batch)
    variances = error_variances(np.ones((2, *batch)))
    absent = np.concatenate([np.zeros((3, FILTER_COUNT, *batch)), variances == 0.0])
    absent[:3] = False
    absent = absent.astype(np.bool_)
    bank.mean[absent] = 0.0
    bank.covariance[absent[:, None] | absent[None]] = 0.0
    assert len(MEMBERS) == MEMBER_COUNT
    return bank


def random_seen(
    rng: np.random.Generator, random_covariances: Covariances, available: BoolArray,
    *, coupled: bool = False, fix_yaw: FloatArray | float = 1.0, believed: bool = False,
) -> Seen:  # fmt: skip
    """Return filters, weights and readings `(4, *batch)`, rows available as given."""
    batch = available.shape[1:]
    weights = rng.uniform(0.01, 1.0, (MEMBER_COUNT, *batch))
    R = np.broadcast_to(np.reshape(OWN_R, (4, 1, *(1,) * len(batch))), (4, 1, *batch))
    noise, fix = Noise(np.ones((2, 1, *batch)), R), None
    if coupled:
        fix = random_covariances(rng, 1, 3)[..., 0]
        of_all = np.broadcast_to(fix.reshape(3, 3, *(1,) * len(batch)), (3, 3, *batch))
        noise = noise_of_readings(noise, OWN_R, of_all, available)
    offset = rng.uniform(0.3, 0.9, batch) if believed else np.zeros(batch)
    variance = rng.uniform(0.01, 0.05, batch) if believed else np.zeros(batch)
    return Seen(
        bank=all_filters(rng, random_covariances, batch),
        weights=weights / weights.sum(axis=0),
        correcting=Correcting(offset, variance, np.broadcast_to(fix_yaw, batch).astype(float)),
        readings=Readings(0.5 * rng.standard_normal((4, *batch)), available),
        noise=noise,
        fix=fix,
    )


class Matrices(NamedTuple):
    """Rows of one filter of one robot that are available: r `(m,)`, H `(m, 7)`, R `(m, m)`."""

    r: FloatArray
    H: FloatArray
    R: FloatArray


def matrices_of(seen: Seen, k: int, n: int, rows: list[Row]) -> Matrices:
    """Return the rows of filter k and robot n; innovations are small, so that none wraps."""
    offset, variance, fix_yaw = (float(value[n]) for value in seen.correcting)
    H = np.zeros((4, SIZE))
    H[Row.X], H[Row.Y] = H_FIX
    H[Row.COMPASS_YAW] = H_YAW
    H[Row.LRF_YAW] = H_YAW if fix_yaw else H_PLAIN_YAW
    z, R = seen.readings.values[:, n].copy(), np.diag(OWN_R)
    if seen.fix is not None:
        place = np.ix_([0, 1, 3], [0, 1, 3])
        R[place] = seen.fix
    if k not in (WITNESS, CHALLENGER):
        z[Row.COMPASS_YAW] -= offset
        z[Row.LRF_YAW] -= fix_yaw * offset
        R[Row.COMPASS_YAW, Row.COMPASS_YAW] += variance
    r = z - H @ seen.bank.mean[:, k, n]
    r[2:] = np.arctan2(np.sin(r[2:]), np.cos(r[2:]))
    return Matrices(r[rows], H[rows], R[np.ix_(rows, rows)])
