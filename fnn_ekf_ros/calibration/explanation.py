# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The simplest mistakes that explain what the readings say.

The readings give rotation and distance per count, yaw offsets and delays, each with its covariance
(`Evidence`); a robot that is wired and sized in some way would show others (`robot`).

A hypothesis says what is wrong: signs and units (`Wiring`), and which numbers differ from the
configured ones. Numbers that are not wrong may differ by what calibration leaves (`SPIKE_STD`).
Each mistake costs log odds, and the hypothesis of highest posterior wins: one that explains
everything by one mistake beats one with two. The values are those of the winning wiring with all
numbers free.
"""

import itertools
import math
from collections.abc import Sequence
from functools import cache
from typing import NamedTuple

import numpy as np

from fnn_ekf_ros.calibration.evidence import Evidence
from fnn_ekf_ros.calibration.robot import (
    Direction,
    Number,
    Observed,
    Wiring,
    difference_of,
    direction_of,
    observed_in,
    predicted_of,
    seen_as_observed,
    slope_of,
)
from fnn_ekf_ros.core.arrays import FloatArray

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


AS_CONFIGURED = Wiring()
"""Signs and units of a robot without a mistake."""
CHEAPEST = min(COST.values())
"""Log odds that an explanation with a mistake costs at least [nats]."""


Hypothesis = tuple[Wiring, tuple[str, ...]]
"""Signs and units, and the names of the numbers that differ from the configured ones."""


class Explanation(NamedTuple):
    """What explains the evidence best.

    Attributes:
        wiring: signs and units.
        free: numbers that differ from the configured ones.
        wrong: names of the mistakes, of `COST`, with the log odds that each of them has against the
            best explanation without it [nats].
        numbers: `(7,)` `Number`s, all free.
        covariance: `(7, 7)` of these.
    """

    wiring: Wiring
    free: tuple[str, ...]
    wrong: dict[str, float]
    numbers: FloatArray
    covariance: FloatArray

    def value(self, name: str) -> float:
        """Return one of the `Number`s."""
        return float(self.numbers[Number[name.upper()]])

    def std(self, name: str) -> float:
        """Return its standard error."""
        at = Number[name.upper()]
        return math.sqrt(max(float(self.covariance[at, at]), 0.0))


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
    observed = observed_in(evidence, meters_per_count, separation)
    if not observed:
        return None
    direction = direction_of(evidence)
    search = _Search(observed, evidence, direction)
    wirings = _wirings(evidence)
    everything = _loosest(evidence)
    scored = _scored(observed, direction, [(wiring, everything) for wiring in wirings])
    loose = {
        wiring: score - _cost(wiring.mistakes())
        for wiring, score in zip(wirings, scored.scores.tolist(), strict=True)
    }
    least = max(loose.values()) - PRUNED_BELOW
    search.climb([wiring for wiring in wirings if loose[wiring] > least])
    (wiring, free), best = max(search.scores.items(), key=lambda scored: scored[1])
    wrong = {name: best - search.best_without(name) for name in (*wiring.mistakes(), *free)}
    delays = (name for name in free if name.endswith("_delay"))
    all_free = _scored(observed, direction, [(wiring, (*everything, *delays))])
    return Explanation(wiring, free, wrong, all_free.numbers[0], all_free.covariances[0])


def fit_of(
    evidence: Evidence,
    meters_per_count: float,
    separation: float,
    wiring: Wiring = AS_CONFIGURED,
    free: tuple[str, ...] = (),
) -> float:
    """Return the log likelihood of a hypothesis with its likeliest numbers [nats], 0 at best.

    Args:
        evidence: of the readings.
        meters_per_count: as configured, of both wheels [m per count].
        separation: as configured, L [m].
        wiring: signs and units.
        free: numbers that differ from the configured ones.
    """
    if not _fits_path(wiring, evidence):
        return -math.inf
    observed = observed_in(evidence, meters_per_count, separation)
    if not observed:
        return 0.0
    return float(_scored(observed, direction_of(evidence), [(wiring, free)]).scores[0])


class _Search:
    """Hypotheses that were tried, with their log posteriors.

    Args:
        observed: what they have to explain.
        evidence: where that comes from.
        direction: where the direction of travel comes from.
    """

    def __init__(
        self, observed: list[Observed], evidence: Evidence, direction: "Direction"
    ) -> None:
        self._observed, self._direction = observed, direction
        self._options = _options(evidence)
        self.scores: dict[Hypothesis, float] = {}

    def climb(self, wirings: Sequence[Wiring]) -> None:
        """Try numbers that are wrong with wirings, one more at a time while that helps."""
        nothing: list[Hypothesis] = [(wiring, ()) for wiring in wirings]
        best = self._tried(nothing)
        while best:
            steps = {each: [(each[0], free) for free in self._next(each[1])] for each in best}
            self._tried([other for others in steps.values() for other in others])
            climbed = {}
            for each, score in best.items():
                other = max(steps[each], key=self.scores.__getitem__)
                if self.scores[other] > score:
                    climbed[other] = self.scores[other]
            best = climbed

    def _next(self, free: tuple[str, ...]) -> list[tuple[str, ...]]:
        """Return the sets of numbers with one more or one fewer."""
        more = [tuple(sorted({*free, option})) for option in self._options
                if option not in free and _may_join(option, free)]  # fmt: skip
        return more + [tuple(name for name in free if name != left) for left in free]

    def best_without(self, name: str) -> float:
        """Return the log posterior of the best hypothesis without a mistake."""
        others = [
            score
            for (wiring, free), score in self.scores.items()
            if not _same_mistake(name, (*wiring.mistakes(), *free))
        ]
        return max(others, default=-math.inf)

    def _tried(self, hypotheses: Sequence[Hypothesis]) -> dict[Hypothesis, float]:
        """Return the log posteriors of hypotheses."""
        new = [each for each in dict.fromkeys(hypotheses) if each not in self.scores]
        if new:
            scored = _scored(self._observed, self._direction, new)
            for hypothesis, score, numbers in zip(
                new, scored.scores.tolist(), scored.numbers, strict=True
            ):
                self.scores[hypothesis] = score - _posterior_cost(hypothesis, numbers)
        return {each: self.scores[each] for each in hypotheses}


def _posterior_cost(hypothesis: Hypothesis, numbers: FloatArray) -> float:
    """Return the log odds that a hypothesis costs with its likeliest numbers `(7,)` [nats]."""
    wiring, free = hypothesis
    large = min(numbers[Number.SCALE], numbers[Number.SEPARATION]) > LARGE_ROBOT
    backward = np.abs(numbers[[Number.COMPASS_OFFSET, Number.FIX_YAW_OFFSET]]) > BACKWARD
    cost = _cost((*wiring.mistakes(), *free)) + (LARGE_ROBOT_COST if large else 0.0)
    return cost + BACKWARD_COST * float(np.sum(backward))


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


@cache
def _prior(free: tuple[str, ...]) -> FloatArray:
    """Return the inverse covariance `(7, 7)` of the numbers before the readings."""
    covariance = np.diag(SPIKE_STD**2)
    for name in free:
        if name in _FREE:
            slab = SLAB_STD[0] if name == "scale" else SLAB_STD[1]
            covariance[:2, :2] += slab**2 * np.outer(_FREE[name], _FREE[name])
        else:
            at = Number[name.upper()]
            covariance[at, at] = SLAB_STD[at] ** 2
    return np.linalg.inv(covariance)


class _Scored(NamedTuple):
    """Hypotheses with their likeliest numbers.

    Attributes:
        scores: `(h,)` log likelihood with the numbers' prior, without costs [nats].
        numbers: `(h, 7)`.
        covariances: `(h, 7, 7)` of these.
    """

    scores: FloatArray
    numbers: FloatArray
    covariances: FloatArray


def _scored(
    observed: list[Observed], direction: Direction, hypotheses: Sequence[Hypothesis]
) -> _Scored:
    """Return hypotheses with their likeliest numbers, by Gauss-Newton for all of them at once."""
    wirings = np.array([wiring for wiring, _ in hypotheses], dtype=np.float64)
    prior = np.stack([_prior(free) for _, free in hypotheses])
    x = np.stack([_start(observed, wiring, free) for wiring, free in hypotheses])
    damping, last = 1e-3, np.full(len(x), math.inf)
    diagonal = np.arange(x.shape[1])
    for _ in range(12):
        normal, gradient = prior.copy(), np.einsum("hij,hj->hi", prior, x)
        cost = np.einsum("hi,hi->h", gradient, x)
        for group in observed:
            predicted = predicted_of(group.kind, x, wirings, direction)
            slope = slope_of(group.kind, predicted, direction)
            predicted, slope = seen_as_observed(group, predicted, slope)
            left = difference_of(group, predicted)
            weighed = np.swapaxes(slope, 1, 2) @ group.precision
            normal += weighed @ slope
            gradient -= np.einsum("hin,hn->hi", weighed, left)
            cost += np.einsum("hn,hn->h", left @ group.precision, left)
        moving = np.abs(last - cost) >= 1e-6 * (1.0 + cost)
        if not moving.any():
            break
        damped = normal.copy()
        damped[:, diagonal, diagonal] *= 1.0 + damping
        step = np.linalg.solve(damped, -gradient[..., None])[..., 0]
        last = cost
        x = x + np.clip(np.where(moving[:, None], step, 0.0), -1.0, 1.0)
    return _Scored(-0.5 * cost, x, np.asarray(np.linalg.inv(normal)))


def _start(observed: list[Observed], wiring: Wiring, free: tuple[str, ...]) -> FloatArray:
    x = np.zeros(len(Number))
    rotation = distance = None
    for group in observed:
        if group.kind in ("compass", "fix_yaw") and rotation is None:
            rotation = float(np.hypot(*group.values[:2]))
        if group.kind == "displacement":
            distance = float(np.hypot(*group.values[:2])) / wiring.unit
    if "scale" in free and distance:
        x[Number.SCALE] = math.log(distance)
    elif "scale" in free and rotation:
        x[Number.SCALE] = math.log(rotation)
    if "separation" in free and rotation:
        x[Number.SEPARATION] = x[Number.SCALE] - math.log(rotation)
    return x
