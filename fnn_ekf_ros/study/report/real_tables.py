# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Results of `study real` as Markdown and as rows for JSON."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from fnn_ekf_ros.core.arrays import FloatArray, Row
from fnn_ekf_ros.study.real_bags import BagResult, FilterResult
from fnn_ekf_ros.study.report.tables import GATES, command_head, factor_words, plain, table
from fnn_ekf_ros.study.scores import LOST_FACTOR
from fnn_ekf_ros.study.starts import ALL_CELLS, FACTORS

HOW_TO_READ = f"""\
q, k: configured variance of Q and of R at the start, over that of the parameters.
All filters see the periods of the localizer itself, late inputs in their place, and start
from the first pose that was measured, with P = R of their start. RMSE: of the position, over the
estimates for which the ground truth is known, nothing aligned. Median, worst: over the starts.
Ratio: to the EKF from the best of its {len(ALL_CELLS)} starts, which takes a ground truth to find.
NEES: median over time, of the median start and (from - to) of all; 2.37 where the covariance is
consistent, more where it is too small. Diverged: share of the starts from which the position was
off, once at least, by more than {LOST_FACTOR:g} times the RMSE of the best EKF.
{GATES}

Noise in use at the end: median over the starts and (from - to), standard deviations. EKF with it:
position RMSE of EKFs that run on the noise each start ended with, from begin to end.
"""
"""Explains the tables."""
_ROW_WORDS = {
    Row.X: "x [m]",
    Row.Y: "y [m]",
    Row.COMPASS_YAW: "compass yaw [rad]",
    Row.LRF_YAW: "laser yaw [rad]",
}
"""Names and units of the measured rows."""


def rows(result: BagResult) -> dict[str, Any]:
    """Return a recording's numbers, one row for each filter and start; null for no number.

    RMSE in m, m, rad; standard deviations in the order of `Row` (m, m, rad, rad).
    """
    found = []
    for each in result.filters:
        for index, cell in enumerate(ALL_CELLS):
            x, y, theta = (plain(value) for value in each.score.rmse[index])
            found.append(
                {
                    "filter": each.name, "q": cell.q, "k": cell.k,
                    "rmse_x": x, "rmse_y": y, "rmse_theta": theta,
                    "rmse_position": plain(each.score.position[index]),
                    "ratio": plain(each.score.position[index] / result.best_position),
                    "furthest": plain(each.score.furthest[index]),
                    "median_nees": plain(each.score.median_nees[index]),
                    "diverged": bool(each.diverged[index]),
                    "end_process_noise_std": [plain(v) for v in each.process_noise_std[index]],
                    "end_measurement_noise_std": [
                        plain(v) for v in each.measurement_noise_std[index]
                    ],
                    "rmse_position_with_noise_found": plain(each.position_with_noise_found[index]),
                }
            )  # fmt: skip
    about = result._asdict()
    del about["filters"]
    return {**about, "rows": [row.name.lower() for row in result.rows], "results": found}


def real_tables(made_by: Mapping[str, Any], results: Sequence[BagResult]) -> str:
    """Return all of `results.md`.

    Args:
        made_by: version, filters and the parameters that were given.
        results: of the recordings.
    """
    bags = " ".join(result.label for result in results)
    options = {"filters": ",".join(made_by["filters"])}
    parts = [command_head(made_by, options, HOW_TO_READ, bags)]
    for result in results:
        parts += [f"## {result.label}\n", _about(result), _summary(result), _noise(result)]
        for each in result.filters:
            parts.append(f"### {each.label}, {result.label}: position RMSE [m] (ratio)\n")
            parts.append(_cells(each, result.best_position))
    return "\n".join(parts)


def _about(result: BagResult) -> str:
    files = ", ".join(result.parameter_files) or "none"
    distance, rotation = result.process_noise_std
    measured = ", ".join(
        f"{_ROW_WORDS[row]} {result.measurement_noise_std[row]:g}" for row in result.rows
    )
    return (
        f"{result.duration_s:.0f} s, {result.estimates} estimates, {result.scored} with a known "
        f"truth. Parameter files: {files}. q = k = 1 stands for standard deviations of distance "
        f"[m] {distance:g}, rotation [rad] {rotation:g} in 375 ms; {measured}.\n"
    )


def _summary(result: BagResult) -> str:
    lines = []
    for each in result.filters:
        position = each.score.position
        worst = int(np.argmax(position))
        cell = ALL_CELLS[worst]
        lines.append(
            [
                each.label, f"{np.min(position):.4f}", f"{np.median(position):.4f}",
                f"{position[worst]:.4f}", f"{factor_words(cell.q)}, {factor_words(cell.k)}",
                *(_ratio(value / result.best_position) for value in _middle_and_worst(position)),
                *(_text(value) for value in _middle_and_worst(each.score.rmse[:, 2])),
                _with_range(each.score.median_nees),
                f"{np.mean(each.diverged):.0%}",
            ]
        )  # fmt: skip
    names = [
        "filter", "best [m]", "median [m]", "worst [m]", "its q, k", "ratio, median",
        "ratio, worst", "yaw, median [rad]", "yaw, worst [rad]", "NEES", "diverged",
    ]  # fmt: skip
    return table(names, lines)


def _noise(result: BagResult) -> str:
    """Return the noise in use at the end, of the filters that adapt it."""
    lines = [
        [
            each.label,
            *(_with_range(each.process_noise_std[:, index]) for index in range(2)),
            *(_with_range(each.measurement_noise_std[:, row]) for row in result.rows),
            *(f"{value:.4f}" for value in _middle_and_worst(each.position_with_noise_found)),
        ]
        for each in result.filters
    ]
    names = [
        "noise in use at the end", "distance [m]", "rotation [rad]",
        *(_ROW_WORDS[row] for row in result.rows),
        "EKF with it, median [m]", "EKF with it, worst [m]",
    ]  # fmt: skip
    return table(names, lines)


def _cells(each: FilterResult, best: float) -> str:
    size = len(FACTORS)
    texts = [f"{value:.4f} ({_ratio(value / best)})" for value in each.score.position]
    return table(
        ["", *(f"k = {factor_words(k)}" for k in FACTORS)],
        [
            [f"q = {factor_words(q)}", *texts[row * size : (row + 1) * size]]
            for row, q in enumerate(FACTORS)
        ],
    )


def _middle_and_worst(values: FloatArray) -> tuple[float, float]:
    return float(np.median(values)), float(np.max(values))


def _with_range(values: FloatArray) -> str:
    if np.any(np.isnan(values)):
        return "n/a"
    return f"{np.median(values):.3g} ({np.min(values):.3g} - {np.max(values):.3g})"


def _text(value: float) -> str:
    return "n/a" if np.isnan(value) else f"{value:.3f}"


def _ratio(value: float) -> str:
    return f"{value:.2f}" if value < 100.0 else f"{value:.3g}"
