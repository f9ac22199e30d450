# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""All that can be said of a run, with ground truth or without."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from fnn_ekf_ros.errors import FnnEkfError
from fnn_ekf_ros.evaluation import belonging
from fnn_ekf_ros.evaluation.alignment import Alignment, Similarity, aligned
from fnn_ekf_ros.evaluation.consistency import (
    NOT_KNOWN,
    Consistency,
    in_words,
    nees_consistency,
)
from fnn_ekf_ros.evaluation.errors import (
    RelativeDelta,
    RelativeErrors,
    Statistics,
    TrackErrors,
    relative_errors,
    track_errors,
)
from fnn_ekf_ros.evaluation.innovations import (
    FIX_YAW,
    SensorInnovations,
    by_sensor,
    nis_consistency,
)
from fnn_ekf_ros.evaluation.matching import Matched, match
from fnn_ekf_ros.evaluation.motion import corrections
from fnn_ekf_ros.recordings.run_record import RunRecord
from fnn_ekf_ros.timeline.trajectory import Trajectory

STATE_DEGREES = 3
"""Expectation of NEES where the covariance is honest: the degrees of freedom of a pose."""
DEFAULT_DELTA = RelativeDelta(1.0, "m")
"""Step of relative errors."""


class AgainstTruth(NamedTuple):
    """A run held against the ground truth.

    Attributes:
        matched: its poses, aligned, beside the true ones.
        alignment: how it was aligned.
        motion: of the plane that did so.
        errors: sizes of its errors.
        relative: of its motions.
        nees: of its covariances.
        nees_position: of x and y alone, 2 degrees of freedom.
        nees_yaw: of the yaw alone.
        warnings: reasons why the truth may not belong to it; found before the alignment.
    """

    matched: Matched
    alignment: Alignment
    motion: Similarity
    errors: TrackErrors
    relative: RelativeErrors
    nees: Consistency
    nees_position: Consistency
    nees_yaw: Consistency
    warnings: list[str]


@dataclass(frozen=True, slots=True)
class Evaluation:
    """What can be said of a run.

    Attributes:
        truth: what it is against the ground truth; None without one.
        nis: of all readings.
        sensors: of each sensor's innovations.
    """

    truth: AgainstTruth | None
    nis: Consistency = NOT_KNOWN
    sensors: Mapping[str, SensorInnovations] = field(default_factory=dict)


def evaluate(
    run: RunRecord,
    truth: Trajectory | None,
    alignment: Alignment = Alignment.NONE,
    delta: RelativeDelta = DEFAULT_DELTA,
) -> Evaluation:
    """Return what can be said of a run.

    Args:
        run: of a localizer.
        truth: the ground truth; None if there is none.
        alignment: of the run with the truth.
        delta: step of relative errors.

    Raises:
        FnnEkfError: the run cannot be aligned.
    """
    against = None if truth is None else against_truth(run.track, truth, alignment, delta)
    if run.noise is None:
        return Evaluation(against)
    return Evaluation(against, nis_consistency(run.noise), by_sensor(run.noise))


def against_truth(
    track: Trajectory,
    truth: Trajectory,
    alignment: Alignment = Alignment.NONE,
    delta: RelativeDelta = DEFAULT_DELTA,
) -> AgainstTruth | None:
    """Return a track held against the truth; None if they have no time in common.

    Raises:
        FnnEkfError: a track that stands still cannot be aligned.
    """
    unaligned = match(track, truth)
    if unaligned is None:
        return None
    if alignment is Alignment.SE2 and not np.any(np.ptp(unaligned.estimate[:, :2], axis=0)):
        raise FnnEkfError(
            "--align se2: the track stands still, expected one that moves; use origin or none"
        )
    matched, motion = aligned(unaligned, alignment)
    e, P = matched.errors(), matched.covariance
    return AgainstTruth(
        matched=matched,
        alignment=alignment,
        motion=motion,
        errors=track_errors(matched),
        relative=relative_errors(matched, delta),
        nees=nees_consistency(e, P),
        nees_position=nees_consistency(e[:, :2], P[:, :2, :2]),
        nees_yaw=nees_consistency(e[:, 2:], P[:, 2:, 2:]),
        warnings=belonging.warnings(track, truth),
    )


def nees_of(against: AgainstTruth) -> list[tuple[str, Consistency, int]]:
    """Return name, consistency and expectation of NEES as a whole and of its parts."""
    return [
        ("NEES", against.nees, STATE_DEGREES),
        ("NEES of position", against.nees_position, STATE_DEGREES - 1),
        ("NEES of yaw", against.nees_yaw, 1),
    ]


def sentences(found: Evaluation, *, by_sensor: bool = True) -> list[str]:
    """Return the verdicts as lines: NEES, NIS, and what does not belong together.

    Args:
        found: the evaluation.
        by_sensor: whether each sensor has a line of its own, and position and yaw, too.
    """
    said = []
    if found.truth is not None:
        whole, *parts = nees_of(found.truth)
        shown = [whole, *(part for part in parts if by_sensor and part[1].size)]
        said += [f"{name}: {_with_band(each, expected)}" for name, each, expected in shown]
    if found.nis.size:
        said.append(f"NIS: {_with_band(found.nis, 1, 'innovations')}")
    for name, sensor in found.sensors.items() if by_sensor else ():
        white = sensor.whiteness
        word = "white" if white.white else "not white"
        counted = sensor.rejected and name != FIX_YAW
        share = f", {sensor.rejected_share:.1%} rejected" if counted else ""
        said.append(
            f"NIS of {name}: {_with_band(sensor.consistency, 1, 'innovations')}; {word} "
            f"(lag 1: {white.lag_one:.2f}, band +-{white.band:.2f}){share}"
        )
    if found.truth is not None:
        said += [f"warning: {text}" for text in found.truth.warnings]
    return said


def _with_band(found: Consistency, expected: int, whose: str = "errors") -> str:
    if not found.size:
        return "not known"
    mean, low, high = (expected * value for value in (found.ratio, found.low, found.high))
    return f"{number(mean)} ({low:.2f} to {high:.2f} if honest), {in_words(found, whose)}"


def number(value: float) -> str:
    """Return a mean of squares with two decimals, or with an exponent from a million on."""
    return f"{value:.2f}" if value < 1e6 else f"{value:.2e}"


def plain(found: Evaluation) -> dict[str, Any]:
    """Return all numbers as JSON can hold them; null where a number is not known."""
    content: dict[str, Any] = {}
    against = found.truth
    if against is not None:
        content["count"] = against.errors.poses
        for name, label in (("x", "x"), ("y", "y"), ("yaw", "theta"), ("position", "position")):
            sizes: Statistics = getattr(against.errors, name)
            content |= {f"{key}_{label}": value for key, value in sizes._asdict().items()}
        content["mean_nees"] = STATE_DEGREES * against.nees.ratio
        relative = against.relative
        content |= {
            "alignment": {"mode": str(against.alignment), **against.motion._asdict()},
            "ate": against.errors.position._asdict(),
            "rpe": {
                "delta": str(relative.delta), "pairs": relative.pairs,
                "translation": relative.translation._asdict(),
                "rotation": relative.rotation._asdict(),
            },
            **{
                name.lower().replace(" of ", "_"): plain_consistency(each, expected)
                for name, each, expected in nees_of(against)
            },
            "warnings": list(against.warnings),
        }  # fmt: skip
    content["nis"] = plain_consistency(found.nis, 1)
    content["sensors"] = {
        name: {
            "nis": plain_consistency(sensor.consistency, 1),
            "lag_one": sensor.whiteness.lag_one,
            "lag_one_band": sensor.whiteness.band,
            "white": sensor.whiteness.white,
            "readings": sensor.readings,
            "rejected": sensor.rejected,
        }
        for name, sensor in found.sensors.items()
    }
    finite: dict[str, Any] = without_nan(content)
    return finite


def plain_run(run: RunRecord) -> dict[str, Any]:
    """Return how long a run was, how smooth, and how it was, as JSON can hold it."""
    worst = run.worst_status()
    moved = corrections(run)
    found: dict[str, Any] = without_nan(
        {
            "odom": len(run.track.time_ns),
            "duration_s": float(run.track.time_ns[-1] - run.track.time_ns[0]) * 1e-9,
            "distance": distance_driven(run.track),
            "fixes": None if run.fixes is None else len(run.fixes.time_ns),
            "corrections": {"rms": moved.rmse, "max": moved.max},
            "worst_status": None if worst is None else worst._asdict(),
        }
    )
    return found


def distance_driven(track: Trajectory) -> float:
    """Return the length of a track [m]."""
    return float(np.sum(np.hypot(*np.diff(track.pose[:, :2], axis=0).T)))


def plain_consistency(found: Consistency, expected: int) -> dict[str, Any]:
    """Return a consistency by key, its mean and band in multiples of what is expected."""
    return {
        "mean": expected * found.ratio,
        "expected": expected,
        "band": [expected * found.low, expected * found.high],
        "count": found.size,
        "independent": found.independent,
        "verdict": str(found.verdict),
    }


def without_nan(content: Any) -> Any:
    """Return a tree with None in place of what is no finite number."""
    if isinstance(content, dict):
        return {key: without_nan(value) for key, value in content.items()}
    if isinstance(content, list | tuple):
        return [without_nan(value) for value in content]
    if isinstance(content, float) and not math.isfinite(content):
        return None
    return content
