"""`study paper|grid|dynamic`: Monte Carlo runs through every filter; tables, figures, JSON.

`study real`, `study faults` and `study rates` are other modules'.
"""

import argparse
import json
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

from fnn_ekf_ros.errors import FnnEkfError
from fnn_ekf_ros.parameters.localizer import NODE_NAME as LOCALIZER
from fnn_ekf_ros.study import dynamic, grid, paper
from fnn_ekf_ros.study.filters import (
    BANK,
    CENTROID,
    DEAD_RECKONING,
    EKF,
    ORACLE,
    PAPER,
    StudyFilter,
    study_filters,
)
from fnn_ekf_ros.study.trials import Outcome, Size, TrialPlan
from fnn_ekf_ros.text_files import write_text
from fnn_ekf_ros.tools import (
    study_faults,
    study_figures,
    study_paper_figures,
    study_rates,
    study_real,
    study_tables,
    study_words,
)
from fnn_ekf_ros.tools.arguments import add_parameter_arguments, given_parameters
from fnn_ekf_ros.tools.pictures import require_matplotlib
from fnn_ekf_ros.tools.progress import with_progress
from fnn_ekf_ros.tools.result_folder import prepare_study
from fnn_ekf_ros.tools.study_settings import study_localizer, write_settings
from fnn_ekf_ros.tools.study_trials import joined, pieces, work_through
from fnn_ekf_ros.tools.workers import add_jobs_argument, given_jobs
from fnn_ekf_ros.version import version

MOST = {"runs": 10_000, "steps": 100_000, "seed": 2**63 - 1}
MOST_PERIODS = 2_000_000
"""Periods of all runs of a trial together: more would not fit into the memory of a computer."""
FEWEST = {"runs": 2, "steps": 10, "seed": 0}
"""One run has no confidence interval."""


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


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    names = parser.add_subparsers(metavar="STUDY", required=True)
    for name, study in STUDIES.items():
        own = names.add_parser(name, help=study.summary, description=study.summary)
        own.set_defaults(study=name)
        own.add_argument(
            "--out", metavar="DIR", type=Path, required=True,
            help="folder for tables, figures and settings; files of the same name are replaced",
        )  # fmt: skip
        own.add_argument("--runs", metavar="N", type=int, default=100, help="recordings (100)")
        own.add_argument(
            "--steps", metavar="N", type=int, default=800, help="periods of 375 ms (800)"
        )
        own.add_argument("--seed", metavar="S", type=int, default=1, help="of everything (1)")
        but = f" but {', '.join(study.left_out)}" if study.left_out else ""
        own.add_argument(
            "--filters",
            metavar="A,B",
            help=f"filters beside {', '.join((ORACLE, *study.always))}, by name (all{but})",
        )
        own.add_argument(
            "--json", metavar="FILE", type=Path, help="write the numbers here (DIR/results.json)"
        )
        add_jobs_argument(own)
        add_parameter_arguments(own)
    real = names.add_parser(
        study_real.NAME, help=study_real.SUMMARY, description=study_real.SUMMARY
    )
    real.set_defaults(study=study_real.NAME)
    study_real.add_arguments(real)
    faults = names.add_parser(
        study_faults.NAME, help=study_faults.SUMMARY, description=study_faults.SUMMARY
    )
    faults.set_defaults(study=study_faults.NAME)
    study_faults.add_arguments(faults)
    rates = names.add_parser(
        study_rates.NAME, help=study_rates.SUMMARY, description=study_rates.SUMMARY
    )
    rates.set_defaults(study=study_rates.NAME)
    study_rates.add_arguments(rates)


def run(arguments: argparse.Namespace) -> int:
    """Run the command."""
    if arguments.study == study_real.NAME:
        return study_real.run(arguments)
    if arguments.study == study_faults.NAME:
        return study_faults.run(arguments)
    if arguments.study == study_rates.NAME:
        return study_rates.run(arguments)
    study = STUDIES[arguments.study]
    size, jobs = _size(arguments), given_jobs(arguments)
    given = {**study.defaults, **given_parameters(arguments, LOCALIZER)}
    filters = study_filters(study_localizer(study.paths[0], given))
    names = _chosen(arguments.filters, filters, study)
    require_matplotlib()
    out = arguments.out
    numbers = prepare_study(out, ["results.md"], arguments.json, arguments.params)
    made_by = {
        "study": arguments.study, "version": version(), **size._asdict(), "filters": names,
        "parameters": given,
    }  # fmt: skip
    for path in study.paths:
        write_settings(out, path, given)

    plans = study.plans(size)
    total = len(pieces(plans, names))
    with closing(work_through(plans, filters, names, jobs)) as work:
        done = dict(with_progress(work, total, f"study {arguments.study}"))
    outcomes = joined(done, plans, names)

    labels = {name: each.label for name, each in filters.items()}
    content = {**made_by, "results": study_tables.rows(outcomes)}
    write_text(numbers, json.dumps(content, indent=1, allow_nan=False) + "\n")
    parts = (
        study_tables.head(made_by),
        study.words(outcomes, labels),
        study.tables(outcomes, labels),
    )
    write_text(out / "results.md", "\n".join(parts))
    study.figures(out, outcomes, labels)
    print(f"{out}: {len(plans)} trials of {size.runs} runs, {', '.join([ORACLE, *names])}")
    print(f"{out / 'results.md'}: the tables")
    return 0


def _size(arguments: argparse.Namespace) -> Size:
    for name, fewest in FEWEST.items():
        value = getattr(arguments, name)
        if not fewest <= value <= MOST[name]:
            raise FnnEkfError(f"--{name} {value}: expected {fewest} to {MOST[name]}")
    if arguments.runs * arguments.steps > MOST_PERIODS:
        raise FnnEkfError(
            f"--runs {arguments.runs} --steps {arguments.steps}: expected {MOST_PERIODS} periods "
            "of all runs together at most, which are kept in memory"
        )
    return Size(arguments.steps, arguments.runs, arguments.seed)


def _chosen(words: str | None, known: dict[str, StudyFilter], study: Study) -> list[str]:
    """Return the names of the filters to try, in the order they are known in."""
    possible = [name for name in known if name != ORACLE]
    if words is None:
        return [name for name in possible if name not in study.left_out]
    chosen = [word.strip() for word in words.split(",")]
    for word in chosen:
        if word not in possible:
            raise FnnEkfError(f"--filters {word}: expected some of {', '.join(possible)}")
    return [name for name in possible if name in (*chosen, *study.always)]
