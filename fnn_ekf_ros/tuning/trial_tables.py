# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The tables of `study tune`."""

import math
from collections.abc import Sequence

import numpy as np

from fnn_ekf_ros.study.report.tables import table
from fnn_ekf_ros.tuning.recorded import Recorded
from fnn_ekf_ros.tuning.trials import KINDS, Found, Halves, Trial

HOW_TO_READ = """\
The search begins with Q twice too large and R twice too small in standard deviation. Error: of the
value that was found, root mean square and largest over the robots, relative to the true value; in
rad or s for offsets and delays. Stated: the mean standard error that `tune` gives, but for values
at a bound. Covered: robots whose 95 % interval has the true value in it. Right model: robots of
which `tune` says rightly whether errors last.
"""
"""Explains the table of simulated robots."""
HOW_TO_READ_RECORDINGS = """\
Position RMSE over the ground truth, relative to the best of 25 fixed EKFs with the shipped gate,
chosen in hindsight: of a plain EKF with that gate and the noise that `tune` writes, and of the
fitted filter that follows lasting errors.
"""
"""Explains the table of recordings."""


HOW_TO_READ_HALVES = """\
Halves: what the noise of the first half of a drive loses of the second half's objective, in nats
with the weights of its fit, and relative to its size at the optimum of the same model; and the one
of its quantities in which the two halves differ most, in standard errors of the difference: 2 are
usual where the noise does not change. Halves with too few fixes are left out.
"""
"""Explains the table of halves."""


def trial_table(names: Sequence[str], trials: Sequence[Trial]) -> str:
    """Return the results of simulated robots in Markdown."""
    lines = []
    for name in names:
        own = [trial for trial in trials if trial.kind == name]
        right = sum(trial.errors_last == bool(KINDS[name].faults) for trial in own)
        for quantity in dict.fromkeys(each.quantity for trial in own for each in trial.found):
            found = [each for trial in own for each in trial.found if each.quantity == quantity]
            lines.append([name, f"{right} of {len(own)}", quantity, *_cells(found)])
    return table(
        ["robots", "right model", "quantity", "error, rms", "largest", "stated", "covered"], lines
    )


def _cells(found: Sequence[Found]) -> list[str]:
    errors = np.array([each.error for each in found])
    stds = [each.std for each in found if math.isfinite(each.std)]
    return [
        f"{float(np.sqrt(np.mean(errors**2))):.4f}",
        f"{float(np.max(np.abs(errors))):.4f}",
        f"{float(np.mean(stds)):.4f}" if stds else "-",
        f"{sum(each.covered for each in found)} of {len(found)}",
    ]


def recorded_table(found: Sequence[Recorded]) -> str:
    """Return the results of recordings in Markdown."""
    return table(
        ["recording", "best EKF [m]", "plain EKF", "with lasting errors", "errors last",
         "decided by"],
        [
            [
                each.label,
                f"{each.best_position:.4g}",
                f"{each.plain:.3f}",
                f"{each.lasting:.3f}",
                "yes" if each.errors_last else "no",
                each.decided_by,
            ]
            for each in found
        ],
    )  # fmt: skip


def halves_table(found: Sequence[tuple[str, Halves]]) -> str:
    """Return how halves compare, by the name of what they are of, in Markdown."""
    return table(
        ["drive", "lost [nats]", "lost", "differs most", "standard errors"],
        [
            [
                name,
                f"{each.loss_nats:.1f}",
                f"{each.loss:+.2%}",
                each.most_different or "-",
                f"{each.standard_errors:.1f}",
            ]
            for name, each in found
        ],
    )


def summary(trials: Sequence[Trial]) -> str:
    """Return in one line how many intervals cover the true value."""
    found = [each for trial in trials for each in trial.found]
    covered = sum(each.covered for each in found)
    return f"{len(trials)} robots, {covered} of {len(found)} intervals have the true value in them"
