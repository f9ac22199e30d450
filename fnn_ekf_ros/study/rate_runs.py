# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The runs of `study rates`, by several processes."""

from collections.abc import Mapping, Sequence
from contextlib import closing
from typing import Any, NamedTuple

import numpy as np

from fnn_ekf_ros.core.pace import NOMINAL_PERIOD_S
from fnn_ekf_ros.parameters.localizer import LocalizerParameters
from fnn_ekf_ros.reports.progress import with_progress
from fnn_ekf_ros.study import rates
from fnn_ekf_ros.study.instants import ROBOTS_AT_ONCE
from fnn_ekf_ros.study.rates import (
    CELLS,
    COMPASS_RATE,
    FIX_RATE,
    PERIODS_S,
    PHASES,
    PeriodErrors,
    RateCase,
    RateErrors,
    case_length,
    case_runs,
    period_errors,
    rate_errors,
    run_length,
)
from fnn_ekf_ros.study.workers import in_any_order

RUNS_AT_ONCE = ROBOTS_AT_ONCE // len(CELLS)
"""Runs of joint adaptation, each from all starts, that go through the filter side by side: their
robots fit the cache together."""


class RateResults(NamedTuple):
    """Results of the runs.

    Attributes:
        period_seconds: length of the runs without adaptation [s].
        periods: without adaptation, by a name in `PHASES`.
        cases: of joint adaptation, in the order of `rates.RATE_CASES`.
    """

    period_seconds: float
    periods: dict[str, PeriodErrors]
    cases: list[tuple[RateCase, RateErrors]]


def run_rates(
    localizer: LocalizerParameters, runs: int, fixes: int, seed: int, jobs: int
) -> RateResults:
    """Run robots at all periods, rates and phases.

    Args:
        localizer: parameters of the filters.
        runs: of a row of mode joint.
        fixes: in each of its runs.
        seed: of all random numbers.
        jobs: processes.

    Raises:
        WorkError: a run failed, or a process has ended.
    """
    pieces = _pieces(runs, fixes, seed)
    requests = [(piece.words(), piece) for piece in pieces]
    with closing(in_any_order(jobs, _Runner, requests, localizer)) as work:
        done = dict(with_progress(work, len(requests), "study rates"))
    answers = {piece: done[number] for number, piece in enumerate(pieces)}
    return RateResults(
        period_seconds=_period_seconds(fixes),
        periods={
            phases: PeriodErrors(*_joined(_answers_of(answers, None, phases))) for phases in PHASES
        },
        cases=[
            (case, RateErrors(*_joined(_answers_of(answers, number, case.phases))))
            for number, case in enumerate(rates.RATE_CASES)
        ],
    )


class _Piece(NamedTuple):
    """Some runs of a row of a table.

    Attributes:
        case: number of the case in `rates.RATE_CASES`; None without adaptation.
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
        case = rates.RATE_CASES[self.case]
        timing = case.timing
        return self.seconds * (timing.fix_rate + timing.compass_rate + 1.0 / case.period_s)


def _pieces(runs: int, fixes: int, seed: int) -> list[_Piece]:
    """Return all the work, that which takes longest first."""
    work: list[tuple[int | None, str, float, int, int]] = [
        (None, phases, _period_seconds(fixes), len(CELLS) * runs, ROBOTS_AT_ONCE)
        for phases in PHASES
    ]
    work += [
        (number, case.phases, case_length(case, fixes), case_runs(case, runs), RUNS_AT_ONCE)
        for number, case in enumerate(rates.RATE_CASES)
    ]
    pieces = [
        _Piece(case=number, phases=phases, seconds=seconds, runs=len(some), block=block, seed=seed)
        for number, phases, seconds, count, at_once in work
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
        return rate_errors(self._localizer, rates.RATE_CASES[piece.case], *size)


def _period_seconds(fixes: int) -> float:
    """Return the length of the runs without adaptation [s]."""
    return run_length(NOMINAL_PERIOD_S * fixes)


def _answers_of(answers: Mapping[_Piece, Any], case: int | None, phases: str) -> list[Any]:
    """Return the answers for the blocks of a row, in their order."""
    own = [piece for piece in answers if (piece.case, piece.phases) == (case, phases)]
    return [answers[piece] for piece in sorted(own, key=lambda piece: piece.block)]


def _joined(parts: Sequence[Any]) -> list[Any]:
    """Return the arrays `(..., n)` of several blocks of runs as those of all runs."""
    return [np.concatenate(arrays, axis=-1) for arrays in zip(*parts, strict=True)]
