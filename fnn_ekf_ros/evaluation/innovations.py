# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""What innovations tell without a ground truth: their size (NIS) and whether they are white."""

import math
from typing import NamedTuple

import numpy as np

from fnn_ekf_ros.core.arrays import BoolArray, FloatArray, Row
from fnn_ekf_ros.evaluation.consistency import (
    NOT_KNOWN,
    Consistency,
    consistency,
    independent_errors,
    judged,
)
from fnn_ekf_ros.evaluation.intervals import CONFIDENCE_Z
from fnn_ekf_ros.recordings.run_record import Noise

FIX_YAW = "fixes' yaw"
"""Name of the fixes' yaw, which is accepted or rejected with its fix."""
SENSORS = {"fixes": (Row.X, Row.Y), FIX_YAW: (Row.LRF_YAW,), "compass": (Row.COMPASS_YAW,)}
"""Rows of the innovations that are judged together, by what measures them."""
FEWEST_READINGS = 10
"""Fewest readings of a sensor of which anything is said."""

NEGLIGIBLE_LAG = 0.05
"""Correlation from one reading to the next that is called white however many readings there are: a
filter that used it would predict 0.13 % better (1 - sqrt(1 - 0.05^2))."""


class Whiteness(NamedTuple):
    """Correlation of a sensor's innovations from one reading to the next; 0 if they are white.

    Attributes:
        lag_one: sum z_t z_(t+1) / sum z_t^2 of standardized innovations.
        band: white ones are inside of +- this, 95 %: 1.96 / sqrt(number of them).
        readings: number of readings.
    """

    lag_one: float
    band: float
    readings: int

    @property
    def white(self) -> bool:
        """Whether they may be white, or nearly are."""
        return abs(self.lag_one) <= max(self.band, NEGLIGIBLE_LAG)


class SensorInnovations(NamedTuple):
    """What the innovations of a sensor tell.

    Attributes:
        consistency: of accepted readings: mean of r^2 / S, row by row.
        whiteness: of accepted readings.
        readings: number of periods with a reading.
        rejected: number of these with a rejected one.
    """

    consistency: Consistency
    whiteness: Whiteness
    readings: int
    rejected: int

    @property
    def rejected_share(self) -> float:
        """Share of the periods with a reading in which one was rejected."""
        return self.rejected / self.readings if self.readings else math.nan


def nis_consistency(noise: Noise) -> Consistency:
    """Judge the NIS of all readings of the periods in which none was rejected.

    The mean is that of the published filter's NIS over the degrees of freedom; how many independent
    ones there are is found from the standardized innovations.
    """
    rows = np.stack([noise.standardized(row) for row in Row], axis=1)
    dof = noise.get("degrees_of_freedom")
    fine = (dof > 0.0) & np.isfinite(noise.get("nis")) & ~_rejected(noise)
    if np.sum(fine) < FEWEST_READINGS:
        return NOT_KNOWN
    ratio = float(np.sum(noise.get("nis")[fine]) / np.sum(dof[fine]))
    independent = independent_errors(rows[fine])
    return judged(ratio, int(np.sum(fine)), independent, float(np.mean(dof[fine])))


def by_sensor(noise: Noise) -> dict[str, SensorInnovations]:
    """Return what the innovations of each sensor tell, of those with enough readings."""
    found = {}
    for name, rows in SENSORS.items():
        measured = noise.measured(rows[0])
        flag = "rejected_compass" if Row.COMPASS_YAW in rows else "rejected_lrf_pose"
        rejected = noise.get(flag) > 0.0
        z = np.stack([noise.standardized(row) for row in rows], axis=1)[measured & ~rejected]
        z = z[np.all(np.isfinite(z), axis=1)]
        if len(z) >= FEWEST_READINGS:
            found[name] = SensorInnovations(
                consistency=consistency(z),
                whiteness=whiteness(z),
                readings=int(np.sum(measured | rejected)),
                rejected=int(np.sum(rejected)),
            )
    return found


def whiteness(z: FloatArray) -> Whiteness:
    """Return how alike successive innovations `(n, d)` of about unit variance are."""
    lag_one = float(np.sum(z[1:] * z[:-1]) / max(float(np.sum(z**2)), np.finfo(float).tiny))
    return Whiteness(lag_one, CONFIDENCE_Z / math.sqrt(max(z.size, 1)), len(z))


def _rejected(noise: Noise) -> BoolArray:
    of_compass, of_fixes = noise.get("rejected_compass"), noise.get("rejected_lrf_pose")
    return np.asarray((of_compass > 0.0) | (of_fixes > 0.0))
