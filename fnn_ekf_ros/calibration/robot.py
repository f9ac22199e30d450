# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""What a robot would show whose wheels and sensors are wired and sized in some way.

A robot has wheels of sizes rho_l, rho_r [m per count, negative if a counter runs backward], apart
by L, negative if they are swapped. Of it one sees

    a_s = h (rho_r - rho_l) / L     a_d = h (rho_r + rho_l) / L     h = -1: a yaw is clockwise
    b_s = u (rho_r + rho_l) / 2     b_d = u (rho_r - rho_l) / 2     u: units of the fixes a meter

beside the offsets of its yaws and its sensors' delays. `Wiring` has the signs and units, a vector
of `Number`s the rest, all against the configuration.
"""

import math
from enum import IntEnum
from typing import NamedTuple

import numpy as np

from fnn_ekf_ros.calibration.evidence import Evidence
from fnn_ekf_ros.core.angles import wrap_angle
from fnn_ekf_ros.core.arrays import FloatArray


class Number(IntEnum):
    """Numbers of a robot against the configured ones, by their places in a vector.

    Logs of meters per count, of the right wheel's over the left one's, and of the separation;
    offsets [rad]; delays [s].
    """

    SCALE = 0
    RATIO = 1
    SEPARATION = 2
    COMPASS_OFFSET = 3
    FIX_YAW_OFFSET = 4
    COMPASS_DELAY = 5
    FIX_DELAY = 6


UNKNOWN_STD = 1e3
"""Standard deviation of what was not observed [rad]."""


class Wiring(NamedTuple):
    """Signs and units, +1 where they are as configured.

    Attributes:
        left: -1: the left counter runs the other way.
        right: likewise.
        sides: -1: left and right wheel are swapped.
        compass: -1: the compass counts clockwise.
        fix_yaw: -1: the yaw of the fixes does.
        mirror: -1: the fixes are mirrored.
        unit: units of the fixes a meter.
    """

    left: int = 1
    right: int = 1
    sides: int = 1
    compass: int = 1
    fix_yaw: int = 1
    mirror: int = 1
    unit: float = 1.0

    def mistakes(self) -> tuple[str, ...]:
        """Return the names of what is wrong."""
        return tuple(
            name
            for name, wrong in (
                ("left_inverted", self.left < 0),
                ("right_inverted", self.right < 0),
                ("swapped", self.sides < 0),
                ("compass_clockwise", self.compass < 0),
                ("fix_yaw_clockwise", self.fix_yaw < 0),
                ("fixes_mirrored", self.mirror < 0),
                ("fix_unit", self.unit != 1.0),
            )
            if wrong
        )


class Observed(NamedTuple):
    """One group of observed numbers.

    Attributes:
        kind: "compass", "fix_yaw" or "displacement".
        values: `(n,)`.
        precision: `(n, n)` inverse of their covariance.
    """

    kind: str
    values: FloatArray
    precision: FloatArray


def observed_in(evidence: Evidence, meters: float, separation: float) -> list[Observed]:
    """Return the observed numbers, rotations and distances in units of the configured ones."""
    found = []
    unit = np.array([2.0 * meters / separation, 2.0 * meters / separation, 1.0])
    for name, source in (("compass", evidence.compass), ("fix_yaw", evidence.fix_yaw)):
        if source is not None and source.usable:
            fit = source.fit
            found.append(_group(name, fit.coefficients / unit, fit.covariance, unit))
    if evidence.best is not None:
        found.append(_displacement(evidence, meters))
    return found


def _displacement(evidence: Evidence, meters: float) -> Observed:
    """Return b_s, b_d, g and the delay by the best yaw, and g of the other yaw, if there is one.

    Both coefficients of the other sign with g + pi say the same, so the other yaw's g is taken with
    the signs of the best one's.
    """
    best, other = evidence.best, evidence.other
    assert best is not None
    assert best.displacement is not None
    unit = np.array([meters, meters, 1.0, 1.0, 1.0])
    values, covariance = np.zeros(5), np.eye(5) * UNKNOWN_STD**2
    values[:4], covariance[:4, :4] = best.displacement.coefficients, best.displacement.covariance
    if other is not None and other.displacement is not None:
        backward = float(values[:2] @ other.displacement.coefficients[:2]) < 0.0
        values[4] = other.displacement.coefficients[2] + (math.pi if backward else 0.0)
        covariance[4, 4] = other.displacement.covariance[2, 2]
    return _group("displacement", values / unit, covariance, unit)


def _group(kind: str, values: FloatArray, covariance: FloatArray, unit: FloatArray) -> Observed:
    std = np.sqrt(np.diag(covariance))
    correlation = covariance / np.outer(std, std)
    precision = np.linalg.inv(correlation) * np.outer(unit / std, unit / std)
    return Observed(kind, values, np.asarray(precision))


class Direction(NamedTuple):
    """Where the direction of travel comes from.

    Attributes:
        from_compass: whether that is the compass; otherwise it is the yaw of the fixes.
        yaw_share: how much of it is the yaw sensor's rather than the wheels'. Where wheels explain
            the yaw, directions are on their clock, whatever the sensor's stamps are.
        taken_off_s: delay that was taken off the sensor's stamps [s].
    """

    from_compass: bool
    yaw_share: float
    taken_off_s: float

    @property
    def offsets(self) -> tuple[Number, Number]:
        """The offset of this yaw, and that of the other one."""
        pair = (Number.COMPASS_OFFSET, Number.FIX_YAW_OFFSET)
        return pair if self.from_compass else (pair[1], pair[0])

    @property
    def delay(self) -> Number:
        """The delay of its sensor."""
        return Number.COMPASS_DELAY if self.from_compass else Number.FIX_DELAY


def delay_of(kind: str) -> Number:
    """Return the delay of a yaw, "compass" or "fix_yaw"."""
    return Number.COMPASS_DELAY if kind == "compass" else Number.FIX_DELAY


def direction_of(evidence: Evidence) -> Direction:
    """Return where the direction of travel comes from in some evidence."""
    best = evidence.best
    if best is None:
        return Direction(from_compass=True, yaw_share=0.0, taken_off_s=0.0)
    return Direction(
        from_compass=best is evidence.compass,
        yaw_share=1.0 - max(best.fit.explained, 0.0),
        taken_off_s=best.fit.level_delay_s,
    )


def predicted_of(kind: str, x: FloatArray, wirings: FloatArray, direction: Direction) -> FloatArray:
    """Return what robots would show `(h, n)`, in the units of `observed_in`.

    Args:
        kind: of what is observed.
        x: `(h, 7)` `Number`s of each robot.
        wirings: `(h, 7)` the `Wiring` of each.
        direction: where the direction of travel comes from.
    """
    scale, ratio, separation = (x[:, at] for at in Number if at <= Number.SEPARATION)
    of_left, of_right, sides, compass, fix_yaw, mirror, unit = wirings.T
    left, right = of_left * np.exp(scale - 0.5 * ratio), of_right * np.exp(scale + 0.5 * ratio)
    mean, half = 0.5 * (right + left), 0.5 * (right - left)
    if kind != "displacement":
        hand = compass if kind == "compass" else fix_yaw * mirror
        turn = hand * sides * np.exp(-separation)
        return np.stack([turn * half, turn * mean, x[:, delay_of(kind)]], axis=-1)
    own, other = direction.offsets
    late = x[:, direction.delay] - direction.taken_off_s
    delay = x[:, Number.FIX_DELAY] - direction.yaw_share * late
    return np.stack([unit * mean, unit * half, x[:, own], delay, x[:, other]], axis=-1)


def slope_of(kind: str, predicted: FloatArray, direction: Direction) -> FloatArray:
    """Return the derivative `(h, n, 7)` of what robots would show `(h, n)`, by their numbers."""
    one, other = predicted[:, 0], predicted[:, 1]
    slope = np.zeros((*predicted.shape, len(Number)))
    slope[:, 0, Number.SCALE], slope[:, 1, Number.SCALE] = one, other
    slope[:, 0, Number.RATIO], slope[:, 1, Number.RATIO] = 0.5 * other, 0.5 * one
    if kind != "displacement":
        slope[:, 0, Number.SEPARATION], slope[:, 1, Number.SEPARATION] = -one, -other
        slope[:, 2, delay_of(kind)] = 1.0
        return slope
    best, second = direction.offsets
    slope[:, 2, best] = slope[:, 4, second] = slope[:, 3, Number.FIX_DELAY] = 1.0
    slope[:, 3, direction.delay] -= direction.yaw_share
    return slope


def seen_as_observed(
    group: Observed, predicted: FloatArray, slope: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return predictions and their slopes with the signs in which displacements were observed.

    A displacement backward is one forward in a direction turned by pi.
    """
    if group.kind != "displacement":
        return predicted, slope
    backward = predicted[:, :2] @ group.values[:2] < 0.0
    signs = np.where(backward[:, None], _TURNED, 1.0)
    turned = predicted + np.where(backward[:, None], _HALF_TURN, 0.0)
    return turned * signs, slope * signs[..., None]


def difference_of(group: Observed, predicted: FloatArray) -> FloatArray:
    """Return observed minus predicted numbers `(h, n)`, angles the short way round."""
    difference = group.values - predicted
    if group.kind == "displacement":
        difference[:, _ANGLES] = wrap_angle(difference[:, _ANGLES])
    return difference


_ANGLES = [2, 4]
"""Which numbers of a displacement are angles."""
_TURNED = np.array([-1.0, -1.0, 1.0, 1.0, 1.0])
"""Signs of a displacement's numbers where it is told in the opposite direction."""
_HALF_TURN = np.array([0.0, 0.0, math.pi, 0.0, math.pi])
"""By how much its numbers change then [rad]."""
