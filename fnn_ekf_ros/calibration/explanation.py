# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The simplest mistakes that explain what the readings say.

The readings give rotation and distance per count, yaw offsets and delays, each with its covariance
(`Evidence`). A robot predicts them from the sizes of its wheels rho_l, rho_r [m per count, negative
if a counter runs backward], their separation L, negative if they are swapped, and its sensors:

    a_s = h (rho_r - rho_l) / L     a_d = h (rho_r + rho_l) / L     h = -1: a yaw is clockwise
    b_s = u (rho_r + rho_l) / 2     b_d = u (rho_r - rho_l) / 2     u: units of the fixes a meter

A hypothesis says what is wrong: signs and units (`Wiring`), and which numbers differ from the
configured ones. Numbers that are not wrong may differ by what calibration leaves (`SPIKE_STD`).
Each mistake costs log odds, and the hypothesis of highest posterior wins: one that explains
everything by one mistake beats one with two. The values are those of the winning wiring with all
numbers free.
"""

import itertools
import math
from typing import NamedTuple

import numpy as np

from fnn_ekf_ros.calibration.evidence import Evidence
from fnn_ekf_ros.core.arrays import FloatArray

NUMBERS = ("scale", "ratio", "separation", "compass_offset", "fix_yaw_offset", "compass_delay",
           "fix_delay")  # fmt: skip
"""Numbers of a robot, against the configuration: log of meters per count, log of the right wheel's
over the left one's, log of the separation [none]; offsets [rad]; delays [s]."""
SPIKE_STD = np.array([0.01, 0.003, 0.015, 0.03, 0.03, 0.03, 0.03])
"""What calibration leaves of each number that is not wrong, as a standard deviation."""
SLAB_STD = np.array([4.0, 1.0, 4.0, 2.0, 2.0, 0.5, 0.5])
"""Standard deviation of each number that is wrong."""
COST = {
    "scale": 3.0, "ratio": 3.0, "left_wheel": 3.5, "right_wheel": 3.5, "separation": 3.0,
    "compass_offset": 3.0, "fix_yaw_offset": 3.0, "compass_delay": 3.0, "fix_delay": 3.0,
    "left_inverted": 8.0, "right_inverted": 8.0, "swapped": 10.0, "compass_clockwise": 8.0,
    "fix_yaw_clockwise": 12.0, "fixes_mirrored": 12.0, "fix_unit": 9.0,
}  # fmt: skip
"""Log odds that each mistake costs [nats]: a number has to explain 6 in chi square."""
PRUNED_BELOW = 30.0
"""Log posterior below the best one, with all numbers free, from which on a wiring is left out."""
UNKNOWN_STD = 1e3
"""Standard deviation of what was not observed [rad]."""
FIX_UNITS = (1000.0, 100.0)
"""Units of the fixes a meter, if they are not meters: millimeters, centimeters."""
BOTH_INVERTED = -6.0
"""Log odds that both counters together cost in addition [nats]: a robot that drives backward by
both is also one with swapped wheels whose yaw is off by pi, but that would be two mistakes."""
BACKWARD = 2.0
"""Offset of a yaw from which on it is taken for a sensor that is mounted backward [rad]."""
BACKWARD_COST = 3.0
"""Log odds that such an offset costs in addition [nats]."""
LARGE_ROBOT = math.log(30.0)
"""Factor, as a logarithm, by which no robot is larger than configured: lengths that are given in
another unit than meters are too large, never too small."""
LARGE_ROBOT_COST = 12.0
"""Log odds that such a robot costs [nats]."""


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


class Explanation(NamedTuple):
    """What explains the evidence best.

    Attributes:
        wiring: signs and units.
        wrong: names of the mistakes, of `COST`, with the log odds that each of them has against the
            best explanation without it [nats].
        numbers: `(7,)` `NUMBERS`, all free.
        covariance: `(7, 7)` of these.
    """

    wiring: Wiring
    wrong: dict[str, float]
    numbers: FloatArray
    covariance: FloatArray

    def value(self, name: str) -> float:
        """Return one of the `NUMBERS`."""
        return float(self.numbers[NUMBERS.index(name)])

    def std(self, name: str) -> float:
        """Return its standard error."""
        at = NUMBERS.index(name)
        return math.sqrt(max(float(self.covariance[at, at]), 0.0))


class _Observed(NamedTuple):
    """One group of observed numbers.

    Attributes:
        kind: "compass", "fix_yaw" or "displacement".
        values: `(n,)`.
        precision: `(n, n)` inverse of their covariance.
    """

    kind: str
    values: FloatArray
    precision: FloatArray


_FREE = {
    "scale": np.array([1.0, 0.0]),
    "ratio": np.array([0.0, 1.0]),
    "right_wheel": np.array([0.5, 1.0]),
    "left_wheel": np.array([-0.5, 1.0]),
}
"""Directions of scale and ratio that a mistake frees."""


def explain(evidence: Evidence, meters_per_count: float, separation: float) -> Explanation | None:
    """Return the simplest explanation; None if wheels and sensors say nothing of each other.

    Args:
        evidence: of the readings.
        meters_per_count: as configured, of both wheels [m per count].
        separation: as configured, L [m].
    """
    observed = _observed(evidence, meters_per_count, separation)
    if not observed:
        return None
    direction = _direction_of(evidence)
    search = _Search(observed, evidence, direction)
    wirings = _wirings(evidence)
    everything = _loosest(evidence)
    loose = {
        wiring: _score(observed, direction, wiring, everything)[0] - _cost(wiring.mistakes())
        for wiring in wirings
    }
    least = max(loose.values()) - PRUNED_BELOW
    for wiring in wirings:
        if loose[wiring] > least:
            search.climb(wiring)
    (wiring, free), best = max(search.scores.items(), key=lambda scored: scored[1])
    wrong = {name: best - search.best_without(name) for name in (*wiring.mistakes(), *free)}
    delays = (name for name in free if name.endswith("_delay"))
    _, numbers, covariance = _score(observed, direction, wiring, (*everything, *delays))
    return Explanation(wiring, wrong, numbers, covariance)


class _Search:
    """Hypotheses that were tried, with their log posteriors.

    Args:
        observed: what they have to explain.
        evidence: where that comes from.
        direction: where the direction of travel comes from.
    """

    def __init__(
        self, observed: list[_Observed], evidence: Evidence, direction: "_Direction"
    ) -> None:
        self._observed, self._direction = observed, direction
        self._options = _options(evidence)
        self.scores: dict[tuple[Wiring, tuple[str, ...]], float] = {}

    def climb(self, wiring: Wiring) -> None:
        """Try numbers that are wrong with a wiring, one more at a time while that helps."""
        free: tuple[str, ...] = ()
        score = self._tried(wiring, free)
        while True:
            more = [tuple(sorted({*free, option})) for option in self._options
                    if option not in free and _may_join(option, free)]  # fmt: skip
            fewer = [tuple(name for name in free if name != left) for left in free]
            scored = {each: self._tried(wiring, each) for each in (*more, *fewer)}
            best = max(scored, key=scored.__getitem__, default=free)
            if best == free or scored[best] <= score:
                return
            free, score = best, scored[best]

    def best_without(self, name: str) -> float:
        """Return the log posterior of the best hypothesis without a mistake."""
        others = [
            score
            for (wiring, free), score in self.scores.items()
            if not _same_mistake(name, (*wiring.mistakes(), *free))
        ]
        return max(others, default=-math.inf)

    def _tried(self, wiring: Wiring, free: tuple[str, ...]) -> float:
        key = (wiring, free)
        if key not in self.scores:
            score, numbers, _ = _score(self._observed, self._direction, wiring, free)
            large = min(numbers[0], numbers[2]) > LARGE_ROBOT
            backward = np.abs(numbers[[3, 4]]) > BACKWARD
            cost = _cost((*wiring.mistakes(), *free)) + (LARGE_ROBOT_COST if large else 0.0)
            cost += BACKWARD_COST * float(np.sum(backward))
            self.scores[key] = score - cost
        return self.scores[key]


_RATIOS = ("ratio", "left_wheel", "right_wheel")
"""Mistakes of which one at a time explains unequal wheels."""


def _may_join(option: str, free: tuple[str, ...]) -> bool:
    return option not in _RATIOS or not any(name in _RATIOS for name in free)


def _same_mistake(name: str, names: tuple[str, ...]) -> bool:
    return any(name == other or (name in _RATIOS and other in _RATIOS) for other in names)


def _cost(names: tuple[str, ...]) -> float:
    both = BOTH_INVERTED if {"left_inverted", "right_inverted"} <= {*names} else 0.0
    return sum(COST[name] for name in names) + both


def _options(evidence: Evidence) -> list[str]:
    """Return the numbers that the evidence can show to be wrong."""
    found = ["scale", "separation", *_RATIOS]
    if evidence.compass is not None:
        found += ["compass_offset", "compass_delay"]
    if evidence.fix_yaw is not None:
        found.append("fix_yaw_offset")
    if evidence.fix_yaw is not None or evidence.best is not None:
        found.append("fix_delay")
    return found


def _loosest(evidence: Evidence) -> tuple[str, ...]:
    offsets = [
        name
        for name, source in (
            ("compass_offset", evidence.compass),
            ("fix_yaw_offset", evidence.fix_yaw),
        )
        if source is not None
    ]
    return ("scale", "ratio", "separation", *offsets)


def _wirings(evidence: Evidence) -> list[Wiring]:
    units = (1.0, *FIX_UNITS) if evidence.best is not None else (1.0,)
    found = [
        Wiring(left, right, sides, compass, fix_yaw, mirror, unit)
        for left, right, sides, compass, fix_yaw, mirror in itertools.product((1, -1), repeat=6)
        for unit in units
    ]
    return [wiring for wiring in found if _fits_path(wiring, evidence)]


def _fits_path(wiring: Wiring, evidence: Evidence) -> bool:
    """Return whether a wiring has the handedness that the fixes' path shows."""
    for source, sign in (
        (evidence.compass, wiring.compass * wiring.mirror),
        (evidence.fix_yaw, wiring.fix_yaw),
    ):
        if source is None or not source.usable:
            if source is None and sign < 0:
                return False
        elif (source.handedness != 0 and source.handedness != sign) or (
            source.handedness == 0 and sign < 0
        ):
            return False
    return True


def _observed(evidence: Evidence, meters: float, separation: float) -> list[_Observed]:
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


def _displacement(evidence: Evidence, meters: float) -> _Observed:
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


def _group(kind: str, values: FloatArray, covariance: FloatArray, unit: FloatArray) -> _Observed:
    std = np.sqrt(np.diag(covariance))
    correlation = covariance / np.outer(std, std)
    precision = np.linalg.inv(correlation) * np.outer(unit / std, unit / std)
    return _Observed(kind, values, np.asarray(precision))


class _Direction(NamedTuple):
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


def _direction_of(evidence: Evidence) -> _Direction:
    best = evidence.best
    if best is None:
        return _Direction(from_compass=True, yaw_share=0.0, taken_off_s=0.0)
    return _Direction(
        from_compass=best is evidence.compass,
        yaw_share=1.0 - max(best.fit.explained, 0.0),
        taken_off_s=best.fit.level_delay_s,
    )


def _predicted(kind: str, x: FloatArray, wiring: Wiring, direction: _Direction) -> FloatArray:
    """Return what a robot would show, in the units of `_observed`."""
    left = wiring.left * math.exp(x[0] - 0.5 * x[1])
    right = wiring.right * math.exp(x[0] + 0.5 * x[1])
    mean, half = 0.5 * (right + left), 0.5 * (right - left)
    if kind != "displacement":
        hand = wiring.compass if kind == "compass" else wiring.fix_yaw * wiring.mirror
        turn = hand * wiring.sides * math.exp(-x[2])
        return np.array([turn * half, turn * mean, x[5] if kind == "compass" else x[6]])
    own, other = (3, 4) if direction.from_compass else (4, 3)
    late = x[5 if direction.from_compass else 6] - direction.taken_off_s
    return np.array([
        wiring.unit * mean, wiring.unit * half, x[own], x[6] - direction.yaw_share * late, x[other],
    ])  # fmt: skip


def _slope(kind: str, predicted: FloatArray, direction: _Direction) -> FloatArray:
    """Return the derivative `(n, 7)` of what a robot would show, by its numbers."""
    one, other = predicted[:2]
    slope = np.zeros((len(predicted), len(NUMBERS)))
    slope[:2, 0] = one, other
    slope[:2, 1] = 0.5 * other, 0.5 * one
    if kind != "displacement":
        slope[:2, 2] = -one, -other
        slope[2, 5 if kind == "compass" else 6] = 1.0
        return slope
    best, second = (3, 4) if direction.from_compass else (4, 3)
    slope[2, best] = slope[4, second] = slope[3, 6] = 1.0
    slope[3, 5 if direction.from_compass else 6] -= direction.yaw_share
    return slope


def _seen_as_observed(
    group: _Observed, predicted: FloatArray, slope: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return a prediction and its slope with the signs in which displacements were observed.

    A displacement backward is one forward in a direction turned by pi.
    """
    if group.kind != "displacement" or group.values[:2] @ predicted[:2] >= 0.0:
        return predicted, slope
    turned, signs = predicted.copy(), np.array([-1.0, -1.0, 1.0, 1.0, 1.0])
    turned[_ANGLES] += math.pi
    return turned * signs, slope * signs[:, None]


def _difference(group: _Observed, predicted: FloatArray) -> FloatArray:
    """Return observed minus predicted numbers, angles the short way round."""
    difference = group.values - predicted
    if group.kind == "displacement":
        difference[_ANGLES] = [math.remainder(each, 2.0 * math.pi) for each in difference[_ANGLES]]
    return difference


_ANGLES = [2, 4]
"""Which numbers of a displacement are angles."""


def _prior(free: tuple[str, ...]) -> FloatArray:
    """Return the inverse covariance `(7, 7)` of the numbers before the readings."""
    covariance = np.diag(SPIKE_STD**2)
    for name in free:
        if name in _FREE:
            slab = SLAB_STD[0] if name == "scale" else SLAB_STD[1]
            covariance[:2, :2] += slab**2 * np.outer(_FREE[name], _FREE[name])
        else:
            at = NUMBERS.index("fix_delay" if name == "fix_delay" else name)
            covariance[at, at] = SLAB_STD[at] ** 2
    return np.linalg.inv(covariance)


def _score(
    observed: list[_Observed], direction: _Direction, wiring: Wiring, free: tuple[str, ...]
) -> tuple[float, FloatArray, FloatArray]:
    """Return log posterior, numbers and their covariance by Gauss-Newton."""
    prior = _prior(free)
    x = _start(observed, wiring, free)
    damping, last = 1e-3, math.inf
    precision = prior
    for _ in range(12):
        normal, gradient, cost = prior.copy(), prior @ x, float(x @ prior @ x)
        for group in observed:
            predicted = _predicted(group.kind, x, wiring, direction)
            slope = _slope(group.kind, predicted, direction)
            predicted, slope = _seen_as_observed(group, predicted, slope)
            left = _difference(group, predicted)
            normal += slope.T @ group.precision @ slope
            gradient -= slope.T @ group.precision @ left
            cost += float(left @ group.precision @ left)
        precision = normal
        step = np.linalg.solve(normal + damping * np.diag(np.diag(normal)), -gradient)
        if abs(last - cost) < 1e-6 * (1.0 + cost):
            break
        last = cost
        x = x + np.clip(step, -1.0, 1.0)
    return -0.5 * cost, x, np.asarray(np.linalg.inv(precision))


def _start(observed: list[_Observed], wiring: Wiring, free: tuple[str, ...]) -> FloatArray:
    x = np.zeros(len(NUMBERS))
    rotation = distance = None
    for group in observed:
        if group.kind in ("compass", "fix_yaw") and rotation is None:
            rotation = float(np.hypot(*group.values[:2]))
        if group.kind == "displacement":
            distance = float(np.hypot(*group.values[:2])) / wiring.unit
    if "scale" in free and distance:
        x[0] = math.log(distance)
    elif "scale" in free and rotation:
        x[0] = math.log(rotation)
    if "separation" in free and rotation:
        x[2] = x[0] - math.log(rotation)
    return x
