# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Everything that the readings say of each other, without the configuration.

Nothing here depends on the configured radius, separation or signs: rotations and distances are per
count. So what is found is the same for a right configuration and for a wrong one, and only its
explanation differs.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fnn_ekf_ros.calibration.displacement import DisplacementFit, fit_displacement
from fnn_ekf_ros.calibration.rotation import YawFit, YawTrack, fit_yaw
from fnn_ekf_ros.calibration.travel import WheelTravel
from fnn_ekf_ros.core.angles import wrap_angle
from fnn_ekf_ros.core.arrays import FloatArray

FEWEST_READINGS = 20
"""Number of readings that a fit needs."""
MOST_READINGS = 20_000
"""Largest number of readings of one sensor that are used, its first ones: two hours of fixes."""
GROUP_S = 0.3
"""Time over which the readings of a fast sensor are averaged [s]: rotation is nearly even in it."""
DEGREES = 180.0 / math.pi
"""Factor of a yaw in degrees that is taken for radians."""
NARROW_YAW = 0.2
"""Range of a yaw in radians that is taken for degrees, 2 pi / 57.3 = 0.11, with noise [rad]."""
NEARLY_ALL = 0.98
"""Share of the readings that have to be in it: the others may be outliers."""
UNIT_TOLERANCE = 1.4
"""Factor by which a yaw of another unit may differ from what is expected of it."""
RANDOM_BELOW = 0.2
"""Mean resultant length of the changes of a yaw, beside the wheels, below which it is random; noise
of 1.3 rad gives that, ten times a compass's."""
WEAK_SHARE = 0.05
"""Share of the fixes' changes that wheels and yaw have to explain for a fit to count."""


class Readings(NamedTuple):
    """Readings of a drive; stamps in seconds since its begin.

    Attributes:
        travel: of the wheels.
        compass: `(n, 2)` stamps, yaw as the localizer takes it [s, rad]; maybe empty.
        fixes: `(k, 4)` stamps, x, y, yaw [s, m, m, rad]; maybe empty; NaN yaw if it has none.
    """

    travel: WheelTravel
    compass: FloatArray
    fixes: FloatArray


class YawSource(NamedTuple):
    """A sensor's yaw against wheels and fixes.

    Attributes:
        fit: against the wheels.
        turned: range of directions that the robot had by it [rad].
        displacement: of the fixes along it; None without fixes.
        handedness: +1 if the fixes' path goes the way the yaw says, -1 if it is mirrored, 0 if that
            cannot be told.
        factor: 1, or by how much it turns further than the robot: `DEGREES` or 1 / `DEGREES`.
    """

    fit: YawFit
    turned: float
    displacement: DisplacementFit | None = None
    handedness: int = 0
    factor: float = 1.0

    @property
    def usable(self) -> bool:
        """Whether it is a direction."""
        return self.factor == 1.0


class Evidence(NamedTuple):
    """What the readings say.

    Attributes:
        compass: None if there are too few readings, or if it is random.
        fix_yaw: likewise.
        random_compass: whether the compass has nothing to do with the robot's rotation.
    """

    compass: YawSource | None
    fix_yaw: YawSource | None
    random_compass: bool

    @property
    def best(self) -> YawSource | None:
        """The source whose direction explains the fixes best."""
        found = [
            source
            for source in (self.compass, self.fix_yaw)
            if source is not None
            and source.usable
            and source.displacement is not None
            and source.displacement.explained > WEAK_SHARE
        ]
        return max(found, key=_likelihood, default=None)

    @property
    def other(self) -> YawSource | None:
        """The other source that is a direction along which fixes can be explained."""
        best = self.best
        sources = [each for each in (self.compass, self.fix_yaw) if each is not None]
        return next(
            (each for each in sources if each is not best and each.displacement is not None), None
        )


def evidence_of(readings: Readings, expected: FloatArray) -> Evidence:
    """Return what the readings say.

    Args:
        readings: of a drive; enough of the wheels.
        expected: `(2,)` a_s, a_d by the configuration [rad per count], to recognize a yaw in
            degrees where nothing else tells.
    """
    travel = readings.travel
    fixes = readings.fixes[travel.covers(readings.fixes[:, 0])][:MOST_READINGS]
    with_yaw = fixes[np.isfinite(fixes[:, 3])]
    fix_yaw, reference = None, expected
    if _varies(with_yaw[:, 3]):
        fit, track = fit_yaw(travel, with_yaw[:, 0], with_yaw[:, 3])
        if not _is_random(travel, with_yaw[:, [0, 3]], fit.coefficients[:2]):
            fix_yaw, reference = _source(travel, fit, track, fixes), fit.coefficients[:2]
    compass = readings.compass[travel.covers(readings.compass[:, 0])]
    source, random_compass = None, False
    if _varies(averaged(compass)[:, 1]):
        source = _compass_source(travel, compass, fixes, reference)
        random_compass = source is None
    return Evidence(compass=source, fix_yaw=fix_yaw, random_compass=random_compass)


def _compass_source(
    travel: WheelTravel, compass: FloatArray, fixes: FloatArray, reference: FloatArray
) -> YawSource | None:
    """Return the compass against wheels and fixes; None if it is random.

    Radians that are taken for degrees are all near 0. A yaw in degrees turns so fast that close
    readings do not tell by how much; the fit then begins with what it would be.
    """
    low, high = np.quantile(compass[:, 1], [0.5 - 0.5 * NEARLY_ALL, 0.5 + 0.5 * NEARLY_ALL])
    if high - low < NARROW_YAW and _turns(travel, reference) > 1.0:
        scaled = averaged(compass * [1.0, DEGREES])[:MOST_READINGS]
        fit, track = fit_yaw(travel, scaled[:, 0], wrap_angle(scaled[:, 1]))
        if not _is_random(travel, scaled, fit.coefficients[:2]) and agrees(fit, reference, 1.0):
            return YawSource(fit, _turned(travel, track), factor=1.0 / DEGREES)
    compass = averaged(compass)[:MOST_READINGS]
    times, yaw = compass.T
    for factor in (1.0, DEGREES, -DEGREES):
        start = None if factor == 1.0 else factor * reference
        fit, track = fit_yaw(travel, times, yaw, start)
        if not _is_random(travel, compass, fit.coefficients[:2]):
            if factor != 1.0 or agrees(fit, reference, DEGREES):
                return YawSource(fit, _turned(travel, track), factor=DEGREES)
            return _source(travel, fit, track, fixes)
    return None


def _turns(travel: WheelTravel, reference: FloatArray) -> float:
    """Return the range of directions by the wheels [rad]."""
    return float(np.ptp(travel.mean_and_half_difference(travel.times) @ reference))


def agrees(fit: YawFit, reference: FloatArray, factor: float) -> bool:
    """Return whether a yaw turns by a factor further than another one, either way."""
    size = float(np.hypot(*fit.coefficients[:2])) / (factor * float(np.hypot(*reference)) + 1e-300)
    return 1.0 / UNIT_TOLERANCE < size < UNIT_TOLERANCE


def _is_random(travel: WheelTravel, readings: FloatArray, coefficients: FloatArray) -> bool:
    moved = travel.mean_and_half_difference(readings[:, 0])
    return bool(abs(np.mean(changes_beside(readings, moved, coefficients))) < RANDOM_BELOW)


def changes_beside(
    readings: FloatArray, moved: FloatArray, coefficients: FloatArray
) -> NDArray[np.complex128]:
    """Return the changes of a yaw that the wheels do not explain, as directions `(k,)`.

    Args:
        readings: `(n, 2)` stamps, yaw [s, rad]; only readings close to each other count.
        moved: `(n, 2)` travel of the wheels [counts].
        coefficients: `(2,)` a_s, a_d [rad per count].
    """
    gaps = np.diff(readings[:, 0])
    left = np.diff(readings[:, 1]) - np.diff(moved @ coefficients)
    return np.asarray(np.exp(1j * left[gaps <= np.median(gaps) * 1.5]))


def _varies(yaw: FloatArray) -> bool:
    return len(yaw) >= FEWEST_READINGS and bool(np.ptp(yaw) > 1e-6)


def _source(travel: WheelTravel, fit: YawFit, track: YawTrack, fixes: FloatArray) -> YawSource:
    turned = _turned(travel, track)
    if len(fixes) < FEWEST_READINGS:
        return YawSource(fit, turned)
    yaw = track.at(travel, travel.times)
    displacement, handedness = fit_displacement(travel, yaw, fixes[:, 0], fixes[:, 1:3])
    return YawSource(fit, turned, displacement, handedness)


def _likelihood(source: YawSource) -> float:
    return -math.inf if source.displacement is None else source.displacement.log_likelihood


def averaged(readings: FloatArray) -> FloatArray:
    """Return readings `(n, 2)` of stamp and yaw, those of a fast sensor as averages of a few."""
    if len(readings) < 2:
        return readings
    size = int(GROUP_S / max(float(np.median(np.diff(readings[:, 0]))), 1e-3))
    if size < 2:
        return readings
    count = len(readings) // size
    grouped = readings[: count * size].reshape(count, size, 2)
    first = grouped[:, :1, 1]
    yaw = first[:, 0] + np.mean(wrap_angle(grouped[:, :, 1] - first), axis=1)
    return np.stack([grouped[:, :, 0].mean(axis=1), yaw], axis=-1)


def _turned(travel: WheelTravel, track: YawTrack) -> float:
    return float(np.ptp(track.at(travel, travel.times)))
