# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The lags of compass and fixes: by how much their stamps are later than the measured instants.

A reading with lag L shows the robot where it was L seconds before its stamp. Against the path p of
the wheels it is behind by L times the velocity v:

    z = c0 + (1 + c) p - L v + e

c0 is the map's place in the frame of the wheels, and the yaw's zero. c is an error of scale (wheels
that are too large or too far apart) and, for fixes, of direction (a compass that is off), as one
complex number. e is noise, slip and what else is wrong; its law is not known, and it may last.

The estimate is a regression that assumes no noise of the filter:

    high pass  each of z - p, p, v without its mean over the last readings removes c0, slow drift,
               and errors that last for longer than `HIGH_PASS_S`
    shape      v' = v - kappa p, with kappa = sum p* v / sum p* p, which c cannot imitate
    block      information I = sum Re(v'* v), score u = -sum Re(v'* (z - p))      over `BLOCK_S`
    estimate   L = sum u / sum I over the blocks
    variance   sum (u - L I)^2 / (sum I)^2: how much the blocks contradict each other, whatever
               their noise (White 1980, "A heteroskedasticity-consistent covariance matrix
               estimator", over blocks)

Blocks weigh less by the variance of their noise, averaged with the usual one: real fixes are far
worse at some times than at others. Few blocks may agree by chance; so the variance is averaged with
the one that follows from the readings' scatter and its correlation from one reading to the next,
which counts as `PRIOR_BLOCKS` blocks.

Where nothing but c moves the readings (a straight path at constant speed, a circle), v' is 0, and
nothing is learned: only driving that changes shows a lag.

The module knows neither the filter's innovations nor its noise, and changes nothing of it. Where a
robot is steered by its true position, as the simulated one, what the wheels did not count is
steered back soon after; this looks like a lag of up to 0.15 s.
"""

import math
from typing import NamedTuple

import numpy as np

from fnn_ekf_ros.core.arrays import BoolArray
from fnn_ekf_ros.core.results import Epoch
from fnn_ekf_ros.core.rows import COMPASS, LRF_POSE

SPEED_S = 0.35
"""Time constant over which the velocity is averaged [s]: it looks back as far as the lags are that
are found best. With velocities of the instant a lag of 1 s comes out as 0.7 s in sharp turns."""
HIGH_PASS_S = 4.0
"""Time constant of the means that are removed [s]: a turn takes about as long; slip and errors that
last grow with it."""
HEADING_S = 5.0
"""Time constant with which the path's direction follows the filter's yaw [s]: in between it turns
by the wheels, so that late yaws do not bend the path."""
BLOCK_S = 5.0
"""Shortest duration of a block [s]: somewhat longer than the high pass, so that blocks are nearly
independent."""
BLOCK_READINGS = 8
"""Least number of readings in a block: the error of direction, which has to be known from the
block, takes one of them."""
SCALE_MEMORY_S = 100.0
"""Memory for the shape of the yaw's path [s]: the error of the wheels' separation stays. The error
of direction of the fixes' path changes within seconds; its shape is that of the block."""
LAG_MEMORY_S = 300.0
"""Memory for blocks [s]: a lag that has changed is noticed in minutes."""
LARGEST_GAP_S = 6.0
"""Time without a reading from which on the means begin anew [s]: the path has drifted."""
COLOR = 1.5
"""Variance of a block's score over that of noise with the readings' correlation, before the blocks
show it: errors are not of that simple kind."""
PRIOR_BLOCKS = 10.0
"""Number of blocks that this assumption counts for."""
SMALLEST_LAG = 0.2
"""Lag that has to be exceeded significantly to be believed, either way [s]: robots that are steered
by their true position seem to be late by up to 0.15 s."""
LARGEST_LAG = 1.5
"""Largest lag that is believed, either way [s]: the velocity says little of places further back."""
SIGNIFICANT = 3.3
"""Standard errors by which a lag that is believed exceeds `SMALLEST_LAG`, if the variance is known;
see `_threshold`."""
FEWEST_BLOCKS = 4.0
"""Effective number of blocks from which on a lag is believed."""

_TAKEN = 2.0
"""Readings of a block that c, a lag, and the means explain by themselves."""
_LARGEST_CORRELATION = 0.97
"""Largest correlation of errors from one reading to the next that is assumed."""
_NEVER_S = 1e9
"""Time since the last reading before the first one [s]."""
_SMALLEST_SQUARES = 1e-12
"""Least sum of squares that is divided by (m^2, rad^2, and per s^2)."""


class Sample(NamedTuple):
    """A reading against the wheels: complex numbers x + i y for positions, real ones for yaws.

    Attributes:
        error: z - p (m or rad).
        path: p (m or rad).
        speed: v (m/s or rad/s).
    """

    error: complex = 0.0
    path: complex = 0.0
    speed: complex = 0.0


class Evidence(NamedTuple):
    """Fading sums over the blocks, each block with its weight.

    Attributes:
        information: I.
        score: u.
        score_square: u^2.
        score_information: u I.
        information_square: I^2.
        white: variance of u if the block's noise were white.
        noise: squares of the readings' errors that c and L leave, per real component; not weighted.
        noise_next: products of these errors with those of the readings before; not weighted.
        readings: number of readings behind these, without what c takes; not weighted.
    """

    information: float = 0.0
    score: float = 0.0
    score_square: float = 0.0
    score_information: float = 0.0
    information_square: float = 0.0
    white: float = 0.0
    noise: float = 0.0
    noise_next: float = 0.0
    readings: float = 0.0


class SensorLag(NamedTuple):
    """What is known of the lag of one sensor.

    Attributes:
        sensor: as in `rows`.
        means: over the last readings.
        averaged: number of readings behind these means.
        last_s: time of the last reading, as `Lags.time_s` [s].
        block: readings of the block that is not full yet, after the high pass.
        block_begin_s: time of its begin [s].
        shape: fading sums of p* p and p* v over the blocks before.
        evidence: of the blocks before.
        believed: whether the lag is believed.
    """

    sensor: int
    means: Sample = Sample()
    averaged: int = 0
    last_s: float = -_NEVER_S
    block: tuple[Sample, ...] = ()
    block_begin_s: float = 0.0
    shape: tuple[float, complex] = (0.0, 0.0)
    evidence: Evidence = Evidence()
    believed: bool = False

    @property
    def lag(self) -> float:
        """L [s]; positive: the stamps are late."""
        return self.evidence.score / max(self.evidence.information, _SMALLEST_SQUARES)

    @property
    def blocks(self) -> float:
        """Effective number of blocks, (sum I)^2 / sum I^2."""
        seen = self.evidence
        return max(seen.information**2 / max(seen.information_square, _SMALLEST_SQUARES**2), 1.0)

    @property
    def color(self) -> float:
        """Variance of a sum of the readings' errors over that of white ones of the same size.

        (1 + r) / (1 - r) of errors with correlation r from one reading to the next.
        """
        seen = self.evidence
        r = seen.noise_next / max(seen.noise, _SMALLEST_SQUARES)
        r = min(max(r, 0.0), _LARGEST_CORRELATION)
        return (1.0 + r) / (1.0 - r)

    @property
    def std(self) -> float:
        """Standard error of the lag [s]; very large where nothing is known."""
        seen, lag, n = self.evidence, self.lag, self.blocks
        information = max(seen.information, _SMALLEST_SQUARES)
        contradiction = (
            seen.score_square
            - 2.0 * lag * seen.score_information
            + lag**2 * seen.information_square
        )
        assumed = COLOR * self.color * seen.white * PRIOR_BLOCKS / n
        variance = (max(contradiction, 0.0) + assumed) * n / (n + PRIOR_BLOCKS - 1.0)
        return math.sqrt(variance) / information


class Lags(NamedTuple):
    """What is known of the lags of both sensors of a robot.

    Attributes:
        time_s: time since the start [s].
        position: x + i y by the wheels since the start, in directions of the map [m].
        rotation: yaw by the wheels since the start [rad].
        position_behind: position, averaged over the last `SPEED_S` [m].
        rotation_behind: rotation likewise [rad].
        heading_offset: yaw in the map without that rotation [rad].
        heading_s: time at which the filter's yaw was seen last [s].
        sensors: the lag of each sensor, as in `rows`.
    """

    time_s: float = 0.0
    position: complex = 0.0
    rotation: float = 0.0
    position_behind: complex = 0.0
    rotation_behind: float = 0.0
    heading_offset: float = 0.0
    heading_s: float = -_NEVER_S
    sensors: tuple[SensorLag, ...] = (SensorLag(COMPASS), SensorLag(LRF_POSE))


def at_another_pose(lags: Lags) -> Lags:
    """Return what is known after the pose was set or moved: the path begins anew."""
    begun = tuple(sensor._replace(last_s=-_NEVER_S) for sensor in lags.sensors)
    return lags._replace(heading_s=-_NEVER_S, sensors=begun)


def lags_after(
    lags: Lags, epoch: Epoch, heading: float | None = None, accepted: BoolArray | None = None
) -> Lags:
    """Return what is known after an epoch of one robot.

    Args:
        lags: before it; not changed.
        epoch: the step of the wheels, and maybe readings.
        heading: yaw that the filter predicted for its end [rad]; None without readings.
        accepted: `(4,)` rows that were measured and accepted; None without readings.
    """
    distance, turn = epoch.control.tolist()
    lags = _moved(lags, distance, turn, epoch.duration_s)
    if heading is None or accepted is None:
        return lags
    x, y, yaw, _ = epoch.measurement.tolist()
    has_x, has_y, has_yaw, _ = accepted.tolist()
    time_s, position, rotation = lags.time_s, lags.position, lags.rotation
    compass, fixes = lags.sensors
    if has_yaw:
        known = compass.means.error.real
        error = known + math.remainder(yaw - rotation - known, math.tau)
        speed = (rotation - lags.rotation_behind) / SPEED_S
        compass = _after_reading(compass, time_s, Sample(error, rotation, speed))
    if has_x and has_y:
        velocity = (position - lags.position_behind) / SPEED_S
        sample = Sample(complex(x, y) - position, position, velocity)
        fixes = _after_reading(fixes, time_s, sample)
    turned = math.remainder(heading - rotation - lags.heading_offset, math.tau)
    share = 1.0 - math.exp((lags.heading_s - time_s) / HEADING_S)
    return lags._replace(
        heading_offset=lags.heading_offset + share * turned,
        heading_s=time_s,
        sensors=(compass, fixes),
    )


def _moved(lags: Lags, distance: float, turn: float, duration_s: float) -> Lags:
    """Return what is known after a step of the wheels (m, rad, s)."""
    if duration_s <= 0.0:
        return lags
    direction = lags.heading_offset + lags.rotation + 0.5 * turn
    step = distance * complex(math.cos(direction), math.sin(direction))
    position, rotation = lags.position + step, lags.rotation + turn
    # The first order low pass of a path at constant speed: exact, whatever the epoch's duration.
    left = math.exp(-duration_s / SPEED_S)
    caught = (1.0 - left) * SPEED_S / duration_s
    return lags._replace(
        time_s=lags.time_s + duration_s,
        position=position,
        rotation=rotation,
        position_behind=position - left * (lags.position - lags.position_behind) - caught * step,
        rotation_behind=rotation - left * (lags.rotation - lags.rotation_behind) - caught * turn,
    )


def _after_reading(sensor: SensorLag, time_s: float, sample: Sample) -> SensorLag:
    """Return what is known after a reading at a time [s]."""
    since_s = time_s - sensor.last_s
    if since_s > LARGEST_GAP_S:
        return sensor._replace(means=sample, averaged=1, last_s=time_s)
    averaged, means = sensor.averaged + 1, sensor.means
    share = max(1.0 - math.exp(-since_s / HIGH_PASS_S), 1.0 / averaged)
    y, p, v = sample.error - means.error, sample.path - means.path, sample.speed - means.speed
    block = (*sensor.block, Sample(y, p, v))
    after = sensor._replace(
        means=Sample(means.error + share * y, means.path + share * p, means.speed + share * v),
        averaged=averaged,
        last_s=time_s,
        block=block,
    )
    full = time_s - sensor.block_begin_s >= BLOCK_S and len(block) >= BLOCK_READINGS
    return _after_block(after) if full else after


def _after_block(sensor: SensorLag) -> SensorLag:
    """Return what is known once a block is full."""
    is_yaw, samples = sensor.sensor == COMPASS, np.array(sensor.block)
    y, p, v = samples.T
    kept = math.exp(-BLOCK_S / SCALE_MEMORY_S) if is_yaw else 0.0
    squares = float(np.vdot(p, p).real)
    path = kept * sensor.shape[0] + squares
    path_speed = kept * sensor.shape[1] + complex(np.vdot(p, v))
    left = v - path_speed / max(path, _SMALLEST_SQUARES) * p  # v'
    information = max(float(np.vdot(left, v).real), 0.0)
    score = -float(np.vdot(left, y).real)
    # What c and a lag leave of the errors, each as this block has it.
    rest = y + score / max(information, _SMALLEST_SQUARES) * left
    rest = rest - np.vdot(p, rest) / max(squares, _SMALLEST_SQUARES) * p
    components = 1.0 if is_yaw else 2.0
    noise = float(np.vdot(rest, rest).real) / components
    following = float(np.vdot(rest[1:], rest[:-1]).real) / components
    readings = len(samples) - _TAKEN
    fading, seen = math.exp(-BLOCK_S / LAG_MEMORY_S), sensor.evidence
    usual = (fading * seen.noise + noise) / (fading * seen.readings + readings)
    variance = noise / readings
    weight = 2.0 / max(usual + variance, _SMALLEST_SQUARES)
    information, score = weight * information, weight * score
    new = Evidence(
        information=information,
        score=score,
        score_square=score**2,
        score_information=score * information,
        information_square=information**2,
        white=weight * information * variance,
        noise=noise,
        noise_next=following,
        readings=readings,
    )
    after = sensor._replace(
        block=(),
        block_begin_s=sensor.last_s,
        shape=(path, path_speed),
        evidence=Evidence(*(fading * old + now for old, now in zip(seen, new, strict=True))),
    )
    return after._replace(believed=_is_believed(after))


def _is_believed(sensor: SensorLag) -> bool:
    """Return whether the lag is believed after a block; one that is believed is kept for longer."""
    size = abs(sensor.lag)
    if sensor.believed and size >= SMALLEST_LAG:
        return True
    if size > LARGEST_LAG or sensor.blocks < FEWEST_BLOCKS:
        return False
    return size - SMALLEST_LAG > _threshold(sensor)


def _threshold(sensor: SensorLag) -> float:
    """Return by how much a lag has to exceed the smallest one [s].

    The quantile of Student's t distribution, to the first order in 1 / degrees of freedom
    (Abramowitz and Stegun 1964, eq. 26.7.5).
    """
    degrees_of_freedom = sensor.blocks + PRIOR_BLOCKS - 1.0
    heavier_tail = 1.0 + (SIGNIFICANT**2 + 1.0) / (4.0 * degrees_of_freedom)
    return SIGNIFICANT * heavier_tail * sensor.std
