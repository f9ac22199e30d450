"""The filters of joint adaptation: a place in the bank for each, and the noise it stands for."""

import numpy as np

from fnn_ekf_ros.core.arrays import BoolArray, Constant, FloatArray
from fnn_ekf_ros.core.bank import Bank, Noise
from fnn_ekf_ros.core.evidence import SCALE_COUNT, STAR, STAR_SIZE

SETTLED, FAST = 0, 1
"""The learners, in the order of their axis."""
LEARNER_COUNT = 2
SLIP: FloatArray = np.array([1.0, 1.0, 0.0, 0.0]) * np.log(50.0)
"""Log scales of wheels that slip, against the settled ones."""
ROW_SCALE = np.array([2, 2, 3, 3])
"""Which scale each row's R follows."""

# Filters of the bank: the start's noise, the two learners' stars, slip, and forecasts of the first
# ten, made after the last step but one and predicted to now. Those made after the last step stand
# apart from them, as no reading is compared with them.
START, SETTLED_STAR, FAST_STAR = 0, 1, 1 + STAR_SIZE
SLIP_FILTER = 1 + LEARNER_COUNT * STAR_SIZE
_FORECAST_SIZE = 1 + STAR_SIZE
_FILTERS = SLIP_FILTER + 1
_OLDER = slice(_FILTERS, _FILTERS + _FORECAST_SIZE)
FORESEEN_START, FORESEEN_STAR = _OLDER.start, _OLDER.start + 1
JOINT_COUNT = _OLDER.stop
"""Filters of the bank that readings are compared with."""
NEWER_COUNT = _FORECAST_SIZE
"""Filters of the bank that none is compared with: forecasts made after the last step."""
FORECASTS = _OLDER
"""Those that readings are compared with, but do not correct."""
SUDDEN = np.array([FAST_STAR, SLIP_FILTER])
STARS = np.array([star + k for k in range(STAR_SIZE) for star in (FORESEEN_STAR, FAST_STAR)])
_STAR_FACTOR, _SLIP_FACTOR = Constant(np.exp(STAR)), Constant(np.exp(SLIP))


def write_noise(
    noise: Noise, process_noise: FloatArray, measurement_noise: FloatArray, log_scale: FloatArray
) -> None:
    """Write Q and R of the `JOINT_COUNT` filters.

    Args:
        noise: where they are written.
        process_noise: `(2, *batch)` Q that theta = 0 stands for (m^2, rad^2).
        measurement_noise: `(4, *batch)` R, likewise.
        log_scale: `(4, 2, *batch)` theta of the settled and the fast learner.
    """
    batch = process_noise.shape[1:]
    scale = np.exp(log_scale)
    star = _STAR_FACTOR.behind(len(batch))
    factor = np.empty((SCALE_COUNT, JOINT_COUNT, *batch))
    factor[:, START] = 1.0
    factor[:, SETTLED_STAR:FAST_STAR] = scale[:, SETTLED, None] * star
    factor[:, FAST_STAR:SLIP_FILTER] = scale[:, FAST, None] * star
    factor[:, SLIP_FILTER] = scale[:, SETTLED] * _SLIP_FACTOR.behind(len(batch))
    factor[:, _OLDER] = factor[:, :_FORECAST_SIZE]
    np.multiply(process_noise[:, None], factor[:2], out=noise.process)
    np.multiply(measurement_noise[:, None], factor[ROW_SCALE], out=noise.measurement)


def step_forecasts(bank: Bank, newer: Bank, steps: BoolArray) -> None:
    """Take the forecasts one step on, in place, where readings were one.

    Args:
        bank: the `JOINT_COUNT` filters after the readings; nobody else holds them.
        newer: the `NEWER_COUNT` forecasts, likewise.
        steps: `(*batch)` whether readings were a step.
    """
    if not steps.any():
        return
    older, first = bank.filters(_OLDER), bank.filters(slice(0, NEWER_COUNT))
    if steps.all():
        older.mean[...], older.covariance[...] = newer
        newer.mean[...], newer.covariance[...] = first
    else:
        older.mean[...] = np.where(steps, newer.mean, older.mean)
        older.covariance[...] = np.where(steps, newer.covariance, older.covariance)
        newer.mean[...] = np.where(steps, first.mean, newer.mean)
        newer.covariance[...] = np.where(steps, first.covariance, newer.covariance)
