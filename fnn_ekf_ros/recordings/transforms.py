# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""/tf of a replay: what was recorded, and the transform that the localizer publishes."""

import dataclasses
from collections.abc import Iterable

from fnn_ekf_ros import messages
from fnn_ekf_ros.localizer.transforms import TransformOutputs
from fnn_ekf_ros.messages import Message
from fnn_ekf_ros.parameters.localizer import LocalizerParameters
from fnn_ekf_ros.recordings.bag_files import BagError, BagReader, Record
from fnn_ekf_ros.recordings.bag_writer import BagWriter
from fnn_ekf_ros.timeline.events import Output


class ReplayedTransforms:
    """Copies /tf and adds to it what the node publishes with `publish_tf`.

    A frame has one parent: recorded transforms with the child frame that is published are not
    copied.

    Args:
        bag: the recording.
        out: the replay's.
        parameters: of the localizer.
        topic: absolute name of /tf.

    Attributes:
        topic: absolute name of /tf.
        not_copied: number of recorded transforms with the child frame that is published.

    Raises:
        BagError: the topic has another type.
    """

    def __init__(
        self, bag: BagReader, out: BagWriter, parameters: LocalizerParameters, topic: str
    ) -> None:
        found = bag.topics.get(topic)
        if found is not None and found.type_name != messages.TF_TYPE:
            raise BagError(
                f"bag '{bag.path}': topic {topic} is {found.type_name}, expected {messages.TF_TYPE}"
            )
        self._bag, self._out = bag, out
        self._outputs = TransformOutputs(parameters)
        self.topic = topic
        self.not_copied = 0

    @property
    def child(self) -> str:
        """The child frame that is published."""
        return self._outputs.child

    def take(self, record: Record) -> None:
        """Copy a recorded message, and write what it completes."""
        message = self._bag.message(record)
        kept = [
            entry for entry in message.transforms if entry.child_frame_id.lstrip("/") != self.child
        ]
        if len(kept) == len(message.transforms):
            self._out.write_raw(record)
        elif kept:
            self._out.rewrite(record, dataclasses.replace(message, transforms=kept))
        self.not_copied += len(message.transforms) - len(kept)
        self._write(self._outputs.received(message), record.time_ns)

    def located(self, output: Output, time_ns: int) -> Output:
        """Write the transform of a period; return its output with the status `tf`.

        Args:
            output: of the period.
            time_ns: time of recording [ns].
        """
        if output.estimate is not None:
            self._write(self._outputs.located(output.estimate), time_ns)
        if output.statuses is None:
            return output
        return output._replace(statuses=(*output.statuses, self._outputs.status()))

    def _write(self, made: Iterable[Message], time_ns: int) -> None:
        for message in made:
            self._out.write(self.topic, message, time_ns)
