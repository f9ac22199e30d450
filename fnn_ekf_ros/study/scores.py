# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Errors of estimates, beside an oracle that knows the true noise, and their consistency.

Errors of a run are correlated in time, runs are independent: every confidence interval is taken
over the runs, never over the steps.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from fnn_ekf_ros.core.arrays import STATE_SIZE, FloatArray
from fnn_ekf_ros.evaluation.intervals import (
    Interval,
    chi_square_band,
    mean_interval,
    root_ratio_interval,
)
from fnn_ekf_ros.study.recording import Estimates
from fnn_ekf_ros.timeline.trajectory import pose_errors

LOST_FACTOR = 10.0
"""Largest position error of a run that has not diverged, in multiples of the oracle's RMS error."""


class Errors(NamedTuple):
    """Estimates held against the truth.

    Attributes:
        error: `(T, ..., n, 3)` estimate minus truth, yaw wrapped (m, m, rad).
        nees: `(T, ..., n)` e' P^-1 e.
        nis: `(T, ..., n)` normalized innovation squared.
        degrees_of_freedom: `(T, ..., n)` of `nis`.
    """

    error: FloatArray
    nees: FloatArray
    nis: FloatArray
    degrees_of_freedom: FloatArray


class Score(NamedTuple):
    """Scores of a batch of runs over some steps; the leading dimensions are the estimates'.

    Attributes:
        rmse: `(..., 3)` mean over the runs of each run's root mean square error (m, m, rad).
        ratio: `(..., 3)` root mean square error of all runs as a ratio to the oracle's.
        nees: `(...)` mean; 3 where the covariance is consistent.
        nees_inside: `(...)` share of the steps at which the mean over the runs is inside its 95 %
            chi-square band; 0.95 where the covariance is consistent.
        nees_band: that band.
        nis: `(...)` sum of NIS over the sum of its degrees of freedom; 1 where the filter expects
            what it sees; NaN where it sees nothing.
        nis_band: `(..., 2)` 95 % chi-square band of `nis`; innovations are white, so every one
            of them counts.
        diverged: `(...)` share of the runs whose position was off, once at least, by more than
            `LOST_FACTOR` times the oracle's root mean square position error, or not finite.
    """

    rmse: Interval
    ratio: Interval
    nees: Interval
    nees_inside: FloatArray
    nees_band: tuple[float, float]
    nis: FloatArray
    nis_band: FloatArray
    diverged: FloatArray


def compare(estimates: Estimates, truth: FloatArray) -> Errors:
    """Return the errors of estimates.

    Args:
        estimates: `(T, ..., n)`.
        truth: `(T + 1, n, 3)` true poses, the start first (m, m, rad).
    """
    true_pose = truth[1:].reshape(
        len(truth) - 1, *(1,) * (estimates.mean.ndim - 3), *truth.shape[1:]
    )  # fmt: skip
    error = pose_errors(estimates.mean, true_pose)
    nees = np.sum(error * np.linalg.solve(estimates.covariance, error[..., None])[..., 0], axis=-1)
    return Errors(
        error=error, nees=nees, nis=estimates.nis, degrees_of_freedom=estimates.degrees_of_freedom
    )


def rms_over_runs(errors: Errors) -> FloatArray:
    """Return the root mean square over the runs at each step, `(T, ..., 3)` (m, m, rad)."""
    rms: FloatArray = np.sqrt(np.mean(errors.error**2, axis=-2))
    return rms


def score(errors: Errors, oracle: Errors, steps: slice) -> Score:
    """Return the score over some steps.

    Args:
        errors: `(T, ..., n)` of the filter.
        oracle: `(T, n)` of the filter that knows the true noise, on the same recordings.
        steps: the steps that count.
    """
    runs = oracle.error.shape[-2]
    e, best = errors.error[steps], oracle.error[steps]
    square, best_square = (np.swapaxes(np.mean(a**2, axis=0), -1, -2) for a in (e, best))

    low, high = chi_square_band(np.array(STATE_SIZE * runs))
    band = (STATE_SIZE * float(low), STATE_SIZE * float(high))
    nees = errors.nees[steps]
    over_runs = np.mean(nees, axis=-1)
    inside = np.mean((over_runs >= band[0]) & (over_runs <= band[1]), axis=0)

    dof = np.sum(errors.degrees_of_freedom[steps], axis=(0, -1))
    dof = np.where(dof > 0.0, dof, np.nan)
    nis = np.sum(errors.nis[steps], axis=(0, -1)) / dof
    nis_band = np.stack(chi_square_band(dof), axis=-1)

    limit = LOST_FACTOR * np.sqrt(np.mean(np.sum(best[..., :2] ** 2, axis=-1)))
    furthest = np.max(np.hypot(e[..., 0], e[..., 1]), axis=0)  # NaN if any is NaN
    return Score(
        rmse=mean_interval(np.sqrt(square)),
        ratio=root_ratio_interval(square, best_square),
        nees=mean_interval(np.mean(nees, axis=0)),
        nees_inside=inside,
        nees_band=band,
        nis=nis,
        nis_band=nis_band,
        diverged=np.mean(~(furthest <= limit), axis=-1),
    )


def join_scores(parts: Sequence[Score]) -> Score:
    """Return the score of several batches of estimates as one, along the first of their dimensions.

    Args:
        parts: with the same runs and steps; at least one, each with a leading dimension.
    """
    return Score(
        rmse=_join_intervals([part.rmse for part in parts]),
        ratio=_join_intervals([part.ratio for part in parts]),
        nees=_join_intervals([part.nees for part in parts]),
        nees_inside=np.concatenate([part.nees_inside for part in parts]),
        nees_band=parts[0].nees_band,
        nis=np.concatenate([part.nis for part in parts]),
        nis_band=np.concatenate([part.nis_band for part in parts]),
        diverged=np.concatenate([part.diverged for part in parts]),
    )


def _join_intervals(parts: Sequence[Interval]) -> Interval:
    return Interval(
        value=np.concatenate([part.value for part in parts]),
        low=np.concatenate([part.low for part in parts]),
        high=np.concatenate([part.high for part in parts]),
    )
