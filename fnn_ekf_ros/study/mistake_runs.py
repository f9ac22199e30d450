# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The runs of `study mistakes`, by several processes, and their table."""

import math
from collections.abc import Sequence
from contextlib import closing
from typing import Any, NamedTuple

from fnn_ekf_ros.parameters.fake_robot import FakeRobotParameters
from fnn_ekf_ros.reports.progress import with_progress
from fnn_ekf_ros.study.mistakes import IN_TIME_S, MISTAKES, NOTHING, SLIPS, Told, follow_mistake
from fnn_ekf_ros.study.report.tables import table
from fnn_ekf_ros.study.workers import in_any_order

HOW_TO_READ = f"""\
Each run has one mistake from the start, or none. In time: within {IN_TIME_S:g} s of driving the
status of the sensor tells it, with the parameter and the value to set, in each report to the end.
After: seconds until then, in each run; - where it is not told. Others: sensors that are not OK
after it is told. Wrong: other mistakes that are told at any time.
"""
"""Explains the table."""


class MistakePlan(NamedTuple):
    """Plan of `study mistakes`.

    Attributes:
        names: of the mistakes, and `NOTHING`.
        runs: of each mistake and slip.
        seconds: length of each run [s].
        path: what is driven.
        seed: of the first run.
        given: parameters of the localizer that the user chose.
    """

    names: Sequence[str]
    runs: int
    seconds: float
    path: str
    seed: int
    given: dict[str, Any]


class _Run(NamedTuple):
    """A run: its mistake, its slip and its seed."""

    name: str
    slip: str
    seed: int


class _Runner:
    """Runs robots with mistakes, in any process."""

    def __init__(self, path: str, seconds: float, given: dict[str, Any]) -> None:
        self._path, self._seconds, self._given = path, seconds, given

    def __call__(self, run: _Run) -> Told:
        """Return what diagnostics say."""
        robot = FakeRobotParameters(path=self._path, seed=run.seed, slip_std=SLIPS[run.slip])
        return follow_mistake(run.name, run.slip, robot, self._seconds, self._given)


def run_mistakes(plan: MistakePlan, jobs: int) -> list[Told]:
    """Run robots with mistakes.

    Args:
        plan: the runs.
        jobs: processes.

    Raises:
        WorkError: a run failed, or a process has ended.
    """
    runs = [
        _Run(name, slip, plan.seed + number)
        for name in plan.names
        for slip in SLIPS
        for number in range(plan.runs)
    ]
    requests = [(f"{run.name}, slip {run.slip}, seed {run.seed}", run) for run in runs]
    work = in_any_order(jobs, _Runner, requests, plan.path, plan.seconds, plan.given)
    with closing(work):
        done = dict(with_progress(work, len(requests), "study mistakes"))
    return [done[number] for number in range(len(requests))]


def mistake_table(names: Sequence[str], told: Sequence[Told]) -> str:
    """Return the results in Markdown."""
    about = {mistake.name: mistake.about for mistake in MISTAKES}
    lines = []
    for name in names:
        for slip in SLIPS:
            own = [each for each in told if each.mistake == name and each.slip == slip]
            after = ["-" if math.isnan(e.named_s) else f"{e.named_s:.0f}" for e in own]
            lines.append(
                [
                    name,
                    about.get(name, "as configured"),
                    slip,
                    "n/a" if name == NOTHING else f"{sum(e.in_time for e in own)} of {len(own)}",
                    ", ".join(after),
                    own[0].value if own else "",
                    ", ".join(sorted({other for each in own for other in each.others})) or "-",
                    "; ".join(dict.fromkeys(said for each in own for said in each.wrong)) or "-",
                    f"{sum(e.warned for e in own) / max(sum(e.reports for e in own), 1):.1%}",
                ]
            )
    return table(
        ["mistake", "what it is", "slip", "in time", "after [s]", "value told, first run", "others",
         "wrong", "WARN or worse"],
        lines,
    )  # fmt: skip


def summary(told: Sequence[Told]) -> str:
    """Return in one line how many were named in time."""
    wrong = [each for each in told if each.mistake != NOTHING]
    nothing = [each for each in told if each.mistake == NOTHING]
    parts = [f"{sum(each.in_time for each in wrong)} of {len(wrong)} mistakes told in time"]
    parts.append(f"{sum(bool(each.wrong) for each in wrong)} runs with another one")
    if nothing:
        said = sum(bool(each.wrong) for each in nothing)
        parts.append(f"without a mistake {said} of {len(nothing)} runs with one told")
    return ", ".join(parts)
