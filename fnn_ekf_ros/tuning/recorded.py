# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Tuning of recordings with a ground truth: what a plain EKF makes of the noise that is found."""

from typing import NamedTuple

import numpy as np

from fnn_ekf_ros.core.arrays import FloatArray
from fnn_ekf_ros.study.ablations import real_filters
from fnn_ekf_ros.study.filters import EKF_GATED, FIXED
from fnn_ekf_ros.study.real import batch_start, collect, run_starts, score_starts
from fnn_ekf_ros.study.real_bags import RealRecording, run_filters
from fnn_ekf_ros.study.starts import RIGHT
from fnn_ekf_ros.tuning.fit import Progress
from fnn_ekf_ros.tuning.forecasts import poses
from fnn_ekf_ros.tuning.recording import TuningRecording, prepare
from fnn_ekf_ros.tuning.trials import Halves, compare_halves
from fnn_ekf_ros.tuning.tune import tune

SAME_INSTANT_S = 1e-6
"""Largest difference of two times of one instant [s]: sums of durations are rounded."""


class Recorded(NamedTuple):
    """A recording that was tuned; position RMSE relative to the best of 25 fixed EKFs.

    Attributes:
        label: its name.
        best_position: RMSE of the best fixed EKF, which takes a ground truth to find [m].
        plain: of an EKF with the gate and the noise that was found.
        lasting: of the fitted filter that follows lasting errors.
        errors_last: whether errors are said to last.
        decided_by: what the fit that is shown goes by.
        halves: its halves beside each other, where that was asked for and can be told.
    """

    label: str
    best_position: float
    plain: float
    lasting: float
    errors_last: bool
    decided_by: str
    halves: Halves | None = None


def tune_recording(
    recording: RealRecording, progress: Progress, *, with_halves: bool = False
) -> Recorded:
    """Tune a recording and score what was found.

    Args:
        recording: with its truth.
        progress: is told what is being done.
        with_halves: whether both halves of it are tuned, too, and compared.
    """
    best = run_filters(recording, FIXED).reference.position
    start = batch_start(recording.parameters, recording.periods, [RIGHT])
    prepared = prepare(recording.label, recording.parameters, start)
    tuned = tune([prepared], calibrates=False, progress=progress)
    plain_start = batch_start(tuned.after, recording.periods, [RIGHT])
    model = real_filters(tuned.after)[EKF_GATED].model
    plain = score_starts(collect(run_starts(model, plain_start)), recording.truth).position[0]
    of_lasting = poses(prepared, tuned.lasting.fit.values[:, None]).mean[..., 0]
    errors = _errors(recording, prepared, of_lasting)
    fit = tuned.shown.fit
    return Recorded(
        label=recording.label,
        best_position=best,
        plain=float(plain) / best,
        lasting=float(np.sqrt(np.mean(errors**2))) / best,
        errors_last=tuned.errors_last,
        decided_by="next readings" if fit.trusts_next_readings else "outages",
        halves=compare_halves(prepared, progress) if with_halves else None,
    )


def _errors(recording: RealRecording, prepared: TuningRecording, mean: FloatArray) -> FloatArray:
    """Return the distances to the truth at the ends of the periods, where it is known [m]."""
    batch = recording.batch
    ends_s = 1e-9 * (np.array(batch.stamps_ns) - batch.stamps_ns[-1])
    times_s = np.cumsum(prepared.duration_s)
    times_s -= times_s[-1]
    at = np.clip(np.searchsorted(times_s, ends_s - SAME_INSTANT_S), 0, len(times_s) - 1)
    distance = np.hypot(*(mean[at, :2] - recording.truth[1:, :2]).T)
    found: FloatArray = distance[np.isfinite(distance)]
    return found
