# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Results of `study real` as Markdown and as rows for JSON."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from fnn_ekf_ros.core.arrays import STATE_SIZE, FloatArray, Row
from fnn_ekf_ros.study.filters import EKF_GATED
from fnn_ekf_ros.study.real_bags import BagResult, FilterResult
from fnn_ekf_ros.study.report.tables import GATES, command_head, factor_words, plain, table
from fnn_ekf_ros.study.scores import LOST_FACTOR
from fnn_ekf_ros.study.starts import ALL_CELLS, FACTORS

HOW_TO_READ = f"""\
q, k: configured variance of Q and of R at the start, over that of the parameters.
All filters see the periods of the localizer itself, late inputs in their place, and start
from the first pose that was measured, with P = R of their start. RMSE: over the estimates for which
the ground truth is known, nothing aligned. Best, median, worst: of the {len(ALL_CELLS)} starts.
Ratio: to the best EKF with gate, from the start of its {len(ALL_CELLS)} that is best in position,
which takes a ground truth to find; the yaw ratio is to the yaw RMSE of that same EKF.
NEES: median and mean over time, of the median start, and (from - to) the medians of all starts.
Where the covariance is consistent the median is 2.37 and the mean 3; of x and y alone, where the
truth has no yaw, 1.39 and 2. More: the covariance is too small. Diverged: share of the starts from
which the position was off, once at least, by more than {LOST_FACTOR:g} times the RMSE of that EKF.
{GATES}

Noise in use at the end: median over the starts and (from - to), standard deviations. EKF with it:
position RMSE of EKFs with gate that run on the noise each start ended with, from begin to end.
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
                    "ratio": plain(each.score.position[index] / result.reference.position),
                    "furthest": plain(each.score.furthest[index]),
                    "median_nees": plain(each.score.median_nees[index]),
                    "mean_nees": plain(each.score.mean_nees[index]),
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
    reference, cell = result.reference, ALL_CELLS[result.reference.start]
    about["reference"] = {
        "filter": EKF_GATED, "q": cell.q, "k": cell.k,
        "rmse_position": plain(reference.position), "rmse_theta": plain(reference.yaw),
    }  # fmt: skip
    return {
        **about,
        "rows": [row.name.lower() for row in result.rows],
        "summary": [_plain_values(row) for row in summary_rows(result)],
        "results": found,
    }


class SummaryRow(NamedTuple):
    """A filter on a recording, over its starts; infinite where it was lost.

    Attributes:
        filter: its name.
        best_position: position RMSE of the best start [m].
        median_position: of the median start [m].
        worst_position: of the worst start [m].
        best_ratio: of the best start to the reference.
        median_ratio: of the median start to the reference.
        worst_ratio: of the worst start to the reference.
        median_yaw: yaw RMSE of the median start [rad]; NaN if truth has none.
        yaw_ratio: its ratio to the reference's.
        median_nees: median over the starts of the median over time.
        mean_nees: median over the starts of the mean over time.
        nees_size: 3, or 2 where NEES is of x and y alone.
    """

    filter: str
    best_position: float
    median_position: float
    worst_position: float
    best_ratio: float
    median_ratio: float
    worst_ratio: float
    median_yaw: float
    yaw_ratio: float
    median_nees: float
    mean_nees: float
    nees_size: int


class AcrossRow(NamedTuple):
    """A filter over several recordings.

    Attributes:
        filter: its name.
        recordings: how many.
        median_ratio: geometric mean of the ratios of the median start.
        worst_ratio: geometric mean of the ratios of the worst start.
        recordings_with_yaw: how many have a true yaw.
        yaw_ratio: geometric mean over these; NaN without any.
    """

    filter: str
    recordings: int
    median_ratio: float
    worst_ratio: float
    recordings_with_yaw: int
    yaw_ratio: float


def summary_rows(result: BagResult) -> list[SummaryRow]:
    """Return a recording's summary, in the order of the filters."""
    found = []
    for each in result.filters:
        score, best = each.score, result.reference
        low, middle, high = (float(of(score.position)) for of in (np.min, np.median, np.max))
        yaw = float(np.median(score.rmse[:, STATE_SIZE - 1]))
        found.append(
            SummaryRow(
                filter=each.name,
                best_position=low,
                median_position=middle,
                worst_position=high,
                best_ratio=low / best.position,
                median_ratio=middle / best.position,
                worst_ratio=high / best.position,
                median_yaw=yaw,
                yaw_ratio=yaw / best.yaw,
                median_nees=float(np.median(score.median_nees)),
                mean_nees=float(np.median(score.mean_nees)),
                nees_size=score.nees_size,
            )
        )
    return found


def across_rows(results: Sequence[BagResult]) -> list[AcrossRow]:
    """Return the summary over recordings that the same filters ran on."""
    found = []
    for rows_of_filter in zip(*map(summary_rows, results), strict=True):
        yaw = [row.yaw_ratio for row in rows_of_filter if not np.isnan(row.yaw_ratio)]
        found.append(
            AcrossRow(
                filter=rows_of_filter[0].filter,
                recordings=len(rows_of_filter),
                median_ratio=_geometric_mean([row.median_ratio for row in rows_of_filter]),
                worst_ratio=_geometric_mean([row.worst_ratio for row in rows_of_filter]),
                recordings_with_yaw=len(yaw),
                yaw_ratio=_geometric_mean(yaw) if yaw else np.nan,
            )
        )
    return found


def across_numbers(results: Sequence[BagResult]) -> list[dict[str, Any]]:
    """Return the summary over recordings for JSON; null for no number."""
    return [_plain_values(row) for row in across_rows(results)]


def _plain_values(row: SummaryRow | AcrossRow) -> dict[str, Any]:
    return {
        name: plain(value) if isinstance(value, float) else value
        for name, value in row._asdict().items()
    }


def _geometric_mean(values: Sequence[float]) -> float:
    return float(np.exp(np.mean(np.log(values))))


def real_tables(made_by: Mapping[str, Any], results: Sequence[BagResult]) -> str:
    """Return all of `results.md`.

    Args:
        made_by: version, filters and the parameters that were given.
        results: of the recordings.
    """
    bags = " ".join(result.label for result in results)
    options = {"filters": ",".join(made_by["filters"])}
    if results[0].taught_by:
        options["state-file"] = results[0].taught_by
    parts = [command_head(made_by, options, HOW_TO_READ, bags)]
    if len(results) > 1:
        parts += [f"## All {len(results)} recordings\n", _across(results)]
    for result in results:
        parts += [f"## {result.label}\n", _about(result), _summary(result), _noise(result)]
        for each in result.filters:
            parts.append(f"### {each.label}, {result.label}: position RMSE [m] (ratio)\n")
            parts.append(_cells(each, result.reference.position))
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
        f"[m] {distance:g}, rotation [rad] {rotation:g} in 375 ms; {measured}.{_teacher(result)}\n"
    )


def _teacher(result: BagResult) -> str:
    """Return whom the filters learned from before, as a sentence."""
    if not result.taught_by:
        return ""
    return (
        f" Filters that adapt start with what {result.taught_by} taught them: noise in place of q "
        "and k, and how much of the errors lasts."
    )


def _across(results: Sequence[BagResult]) -> str:
    lines = [
        [
            each.label, _ratio(row.median_ratio), _ratio(row.worst_ratio),
            "n/a" if np.isnan(row.yaw_ratio) else _ratio(row.yaw_ratio),
            str(row.recordings_with_yaw),
        ]
        for each, row in zip(results[0].filters, across_rows(results), strict=True)
    ]  # fmt: skip
    names = [
        "geometric means", "ratio, median", "ratio, worst", "yaw ratio, median",
        "recordings with a true yaw",
    ]  # fmt: skip
    return table(names, lines)


def _summary(result: BagResult) -> str:
    lines = []
    for each, row in zip(result.filters, summary_rows(result), strict=True):
        cell = ALL_CELLS[int(np.argmax(each.score.position))]
        lines.append(
            [
                each.label,
                *(f"{v:.4f}" for v in (row.best_position, row.median_position, row.worst_position)),
                f"{factor_words(cell.q)}, {factor_words(cell.k)}",
                *(_ratio(value) for value in (row.best_ratio, row.median_ratio, row.worst_ratio)),
                _text(row.median_yaw),
                "n/a" if np.isnan(row.yaw_ratio) else _ratio(row.yaw_ratio),
                _with_range(each.score.median_nees),
                f"{row.mean_nees:.3g}",
                f"{np.mean(each.diverged):.0%}",
            ]
        )
    nees = "NEES" if result.filters[0].score.nees_size == STATE_SIZE else "NEES of x, y"
    names = [
        "filter", "best [m]", "median [m]", "worst [m]", "its q, k", "ratio, best",
        "ratio, median", "ratio, worst", "yaw, median [rad]", "yaw ratio, median",
        f"{nees}, median", f"{nees}, mean", "diverged",
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
