"""What a filter is told of a period, and what the period showed."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from fnn_ekf_ros.core.arrays import BoolArray, FloatArray, Row
from fnn_ekf_ros.core.joint import JointReport, Learned
from fnn_ekf_ros.core.rows import SENSOR_COUNT


class Epoch(NamedTuple):
    """The time from one instant to the next, and what was measured at its end.

    Attributes:
        control: `(2, *batch)` [dS, dtheta] of the wheels (m, rad).
        duration_s: how long it took [s].
        measurement: `(4, *batch)` z (m, m, rad, rad), rows as in `Row`.
        available: `(4, *batch)` which rows were measured.
        fix_covariance: `(3, 3, *batch)` R of x, y and laser yaw as the fix reported it, to be
            multiplied by the adapted scale; None to use the filter's own R.
    """

    control: FloatArray
    duration_s: float
    measurement: FloatArray
    available: BoolArray
    fix_covariance: FloatArray | None = None


class Shown(NamedTuple):
    """What the readings of an instant showed.

    Attributes:
        innovation: `(4, *batch)` r, 0 where not available (m, m, rad, rad).
        innovation_variance: `(4, *batch)` diagonal of S.
        available: `(4, *batch)` which rows were measured.
        teaches: `(4, *batch)` which of them the noise may be learned from.
        heading: `(*batch)` predicted [rad].
        reported_scale: `(4, *batch)` by how much the R in use moves when the filter's own R moves
            by one.
        nis: `(*batch)` normalised innovation squared of the available rows.
        degrees_of_freedom: `(*batch)` how many rows that were.
        sensor_nis: `(2, *batch)` NIS of each sensor's rows, in the order of `gate`.
        sensor_degrees_of_freedom: `(2, *batch)` how many rows it measured.
        rejected: `(2, *batch)` whether the gate rejected it.
        relocated: `(*batch)` whether the pose was moved to where rejected readings agree.
        learned: what joint adaptation learned; None if nothing, or in the other modes.
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
    """What one period showed; for diagnostics and statistics.

    Attributes:
        innovation: `(4, *batch)` the last r of each row, 0 where not available (m, m, rad, rad).
        innovation_variance: `(4, *batch)` diagonal of S, of the same reading.
        available: `(4, *batch)` which rows were measured.
        nis: `(*batch)` normalised innovation squared, summed over all readings.
        degrees_of_freedom: `(*batch)` how many rows these had.
        mismatch: `(4, *batch)` D = S - C_hat.
        firing_strength: `(3, 4, *batch)` alpha of the rules I, M, D for the rows of R; in mode `q`
            those of Q, in the rows of x and compass yaw; in mode `joint` of the four log scales.
        process_firing_strength: `(3, 2, *batch)` the same for Q's distance and rotation, modes `q`
            and `rq`.
        joint: what joint adaptation believes; None in the other modes.
        sensor_nis: `(2, *batch)` NIS of each sensor's rows, summed, in the order of `gate`.
        sensor_degrees_of_freedom: `(2, *batch)` how many rows it measured.
        rejected: `(2, *batch)` whether the gate rejected a reading of it.
        relocated: `(*batch)` whether the pose was moved to where rejected readings agree.
        shown: what each instant with readings showed.
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
    sensor_nis: FloatArray
    sensor_degrees_of_freedom: FloatArray
    rejected: BoolArray
    relocated: BoolArray
    shown: tuple[Shown, ...]


def last_of_each_row(shown: Sequence[Shown]) -> Shown:
    """Return what several instants showed, one at least, as one: the last reading of each row.

    NIS and degrees of freedom are summed up.
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
    """Return what a period without readings shows.

    Args:
        heading: `(*batch)` where it ended [rad].
        variance: `(4, *batch)` diagonal of S there.
    """
    none = np.zeros_like(variance)
    nobody = np.zeros((SENSOR_COUNT, *heading.shape))
    no_row, no_sensor = none.astype(np.bool_), nobody.astype(np.bool_)
    return Shown(
        innovation=none,
        innovation_variance=variance,
        available=no_row,
        teaches=no_row,
        heading=heading,
        reported_scale=np.ones_like(none),
        nis=none[0],
        degrees_of_freedom=none[0],
        sensor_nis=nobody,
        sensor_degrees_of_freedom=nobody,
        rejected=no_sensor,
        relocated=no_sensor[0],
        learned=None,
    )


def _last_learned(before: Learned | None, later: Learned | None) -> Learned | None:
    """Return what each robot of a batch learned last."""
    if before is None or later is None:
        return before if later is None else later
    taught = later.firing_strength.any(axis=(0, 1))
    return later._replace(
        explained=np.where(taught, later.explained, before.explained),
        firing_strength=np.where(taught, later.firing_strength, before.firing_strength),
    )
