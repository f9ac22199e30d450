# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The studies `paper`, `grid` and `dynamic`: their trials, words, tables and figures."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

from fnn_ekf_ros.study import dynamic, grid, paper
from fnn_ekf_ros.study.filters import BANK, CENTROID, DEAD_RECKONING, EKF, PAPER
from fnn_ekf_ros.study.report import figures as study_figures
from fnn_ekf_ros.study.report import paper_figures as study_paper_figures
from fnn_ekf_ros.study.report import tables as study_tables
from fnn_ekf_ros.study.report import words as study_words
from fnn_ekf_ros.study.trials import Outcome, Size, TrialPlan


class Study(NamedTuple):
    """A study.

    Attributes:
        summary: what it does.
        paths: of the fake robot, whose settings are written down.
        plans: of its trials.
        words: what the numbers show.
        tables: the results in Markdown.
        figures: draws them into a folder.
        left_out: filters that run only when they are named.
        always: filters that run even when they are not named.
        defaults: parameters of the filters that differ from the localizer's.
    """

    summary: str
    paths: tuple[str, ...]
    plans: Callable[[Size], Sequence[TrialPlan]]
    words: Callable[[Sequence[Outcome], study_tables.Labels], str]
    tables: Callable[[Sequence[Outcome], study_tables.Labels], str]
    figures: Callable[[Path, Sequence[Outcome], study_tables.Labels], None]
    left_out: tuple[str, ...] = (DEAD_RECKONING, BANK, CENTROID)
    always: tuple[str, ...] = ()
    defaults: Mapping[str, Any] = MappingProxyType({})


def _paper_tables(outcomes: Sequence[Outcome], labels: study_tables.Labels) -> str:
    tables = study_tables.paper_tables(outcomes, labels)
    return f"{tables}\n## Figures\n\n{study_paper_figures.figure_table()}"


STUDIES = {
    "paper": Study(
        "the paper's simulations and experiment, with its figures",
        tuple(paper.TRIALS), paper.plans,
        study_words.paper_words, _paper_tables, study_paper_figures.draw_paper, left_out=(BANK,),
        always=(EKF, PAPER),
        defaults=MappingProxyType({"motion_model": "paper"}),
    ),
    "grid": Study(
        "both simulations from 25 starts with wrong noise",
        tuple(grid.SIMULATIONS), grid.plans,
        study_words.grid_words, study_tables.grid_tables, study_figures.draw_grid,
    ),
    "dynamic": Study(
        "noise that changes, and errors that are no white noise",
        (dynamic.PATH,), dynamic.plans,
        study_words.dynamic_words, study_tables.dynamic_tables, study_figures.draw_dynamic,
    ),
}  # fmt: skip
"""The studies by name."""
