"""Wheels that go further, or less far, than their counts say: a flat tyre, a wrong radius.

Noise has no direction. A wheel of another size has one: compass and fixes correct the filter the
same way again and again, in proportion to how far the wheel went, although no correction is large.
So from what the filter was corrected by in the last `LOOK_BACK_S` the parts g are estimated by
which the wheels go less far than they count, by least squares:

    turn's correction = (g_left l - g_right r) / L        l, r: ways that the wheels counted
    way's correction = -(g_left l + g_right r) / 2        L: distance between the wheels

An offset of compass or fixes corrects the filter once: so each half of the time has to show the
sizes by itself. A compass that is late corrects the turn in curves, and fixes that are late the
way: so the turn has to show them, and the way has to confirm it. (Two wheels that are off alike
look like late fixes on a straight way, and are not told.) What the corrections are held against is
the wheels' noise at the begin of that time: what was learned since may be the lean itself.

| sizes are wrong from | |
| --- | --- |
| 5 standard deviations on | of the corrections of 18 s, of way and turn together |
| 3 standard deviations on | of each half, and of the turn alone, which says no more than both |
| 5 % on | of a wheel's way |
"""

import math
from typing import NamedTuple

import numpy as np

from fnn_ekf_ros.core.arrays import FloatArray
from fnn_ekf_ros.core.pace import NOMINAL_PERIOD_S

LOOK_BACK_S = 18.0
"""So long is looked back [s]: a fault shows within the time in which it has to be named."""
SIGMAS = 5.0
"""So clear the sizes have to be: right wheels are accused once in 300 000 looks."""
PART_SIGMAS = 3.0
"""So clear in each half of the time, as what happened once is in one of them, and by the turn."""
SMALLEST_PART = 0.05
"""So much of its way a wheel has to be off: less is for who calibrates the wheels."""
LIKELY_PART = 1.0
"""Std of g before anything is seen: a wheel that did not turn has the size it should have."""


class Step(NamedTuple):
    """A period, or short ones together: how far the wheels went, by how much the filter was moved.

    Attributes:
        stamp_ns: its end [ns].
        way: that the wheels counted [m].
        turn: likewise [rad].
        way_correction: by which measurements moved the filter ahead [m].
        turn_correction: by which they turned it [rad].
        way_noise: variance that the wheels' way was believed to have [m^2].
        turn_noise: likewise of their turn [rad^2].
        position_variance: of the filter, the larger one [m^2].
        yaw_variance: likewise [rad^2].
    """

    stamp_ns: int
    way: float
    turn: float
    way_correction: float
    turn_correction: float
    way_noise: float
    turn_noise: float
    position_variance: float
    yaw_variance: float


class Sizes(NamedTuple):
    """What the corrections say about the wheels.

    Attributes:
        left: the part by which the left wheel goes less far than it counts; negative: further.
        right: likewise.
        sigmas: how clear it is that not both are 0.
        half_sigmas: the same of that half of the time that says it less clearly.
        turn_sigmas: the same of the corrections of the turn alone.
    """

    left: float
    right: float
    sigmas: float
    half_sigmas: float
    turn_sigmas: float

    @property
    def wrong(self) -> bool:
        """Whether a wheel is not as large as it should be."""
        return (
            self.sigmas >= max(SIGMAS, self.turn_sigmas)
            and min(self.half_sigmas, self.turn_sigmas) >= PART_SIGMAS
            and max(abs(self.left), abs(self.right)) >= SMALLEST_PART
        )


def recent(steps: tuple[Step, ...], step: Step) -> tuple[Step, ...]:
    """Return the steps with one more, without those that are no longer looked back at.

    Periods shorter than the nominal one count together as one step.
    """
    if len(steps) > 1 and _seconds(steps[-2], step) <= NOMINAL_PERIOD_S:
        steps, step = steps[:-1], _together(steps[-1], step)
    old = 0
    while old < len(steps) and _seconds(steps[old], step) >= LOOK_BACK_S:
        old += 1
    return (*steps[max(old - 1, 0) :], step)


def _together(one: Step, other: Step) -> Step:
    """Return two steps, one after the other, as one."""
    return other._replace(
        way=one.way + other.way,
        turn=one.turn + other.turn,
        way_correction=one.way_correction + other.way_correction,
        turn_correction=one.turn_correction + other.turn_correction,
        way_noise=one.way_noise + other.way_noise,
        turn_noise=one.turn_noise + other.turn_noise,
    )


def seen_sizes(steps: tuple[Step, ...], wheel_separation: float) -> Sizes | None:
    """Return what the corrections say; None if they do not reach far enough back.

    Args:
        steps: as `recent` gives them.
        wheel_separation: L [m].
    """
    if len(steps) < 2 or _seconds(steps[0], steps[-1]) < LOOK_BACK_S:
        return None
    first, last, count = steps[0], steps[-1], len(steps)
    # What the pose is off by at begin and end is corrected, too: it is spread over all steps.
    way_noise = first.way_noise + (first.position_variance + last.position_variance) / count
    turn_noise = first.turn_noise + (first.yaw_variance + last.yaw_variance) / count
    if not (way_noise > 0.0 and turn_noise > 0.0):
        return None
    way, turn = (np.array([step[index] for step in steps]) for index in (1, 2))
    left, right = way - 0.5 * wheel_separation * turn, way + 0.5 * wheel_separation * turn
    of_turn = np.stack([left, -right], axis=-1) / (wheel_separation * math.sqrt(turn_noise))
    of_way = -0.5 * np.stack([left, right], axis=-1) / math.sqrt(way_noise)
    turned = np.array([step.turn_correction for step in steps]) / math.sqrt(turn_noise)
    moved = np.array([step.way_correction for step in steps]) / math.sqrt(way_noise)

    both = np.concatenate([of_turn, of_way]), np.concatenate([turned, moved])
    parts, sigmas = _fit(*both)
    half = np.arange(count) < count // 2
    halves = [
        _along(parts, np.concatenate([of_turn[part], of_way[part]]),
               np.concatenate([turned[part], moved[part]]))
        for part in (half, ~half)
    ]  # fmt: skip
    return Sizes(float(parts[0]), float(parts[1]), sigmas, min(halves), _fit(of_turn, turned)[1])


def in_words(sizes: Sizes) -> str:
    """Return what is wrong with the wheels."""
    said = [
        f"the {name} wheel goes {abs(part):.0%} {'less' if part > 0.0 else 'more'} than it counts"
        for name, part in (("left", sizes.left), ("right", sizes.right))
        if abs(part) >= SMALLEST_PART
    ]
    return " and ".join(said)


def _fit(rows: FloatArray, values: FloatArray) -> tuple[FloatArray, float]:
    """Return the parts `(2,)` that explain the values best, and how clearly they are not 0."""
    weighed = rows.T @ values
    precision = rows.T @ rows + np.eye(2) / LIKELY_PART**2
    parts = np.asarray(np.linalg.solve(precision, weighed), dtype=np.float64)
    return parts, math.sqrt(max(float(weighed @ parts), 0.0))


def _along(parts: FloatArray, rows: FloatArray, values: FloatArray) -> float:
    """Return how clearly the values lean as `parts` have it, in standard deviations."""
    expected = rows @ parts
    length = float(np.linalg.norm(expected))
    return float(expected @ values) / length if length > 0.0 else 0.0


def _seconds(begin: Step, end: Step) -> float:
    return (end.stamp_ns - begin.stamp_ns) * 1e-9
