# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The filters of joint adaptation: their places in the bank, and the noise of each."""

import numpy as np

from fnn_ekf_ros.core.arrays import BoolArray, Constant, FloatArray
from fnn_ekf_ros.core.bank import Bank, Noise
from fnn_ekf_ros.core.evidence import SCALE_COUNT, STAR, STAR_SIZE, Scale

SETTLED, FAST = 0, 1
"""Indices of the learners on their axis."""
LEARNER_COUNT = 2
"""Learners; the length of that axis."""
SLIP: FloatArray = np.array([1.0, 1.0, 0.0, 0.0]) * np.log(50.0)
"""Log scales of the hypothesis slip relative to the settled ones: the wheels' variances times 50,
between slip that hardly matters and a factor of 100."""
ROW_SCALE = np.array([Scale.POSITION, Scale.POSITION, Scale.YAW, Scale.YAW])
"""The scale that each row's R follows, rows as in `Row`."""
PROCESS_SCALES = slice(Scale.DISTANCE, Scale.ROTATION + 1)
"""The scales that Q follows."""

# Filters of the bank: the start's, the stars of the two learners, slip, and the older forecasts of
# the first ten of these, made after the last step but one and predicted to now. The newer
# forecasts, made after the last step, are stored elsewhere: no reading is compared with them.
START, SETTLED_STAR, FAST_STAR = 0, 1, 1 + STAR_SIZE
"""Filters of the start's noise, and the first ones of the stars of the settled and of the fast
learner."""
SLIP_FILTER = 1 + LEARNER_COUNT * STAR_SIZE
"""Filter of the hypothesis slip."""
_FORECAST_SIZE = 1 + STAR_SIZE
"""Number of filters that make forecasts: the start's and the settled star."""
_FILTERS = SLIP_FILTER + 1
"""Number of filters that readings correct."""
_OLDER = slice(_FILTERS, _FILTERS + _FORECAST_SIZE)
"""Older forecasts, made after the last step but one."""
FORESEEN_START, FORESEEN_STAR = _OLDER.start, _OLDER.start + 1
"""Older forecasts by the start's filter, and the first one of those by the settled star."""
JOINT_COUNT = _OLDER.stop
"""Number of filters that readings are compared with."""
NEWER_COUNT = _FORECAST_SIZE
"""Number of newer forecasts, made after the last step."""
FORECASTS = _OLDER
"""Filters that readings are compared with but do not correct: the older forecasts."""
SUDDEN = np.array([FAST_STAR, SLIP_FILTER])
"""Filters of the sudden hypotheses, fast and slip."""
STARS = np.array([star + k for k in range(STAR_SIZE) for star in (FORESEEN_STAR, FAST_STAR)])
"""Filters of the settled learner's forecast star and of the fast one's star, alternating."""
_STAR_FACTOR, _SLIP_FACTOR = Constant(np.exp(STAR)), Constant(np.exp(SLIP))
"""Factors on variances: of the filters of a star, and of slip."""


def write_noise(
    noise: Noise, process_noise: FloatArray, measurement_noise: FloatArray, log_scale: FloatArray
) -> None:
    """Write Q and R of the `JOINT_COUNT` filters.

    Args:
        noise: of these filters; changed.
        process_noise: `(2, *batch)` Q at theta = 0 (m^2, rad^2).
        measurement_noise: `(4, *batch)` R at theta = 0 (m^2, m^2, rad^2, rad^2).
        log_scale: `(4, 2, *batch)` theta of the settled and of the fast learner.
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
    np.multiply(process_noise[:, None], factor[PROCESS_SCALES], out=noise.process)
    np.multiply(measurement_noise[:, None], factor[ROW_SCALE], out=noise.measurement)


def step_forecasts(bank: Bank, newer: Bank, steps: BoolArray) -> None:
    """Replace the older forecasts by the newer ones, and these by the corrected filters, in place.

    Args:
        bank: the `JOINT_COUNT` filters after the readings; changed.
        newer: the `NEWER_COUNT` newer forecasts; changed.
        steps: `(*batch)` whether the readings are a step of the forecasts.
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
