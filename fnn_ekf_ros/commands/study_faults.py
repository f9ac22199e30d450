# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""`study faults`: is the sensor that fails named, and is nobody named while nothing is wrong."""

import argparse

from fnn_ekf_ros.commands.arguments import (
    Count,
    Range,
    add_study_arguments,
    check_ranges,
    check_study_arguments,
    chosen_names,
    given_parameters,
)
from fnn_ekf_ros.files.text_files import write_text
from fnn_ekf_ros.parameters.localizer import NODE_NAME as LOCALIZER
from fnn_ekf_ros.reports.results import study_results
from fnn_ekf_ros.study.fault_naming import NAMING_CASES, PATHS, FaultCase
from fnn_ekf_ros.study.fault_runs import FaultPlan, run_faults, setting_of
from fnn_ekf_ros.study.report.fault_tables import (
    fault_tables,
    head,
    naming_numbers,
    quiet_numbers,
    shares,
)
from fnn_ekf_ros.study.starts import RIGHT
from fnn_ekf_ros.version import version

NAME = "faults"
"""Name of the subcommand."""
SUMMARY = "faults of one sensor at a time: which sensor diagnostics name, and how soon"
"""Its line in `study --help`."""
COUNTS = (
    Count("runs", 20, Range(1, 1000), "runs of each fault"),
    Count("quiet-runs", 10, Range(0, 1000), "runs without a fault, of each path and start"),
)
"""Numbers that the study is asked for."""
QUIET_SECONDS = Range(1.0, 3600.0, "s")
"""Range of `--quiet-seconds`."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    add_study_arguments(parser, "tables and numbers", COUNTS)
    parser.add_argument(
        "--quiet-seconds", metavar="S", type=float, default=300.0,
        help="length of the runs without a fault [s] (300)",
    )  # fmt: skip
    names = ", ".join(case.name for case in NAMING_CASES)
    parser.add_argument("--faults", metavar="A,B", help=f"some of {names} (all)")


def run(arguments: argparse.Namespace) -> int:
    """Run the command."""
    check_study_arguments(arguments, COUNTS)
    check_ranges(vars(arguments), {"quiet_seconds": QUIET_SECONDS})
    plan = FaultPlan(
        cases=_cases(arguments.faults),
        runs=arguments.runs,
        quiet_runs=arguments.quiet_runs,
        quiet_seconds=arguments.quiet_seconds,
        seed=arguments.seed,
        given=given_parameters(arguments, LOCALIZER),
    )
    setting_of(PATHS[0], 0, RIGHT, plan.given)  # refuses wrong parameters before any work
    out = arguments.out
    results = study_results(out, arguments.json, arguments.params, replaces=arguments.force)
    made_by = {
        "study": NAME, "version": version(), "runs": plan.runs, "quiet_runs": plan.quiet_runs,
        "quiet_seconds": plan.quiet_seconds, "seed": plan.seed,
        "faults": [case.name for case in plan.cases], "parameters": plan.given,
    }  # fmt: skip
    named, quiet = run_faults(plan, arguments.jobs)
    content = {
        **made_by,
        "results": [naming_numbers(naming) for naming in named],
        "quiet": [quiet_numbers(*each) for each in quiet],
    }
    with results.written(content) as folder:
        write_text(folder / "results.md", head(made_by) + fault_tables(plan.cases, named, quiet))
    print(f"{out}: {shares(named)}")
    print(f"{out / 'results.md'}: the tables")
    return 0


def _cases(words: str | None) -> list[FaultCase]:
    known = {case.name: case for case in NAMING_CASES}
    names = list(known) if words is None else chosen_names("--faults", words, known)
    return [known[name] for name in names]
