# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The trials of a study through its filters, by several processes.

A piece of work is to make a trial, or to take one filter through one block of its starts. A trial
is made once, by one process, and sent to each of the others; blocks are the same for any number
of processes, and so are the results.
"""

import pickle
from collections import deque
from collections.abc import Generator, Iterator, Mapping, Sequence
from typing import NamedTuple

from fnn_ekf_ros.study.filters import ORACLE, SLOWEST, StudyFilter
from fnn_ekf_ros.study.trials import (
    Outcome,
    Trial,
    TrialPlan,
    blocks,
    join_outcomes,
    make_trial,
    oracle_outcome,
    try_block,
)
from fnn_ekf_ros.study.workers import Worker, Workers, one_line

TRIALS_AT_ONCE = 2
"""Largest number of trials that are being made or tried, and kept in memory, at a time: while the
last blocks of one are tried, the next one is made."""


class Piece(NamedTuple):
    """A piece of work.

    Attributes:
        trial: number of the trial's plan.
        filter: the filter's name; the oracle's stands for making the trial.
        block: number of the block of the trial's starts; 0 of the oracle.
    """

    trial: int
    filter: str
    block: int


class Request(NamedTuple):
    """A piece of work for a process.

    Attributes:
        piece: of work.
        packed: the trial, pickled; None where the process has it, or is to make it.
    """

    piece: Piece
    packed: bytes | None


class Answer(NamedTuple):
    """Answer to a request.

    Attributes:
        outcome: of the filter in this block.
        packed: the trial that was made, pickled.
    """

    outcome: Outcome
    packed: bytes | None = None


class TrialServer:
    """Makes trials and tries filters on them, in a process of its own."""

    def __init__(self, plans: Sequence[TrialPlan], filters: Mapping[str, StudyFilter]) -> None:
        self._plans = plans
        self._filters = filters
        self._trial: Trial | None = None

    def __call__(self, request: Request) -> Answer:
        """Do a piece of work."""
        piece = request.piece
        if piece.filter == ORACLE:
            trial = make_trial(*self._plans[piece.trial], self._filters[ORACLE])
            packed = pickle.dumps(trial, pickle.HIGHEST_PROTOCOL)
            return Answer(oracle_outcome(trial, self._filters[ORACLE]), packed)
        if request.packed is not None:
            self._trial = pickle.loads(request.packed)  # noqa: S301 (from another own process)
        if self._trial is None:
            raise ValueError("there is no trial: expected it with the first block")
        return Answer(_tried(self._trial, self._filters, piece))


def pieces(plans: Sequence[TrialPlan], names: Sequence[str]) -> list[Piece]:
    """Return all the work of a study, that of the slowest filters first in each trial.

    Args:
        plans: of the trials.
        names: of the filters beside the oracle.
    """
    order = [*(name for name in SLOWEST if name in names), *names]
    return [
        piece
        for number, plan in enumerate(plans)
        for piece in (
            Piece(number, ORACLE, 0),
            *(
                Piece(number, name, block)
                for name in dict.fromkeys(order)
                for block in range(len(blocks(plan.cells)))
            ),
        )
    ]


def joined(
    done: Mapping[Piece, Outcome], plans: Sequence[TrialPlan], names: Sequence[str]
) -> list[Outcome]:
    """Return what became of each filter in each trial, the oracle first.

    Args:
        done: all pieces of the study.
        plans: of the trials.
        names: of the filters beside the oracle, in the order of the results.
    """
    return [
        join_outcomes([done[Piece(number, name, block)] for block in range(count)])
        for number, plan in enumerate(plans)
        for name, count in ((ORACLE, 1), *((name, len(blocks(plan.cells))) for name in names))
    ]


def work_through(
    plans: Sequence[TrialPlan],
    filters: Mapping[str, StudyFilter],
    names: Sequence[str],
    jobs: int,
) -> Generator[tuple[Piece, Outcome], None, None]:
    """Yield each piece of a study's work as it is done.

    Args:
        plans: of the trials.
        filters: by name, with the oracle.
        names: of the filters to try beside it.
        jobs: processes; with one, the work is done here.

    Raises:
        WorkError: a piece failed, or a process has ended.
    """
    work = pieces(plans, names)
    count = min(jobs, len(work))
    if count > 1:
        used = {name: filters[name] for name in (ORACLE, *names)}
        with Workers(count, TrialServer, plans, used) as workers:
            yield from _work_through(work, plans, workers)
        return
    for number, plan in enumerate(plans):
        with one_line(_words(plan, ORACLE)):
            trial = make_trial(*plan, filters[ORACLE])
            outcome = oracle_outcome(trial, filters[ORACLE])
        for piece in [piece for piece in work if piece.trial == number]:
            if piece.filter != ORACLE:
                with one_line(_words(plan, piece.filter)):
                    outcome = _tried(trial, filters, piece)
            yield piece, outcome


def _work_through(
    work: Sequence[Piece], plans: Sequence[TrialPlan], workers: Workers
) -> Iterator[tuple[Piece, Outcome]]:
    to_make = deque(piece for piece in work if piece.filter == ORACLE)
    to_try: deque[Piece] = deque()
    packed: dict[int, bytes] = {}
    unfinished: dict[int, int] = {}  # pieces of each trial that is in use
    has: dict[Worker, int] = {}  # which trial
    does: dict[Worker, Piece] = {}
    while True:
        for worker in list(workers.idle):
            sent = None
            if to_make and len(unfinished) < TRIALS_AT_ONCE:
                piece = to_make.popleft()
                unfinished[piece.trial] = sum(each.trial == piece.trial for each in work)
            elif to_try:
                piece = to_try.popleft()
                if has.get(worker) != piece.trial:
                    has[worker], sent = piece.trial, packed[piece.trial]
            else:
                break
            does[worker] = piece
            what = _words(plans[piece.trial], piece.filter)
            workers.give(worker, Request(piece, sent), what)
        if not workers.busy:
            return
        for worker, answer in workers.answers():
            piece = does[worker]
            number = piece.trial
            if answer.packed is not None:
                packed[number] = answer.packed
                made = [p for p in work if p.trial == number and p.filter != ORACLE]
                to_try = deque(sorted((*to_try, *made), key=lambda p: p.trial))  # stable
            unfinished[number] -= 1
            if not unfinished[number]:
                del unfinished[number], packed[number]
            yield piece, answer.outcome


def _tried(trial: Trial, filters: Mapping[str, StudyFilter], piece: Piece) -> Outcome:
    return try_block(trial, filters[piece.filter], blocks(trial.cells)[piece.block])


def _words(plan: TrialPlan, name: str) -> str:
    if name == ORACLE:
        return f"trial {plan.name}: making it"
    return f"trial {plan.name}: the filter {name}"
