# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""`study NAME`: what every filter makes of many runs; tables, figures, JSON.

`study paper`, `grid` and `dynamic` are here; `real`, `faults`, `mistakes`, `rates`, `lasting` and
`tune` have their own modules.
"""

import argparse
from collections.abc import Callable, Mapping
from contextlib import closing
from typing import NamedTuple

from fnn_ekf_ros.commands import (
    study_faults,
    study_lasting,
    study_mistakes,
    study_rates,
    study_real,
    study_tune,
)
from fnn_ekf_ros.commands.arguments import (
    Count,
    Range,
    add_study_arguments,
    check_study_arguments,
    chosen_names,
    given_parameters,
    runs_count,
)
from fnn_ekf_ros.errors import FnnEkfError
from fnn_ekf_ros.files.text_files import write_text
from fnn_ekf_ros.parameters.localizer import NODE_NAME as LOCALIZER
from fnn_ekf_ros.reports.pictures import require_matplotlib
from fnn_ekf_ros.reports.progress import with_progress
from fnn_ekf_ros.reports.results import study_results
from fnn_ekf_ros.study.filters import ORACLE, StudyFilter, study_filters
from fnn_ekf_ros.study.monte_carlo import STUDIES, Study
from fnn_ekf_ros.study.report import tables
from fnn_ekf_ros.study.settings import study_localizer, write_settings
from fnn_ekf_ros.study.trials import Size
from fnn_ekf_ros.study.trials_in_processes import joined, pieces, work_through
from fnn_ekf_ros.version import version

COUNTS = (
    runs_count(100, "number of recordings"),
    Count("steps", 800, Range(10, 100_000), "periods of 375 ms in each"),
)
"""Numbers that a study of trials is asked for."""
MOST_PERIODS = 2_000_000
"""Largest number of periods of all runs of a trial together: more do not fit into memory."""


class OwnModule(NamedTuple):
    """A study with a module of its own.

    Attributes:
        summary: what it does.
        add_arguments: declares its arguments.
        run: runs it.
    """

    summary: str
    add_arguments: Callable[[argparse.ArgumentParser], None]
    run: Callable[[argparse.Namespace], int]


OWN_MODULES = {
    module.NAME: OwnModule(module.SUMMARY, module.add_arguments, module.run)
    for module in (study_real, study_faults, study_mistakes, study_rates, study_lasting, study_tune)
}
"""The studies with modules of their own, by name."""


def add_arguments(parser: argparse.ArgumentParser) -> Mapping[str, argparse.ArgumentParser]:
    """Declare the command's arguments; return the parsers of the studies."""
    names = parser.add_subparsers(metavar="STUDY", required=True)
    for name, study in STUDIES.items():
        own = names.add_parser(name, help=study.summary, description=study.summary)
        own.set_defaults(study=name)
        _add_study_arguments(own, study)
    for name, module in OWN_MODULES.items():
        own = names.add_parser(name, help=module.summary, description=module.summary)
        own.set_defaults(study=name)
        module.add_arguments(own)
    return names.choices


def _add_study_arguments(parser: argparse.ArgumentParser, study: Study) -> None:
    add_study_arguments(parser, "tables, figures and settings", COUNTS)
    but = f" but {', '.join(study.left_out)}" if study.left_out else ""
    parser.add_argument(
        "--filters",
        metavar="A,B",
        help=f"names of the filters beside {', '.join((ORACLE, *study.always))} (all{but})",
    )


def run(arguments: argparse.Namespace) -> int:
    """Run the command."""
    if arguments.study in OWN_MODULES:
        return OWN_MODULES[arguments.study].run(arguments)
    study = STUDIES[arguments.study]
    size = _size(arguments)
    given = {**study.defaults, **given_parameters(arguments, LOCALIZER)}
    filters = study_filters(study_localizer(study.paths[0], given))
    names = _filter_names(arguments.filters, filters, study)
    require_matplotlib()
    out = arguments.out
    results = study_results(out, arguments.json, arguments.params, replaces=arguments.force)
    made_by = {
        "study": arguments.study, "version": version(), **size._asdict(), "filters": names,
        "parameters": given,
    }  # fmt: skip

    plans = study.plans(size)
    total = len(pieces(plans, names))
    with closing(work_through(plans, filters, names, arguments.jobs)) as work:
        done = dict(with_progress(work, total, f"study {arguments.study}"))
    outcomes = joined(done, plans, names)

    labels = {name: each.label for name, each in filters.items()}
    parts = (tables.head(made_by), study.words(outcomes, labels), study.tables(outcomes, labels))
    with results.written({**made_by, "results": tables.rows(outcomes)}) as folder:
        for path in study.paths:
            write_settings(folder, path, given)
        write_text(folder / "results.md", "\n".join(parts))
        study.figures(folder, outcomes, labels)
    print(f"{out}: {len(plans)} trials of {size.runs} runs, {', '.join([ORACLE, *names])}")
    print(f"{out / 'results.md'}: the tables")
    return 0


def _size(arguments: argparse.Namespace) -> Size:
    check_study_arguments(arguments, COUNTS)
    if arguments.runs * arguments.steps > MOST_PERIODS:
        raise FnnEkfError(
            f"--runs {arguments.runs} --steps {arguments.steps}: expected {MOST_PERIODS} periods "
            "of all runs together at most, which are kept in memory"
        )
    return Size(steps=arguments.steps, runs=arguments.runs, seed=arguments.seed)


def _filter_names(words: str | None, known: dict[str, StudyFilter], study: Study) -> list[str]:
    """Return the names of the filters to try, in the order they are known in."""
    possible = [name for name in known if name != ORACLE]
    if words is None:
        return [name for name in possible if name not in study.left_out]
    chosen = chosen_names("--filters", words, possible)
    return [name for name in possible if name in (*chosen, *study.always)]
