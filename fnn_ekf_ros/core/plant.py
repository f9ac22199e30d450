"""What every filter of one robot shares: the motion model and what a period brought."""

from typing import NamedTuple

import numpy as np

from fnn_ekf_ros.core.arrays import BoolArray, FloatArray, diagonal_matrix
from fnn_ekf_ros.core.covariance import limit_uncertainty
from fnn_ekf_ros.core.kalman import predict_covariance
from fnn_ekf_ros.core.limits import SMALLEST_STD
from fnn_ekf_ros.core.motion import MotionModel, displacement, move

NOMINAL_PERIOD_S = 0.375
"""The paper's period [s]; process noise is given for one step of this length."""


class Plant(NamedTuple):
    """What the filters are told once about robot and sensors.

    Attributes:
        motion_model: f(x, u).
        period_scale: length of one step as a multiple of `NOMINAL_PERIOD_S`.
        measurement_noise: diagonal of R that reported covariances are scaled against.
    """

    motion_model: MotionModel
    period_scale: float
    measurement_noise: tuple[float, float, float, float]


class StepInput(NamedTuple):
    """What one period brought.

    Attributes:
        control: `(..., 2)` [dS, dtheta] of the whole period (m, rad).
        measurement: `(..., 4)` the latest measurement of each row (m, m, rad, rad).
        available: `(..., 4)` which rows were measured.
        control_at_measurement: `(..., 4, 2)` [dS, dtheta] from the period's begin to the
            instant each row was measured at (m, rad); None where all were measured at its end.
        measurement_covariance: `(..., 4, 4)` R as the sensors reported it, to be multiplied by
            the adapted scale; None to use the filter's own R.
    """

    control: FloatArray
    measurement: FloatArray
    available: BoolArray
    control_at_measurement: FloatArray | None = None
    measurement_covariance: FloatArray | None = None


def for_each(period: StepInput) -> StepInput:
    """Return the input with a batch axis of length 1 behind its own: the same for many filters."""
    at, reported = period.control_at_measurement, period.measurement_covariance
    return StepInput(
        period.control[..., None, :],
        period.measurement[..., None, :],
        period.available[..., None, :],
        None if at is None else at[..., None, :, :],
        None if reported is None else reported[..., None, :, :],
    )


def predict(
    plant: Plant,
    mean: FloatArray,
    covariance: FloatArray,
    process_noise: FloatArray,
    control: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Return mean `(..., 3)` and covariance `(..., 3, 3)` after one step.

    Args:
        plant: the robot.
        mean: `(..., 3)` before the step (m, m, rad).
        covariance: `(..., 3, 3)` P.
        process_noise: `(..., 2)` diagonal of Q for the nominal period (m^2, rad^2).
        control: `(..., 2)` [dS, dtheta] (m, rad).
    """
    motion = move(plant.motion_model, mean, control)
    predicted = predict_covariance(covariance, motion, process_noise * plant.period_scale)
    return motion.mean, limit_uncertainty(predicted)


def carry_to_end(plant: Plant, heading: FloatArray, period: StepInput) -> FloatArray:
    """Carry the measurements from the instants they were taken at to the period's end.

    Args:
        plant: the robot.
        heading: `(...)` at the period's begin [rad].
        period: what it brought.
    """
    if period.control_at_measurement is None:
        return period.measurement
    model, heading = plant.motion_model, heading[..., None]
    end = displacement(model, heading, period.control[..., None, :])
    since = end - displacement(model, heading, period.control_at_measurement)
    # Row i takes the component it measures: x from row 0, y from row 1, yaw from rows 2 and 3.
    moved = np.stack(
        [since[..., 0, 0], since[..., 1, 1], since[..., 2, 2], since[..., 3, 2]], axis=-1
    )
    return period.measurement + moved


def noise_matrix(plant: Plant, measurement_noise: FloatArray, period: StepInput) -> FloatArray:
    """Return R `(..., 4, 4)`: the filter's own, or what the sensors reported times its scale.

    No scale makes a report better than `SMALLEST_STD`, as no report is.

    Args:
        plant: the robot, with the R that reported covariances are scaled against.
        measurement_noise: `(..., 4)` diagonal of the filter's own R.
        period: what it brought.
    """
    own = diagonal_matrix(measurement_noise)
    if period.measurement_covariance is None:
        return own
    scale: FloatArray = np.sqrt(measurement_noise / np.asarray(plant.measurement_noise))
    stds = np.sqrt(np.diagonal(period.measurement_covariance, axis1=-2, axis2=-1))
    scale = np.maximum(scale, SMALLEST_STD / stds)
    reported = period.measurement_covariance * scale[..., :, None] * scale[..., None, :]
    both = period.available[..., :, None] & period.available[..., None, :]
    return np.where(both, reported, own)


def reported_scale(plant: Plant, period: StepInput) -> FloatArray:
    """Return by how much the R in use moves when the filter's own R moves by one, `(..., 4)`."""
    own = np.asarray(plant.measurement_noise)
    if period.measurement_covariance is None:
        return np.ones_like(own)
    reported = np.diagonal(period.measurement_covariance, axis1=-2, axis2=-1)
    return np.where(period.available, reported / own, 1.0)
