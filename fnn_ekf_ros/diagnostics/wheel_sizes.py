# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Wheels that travel more or less than their counts say: a flat tyre, a wrong wheel_radius.

Noise has no direction. A wheel of another size has one: compass and fixes correct the filter in the
same direction again and again, in proportion to the distance of the wheel, although no correction
is large. The parts g by which the wheels travel less than they count are estimated by least squares
from the corrections of the last `LOOK_BACK_S`:

    correction of the rotation = (g_left l - g_right r) / L     l, r: distances the wheels counted
    correction of the distance = -(g_left l + g_right r) / 2    L: distance between the wheels

An offset of compass or fixes corrects the filter once, so each half of the time has to show the
sizes by itself. A late compass corrects the rotation in curves, and late fixes correct the
distance, so the rotation has to show the sizes and the distance has to confirm them. (Two wheels
that are off by the same factor look like late fixes on a straight path, and are not reported.) The
corrections are compared with the wheels' noise at the begin of that time, because the noise that
was learned since may already contain them.

| sizes are wrong from | |
| --- | --- |
| 5 standard deviations on | of the corrections of 18 s, of distance and rotation together |
| 3 standard deviations on | of each half, and of the rotation alone, which must not exceed both |
| 5 % on | of a wheel's distance |
"""

import math
from typing import NamedTuple

import numpy as np

from fnn_ekf_ros.core.arrays import BoolArray, FloatArray
from fnn_ekf_ros.core.pace import NOMINAL_PERIOD_S
from fnn_ekf_ros.diagnostics.messages import EncoderMessage, fill
from fnn_ekf_ros.diagnostics.noise_words import Values

LOOK_BACK_S = 18.0
"""Time over which corrections are evaluated [s]: a fault is named soon, and straight paths and
curves alternate in it."""
SIGMAS = 5.0
"""Significance from which on sizes are wrong, in standard deviations: right wheels exceed it once
in 300 000 evaluations."""
PART_SIGMAS = 3.0
"""Significance that each half of the time and the rotation alone need, in standard deviations: an
event that happened once is in one half only."""
SMALLEST_PART = 0.05
"""Least error of a wheel, as a part of its distance: a smaller one is a matter of calibration, no
fault."""
LIKELY_PART = 1.0
"""Standard deviation of g before any correction: a wheel that did not turn keeps its configured
size."""


SIZE_KEYS = tuple(f"{wheel} wheel's distance against its counts [%]" for wheel in ("left", "right"))
"""Keys of the sizes of the wheels."""


class PeriodCorrection(NamedTuple):
    """Motion by the wheels in a period, or short ones together, and the filter's correction of it.

    Attributes:
        stamp_ns: its end [ns].
        distance: that the wheels counted [m].
        rotation: that they counted [rad].
        distance_correction: by which measurements moved the filter ahead [m].
        rotation_correction: by which they rotated it [rad].
        distance_noise: assumed variance of the wheels' distance [m^2].
        rotation_noise: assumed variance of their rotation [rad^2].
        position_variance: of the filter, the larger one [m^2].
        yaw_variance: likewise [rad^2].
    """

    stamp_ns: int
    distance: float
    rotation: float
    distance_correction: float
    rotation_correction: float
    distance_noise: float
    rotation_noise: float
    position_variance: float
    yaw_variance: float


class WheelSizes(NamedTuple):
    """The wheels' sizes by the corrections.

    Attributes:
        left: g of the left wheel: the part by which it travels less than it counts; negative: more.
        right: g of the right wheel.
        sigmas: significance of a difference from 0, in standard deviations.
        half_sigmas: the same of the half of the time in which it is smaller.
        rotation_sigmas: the same of the corrections of the rotation alone.
    """

    left: float
    right: float
    sigmas: float
    half_sigmas: float
    rotation_sigmas: float

    @property
    def wrong(self) -> bool:
        """Whether a wheel is not as large as it should be."""
        return (
            self.sigmas >= max(SIGMAS, self.rotation_sigmas)
            and min(self.half_sigmas, self.rotation_sigmas) >= PART_SIGMAS
            and max(abs(self.left), abs(self.right)) >= SMALLEST_PART
        )


def with_correction(
    corrections: tuple[PeriodCorrection, ...], newest: PeriodCorrection
) -> tuple[PeriodCorrection, ...]:
    """Return the corrections with one more, without those that are too old.

    Periods shorter than the nominal one are added up to one correction.
    """
    if len(corrections) > 1 and _seconds(corrections[-2], newest) <= NOMINAL_PERIOD_S:
        corrections, newest = corrections[:-1], _together(corrections[-1], newest)
    old = 0
    while old < len(corrections) and _seconds(corrections[old], newest) >= LOOK_BACK_S:
        old += 1
    return (*corrections[max(old - 1, 0) :], newest)


def _together(one: PeriodCorrection, other: PeriodCorrection) -> PeriodCorrection:
    """Return the corrections of two consecutive periods as one."""
    return other._replace(
        distance=one.distance + other.distance,
        rotation=one.rotation + other.rotation,
        distance_correction=one.distance_correction + other.distance_correction,
        rotation_correction=one.rotation_correction + other.rotation_correction,
        distance_noise=one.distance_noise + other.distance_noise,
        rotation_noise=one.rotation_noise + other.rotation_noise,
    )


def estimate_sizes(
    corrections: tuple[PeriodCorrection, ...], wheel_separation: float
) -> WheelSizes | None:
    """Return the wheels' sizes by the corrections; None if these do not reach far enough back.

    Args:
        corrections: as `with_correction` gives them.
        wheel_separation: L [m].
    """
    if len(corrections) < 2 or _seconds(corrections[0], corrections[-1]) < LOOK_BACK_S:
        return None
    first, last, count = corrections[0], corrections[-1], len(corrections)
    # The pose's errors at begin and end are corrected, too: they are spread over all periods.
    distance_noise = (
        first.distance_noise + (first.position_variance + last.position_variance) / count
    )
    rotation_noise = first.rotation_noise + (first.yaw_variance + last.yaw_variance) / count
    if not (distance_noise > 0.0 and rotation_noise > 0.0):
        return None
    distance = np.array([each.distance for each in corrections])
    rotation = np.array([each.rotation for each in corrections])
    left = distance - 0.5 * wheel_separation * rotation
    right = distance + 0.5 * wheel_separation * rotation
    rotated = np.array([each.rotation_correction for each in corrections])
    moved = np.array([each.distance_correction for each in corrections])
    by_rotation = _Equations(
        np.stack([left, -right], axis=-1) / (wheel_separation * math.sqrt(rotation_noise)),
        rotated / math.sqrt(rotation_noise),
    )
    by_distance = _Equations(
        -0.5 * np.stack([left, right], axis=-1) / math.sqrt(distance_noise),
        moved / math.sqrt(distance_noise),
    )
    parts, sigmas = _fit(by_rotation.and_also(by_distance))
    half = np.arange(count) < count // 2
    halves = [
        _significance_along(parts, by_rotation.only(which).and_also(by_distance.only(which)))
        for which in (half, ~half)
    ]
    _, rotation_sigmas = _fit(by_rotation)
    return WheelSizes(
        left=float(parts[0]),
        right=float(parts[1]),
        sigmas=sigmas,
        half_sigmas=min(halves),
        rotation_sigmas=rotation_sigmas,
    )


def size_messages(sizes: WheelSizes) -> list[str]:
    """Return what diagnostics say of wheels of wrong sizes."""
    return [
        fill(
            EncoderMessage.WHEEL_SMALLER if part > 0.0 else EncoderMessage.WHEEL_LARGER, wheel=name
        )
        for name, part in (("left", sizes.left), ("right", sizes.right))
        if abs(part) >= SMALLEST_PART
    ]


def size_values(sizes: WheelSizes) -> Values:
    """Return the numbers behind these messages."""
    parts = zip(SIZE_KEYS, (sizes.left, sizes.right), strict=True)
    return tuple((key, f"{-100.0 * part:+.0f}") for key, part in parts)


class _Equations(NamedTuple):
    """Linear equations for the two parts g, each divided by its standard deviation.

    Attributes:
        rows: `(n, 2)` coefficients.
        values: `(n,)` right-hand sides.
    """

    rows: FloatArray
    values: FloatArray

    def and_also(self, other: "_Equations") -> "_Equations":
        """Return these equations and others."""
        return _Equations(
            np.concatenate([self.rows, other.rows]), np.concatenate([self.values, other.values])
        )

    def only(self, which: BoolArray) -> "_Equations":
        """Return some of these equations."""
        return _Equations(self.rows[which], self.values[which])


def _fit(equations: _Equations) -> tuple[FloatArray, float]:
    """Return the parts `(2,)` that solve equations best, and their significance in std."""
    rows, values = equations
    weighed = rows.T @ values
    precision = rows.T @ rows + np.eye(2) / LIKELY_PART**2
    parts = np.asarray(np.linalg.solve(precision, weighed), dtype=np.float64)
    return parts, math.sqrt(max(float(weighed @ parts), 0.0))


def _significance_along(parts: FloatArray, equations: _Equations) -> float:
    """Return the significance of equations in the direction of `parts` `(2,)`, in std."""
    rows, values = equations
    expected = rows @ parts
    length = float(np.linalg.norm(expected))
    return float(expected @ values) / length if length > 0.0 else 0.0


def _seconds(begin: PeriodCorrection, end: PeriodCorrection) -> float:
    return (end.stamp_ns - begin.stamp_ns) * 1e-9
