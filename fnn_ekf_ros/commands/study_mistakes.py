# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""`study mistakes`: do the running localizer and `doctor` name what is wrong with a robot."""

import argparse
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from fnn_ekf_ros.calibration.examination import Drive
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
from fnn_ekf_ros.files.text_files import write_text
from fnn_ekf_ros.parameters.localizer import NODE_NAME as LOCALIZER
from fnn_ekf_ros.recordings.bag_files import BagReader, check_bags
from fnn_ekf_ros.recordings.diagnosis import BagExamination
from fnn_ekf_ros.recordings.inputs import TopicNames
from fnn_ekf_ros.reports.progress import with_progress
from fnn_ekf_ros.reports.results import study_results
from fnn_ekf_ros.study.diagnosed_mistakes import Diagnosed
from fnn_ekf_ros.study.mistake_runs import (
    HOW_TO_READ,
    HOW_TO_READ_RECORDINGS,
    MistakePlan,
    Recorded,
    diagnose_recording,
    doctor_table,
    mistake_table,
    recorded_summary,
    recorded_table,
    run_mistakes,
    summary,
)
from fnn_ekf_ros.study.mistakes import MISTAKES, NOTHING, configured
from fnn_ekf_ros.study.report.tables import command_head
from fnn_ekf_ros.version import version

NAME = "mistakes"
"""Name of the subcommand."""
SUMMARY = "mistakes of robot, wiring and configuration: do the localizer and doctor name them"
"""Its line in `study --help`."""
COUNTS = (Count("runs", 3, Range(1, 1000), "runs of each mistake and slip"),)
"""Numbers that the study is asked for."""
SECONDS = Range(1.0, 3600.0, "s")
"""Range of `--seconds`."""
PATHS = ("square", "round", "figure_eight", "sim1", "sim2")
"""Paths to choose from."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument(
        "bags", metavar="BAG", type=Path, nargs="*",
        help="recordings to put the mistakes into, instead of simulated robots; NAME.yaml beside "
        "NAME holds its localizer parameters",
    )  # fmt: skip
    add_study_arguments(parser, "table and numbers", COUNTS)
    parser.add_argument(
        "--seconds", metavar="S", type=float, default=120.0, help="length of a run [s] (120)"
    )
    parser.add_argument("--path", choices=PATHS, default="square", help="what is driven (square)")
    add_remapping_argument(parser)
    names = ", ".join((*(mistake.name for mistake in MISTAKES), NOTHING))
    parser.add_argument("--mistakes", metavar="A,B", help=f"some of {names} (all)")


def run(arguments: argparse.Namespace) -> int:
    """Run the command."""
    check_study_arguments(arguments, COUNTS)
    check_ranges(vars(arguments), {"seconds": SECONDS})
    known = [*(mistake.name for mistake in MISTAKES), NOTHING]
    words = arguments.mistakes
    names = known if words is None else chosen_names("--mistakes", words, known)
    if arguments.bags:
        return _recorded(arguments, names)
    plan = MistakePlan(
        names=names,
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
        {
            **each._asdict(),
            "named_s": None if math.isnan(each.named_s) else each.named_s,
            "doctor": _as_json(each.doctor),
        }
        for each in told
    ]
    options = {
        "runs": plan.runs, "seconds": f"{plan.seconds:g}", "path": plan.path, "seed": plan.seed,
    }  # fmt: skip
    if words is not None:
        options["mistakes"] = ",".join(plan.names)
    head = command_head(made_by, options, HOW_TO_READ)
    tables = f"{mistake_table(plan.names, told)}\n{doctor_table(plan.names, told)}"
    with results.written({**made_by, "results": rows}) as folder:
        write_text(folder / "results.md", f"{head}\n{tables}")
    print(f"{out}: {summary(told)}")
    print(f"{out / 'results.md'}: the tables")
    return 0


def _as_json(found: Diagnosed) -> dict[str, Any]:
    return {**found._asdict(), "error": None if math.isnan(found.error) else found.error}


def _recorded(arguments: argparse.Namespace, names: Sequence[str]) -> int:
    """Put the mistakes into recordings."""
    check_bags(arguments.bags)
    out = arguments.out
    inputs = [*arguments.bags, *arguments.params]
    results = study_results(out, arguments.json, inputs, replaces=arguments.force)
    found: list[Recorded] = []
    for bag in arguments.bags:
        drive, values = _read(bag, arguments)
        found += diagnose_recording(bag.name, drive, values, names)
    rows = [{**each._asdict(), "doctor": _as_json(each.doctor)} for each in found]
    bags = [bag.name for bag in arguments.bags]
    made_by = {
        "study": NAME,
        "version": version(),
        "bags": bags,
        "names": list(names),
        "parameters": given_parameters(arguments, LOCALIZER),
    }
    options = {} if arguments.mistakes is None else {"mistakes": ",".join(names)}
    head = command_head(made_by, options, HOW_TO_READ_RECORDINGS, " ".join(bags))
    with results.written({**made_by, "results": rows}) as folder:
        write_text(folder / "results.md", f"{head}\n{recorded_table(found)}")
    print(f"{out}: {recorded_summary(found)}")
    print(f"{out / 'results.md'}: the table")
    return 0


def _read(bag: Path, arguments: argparse.Namespace) -> tuple[Drive, dict[str, Any]]:
    """Return the readings of a recording, and the parameters that go with them."""
    given, _ = recorded_parameters(arguments, bag, LOCALIZER)
    with BagReader(bag) as reader:
        examination = BagExamination(reader, given, TopicNames(arguments.remappings))
        for record in with_progress(reader.records(), reader.message_count, bag.name):
            examination.add(record)
        return examination.drive(), examination.configured
