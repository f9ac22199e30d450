# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The examination of a robot while it drives: readings in, findings as long as they hold."""

import math
from collections.abc import Generator, Mapping, Sequence
from typing import Any, TypeVar

import numpy as np

from fnn_ekf_ros.calibration.block_sums import LONGEST_STEP_S
from fnn_ekf_ros.calibration.evidence import Evidence, YawSource
from fnn_ekf_ros.calibration.examination import (
    FEWEST_COUNTS,
    FEWEST_WHEEL_READINGS,
    GROSS,
    SIZES,
    STILL_RAD,
    is_small,
    meters_per_count,
    random_compass,
    told_findings,
)
from fnn_ekf_ros.calibration.explanation import CHEAPEST, Explanation, explain, fit_of
from fnn_ekf_ros.calibration.findings import (
    CERTAIN_ODDS,
    NUMBER_ODDS,
    UNTOLD,
    Certainty,
    Finding,
    in_order,
)
from fnn_ekf_ros.calibration.geometry_findings import (
    LEAST_DELAY_S,
    SLOWEST_WHEELS_S,
    Context,
    compass_unit,
)
from fnn_ekf_ros.calibration.reading_buffers import Buffers
from fnn_ekf_ros.calibration.rotation import EXPLAINED
from fnn_ekf_ros.calibration.travel import usual_interval, wheel_travel
from fnn_ekf_ros.calibration.two_yaws import delay_alone, of_one_slip
from fnn_ekf_ros.calibration.yaw_blocks import BLOCK_S, MARGIN_S, Segment, YawBlocks

WAIT_S = 0.5
"""Time for which readings of a block are waited for [s]."""
FEWEST_BLOCKS = 4
"""Number of blocks of driving from which on something is found."""
RECENT_BLOCKS = 6
"""Number of the newest blocks that can contradict a finding."""
OVER_GAIN = 0.5
"""Log likelihood that a finding gains on these blocks below which it is over [nats]: a number that
is right gains half a nat by chance."""
EACH_BLOCKS, JUDGED_BLOCKS = 7, 3
"""Number of blocks up to which each one is followed by a judgment, the first minute, and of how
many one is later: what is known changes slowly, and a judgment costs as much as ten blocks."""
LEAST_MISFIT = CHEAPEST + NUMBER_ODDS + CERTAIN_ODDS
"""Log likelihood that the configuration has to lack for an explanation to be looked for [nats]:
with less no number can be certain."""
RENEWED_BLOCKS = 6
"""Number of blocks after which findings that stand are made anew, with better numbers."""
LASTING_GAIN = 2.0
"""Log likelihood by which a finding has to explain each half of the blocks better than the
configuration does [nats]: what begins while driving is a fault, not a mistake."""
LEAST_TOLD_DELAY_S = LEAST_DELAY_S + 0.15
"""Delay that has to be exceeded significantly [s]: a robot that is steered by its true position
seems to be late by up to 0.15 s."""
ROTATIONS = ("wheel_separation", "wheel_ratio")
"""Findings about sizes that follow from rotations."""
YAW_EXPLAINED = 0.7
"""Share of a yaw's changes that wheels have to explain for sizes to be told that are not off by
much: where they explain less, instruments are weak, and standard errors are too small."""
PATH_EXPLAINED = 0.6
"""Share of the fixes' changes that wheels and yaw have to explain for their delay to be told: less
than of a yaw's changes, because paths are compared without instruments."""
LARGEST_TOLD_DELAY_S = 1.0
"""Largest delay that is told [s]: errors that last lead to the ends of what is looked for."""
DELAYS = {"compass_delay", "fix_delay"}
"""Findings about delays."""
LONGEST_SILENCE_S = 10.0 * BLOCK_S
"""Time without a look at the clock after which blocks begin anew [s]."""

_OVER = object()
"""What `next` gives where work is over."""

T = TypeVar("T")
Parts = Generator[None, None, T]
"""Work that is done in parts, each of some milliseconds, and its result."""


class RunningExamination:
    """Examines a robot while it drives.

    Args:
        configured: parameters of the localizer, by name.
    """

    def __init__(self, configured: Mapping[str, Any]) -> None:
        self._configured = configured
        self._meters = meters_per_count(configured)
        self._separation = float(configured["wheel_separation"])
        expected = np.array([0.0, 2.0 * self._meters / self._separation])
        self._still = FEWEST_COUNTS if configured["encoder_source"] == "ticks" else STILL_RAD
        self._buffers = Buffers()
        self._compass, self._fix_yaw = YawBlocks(expected), YawBlocks(expected)
        self._used = [self._compass, self._fix_yaw]
        if not configured["lrf_use_yaw"]:
            self._used.pop()
        self._begin_s: float | None = None
        self._interval_s = math.nan
        self._explanation: Explanation | None = None
        self._seen = self._renewed_at = self._driven = 0
        self.examined = False
        """Whether the robot drove for long enough to judge it by each sensor that it has."""
        self._work: Parts[None] | None = None
        self.findings: tuple[Finding, ...] = ()

    def wheel(self, side: str, time_s: float, counts: float) -> None:
        """Take counts of a wheel in.

        Args:
            side: left or right.
            time_s: stamp [s].
            counts: unwrapped, positive forward by the configuration [counts or rad].
        """
        factor = float(self._configured[f"{side}_wheel_radius_multiplier"])
        self._buffers.add(side, (time_s, factor * counts))

    def compass(self, time_s: float, yaw: float) -> None:
        """Take a reading of the compass in, as the localizer uses it [s, rad]."""
        self._buffers.add("compass", (time_s, yaw))

    def fix(self, time_s: float, x: float, y: float, yaw: float) -> None:
        """Take a fix in, as the localizer would use it [s, m, m, rad].

        Of a yaw that is not used only its delay is evidence, where it is that of the positions.
        """
        self._buffers.add("fixes", (time_s, x, y, yaw))

    def advance(self, now_s: float) -> None:
        """Go on with the blocks that are over at an instant [s].

        Only a part of the work on a block is done in a call: no period of a node may take the time
        of all of it.
        """
        if self._begin_s is None or now_s - self._begin_s > LONGEST_SILENCE_S:
            self._begin_s, self._work = now_s, None
            return
        if self._work is None and now_s >= self._begin_s + BLOCK_S + MARGIN_S + WAIT_S:
            self._work = self._look_at(self._begin_s, self._begin_s + BLOCK_S)
            self._begin_s += BLOCK_S
        if self._work is None:
            return
        try:
            with np.errstate(over="raise", divide="raise", invalid="raise"):
                is_over = next(self._work, _OVER) is _OVER
        except (ArithmeticError, np.linalg.LinAlgError):  # numbers of no robot
            self._forget_all_but(0)
            self._driven = 0
            is_over = True
        if is_over:
            self._work = None
            begun = any(map(self._has_begun, self._used))
            self.examined = self._driven >= FEWEST_BLOCKS and not begun

    def _has_begun(self, blocks: YawBlocks) -> bool:
        """Return whether a sensor has readings in too few blocks yet, the last of them included."""
        few = 0 < len(blocks) < FEWEST_BLOCKS
        return few and blocks.numbers[-1] > self._seen - FEWEST_BLOCKS

    def _look_at(self, begin_s: float, end_s: float) -> Parts[None]:
        """Take a block in, and find out what is wrong after it."""
        segment = self._segment(begin_s, end_s)
        self._buffers.forget_before(end_s - MARGIN_S - LONGEST_STEP_S)
        if segment is None:
            return
        fixes = segment.inside(segment.fixes)
        if len(fixes) and float(np.max(np.ptp(fixes[:, 1:3], axis=0))) < 0.01:
            fixes = fixes[:0]
        self._seen += 1
        self._compass.add(segment, segment.compass, fixes)
        yield
        with_yaw = segment.fixes[np.isfinite(segment.fixes[:, 3])]
        self._fix_yaw.add(segment, with_yaw[:, [0, 3]], fixes)
        yield from self._judged()

    def _forget_all_but(self, blocks: int) -> None:
        """Forget findings, and the oldest blocks."""
        self.findings = ()
        self._explanation = None
        self._compass.forget_all_but(blocks)
        self._fix_yaw.forget_all_but(blocks)

    def _segment(self, begin_s: float, end_s: float) -> Segment | None:
        """Return the readings of a block; None if the robot did not move in it."""
        left, right = self._buffers.table("left", 2), self._buffers.table("right", 2)
        if min(len(left), len(right)) < 2 or np.ptp(left, 0)[1] + np.ptp(right, 0)[1] < self._still:
            return None
        self._driven += 1
        self._interval_s = usual_interval(left[:, 0], right[:, 0])
        if min(len(left), len(right)) < FEWEST_WHEEL_READINGS // 2:
            return None
        travel = wheel_travel(left, right)
        if len(travel.times) < FEWEST_WHEEL_READINGS // 2 or self._interval_s > SLOWEST_WHEELS_S:
            return None
        compass, fixes = self._buffers.table("compass", 2), self._buffers.table("fixes", 4)
        return Segment(
            self._seen + 1, begin_s, end_s, travel,
            compass[travel.covers(compass[:, 0])], fixes[travel.covers(fixes[:, 0])],
        )  # fmt: skip

    @property
    def kept(self) -> tuple[int, int]:
        """Numbers of blocks and of readings that are kept."""
        return max(len(self._compass), len(self._fix_yaw)), self._buffers.count

    def evidence(self, which: range | None = None) -> Evidence:
        """Return what blocks with some numbers say; None: all of them."""
        compass, random = self._compass.source(which)
        return self._together(compass, random, self._fix_yaw.source(which)[0])

    def _together(
        self, compass: YawSource | None, random: bool, fix_yaw: YawSource | None
    ) -> Evidence:
        if compass is None or fix_yaw is None:
            return Evidence(compass, fix_yaw if self._fix_yaw in self._used else None, random)
        if self._fix_yaw in self._used:
            return Evidence(of_one_slip(compass), of_one_slip(fix_yaw), random)
        return Evidence(compass, delay_alone(fix_yaw, compass), random)

    def _numbers(self) -> list[int]:
        """Return the numbers of the blocks in which all used sensors have readings.

        If there are too few of them, those of the blocks in which any used sensor has readings.
        """
        numbers = [set(blocks.numbers) for blocks in self._used]
        each = set.intersection(*numbers)
        return sorted(each if len(each) >= FEWEST_BLOCKS else set.union(*numbers))

    def _judged(self) -> Parts[None]:
        """Find out what is wrong after a block."""
        blocks = max(map(len, self._used))
        later = self._seen > EACH_BLOCKS and self._seen % JUDGED_BLOCKS
        if blocks < FEWEST_BLOCKS or later:
            return
        if self.findings:
            yield
            if self._is_over():
                self._forget_all_but(RECENT_BLOCKS)
                return
            if self._seen < self._renewed_at:
                return
        yield
        found, explanation = yield from self._found(BLOCK_S * blocks)
        if found:
            self.findings, self._explanation = found, explanation
            self._renewed_at = self._seen + RENEWED_BLOCKS

    def _found(self, long_s: float) -> Parts[tuple[tuple[Finding, ...], Explanation | None]]:
        """Return what is wrong by all blocks and by each half of them, and what explains it.

        No explanation is needed for a yaw that is random or in another unit.
        """
        compass, random = self._compass.source()
        yield
        evidence = self._together(compass, random, self._fix_yaw.source()[0])
        if evidence.random_compass:
            for half in _halves(self._compass.numbers):
                yield
                if not self._compass.source(half)[1]:
                    return (), None
            return (random_compass(),), None
        unit = yield from self._lasting_unit(evidence)
        if self._fit(evidence) > -LEAST_MISFIT:
            return unit, None
        yield
        explanation = explain(evidence, self._meters, self._separation)
        if explanation is None:
            return unit, None
        context = Context(self._configured, evidence, explanation, self._interval_s)
        possible = [e for e in told_findings(context, long_s) if e.name != "compass_degrees"]
        found = [each for each in possible if _is_told(each, context)]
        if any(_is_hidden(each, context) for each in possible):
            found = [e for e in found if e.name not in SIZES or not is_small(e, self._configured)]
        if not found or not (yield from self._lasts(explanation)):
            return unit, None
        return in_order([*unit, *found]), explanation

    def _lasting_unit(self, evidence: Evidence) -> Parts[tuple[Finding, ...]]:
        """Return the compass's wrong unit, if it has one in each half of the blocks."""
        unit = compass_unit(evidence)
        if unit:
            for half in _halves(self._compass.numbers):
                yield
                if compass_unit(self.evidence(half)) != unit:
                    return ()
        return tuple(unit)

    def _fit(self, evidence: Evidence, explanation: Explanation | None = None) -> float:
        """Return the log likelihood of an explanation; None: that all is as configured [nats]."""
        if explanation is None:
            return fit_of(evidence, self._meters, self._separation)
        return fit_of(
            evidence, self._meters, self._separation, explanation.wiring, explanation.free
        )

    def _gains(self, evidence: Evidence, explanation: Explanation, nats: float) -> bool:
        """Return whether an explanation is better than the configuration by that much."""
        gain = self._fit(evidence, explanation) - self._fit(evidence)
        return gain >= nats  # not, if neither is possible

    def _lasts(self, explanation: Explanation) -> Parts[bool]:
        """Return whether an explanation is better than the configuration in each half."""
        for half in _halves(self._numbers()):
            yield
            if not self._gains(self.evidence(half), explanation, LASTING_GAIN):
                return False
        return True

    def _is_over(self) -> bool:
        """Return whether the newest blocks contradict the findings."""
        numbers = self._numbers()
        evidence = self.evidence(range(numbers[-min(RECENT_BLOCKS, len(numbers))], self._seen + 1))
        if self._explanation is None:
            return not evidence.random_compass and not compass_unit(evidence)
        return not self._gains(evidence, self._explanation, OVER_GAIN)


def _is_told(finding: Finding, context: Context) -> bool:
    """Return whether a finding is told while driving.

    Numbers have to be certain: a drive is looked at again and again. A delay has to be large,
    and wheels have to explain the sensor well: instruments are weak where they slip much.
    """
    if finding.certainty is Certainty.POSSIBLE or finding.name in UNTOLD:
        return False
    if finding.name in ROTATIONS and is_small(finding, context.configured):
        sources = (context.evidence.compass, context.evidence.fix_yaw)
        shares = [each.fit.explained for each in sources if each is not None]
        if max(shares, default=0.0) < YAW_EXPLAINED:
            return False
    if finding.name not in DELAYS:
        return finding.certainty is Certainty.CERTAIN or finding.name not in GROSS
    if finding.certainty is not Certainty.CERTAIN or _is_hidden(finding, context):
        return False
    (change,) = finding.changes
    now = float(context.configured[change.parameter])
    same_side = (change.low > now) == (change.high > now)
    return same_side and min(abs(change.low - now), abs(change.high - now)) > LEAST_TOLD_DELAY_S


def _is_hidden(finding: Finding, context: Context) -> bool:
    """Return whether a finding is a sure delay that may be something else, and is not told.

    Beside such a delay, of a compass on slipping wheels, a right separation seemed off by a third.
    """
    if finding.name not in DELAYS or finding.certainty is not Certainty.CERTAIN:
        return False
    (change,) = finding.changes
    size = abs(float(change.value) - float(context.configured[change.parameter]))
    return size > LARGEST_TOLD_DELAY_S or not _is_explained(finding, context)


def _is_explained(finding: Finding, context: Context) -> bool:
    """Return whether wheels explain a sensor well enough for a delay of it to be told."""
    evidence = context.evidence
    if finding.name == "compass_delay":
        return evidence.compass is not None and evidence.compass.fit.explained >= EXPLAINED
    best = evidence.best
    if best is None or best.displacement is None:
        return False
    return best.displacement.explained >= PATH_EXPLAINED


def _halves(numbers: Sequence[int]) -> tuple[range, range]:
    """Return the numbers of the first half of some blocks, and of the second one."""
    if not numbers:
        return range(0), range(0)
    middle = numbers[len(numbers) // 2]
    return range(numbers[0], middle), range(middle, numbers[-1] + 1)
