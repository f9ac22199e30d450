# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Forecasts of all readings of a recording, for many models of the robot at once.

Every model of the robot, a vector of values of `Quantity`, is an EKF with the core's prediction
(`core.bank`, `core.lasting.augmented`) and row update. Beside it run its copies in simulated
outages, which no fix corrects for a horizon. The models are the batch, the filter and its copies
the filters of the bank: one pass over the recording serves all models.

The influence of outliers is bounded (Huber 1964): a fix whose NIS e exceeds the limit h has

    R_k = R + (e / h - 1) (R + P_bb)

Scores are taken with R itself, and are bounded by their Student t.
"""

from typing import NamedTuple

import numpy as np

from fnn_ekf_ros.core.angles import wrap_angle
from fnn_ekf_ros.core.arrays import FloatArray, Row
from fnn_ekf_ros.core.bank import Bank, predict
from fnn_ekf_ros.core.lasting.augmented import (
    AUGMENTED_SIZE,
    Component,
    observe,
    predict_augmented,
)
from fnn_ekf_ros.core.pace import NOMINAL_PERIOD_S
from fnn_ekf_ros.core.row_update import Terms, take_row
from fnn_ekf_ros.tuning.quantities import Quantity
from fnn_ekf_ros.tuning.recording import HORIZONS_S, PHASES, TuningRecording

FIX_LIMIT = 9.21
"""h, NIS of x and y from which on a fix's influence is bounded: right noise exceeds it in 1 %."""
YAW_LIMIT = 9.0
"""NIS of a compass reading from which on its influence is bounded: three standard deviations."""
FILTERS = 1 + len(HORIZONS_S) * PHASES
"""Filters of a model: the filter itself, then the copies by horizon and phase."""
_OWN = slice(0, 1)
_X, _Y, _YAW = Component.X, Component.Y, Component.YAW


class Items(NamedTuple):
    """Rows that were forecast, one after the other: K readings of up to m rows, for S models.

    Attributes:
        normalized: `(K, m, S)` e / sqrt(s), with e the innovation after the rows before it.
        variance: `(K, m, S)` s; 1 where a row is not measured.
        taken: `(K, m)` which rows are measured.
    """

    normalized: FloatArray
    variance: FloatArray
    taken: FloatArray


class Forecasts(NamedTuple):
    """Forecasts of a recording's readings.

    Attributes:
        fixes: next-reading forecasts of x, y and the fix's yaw at each epoch with readings.
        compass: those of the compass.
        outages: forecasts of x and y after outages, by horizon.
    """

    fixes: Items
    compass: Items
    outages: tuple[Items, ...]


class Poses(NamedTuple):
    """Poses after each epoch.

    Attributes:
        mean: `(T, 3, S)` x, y and yaw (m, m, rad).
        variance: `(T, 3, S)` their variances (m^2, m^2, rad^2).
    """

    mean: FloatArray
    variance: FloatArray


class _Run:
    """A pass over a recording.

    Args:
        recording: the epochs.
        values: `(16, S)` models.
        filters: of each model: the filter, and its copies.
    """

    def __init__(self, recording: TuningRecording, values: FloatArray, filters: int) -> None:
        self.recording, self.values, self.filters = recording, values, filters
        self.models = values.shape[1]
        lasting = values[[Quantity.FIX_ERROR, Quantity.YAW_ERROR, Quantity.YAW_CONSTANT]]
        self.augmented = bool((lasting > 0.0).any())
        self.process = values[[Quantity.DISTANCE, Quantity.ROTATION], None] ** 2
        position = values[Quantity.POSITION] * _shape_of_position(recording)
        rest = values[[Quantity.COMPASS, Quantity.FIX_YAW]]
        self.noise: FloatArray = np.concatenate([position, rest]) ** 2
        self.error_variance = self._error_variances()
        self.times = values[[Quantity.FIX_TIME, Quantity.FIX_TIME, Quantity.YAW_TIME]]
        self.control = _controls(recording, values)
        self.measurement = _measurements(recording, values)
        self.back = _motion_in_delays(recording, values, self.control)
        self.bank = self._start()
        yaw: Terms = ((_YAW, None),)
        lasting_yaw: Terms = (*yaw, (Component.YAW_DRIFT, None), (Component.YAW_OFFSET, None))
        self.yaw_terms = lasting_yaw if self.augmented else yaw
        self.fix_yaw_terms = yaw if recording.has_compass else self.yaw_terms

    def _error_variances(self) -> FloatArray:
        values = self.values
        fix, yaw = values[Quantity.FIX_ERROR] ** 2, values[Quantity.YAW_ERROR] ** 2
        offset = values[Quantity.YAW_CONSTANT] ** 2
        return np.stack([fix, fix, yaw, offset])

    def _start(self) -> Bank:
        recording = self.recording
        size = AUGMENTED_SIZE if self.augmented else len(recording.mean)
        bank = Bank(
            np.empty((size, self.filters, self.models)),
            np.empty((size, size, self.filters, self.models)),
        )
        self._set_pose(bank, recording.mean, recording.covariance)
        if not recording.from_readings:
            return bank
        P, stds = bank.covariance, recording.parameters.measurement_noise_std
        configured = np.square([*stds, recording.parameters.lrf_yaw_std])
        yaw = Row.COMPASS_YAW if recording.has_compass else Row.LRF_YAW
        for place, row in enumerate((Row.X, Row.Y, yaw)):
            P[place, place] *= self.noise[row] / configured[row]
        if self.augmented:
            for place, variance in enumerate(self.error_variance):
                error, measured = 3 + place, min(place, 2)
                P[measured, measured] += variance
                P[measured, error] = P[error, measured] = -variance
        return bank

    def _set_pose(self, bank: Bank, pose: FloatArray, covariance: FloatArray) -> None:
        """Put the filters of a bank at a pose, with errors as in the long run; in place."""
        mean, P = bank
        mean[...], P[...] = 0.0, 0.0
        mean[:3] = pose[:, None, None]
        P[:3, :3] = covariance[:, :, None, None]
        if self.augmented:
            for place, variance in enumerate(self.error_variance):
                P[3 + place, 3 + place] = variance

    def predict(self, t: int) -> None:
        """Take all filters over epoch t."""
        reset = self.recording.resets.get(t)
        if reset is not None:
            self._set_pose(self.bank, reset.pose, reset.covariance)
        duration_s = float(self.recording.duration_s[t])
        Q = (duration_s / NOMINAL_PERIOD_S) * self.process
        model, control = self.recording.motion_model, self.control[:, t]
        if not self.augmented:
            self.bank = predict(model, self.bank, control, Q)
            return
        phi = np.ones((4, self.models))
        np.exp(-duration_s / self.times, out=phi[:3])
        added = (1.0 - phi * phi) * self.error_variance
        self.bank = predict_augmented(model, self.bank, control, Q, phi[:, None], added[:, None])

    def innovations(self, t: int) -> tuple[FloatArray, FloatArray]:
        """Return r `(4, F, S)` of the readings of epoch t, and H P H' of x and y `(2, 2, F, S)`."""
        if self.augmented:
            expected, covariance = observe(self.bank)
        else:
            expected, covariance = self.bank.mean, self.bank.covariance
        z = self.measurement[:, t, None]
        r = np.empty((4, self.filters, self.models))
        r[:2] = z[:2] - expected[:2]
        r[Row.COMPASS_YAW] = z[Row.COMPASS_YAW] - expected[_YAW]
        fix_yaw = expected if not self.recording.has_compass else self.bank.mean
        r[Row.LRF_YAW] = z[Row.LRF_YAW] - fix_yaw[_YAW]
        if self.back is not None:
            distance, rotation, of_compass = self.back[:, t, None]
            direction = self.bank.mean[_YAW] - 0.5 * rotation
            r[0] += distance * np.cos(direction)
            r[1] += distance * np.sin(direction)
            r[Row.LRF_YAW] += rotation
            r[Row.COMPASS_YAW] += of_compass
        r[2:] = wrap_angle(r[2:])
        return r, covariance[:2, :2]


def forecasts(recording: TuningRecording, values: FloatArray) -> Forecasts:
    """Return the forecasts of a recording's readings.

    Args:
        recording: the epochs.
        values: `(16, S)` models, as in `Quantity`.
    """
    run = _Run(recording, values, FILTERS)
    kept = _Kept(recording, run.models)
    k = 0
    scored, renewed = recording.schedule.scored, recording.schedule.renewed
    for t, measured in enumerate(np.any(recording.available, axis=0)):
        run.predict(t)
        if measured:
            _take_readings(run, t, kept, k, scored[t])
            k += 1
        for horizon in np.flatnonzero(renewed[t] >= 0):
            copy = 1 + horizon * PHASES + renewed[t, horizon]
            run.bank.mean[:, copy] = run.bank.mean[:, 0]
            run.bank.covariance[:, :, copy] = run.bank.covariance[:, :, 0]
    return kept.forecasts()


def poses(recording: TuningRecording, values: FloatArray) -> Poses:
    """Return where models `(16, S)` put the robot, without outages."""
    run = _Run(recording, values, 1)
    kept = _Kept(recording, run.models)
    none = np.full(len(HORIZONS_S), -1)
    shape = (len(recording.duration_s), 3, run.models)
    found = Poses(np.empty(shape), np.empty(shape))
    for t, measured in enumerate(np.any(recording.available, axis=0)):
        run.predict(t)
        if measured:
            _take_readings(run, t, kept, 0, none)
        found.mean[t] = run.bank.mean[:3, 0]
        found.variance[t] = run.bank.covariance[[0, 1, 2], [0, 1, 2], 0]
    return found


class _Kept:
    """Arrays that a pass fills in."""

    def __init__(self, recording: TuningRecording, models: int) -> None:
        measured = recording.available.any(axis=0)
        count, horizons = int(measured.sum()), len(HORIZONS_S)
        self.e = np.zeros((count, 4, models))
        self.s = np.ones((count, 4, models))
        self.outage_e = np.zeros((horizons, count, 2, models))
        self.outage_s = np.ones((horizons, count, 2, models))
        self.available = recording.available[:, measured].T
        self.scored = recording.schedule.scored[measured] >= 0

    def forecasts(self) -> Forecasts:
        fix = [Row.X, Row.Y, Row.LRF_YAW]
        return Forecasts(
            fixes=Items(self.e[:, fix], self.s[:, fix], self.available[:, fix].astype(float)),
            compass=Items(
                self.e[:, [Row.COMPASS_YAW]],
                self.s[:, [Row.COMPASS_YAW]],
                self.available[:, [Row.COMPASS_YAW]].astype(float),
            ),
            outages=tuple(
                Items(e, s, np.repeat(self.scored[:, [horizon]], 2, axis=1).astype(float))
                for horizon, (e, s) in enumerate(zip(self.outage_e, self.outage_s, strict=True))
            ),
        )


def _take_readings(run: _Run, t: int, kept: _Kept, k: int, scored: FloatArray) -> None:
    """Score the readings at the end of epoch t, and correct the filters by them."""
    available = run.recording.available[:, t]
    r, covariance = run.innovations(t)
    P, R = run.bank.covariance, run.noise * run.recording.reported[:, t, None]
    x = np.zeros_like(run.bank.mean)
    excess: FloatArray | float = 0.0
    if available[Row.X]:
        e, s = _sequential(r[:2], covariance, R[:2, None])
        kept.e[k, :2], kept.s[k, :2] = e[:, 0], s[:, 0]
        for horizon in np.flatnonzero(scored >= 0):
            copy = 1 + horizon * PHASES + scored[horizon]
            kept.outage_e[horizon, k], kept.outage_s[horizon, k] = e[:, copy], s[:, copy]
        excess = np.maximum((e[0, 0] ** 2 + e[1, 0] ** 2) / FIX_LIMIT, 1.0) - 1.0
        for row in (Row.X, Row.Y):
            terms: Terms = ((int(row), None),)
            wide = R[row] + excess * R[row]
            if run.augmented:
                error = Component.FIX_X + int(row)
                terms = (*terms, (error, None))
                wide = wide + excess * P[error, error, 0]
            take_row(x[:, _OWN], P[:, :, _OWN], terms, r[row, _OWN], wide[None], None)
    if available[Row.LRF_YAW]:
        kept.e[k, Row.LRF_YAW], kept.s[k, Row.LRF_YAW] = _take_yaw(
            x, P, run.fix_yaw_terms, r[Row.LRF_YAW], R[Row.LRF_YAW], excess
        )
    if available[Row.COMPASS_YAW]:
        kept.e[k, Row.COMPASS_YAW], kept.s[k, Row.COMPASS_YAW] = _take_yaw(
            x, P, run.yaw_terms, r[Row.COMPASS_YAW], R[Row.COMPASS_YAW], None
        )
    run.bank.mean[...] += x
    run.bank.mean[_YAW] = wrap_angle(run.bank.mean[_YAW])


def _take_yaw(
    x: FloatArray,
    P: FloatArray,
    terms: Terms,
    r: FloatArray,
    R: FloatArray,
    excess: FloatArray | float | None,
) -> tuple[FloatArray, FloatArray]:
    """Correct all filters by a yaw; return its forecast by the first, e / sqrt(s) and s `(S,)`.

    Args:
        x: corrections so far; changed.
        P: covariances; changed.
        terms: the row.
        r: `(F, S)` innovation [rad].
        R: `(S,)` its variance [rad^2].
        excess: by how many times R its noise is larger; None: its own NIS says.
    """
    places = [place for place, _ in terms]
    e = r[0] - x[places, 0].sum(axis=0)
    s = P[np.ix_(places, places)][:, :, 0].sum(axis=(0, 1)) + R
    if excess is None:
        excess = np.maximum(e * e / (s * YAW_LIMIT), 1.0) - 1.0
    noise = np.broadcast_to((1.0 + excess) * R, r.shape)
    take_row(x, P, terms, r, noise, None)
    return e / np.sqrt(s), s


def _sequential(
    r: FloatArray, covariance: FloatArray, R: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return e / sqrt(s) and s `(2, F, S)` of x and of y given x."""
    sx = covariance[0, 0] + R[0]
    gain = covariance[1, 0] / sx
    sy = covariance[1, 1] + R[1] - gain * covariance[0, 1]
    s = np.stack([sx, sy])
    return np.stack([r[0], r[1] - gain * r[0]]) / np.sqrt(s), s


def _shape_of_position(recording: TuningRecording) -> FloatArray:
    """Return the configured noise of x and y over that of x, `(2, 1)`, which tuning keeps."""
    x, y, _ = recording.parameters.measurement_noise_std
    return np.array([[1.0], [y / x]])


def _controls(recording: TuningRecording, values: FloatArray) -> FloatArray:
    """Return [dS, dtheta] `(2, T, S)` of the wheels with each model's geometry (m, rad).

    With the factor rho of the radius, epsilon the difference of the wheels, and lambda the factor
    of the separation L:

        dS' = rho (dS + epsilon L dtheta / 4),   dtheta' = rho (dtheta + epsilon dS / L) / lambda
    """
    distance, rotation = recording.control[..., None]
    rho, ratio = values[Quantity.RADIUS], values[Quantity.RATIO]
    L = recording.parameters.wheel_separation
    return np.stack([
        rho * (distance + 0.25 * ratio * L * rotation),
        rho / values[Quantity.SEPARATION] * (rotation + ratio * distance / L),
    ])  # fmt: skip


def _measurements(recording: TuningRecording, values: FloatArray) -> FloatArray:
    """Return the readings `(4, T, S)` with each model's compass offset."""
    z = np.repeat(recording.measurement[..., None], values.shape[1], axis=2)
    z[Row.COMPASS_YAW] += values[Quantity.OFFSET]
    return z


def _motion_in_delays(
    recording: TuningRecording, values: FloatArray, control: FloatArray
) -> FloatArray | None:
    """Return how far the robot went in the delay of a reading, `(3, T, S)`; None without delays.

    The distance and the rotation in the delay of the fixes, and the rotation in that of the compass
    (m, rad, rad).
    """
    delays = values[[Quantity.FIX_DELAY, Quantity.COMPASS_DELAY]]
    if not delays.any():
        return None
    end = np.cumsum(recording.duration_s)
    knots = np.concatenate([[0.0], end])
    found = np.zeros((3, *control.shape[1:]))
    for model in range(values.shape[1]):
        path = np.concatenate([np.zeros((2, 1)), np.cumsum(control[:, :, model], axis=1)], axis=1)
        fix, compass = (np.clip(end - delay, 0.0, end[-1]) for delay in delays[:, model])
        for place, (along, times) in enumerate(((0, fix), (1, fix), (1, compass))):
            found[place, :, model] = path[along, 1:] - np.interp(times, knots, path[along])
    return found
