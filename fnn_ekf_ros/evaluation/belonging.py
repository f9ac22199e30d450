# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Whether a track and a truth belong together: same frame, same map, same clock, same units.

Errors that one motion of the plane or one shift of time removes are not those of a localizer. Each
explanation is fitted, and the simplest one that removes most of the error is named with its
numbers.
"""

import math
from typing import NamedTuple

import numpy as np

from fnn_ekf_ros.core.angles import wrap_angle
from fnn_ekf_ros.core.arrays import FloatArray
from fnn_ekf_ros.evaluation.alignment import STILL, Similarity, fit
from fnn_ekf_ros.evaluation.matching import Matched, match
from fnn_ekf_ros.timeline.trajectory import Trajectory, interpolate

REMOVED = 0.35
"""Largest share of the RMSE that an explanation leaves: it removes 88 % of the squared errors, more
than a drift or noise that a straight motion happens to fit."""
ALIKE = 0.3
"""Largest RMSE that an explanation leaves, in multiples of the truth's spread about its mean: a
track that is shrunk to a point, or laid across another one, leaves about the spread."""
NEAR_BEST = 1.25
"""Factor by which a simpler explanation may leave more error than the best one."""
SURPRISING = 2.0
"""RMSE in multiples of what the covariance claims from which errors ask for an explanation."""
HUGE = 10.0
"""RMSE in multiples of what the covariance claims that is told even if nothing explains it."""
SMALLEST_SCALE_ERROR = 0.02
"""Smallest difference of a scale from 1 that is told: a calibration of wheels is as good as
that."""
FEWEST_POSES = 20
"""Fewest poses from which anything is concluded."""
MOST_POSES = 5000
"""Most poses with which explanations are tried: more of them take long and say the same."""
LARGEST_SHIFT_S = 10.0
"""Largest shift of time that is tried [s]."""
SHIFTS = 81
"""Number of shifts of each of the two passes: 0.25 s apart, then 6 ms."""
YAW_SPREADS = 3.0
"""Mean error of the yaw in multiples of its scatter from which it is constant."""
SMALLEST_YAW = 0.05
"""Smallest constant error of the yaw that is told [rad], 3 degrees."""


class Explanation(NamedTuple):
    """What would make a track and a truth alike.

    Attributes:
        name: in a few words.
        motion: of the plane, to be applied to the track.
        shift_s: how much later the truth is to be read [s]; more than 0 where the track lags.
        rmse: of the position, with it [m].
    """

    name: str
    motion: Similarity
    shift_s: float
    rmse: float


def explanations(track: Trajectory, truth: Trajectory) -> list[Explanation]:
    """Return what could make a track and a truth alike, the simplest first.

    Args:
        track: estimated.
        truth: has at least one time in common with it.
    """
    matched = match(track, truth)
    if matched is None:
        return []
    shift_alone = _best_shift(track, truth, moves=False)
    shift_moved = _best_shift(track, truth, moves=True)
    found = [
        _explanation("another clock", matched_at(track, truth, shift_alone), STILL, shift_alone),
        _fitted("another frame or map", matched, 0.0),
        _fitted("a mirrored map", matched, 0.0, mirrored=True),
        _fitted("another scale", matched, 0.0, with_scale=True),
        _fitted("another frame and clock", matched_at(track, truth, shift_moved), shift_moved),
        _fitted("a mirrored map of another scale", matched, 0.0, with_scale=True, mirrored=True),
    ]  # fmt: skip
    return [each for each in found if each is not None]


def matched_at(track: Trajectory, truth: Trajectory, shift_s: float) -> Matched | None:
    """Return a track beside the truth read so much earlier [s]."""
    moved = Trajectory(truth.time_ns + round(shift_s * 1e9), truth.pose, truth.covariance)
    return match(track, moved)


def warnings(track: Trajectory, truth: Trajectory) -> list[str]:
    """Return sentences on why a track and a truth may not belong together; none if they do.

    Args:
        track: estimated.
        truth: the ground truth.
    """
    said = []
    if track.frame and truth.frame and track.frame != truth.frame:
        said.append(
            f"odom is in the frame '{track.frame}', the ground truth in '{truth.frame}': they are "
            "compared as if these were the same"
        )
    track = _thinned(track)
    matched = match(track, truth)
    if matched is None or len(matched.time_ns) < FEWEST_POSES:
        return said
    e = matched.errors()
    rmse = _rmse(e)
    claim = _claimed_std(matched)
    if rmse > SURPRISING * claim and rmse > 0.0:
        spread = _rmse(matched.truth - np.mean(matched.truth, axis=0))
        chosen = _simplest(min(REMOVED * rmse, ALIKE * spread), explanations(track, truth))
        if chosen is not None:
            return [*said, _sentence(chosen, rmse)]
        if rmse > HUGE * claim > 0.0:
            said.append(
                f"position errors are {rmse / claim:.0f} times what odom says ({rmse:.3g} m RMSE), "
                "and no shift, turn, mirror image, scale or delay explains them: is this the "
                "ground truth of this run?"
            )
    return said + _yaw_warning(
        e, math.sqrt(max(float(np.median(matched.covariance[:, 2, 2])), 0.0))
    )


def _thinned(track: Trajectory) -> Trajectory:
    """Return a track with `MOST_POSES` poses at most, evenly chosen."""
    stride = -(-len(track.time_ns) // MOST_POSES)
    return Trajectory(
        track.time_ns[::stride], track.pose[::stride], track.covariance[::stride], track.frame
    )


def _simplest(most: float, found: list[Explanation]) -> Explanation | None:
    """Return the simplest explanation that leaves an RMSE of `most` [m] or less, or None."""
    if not found:
        return None
    best = min(each.rmse for each in found)
    limit = min(most, max(NEAR_BEST * best, 1e-9 * most))
    return next((each for each in found if each.rmse <= limit), None)


def _sentence(chosen: Explanation, rmse: float) -> str:
    """Return an explanation as one sentence with its numbers."""
    motion, parts = chosen.motion, []
    if motion.mirrored:
        parts.append("mirrored at its x axis")
    if abs(motion.scale - 1.0) > SMALLEST_SCALE_ERROR:
        parts.append(f"made {motion.scale:.3g} times as large")
    if motion != STILL:
        parts.append(f"turned by {motion.rotation:.3g} rad")
        parts.append(f"moved by ({motion.x:.3g}, {motion.y:.3g}) m")
    if chosen.shift_s:
        word = "earlier" if chosen.shift_s > 0.0 else "later"
        parts.append(f"stamped {abs(chosen.shift_s):.2f} s {word}")
    return (
        f"ground truth and odom do not belong together, it looks like {chosen.name}: odom "
        f"{', '.join(parts)} has a position RMSE of {chosen.rmse:.3g} m instead of {rmse:.3g} m"
    )


def _yaw_warning(e: FloatArray, claim: float) -> list[str]:
    """Return a sentence on a yaw that is off by a constant, if it is."""
    known = e[np.isfinite(e[:, 2]), 2]
    if len(known) < FEWEST_POSES:
        return []
    mean = math.atan2(float(np.mean(np.sin(known))), float(np.mean(np.cos(known))))
    spread = float(np.median(np.abs(wrap_angle(known - mean)))) / 0.6745
    if (
        abs(mean) < SMALLEST_YAW
        or abs(mean) < YAW_SPREADS * spread
        or abs(mean) < SURPRISING * claim
    ):
        return []
    return [
        f"the yaws of odom and of the ground truth differ by a constant {mean:.3g} rad (scatter "
        f"{spread:.2g} rad): do both mean the same axis of the robot?"
    ]


def _best_shift(track: Trajectory, truth: Trajectory, *, moves: bool) -> float:
    """Return the shift of the truth's time with the least error [s]; 0 if none is better."""
    center, reach = 0.0, LARGEST_SHIFT_S
    for _ in range(2):
        tried = center + np.linspace(-reach, reach, SHIFTS)
        errors = [_error_at(track, truth, float(shift), moves=moves) for shift in tried]
        center = float(tried[int(np.argmin(errors))])
        reach = 2.0 * reach / (SHIFTS - 1)
    still = _error_at(track, truth, 0.0, moves=moves)
    return center if _error_at(track, truth, center, moves=moves) < still else 0.0


def _error_at(track: Trajectory, truth: Trajectory, shift_s: float, *, moves: bool) -> float:
    """Return the position RMSE with a shift of time [m], the track moved for it or not.

    Of poses whose truth is known at every shift that is tried, so that the shifts compare.
    """
    pose = interpolate(truth, track.time_ns - round(shift_s * 1e9))
    known = np.isfinite(pose[:, 0])
    if np.sum(known) < max(FEWEST_POSES, 0.5 * len(known)):
        return math.inf
    source = track.pose[known]
    motion = fit(source[:, :2], pose[known, :2]) if moves else STILL
    return _rmse(motion.poses(source) - pose[known])


def _fitted(
    name: str,
    matched: Matched | None,
    shift_s: float,
    *,
    with_scale: bool = False,
    mirrored: bool = False,
) -> Explanation | None:
    if matched is None:
        return None
    xy, true = matched.estimate[:, :2], matched.truth[:, :2]
    motion = fit(xy, true, with_scale=with_scale, mirrored=mirrored)
    return _explanation(name, matched, motion, shift_s)


def _explanation(
    name: str, matched: Matched | None, motion: Similarity, shift_s: float
) -> Explanation | None:
    if matched is None:
        return None
    left = motion.poses(matched.estimate) - matched.truth
    return Explanation(name, motion, shift_s, _rmse(left))


def _rmse(e: FloatArray) -> float:
    """Return the root mean square of the distances of `(n, 2 or more)` errors [m]."""
    return float(np.sqrt(np.mean(np.sum(e[:, :2] ** 2, axis=1))))


def _claimed_std(matched: Matched) -> float:
    """Return the root mean square of the position errors that are claimed [m]; 0 if none are."""
    with np.errstate(over="ignore", invalid="ignore"):
        variance = matched.covariance[:, 0, 0] + matched.covariance[:, 1, 1]
        known = variance[np.isfinite(variance) & (variance >= 0.0)]
        return float(np.sqrt(np.mean(known))) if len(known) else 0.0
