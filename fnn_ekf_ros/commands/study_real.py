# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""`study real BAG...`: every start of the localizer on recordings with a ground truth."""

import argparse
from dataclasses import asdict
from pathlib import Path

from fnn_ekf_ros.commands.arguments import (
    add_parameter_arguments,
    add_remapping_argument,
    add_study_results,
    chosen_names,
    recorded_parameters,
)
from fnn_ekf_ros.errors import FnnEkfError
from fnn_ekf_ros.files.text_files import write_text
from fnn_ekf_ros.parameters.files import (
    parse_assignment,
    render_parameter_file,
)
from fnn_ekf_ros.parameters.localizer import NODE_NAME, LocalizerParameters
from fnn_ekf_ros.parameters.schema import ParameterError, build
from fnn_ekf_ros.recordings.bag_files import STORAGE_SUFFIXES, check_bags
from fnn_ekf_ros.reports.pictures import require_matplotlib
from fnn_ekf_ros.reports.results import study_results
from fnn_ekf_ros.study.ablations import real_filters
from fnn_ekf_ros.study.filters import EKF, EKF_GATED, FIXED, JOINT, SET_BY_NAMES
from fnn_ekf_ros.study.real import batch_start
from fnn_ekf_ros.study.real_bags import read_periods, read_recording, run_filters
from fnn_ekf_ros.study.report.real_figures import draw_real
from fnn_ekf_ros.study.report.real_tables import across_numbers, real_tables, rows
from fnn_ekf_ros.study.report.tables import start_words
from fnn_ekf_ros.study.starts import ALL_CELLS, with_noise_factors
from fnn_ekf_ros.study.taught import Teacher, check_same_robot, teacher_from_file
from fnn_ekf_ros.version import version

NAME = "real"
"""Name of the subcommand."""
SUMMARY = "recordings with a ground truth, from 25 starts with wrong noise"
"""Its line in `study --help`."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument(
        "bags", metavar="BAG", type=Path, nargs="+",
        help="recordings; NAME.yaml beside NAME holds its localizer parameters",
    )  # fmt: skip
    add_study_results(parser, "tables, figures and settings")
    parser.add_argument(
        "--truth-topic",
        default="/ground_truth",
        metavar="TOPIC",
        help="topic of the ground truth (/ground_truth)",
    )
    parser.add_argument(
        "--filters", metavar="A,B", default=JOINT,
        help=f"names of the localizer's filters beside {' and '.join(FIXED)}, and of {JOINT} "
        f"without one of its parts ({JOINT})",
    )  # fmt: skip
    parser.add_argument(
        "--state-file", metavar="BAG|FILE", type=Path,
        help="what the filters that adapt start with, noise and how much of the errors lasts: what "
        "each of their starts learned on this recording, or what a localizer's state_file holds",
    )  # fmt: skip
    add_parameter_arguments(parser)
    add_remapping_argument(parser)


def run(arguments: argparse.Namespace) -> int:
    """Run the command."""
    check_bags(arguments.bags)
    require_matplotlib()
    for text in arguments.assignments:
        name, _ = parse_assignment(text)
        if name in SET_BY_NAMES:
            raise FnnEkfError(
                f"parameter '{name}': it follows from the names of the filters; expected another"
            )
    labels = [_label(path) for path in arguments.bags]
    if len(set(labels)) < len(labels):
        raise FnnEkfError(f"{', '.join(labels)}: expected bags of different names")
    out = arguments.out
    settings = [_parameters(path, arguments) for path in arguments.bags]
    possible = [name for name in real_filters(settings[0][0]) if name != EKF]
    chosen = chosen_names("--filters", arguments.filters, possible)
    names = [*FIXED, *(name for name in chosen if name != EKF_GATED)]
    teacher = _teacher(arguments, settings[0][0])
    if teacher is not None:
        for label, (parameters, _) in zip(labels, settings, strict=True):
            check_same_robot(teacher, label, parameters)
    recordings = [
        read_recording(path, label, *each, arguments.truth_topic, arguments.remappings)
        for path, label, each in zip(arguments.bags, labels, settings, strict=True)
    ]
    inputs = [*arguments.bags, *arguments.params]
    if arguments.state_file is not None:
        inputs.append(arguments.state_file)
    places = study_results(out, arguments.json, inputs, replaces=arguments.force)

    made_by = {
        "study": NAME, "version": version(), "filters": names[len(FIXED) :],
        "parameters": dict(parse_assignment(text) for text in arguments.assignments),
    }  # fmt: skip
    results = [run_filters(recording, names, teacher) for recording in recordings]
    content = {
        **made_by,
        "summary": across_numbers(results),
        "bags": [rows(result) for result in results],
    }
    with places.written(content) as folder:
        write_text(folder / "results.md", real_tables(made_by, results))
        for recording, result in zip(recordings, results, strict=True):
            values = asdict(recording.parameters)
            text = render_parameter_file(LocalizerParameters, values, NODE_NAME)
            write_text(folder / f"localizer_{result.label}.yaml", text)
            draw_real(folder / f"real_{result.label}.png", result)
    print(f"{out}: {', '.join(labels)} from {len(ALL_CELLS)} starts, {', '.join(names)}")
    print(f"{out / 'results.md'}: the tables")
    return 0


def _label(path: Path) -> str:
    return path.stem if path.is_file() else path.resolve().name


def _teacher(arguments: argparse.Namespace, robot: LocalizerParameters) -> Teacher | None:
    """Return what `--state-file` names.

    Args:
        arguments: of the command.
        robot: parameters of the robot that a state file has to be of.

    Raises:
        FnnEkfError: it cannot be used.
    """
    path = arguments.state_file
    if path is None:
        return None
    if not path.exists():
        raise FnnEkfError(
            f"--state-file '{path}' does not exist: expected a recording, or the state_file of a "
            "localizer"
        )
    if path.is_file() and path.suffix not in STORAGE_SUFFIXES:
        return teacher_from_file(path, robot)
    label, (parameters, _) = _label(path), _parameters(path, arguments)
    periods = read_periods(path, label, parameters, arguments.remappings)
    return Teacher(label, parameters, batch_start(parameters, periods, ALL_CELLS))


def _parameters(path: Path, arguments: argparse.Namespace) -> tuple[LocalizerParameters, list[str]]:
    """Return the parameters for a bag, and the files they are from; the given ones win."""
    values, files = recorded_parameters(arguments, path, NODE_NAME)
    for name in SET_BY_NAMES:
        values.pop(name, None)
    parameters = build(LocalizerParameters, values)
    for cell in ALL_CELLS:
        try:
            with_noise_factors(parameters, cell)
        except ParameterError as error:
            raise ParameterError(f"bag '{path}', {start_words(cell)}: {error}") from None
    return parameters, [*files, *(str(p) for p in arguments.params)]
