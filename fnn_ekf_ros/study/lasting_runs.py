# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The runs of `study lasting`, by several processes."""

from collections.abc import Mapping
from contextlib import closing
from typing import NamedTuple

import numpy as np

from fnn_ekf_ros.parameters.localizer import LocalizerParameters
from fnn_ekf_ros.reports.progress import with_progress
from fnn_ekf_ros.study.lasting import CASES, LABELS, SIMULATIONS, FilterErrors, run_cases
from fnn_ekf_ros.study.workers import in_any_order

RUNS_AT_ONCE = 20
"""Number of runs that are driven side by side: with fewer, the drive takes longer than the
filters."""

BlockErrors = Mapping[str, Mapping[str, FilterErrors]]
"""Errors by case and filter."""


class _Block(NamedTuple):
    """Some runs of a simulation.

    Attributes:
        path: that is driven.
        number: of the block, from 0.
        runs: how many.
    """

    path: str
    number: int
    runs: int


def run_lasting(
    localizers: Mapping[str, LocalizerParameters], steps: int, runs: int, seed: int, jobs: int
) -> dict[str, dict[str, dict[str, FilterErrors]]]:
    """Run all filters in all cases of both simulations; errors by simulation, case and filter.

    Args:
        localizers: parameters of the filters, by path.
        steps: of a run, periods of 375 ms.
        runs: of a case.
        seed: of everything random, with the block.
        jobs: processes.

    Raises:
        WorkError: a run failed, or a process has ended.
    """
    blocks = [
        _Block(path, number, min(RUNS_AT_ONCE, runs - first))
        for path in SIMULATIONS
        for number, first in enumerate(range(0, runs, RUNS_AT_ONCE))
    ]
    requests = [(f"{block.path}, block {block.number + 1}", block) for block in blocks]
    with closing(in_any_order(jobs, _Runner, requests, localizers, steps, seed)) as work:
        done = dict(with_progress(work, len(requests), "study lasting"))
    answers = {
        path: [done[number] for number, block in enumerate(blocks) if block.path == path]
        for path in SIMULATIONS
    }
    return {
        path: {
            case: {name: _joined([each[case][name] for each in parts]) for name in LABELS}
            for case in CASES
        }
        for path, parts in answers.items()
    }


class _Runner:
    """Runs blocks, in any process."""

    def __init__(
        self, localizers: Mapping[str, LocalizerParameters], steps: int, seed: int
    ) -> None:
        self._localizers, self._steps, self._seed = dict(localizers), steps, seed

    def __call__(self, block: _Block) -> BlockErrors:
        """Return the errors of a block."""
        localizer, seed = self._localizers[block.path], (self._seed, block.number)
        return run_cases(localizer, block.path, self._steps, block.runs, seed)


def _joined(parts: list[FilterErrors]) -> FilterErrors:
    """Return the arrays `(..., n)` of several blocks as those of all runs."""
    return FilterErrors(*(np.concatenate(arrays, axis=-1) for arrays in zip(*parts, strict=True)))
