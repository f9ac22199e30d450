"""`replay IN OUT`: the localizer's own pipeline over a recording, bag in, bag out."""

import argparse
import sys
import time
from dataclasses import asdict
from pathlib import Path

from fnn_ekf_ros import messages
from fnn_ekf_ros.bag_files import STORAGES, BagError, BagReader, BagWriter, Record, Topic
from fnn_ekf_ros.membership.files import networks_for
from fnn_ekf_ros.parameters.files import render_parameter_file
from fnn_ekf_ros.parameters.localizer import NODE_NAME, LocalizerParameters
from fnn_ekf_ros.parameters.schema import build
from fnn_ekf_ros.pipeline.events import CompassYaw, Output, PoseFix
from fnn_ekf_ros.pipeline.pipeline import Pipeline
from fnn_ekf_ros.pipeline.saved import SavedState
from fnn_ekf_ros.saved_state import SavedStateError, read_state
from fnn_ekf_ros.tools.arguments import add_parameter_arguments, given_parameters
from fnn_ekf_ros.tools.bag_inputs import (
    TopicNames,
    add_remapping_argument,
    inputs_in,
    last_words,
    read_events,
)
from fnn_ekf_ros.tools.progress import with_progress


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument("bag", metavar="IN", type=Path, help="the recording to replay")
    parser.add_argument("out", metavar="OUT", type=Path, help="the bag to write (a new folder)")
    add_parameter_arguments(parser)
    add_remapping_argument(parser)
    parser.add_argument(
        "--dead-reckoning", action="store_true",
        help="wheels only: ignore fixes and compass once the filter has started, to compare with",
    )  # fmt: skip
    parser.add_argument("--storage", choices=STORAGES, default="mcap", help="format (mcap)")


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
            print(f"replay: {', '.join(old)} of {arguments.bag} left out: OUT has new ones there")
        notes = {
            NODE_NAME: render_parameter_file(LocalizerParameters, asdict(parameters), NODE_NAME)
        }
        with BagWriter(arguments.out, arguments.storage, notes) as out:
            copied = _announce(out, [t for t in bag.topics.values() if t.name not in replaced])
            pipeline = Pipeline(parameters, networks, warm_start=_warm_start(parameters))
            dead_reckoning = _DeadReckoning() if arguments.dead_reckoning else None
            estimates = 0
            for record in with_progress(bag.records(), bag.message_count, "replay"):
                if record.topic in copied and (
                    record.topic != messages.DIAGNOSTICS or not _is_own_diagnostics(bag, record)
                ):
                    out.write_raw(record)
                closed = []
                topic = inputs.get(record.topic)
                if topic is not None:
                    closed = _feed(pipeline, bag, record, topic, dead_reckoning)
                closed += pipeline.advance(record.time_ns)
                for output in closed:
                    estimates += _write(out, names, output, record.time_ns, parameters)
            if not estimates:
                raise BagError(
                    f"bag '{arguments.bag}' gives no odom: expected encoders, fixes and a yaw "
                    f"that start the filter; {last_words(pipeline)}"
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
        return read_state(Path(parameters.state_file), parameters)[0]
    except SavedStateError as error:
        print(f"replay: {error}; starting without it", file=sys.stderr)
        return None


class _DeadReckoning:
    """Lets measurements pass until the filter has started."""

    def __init__(self) -> None:
        self.started = False

    def blocks(self, event: object) -> bool:
        return self.started and isinstance(event, CompassYaw | PoseFix)


def _announce(out: BagWriter, topics: list[Topic]) -> set[str]:
    """Announce the topics that OUT is to have copies of; return their names."""
    copied = set()
    for topic in topics:
        try:
            out.add_topic(topic)
            copied.add(topic.name)
        except BagError as error:
            print(f"replay: left out: {error}", file=sys.stderr)
    return copied


def _is_own_diagnostics(bag: BagReader, record: Record) -> bool:
    """Return whether diagnostics are what a localizer said when the bag was recorded."""
    return any(status.hardware_id == NODE_NAME for status in bag.message(record).status)


def _feed(
    pipeline: Pipeline,
    bag: BagReader,
    record: Record,
    topic: str,
    dead_reckoning: _DeadReckoning | None,
) -> list[Output]:
    closed: list[Output] = []
    for event in read_events(pipeline, bag, record, topic):
        if dead_reckoning is None or not dead_reckoning.blocks(event):
            closed += pipeline.add(event, record.time_ns)
    if dead_reckoning is not None:
        dead_reckoning.started |= any(output.estimate is not None for output in closed)
    return closed


def _write(
    out: BagWriter, names: TopicNames, output: Output, time_ns: int, parameters: LocalizerParameters
) -> int:
    """Write what a closed period gives; returns the number of odom messages."""
    estimate = output.estimate
    if estimate is not None:
        made = messages.estimate_messages(estimate, parameters.frame_id, parameters.base_frame)
        for topic, message in made.items():
            out.write(names.of(topic), message, time_ns)
    if output.health is not None:
        diagnostics = messages.diagnostics(output.stamp_ns, NODE_NAME, output.health)
        out.write(messages.DIAGNOSTICS, diagnostics, time_ns)
    return int(estimate is not None)
