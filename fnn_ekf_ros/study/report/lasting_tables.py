# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Results of `study lasting` as Markdown and as rows for JSON."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from fnn_ekf_ros.core.arrays import FloatArray
from fnn_ekf_ros.evaluation.intervals import Interval, mean_interval, root_ratio_interval
from fnn_ekf_ros.study.filters import JOINT
from fnn_ekf_ros.study.lasting import (
    CASES,
    COMPASS_OFFSET,
    FIX_STD,
    KNOWS,
    LABELS,
    SIMULATIONS,
    FilterErrors,
    cells_of,
)
from fnn_ekf_ros.study.report.tables import (
    command_head,
    number,
    or_infinite,
    plain,
    plain_interval,
    start_words,
    table,
)
from fnn_ekf_ros.study.starts import RIGHT

RANGES = ("whole", "last half")
"""Names of the ranges, in the order of `trials.halves`."""
CONSISTENT_NEES = 3.0
"""Mean NEES of a consistent covariance."""
HOW_TO_READ = f"""\
Beside white noise of the right size the readings have errors that last. Fixes: a Gauss-Markov
process of {FIX_STD:g} m in x and in y, with the time constant that is given. Compass: an offset of
{COMPASS_OFFSET:g} rad. The EKF that knows the errors has them in its state, with the true model.
Ratio: RMSE of all runs over its RMSE; position is the distance in the plane. The oracle knows the
white noise and nothing of the lasting errors. NEES: mean; {CONSISTENT_NEES:g} where the
covariance is consistent. Each entry: whole run / last half. The pose at the start has no lasting
error. Worst: of the starts with Q and R each too small or too large by 25 in variance, each number
by itself, NEES by its factor from {CONSISTENT_NEES:g}; the start that is named has the largest
position ratio over the whole run.
"""
"""Explains the tables."""


class LastingRow(NamedTuple):
    """A filter in a case.

    Attributes:
        path: of the simulation.
        case: a name in `CASES`.
        filter: a name in `LABELS`.
        position: `(ranges, cells)` RMSE [m].
        yaw: likewise [rad].
        position_ratio: `(ranges, cells)` RMSE over that of the EKF that knows.
        yaw_ratio: likewise.
        nees: `(ranges, cells)` mean.
        runs: how many.
    """

    path: str
    case: str
    filter: str
    position: FloatArray
    yaw: FloatArray
    position_ratio: Interval
    yaw_ratio: Interval
    nees: Interval
    runs: int


Errors = Mapping[str, Mapping[str, Mapping[str, FilterErrors]]]
"""Errors by simulation, case and filter."""


def lasting_rows(errors: Errors) -> list[LastingRow]:
    """Return the rows of all simulations, cases and filters."""
    return [
        _row(path, case, name, of_filter, by_filter[KNOWS])
        for path, by_case in errors.items()
        for case, by_filter in by_case.items()
        for name, of_filter in by_filter.items()
    ]


def _row(path: str, case: str, name: str, own: FilterErrors, known: FilterErrors) -> LastingRow:
    return LastingRow(
        path=path,
        case=case,
        filter=name,
        position=np.sqrt(np.mean(own.position, axis=-1)),
        yaw=np.sqrt(np.mean(own.yaw, axis=-1)),
        position_ratio=_ratio(own.position, known.position),
        yaw_ratio=_ratio(own.yaw, known.yaw),
        nees=mean_interval(own.nees),
        runs=own.position.shape[-1],
    )


def _ratio(squares: FloatArray, known: FloatArray) -> Interval:
    return root_ratio_interval(squares, np.broadcast_to(known, squares.shape))


def lasting_numbers(row: LastingRow) -> Iterator[dict[str, Any]]:
    """Yield a row for JSON for each start and range; intervals are [value, low, high]."""
    for index, cell in enumerate(cells_of(row.filter)):
        for place, name in enumerate(RANGES):
            at = (place, index)
            yield {
                "simulation": row.path, "case": row.case, "filter": row.filter,
                "q": cell.q, "k": cell.k, "range": name, "runs": row.runs,
                "rmse_position": plain(row.position[at]),
                "rmse_yaw": plain(row.yaw[at]),
                "ratio_position": plain_interval(row.position_ratio, at),
                "ratio_yaw": plain_interval(row.yaw_ratio, at),
                "nees": plain_interval(row.nees, at),
            }  # fmt: skip


def head(made_by: Mapping[str, Any]) -> str:
    """Return the first lines: how the tables were made and how they are read."""
    options = {name: made_by[name] for name in ("runs", "steps", "seed")}
    return command_head(made_by, options, HOW_TO_READ)


def summary(rows: Sequence[LastingRow]) -> str:
    """Return in one sentence what lasting errors cost mode joint."""
    own = [row for row in rows if row.filter == JOINT]
    lasting = [row for row in own if row.case != "none"]
    white = [row for row in own if row.case == "none"]

    def ratios(of: Sequence[LastingRow]) -> str:
        return _span([_worst(row.position_ratio.value[0]) for row in of])

    nees = _span([_worst_nees(row.nees.value[0]) for row in lasting])
    return (
        f"Mode joint from its worst start, whole run: position RMSE {ratios(lasting)} times that "
        f"of the EKF that knows the errors, mean NEES {nees}; without lasting errors "
        f"{ratios(white)} times.\n"
    )


def lasting_tables(rows: Sequence[LastingRow]) -> str:
    """Return two tables for each simulation: the EKF that knows the errors, and all others."""
    parts = []
    for path, title in SIMULATIONS.items():
        own = [row for row in rows if row.path == path]
        known = [row for row in own if row.filter == KNOWS]
        parts += [
            f"## {title.capitalize()}, {known[0].runs} runs\n",
            table(
                [LABELS[KNOWS], "position [m]", "yaw [rad]", "NEES"],
                [
                    [
                        CASES[row.case].about,
                        _halves(row.position[:, 0], 3),
                        _halves(row.yaw[:, 0], 4),
                        _halves(row.nees.value[:, 0]),
                    ]
                    for row in known
                ],
            ),
            table(
                ["lasting errors", "filter", "start", "position, ratio", "yaw, ratio", "NEES"],
                [line for row in own if row.filter != KNOWS for line in _lines(row)],
            ),
        ]
    return "\n".join(parts)


def _lines(row: LastingRow) -> list[list[str]]:
    """Return the lines of a filter: the right start, and the worst of the wrong ones."""
    cells = cells_of(row.filter)
    right = cells.index(RIGHT)
    lines = [
        [
            start_words(RIGHT) if len(cells) > 1 else "knows the noise",
            _halves(row.position_ratio.value[:, right]),
            _halves(row.yaw_ratio.value[:, right]),
            _halves(row.nees.value[:, right]),
        ]
    ]
    wrong = [index for index, cell in enumerate(cells) if cell != RIGHT]
    if wrong:
        position, yaw, nees = (
            each.value[:, wrong] for each in (row.position_ratio, row.yaw_ratio, row.nees)
        )
        where = max(range(len(wrong)), key=lambda index: or_infinite(position[0, index]))
        lines.append(
            [
                f"worst: {start_words(cells[wrong[where]])}",
                _halves([_worst(values) for values in position]),
                _halves([_worst(values) for values in yaw]),
                _halves([_worst_nees(values) for values in nees]),
            ]
        )
    return [[CASES[row.case].about, LABELS[row.filter], *line] for line in lines]


def _worst(values: FloatArray) -> float:
    return max(or_infinite(value) for value in values.tolist())


def _worst_nees(values: FloatArray) -> float:
    """Return the NEES that is furthest from that of a consistent covariance, as a factor."""
    return max(
        (or_infinite(value) for value in values.tolist()),
        key=lambda value: abs(np.log(value / CONSISTENT_NEES)),
    )


def _halves(values: Sequence[float] | FloatArray, digits: int | None = None) -> str:
    """Return the values of both ranges; two digits, or fewer for large ones, if not given."""
    return " / ".join(
        number(float(value)) if digits is None else f"{value:.{digits}f}" for value in values
    )


def _span(values: Sequence[float]) -> str:
    low, high = number(min(values)), number(max(values))
    return low if low == high else f"{low} to {high}"
