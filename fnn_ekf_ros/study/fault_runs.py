# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The runs of `study faults`, by several processes."""

from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import asdict
from typing import Any, NamedTuple

import numpy as np

from fnn_ekf_ros.membership.files import networks_for
from fnn_ekf_ros.parameters.fake_robot import FakeRobotParameters
from fnn_ekf_ros.parameters.localizer import LocalizerParameters
from fnn_ekf_ros.parameters.matching import matching_localizer
from fnn_ekf_ros.parameters.schema import build
from fnn_ekf_ros.reports.progress import with_progress
from fnn_ekf_ros.study.fault_naming import (
    NAMING_CASES,
    PATHS,
    QUIET_PATHS,
    FaultCase,
    Naming,
    Quiet,
    Setting,
    name_fault,
    quiet_run,
)
from fnn_ekf_ros.study.report.tables import start_words
from fnn_ekf_ros.study.starts import CORNERS, RIGHT, Cell, with_noise_factors
from fnn_ekf_ros.study.workers import in_any_order


class FaultPlan(NamedTuple):
    """Plan of `study faults`.

    Attributes:
        cases: the faults.
        runs: of each fault.
        quiet_runs: without a fault, of each path and start.
        quiet_seconds: length of the runs without a fault [s].
        seed: of all random numbers.
        given: parameters of the localizer that differ from those that fit the robot.
    """

    cases: Sequence[FaultCase]
    runs: int
    quiet_runs: int
    quiet_seconds: float
    seed: int
    given: dict[str, Any]


class FaultResults(NamedTuple):
    """Results of `study faults`.

    Attributes:
        named: of each run with a fault.
        quiet: of each run without one, with its start.
    """

    named: list[Naming]
    quiet: list[tuple[Cell, Quiet]]


def run_faults(plan: FaultPlan, jobs: int) -> FaultResults:
    """Run robots with and without faults.

    Args:
        plan: the runs.
        jobs: processes.

    Raises:
        WorkError: a run failed, or a process has ended.
    """
    quiet_runs, fault_runs = list(_quiet_runs(plan)), list(_fault_runs(plan))
    runs: list[_FaultRun | _QuietRun] = [*quiet_runs, *fault_runs]
    requests = [(each.words(), each) for each in runs]
    work = in_any_order(jobs, _Runner, requests, plan.seed, plan.quiet_seconds, plan.given)
    with closing(work):
        done = dict(with_progress(work, len(requests), "study faults"))
    answers = [done[number] for number in range(len(requests))]
    by_name = {case.name: case for case in plan.cases}
    return FaultResults(
        named=[
            Naming(by_name[each.case], *answer)
            for each, answer in zip(fault_runs, answers[len(quiet_runs) :], strict=True)
        ],
        quiet=[
            (each.cell, answer)
            for each, answer in zip(quiet_runs, answers[: len(quiet_runs)], strict=True)
        ],
    )


def setting_of(path: str, seed: int, cell: Cell, given: dict[str, Any]) -> Setting:
    """Return a robot and its localizer.

    Args:
        path: what is driven.
        seed: of the robot.
        cell: how wrong the configured noise is.
        given: parameters of the localizer that differ from those that fit the robot.

    Raises:
        ParameterError: a given parameter is wrong.
    """
    robot = FakeRobotParameters(path=path, seed=seed)
    matching = with_noise_factors(matching_localizer(robot), cell)
    localizer = build(LocalizerParameters, asdict(matching) | given)
    return Setting(robot=robot, localizer=localizer, networks=networks_for(localizer))


class _FaultRun(NamedTuple):
    """A run with a fault.

    Attributes:
        case: name of the fault.
        number: of the run, from 0.
    """

    case: str
    number: int

    def words(self) -> str:
        """Return what it is."""
        return f"fault {self.case}, run {self.number + 1}"


class _QuietRun(NamedTuple):
    """A run without a fault.

    Attributes:
        cell: how wrong the start is.
        path: what is driven.
        number: of the run, from 0.
    """

    cell: Cell
    path: str
    number: int

    def words(self) -> str:
        """Return what it is."""
        return f"quiet run {self.number + 1} on {self.path}, {start_words(self.cell)}"


class _Runner:
    """Runs robots with and without faults, in any process."""

    def __init__(self, seed: int, quiet_seconds: float, given: dict[str, Any]) -> None:
        self._seed = seed
        self._quiet_seconds = quiet_seconds
        self._given = given

    def __call__(self, run: _FaultRun | _QuietRun) -> Quiet | tuple[Any, ...]:
        """Return a `Quiet`, or a `Naming` without its case, which cannot be pickled."""
        if isinstance(run, _QuietRun):
            rng = np.random.default_rng([self._seed, run.number, 1])
            setting = setting_of(run.path, int(rng.integers(2**31)), run.cell, self._given)
            return quiet_run(setting, self._quiet_seconds)
        (case,) = (case for case in NAMING_CASES if case.name == run.case)
        # The same robots and onsets for every fault, whichever are chosen.
        rng = np.random.default_rng([self._seed, run.number])
        path = PATHS[run.number % len(PATHS)]
        setting = setting_of(path, int(rng.integers(2**31)), RIGHT, self._given)
        return name_fault(case, setting, rng)[1:]


def _fault_runs(plan: FaultPlan) -> Iterator[_FaultRun]:
    for case in plan.cases:
        for number in range(plan.runs):
            yield _FaultRun(case.name, number)


def _quiet_runs(plan: FaultPlan) -> Iterator[_QuietRun]:
    for cell in (RIGHT, *CORNERS):
        for path in QUIET_PATHS:
            for number in range(plan.quiet_runs):
                yield _QuietRun(cell, path, number)
