# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Runs side by side as a table of text and as JSON: one column for each run."""

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from fnn_ekf_ros.evaluation.comparison import (
    Compared,
    Measure,
    conclusion,
    judge,
    judge_consistency,
    judgment_in_words,
)
from fnn_ekf_ros.evaluation.evaluation import (
    STATE_DEGREES,
    number,
    plain,
    plain_run,
    without_nan,
)
from fnn_ekf_ros.evaluation.innovations import FIX_YAW
from fnn_ekf_ros.evaluation.motion import corrections

_NAME_WIDTH = 40
"""Width of the first column [characters]."""
_LEAST_WIDTH, _MOST_WIDTH = 12, 34
"""Least and largest width of the other columns [characters]."""


class Line(NamedTuple):
    """A line of the table.

    Attributes:
        name: what is compared.
        values: of each run.
    """

    name: str
    values: list[str]


def comparison_lines(runs: Mapping[str, Compared], measures: Sequence[Measure]) -> list[Line]:
    """Return the lines of the table; what no run has is left out."""
    lines = [Line("odom", [str(len(each.run.track.time_ns)) for each in runs.values()])]
    lines += [
        Line(
            f"{each.name} [{each.unit}]", [_size(series.size()) for series in each.series.values()]
        )
        for each in measures
    ]
    if all(each.found.truth is not None for each in runs.values()):
        lines.append(Line(f"NEES ({STATE_DEGREES})", [_nees(each) for each in runs.values()]))
    lines.append(Line("NIS (1)", [_judged(each.found.nis.ratio, str(each.found.nis.verdict))
                                  for each in runs.values()]))  # fmt: skip
    sensors = list(dict.fromkeys(name for each in runs.values() for name in each.found.sensors))
    for name in sensors:
        found = [each.found.sensors.get(name) for each in runs.values()]
        lines += [
            Line(f"NIS of {name} (1)", ["-" if s is None else
                 _judged(s.consistency.ratio, str(s.consistency.verdict)) for s in found]),
            Line(f"lag 1 of {name}", ["-" if s is None else
                 f"{s.whiteness.lag_one:.2f} (white: +-{s.whiteness.band:.2f})" for s in found]),
        ]  # fmt: skip
        if name != FIX_YAW:
            shares = ["-" if s is None else f"{s.rejected_share:.1%}" for s in found]
            lines.append(Line(f"rejected {name}", shares))
    sizes = [corrections(each.run) for each in runs.values()]
    lines.append(Line("corrections, rms [m]", [_size(each.rmse) for each in sizes]))
    lines.append(Line("largest correction [m]", [_size(each.max) for each in sizes]))
    lines.append(Line("worst status", [_status(each) for each in runs.values()]))
    return [line for line in lines if any(value != "-" for value in line.values)]


def format_comparison(names: Sequence[str], lines: Sequence[Line]) -> str:
    """Return the table as text."""
    widths = [
        min(max(_LEAST_WIDTH, *map(len, (name, *(line.values[i] for line in lines)))), _MOST_WIDTH)
        for i, name in enumerate(names)
    ]  # fmt: skip
    rows = [("", *names), *((line.name, *line.values) for line in lines)]
    return "\n".join(
        f"{first:<{_NAME_WIDTH}}  "
        + "  ".join(f"{cell:<{width}}" for cell, width in zip(cells, widths, strict=True)).rstrip()
        for first, *cells in rows
    )


def verdicts(runs: Mapping[str, Compared], measures: Sequence[Measure]) -> list[str]:
    """Return which run is better by what, and where the data cannot tell."""
    found = [judge(measure) for measure in measures]
    return [*map(judgment_in_words, found), *judge_consistency(runs), conclusion(found)]


def plain_comparison(runs: Mapping[str, Compared], measures: Sequence[Measure]) -> dict[str, Any]:
    """Return all numbers as JSON can hold them."""
    content: dict[str, Any] = {"runs": {}, "verdicts": verdicts(runs, measures)}
    for name, each in runs.items():
        content["runs"][name] = {
            **plain(each.found),
            **plain_run(each.run),
            "measures": {measure.name: measure.series[name].size() for measure in measures},
        }
    finite: dict[str, Any] = without_nan(content)
    return finite


def _size(value: float) -> str:
    return "-" if math.isnan(value) else f"{value:.4g}"


def _judged(value: float, verdict: str) -> str:
    return "-" if math.isnan(value) else f"{number(value)} {verdict}"


def _nees(each: Compared) -> str:
    assert each.found.truth is not None
    nees = each.found.truth.nees
    return _judged(STATE_DEGREES * nees.ratio, str(nees.verdict))


def _status(each: Compared) -> str:
    worst = each.run.worst_status()
    if worst is None:
        return "OK" if each.run.statuses else "-"
    return f"{worst.word} {worst.name}, {worst.share:.1%}"
