# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""`import-csv CSV OUT`: a recording from elsewhere as a bag, with a matching parameter file.

CSV: `t` [s], `left_ticks`, `right_ticks` (cumulative), and if known `gt_x`, `gt_y` [m],
`gt_theta` [rad] and a compass yaw `heading_meas` [rad]. `--fixes`: `t`, `fix_x`, `fix_y` [m],
`fix_theta` [rad], and if known their standard deviations `sig_x`, `sig_y` [m], `sig_theta` [rad]
and correlation `rho_xy`, which the localizer uses with lrf_use_message_covariance. An empty field
or nan is a missing value. `--geometry`: JSON with `wheel_base_m` and `metres_per_tick`.
"""

import argparse
from collections import Counter
from dataclasses import asdict
from pathlib import Path

import numpy as np

from fnn_ekf_ros.commands.arguments import add_force_argument
from fnn_ekf_ros.parameters.files import render_parameter_file
from fnn_ekf_ros.parameters.localizer import NODE_NAME, LocalizerParameters
from fnn_ekf_ros.parameters.schema import build
from fnn_ekf_ros.recordings.bag_writer import (
    STORAGES,
    BagWriter,
    file_beside,
    refuse_existing,
    refuse_inputs,
)
from fnn_ekf_ros.recordings.csv_hints import import_notes
from fnn_ekf_ros.recordings.csv_import import (
    COMPASS_COLUMN,
    FIX_COLUMNS,
    TRUTH_COLUMNS,
    Columns,
    chosen_columns,
    encoder_timeout,
    messages_of,
    read_geometry,
)
from fnn_ekf_ros.recordings.csv_tables import read_table
from fnn_ekf_ros.reports.progress import with_progress


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.description = __doc__
    parser.add_argument("csv", metavar="CSV", type=Path, help="t, left_ticks, right_ticks, ...")
    parser.add_argument("out", metavar="OUT", type=Path, help="the bag to write (a new folder)")
    parser.add_argument(
        "--fixes", metavar="CSV", type=Path, help="pose fixes, if they are in a separate file"
    )
    parser.add_argument(
        "--geometry", metavar="JSON", type=Path, help="wheel base and distance per tick (required)"
    )
    parser.add_argument(
        "--truth-columns",
        metavar="COLUMN",
        nargs="+",
        help="columns of the ground truth: x, y and, if known, yaw (gt_x gt_y gt_theta)",
    )
    parser.add_argument(
        "--fix-columns", metavar="COLUMN", nargs="+",
        help="columns of the fixes, in --fixes if given: x, y and, if known, yaw "
        "(fix_x fix_y fix_theta)",
    )  # fmt: skip
    parser.add_argument(
        "--compass-column", metavar="COLUMN", help=f"column of the compass yaw ({COMPASS_COLUMN})"
    )
    parser.add_argument(
        "--storage", choices=STORAGES, default="mcap", help="storage format of the bag (mcap)"
    )
    add_force_argument(parser)


def run(arguments: argparse.Namespace) -> int:
    """Run the command."""
    for result in (arguments.out, file_beside(arguments.out)):
        refuse_existing(result, replaces=arguments.force)
    given = (arguments.csv, arguments.fixes, arguments.geometry)
    refuse_inputs(arguments.out, [path for path in given if path is not None])
    table = read_table(arguments.csv)
    fixes = table if arguments.fixes is None else read_table(arguments.fixes)
    truth = chosen_columns(table, arguments.truth_columns, TRUTH_COLUMNS, "--truth-columns")
    fix = chosen_columns(fixes, arguments.fix_columns, FIX_COLUMNS, "--fix-columns")
    if arguments.fixes is not None and not fix:
        fixes.column(FIX_COLUMNS[0])
    compass = arguments.compass_column or (
        COMPASS_COLUMN if COMPASS_COLUMN in table.columns else ""
    )
    parameters = build(
        LocalizerParameters,
        read_geometry(arguments.geometry)
        | {
            "lrf_use_yaw": len(fix) == 3,
            "encoder_timeout": encoder_timeout(table.column("t")),
        },
    )

    columns = Columns(truth=truth, fixes=fix, compass=compass)
    timed = messages_of(table, fixes, columns, parameters)
    for source in {table.path: table, fixes.path: fixes}.values():
        backwards = int(np.sum(np.diff(source.column("t")) < 0.0))
        if backwards:
            print(f"import-csv: '{source.path}': t goes back {backwards} times; rows are sorted")
    head = f"Localizer parameters for {arguments.out.name}, imported from {arguments.csv.name}."
    matching = render_parameter_file(LocalizerParameters, asdict(parameters), NODE_NAME, head)
    notes = {"source": arguments.csv.name}
    writer = BagWriter(arguments.out, arguments.storage, notes, matching, replaces=arguments.force)
    with writer as bag:
        for entry in with_progress(timed, len(timed), "import-csv"):
            bag.write(f"/{entry.topic}", entry.message, entry.time_ns)
    counts = Counter(entry.topic for entry in timed)
    listed = ", ".join(f"{count} {topic}" for topic, count in counts.items())
    print(f"{arguments.out}: {listed}; {file_beside(arguments.out)}: matching localizer parameters")
    for note in import_notes(table, fixes, columns, counts):
        print(f"import-csv: {note}")
    return 0
