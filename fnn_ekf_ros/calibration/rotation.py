# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Rotation by the wheels against the yaw that a sensor measured.

With the mean s and the half difference d of the wheels' travel in counts,

    yaw(t) = c + a_s s(t - delay) + a_d d(t - delay),    s = (N_l + N_r) / 2,  d = (N_r - N_l) / 2.

A robot that is wired as it should be has a_d > 0, and a_s = 0 if its wheels are equal.
"""

import math
from typing import NamedTuple

import numpy as np

from fnn_ekf_ros.calibration.drift_regression import (
    Drift,
    DriftFit,
    fit_drifting,
    fit_with,
    fit_with_instruments,
    profile,
    smoothed,
)
from fnn_ekf_ros.calibration.travel import WheelTravel
from fnn_ekf_ros.core.angles import wrap_angle
from fnn_ekf_ros.core.arrays import BoolArray, FloatArray

LARGEST_DELAY_S = 1.5
"""Largest delay that is looked for [s]."""
DELAY_STEP_S = 0.1
"""Step of the delays that are tried first [s]."""
INSTRUMENT_LAGS_S = (0.0, 0.15, 0.3, 0.6)
"""Ages of the travel that serves as instruments [s]; turns last for about a second."""
LONG_S = 16.0
"""Time over which rotations are compared once more [s]."""
EXPLAINED = 0.8
"""Share of the yaw's changes explained by the wheels from which on least squares need no
instruments: feedback then biases them by 2 %, and instruments would double the standard errors."""
WEAK_DELAY_STD_S = 0.15
"""Standard error of a delay from which on the readings do not show it, and it is taken for 0 [s]:
two-stage least squares are far from normal where instruments are weak."""
DRIFT_GAIN = 0.3
"""Part of a difference between yaw and wheels that is followed when the yaw is unwrapped."""
RATE_HALF_WINDOW_S = 0.1
"""Half the time over which a speed is taken [s]."""


class YawFit(NamedTuple):
    """What a yaw sensor says of the wheels.

    Attributes:
        coefficients: `(3,)` a_s, a_d [rad per count], delay [s].
        covariance: `(3, 3)` of these.
        noise_std: of one reading [rad].
        explained: share of the yaw's changes, from reading to reading, that the wheels explain.
        readings: number of readings.
        level_delay_s: delay that was taken off the stamps where the yaw gives directions [s].
    """

    coefficients: FloatArray
    covariance: FloatArray
    noise_std: float
    explained: float
    readings: int
    level_delay_s: float


class YawTrack(NamedTuple):
    """A yaw that is known at any instant: the wheels' part, and what it leaves of the readings.

    Attributes:
        times: `(n,)` stamps of the readings [s].
        slope: `(2,)` a_s, a_d of the wheels' part.
        level: `(n,)` the yaw, unwrapped, without the wheels' part [rad].
        delay_s: that is taken off the stamps [s].
    """

    times: FloatArray
    slope: FloatArray
    level: FloatArray
    delay_s: float

    def at(self, travel: WheelTravel, times: FloatArray) -> FloatArray:
        """Return the yaw, unwrapped, at instants of the wheels' clock [rad]."""
        level = np.interp(times, self.times - self.delay_s, self.level)
        return np.asarray(travel.mean_and_half_difference(times) @ self.slope + level)


def fit_yaw(
    travel: WheelTravel, times: FloatArray, yaw: FloatArray, start: FloatArray | None = None
) -> tuple[YawFit, YawTrack]:
    """Return how a sensor's yaw depends on the wheels, and the yaw at any instant.

    Args:
        travel: of the wheels.
        times: `(n,)` stamps, rising [s].
        yaw: `(n,)` yaw, wrapped [rad].
        start: `(2,)` a_s, a_d to begin with; None: by readings that follow each other closely.
    """
    breaks = travel.breaks(times)
    columns = travel.mean_and_half_difference(times)
    first = _by_close_readings(times, yaw, columns, breaks) if start is None else start
    unwrapped = unwrapped_beside(yaw, columns @ first)
    for _ in range(2):
        fit = fit_drifting(times, unwrapped[:, None], columns[:, None, :], breaks)
        unwrapped = unwrapped_beside(yaw, columns @ fit.coefficients)
    fit, delay = _aligned(travel, fit, unwrapped)
    if fit.explained >= EXPLAINED:
        coefficients, covariance = _estimated(
            travel, fit.drift, unwrapped, delay, instruments=False
        )
    else:
        coefficients, covariance = _estimated(travel, fit.drift, unwrapped, delay, instruments=True)
    if math.sqrt(covariance[2, 2]) > WEAK_DELAY_STD_S:
        coefficients, covariance = _without_delay(travel, fit.drift, unwrapped)
    long_changes = _long_changes(times, unwrapped, columns, breaks)
    if not np.any(np.isnan(long_changes)):
        half = 0.5 * (long_changes - coefficients[:2])
        covariance[:2, :2] += np.outer(half, half)
    delay = float(coefficients[2])
    explained = travel.mean_and_half_difference(times - delay) @ coefficients[:2]
    found = YawFit(
        coefficients=coefficients,
        covariance=covariance,
        noise_std=fit.noise_std,
        explained=fit.explained,
        readings=len(times),
        level_delay_s=delay,
    )
    level = smoothed(fit.drift, unwrapped - explained)
    return found, YawTrack(times, coefficients[:2], level, delay)


def _aligned(travel: WheelTravel, fit: DriftFit, unwrapped: FloatArray) -> tuple[DriftFit, float]:
    """Return the fit at the delay of highest likelihood, and that delay [s]."""
    times, breaks = fit.drift.times, fit.drift.breaks
    delays = np.arange(-LARGEST_DELAY_S, LARGEST_DELAY_S + 1e-9, DELAY_STEP_S)
    shifted = np.stack([travel.mean_and_half_difference(times - each) for each in delays])
    scores = profile(fit.drift, unwrapped[:, None], shifted[:, :, None, :])
    best = int(np.argmax(scores))
    delay = float(delays[best])
    if abs(delay) < DELAY_STEP_S:
        return fit, delay
    return fit_drifting(times, unwrapped[:, None], shifted[best][:, None, :], breaks), delay


def _estimated(
    travel: WheelTravel, drift: Drift, unwrapped: FloatArray, delay: float, *, instruments: bool
) -> tuple[FloatArray, FloatArray]:
    """Return a_s, a_d and the delay with their covariance, by Gauss-Newton on the delay.

    With instruments they are free of the driver's feedback; without, less noisy.
    """
    times, readings = drift.times, unwrapped[:, None]
    found, covariance = np.zeros(3), np.eye(3)
    for _ in range(4):
        columns = travel.mean_and_half_difference(times - delay)[:, None, :]
        earlier = [
            travel.mean_and_half_difference(times - delay - lag) for lag in INSTRUMENT_LAGS_S
        ]
        known = np.concatenate(earlier, axis=-1)[:, None, :]
        slope = _solved(drift, readings, columns, known if instruments else None)[0]
        ahead = travel.mean_and_half_difference(times - delay + RATE_HALF_WINDOW_S)
        behind = travel.mean_and_half_difference(times - delay - RATE_HALF_WINDOW_S)
        rate = (ahead - behind) @ slope / (2.0 * RATE_HALF_WINDOW_S)
        columns = np.concatenate([columns, -rate[:, None, None]], axis=-1)
        found, covariance = _solved(drift, readings, columns, known if instruments else None)
        step = float(np.clip(found[2], -0.2, 0.2))
        delay = float(np.clip(delay + step, -LARGEST_DELAY_S, LARGEST_DELAY_S))
        if abs(step) < 2e-3:
            break
    return np.array([found[0], found[1], delay]), covariance


def _solved(
    drift: Drift, readings: FloatArray, columns: FloatArray, instruments: FloatArray | None
) -> tuple[FloatArray, FloatArray]:
    if instruments is not None:
        return fit_with_instruments(drift, readings, columns, instruments)
    fit = fit_with(drift, readings, columns)
    return fit.coefficients, fit.covariance


def _without_delay(
    travel: WheelTravel, drift: Drift, unwrapped: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return a_s, a_d without any delay, and a delay of which nothing is known."""
    columns = travel.mean_and_half_difference(drift.times)
    lagged = [travel.mean_and_half_difference(drift.times - lag) for lag in INSTRUMENT_LAGS_S]
    instruments = np.concatenate(lagged, axis=-1)
    slope, covariance = fit_with_instruments(
        drift, unwrapped[:, None], columns[:, None, :], instruments[:, None, :]
    )
    unknown = np.zeros((3, 3))
    unknown[:2, :2] = covariance
    unknown[2, 2] = LARGEST_DELAY_S**2
    return np.array([*slope, 0.0]), unknown


def _by_close_readings(
    times: FloatArray, yaw: FloatArray, columns: FloatArray, breaks: BoolArray
) -> FloatArray:
    """Return a_s, a_d by changes between readings so close that the yaw cannot have wrapped."""
    gaps = np.diff(times)
    close = (gaps <= max(float(np.median(gaps)), 0.4)) & ~breaks[1:]
    return _robust(wrap_angle(np.diff(yaw))[close], np.diff(columns, axis=0)[close])


def _long_changes(
    times: FloatArray, unwrapped: FloatArray, columns: FloatArray, breaks: BoolArray
) -> FloatArray:
    """Return a_s, a_d by the changes over `LONG_S`; NaN if there are too few."""
    ends = np.searchsorted(times, times + LONG_S)
    starts = np.flatnonzero(ends < len(times))
    ends = ends[starts]
    holes = np.cumsum(breaks)
    usable = (times[ends] - times[starts] < 1.25 * LONG_S) & (holes[ends] == holes[starts])
    starts, ends = starts[usable], ends[usable]
    if len(starts) < 10:
        return np.full(2, math.nan)
    return _robust(unwrapped[ends] - unwrapped[starts], columns[ends] - columns[starts])


def _robust(change: FloatArray, moved: FloatArray) -> FloatArray:
    """Return coefficients of least squares in which outliers get less weight."""
    scale = np.sqrt(np.mean(moved**2)) + 1e-300
    weights = np.ones(len(change))
    found = np.zeros(moved.shape[-1])
    for _ in range(8):
        rows = moved / scale * np.sqrt(weights)[:, None]
        values = change * np.sqrt(weights)
        found = np.linalg.solve(rows.T @ rows + 1e-6 * np.eye(rows.shape[1]), rows.T @ values)
        left = np.abs(change - moved / scale @ found)
        weights = 1.0 / np.maximum(1.0, left / (2.0 * np.median(left) + 1e-12)) ** 2
    return np.asarray(found / scale)


def unwrapped_beside(yaw: FloatArray, explained: FloatArray) -> FloatArray:
    """Return yaw without wraps: it stays near what the wheels explain, plus a slow difference."""
    residual = yaw - explained
    found = np.empty_like(yaw)
    level = float(residual[0])
    for k, value in enumerate(residual.tolist()):
        innovation = float((value - level + np.pi) % (2.0 * np.pi) - np.pi)
        found[k] = level + innovation
        level += DRIFT_GAIN * innovation
    return found + explained
