# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""`study mistakes`: does the running localizer name what is wrong with robot or configuration."""

import argparse
import math

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
from fnn_ekf_ros.study.mistake_runs import (
    HOW_TO_READ,
    MistakePlan,
    mistake_table,
    run_mistakes,
    summary,
)
from fnn_ekf_ros.study.mistakes import MISTAKES, NOTHING, configured
from fnn_ekf_ros.study.report.tables import command_head
from fnn_ekf_ros.version import version

NAME = "mistakes"
"""Name of the subcommand."""
SUMMARY = "mistakes of robot, wiring and configuration: does the running localizer name them"
"""Its line in `study --help`."""
COUNTS = (Count("runs", 3, Range(1, 1000), "runs of each mistake and slip"),)
"""Numbers that the study is asked for."""
SECONDS = Range(1.0, 3600.0, "s")
"""Range of `--seconds`."""
PATHS = ("square", "round", "figure_eight", "sim1", "sim2")
"""Paths to choose from."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    add_study_arguments(parser, "table and numbers", COUNTS)
    parser.add_argument(
        "--seconds", metavar="S", type=float, default=120.0, help="length of a run [s] (120)"
    )
    parser.add_argument("--path", choices=PATHS, default="square", help="what is driven (square)")
    names = ", ".join((*(mistake.name for mistake in MISTAKES), NOTHING))
    parser.add_argument("--mistakes", metavar="A,B", help=f"some of {names} (all)")


def run(arguments: argparse.Namespace) -> int:
    """Run the command."""
    check_study_arguments(arguments, COUNTS)
    check_ranges(vars(arguments), {"seconds": SECONDS})
    known = [*(mistake.name for mistake in MISTAKES), NOTHING]
    words = arguments.mistakes
    plan = MistakePlan(
        names=known if words is None else chosen_names("--mistakes", words, known),
        runs=arguments.runs,
        seconds=arguments.seconds,
        path=arguments.path,
        seed=arguments.seed,
        given=given_parameters(arguments, LOCALIZER),
    )
    configured(plan.given)  # refuses wrong parameters before any work
    out = arguments.out
    results = study_results(out, arguments.json, arguments.params, replaces=arguments.force)
    made_by = {"study": NAME, "version": version(), **plan._asdict()}
    made_by["parameters"] = made_by.pop("given")
    told = run_mistakes(plan, arguments.jobs)
    rows = [
        {**each._asdict(), "named_s": None if math.isnan(each.named_s) else each.named_s}
        for each in told
    ]
    options = {
        "runs": plan.runs, "seconds": f"{plan.seconds:g}", "path": plan.path, "seed": plan.seed,
    }  # fmt: skip
    if words is not None:
        options["mistakes"] = ",".join(plan.names)
    head = command_head(made_by, options, HOW_TO_READ)
    with results.written({**made_by, "results": rows}) as folder:
        write_text(folder / "results.md", f"{head}\n{mistake_table(plan.names, told)}")
    print(f"{out}: {summary(told)}")
    print(f"{out / 'results.md'}: the table")
    return 0
