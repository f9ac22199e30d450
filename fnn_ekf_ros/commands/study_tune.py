# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""`study tune`: how near `tune` comes, for simulated robots and for recordings with a truth."""

import argparse
import math
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

from fnn_ekf_ros.commands.arguments import (
    Count,
    Range,
    add_remapping_argument,
    add_study_arguments,
    check_ranges,
    check_study_arguments,
    chosen_names,
    given_parameters,
    recorded_parameters,
)
from fnn_ekf_ros.errors import FnnEkfError
from fnn_ekf_ros.files.text_files import write_text
from fnn_ekf_ros.parameters.localizer import NODE_NAME as LOCALIZER
from fnn_ekf_ros.parameters.localizer import LocalizerParameters
from fnn_ekf_ros.parameters.schema import build
from fnn_ekf_ros.recordings.bag_files import check_bags
from fnn_ekf_ros.reports.progress import with_progress
from fnn_ekf_ros.reports.results import study_results
from fnn_ekf_ros.study.real_bags import read_recording
from fnn_ekf_ros.study.report.tables import command_head
from fnn_ekf_ros.study.workers import in_any_order
from fnn_ekf_ros.tuning.recorded import Recorded, tune_recording
from fnn_ekf_ros.tuning.trial_tables import (
    HOW_TO_READ,
    HOW_TO_READ_HALVES,
    HOW_TO_READ_RECORDINGS,
    halves_table,
    recorded_table,
    summary,
    trial_table,
)
from fnn_ekf_ros.tuning.trials import KINDS, Trial, tune_robot
from fnn_ekf_ros.version import version

NAME = "tune"
"""Name of the subcommand."""
SUMMARY = "how near tune comes, for simulated robots or for recordings with a ground truth"
"""Its line in `study --help`."""
COUNTS = (Count("runs", 10, Range(1, 1000), "robots of each kind"),)
"""Numbers that the study is asked for."""
SECONDS = Range(60.0, 7200.0, "s")
"""Range of `--seconds`."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument(
        "bags", metavar="BAG", type=Path, nargs="*",
        help="recordings with a ground truth, instead of simulated robots; NAME.yaml beside NAME "
        "holds its localizer parameters",
    )  # fmt: skip
    add_study_arguments(parser, "table and numbers", COUNTS)
    parser.add_argument(
        "--seconds", metavar="S", type=float, default=600.0, help="length of a drive [s] (600)"
    )
    parser.add_argument(
        "--halves", action="store_true",
        help="tune both halves of each drive, too: does the noise of the first fit the second?",
    )  # fmt: skip
    parser.add_argument("--kinds", metavar="A,B", help=f"some of {', '.join(KINDS)} (all)")
    parser.add_argument(
        "--truth-topic", metavar="TOPIC", default="/ground_truth",
        help="topic of the ground truth (/ground_truth)",
    )  # fmt: skip
    add_remapping_argument(parser)


def run(arguments: argparse.Namespace) -> int:
    """Run the command."""
    check_study_arguments(arguments, COUNTS)
    check_ranges(vars(arguments), {"seconds": SECONDS})
    names = list(KINDS)
    if arguments.kinds is not None:
        names = chosen_names("--kinds", arguments.kinds, names)
    given = given_parameters(arguments, LOCALIZER)
    if given and not arguments.bags:
        raise FnnEkfError("--params and -p are for recordings: expected at least one BAG with them")
    check_bags(arguments.bags)
    out = arguments.out
    inputs = [*arguments.bags, *arguments.params]
    results = study_results(out, arguments.json, inputs, replaces=arguments.force)
    made_by: dict[str, Any] = {"study": NAME, "version": version(), "parameters": given}
    made_by["halves"] = arguments.halves
    options: dict[str, Any] = {"halves": ""} if arguments.halves else {}
    rows: Sequence[Recorded | Trial]
    if arguments.bags:
        rows = recorded = [_recorded(bag, arguments) for bag in arguments.bags]
        bags = " ".join(bag.name for bag in arguments.bags)
        head = command_head(made_by, options, HOW_TO_READ_RECORDINGS, bags)
        body, said = recorded_table(recorded), f"{len(recorded)} recordings"
    else:
        chosen = {
            "runs": arguments.runs,
            "seconds": f"{arguments.seconds:g}",
            "seed": arguments.seed,
            "kinds": ",".join(names),
        }
        options = chosen | options
        rows = trials = _trials(names, arguments)
        head, body = command_head(made_by, options, HOW_TO_READ), trial_table(names, trials)
        made_by |= chosen
        said = summary(trials)
    halves = [(_name(row), row.halves) for row in rows if row.halves is not None]
    if halves:
        head, body = f"{head}\n{HOW_TO_READ_HALVES}", f"{body}\n{halves_table(halves)}"
    with results.written({**made_by, "results": [_plain(row) for row in rows]}) as folder:
        write_text(folder / "results.md", f"{head}\n{body}")
    print(f"{out}: {said}")
    print(f"{out / 'results.md'}: the table")
    return 0


class _Tuner:
    """Tunes robots, in any process."""

    def __init__(self, seconds: float, with_halves: bool) -> None:
        self._seconds, self._with_halves = seconds, with_halves

    def __call__(self, robot: tuple[str, int]) -> Trial:
        """Return what was found."""
        name, seed = robot
        return tune_robot(name, seed, self._seconds, with_halves=self._with_halves)


def _trials(names: Sequence[str], arguments: argparse.Namespace) -> list[Trial]:
    """Tune simulated robots."""
    robots = [(name, arguments.seed + number) for name in names for number in range(arguments.runs)]
    requests = [(f"{name}, seed {seed}", (name, seed)) for name, seed in robots]
    work = in_any_order(arguments.jobs, _Tuner, requests, arguments.seconds, arguments.halves)
    with closing(work):
        done = dict(with_progress(work, len(requests), "study tune"))
    return [done[number] for number in range(len(requests))]


def _recorded(bag: Path, arguments: argparse.Namespace) -> Recorded:
    """Tune a recording."""
    values, files = recorded_parameters(arguments, bag, LOCALIZER)
    recording = read_recording(
        bag,
        bag.stem if bag.is_file() else bag.resolve().name,
        build(LocalizerParameters, values),
        files,
        arguments.truth_topic,
        arguments.remappings,
    )
    return tune_recording(recording, lambda _: None, with_halves=arguments.halves)


def _name(row: Recorded | Trial) -> str:
    return row.label if isinstance(row, Recorded) else f"{row.kind}, seed {row.seed}"


def _plain(row: Recorded | Trial) -> dict[str, Any]:
    """Return a row for JSON, which knows no infinite standard error."""
    halves = None if row.halves is None else row.halves._asdict()
    if isinstance(row, Recorded):
        return {**row._asdict(), "halves": halves}
    found = [
        {**each._asdict(), "std": each.std if math.isfinite(each.std) else None}
        for each in row.found
    ]
    return {**row._asdict(), "found": found, "halves": halves}
