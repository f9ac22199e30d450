# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Topics of a recording that the localizer listens to, for all commands that run it."""

from collections.abc import Mapping

from fnn_ekf_ros import messages
from fnn_ekf_ros.diagnostics.messages import LAST_REFUSAL
from fnn_ekf_ros.errors import FnnEkfError
from fnn_ekf_ros.files.fields import suggestion
from fnn_ekf_ros.localizer.localizer import Localizer
from fnn_ekf_ros.parameters.localizer import LocalizerParameters
from fnn_ekf_ros.recordings.bag_files import BagError, BagReader, Record
from fnn_ekf_ros.timeline.events import Level, Output

TOPICS = (*messages.INPUT_TYPES, *messages.output_topics(), messages.TF)
"""The localizer's topics that can have another name in a recording."""


class TopicNames:
    """Topic names of the localizer, remapped."""

    def __init__(self, remappings: list[str]) -> None:
        known = {messages.absolute_name(topic): topic for topic in TOPICS}
        self._to: dict[str, str] = {}
        for text in remappings:
            source, separator, target = text.partition(":=")
            if not (separator and messages.is_topic_name(target)):
                raise FnnEkfError(f"-r {text}: expected FROM:=TO, TO a topic's name")
            if messages.absolute_name(source) not in known:
                names = suggestion(source.removeprefix("/"), known.values())
                raise FnnEkfError(f"-r {text}: unknown topic '{source}'{names}")
            self._to[messages.absolute_name(source)] = messages.absolute_name(target)

    def of(self, topic: str) -> str:
        """Return the absolute name of one of the localizer's topics."""
        name = messages.absolute_name(topic)
        return self._to.get(name, name)

    def is_remapped(self, topic: str) -> bool:
        """Return whether one of the localizer's topics was given another name."""
        return messages.absolute_name(topic) in self._to

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
    for name, topic in taken.items():
        found = bag.topics.get(name)
        expected = messages.INPUT_TYPES[topic]
        if found is not None:
            if found.type_name != expected:
                raise BagError(
                    f"bag '{bag.path}': topic {name} is {found.type_name}, expected {expected}"
                )
            inputs[name] = topic
        elif topic not in (messages.COMPASS, messages.INITIAL_POSE) or names.is_remapped(topic):
            raise BagError(
                f"bag '{bag.path}' has no topic {name} ({expected}): it has "
                f"{', '.join(sorted(bag.topics)) or 'none'}; -r {topic}:=NAME takes another"
            )
    return inputs


def take(
    localizer: Localizer, bag: BagReader, record: Record, inputs: Mapping[str, str]
) -> list[Output]:
    """Let the localizer take a record in, if it listens to its topic, and its time pass.

    Args:
        localizer: takes it in.
        bag: the recording.
        record: a message of it, of any topic.
        inputs: the localizer's topic for each of the recording's that it listens to.

    Returns:
        The outputs of the periods that were closed.
    """
    topic = inputs.get(record.topic)
    if topic is None:
        return localizer.advance(record.time_ns)
    return localizer.receive(topic, bag.message(record), record.time_ns).outputs


def last_words(localizer: Localizer) -> str:
    """Return the localizer's troubles at the end of a recording, with the last refusals."""
    said = []
    for status in localizer.report():
        if status.level > Level.OK:
            refusal = dict(status.values).get(LAST_REFUSAL)
            detail = f" ({refusal})" if refusal else ""
            said.append(f"{status.name}: {status.message}{detail}")
    return "; ".join(said)
