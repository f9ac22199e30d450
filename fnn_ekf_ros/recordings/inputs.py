# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Topics of a recording that the localizer listens to, for all commands that run it."""

from collections.abc import Mapping
from itertools import islice

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
_SHOWN_MESSAGES = 50
"""Number of messages of joint_states whose joints an error names: several publishers share it."""


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
        BagError: a topic is missing or of another type, or the recording goes on after 2038.
        FnnEkfError: remappings put one of the localizer's topics onto another.
    """
    bag.check_stamps()
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


def no_start(localizer: Localizer, bag: BagReader, inputs: Mapping[str, str]) -> BagError:
    """Return the error for a recording that did not start a localizer, with what to do.

    Args:
        localizer: after the recording.
        bag: the recording.
        inputs: the localizer's topic for each of the recording's that it listens to.
    """
    said = [_last_words(localizer), *_missing_joints(localizer.parameters, bag, inputs)]
    said += _other_frame(localizer.parameters, bag, inputs)
    said += _silent_topics(localizer.parameters, bag, inputs)
    return BagError(
        f"bag '{bag.path}' gives no odom: expected encoders, fixes and a yaw that start the "
        f"filter; {'; '.join(said)}"
    )


def _last_words(localizer: Localizer) -> str:
    """Return the localizer's troubles at the end of a recording, with the last refusals."""
    said = []
    for status in localizer.report():
        if status.level > Level.OK:
            refusal = dict(status.values).get(LAST_REFUSAL)
            detail = f" ({refusal})" if refusal else ""
            said.append(f"{status.name}: {status.message}{detail}")
    return "; ".join(said)


def _missing_joints(
    parameters: LocalizerParameters, bag: BagReader, inputs: Mapping[str, str]
) -> list[str]:
    """Return which joints the recording has, if those of the parameters are not among them."""
    name = _recorded(messages.JOINT_STATES, inputs)
    first = [] if name is None else islice(bag.records({name}), _SHOWN_MESSAGES)
    there = sorted({str(joint) for record in first for joint in bag.message(record).name})
    if not there:
        return []
    wanted = {"left_joint": parameters.left_joint, "right_joint": parameters.right_joint}
    return [
        f"{name} has no joint '{joint}', but {', '.join(there)}: -p {parameter}:=NAME takes another"
        for parameter, joint in wanted.items()
        if joint not in there
    ]


def _other_frame(
    parameters: LocalizerParameters, bag: BagReader, inputs: Mapping[str, str]
) -> list[str]:
    """Return the frame of the fixes, if it is not that of the parameters."""
    name = _recorded(messages.LRF_POSE, inputs)
    first = None if name is None else next(bag.records({name}), None)
    if first is None:
        return []
    frame = bag.message(first).header.frame_id
    if frame == parameters.frame_id:
        return []
    if not frame:
        return [f"the fixes of {name} have no frame: expected '{parameters.frame_id}' in theirs"]
    slash = ", but frames of ROS 2 begin with no slash" if frame.startswith("/") else ""
    return [f"-p frame_id:={frame} takes the fixes of {name}{slash}"]


def _silent_topics(
    parameters: LocalizerParameters, bag: BagReader, inputs: Mapping[str, str]
) -> list[str]:
    """Return the topics that the filter waits for without a message of them."""
    said = []
    for topic in messages.input_topics(parameters):
        name = _recorded(topic, inputs)
        if topic == messages.INITIAL_POSE or (name is not None and bag.topics[name].message_count):
            continue
        shown = name or messages.absolute_name(topic)
        more = ", -p lrf_use_yaw:=true the yaw of the fixes" if topic == messages.COMPASS else ""
        said.append(f"no message on {shown}: -r {topic}:=NAME takes another topic{more}")
    return said


def _recorded(topic: str, inputs: Mapping[str, str]) -> str | None:
    """Return the recording's name of one of the localizer's topics; None if it has none."""
    return next((name for name, each in inputs.items() if each == topic), None)
