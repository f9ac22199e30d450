# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Readings of a robot that drives, in blocks: what they say of each other, in bounded memory.

Blocks of `BLOCK_S` become sums (`block_sums`) as soon as they are over; the sums of the last
`MOST_BLOCKS` blocks in which the robot moved are kept.
"""

import math
from collections import deque
from typing import NamedTuple

import numpy as np

from fnn_ekf_ros.calibration.block_fits import (
    displacement_of_blocks,
    likeliest_ratio,
    rotation_of_blocks,
)
from fnn_ekf_ros.calibration.block_sums import (
    BLOCK_RATIOS,
    COLUMNS,
    FEWEST_IN_BLOCK,
    LONGEST_STEP_S,
    NODES_S,
    USUAL_RATIO,
    BlockSums,
    NumberArray,
    block_sums,
)
from fnn_ekf_ros.calibration.displacement import dead_reckoned, displaced_at
from fnn_ekf_ros.calibration.drift_regression import Drift, Level, smoothed
from fnn_ekf_ros.calibration.evidence import (
    DEGREES,
    FEWEST_READINGS,
    NARROW_YAW,
    NEARLY_ALL,
    RANDOM_BELOW,
    YawSource,
    agrees,
    averaged,
    changes_beside,
)
from fnn_ekf_ros.calibration.rotation import LARGEST_DELAY_S, YawFit, YawTrack, unwrapped_beside
from fnn_ekf_ros.calibration.travel import WheelTravel
from fnn_ekf_ros.core.angles import wrap_angle
from fnn_ekf_ros.core.arrays import BoolArray, FloatArray

BLOCK_S = 9.0
"""Length of a block [s]: errors that last for seconds are alike in it, and a minute has six, from
which standard errors can be told."""
MARGIN_S = LARGEST_DELAY_S + 0.1
"""Time around a block from which travel is needed [s]."""
MOST_BLOCKS = 24
"""Number of blocks that are kept: four minutes of driving, which is what small errors need."""
PROVISIONAL_BLOCKS = 4
"""Number of blocks up to which what is known of the wheels is put right after each of them."""
WELL_KNOWN = 6.0
"""Size of what wheels and a sensor have to do with each other, in standard errors, from which on a
sensor says something: a robot that never turned tells nothing."""
KNOWN = 4.0
"""Size of a coefficient, in standard errors, from which on turns are unwrapped by it."""
STILL = 0.01
"""Range of a sensor's readings below which they are no evidence in a block (rad, m): the robot
stands, drives straight on, or the sensor is frozen."""
CHANCE = 2.5
"""Mean resultant length that random directions rarely exceed, times the root of their number."""
NARROW_TURN = 1.0
"""Rotation by the wheels in a block from which on a yaw that stays near 0 may be in radians taken
for degrees [rad]: less than a corner."""
DIRECTION = 0.5
"""Share of the fixes' changes that wheels explain along a yaw from which on it is a direction."""
UNIT_MARGIN = 0.2
"""Length by which changes of a yaw have to be more alike if it is in degrees."""
_FACTORS = (1.0, DEGREES, -DEGREES)
"""Factors by which a yaw may turn further than the robot, to be told by close readings."""


class Segment(NamedTuple):
    """Readings of a block, as configured; those of wheels and yaw reach beyond both ends.

    Attributes:
        number: of the block.
        begin_s: of the block [s].
        end_s: of the block [s].
        travel: of the wheels.
        compass: `(n, 2)` stamps, yaw [s, rad].
        fixes: `(k, 4)` stamps, x, y, yaw [s, m, m, rad]; NaN yaw where there is none.
    """

    number: int
    begin_s: float
    end_s: float
    travel: WheelTravel
    compass: FloatArray
    fixes: FloatArray

    def inside(self, readings: FloatArray) -> FloatArray:
        """Return the readings within the block."""
        times = readings[:, 0]
        return readings[(times > self.begin_s) & (times <= self.end_s)]


class YawBlock(NamedTuple):
    """What a block says of a yaw sensor.

    Attributes:
        number: of the block.
        rotation: sums of the yaw against the wheels.
        displacement: sums of the fixes against the wheels in the direction of the yaw; None: there
            were too few of them, or the yaw is no direction.
        changes: `(3,)` sums of the directions of the yaw's changes that the wheels do not explain
            if it turns by each of `_FACTORS`.
        close: number of these changes.
        turned: range of directions [rad].
        delay_s: that was taken off the yaw's stamps for the displacement [s].
    """

    number: int
    rotation: BlockSums
    displacement: BlockSums | None
    changes: NumberArray
    close: int
    turned: float
    delay_s: float


class _End(NamedTuple):
    """Where a filter is after a block.

    Attributes:
        reading: the last one, a row as it came.
        level: after it.
    """

    reading: FloatArray
    level: Level


class YawBlocks:
    """The blocks of one yaw sensor.

    Args:
        expected: `(2,)` a_s, a_d by the configuration [rad per count].
    """

    def __init__(self, expected: FloatArray) -> None:
        self._expected = expected
        self._blocks: deque[YawBlock] = deque(maxlen=MOST_BLOCKS)
        self._ends: dict[str, _End] = {}
        self._narrow = False
        self._known: YawFit | None = None
        self._moved_known: NumberArray | None = None
        self._ratios = [USUAL_RATIO, USUAL_RATIO]

    def __len__(self) -> int:
        return len(self._blocks)

    def forget_all_but(self, blocks: int) -> None:
        """Forget the oldest blocks."""
        while len(self._blocks) > blocks:
            self._blocks.popleft()
        if not blocks:
            self._ends.clear()
            self._known = None
            self._ratios = [USUAL_RATIO, USUAL_RATIO]

    def add(self, segment: Segment, readings: FloatArray, fixes: FloatArray) -> None:
        """Take a block in.

        Args:
            segment: the block.
            readings: `(n, 2)` stamps, yaw, also beyond the block [s, rad].
            fixes: `(k, 4)` within it.
        """
        inside = segment.inside(readings)
        if len(inside) < FEWEST_IN_BLOCK or float(np.ptp(inside[:, 1])) < STILL:
            return
        self._look_at_unit(segment, inside)
        readings = averaged(readings * [1.0, DEGREES] if self._narrow else readings)
        inside = segment.inside(readings)
        if len(inside) < FEWEST_IN_BLOCK:
            return
        inside = self._with_last("rotation", inside)
        moved = segment.travel.mean_and_half_difference(inside[:, 0])
        slope = np.zeros(2) if self._known is None else self._known.coefficients[:2]
        unwrapped = unwrapped_beside(np.asarray(wrap_angle(inside[:, 1])), moved @ slope)
        rotation = self._rotation_sums(segment.travel, inside, unwrapped)
        if len(self._blocks) < PROVISIONAL_BLOCKS:
            sums = [*(block.rotation for block in self._blocks), rotation]
            self._known = _shrunk(rotation_of_blocks(sums, 0.0))
            self._ratios[0] = likeliest_ratio(sums)
        assert self._known is not None
        slope = self._known.coefficients[:2]
        changes = [changes_beside(inside, moved, slope)]
        changes += [changes_beside(inside, moved, f * self._expected) for f in _FACTORS[1:]]
        displacement, delay_s = None, 0.0
        fixes = self._with_last("displacement", fixes)
        if len(fixes) >= FEWEST_IN_BLOCK and not self._narrow:
            track = self._track(segment, readings, slope)
            delay_s = track.delay_s
            displacement = self._displacement_sums(segment.travel, track, fixes)
        self._blocks.append(
            YawBlock(
                segment.number,
                rotation,
                displacement,
                np.array([np.sum(each) for each in changes]),
                len(changes[0]),
                float(np.ptp(unwrapped)),
                delay_s,
            )
        )

    @property
    def numbers(self) -> list[int]:
        """Numbers of the blocks, rising."""
        return [block.number for block in self._blocks]

    def source(self, which: range | None = None) -> tuple[YawSource | None, bool]:
        """Return what blocks say, and whether the yaw is random.

        Args:
            which: numbers of the blocks; None: all of them, and what is found is kept for the
                blocks to come.
        """
        blocks = [each for each in self._blocks if which is None or each.number in which]
        rotations = [block.rotation for block in blocks]
        if sum(sums.readings for sums in rotations) < FEWEST_READINGS:
            return None, False
        close = sum(block.close for block in blocks)
        random_below = max(RANDOM_BELOW, CHANCE / math.sqrt(max(close, 1)))
        lengths = np.abs(sum(block.changes for block in blocks)) / max(close, 1)
        fit = rotation_of_blocks(rotations, float(np.mean([each.delay_s for each in blocks])))
        if which is None:
            self._known = _shrunk(fit)
            self._ratios[0] = likeliest_ratio(rotations)
        turned = max(block.turned for block in blocks)
        if not _well_known(fit.coefficients[:2], fit.covariance) and close:
            return None, bool(np.max(lengths) < random_below) and not self._narrow
        if self._narrow:  # if it does not fit, the yaw was near 0 on a straight road
            fits = lengths[0] >= random_below and agrees(fit, self._expected, 1.0)
            return (YawSource(fit, turned, factor=1.0 / DEGREES) if fits else None), False
        place = int(np.argmax(lengths - [0.0, UNIT_MARGIN, UNIT_MARGIN]))
        if lengths[place] < random_below:
            return None, True
        if place > 0:
            return YawSource(fit, turned, factor=DEGREES), False
        return self._along(fit, turned, blocks, keep=which is None), False

    def _along(
        self, fit: YawFit, turned: float, blocks: list[YawBlock], *, keep: bool
    ) -> YawSource | None:
        """Return a yaw with what fixes say along it; None if they contradict it.

        Args:
            fit: of it.
            turned: range of directions by it [rad].
            blocks: those in question.
            keep: whether what is found is kept for the blocks to come.
        """
        in_degrees = agrees(fit, self._expected, DEGREES)
        moved = [each.displacement for each in blocks if each.displacement is not None]
        if sum(sums.readings for sums in moved) < FEWEST_READINGS:
            return YawSource(fit, turned, factor=DEGREES if in_degrees else 1.0)
        displacement, handedness = displacement_of_blocks(moved)
        if in_degrees and displacement.explained < DIRECTION:  # wheels may be wrong by 60, too
            return YawSource(fit, turned, factor=DEGREES)
        if not _well_known(displacement.coefficients[:2], displacement.covariance):
            return None
        if keep:
            self._ratios[1] = likeliest_ratio(moved)
        return YawSource(fit, turned, displacement, handedness)

    def _look_at_unit(self, segment: Segment, inside: FloatArray) -> None:
        """Find out whether the yaw is so near 0 that it is one in radians taken for degrees."""
        by_wheels = segment.travel.mean_and_half_difference(inside[:, 0]) @ self._expected
        near_0 = float(np.quantile(np.abs(inside[:, 1]), NEARLY_ALL)) < NARROW_YAW
        if self._narrow and not near_0:
            self._narrow = False
        elif not self._narrow and near_0 and float(np.ptp(by_wheels)) > NARROW_TURN:
            self._narrow = True
        else:
            return
        self.forget_all_but(0)

    def _with_last(self, kind: str, readings: FloatArray) -> FloatArray:
        """Return readings with the last one of the block before in front, if it is known still."""
        end = self._ends.get(kind)
        if end is None or len(readings) == 0 or readings[0, 0] - end.reading[0] > LONGEST_STEP_S:
            self._ends.pop(kind, None)
            return readings
        return np.concatenate([end.reading[None], readings])

    def _sums(
        self, kind: str, readings: FloatArray, columns: NumberArray, breaks: BoolArray
    ) -> BlockSums:
        """Return the sums of a block, from where the filter was after the block before."""
        rotation = kind == "rotation"
        known = None
        if rotation and self._known is not None:
            known = np.zeros(COLUMNS - 1)
            known[_MIDDLE] = self._known.coefficients[:2]
        end = self._ends.get(kind)
        sums, level = block_sums(
            readings[:, 0],
            columns,
            breaks,
            known,
            self._ratios[0 if rotation else 1],
            None if end is None else end.level,
        )
        self._ends[kind] = _End(readings[-1], level)
        return sums

    def _rotation_sums(
        self, travel: WheelTravel, readings: FloatArray, yaw: FloatArray
    ) -> BlockSums:
        times = readings[:, 0]
        moved = travel.mean_and_half_difference(times[:, None] - NODES_S)
        columns = np.concatenate([yaw[:, None], moved[..., 0], moved[..., 1]], axis=1)
        return self._sums("rotation", readings, columns, travel.breaks(times))

    def _track(self, segment: Segment, readings: FloatArray, slope: FloatArray) -> YawTrack:
        """Return the yaw in a block and around it."""
        travel = segment.travel
        delay_s = 0.0 if self._known is None else float(self._known.coefficients[2])
        times = readings[:, 0]
        moved = travel.mean_and_half_difference(times - delay_s) @ slope
        left = unwrapped_beside(np.asarray(wrap_angle(readings[:, 1])), moved) - moved
        breaks = travel.breaks(times)
        breaks[0] = True
        ratio = float(BLOCK_RATIOS[self._ratios[0]])
        level = smoothed(Drift(times, breaks, np.ones(len(times)), ratio), left)
        return YawTrack(times, slope, level, delay_s)

    def _displacement_sums(
        self, travel: WheelTravel, track: YawTrack, fixes: FloatArray
    ) -> BlockSums:
        path = dead_reckoned(travel, track.at(travel, travel.times))
        times = fixes[:, 0]
        moved = displaced_at(travel, path, times[:, None] - NODES_S)
        position = fixes[:, 1] + 1j * fixes[:, 2]
        columns = np.concatenate([position[:, None], moved[..., 0], moved[..., 1]], axis=1)
        return self._sums("displacement", fixes, columns, travel.breaks(times))


_MIDDLE = [len(NODES_S) // 2, len(NODES_S) + len(NODES_S) // 2]
"""Places of travel without a delay among the coefficients."""


def _well_known(coefficients: FloatArray, covariance: FloatArray) -> bool:
    stds = np.sqrt(np.diag(covariance)[: len(coefficients)])
    return bool(np.max(np.abs(coefficients) / stds) > WELL_KNOWN)


def _shrunk(fit: YawFit) -> YawFit:
    """Return a fit without coefficients that may as well be 0.

    A robot that drove straight on tells none, and one that turned at one rate only their sum. What
    is known wrongly unwraps the next turns wrongly, and then seems to be known well.
    """
    found = fit.coefficients.copy()
    found[np.abs(found) < KNOWN * np.sqrt(np.diag(fit.covariance))] = 0.0
    return fit._replace(coefficients=found)
