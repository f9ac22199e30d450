# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""`compare BAG...`: runs, or parameter sets on one recording, side by side."""

import argparse
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from fnn_ekf_ros import messages
from fnn_ekf_ros.commands.arguments import (
    add_force_argument,
    add_remapping_argument,
    add_text_argument,
    check_command_results,
)
from fnn_ekf_ros.errors import FnnEkfError
from fnn_ekf_ros.evaluation.alignment import Alignment
from fnn_ekf_ros.evaluation.comparison import Compared, measures
from fnn_ekf_ros.evaluation.evaluation import evaluate
from fnn_ekf_ros.files.text_files import readable
from fnn_ekf_ros.localizer.localizer import Localizer
from fnn_ekf_ros.membership.files import networks_for
from fnn_ekf_ros.parameters.files import (
    parse_assignment,
    read_parameter_file,
    refuse_what_ros_refuses,
)
from fnn_ekf_ros.parameters.localizer import NODE_NAME, LocalizerParameters
from fnn_ekf_ros.parameters.schema import build
from fnn_ekf_ros.recordings.bag_files import BagReader, check_bags
from fnn_ekf_ros.recordings.inputs import TopicNames, inputs_in
from fnn_ekf_ros.recordings.run_record import RunRecord
from fnn_ekf_ros.recordings.runs import read_run, run_localizer
from fnn_ekf_ros.recordings.trajectories import read_trajectory
from fnn_ekf_ros.reports.comparison_table import (
    comparison_lines,
    format_comparison,
    plain_comparison,
    verdicts,
)
from fnn_ekf_ros.reports.progress import with_progress
from fnn_ekf_ros.timeline.trajectory import Trajectory


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    topic: dict[str, Any] = {"metavar": "TOPIC", "type": messages.absolute_name}
    parser.add_argument(
        "bags", metavar="BAG", type=Path, nargs="+",
        help="a recording of one run; with --params the one recording to run each set on",
    )  # fmt: skip
    parser.add_argument(
        "--params", metavar="FILE", type=Path, nargs="+",
        help="parameter files in ROS form: the localizer runs over BAG with each of them",
    )  # fmt: skip
    parser.add_argument(
        "-p", dest="assignments", metavar="NAME:=VALUE", action="append", default=[],
        help="one parameter of all sets, with --params; wins over files",
    )  # fmt: skip
    add_remapping_argument(parser)
    parser.add_argument(
        "--odom-topic", default="/odom", help="topic of the estimate (/odom)", **topic
    )
    parser.add_argument(
        "--truth-topic", help="topic of the ground truth (/ground_truth, if it is there)", **topic
    )
    parser.add_argument(
        "--truth-bag", metavar="BAG", type=Path, help="take the ground truth from this bag"
    )
    parser.add_argument(
        "--align", choices=[str(mode) for mode in Alignment], default=str(Alignment.NONE),
        help="move each run before it is compared with the truth, as evaluate --align does (none)",
    )  # fmt: skip
    parser.add_argument(
        "--labels", nargs="+", metavar="LABEL", type=readable, help="names of the runs"
    )
    add_text_argument(parser, "--json", "write all numbers as JSON")
    add_force_argument(parser)


def run(arguments: argparse.Namespace) -> int:
    """Run the command."""
    truth_bags = [] if arguments.truth_bag is None else [arguments.truth_bag]
    check_bags([*arguments.bags, *truth_bags])
    labels = _labels(arguments)
    inputs = [*arguments.bags, *truth_bags, *(arguments.params or ())]
    check_command_results(arguments, ["--json"], inputs)
    alignment = Alignment(arguments.align)
    runs: dict[str, Compared] = {}
    for label, (record, truth) in zip(labels, _runs(arguments, labels), strict=True):
        runs[label] = Compared(record, truth, evaluate(record, truth, alignment))
    compared = measures(runs)
    print(format_comparison(labels, comparison_lines(runs, compared)))
    print()
    for line in verdicts(runs, compared):
        print(line)
    for label, each in runs.items():
        for text in each.found.truth.warnings if each.found.truth is not None else ():
            print(f"warning: {label}: {text}")
    if arguments.json is not None:
        arguments.json.write_json(plain_comparison(runs, compared), indent=2)
    return 0


def _labels(arguments: argparse.Namespace) -> list[str]:
    """Return the names of the runs.

    Raises:
        FnnEkfError: labels do not fit the runs, or arguments do not fit each other.
    """
    if arguments.params is None:
        for option, given in (("-p", arguments.assignments), ("-r", arguments.remappings)):
            if given:
                raise FnnEkfError(
                    f"{option} {given[0]}: expected --params, which runs the localizer"
                )
    elif len(arguments.bags) > 1:
        raise FnnEkfError(f"--params: {len(arguments.bags)} bags, expected one to run each set on")
    sources = arguments.params or arguments.bags
    labels = list(arguments.labels or [readable(str(path)) for path in sources])
    if len(labels) != len(sources):
        raise FnnEkfError(f"--labels: {len(labels)} labels, expected {len(sources)}")
    if len(set(labels)) < len(labels):
        raise FnnEkfError(f"{', '.join(labels)}: expected different labels, see --labels")
    if len(labels) < 2:
        raise FnnEkfError("one run: expected at least two to compare; evaluate is for one")
    return labels


def _runs(
    arguments: argparse.Namespace, labels: Sequence[str]
) -> list[tuple[RunRecord, Trajectory | None]]:
    """Return the runs with their ground truth."""
    if arguments.params is None:
        found = []
        for path in arguments.bags:
            with BagReader(path) as bag:
                record = read_run(bag, arguments.odom_topic)
            found.append((record, _truth(arguments, arguments.truth_bag or path)))
        return found
    (path,) = arguments.bags
    truth = _truth(arguments, arguments.truth_bag or path)
    sets = [_parameters(file, arguments.assignments) for file in arguments.params]
    return [
        (_run_over(path, each, arguments.remappings, label), truth)
        for each, label in zip(sets, labels, strict=True)
    ]


def _parameters(file: Path, assignments: Sequence[str]) -> LocalizerParameters:
    values: dict[str, Any] = dict(read_parameter_file(file, NODE_NAME))
    values.update(parse_assignment(text) for text in assignments)
    refuse_what_ros_refuses(values)
    # Each set starts from its own noise, not from what an earlier run has saved.
    return replace(build(LocalizerParameters, values), warm_start=False)


def _run_over(
    path: Path, parameters: LocalizerParameters, remappings: list[str], label: str
) -> RunRecord:
    """Run the localizer over a recording; nothing is written."""
    localizer = Localizer(parameters, networks_for(parameters))
    with BagReader(path) as bag:
        inputs = inputs_in(bag, parameters, TopicNames(remappings))
        records = with_progress(bag.records(), bag.message_count, label)
        return run_localizer(bag, records, localizer, inputs)


def _truth(arguments: argparse.Namespace, source: Path) -> Trajectory | None:
    """Return the ground truth of a bag; None if it has none and none was asked for."""
    topic = arguments.truth_topic or messages.absolute_name(messages.GROUND_TRUTH)
    asked = arguments.truth_topic is not None or arguments.truth_bag is not None
    with BagReader(source) as bag:
        if not asked and topic not in bag.topics:
            return None
        return read_trajectory(bag, topic)
