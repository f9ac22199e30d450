# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""`study lasting`: errors of fixes and compass that last, from right and wrong starts."""

import argparse

from fnn_ekf_ros.commands.arguments import (
    Range,
    add_folder_argument,
    add_jobs_argument,
    add_json_argument,
    add_parameter_arguments,
    add_seed_argument,
    check_ranges,
    given_jobs,
    given_parameters,
)
from fnn_ekf_ros.files.text_files import write_json, write_text
from fnn_ekf_ros.parameters.localizer import NODE_NAME as LOCALIZER
from fnn_ekf_ros.reports.pictures import require_matplotlib
from fnn_ekf_ros.reports.result_folder import prepare_study
from fnn_ekf_ros.study.lasting import SIMULATIONS
from fnn_ekf_ros.study.lasting_runs import run_lasting
from fnn_ekf_ros.study.report.lasting_figures import draw_lasting
from fnn_ekf_ros.study.report.lasting_tables import (
    head,
    lasting_numbers,
    lasting_rows,
    lasting_tables,
    summary,
)
from fnn_ekf_ros.study.settings import study_localizer, write_settings
from fnn_ekf_ros.version import version

NAME = "lasting"
"""Name of the subcommand."""
SUMMARY = "errors of fixes and compass that last, beside an EKF that knows their model"
"""Its line in `study --help`."""
RANGES = {"runs": Range(2, 10_000), "steps": Range(10, 20_000), "seed": Range(0, 2**63 - 1)}
"""Ranges of the options; one run has no confidence interval, more steps do not fit into memory."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    add_folder_argument(parser, "tables, picture and settings")
    parser.add_argument(
        "--runs", metavar="N", type=int, default=40, help="robots of each simulation (40)"
    )
    parser.add_argument(
        "--steps", metavar="N", type=int, default=1600, help="periods of 375 ms in each run (1600)"
    )
    add_seed_argument(parser)
    add_json_argument(parser)
    add_jobs_argument(parser)
    add_parameter_arguments(parser)


def run(arguments: argparse.Namespace) -> int:
    """Run the command."""
    check_ranges(vars(arguments), RANGES)
    jobs, given = given_jobs(arguments), given_parameters(arguments, LOCALIZER)
    localizers = {path: study_localizer(path, given) for path in SIMULATIONS}
    require_matplotlib()
    out, runs, steps = arguments.out, arguments.runs, arguments.steps
    numbers = prepare_study(out, ["results.md"], arguments.json, arguments.params)
    made_by = {
        "study": NAME, "version": version(), "runs": runs, "steps": steps,
        "seed": arguments.seed, "parameters": given,
    }  # fmt: skip
    for path in SIMULATIONS:
        write_settings(out, path, given)

    rows = lasting_rows(run_lasting(localizers, steps, runs, arguments.seed, jobs))
    found = [each for row in rows for each in lasting_numbers(row)]
    write_json(numbers, {**made_by, "results": found})
    parts = (head(made_by), summary(rows), lasting_tables(rows))
    write_text(out / "results.md", "\n".join(parts))
    draw_lasting(out, rows)
    print(f"{out}: {len(rows)} rows, {runs} runs of {steps} periods")
    print(summary(rows), end="")
    print(f"{out / 'results.md'}: the tables")
    return 0
