# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""What a study's results.md says in words, and that its numbers are the study's."""

import math

import numpy as np
import pytest

from fnn_ekf_ros.evaluation.intervals import Interval
from fnn_ekf_ros.membership.files import read_membership
from fnn_ekf_ros.study import grid, paper
from fnn_ekf_ros.study.report.words import dynamic_words, grid_words, membership_words, paper_words
from fnn_ekf_ros.study.scores import Score
from fnn_ekf_ros.study.starts import RIGHT, Cell
from fnn_ekf_ros.study.trials import Outcome

LABELS = {
    "oracle": "oracle EKF", "ekf": "EKF", "rq_published": "FNN-EKF", "rq_trained": "trained",
    "joint": "joint",
}  # fmt: skip


def outcome(trial: str, name: str, cells: tuple[Cell, ...], worst: list[float]) -> Outcome:
    """Return an outcome whose worst ratio, that of theta, is given for each start."""
    value = np.array([[0.5 * w, 0.9 * w, w] for w in worst])
    ratio = Interval(value, value, value)
    one = np.ones(len(cells))
    score = Score(ratio, ratio, Interval(one, one, one), one, (1.0, 2.0), one, one, one)
    nothing = np.zeros((1, len(cells), 3))
    return Outcome(trial, name, cells, {"whole": score}, nothing, nothing, nothing[:, 0])


def of_paper(name: str, *worst: float) -> list[Outcome]:
    return [outcome(trial, name, paper.STARTS, [*worst]) for trial in paper.TRIALS]


def test_paper_says_where_the_papers_filter_wins_and_where_it_cannot() -> None:
    outcomes = [
        *of_paper("ekf", 1.0, 1.7, 5.1),
        *of_paper("rq_published", 2.1, 1.701, 2.2),
        *of_paper("joint", 1.0, 1.04, 1.07),
    ]
    text = paper_words(outcomes, LABELS)
    for words in (
        "simulation 1, right start: the FNN-EKF loses, 2.10 against 1.00 of the EKF; nearest to "
        "the oracle is EKF, 1.00.",
        "simulation 2, R x 25: they are alike, 1.70 against 1.70 of the EKF; nearest to the "
        "oracle is joint, 1.04.",
        "experiment (simulated), Q / 25, R x 25: the FNN-EKF wins, 2.20 against 5.10 of the EKF; "
        "nearest to the oracle is joint, 1.07.",
        "| simulation 2, Q / 25, R x 25 | 5.10 | 2.20 | 1.07 |",
    ):
        assert words in text, words
    assert "forgets its start: 1.70 to 2.20 in simulation 1, 1.70 to 2.20 in simulation 2" in text
    assert "What that costs" not in text
    assert "plain fuzzy system" not in text


def test_learned_and_published_parameters_stand_in_one_table_and_what_they_cost() -> None:
    outcomes = [*of_paper("rq_published", 2.1, 1.7, 2.2), *of_paper("rq_trained", 1.2, 1.8, 1.3)]
    text = membership_words(outcomes)
    published, trained = (read_membership(name).sets for name in ("published", "trained"))
    for letter, key in (
        ("a2", "negative_slope"),
        ("b3", "decrease_center"),
        ("c1", "maintain_center"),
    ):
        row = f"{getattr(published, key):g} | {getattr(trained, key):g} |"
        assert any(line.startswith(f"| {letter} |") and line.endswith(row)
                   for line in text.splitlines()), letter  # fmt: skip
    assert f"{trained.negative_slope:.4f} where the paper prints 0.1515" in text
    assert f"b3 {trained.decrease_center:.1f} where it prints -143, each in its own unit" in text
    assert "| a2/a4 | gain of I | 1 | 1.5 |" in text
    assert "| a1/a3 | gain of D | 0 | 1.6 |" in text
    gains = sorted([trained.negative_slope / trained.increase_slope,
                    trained.positive_slope / trained.decrease_slope])  # fmt: skip
    assert "{:.2g} to {:.2g} of the trained set, 1.5 to 1.6 of the".format(*gains) in text
    assert (
        "simulation 1, right start: 1.20 against 2.10; simulation 1, R x 25: 1.80 against" in text
    )


def test_grid_ranks_the_filters_by_their_worst_starts() -> None:
    cells = (RIGHT, Cell(25.0, 0.04))
    outcomes = [
        outcome(trial, name, cells, [1.0, worst])
        for trial in grid.SIMULATIONS
        for name, worst in (("ekf", 5.27), ("rq_published", 2.2), ("joint", 1.08))
    ]
    text = grid_words(outcomes, LABELS)
    assert "- simulation 1: joint 1.08, FNN-EKF 2.20, EKF 5.27." in text
    assert "- simulation 2: joint 1.08" in text


def test_a_filter_that_left_the_numbers_is_the_worst() -> None:
    cells = (RIGHT, Cell(25.0, 0.04))
    outcomes = [
        outcome(trial, name, cells, [1.0, worst])
        for trial in grid.SIMULATIONS
        for name, worst in (("rq_published", math.nan), ("ekf", 5.27), ("joint", 1.08))
    ]
    assert "- simulation 1: joint 1.08, EKF 5.27, FNN-EKF n/a." in grid_words(outcomes, LABELS)
    lost = [*of_paper("ekf", 1.0, 1.7, 5.1), *of_paper("rq_published", 2.1, math.nan, 2.2)]
    assert "R x 25: the FNN-EKF loses, n/a against 1.70 of the EKF" in paper_words(lost, LABELS)


@pytest.mark.parametrize("names", [("ekf",), ("ekf", "rq_published", "joint")])
def test_dynamic_names_the_right_start_of_what_ran(names: tuple[str, ...]) -> None:
    outcomes = [outcome("slip", name, (RIGHT,), [2.0 + i]) for i, name in enumerate(names)]
    (line,) = (line for line in dynamic_words(outcomes, LABELS).splitlines() if "slip" in line)
    said = ", ".join(f"{LABELS[name]} {2.0 + i:.2f}" for i, name in enumerate(names))
    assert line == f"- wheel slip of 100 times the variance: {said}."
