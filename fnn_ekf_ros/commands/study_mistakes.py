# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""`study mistakes`: does the running localizer name what is wrong with robot or configuration."""

import argparse
import math

from fnn_ekf_ros.commands.arguments import (
    Range,
    add_folder_argument,
    add_jobs_argument,
    add_seed_argument,
    check_ranges,
    chosen_names,
    given_jobs,
)
from fnn_ekf_ros.files.text_files import write_json, write_text
from fnn_ekf_ros.reports.result_folder import prepare_study
from fnn_ekf_ros.study.mistake_runs import (
    HOW_TO_READ,
    MistakePlan,
    mistake_table,
    run_mistakes,
    summary,
)
from fnn_ekf_ros.study.mistakes import MISTAKES, NOTHING
from fnn_ekf_ros.study.report.tables import command_head
from fnn_ekf_ros.version import version

NAME = "mistakes"
"""Name of the subcommand."""
SUMMARY = "mistakes of robot, wiring and configuration: does the running localizer name them"
"""Its line in `study --help`."""
RANGES = {
    "runs": Range(1, 1000),
    "seconds": Range(1.0, 3600.0, "s"),
    "seed": Range(0, 2**31 - 1001),
}
"""Ranges of the options."""
PATHS = ("square", "round", "figure_eight", "sim1", "sim2")
"""Paths to choose from."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    add_folder_argument(parser, "table and numbers")
    parser.add_argument(
        "--runs", metavar="N", type=int, default=3, help="runs of each mistake and slip (3)"
    )
    parser.add_argument(
        "--seconds", metavar="S", type=float, default=120.0, help="length of a run [s] (120)"
    )
    parser.add_argument("--path", choices=PATHS, default="square", help="what is driven (square)")
    add_seed_argument(parser)
    names = ", ".join((*(mistake.name for mistake in MISTAKES), NOTHING))
    parser.add_argument("--mistakes", metavar="A,B", help=f"some of {names} (all)")
    add_jobs_argument(parser)


def run(arguments: argparse.Namespace) -> int:
    """Run the command."""
    check_ranges(vars(arguments), RANGES)
    jobs = given_jobs(arguments)
    known = [*(mistake.name for mistake in MISTAKES), NOTHING]
    words = arguments.mistakes
    plan = MistakePlan(
        names=known if words is None else chosen_names("--mistakes", words, known),
        runs=arguments.runs,
        seconds=arguments.seconds,
        path=arguments.path,
        seed=arguments.seed,
    )
    out = arguments.out
    numbers = prepare_study(out, ["results.md"])
    made_by = {"study": NAME, "version": version(), "parameters": {}, **plan._asdict()}
    told = run_mistakes(plan, jobs)
    rows = [
        {**each._asdict(), "named_s": None if math.isnan(each.named_s) else each.named_s}
        for each in told
    ]
    write_json(numbers, {**made_by, "results": rows})
    options = {
        "runs": plan.runs, "seconds": f"{plan.seconds:g}", "path": plan.path, "seed": plan.seed,
    }  # fmt: skip
    if words is not None:
        options["mistakes"] = ",".join(plan.names)
    head = command_head(made_by, options, HOW_TO_READ)
    write_text(out / "results.md", f"{head}\n{mistake_table(plan.names, told)}")
    print(f"{out}: {summary(told)}")
    print(f"{out / 'results.md'}: the table")
    return 0
