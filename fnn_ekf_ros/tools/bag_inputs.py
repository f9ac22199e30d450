"""What of a recording the localizer listens to, for all commands that run the pipeline."""

import argparse

from fnn_ekf_ros import messages
from fnn_ekf_ros.bag_files import BagError, BagReader, Record
from fnn_ekf_ros.errors import FnnEkfError
from fnn_ekf_ros.parameters.localizer import LocalizerParameters
from fnn_ekf_ros.pipeline.events import Event, Rejected
from fnn_ekf_ros.pipeline.pipeline import Pipeline


def add_remapping_argument(parser: argparse.ArgumentParser) -> None:
    """Add `-r FROM:=TO`."""
    parser.add_argument(
        "-r", dest="remappings", metavar="FROM:=TO", action="append", default=[],
        help="the topic the recording has for one of the localizer's, as in ros2 run",
    )  # fmt: skip


class TopicNames:
    """Topic names of the localizer, remapped."""

    def __init__(self, remappings: list[str]) -> None:
        known = {
            messages.absolute_name(topic): topic
            for topic in (*messages.INPUT_TYPES, *messages.output_topics())
        }
        self._to: dict[str, str] = {}
        for text in remappings:
            source, separator, target = text.partition(":=")
            if not (separator and messages.is_topic_name(target)):
                raise FnnEkfError(f"-r {text}: expected FROM:=TO, TO a topic's name")
            if messages.absolute_name(source) not in known:
                raise FnnEkfError(f"-r {text}: expected one of {', '.join(known.values())}")
            self._to[messages.absolute_name(source)] = messages.absolute_name(target)

    def of(self, topic: str) -> str:
        """Return the absolute name of one of the localizer's topics."""
        name = messages.absolute_name(topic)
        return self._to.get(name, name)

    def outputs(self, inputs: set[str]) -> set[str]:
        """Return the absolute names of what comes with an estimate.

        Args:
            inputs: absolute names of what the localizer listens to.

        Raises:
            FnnEkfError: remappings put one topic onto another.
        """
        own = [self.of(topic) for topic in messages.output_topics()]
        shared = {name for name in own if own.count(name) > 1}
        shared |= {*own} & {*inputs, messages.DIAGNOSTICS}
        if shared:
            raise FnnEkfError(f"-r: {', '.join(sorted(shared))} would share a name with another")
        return set(own)


def inputs_in(bag: BagReader, parameters: LocalizerParameters, names: TopicNames) -> dict[str, str]:
    """Return the localizer's topic for each of the recording's that it listens to.

    Raises:
        BagError: a topic is missing or of another type.
        FnnEkfError: remappings put one of the localizer's topics onto another.
    """
    inputs: dict[str, str] = {}
    taken: dict[str, str] = {}
    for topic in messages.input_topics(parameters):
        name = names.of(topic)
        if name in taken:
            raise FnnEkfError(f"-r: {name} would be both {taken[name]} and {topic}")
        taken[name] = topic
        found = bag.topics.get(name)
        expected = messages.INPUT_TYPES[topic]
        if found is not None:
            if found.type_name != expected:
                raise BagError(
                    f"bag '{bag.path}': topic {name} is {found.type_name}, expected {expected}"
                )
            inputs[name] = topic
        elif topic not in (messages.COMPASS, messages.INITIAL_POSE):
            raise BagError(
                f"bag '{bag.path}' has no topic {name} ({expected}): it has "
                f"{', '.join(sorted(bag.topics)) or 'none'}; -r {topic}:=NAME takes another"
            )
    return inputs


def read_events(pipeline: Pipeline, bag: BagReader, record: Record, topic: str) -> list[Event]:
    """Return the events in a record; what the pipeline cannot use is counted there.

    Args:
        pipeline: whose input it is.
        bag: the recording.
        record: a message of it.
        topic: the localizer's topic that it is of.
    """
    events = messages.read_input(topic, bag.message(record), record.time_ns, pipeline.parameters)
    if isinstance(events, Rejected):
        pipeline.reject(events)
        return []
    return events


def last_words(pipeline: Pipeline) -> str:
    """Return what the pipeline complains of at the end of a recording."""
    return "; ".join(
        f"{status.name}: {status.message}" for status in pipeline.report() if status.level > 0
    )
