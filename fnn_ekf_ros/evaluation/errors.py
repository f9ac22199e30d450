# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Errors of a track against the truth: per axis, absolute (ATE) and relative (RPE)."""

import math
from typing import NamedTuple

import numpy as np

from fnn_ekf_ros.core.angles import wrap_angle
from fnn_ekf_ros.core.arrays import FloatArray
from fnn_ekf_ros.errors import FnnEkfError
from fnn_ekf_ros.evaluation.matching import Matched


class Statistics(NamedTuple):
    """Sizes of errors; NaN where there are none.

    Attributes:
        rmse: root mean square.
        mean: mean of the absolute values.
        median: of the absolute values.
        max: largest absolute value.
    """

    rmse: float
    mean: float
    median: float
    max: float


class RelativeDelta(NamedTuple):
    """Step over which relative errors are taken.

    Attributes:
        value: its length.
        unit: `m` along the estimated track, or `poses`.
    """

    value: float
    unit: str

    def __str__(self) -> str:
        return f"{self.value:g} {self.unit}"


class RelativeErrors(NamedTuple):
    """Relative pose errors (RPE).

    Attributes:
        delta: step from one pose of a pair to the other.
        pairs: number of pairs.
        translation: of the distances [m].
        rotation: of the angles [rad].
    """

    delta: RelativeDelta
    pairs: int
    translation: Statistics
    rotation: Statistics


class TrackErrors(NamedTuple):
    """Errors of an estimated track.

    Attributes:
        poses: number of poses compared.
        x: along the map's x [m].
        y: along its y [m].
        yaw: of the yaw [rad]; NaN if truth has none.
        position: of the distance [m]: the absolute trajectory error (ATE).
    """

    poses: int
    x: Statistics
    y: Statistics
    yaw: Statistics
    position: Statistics


def statistics(errors: FloatArray) -> Statistics:
    """Return the sizes of the errors `(n,)` that are known."""
    known = np.abs(errors[np.isfinite(errors)])
    if not len(known):
        return Statistics(math.nan, math.nan, math.nan, math.nan)
    return Statistics(
        rmse=float(np.sqrt(np.mean(known**2))),
        mean=float(np.mean(known)),
        median=float(np.median(known)),
        max=float(np.max(known)),
    )


def track_errors(matched: Matched) -> TrackErrors:
    """Return the errors of a track; the position's is evo's APE of the translation part."""
    e = matched.errors()
    return TrackErrors(
        poses=len(e),
        x=statistics(e[:, 0]),
        y=statistics(e[:, 1]),
        yaw=statistics(e[:, 2]),
        position=statistics(np.hypot(e[:, 0], e[:, 1])),
    )


def relative_errors(matched: Matched, delta: RelativeDelta) -> RelativeErrors:
    """Return errors of the motion from one pose to another, of consecutive pairs.

    Of the poses P of the estimate and Q of the truth, E = (Q_i^-1 Q_j)^-1 (P_i^-1 P_j); its
    translation and angle are evo's RPE of translation part and rotation angle (Sturm et al. 2012,
    eq. 1). Pairs are chosen by the estimate, as evo does: each begins where the one before ends.
    NaN where truth has no yaw.
    """
    first, second = _pairs(matched.estimate[:, :2], delta)
    of_estimate, of_truth = (
        _motions(pose[first], pose[second]) for pose in (matched.estimate, matched.truth)
    )
    translation = np.hypot(*(of_estimate - of_truth)[:, :2].T)
    rotation = wrap_angle(of_estimate[:, 2] - of_truth[:, 2])
    return RelativeErrors(delta, len(first), statistics(translation), statistics(rotation))


def parse_delta(text: str) -> RelativeDelta:
    """Return the step that a text such as `1m`, `0.5m` or `10poses` says.

    Raises:
        FnnEkfError: it says none.
    """
    for unit in ("m", "poses"):
        number = text.removesuffix(unit).strip()
        try:
            value = float(number) if number != text else math.nan
        except ValueError:
            continue
        if 0.0 < value < math.inf and (unit == "m" or value.is_integer()):
            return RelativeDelta(value, unit)
    raise FnnEkfError(
        f"--rpe {text}: expected a length such as 1m or 0.5m, or a number of poses such as 10poses"
    )


def _pairs(xy: FloatArray, delta: RelativeDelta) -> tuple[list[int], list[int]]:
    """Return the indices of the first and of the second poses of the pairs."""
    if delta.unit == "poses":
        chosen = list(range(0, len(xy), int(delta.value)))
        return chosen[:-1], chosen[1:]
    chosen, driven = [0], 0.0
    for index, step in enumerate(np.hypot(*np.diff(xy, axis=0).T), start=1):
        driven += float(step)
        if driven >= delta.value:
            chosen.append(index)
            driven = 0.0
    return chosen[:-1], chosen[1:]


def _motions(first: FloatArray, second: FloatArray) -> FloatArray:
    """Return second poses `(n, 3)` as the first ones see them (m, m, rad)."""
    dx, dy = (second - first)[:, :2].T
    c, s = np.cos(first[:, 2]), np.sin(first[:, 2])
    return np.column_stack([c * dx + s * dy, c * dy - s * dx, second[:, 2] - first[:, 2]])
