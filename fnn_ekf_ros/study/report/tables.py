# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Results of the studies as Markdown and as rows for JSON."""

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from fnn_ekf_ros.core.arrays import FloatArray
from fnn_ekf_ros.evaluation.intervals import Interval
from fnn_ekf_ros.study import dynamic, grid, paper
from fnn_ekf_ros.study.scores import LOST_FACTOR, Score
from fnn_ekf_ros.study.starts import FACTORS, RIGHT, Cell
from fnn_ekf_ros.study.trials import Outcome

Labels = Mapping[str, str]
"""Labels of the filters, by name."""
AXES = ("x", "y", "theta")
"""Names of the axes of a pose."""
GATES = (
    "*FNN-EKF joint* and *EKF with gate* reject outliers as the localizer ships; the others, the "
    "paper's filters too, take every reading."
)
"""Says which filters of the studies have a gate."""
HOW_TO_READ = f"""\
Q / 25, R x 25: the filter starts with a 25th of the true variance of Q and with 25 times that of
R; q and k are these two factors. RMSE: mean over the runs of each run's. Ratio: RMSE of all runs
over that of the oracle, an EKF with the true Q and R of each step; x / y / theta. NEES: 3
where the covariance is consistent; inside: share of the steps at which its mean over the runs lies
in the 95 % chi-square band. NIS: per degree of freedom, 1 where innovations are as expected.
Diverged: share of the runs whose position was once off by more than {LOST_FACTOR:g} times the
oracle's RMSE. In brackets: 95 % confidence intervals over the runs.
{GATES}
"""
"""Explains the tables."""


def head(made_by: Mapping[str, Any]) -> str:
    """Return the first lines of the tables of `study paper`, `grid` and `dynamic`."""
    options = {name: made_by[name] for name in ("runs", "steps", "seed")}
    options["filters"] = ",".join(made_by["filters"])
    return command_head(made_by, options, HOW_TO_READ)


def command_head(
    made_by: Mapping[str, Any], options: Mapping[str, Any], how_to_read: str, inputs: str = ""
) -> str:
    """Return the first lines of a study's tables: how they were made and how they are read.

    Args:
        made_by: the study's name, the version, the parameters that were given.
        options: of the command, by name; empty for one that has no value.
        how_to_read: explains the tables.
        inputs: arguments of the command before its options.
    """
    words = "".join(f" --{name} {value}".rstrip() for name, value in options.items())
    given = "".join(f" -p {name}:={value}" for name, value in made_by["parameters"].items())
    name = made_by["study"]
    command = f"study {name}{inputs and f' {inputs}'}{words}{given}"
    return f"# study {name}\n\nfnn_ekf_ros {made_by['version']}: `{command}`\n\n{how_to_read}"


def rows(outcomes: Sequence[Outcome]) -> list[dict[str, Any]]:
    """Return one row for each trial, filter, start and range; null where there is no number.

    Intervals are [value, low, high]; RMSE in m, m, rad.
    """
    found = []
    for outcome in outcomes:
        for index, cell in enumerate(outcome.cells):
            for name, score in outcome.scores.items():
                row: dict[str, Any] = {
                    "trial": outcome.trial, "filter": outcome.filter,
                    "q": cell.q, "k": cell.k, "range": name,
                }  # fmt: skip
                for axis, word in enumerate(AXES):
                    row[f"rmse_{word}"] = plain_interval(score.rmse, (index, axis))
                    row[f"ratio_{word}"] = plain_interval(score.ratio, (index, axis))
                row["nees"] = plain_interval(score.nees, (index,))
                row["nees_inside"] = plain(score.nees_inside[index])
                row["nees_band"] = list(score.nees_band)
                row["nis_per_dof"] = plain(score.nis[index])
                row["nis_band"] = [plain(end) for end in score.nis_band[index]]
                row["diverged"] = plain(score.diverged[index])
                found.append(row)
    return found


def paper_tables(outcomes: Sequence[Outcome], labels: Labels) -> str:
    """Return one table for each trial, start and range; then which figure shows what."""
    parts = []
    for trial, title in paper.TRIALS.items():
        for cell in paper.STARTS:
            for name in _ranges(outcomes):
                parts.append(f"## {title.capitalize()}, {start_words(cell)}, {range_words(name)}\n")
                parts.append(
                    table(
                        ["filter", "RMSE x [m]", "RMSE y [m]", "RMSE theta [rad]", "ratio",
                         "NEES", "inside", "NIS", "diverged"],
                        [
                            [labels[outcome.filter], *_paper_row(outcome.scores[name], index)]
                            for outcome, index in _at(outcomes, trial, cell)
                        ],
                    )
                )  # fmt: skip
    return "\n".join(["", *parts])


def grid_tables(outcomes: Sequence[Outcome], labels: Labels) -> str:
    """Return for each simulation and range a summary, and all 25 starts of each filter."""
    parts = []
    for trial, title in grid.SIMULATIONS.items():
        tried = [o for o in outcomes if o.trial == trial and len(o.cells) > 1]
        for name in _ranges(outcomes):
            parts.append(f"## {title.capitalize()}, {range_words(name)}: all starts\n")
            parts.append(
                table(
                    ["filter", "right start", "worst start", "its worst axis", "its q, k",
                     "mean of the worst axis", "NEES", "diverged"],
                    [[labels[o.filter], *_grid_row(o, name)] for o in tried],
                )
            )  # fmt: skip
        for outcome in tried:
            for name, score in outcome.scores.items():
                parts.append(f"### {labels[outcome.filter]}, {title}, {range_words(name)}: ratio\n")
                cells = [
                    [_ratios(score, outcome.cells.index(Cell(q, k))) for k in FACTORS]
                    for q in FACTORS
                ]
                parts.append(
                    table(
                        ["", *(f"k = {factor_words(k)}" for k in FACTORS)],
                        [
                            [f"q = {factor_words(q)}", *texts]
                            for q, texts in zip(FACTORS, cells, strict=True)
                        ],
                    )
                )
    return "\n".join(["", *parts])


def dynamic_tables(outcomes: Sequence[Outcome], labels: Labels) -> str:
    """Return a table for each case: right start and the worst of the wrong ones, by range."""
    parts = []
    ranges = _ranges(outcomes)
    words = ("ratio", "NEES", "diverged")
    columns = [f"{word}, {name}" for name in ranges for word in words]
    for trial, case in dynamic.CASES.items():
        when = " during the event" if case.has_event else ""
        parts.append(f"## {trial}: {case.about}{when}\n")
        lines = []
        for outcome in outcomes:
            if outcome.trial != trial:
                continue
            wrong = [index for index, cell in enumerate(outcome.cells) if cell != RIGHT]
            worst = np.max(outcome.scores["whole"].ratio.value, axis=-1)
            indices = [outcome.cells.index(RIGHT)]
            indices += [max(wrong, key=lambda index: or_infinite(worst[index]))] if wrong else []
            for index in indices:
                start = start_words(outcome.cells[index])
                texts = [t for name in ranges for t in _brief(outcome.scores[name], index)]
                lines.append([labels[outcome.filter], start, *texts])
        parts.append(table(["filter", "start", *columns], lines))
        parts.append(_against_fixed([o for o in outcomes if o.trial == trial], labels))
    return "\n".join(["", *parts])


def _against_fixed(outcomes: Sequence[Outcome], labels: Labels) -> str:
    """Return how the filters compare, over the whole run, with EKFs whose noise stays."""
    fixed = next((o for o in outcomes if o.filter == "ekf"), None)
    others = [o for o in outcomes if fixed is not None and o.cells == fixed.cells and o != fixed]
    if fixed is None or not others:
        return ""
    ekf = fixed.scores["whole"].ratio.value
    best = int(np.argmin(np.max(ekf, axis=-1)))
    lines = []
    for outcome in others:
        ratio = outcome.scores["whole"].ratio.value
        same, hindsight = ratio / ekf, ratio / ekf[best]
        right = outcome.cells.index(RIGHT)
        lines.append(
            [
                labels[outcome.filter],
                *(" / ".join(map(number, value)) for value in (same[right], np.max(same, axis=0))),
                *(
                    " / ".join(map(number, value))
                    for value in (hindsight[right], np.max(hindsight, axis=0))
                ),
            ]
        )
    against = f"best EKF ({start_words(fixed.cells[best])})"
    return table(
        ["over the EKF, whole run", "same start, right", "same start, worst",
         f"right start over {against}", f"worst start over {against}"],
        lines,
    )  # fmt: skip


def factor_words(factor: float) -> str:
    """Return a factor as a reader would write it."""
    return f"{factor:g}" if factor >= 1.0 else f"1/{1.0 / factor:g}"


def range_words(name: str) -> str:
    """Return a range in words."""
    return f"{name} run" if name == "whole" else name


def start_words(cell: Cell) -> str:
    """Return a start in words, such as `Q / 25, R x 25`."""
    wrong = [
        f"{name} x {factor:g}" if factor > 1.0 else f"{name} / {1.0 / factor:g}"
        for name, factor in (("Q", cell.q), ("R", cell.k))
        if factor != 1.0
    ]
    return ", ".join(wrong) or "right start"


def _at(outcomes: Sequence[Outcome], trial: str, cell: Cell) -> Iterator[tuple[Outcome, int]]:
    """Yield the outcomes of a trial with the index of a start; the oracle's at any start."""
    for outcome in outcomes:
        if outcome.trial == trial:
            yield outcome, outcome.cells.index(cell) if cell in outcome.cells else 0


def _ranges(outcomes: Sequence[Outcome]) -> list[str]:
    return list(outcomes[0].scores)


def _paper_row(score: Score, index: int) -> list[str]:
    rmse = [
        f"{value:.4f} ({low:.4f}-{high:.4f})"
        for value, low, high in zip(*(end[index] for end in score.rmse), strict=True)
    ]
    nees = "{:.2f} ({:.2f}-{:.2f})".format(*(end[index] for end in score.nees))
    return [
        *rmse, _ratios(score, index), nees, f"{score.nees_inside[index]:.0%}",
        number(score.nis[index]), f"{score.diverged[index]:.0%}",
    ]  # fmt: skip


def _grid_row(outcome: Outcome, name: str) -> list[str]:
    score = outcome.scores[name]
    worst = np.max(score.ratio.value, axis=-1)
    where = int(np.argmax(np.where(np.isfinite(worst), worst, np.inf)))
    axis = int(np.argmax(score.ratio.value[where]))
    low, high = score.ratio.low[where, axis], score.ratio.high[where, axis]
    cell = outcome.cells[where]
    return [
        _ratios(score, outcome.cells.index(RIGHT)),
        _ratios(score, where),
        f"{worst[where]:.2f} ({low:.2f}-{high:.2f})",
        f"{factor_words(cell.q)}, {factor_words(cell.k)}",
        number(np.mean(worst)),
        f"{np.min(score.nees.value):.2f} - {np.max(score.nees.value):.2f}",
        f"{np.max(score.diverged):.0%}",
    ]


def _brief(score: Score, index: int) -> list[str]:
    return [
        _ratios(score, index), number(score.nees.value[index]), f"{score.diverged[index]:.0%}",
    ]  # fmt: skip


def _ratios(score: Score, index: int) -> str:
    return " / ".join(number(value) for value in score.ratio.value[index])


def number(value: float) -> str:
    """Return a number as tables show it; n/a if it is not finite."""
    if not math.isfinite(value):
        return "n/a"
    return f"{value:.2f}" if value < 100.0 else f"{value:.3g}"


def or_infinite(value: float) -> float:
    """Return a number that compares as the worst where a filter left the numbers."""
    return value if math.isfinite(value) else math.inf


def plain(value: float | FloatArray) -> float | None:
    """Return a number as JSON can hold it; None if it is not finite."""
    number = float(value)
    return number if math.isfinite(number) else None


def plain_interval(interval: Interval, index: tuple[int, ...]) -> list[float | None]:
    """Return one entry of an interval as JSON can hold it, [value, low, high]."""
    return [plain(end[index]) for end in interval]


def table(names: Sequence[str], lines: Sequence[Sequence[str]]) -> str:
    """Return a table in Markdown."""
    texts = [names, ["---"] * len(names), *lines]
    return "\n".join(f"| {' | '.join(line)} |" for line in texts) + "\n"
