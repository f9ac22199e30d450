# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""A recording as arrays: the epochs of the localizer, and the schedule of simulated outages."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from fnn_ekf_ros.core.arrays import MEASUREMENT_SIZE, BoolArray, FloatArray, Row
from fnn_ekf_ros.core.lasting.outages import WINDOW
from fnn_ekf_ros.core.motion import MotionModel
from fnn_ekf_ros.core.results import Epoch
from fnn_ekf_ros.core.rows import FIX_ROWS
from fnn_ekf_ros.parameters.localizer import LocalizerParameters
from fnn_ekf_ros.study.real import BatchStart
from fnn_ekf_ros.timeline.events import PoseReset

HORIZONS_S = (10.0, 100.0)
"""Durations of the simulated outages before their copies are scored [s], as mode joint has them."""
PHASES = 3
"""Copies per horizon: their windows of half a horizon follow each other without a gap."""
STANDSTILL = (1e-3, 1e-3)
"""Speeds below which the robot stands, and outages do not go on (m/s, rad/s)."""


class TuningRecording(NamedTuple):
    """A recording, for T epochs.

    Attributes:
        label: its name.
        parameters: of the localizer.
        mean: `(3,)` pose at the start (m, m, rad).
        covariance: `(3, 3)` its covariance with the configured noise.
        from_readings: whether the start is of a fix and a yaw.
        control: `(2, T)` [dS, dtheta] with the configured geometry (m, rad).
        duration_s: `(T,)` of the epochs [s].
        measurement: `(4, T)` z, rows as in `Row`.
        available: `(4, T)` which rows were measured.
        reported: `(4, T)` variances that fixes report over the configured ones; 1 for none. How x,
            y and yaw of a fix are correlated is not used.
        resets: poses that were set, by the epoch that they come before.
        schedule: of the outages.
    """

    label: str
    parameters: LocalizerParameters
    mean: FloatArray
    covariance: FloatArray
    from_readings: bool
    control: FloatArray
    duration_s: FloatArray
    measurement: FloatArray
    available: BoolArray
    reported: FloatArray
    resets: Mapping[int, PoseReset]
    schedule: "Schedule"

    @property
    def motion_model(self) -> MotionModel:
        """The localizer's motion model."""
        return MotionModel(self.parameters.motion_model)

    @property
    def has_compass(self) -> bool:
        """Whether a compass was heard."""
        return bool(self.available[Row.COMPASS_YAW].any())

    @property
    def has_fix_yaw(self) -> bool:
        """Whether the fixes' yaw is used."""
        return bool(self.available[Row.LRF_YAW].any())


class Schedule(NamedTuple):
    """Simulated outages of a recording, `(T, H)` each for H horizons.

    Attributes:
        renewed: copy that is made anew after the epoch; -1 for none.
        scored: copy that the fix at the epoch's end is compared with; -1 for none.
        window: number of the window that this fix is in.
        weight: 1 over the number of fixes in this window; 0 where nothing is scored.
    """

    renewed: "np.ndarray[tuple[int, ...], np.dtype[np.intp]]"
    scored: "np.ndarray[tuple[int, ...], np.dtype[np.intp]]"
    window: "np.ndarray[tuple[int, ...], np.dtype[np.intp]]"
    weight: FloatArray


def schedule_of(control: FloatArray, duration_s: FloatArray, fixed: BoolArray) -> Schedule:
    """Return the schedule of the outages.

    Args:
        control: `(2, T)` of the wheels (m, rad).
        duration_s: `(T,)` [s].
        fixed: `(T,)` whether a fix comes at the epoch's end.
    """
    limit = np.array(STANDSTILL)[:, None] * duration_s
    moving = (np.abs(control) >= limit).any(axis=0)
    clock = np.cumsum(np.where(moving, duration_s, 0.0))
    shape = (len(duration_s), len(HORIZONS_S))
    renewed, scored = np.full(shape, -1, dtype=np.intp), np.full(shape, -1, dtype=np.intp)
    window, weight = np.zeros(shape, dtype=np.intp), np.zeros(shape)
    for place, horizon in enumerate(HORIZONS_S):
        length = WINDOW * horizon
        interval = np.floor(clock / length).astype(np.intp)
        begins = np.flatnonzero(np.diff(interval, prepend=-1))
        renewed[begins, place] = interval[begins] % PHASES
        # A copy made in interval i is of age H, two windows, in interval i + 2.
        age = round(1.0 / WINDOW)
        counts = fixed & (interval >= age)
        counts &= np.isin(interval - age, interval[begins])
        scored[counts, place] = (interval[counts] - age) % PHASES
        window[:, place] = interval
        number = np.bincount(interval[counts], minlength=int(interval[-1]) + 1)
        weight[counts, place] = 1.0 / number[interval[counts]]
    return Schedule(renewed, scored, window, weight)


def _reported(parameters: LocalizerParameters, epoch: Epoch) -> FloatArray:
    """Return the variances `(4,)` that a fix reports over the configured ones; 1 for none."""
    ratio = np.ones(MEASUREMENT_SIZE)
    if epoch.fix_covariance is not None:
        stds = (*parameters.measurement_noise_std, parameters.lrf_yaw_std)
        for place, row in enumerate(FIX_ROWS):
            if epoch.available[row]:
                ratio[row] = epoch.fix_covariance[place, place] / stds[row] ** 2
    return ratio


def prepare(label: str, parameters: LocalizerParameters, batch: BatchStart) -> TuningRecording:
    """Return a recording as arrays.

    Args:
        label: its name.
        parameters: of the localizer.
        batch: the localizer's start and periods.
    """
    epochs: list[Epoch] = list(batch.rest)
    resets = {}
    for inputs in batch.inputs:
        epochs += inputs.epochs
        if inputs.reset is not None:
            resets[len(epochs)] = inputs.reset
        epochs += inputs.epochs_after_reset
    control = np.stack([epoch.control for epoch in epochs], axis=1)
    duration_s = np.array([epoch.duration_s for epoch in epochs])
    available = np.stack([epoch.available for epoch in epochs], axis=1)
    return TuningRecording(
        label=label,
        parameters=parameters,
        mean=batch.start.mean[0],
        covariance=batch.start.covariance[0],
        from_readings=batch.from_readings,
        control=control,
        duration_s=duration_s,
        measurement=np.stack([epoch.measurement for epoch in epochs], axis=1),
        available=available,
        reported=np.stack([_reported(parameters, epoch) for epoch in epochs], axis=1),
        resets=resets,
        schedule=schedule_of(control, duration_s, available[Row.X]),
    )
