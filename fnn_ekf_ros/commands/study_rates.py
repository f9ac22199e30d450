# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""`study rates`: does accuracy depend on the period, and on rates and phases of the sensors."""

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
from fnn_ekf_ros.study.rate_runs import run_rates
from fnn_ekf_ros.study.rates import CELLS, PATH, case_length, case_runs
from fnn_ekf_ros.study.report.rates_figures import draw_rates
from fnn_ekf_ros.study.report.rates_tables import (
    head,
    period_numbers,
    period_rows,
    period_table,
    rate_numbers,
    rate_row,
    rate_table,
    summary,
)
from fnn_ekf_ros.study.settings import study_localizer, write_settings
from fnn_ekf_ros.version import version

NAME = "rates"
"""Name of the subcommand."""
SUMMARY = "periods, rates and phases of the sensors: does accuracy depend on them"
"""Its line in `study --help`."""
RANGES = {"runs": Range(2, 10_000), "fixes": Range(4, 10_000), "seed": Range(0, 2**63 - 1)}
"""Ranges of the options; one run has no confidence interval."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    add_folder_argument(parser, "tables, picture and settings")
    parser.add_argument(
        "--runs", metavar="N", type=int, default=20,
        help="runs of a row of mode joint (20); twice as many where they are short, fewer where "
        f"they are long, {len(CELLS)} times as many of mode none",
    )  # fmt: skip
    parser.add_argument(
        "--fixes", metavar="N", type=int, default=800,
        help="fixes in a run of mode joint (800); runs of mode none have 375 ms for each",
    )  # fmt: skip
    add_seed_argument(parser)
    add_json_argument(parser)
    add_jobs_argument(parser)
    add_parameter_arguments(parser)


def run(arguments: argparse.Namespace) -> int:
    """Run the command."""
    check_ranges(vars(arguments), RANGES)
    jobs, given = given_jobs(arguments), given_parameters(arguments, LOCALIZER)
    localizer = study_localizer(PATH, given)
    require_matplotlib()
    out, runs, fixes = arguments.out, arguments.runs, arguments.fixes
    numbers = prepare_study(out, ["results.md"], arguments.json, arguments.params)
    made_by = {
        "study": NAME, "version": version(), "runs": runs, "fixes": fixes,
        "seed": arguments.seed, "parameters": given,
    }  # fmt: skip
    write_settings(out, PATH, given)

    found = run_rates(localizer, runs, fixes, arguments.seed, jobs)
    periods = [
        row
        for phases, errors in found.periods.items()
        for row in period_rows(phases, found.period_seconds, errors)
    ]
    rates = [
        rate_row(case, case_length(case, fixes), case_runs(case, runs), errors)
        for case, errors in found.cases
    ]
    content = {
        **made_by,
        "periods": [period_numbers(row) for row in periods],
        "rates": [rate_numbers(row) for row in rates],
    }
    write_json(numbers, content)
    parts = (head(made_by), summary(periods, rates), period_table(periods), rate_table(rates))
    write_text(out / "results.md", "\n".join(parts))
    draw_rates(out, periods, rates)
    print(f"{out}: {len(periods)} rows of periods and {len(rates)} of rates, {runs} runs")
    print(summary(periods, rates), end="")
    print(f"{out / 'results.md'}: the tables")
    return 0
