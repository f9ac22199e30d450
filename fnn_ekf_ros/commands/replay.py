# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""`replay IN OUT`: the localizer over a recording, bag in, bag out, and how healthy it was."""

import argparse
import sys
import time
from dataclasses import asdict, replace
from pathlib import Path

from fnn_ekf_ros import messages
from fnn_ekf_ros.calibration.findings import UNTOLD, Certainty
from fnn_ekf_ros.commands.arguments import (
    add_force_argument,
    add_parameter_arguments,
    add_remapping_argument,
    add_text_argument,
    check_command_results,
    given_parameters,
)
from fnn_ekf_ros.diagnostics.health import UNHEALTHY_SHARE, HealthSummary
from fnn_ekf_ros.diagnostics.health_monitor import HealthMonitor
from fnn_ekf_ros.diagnostics.health_words import (
    checks,
    found_parameters,
    health_lines,
    plain_summary,
)
from fnn_ekf_ros.localizer.localizer import Localizer
from fnn_ekf_ros.localizer.outputs import output_messages
from fnn_ekf_ros.localizer.saved_state import SavedState
from fnn_ekf_ros.localizer.state_file import SavedStateError, read_state
from fnn_ekf_ros.membership.files import networks_for
from fnn_ekf_ros.parameters.files import render_parameter_file
from fnn_ekf_ros.parameters.localizer import NODE_NAME, LocalizerParameters
from fnn_ekf_ros.parameters.schema import build
from fnn_ekf_ros.recordings.bag_files import BagError, BagReader, Record, Topic, check_bags
from fnn_ekf_ros.recordings.bag_writer import STORAGES, BagWriter, refuse_inputs
from fnn_ekf_ros.recordings.diagnosis import BagExamination
from fnn_ekf_ros.recordings.inputs import (
    TopicNames,
    inputs_in,
    no_start,
    take,
)
from fnn_ekf_ros.recordings.transforms import ReplayedTransforms
from fnn_ekf_ros.reports.doctor_report import finding_line, plain_findings
from fnn_ekf_ros.reports.progress import with_progress
from fnn_ekf_ros.stopping import UNHEALTHY

EXAMINED_NS = 600 * 10**9
"""Length of the part of a recording that is examined as by `doctor` [ns]: readings are kept for
it, and ten minutes tell what is wrong."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument("bag", metavar="IN", type=Path, help="the recording to replay")
    parser.add_argument("out", metavar="OUT", type=Path, help="the bag to write (a new folder)")
    add_parameter_arguments(parser)
    add_remapping_argument(parser)
    parser.add_argument(
        "--dead-reckoning", action="store_true",
        help="wheels only, for comparison: ignore fixes and compass once the filter has started",
    )  # fmt: skip
    parser.add_argument(
        "--tf", action="store_true",
        help="write the transform that the node publishes with publish_tf; recorded ones with the "
        "same child frame are not copied",
    )  # fmt: skip
    parser.add_argument(
        "--strict", action="store_true",
        help=f"exit with code {UNHEALTHY} if the run was not healthy: a status of /diagnostics was "
        f"above OK for more than {100.0 * UNHEALTHY_SHARE:g} %% of the time or at the end, the "
        "filter was too sure of a sensor, wheels or noise were far from what is configured, or "
        "something is wrong with robot, wiring or configuration as in doctor",
    )  # fmt: skip
    add_text_argument(
        parser,
        "--save-params",
        "write a parameter file with the noise that was found and what else would fit",
    )
    add_text_argument(parser, "--json", "write the health summary as JSON")
    add_force_argument(parser)
    parser.add_argument(
        "--storage", choices=STORAGES, default="mcap", help="storage format of the bag (mcap)"
    )


def run(arguments: argparse.Namespace) -> int:
    """Run the command."""
    check_bags([arguments.bag])
    given = given_parameters(arguments, NODE_NAME)
    parameters = build(LocalizerParameters, given)
    if arguments.tf:
        parameters = replace(parameters, publish_tf=True)
    inputs = [arguments.bag, *arguments.params]
    check_command_results(arguments, ["--save-params", "--json"], [*inputs, arguments.out])
    refuse_inputs(arguments.out, inputs)
    names = TopicNames(arguments.remappings)
    began = time.monotonic()
    with BagReader(arguments.bag) as bag:
        examination = BagExamination(bag, given, names)
        summary = _replay(arguments, parameters, bag, names, examination)
        findings = [
            each
            for each in examination.diagnosis().findings
            if each.certainty is not Certainty.POSSIBLE and each.name not in UNTOLD
        ]
        duration, begin_ns = bag.duration_s, bag.start_ns
    took = time.monotonic() - began
    print(
        f"{arguments.out}: {summary.estimates} odom from {duration:.1f} s of recording in "
        f"{took:.1f} s ({duration / took:.0f} times real time)"
    )
    healthy = summary.healthy and not findings
    lines = health_lines(summary, begin_ns, cause_known=bool(findings))
    print("\n".join([*lines, *(finding_line(finding) for finding in findings)]))
    if arguments.json is not None:
        plain = {**plain_summary(summary), "healthy": healthy}
        arguments.json.write_json({**plain, "findings": plain_findings(findings)}, indent=2)
    if arguments.save_params is not None:
        arguments.save_params.write(_found(summary, arguments.bag.name))
    return UNHEALTHY if arguments.strict and not healthy else 0


def _replay(
    arguments: argparse.Namespace,
    parameters: LocalizerParameters,
    bag: BagReader,
    names: TopicNames,
    examination: BagExamination,
) -> HealthSummary:
    """Write OUT; return how healthy the run was. What is examined is the begin of the recording.

    Raises:
        BagError: a recording cannot be read or written, or does not start the filter.
    """
    inputs = inputs_in(bag, parameters, names)
    localizer = Localizer(
        parameters,
        networks_for(parameters),
        warm_start=_warm_start(parameters),
        dead_reckoning=arguments.dead_reckoning,
    )
    replaced = _replaced(bag, names.outputs(set(inputs)))
    notes = {NODE_NAME: render_parameter_file(LocalizerParameters, asdict(parameters), NODE_NAME)}
    monitor = HealthMonitor(parameters)
    with BagWriter(arguments.out, arguments.storage, notes, replaces=arguments.force) as out:
        copied = _announce(out, [t for t in bag.topics.values() if t.name not in replaced])
        tf = names.of(messages.TF)
        transforms = ReplayedTransforms(bag, out, parameters, tf) if arguments.tf else None
        for record in with_progress(bag.records(), bag.message_count, "replay"):
            if record.time_ns - bag.start_ns < EXAMINED_NS:
                examination.add(record)
            if transforms is not None and record.topic == transforms.topic:
                transforms.take(record)
            elif record.topic in copied and not _is_own_diagnostics(bag, record):
                out.write_raw(record)
            for closed in take(localizer, bag, record, inputs):
                output = (
                    closed if transforms is None else transforms.located(closed, record.time_ns)
                )
                monitor.saw(output)
                for topic, message in output_messages(output, parameters).items():
                    out.write(names.of(topic), message, record.time_ns)
        summary = monitor.summary()
        if summary is None:
            raise no_start(localizer, bag, inputs)
    if transforms is not None and transforms.not_copied:
        print(
            f"replay: {transforms.not_copied} transforms to {transforms.child} of {arguments.bag} "
            "not copied: OUT gets new ones"
        )
    return summary


def _replaced(bag: BagReader, outputs: set[str]) -> set[str]:
    """Return the topics of which OUT gets no copies, and say which of them there are."""
    replaced = set(outputs)
    recorded = bag.topics.get(messages.DIAGNOSTICS)
    if recorded is not None and recorded.type_name != messages.DIAGNOSTICS_TYPE:
        replaced.add(messages.DIAGNOSTICS)
    if old := sorted(replaced & bag.topics.keys()):
        print(f"replay: {', '.join(old)} of {bag.path} not copied: OUT gets new ones")
    return replaced


def _found(summary: HealthSummary, bag: str) -> str:
    """Return the parameter file with what was found; `bag` is the recording's name."""
    found = found_parameters(summary)
    head = [
        f"Localizer parameters for the robot of {bag}.",
        f"Found by replay: {', '.join(found)}.",
        *(f"Check {text}." for text in checks(summary)),
    ]
    values = asdict(summary.parameters) | found
    return render_parameter_file(LocalizerParameters, values, NODE_NAME, "\n".join(head))


def _warm_start(parameters: LocalizerParameters) -> SavedState | None:
    """Return the state that the parameters ask to start from, if it can be read."""
    if not parameters.warm_start:
        return None
    try:
        return read_state(Path(parameters.state_file), parameters).state
    except SavedStateError as error:
        print(f"replay: {error}; starting without it", file=sys.stderr)
        return None


def _announce(out: BagWriter, topics: list[Topic]) -> set[str]:
    """Announce the topics that OUT is to have copies of; return their names."""
    copied = set()
    for topic in topics:
        try:
            out.add_topic(topic)
            copied.add(topic.name)
        except BagError as error:
            print(f"replay: not copied: {error}", file=sys.stderr)
    return copied


def _is_own_diagnostics(bag: BagReader, record: Record) -> bool:
    """Return whether a record is of a localizer that ran when the bag was recorded."""
    if record.topic != messages.DIAGNOSTICS:
        return False
    return any(status.hardware_id == NODE_NAME for status in bag.message(record).status)
