# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The table of what was tuned, and sentences on what the recordings cannot tell."""

import math
from collections.abc import Sequence
from dataclasses import asdict
from typing import NamedTuple

import numpy as np

from fnn_ekf_ros.core.arrays import FloatArray
from fnn_ekf_ros.core.lasting.outages import WINDOW
from fnn_ekf_ros.parameters.localizer import LocalizerParameters
from fnn_ekf_ros.tuning.quantities import MEANINGS, Quantity, is_logarithm, scale_of
from fnn_ekf_ros.tuning.recording import HORIZONS_S, TuningRecording
from fnn_ekf_ros.tuning.tune import Model, Tuned
from fnn_ekf_ros.tuning.uncertainty import QUANTILE, Interval

UNKNOWN_STD = 0.35
"""Standard error of a logarithm from which on a quantity is said to be hardly known: its 95 %
interval then is a factor of two to each side."""
FEW_TURNS = 2.0
"""Number of full turns below which wheel separation and compass offset are said to be unknown."""
PARAMETER_OF = {
    Quantity.DISTANCE: "process_noise_std[0]",
    Quantity.ROTATION: "process_noise_std[1]",
    Quantity.POSITION: "measurement_noise_std[0]",
    Quantity.COMPASS: "measurement_noise_std[2]",
    Quantity.FIX_YAW: "lrf_yaw_std",
    Quantity.RADIUS: "wheel_radius",
    Quantity.SEPARATION: "wheel_separation",
    Quantity.OFFSET: "compass_offset",
    Quantity.FIX_DELAY: "lrf_pose_delay",
    Quantity.COMPASS_DELAY: "compass_delay",
}
"""Parameters of the localizer that quantities belong to; the others have none."""

WRITTEN = {name.split("[")[0] for name in PARAMETER_OF.values()} | {
    "left_wheel_radius_multiplier",
    "right_wheel_radius_multiplier",
}
"""Parameters of the localizer that tuning changes."""


class Line(NamedTuple):
    """A line of the table.

    Attributes:
        name: of the parameter, or of the quantity if it has none.
        unit: of the values.
        now: its value in the recordings' parameters; None if it has none.
        found: the value that was found.
        low: begin of the 95 % interval.
        high: its end.
        hardly_known: whether the recordings hardly tell it.
    """

    name: str
    unit: str
    now: float | None
    found: float
    low: float
    high: float
    hardly_known: bool


def lines(tuned: Tuned, model: Model) -> list[Line]:
    """Return the table of a model."""
    return [_line(tuned.before, model.fit.values, interval) for interval in model.intervals]


def _line(before: LocalizerParameters, values: FloatArray, interval: Interval) -> Line:
    quantity = interval.quantity
    half = QUANTILE * interval.std
    found = float(values[quantity])
    if is_logarithm(quantity):
        with np.errstate(over="ignore"):
            factor = float(np.exp(half))
        low, high = found / factor, found * factor
        hardly = interval.std > UNKNOWN_STD
    else:
        half *= scale_of(quantity)
        low, high = found - half, found + half
        largest = min(-MEANINGS[quantity].low, MEANINGS[quantity].high)
        hardly = half > 0.5 * largest
    size, start = _configured(before, quantity)
    name = PARAMETER_OF.get(quantity, MEANINGS[quantity].name)
    low, found, high = (start + size * value for value in (low, found, high))
    now = _now(before, quantity)
    return Line(name, MEANINGS[quantity].unit, now, found, low, high, hardly or interval.at_bound)


def _configured(before: LocalizerParameters, quantity: Quantity) -> tuple[float, float]:
    """Return factor and offset from a quantity's value to what the table shows."""
    if quantity is Quantity.RADIUS:
        return before.wheel_radius, 0.0
    if quantity is Quantity.SEPARATION:
        return before.wheel_separation, 0.0
    return 1.0, {
        Quantity.OFFSET: before.compass_offset,
        Quantity.FIX_DELAY: before.lrf_pose_delay,
        Quantity.COMPASS_DELAY: before.compass_delay,
    }.get(quantity, 0.0)


def _now(before: LocalizerParameters, quantity: Quantity) -> float | None:
    distance, rotation = before.process_noise_std
    position, _, compass = before.measurement_noise_std
    return {
        Quantity.DISTANCE: distance, Quantity.ROTATION: rotation,
        Quantity.POSITION: position, Quantity.COMPASS: compass,
        Quantity.FIX_YAW: before.lrf_yaw_std,
        Quantity.RADIUS: before.wheel_radius, Quantity.SEPARATION: before.wheel_separation,
        Quantity.OFFSET: before.compass_offset,
        Quantity.FIX_DELAY: before.lrf_pose_delay, Quantity.COMPASS_DELAY: before.compass_delay,
    }.get(quantity)  # fmt: skip


def table(of_model: Sequence[Line]) -> str:
    """Return the lines as text."""
    row = "{:<26} {:>10} {:>10}   {:<23} {}".format
    text = [row("parameter", "now", "found", "95 % interval", "unit").rstrip()]
    for line in of_model:
        now = "-" if line.now is None else f"{line.now:.4g}"
        interval = f"{line.low:.4g} to {line.high:.4g}"
        if not math.isfinite(line.high):
            interval = "unknown"
        text.append(row(line.name, now, f"{line.found:.4g}", interval, line.unit).rstrip())
    return "\n".join(text)


def changes(tuned: Tuned) -> str:
    """Return the parameters that are written, with what they were, as text."""
    before, after = asdict(tuned.before), asdict(tuned.after)
    row = "{:<26} {:<28} {}".format
    text = [row("parameter", "now", "written")]
    for name, value in after.items():
        if name in WRITTEN and value != before[name]:
            text.append(row(name, _short(before[name]), _short(value)))
    return "\n".join(text)


def _short(value: object) -> str:
    if isinstance(value, tuple):
        return f"[{', '.join(f'{entry:.4g}' for entry in value)}]"
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def remarks(recordings: Sequence[TuningRecording], tuned: Tuned) -> list[str]:
    """Return what the user has to know beside the numbers, one sentence each."""
    said = [*_of_errors(tuned), *_of_outages(recordings)]
    hardly = [line.name for line in lines(tuned, tuned.shown) if line.hardly_known]
    if hardly:
        said.append(f"The recordings hardly tell {_listed(hardly)}: see the intervals.")
    turns = sum(float(np.abs(r.control[1]).sum()) for r in recordings) / (2.0 * math.pi)
    if turns < FEW_TURNS:
        said.append(
            f"The robot made {turns:.1f} turns: rotation noise, wheel separation and offsets of "
            "yaw need a drive with turns both ways."
        )
    if not any(recording.has_compass for recording in recordings):
        said.append("There is no compass: its noise, offset and delay stay as they are.")
    return [*said, *_of_calibration(tuned)]


def _of_errors(tuned: Tuned) -> list[str]:
    if not tuned.errors_last:
        return ["Errors look white: a model with lasting errors predicts no better."]
    values = tuned.lasting.fit.values
    said = []
    if values[Quantity.FIX_ERROR] > 0.3 * values[Quantity.POSITION]:
        said.append(
            f"Errors of the fixes last: {values[Quantity.FIX_ERROR]:.3g} m for about "
            f"{values[Quantity.FIX_TIME]:.2g} s, beside {values[Quantity.POSITION]:.2g} m from fix "
            "to fix."
        )
    if values[Quantity.YAW_ERROR] > 0.3 * values[Quantity.FIX_YAW]:
        said.append(
            f"Errors of yaw last: {values[Quantity.YAW_ERROR]:.2g} rad for about "
            f"{values[Quantity.YAW_TIME]:.2g} s."
        )
    return [
        *said,
        "The noise in the parameters is for a filter that takes all errors for white; "
        "adaptation: joint follows the lasting part itself.",
    ]


def _of_outages(recordings: Sequence[TuningRecording]) -> list[str]:
    longest = max(float(recording.duration_s.sum()) for recording in recordings)
    needed = 10.0 * (1.0 + WINDOW) * max(HORIZONS_S)
    if longest >= needed:
        return []
    return [
        f"The longest recording has {longest:.0f} s: errors that last for minutes take "
        f"{needed:.0f} s or more to be told from wheel noise."
    ]


def _of_calibration(tuned: Tuned) -> list[str]:
    ratio = tuned.shown.fit.values[Quantity.RATIO]
    for interval in tuned.shown.intervals:
        known = abs(interval.coordinate) > QUANTILE * interval.std
        if interval.quantity is Quantity.RATIO and known:
            size = "larger" if ratio > 0.0 else "smaller"
            return [
                f"The right wheel is {100.0 * abs(ratio):.2f} % {size} than the left one; "
                "wheel_radius is their mean."
            ]
    return []


def _listed(names: Sequence[str]) -> str:
    *first, last = names
    return f"{', '.join(first)} and {last}" if first else last
