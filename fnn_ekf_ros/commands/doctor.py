# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""`doctor BAG`: what is in a recording, and what is wrong with robot, wiring or configuration."""

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from fnn_ekf_ros.calibration.findings import Certainty, Finding
from fnn_ekf_ros.commands.arguments import (
    add_force_argument,
    add_parameter_arguments,
    add_remapping_argument,
    add_text_argument,
    check_command_results,
    given_parameters,
)
from fnn_ekf_ros.parameters.files import render_parameter_file
from fnn_ekf_ros.parameters.localizer import NODE_NAME, LocalizerParameters
from fnn_ekf_ros.parameters.schema import build, fields_of
from fnn_ekf_ros.recordings.bag_files import BagReader, check_bags
from fnn_ekf_ros.recordings.diagnosis import BagExamination
from fnn_ekf_ros.recordings.inputs import TopicNames
from fnn_ekf_ros.reports.doctor_report import as_json, as_text
from fnn_ekf_ros.reports.progress import with_progress

EXIT_CODE = (
    "The exit code is 0 if replay would work with these parameters and remappings, otherwise 1."
)
"""Last words of `--help`."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.epilog = EXIT_CODE
    parser.add_argument("bag", metavar="BAG", type=Path, help="the recording of a drive")
    add_parameter_arguments(parser)
    add_remapping_argument(parser)
    add_text_argument(parser, "--json", "write everything as JSON")
    add_text_argument(
        parser,
        "--write-params",
        "write the parameters with what is certain or likely put right, ready to run",
    )
    add_force_argument(parser)


def run(arguments: argparse.Namespace) -> int:
    """Run the command."""
    check_bags([arguments.bag])
    given = given_parameters(arguments, NODE_NAME)
    names = TopicNames(arguments.remappings)
    inputs = [arguments.bag, *arguments.params]
    check_command_results(arguments, ["--json", "--write-params"], inputs)
    with BagReader(arguments.bag) as bag:
        examination = BagExamination(bag, given, names)
        for record in with_progress(bag.records(), bag.message_count, "doctor"):
            examination.add(record)
        found = examination.diagnosis()
    duration_s, facts, findings, estimates, obstacle = found
    print(as_text(arguments.bag, duration_s, facts, findings, obstacle))
    if arguments.json is not None:
        arguments.json.write_json(as_json(facts, findings, estimates, obstacle))
    if arguments.write_params is not None:
        text = corrected_file(arguments.bag.name, given, findings)
        arguments.write_params.write(text)
        print(f"{arguments.write_params}: parameters with these corrections")
    return 1 if obstacle else 0


def corrected_values(given: Mapping[str, Any], findings: Sequence[Finding]) -> LocalizerParameters:
    """Return parameters with what is certain or likely put right.

    Raises:
        ParameterError: they still cannot be used.
    """
    values = dict(given)
    known = {name for name, _, _ in fields_of(LocalizerParameters)}
    for finding in reversed(findings):  # the surest wins
        if finding.certainty is Certainty.POSSIBLE:
            continue
        for change in finding.changes:
            if change.parameter in known:
                values[change.parameter] = change.value
    return build(LocalizerParameters, values)


def corrected_file(bag: str, given: Mapping[str, Any], findings: Sequence[Finding]) -> str:
    """Return a parameter file with what is certain or likely put right.

    Raises:
        ParameterError: the parameters still cannot be used.
    """
    head = f"Localizer parameters after `doctor {bag}`."
    remaps = sorted({remap for each in findings for remap in each.remaps})
    if remaps:
        head += "\nRun with " + " ".join(f"-r {remap}" for remap in remaps)
    corrected = asdict(corrected_values(given, findings))
    return render_parameter_file(LocalizerParameters, corrected, NODE_NAME, head)
