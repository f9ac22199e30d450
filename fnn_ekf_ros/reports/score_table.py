# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Scores of trajectories as a table and as JSON."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict

from fnn_ekf_ros.recordings.scoring import Score

_ROW = "{:<28} {:>7} {:>9} {:>9} {:>11} {:>13} {:>9}"
"""Format of a row of the table."""


def format_table(scores: Mapping[str, Score]) -> str:
    """Return the scores as a table, one line for each run."""
    lines = [
        _ROW.format("run", "odoms", "RMSE x", "RMSE y", "RMSE theta", "RMSE position", "mean NEES"),
        _ROW.format("", "", "[m]", "[m]", "[rad]", "[m]", "(3)"),
    ]
    lines += [
        _ROW.format(label, s.count, *_texts(s.rmse_x, s.rmse_y, s.rmse_theta, s.rmse_position),
                    "n/a" if math.isnan(s.mean_nees) else f"{s.mean_nees:.2f}")
        for label, s in scores.items()
    ]  # fmt: skip
    return "\n".join(lines)


def _texts(*values: float) -> Sequence[str]:
    return ["n/a" if math.isnan(value) else f"{value:.4f}" for value in values]


def plain_scores(scores: Mapping[str, Score]) -> dict[str, dict[str, float | None]]:
    """Return the scores as JSON can hold them; null where a number is not known."""
    return {
        label: {
            key: None if isinstance(value, float) and math.isnan(value) else value
            for key, value in asdict(s).items()
        }
        for label, s in scores.items()
    }
