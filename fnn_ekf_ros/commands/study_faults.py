# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""`study faults`: is the sensor that fails named, and is nobody named while nothing is wrong."""

import argparse

from fnn_ekf_ros.commands.arguments import (
    Range,
    add_folder_argument,
    add_jobs_argument,
    add_parameter_arguments,
    add_seed_argument,
    check_ranges,
    chosen_names,
    given_jobs,
    given_parameters,
)
from fnn_ekf_ros.files.text_files import write_json, write_text
from fnn_ekf_ros.parameters.localizer import NODE_NAME as LOCALIZER
from fnn_ekf_ros.reports.result_folder import prepare_study
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
RANGES = {
    "runs": Range(1, 1000),
    "quiet_runs": Range(0, 1000),
    "quiet_seconds": Range(1.0, 3600.0, "s"),
    "seed": Range(0, 2**31 - 1),
}
"""Ranges of the options."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    add_folder_argument(parser, "tables and numbers")
    parser.add_argument("--runs", metavar="N", type=int, default=20, help="runs of each fault (20)")
    parser.add_argument(
        "--quiet-runs", metavar="N", type=int, default=10,
        help="runs without a fault, of each path and start (10)",
    )  # fmt: skip
    parser.add_argument(
        "--quiet-seconds", metavar="S", type=float, default=300.0,
        help="length of the runs without a fault [s] (300)",
    )  # fmt: skip
    add_seed_argument(parser)
    names = ", ".join(case.name for case in NAMING_CASES)
    parser.add_argument("--faults", metavar="A,B", help=f"some of {names} (all)")
    add_jobs_argument(parser)
    add_parameter_arguments(parser)


def run(arguments: argparse.Namespace) -> int:
    """Run the command."""
    check_ranges(vars(arguments), RANGES)
    jobs = given_jobs(arguments)
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
    numbers = prepare_study(out, ["results.md"])
    made_by = {
        "study": NAME, "version": version(), "runs": plan.runs, "quiet_runs": plan.quiet_runs,
        "quiet_seconds": plan.quiet_seconds, "seed": plan.seed,
        "faults": [case.name for case in plan.cases], "parameters": plan.given,
    }  # fmt: skip
    named, quiet = run_faults(plan, jobs)
    content = {
        **made_by,
        "results": [naming_numbers(naming) for naming in named],
        "quiet": [quiet_numbers(*each) for each in quiet],
    }
    write_json(numbers, content)
    write_text(out / "results.md", head(made_by) + fault_tables(plan.cases, named, quiet))
    print(f"{out}: {shares(named)}")
    print(f"{out / 'results.md'}: the tables")
    return 0


def _cases(words: str | None) -> list[FaultCase]:
    known = {case.name: case for case in NAMING_CASES}
    names = list(known) if words is None else chosen_names("--faults", words, known)
    return [known[name] for name in names]
