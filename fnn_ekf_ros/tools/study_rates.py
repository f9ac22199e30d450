"""`study rates`: does accuracy depend on the period, and on rates and phases of the sensors."""

import argparse
import json
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from fnn_ekf_ros.core.pace import NOMINAL_PERIOD_S
from fnn_ekf_ros.errors import FnnEkfError
from fnn_ekf_ros.parameters.localizer import NODE_NAME as LOCALIZER
from fnn_ekf_ros.parameters.localizer import LocalizerParameters
from fnn_ekf_ros.study.instants import ROBOTS_AT_ONCE
from fnn_ekf_ros.study.rates import (
    CELLS,
    COMPASS_RATE,
    FIX_RATE,
    PATH,
    PERIODS_S,
    PHASES,
    RATE_CASES,
    PeriodErrors,
    RateErrors,
    case_length,
    case_runs,
    period_errors,
    rate_errors,
    run_length,
)
from fnn_ekf_ros.text_files import write_text
from fnn_ekf_ros.tools.arguments import add_parameter_arguments, given_parameters
from fnn_ekf_ros.tools.pictures import require_matplotlib
from fnn_ekf_ros.tools.progress import with_progress
from fnn_ekf_ros.tools.result_folder import prepare_study
from fnn_ekf_ros.tools.study_rates_figures import draw_rates
from fnn_ekf_ros.tools.study_rates_tables import (
    PeriodRow,
    RateRow,
    head,
    period_numbers,
    period_rows,
    period_table,
    rate_numbers,
    rate_row,
    rate_table,
    summary,
)
from fnn_ekf_ros.tools.study_settings import study_localizer, write_settings
from fnn_ekf_ros.tools.workers import add_jobs_argument, given_jobs, in_any_order
from fnn_ekf_ros.version import version

NAME = "rates"
SUMMARY = "periods, rates and phases of the sensors: does accuracy depend on them"
LIMITS = {"runs": (2, 10_000), "fixes": (4, 10_000), "seed": (0, 2**63 - 1)}
RUNS_AT_ONCE = ROBOTS_AT_ONCE // len(CELLS)
"""So many runs of joint adaptation, from all starts, go through the filter side by side."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument(
        "--out", metavar="DIR", type=Path, required=True,
        help="folder for tables, picture and settings; files of the same name are replaced",
    )  # fmt: skip
    parser.add_argument(
        "--runs", metavar="N", type=int, default=20,
        help="of a row of mode joint (20); twice as many where they are short, fewer where they "
        f"are long, {len(CELLS)} times as many of mode none",
    )  # fmt: skip
    parser.add_argument(
        "--fixes", metavar="N", type=int, default=800,
        help="fixes in a run of mode joint (800); runs of mode none have 375 ms for each",
    )  # fmt: skip
    parser.add_argument("--seed", metavar="S", type=int, default=1, help="of everything (1)")
    parser.add_argument(
        "--json", metavar="FILE", type=Path, help="write the numbers here (DIR/results.json)"
    )
    add_jobs_argument(parser)
    add_parameter_arguments(parser)


def run(arguments: argparse.Namespace) -> int:
    """Run the command."""
    for name, (least, most) in LIMITS.items():
        value = getattr(arguments, name)
        if not least <= value <= most:
            raise FnnEkfError(f"--{name} {value}: expected {least} to {most}")
    jobs, given = given_jobs(arguments), given_parameters(arguments, LOCALIZER)
    localizer = study_localizer(PATH, given)
    require_matplotlib()
    out = arguments.out
    numbers = prepare_study(out, ["results.md"], arguments.json, arguments.params)
    made_by = {
        "study": NAME, "version": version(), "runs": arguments.runs, "fixes": arguments.fixes,
        "seed": arguments.seed, "parameters": given,
    }  # fmt: skip
    write_settings(out, PATH, given)

    pieces = _pieces(arguments.runs, arguments.fixes, arguments.seed)
    requests = [(piece.words(), piece) for piece in pieces]
    with closing(in_any_order(jobs, _Runner, requests, localizer)) as work:
        done = dict(with_progress(work, len(requests), "study rates"))
    answers = {piece: done[number] for number, piece in enumerate(pieces)}
    periods, rates = _rows(answers, arguments.runs, arguments.fixes)

    content = {
        **made_by,
        "periods": [period_numbers(row) for row in periods],
        "rates": [rate_numbers(row) for row in rates],
    }
    write_text(numbers, json.dumps(content, indent=1, allow_nan=False) + "\n")
    parts = (head(made_by), summary(periods, rates), period_table(periods), rate_table(rates))
    write_text(out / "results.md", "\n".join(parts))
    draw_rates(out, periods, rates)
    print(f"{out}: {len(periods)} rows of periods and {len(rates)} of rates, {arguments.runs} runs")
    print(summary(periods, rates), end="")
    print(f"{out / 'results.md'}: the tables")
    return 0


class _Piece(NamedTuple):
    """Some runs of a row of a table.

    Attributes:
        case: number of the case in `RATE_CASES`; None where joint adaptation is not in question.
        phases: a name in `PHASES`.
        seconds: length of the runs [s].
        runs: how many.
        block: number of these runs among the row's, from 0.
        seed: of everything random, with `block`.
    """

    case: int | None
    phases: str
    seconds: float
    runs: int
    block: int
    seed: int

    def words(self) -> str:
        """Return what it is."""
        what = "periods" if self.case is None else f"case {self.case + 1}"
        return f"{what}, {self.phases}, block {self.block + 1}"

    def cost(self) -> float:
        """Return about how many epochs that takes."""
        if self.case is None:
            return self.seconds * len(PERIODS_S) * (FIX_RATE + COMPASS_RATE) / 3.0
        case = RATE_CASES[self.case]
        timing = case.timing
        return self.seconds * (timing.fix_rate + timing.compass_rate + 1.0 / case.period_s)


def _pieces(runs: int, fixes: int, seed: int) -> list[_Piece]:
    """Return all the work, that which takes longest first."""
    rows: list[tuple[int | None, str, float, int, int]] = [
        (None, phases, run_length(NOMINAL_PERIOD_S * fixes), len(CELLS) * runs, ROBOTS_AT_ONCE)
        for phases in PHASES
    ]
    rows += [
        (number, case.phases, case_length(case, fixes), case_runs(case, runs), RUNS_AT_ONCE)
        for number, case in enumerate(RATE_CASES)
    ]
    pieces = [
        _Piece(number, phases, seconds, len(some), block, seed)
        for number, phases, seconds, count, at_once in rows
        for block, some in enumerate(_blocks(count, at_once))
    ]
    return sorted(pieces, key=_Piece.cost, reverse=True)


def _blocks(count: int, at_once: int) -> list[range]:
    return [range(first, min(first + at_once, count)) for first in range(0, count, at_once)]


class _Runner:
    """Runs robots, in any process."""

    def __init__(self, localizer: LocalizerParameters) -> None:
        self._localizer = localizer

    def __call__(self, piece: _Piece) -> PeriodErrors | RateErrors:
        """Return what became of them. The same runs of two rows differ in nothing but the row."""
        size = piece.seconds, piece.runs, (piece.seed, piece.block)
        if piece.case is None:
            return period_errors(self._localizer, piece.phases, *size)
        return rate_errors(self._localizer, RATE_CASES[piece.case], *size)


def _rows(
    answers: dict[_Piece, Any], runs: int, fixes: int
) -> tuple[list[PeriodRow], list[RateRow]]:
    periods: list[PeriodRow] = []
    for phases in PHASES:
        own = [each for each in _in_order(answers) if (each.case, each.phases) == (None, phases)]
        errors = PeriodErrors(*_joined([answers[each] for each in own]))
        periods += period_rows(phases, own[0].seconds, errors)
    rates = []
    for number, case in enumerate(RATE_CASES):
        own = [each for each in _in_order(answers) if each.case == number]
        errors_of_case = RateErrors(*_joined([answers[each] for each in own]))
        rates.append(
            rate_row(case, case_length(case, fixes), case_runs(case, runs), errors_of_case)
        )
    return periods, rates


def _in_order(answers: dict[_Piece, Any]) -> list[_Piece]:
    return sorted(answers, key=lambda piece: piece.block)


def _joined(parts: Sequence[Any]) -> list[Any]:
    """Return the arrays `(..., n)` of several blocks of runs as those of all runs."""
    return [np.concatenate(arrays, axis=-1) for arrays in zip(*parts, strict=True)]
