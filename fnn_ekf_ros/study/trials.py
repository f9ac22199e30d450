# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""A trial: recordings, starts and the oracle, on which any filter can be scored."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from fnn_ekf_ros.core.arrays import FloatArray
from fnn_ekf_ros.parameters.fake_robot import FakeRobotParameters
from fnn_ekf_ros.study.filters import StudyFilter
from fnn_ekf_ros.study.recording import Recording, Start
from fnn_ekf_ros.study.scenarios import NOMINAL_MEASUREMENT_NOISE, Scenario, event_steps, record
from fnn_ekf_ros.study.scores import Errors, Score, compare, join_scores, rms_over_runs, score
from fnn_ekf_ros.study.starts import RIGHT, Cell, starts

CELLS_AT_ONCE = 5
"""Number of starts of a hundred runs that go through a filter as one batch: more fall out of the
cache and are slower, with fewer the overhead of Python dominates."""


class Size(NamedTuple):
    """Size of a study.

    Attributes:
        steps: T, periods of 375 ms.
        runs: n, recordings that differ in what is random.
        seed: of everything random.
    """

    steps: int
    runs: int
    seed: int


class Trial(NamedTuple):
    """Recordings and starts that all filters are run on.

    Attributes:
        name: of the simulation or the case.
        recording: of n robots.
        cells: how wrong the starts are.
        start: `(cells, n)`.
        ranges: steps that are scored, by name.
        oracle: errors `(T, n)` of the EKF that knows the true noise of each step.
    """

    name: str
    recording: Recording
    cells: tuple[Cell, ...]
    start: Start
    ranges: Mapping[str, slice]
    oracle: Errors


class TrialPlan(NamedTuple):
    """Plan from which `make_trial` makes a trial; small, and can be pickled.

    Attributes:
        name: of the trial.
        robot: the robot.
        scenario: what goes wrong.
        cells: how wrong the starts are.
        ranges: steps that are scored, by name.
        size: of the trial.
    """

    name: str
    robot: FakeRobotParameters
    scenario: Scenario
    cells: tuple[Cell, ...]
    ranges: Mapping[str, slice]
    size: Size


class Outcome(NamedTuple):
    """Outcome of a filter in a trial.

    Attributes:
        trial: the trial's name.
        filter: the filter's name.
        cells: of the scores; the oracle knows no wrong start and has one cell.
        scores: by range, each with the leading dimension `(cells,)`.
        rms: `(T, cells, 3)` root mean square error over the runs (m, m, rad).
        first_run: `(T, cells, 3)` poses of the first run (m, m, rad).
        first_truth: `(T, 3)` where that robot was.
    """

    trial: str
    filter: str
    cells: tuple[Cell, ...]
    scores: Mapping[str, Score]
    rms: FloatArray
    first_run: FloatArray
    first_truth: FloatArray


def halves(steps: int) -> dict[str, slice]:
    """Return the ranges of a run in which nothing happens."""
    return {"whole": slice(0, steps), "last half": slice(steps // 2, steps)}


def around_event(steps: int) -> dict[str, slice]:
    """Return the ranges of a run in which something does; after it, for as long as it lasted."""
    event = event_steps(steps)
    after = slice(event.stop, 2 * event.stop - event.start)
    return {"whole": slice(0, steps), "during": event, "after": after}


def make_trial(
    name: str,
    robot: FakeRobotParameters,
    scenario: Scenario,
    cells: Sequence[Cell],
    ranges: Mapping[str, slice],
    size: Size,
    oracle: StudyFilter,
) -> Trial:
    """Return a trial. With the same seed, trials differ in nothing but what they are about.

    Args:
        name: of the trial.
        robot: the robot; a factor of 1 stands for its slip.
        scenario: what goes wrong.
        cells: how wrong the starts are.
        ranges: steps that are scored.
        size: of the trial.
        oracle: the filter that knows the true noise.
    """
    record_rng, start_rng = np.random.default_rng(size.seed).spawn(2)
    recording = record(robot, scenario, size.steps, size.runs, record_rng)
    Q = np.square(robot.slip())
    start = starts(recording, Q, NOMINAL_MEASUREMENT_NOISE, cells, start_rng)
    known = Start(*(array[0] for array in start))
    errors = compare(oracle.run(recording, known), recording.truth)
    trial = Trial(
        name=name,
        recording=recording,
        cells=tuple(cells),
        start=start,
        ranges=ranges,
        oracle=errors,
    )
    return _as_another_process_gets_it(trial)


def blocks(cells: Sequence[Cell]) -> list[slice]:
    """Return which cells go through a filter as one batch: numpy may round others differently."""
    return [slice(first, first + CELLS_AT_ONCE) for first in range(0, len(cells), CELLS_AT_ONCE)]


def try_block(trial: Trial, study_filter: StudyFilter, block: slice) -> Outcome:
    """Run a filter from some starts of a trial and score it.

    Args:
        trial: the trial.
        study_filter: the filter.
        block: the cells of these starts, one of `blocks`.
    """
    some = Start(*(array[block] for array in trial.start))
    errors = compare(study_filter.run(trial.recording, some), trial.recording.truth)
    return _outcome(trial, study_filter.name, trial.cells[block], errors)


def join_outcomes(parts: Sequence[Outcome]) -> Outcome:
    """Return the outcome of a filter in a trial, from those of its blocks in their order."""
    first = parts[0]
    return first._replace(
        cells=tuple(cell for part in parts for cell in part.cells),
        scores={
            label: join_scores([part.scores[label] for part in parts]) for label in first.scores
        },
        rms=np.concatenate([part.rms for part in parts], axis=1),
        first_run=np.concatenate([part.first_run for part in parts], axis=1),
    )


def oracle_outcome(trial: Trial, oracle: StudyFilter) -> Outcome:
    """Return what became of the oracle."""
    errors = Errors(*(array[:, None] for array in trial.oracle))
    return _outcome(trial, oracle.name, (RIGHT,), errors)


def _as_another_process_gets_it(trial: Trial) -> Trial:
    """Return the trial with arrays in C order: how numpy rounds depends on their layout."""
    recording = trial.recording
    return trial._replace(
        recording=recording._replace(
            truth=np.ascontiguousarray(recording.truth),
            control=np.ascontiguousarray(recording.control),
            measurement=np.ascontiguousarray(recording.measurement),
            available=np.ascontiguousarray(recording.available),
        ),
        start=Start(*map(np.ascontiguousarray, trial.start)),
        oracle=Errors(*map(np.ascontiguousarray, trial.oracle)),
    )


def _outcome(trial: Trial, name: str, cells: tuple[Cell, ...], errors: Errors) -> Outcome:
    return Outcome(
        trial=trial.name,
        filter=name,
        cells=cells,
        scores={label: score(errors, trial.oracle, steps) for label, steps in trial.ranges.items()},
        rms=rms_over_runs(errors),
        first_run=errors.error[:, :, 0] + trial.recording.truth[1:, None, 0],
        first_truth=trial.recording.truth[1:, 0],
    )
