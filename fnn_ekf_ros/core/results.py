# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The input of the filter, one epoch at a time, and the results of instants and periods."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from fnn_ekf_ros.core.arrays import BoolArray, FloatArray, Row
from fnn_ekf_ros.core.joint_state import JointReport, Learned
from fnn_ekf_ros.core.lasting.report import LastingReport
from fnn_ekf_ros.core.rows import SENSOR_COUNT, SENSOR_OF_ROW


class Epoch(NamedTuple):
    """The step of the wheels from one instant to the next, and the readings at its end.

    Attributes:
        control: `(2, *batch)` [dS, dtheta] of the wheels (m, rad).
        duration_s: its duration [s].
        measurement: `(4, *batch)` z (m, m, rad, rad), rows as in `Row`.
        available: `(4, *batch)` which rows were measured.
        fix_covariance: `(3, 3, *batch)` R of x, y and laser yaw as the fix reported it, which is
            multiplied by the adapted scale; None: the filter's own R is used.
    """

    control: FloatArray
    duration_s: float
    measurement: FloatArray
    available: BoolArray
    fix_covariance: FloatArray | None = None


class Shown(NamedTuple):
    """The results of an instant with readings.

    Attributes:
        innovation: `(4, *batch)` r, 0 where not available (m, m, rad, rad).
        innovation_variance: `(4, *batch)` diagonal of S.
        available: `(4, *batch)` which rows were measured.
        teaches: `(4, *batch)` which of them the noise may be learned from.
        heading: `(*batch)` predicted yaw [rad].
        reported_scale: `(4, *batch)` change of R in use per change of the filter's own R.
        nis: `(*batch)` normalized innovation squared of the measured rows.
        degrees_of_freedom: `(*batch)` number of these rows.
        sensor_nis: `(2, *batch)` NIS of each sensor's rows; sensors as in `rows`.
        sensor_degrees_of_freedom: `(2, *batch)` number of rows that each sensor measured.
        rejected: `(2, *batch)` whether the gate rejected each sensor's reading.
        relocated: `(*batch)` whether the pose was moved to the relocation hypothesis.
        learned: the result of joint adaptation; None if nothing was learned, or in other modes.
    """

    innovation: FloatArray
    innovation_variance: FloatArray
    available: BoolArray
    teaches: BoolArray
    heading: FloatArray
    reported_scale: FloatArray
    nis: FloatArray
    degrees_of_freedom: FloatArray
    sensor_nis: FloatArray
    sensor_degrees_of_freedom: FloatArray
    rejected: BoolArray
    relocated: BoolArray
    learned: Learned | None


class StepResult(NamedTuple):
    """The results of one period, for diagnostics and statistics.

    Attributes:
        innovation: `(4, *batch)` the last r of each row, 0 where not available (m, m, rad, rad).
        innovation_variance: `(4, *batch)` diagonal of S of the same readings.
        available: `(4, *batch)` which rows were measured.
        nis: `(*batch)` normalized innovation squared, summed over all readings.
        degrees_of_freedom: `(*batch)` number of rows of these readings.
        mismatch: `(4, *batch)` D = S - C_hat.
        firing_strength: `(3, 4, *batch)` alpha of the rules I, M, D for the rows of R; in mode `q`
            those of Q, in the rows of x and compass yaw; in mode `joint` of the four log scales.
        process_firing_strength: `(3, 2, *batch)` the same for Q's distance and rotation, modes `q`
            and `rq`.
        joint: noise and weights of joint adaptation; None in the other modes.
        lasting: what is believed of errors that last; None where they are not followed.
        sensor_nis: `(2, *batch)` NIS of each sensor's rows, summed; sensors as in `rows`.
        sensor_degrees_of_freedom: `(2, *batch)` number of rows that each sensor measured.
        rejected: `(2, *batch)` whether the gate rejected any reading of each sensor.
        relocated: `(*batch)` whether the pose was moved to the relocation hypothesis.
        shown: the results of each instant with readings.
    """

    innovation: FloatArray
    innovation_variance: FloatArray
    available: BoolArray
    nis: FloatArray
    degrees_of_freedom: FloatArray
    mismatch: FloatArray
    firing_strength: FloatArray
    process_firing_strength: FloatArray
    joint: JointReport | None
    lasting: LastingReport | None
    sensor_nis: FloatArray
    sensor_degrees_of_freedom: FloatArray
    rejected: BoolArray
    relocated: BoolArray
    shown: tuple[Shown, ...]

    @property
    def accepted(self) -> BoolArray:
        """`(4, *batch)` which rows were measured in a reading that the gate accepted."""
        accepted = np.zeros_like(self.available)
        for shown in self.shown:
            accepted |= shown.available & ~shown.rejected[SENSOR_OF_ROW]
        return accepted

    @property
    def accepted_position(self) -> BoolArray:
        """`(*batch)` whether a position was accepted, or the pose moved to where fixes agree."""
        return np.asarray(self.accepted[Row.X] | self.relocated)

    @property
    def accepted_yaw(self) -> BoolArray:
        """`(*batch)` whether a yaw was accepted."""
        accepted = self.accepted
        return np.asarray(accepted[Row.COMPASS_YAW] | accepted[Row.LRF_YAW])


def last_of_each_row(shown: Sequence[Shown]) -> Shown:
    """Return the results of at least one instant as one: the last reading of each row.

    NIS and degrees of freedom are summed.
    """
    result = shown[0]
    for later in shown[1:]:
        new = later.available
        position = new[Row.X] | new[Row.Y]
        result = Shown(
            innovation=np.where(new, later.innovation, result.innovation),
            innovation_variance=np.where(
                new, later.innovation_variance, result.innovation_variance
            ),
            available=result.available | new,
            teaches=np.where(new, later.teaches, result.teaches),
            heading=np.where(position, later.heading, result.heading),
            reported_scale=np.where(new, later.reported_scale, result.reported_scale),
            nis=result.nis + later.nis,
            degrees_of_freedom=result.degrees_of_freedom + later.degrees_of_freedom,
            sensor_nis=result.sensor_nis + later.sensor_nis,
            sensor_degrees_of_freedom=(
                result.sensor_degrees_of_freedom + later.sensor_degrees_of_freedom
            ),
            rejected=result.rejected | later.rejected,
            relocated=result.relocated | later.relocated,
            learned=_last_learned(result.learned, later.learned),
        )
    return result


def nothing_shown(heading: FloatArray, variance: FloatArray) -> Shown:
    """Return the results of a period without readings.

    Args:
        heading: `(*batch)` yaw at its end [rad].
        variance: `(4, *batch)` diagonal of S at its end (m^2, m^2, rad^2, rad^2).
    """
    none = np.zeros_like(variance)
    no_nis = np.zeros((SENSOR_COUNT, *heading.shape))
    no_row, no_sensor = none.astype(np.bool_), no_nis.astype(np.bool_)
    return Shown(
        innovation=none,
        innovation_variance=variance,
        available=no_row,
        teaches=no_row,
        heading=heading,
        reported_scale=np.ones_like(none),
        nis=none[0],
        degrees_of_freedom=none[0],
        sensor_nis=no_nis,
        sensor_degrees_of_freedom=no_nis,
        rejected=no_sensor,
        relocated=no_sensor[0],
        learned=None,
    )


def _last_learned(before: Learned | None, later: Learned | None) -> Learned | None:
    """Return the last result of joint adaptation for each robot of a batch."""
    if before is None or later is None:
        return before if later is None else later
    taught = later.firing_strength.any(axis=(0, 1))
    return later._replace(
        explained=np.where(taught, later.explained, before.explained),
        firing_strength=np.where(taught, later.firing_strength, before.firing_strength),
    )
