# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Tuning of a localizer: from recordings to parameters, with what is known of them."""

import dataclasses
import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from fnn_ekf_ros.core.arrays import FloatArray, Row
from fnn_ekf_ros.errors import FnnEkfError
from fnn_ekf_ros.parameters.localizer import LARGEST_DELAY_S, LocalizerParameters
from fnn_ekf_ros.tuning.fit import (
    SHORT_OUTAGES,
    Fit,
    Progress,
    beginnings,
    errors_last,
    fit,
)
from fnn_ekf_ros.tuning.plain import plain_noise
from fnn_ekf_ros.tuning.quantities import COUNT, LASTING, Quantity
from fnn_ekf_ros.tuning.recording import TuningRecording
from fnn_ekf_ros.tuning.uncertainty import Interval, Profile, intervals, profiles

FEWEST_FIXES = 30
"""Fewest fixes of all recordings together: with fewer, not even their noise is known to 15 %."""


class Model(NamedTuple):
    """A fitted model with what is known of it.

    Attributes:
        fit: the fit.
        intervals: of its quantities.
        profiles: of its quantities; none where it is not the model that the recordings show.
    """

    fit: Fit
    intervals: tuple[Interval, ...]
    profiles: tuple[Profile, ...]


class Tuned(NamedTuple):
    """What was found.

    Attributes:
        before: the parameters that the recordings were read with.
        after: those to run the localizer with.
        white: the model whose errors are white.
        lasting: the model whose errors last.
        errors_last: whether the recordings show that errors last.
    """

    before: LocalizerParameters
    after: LocalizerParameters
    white: Model
    lasting: Model
    errors_last: bool

    @property
    def shown(self) -> Model:
        """The model that the recordings show."""
        return self.lasting if self.errors_last else self.white


def tune(recordings: Sequence[TuningRecording], *, calibrates: bool, progress: Progress) -> Tuned:
    """Return what recordings of a robot tell of its noise.

    Args:
        recordings: at least one, all with the same parameters.
        calibrates: whether geometry, compass offset and delays are looked for, too.
        progress: is told what is being done.

    Raises:
        FnnEkfError: there are too few fixes.
    """
    fixes = sum(int(recording.available[Row.X].sum()) for recording in recordings)
    if fixes < FEWEST_FIXES:
        raise FnnEkfError(
            f"{fixes} fixes in the recordings: expected at least {FEWEST_FIXES} to tell their noise"
        )
    before = recordings[0].parameters
    noise, calibration = _quantities(recordings, calibrates=calibrates)
    start = configured(before)
    which = (*noise, *calibration)
    white = fit(recordings, which, start[:, None], _named(progress, "white errors"))
    lasting = fit(
        recordings,
        (*noise, *LASTING, *calibration),
        np.concatenate(
            [
                beginnings(values, constant_yaw_error=not calibration)
                for values in (white.values, start)
            ],
            axis=1,
        ),
        _named(progress, "lasting errors"),
    )
    last = errors_last(white, lasting)
    plain = white.values
    if last and lasting.weights != SHORT_OUTAGES:
        plain = plain_noise(recordings, lasting.values, noise, progress)
    progress("profiles")
    models = [
        Model(each, found, profiles(recordings, each, found) if shown else ())
        for each, shown in ((white, not last), (lasting, last))
        for found in (intervals(each),)
    ]
    return Tuned(
        before=before,
        after=found_parameters(before, plain, noise, calibration),
        white=models[0],
        lasting=models[1],
        errors_last=last,
    )


def _named(progress: Progress, model: str) -> Progress:
    return lambda text: progress(f"{model}, {text}")


def configured(parameters: LocalizerParameters) -> FloatArray:
    """Return the values `(16,)` that parameters have, without lasting errors."""
    values = np.zeros(COUNT)
    values[[Quantity.DISTANCE, Quantity.ROTATION]] = parameters.process_noise_std
    values[Quantity.POSITION], _, values[Quantity.COMPASS] = parameters.measurement_noise_std
    values[Quantity.FIX_YAW] = parameters.lrf_yaw_std
    values[[Quantity.FIX_TIME, Quantity.YAW_TIME]] = 1.0
    values[[Quantity.RADIUS, Quantity.SEPARATION]] = 1.0
    return values


def _quantities(
    recordings: Sequence[TuningRecording], *, calibrates: bool
) -> tuple[tuple[Quantity, ...], tuple[Quantity, ...]]:
    """Return the quantities of noise and of calibration that the recordings have sensors for."""
    compass = any(recording.has_compass for recording in recordings)
    fix_yaw = any(recording.has_fix_yaw for recording in recordings)
    noise = [Quantity.DISTANCE, Quantity.ROTATION, Quantity.POSITION]
    noise += [Quantity.COMPASS] * compass + [Quantity.FIX_YAW] * fix_yaw
    if not calibrates:
        return tuple(noise), ()
    calibration = [Quantity.RADIUS, Quantity.RATIO, Quantity.SEPARATION, Quantity.FIX_DELAY]
    calibration += [Quantity.OFFSET, Quantity.COMPASS_DELAY] * compass
    return tuple(noise), tuple(calibration)


def found_parameters(
    before: LocalizerParameters,
    values: FloatArray,
    noise: Sequence[Quantity],
    calibration: Sequence[Quantity],
) -> LocalizerParameters:
    """Return parameters with what was found, within the bounds that they set.

    Args:
        before: the parameters.
        values: `(16,)` of the quantities.
        noise: those of noise that were fitted.
        calibration: those of calibration that were.
    """
    x, y, compass = before.measurement_noise_std
    position = float(values[Quantity.POSITION])
    if Quantity.COMPASS in noise:
        compass = float(values[Quantity.COMPASS])
    process = (float(values[Quantity.DISTANCE]), float(values[Quantity.ROTATION]))
    low, high = before.measurement_noise_std_min, before.measurement_noise_std_max
    changed: dict[str, Any] = {
        "process_noise_std": _within(
            process, before.process_noise_std_min, before.process_noise_std_max
        ),
        "measurement_noise_std": _within((position, position * y / x, compass), low, high),
    }
    if Quantity.FIX_YAW in noise:
        yaw = (float(values[Quantity.FIX_YAW]),)
        (changed["lrf_yaw_std"],) = _within(yaw, low[2:], high[2:])
    if calibration:
        changed["wheel_radius"] = before.wheel_radius * float(values[Quantity.RADIUS])
        changed["wheel_separation"] = before.wheel_separation * float(values[Quantity.SEPARATION])
        half = 0.5 * float(values[Quantity.RATIO])
        for name, factor in (
            ("left_wheel_radius_multiplier", 1.0 - half),
            ("right_wheel_radius_multiplier", 1.0 + half),
        ):
            changed[name] = round(getattr(before, name) * factor, 5)
    for name, quantity in (
        ("lrf_pose_delay", Quantity.FIX_DELAY),
        ("compass_delay", Quantity.COMPASS_DELAY),
    ):
        if quantity in calibration:
            delay = getattr(before, name) + round(float(values[quantity]), 3)
            changed[name] = float(np.clip(delay, -LARGEST_DELAY_S, LARGEST_DELAY_S))
    if Quantity.OFFSET in calibration:
        offset = before.compass_offset + float(values[Quantity.OFFSET])
        changed["compass_offset"] = math.remainder(offset, 2.0 * math.pi)
    return dataclasses.replace(before, **changed)


def _within(
    values: tuple[float, ...], low: tuple[float, ...], high: tuple[float, ...]
) -> tuple[float, ...]:
    """Return values within bounds, to four digits: more are not known."""
    return tuple(
        float(min(max(float(f"{value:.4g}"), a), b))
        for value, a, b in zip(values, low, high, strict=True)
    )
