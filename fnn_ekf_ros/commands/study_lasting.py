# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""`study lasting`: errors of fixes and compass that last, from right and wrong starts."""

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
COUNTS = (
    runs_count(40, "robots of each simulation"),
    Count("steps", 1600, Range(10, 20_000), "periods of 375 ms in each run"),
)
"""Numbers that the study is asked for; more steps do not fit into memory."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    add_study_arguments(parser, "tables, picture and settings", COUNTS)


def run(arguments: argparse.Namespace) -> int:
    """Run the command."""
    check_study_arguments(arguments, COUNTS)
    given = given_parameters(arguments, LOCALIZER)
    localizers = {path: study_localizer(path, given) for path in SIMULATIONS}
    require_matplotlib()
    out, runs, steps = arguments.out, arguments.runs, arguments.steps
    results = study_results(out, arguments.json, arguments.params, replaces=arguments.force)
    made_by = {
        "study": NAME, "version": version(), "runs": runs, "steps": steps,
        "seed": arguments.seed, "parameters": given,
    }  # fmt: skip
    rows = lasting_rows(run_lasting(localizers, steps, runs, arguments.seed, arguments.jobs))
    found = [each for row in rows for each in lasting_numbers(row)]
    parts = (head(made_by), summary(rows), lasting_tables(rows))
    with results.written({**made_by, "results": found}) as folder:
        for path in SIMULATIONS:
            write_settings(folder, path, given)
        write_text(folder / "results.md", "\n".join(parts))
        draw_lasting(folder, rows)
    print(f"{out}: {len(rows)} rows, {runs} runs of {steps} periods")
    print(summary(rows), end="")
    print(f"{out / 'results.md'}: the tables")
    return 0
