# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""`study rates`: does accuracy depend on the period, and on rates and phases of the sensors."""

import argparse

from fnn_ekf_ros.commands.arguments import (
    Count,
    Range,
    add_study_arguments,
    check_study_arguments,
    given_parameters,
    runs_count,
)
from fnn_ekf_ros.files.text_files import write_text
from fnn_ekf_ros.parameters.localizer import NODE_NAME as LOCALIZER
from fnn_ekf_ros.reports.pictures import require_matplotlib
from fnn_ekf_ros.reports.results import study_results
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
COUNTS = (
    runs_count(
        20,
        "runs of a row of mode joint; twice as many where they are short, fewer where they are "
        f"long, {len(CELLS)} times as many of mode none",
    ),
    Count(
        "fixes",
        800,
        Range(4, 10_000),
        "fixes in a run of mode joint; runs of mode none have 375 ms for each",
    ),
)
"""Numbers that the study is asked for."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    add_study_arguments(parser, "tables, picture and settings", COUNTS)


def run(arguments: argparse.Namespace) -> int:
    """Run the command."""
    check_study_arguments(arguments, COUNTS)
    given = given_parameters(arguments, LOCALIZER)
    localizer = study_localizer(PATH, given)
    require_matplotlib()
    out, runs, fixes = arguments.out, arguments.runs, arguments.fixes
    results = study_results(out, arguments.json, arguments.params, replaces=arguments.force)
    made_by = {
        "study": NAME, "version": version(), "runs": runs, "fixes": fixes,
        "seed": arguments.seed, "parameters": given,
    }  # fmt: skip
    found = run_rates(localizer, runs, fixes, arguments.seed, arguments.jobs)
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
    parts = (head(made_by), summary(periods, rates), period_table(periods), rate_table(rates))
    with results.written(content) as folder:
        write_settings(folder, PATH, given)
        write_text(folder / "results.md", "\n".join(parts))
        draw_rates(folder, periods, rates)
    print(f"{out}: {len(periods)} rows of periods and {len(rates)} of rates, {runs} runs")
    print(summary(periods, rates), end="")
    print(f"{out / 'results.md'}: the tables")
    return 0
