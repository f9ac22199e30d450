# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""`replay IN OUT`: the localizer over a recording, bag in, bag out."""

import argparse
import sys
import time
from dataclasses import asdict
from pathlib import Path

from fnn_ekf_ros import messages
from fnn_ekf_ros.commands.arguments import (
    add_parameter_arguments,
    add_remapping_argument,
    given_parameters,
)
from fnn_ekf_ros.localizer.localizer import Localizer
from fnn_ekf_ros.localizer.outputs import output_messages
from fnn_ekf_ros.localizer.saved_state import SavedState
from fnn_ekf_ros.localizer.state_file import SavedStateError, read_state
from fnn_ekf_ros.membership.files import networks_for
from fnn_ekf_ros.parameters.files import render_parameter_file
from fnn_ekf_ros.parameters.localizer import NODE_NAME, LocalizerParameters
from fnn_ekf_ros.parameters.schema import build
from fnn_ekf_ros.recordings.bag_files import BagError, BagReader, Record, Topic
from fnn_ekf_ros.recordings.bag_writer import STORAGES, BagWriter
from fnn_ekf_ros.recordings.inputs import (
    TopicNames,
    inputs_in,
    last_words,
    take,
)
from fnn_ekf_ros.reports.progress import with_progress


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
        "--storage", choices=STORAGES, default="mcap", help="storage format of the bag (mcap)"
    )


def run(arguments: argparse.Namespace) -> int:
    """Run the command."""
    parameters = build(LocalizerParameters, given_parameters(arguments, NODE_NAME))
    networks = networks_for(parameters)
    names = TopicNames(arguments.remappings)
    began = time.monotonic()
    with BagReader(arguments.bag) as bag:
        inputs = inputs_in(bag, parameters, names)
        replaced = names.outputs(set(inputs))
        recorded = bag.topics.get(messages.DIAGNOSTICS)
        if recorded is not None and recorded.type_name != messages.DIAGNOSTICS_TYPE:
            replaced.add(messages.DIAGNOSTICS)
        if old := sorted(replaced & bag.topics.keys()):
            print(f"replay: {', '.join(old)} of {arguments.bag} not copied: OUT gets new ones")
        notes = {
            NODE_NAME: render_parameter_file(LocalizerParameters, asdict(parameters), NODE_NAME)
        }
        with BagWriter(arguments.out, arguments.storage, notes) as out:
            copied = _announce(out, [t for t in bag.topics.values() if t.name not in replaced])
            localizer = Localizer(
                parameters,
                networks,
                warm_start=_warm_start(parameters),
                dead_reckoning=arguments.dead_reckoning,
            )
            estimates = 0
            for record in with_progress(bag.records(), bag.message_count, "replay"):
                if record.topic in copied and (
                    record.topic != messages.DIAGNOSTICS or not _is_own_diagnostics(bag, record)
                ):
                    out.write_raw(record)
                for output in take(localizer, bag, record, inputs):
                    estimates += output.estimate is not None
                    for topic, message in output_messages(output, parameters).items():
                        out.write(names.of(topic), message, record.time_ns)
            if not estimates:
                raise BagError(
                    f"bag '{arguments.bag}' gives no odom: expected encoders, fixes and a yaw "
                    f"that start the filter; {last_words(localizer)}"
                )
            duration = bag.duration_s
    took = time.monotonic() - began
    print(
        f"{arguments.out}: {estimates} odom from {duration:.1f} s of recording in {took:.1f} s "
        f"({duration / took:.0f} times real time)"
    )
    return 0


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
    """Return whether diagnostics are those of a localizer that ran when the bag was recorded."""
    return any(status.hardware_id == NODE_NAME for status in bag.message(record).status)
