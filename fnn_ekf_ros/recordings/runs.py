# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Runs of a localizer: read from a bag, or made by running it over one."""

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fnn_ekf_ros import messages
from fnn_ekf_ros.core.arrays import FloatArray
from fnn_ekf_ros.localizer.localizer import Localizer
from fnn_ekf_ros.parameters.localizer import NODE_NAME
from fnn_ekf_ros.recordings.bag_files import BagReader, Record
from fnn_ekf_ros.recordings.inputs import no_start, take
from fnn_ekf_ros.recordings.run_record import Fixes, RunRecord, StatusReport, noise_at
from fnn_ekf_ros.recordings.trajectories import check_topic, read_trajectory
from fnn_ekf_ros.timeline.events import Output
from fnn_ekf_ros.timeline.trajectory import Trajectory


class _Collected:
    """Noise and statuses as they come; read by attributes, so bags' messages will do."""

    def __init__(self, node: str = NODE_NAME) -> None:
        self._node = node
        self.stamps_ns: list[int] = []
        self.seen: list[int] = []
        self.rows: list[FloatArray] = []
        self.names = list(messages.NOISE_FIELDS)
        self.statuses: dict[str, list[StatusReport]] = {}

    def noise(self, message: Any) -> None:
        """Take a message of `~/noise`; its layout names its numbers."""
        self.seen.append(len(self.stamps_ns))
        self.rows.append(np.array(message.data, dtype=np.float64))
        if message.layout.dim and "," in message.layout.dim[0].label:
            self.names = str(message.layout.dim[0].label).split(",")

    def diagnostics(self, message: Any) -> None:
        """Take a message of /diagnostics; statuses of other nodes are passed over."""
        time_ns = messages.stamp_ns(message)
        for status in message.status:
            if status.hardware_id == self._node:
                level = status.level[0] if isinstance(status.level, bytes) else int(status.level)
                self.status(str(status.name), StatusReport(time_ns, level, str(status.message)))

    def status(self, name: str, report: StatusReport) -> None:
        """Take a status of the localizer."""
        self.statuses.setdefault(name.rsplit(": ", 1)[-1], []).append(report)


def read_run(bag: BagReader, odom_topic: str, fixes_topic: str | None = None) -> RunRecord:
    """Return what a localizer published, from the bag that has it.

    Args:
        bag: the recording.
        odom_topic: topic of the estimate.
        fixes_topic: of the fixes; None for `lrf_pose`, if the recording has it.

    Raises:
        BagError: no such odom or fixes.
    """
    track = read_trajectory(bag, odom_topic)
    twists: dict[int, tuple[float, float]] = {}
    noise_topic = _noise_topic(bag, odom_topic)
    found = _Collected(noise_topic.removesuffix(f"/{messages.NOISE}").lstrip("/"))
    wanted = {
        odom_topic: messages.ODOMETRY_TYPE, noise_topic: messages.NOISE_TYPE,
        messages.DIAGNOSTICS: messages.DIAGNOSTICS_TYPE,
    }  # fmt: skip
    there = {
        name for name, kind in wanted.items()
        if name in bag.topics and bag.topics[name].type_name == kind
    }  # fmt: skip
    for record in bag.records(there):
        message = bag.message(record)
        if record.topic == odom_topic:
            found.stamps_ns.append(messages.stamp_ns(message))
            twist = message.twist.twist
            twists.setdefault(found.stamps_ns[-1], (twist.linear.x, twist.angular.z))
        elif record.topic == noise_topic:
            found.noise(message)
        else:
            found.diagnostics(message)
    return RunRecord(
        track=track,
        twist=np.array([twists[time_ns] for time_ns in track.time_ns.tolist()]),
        noise=noise_at(found.stamps_ns, found.seen, found.rows, found.names),
        statuses=found.statuses,
        fixes=read_fixes(bag, fixes_topic),
        parameters=bag.notes.get(NODE_NAME, ""),
    )


def run_localizer(
    bag: BagReader,
    records: Iterable[Record],
    localizer: Localizer,
    inputs: Mapping[str, str],
) -> RunRecord:
    """Run a localizer over a bag and return what it publishes.

    Args:
        bag: the recording.
        records: all of its records, perhaps with a progress bar.
        localizer: that has seen nothing yet.
        inputs: the localizer's topic for each of the recording's that it listens to.

    Raises:
        BagError: it never starts.
    """
    found = _Collected()
    poses, covariances, twists = [], [], []
    for record in records:
        for output in take(localizer, bag, record, inputs):
            _take_statuses(found, output)
            if output.estimate is None:
                continue
            estimate = output.estimate
            found.stamps_ns.append(estimate.stamp_ns)
            poses.append(estimate.state.mean)
            covariances.append(estimate.state.covariance)
            twists.append(estimate.twist)
            found.seen.append(len(found.stamps_ns))
            found.rows.append(messages.noise(estimate).fields["data"])
    if not poses:
        raise no_start(localizer, bag, inputs)
    time_ns, first = np.unique(np.array(found.stamps_ns), return_index=True)
    return RunRecord(
        track=Trajectory(time_ns, np.array(poses)[first], np.array(covariances)[first]),
        twist=np.array(twists)[first],
        noise=noise_at(found.stamps_ns, found.seen, found.rows, found.names),
        statuses=found.statuses,
        fixes=read_fixes(
            bag, next((t for t, own in inputs.items() if own == messages.LRF_POSE), None)
        ),
    )


def read_fixes(bag: BagReader, asked: str | None) -> Fixes | None:
    """Return the pose fixes of a recording; None if it has none and none were asked for.

    Args:
        bag: the recording.
        asked: the topic that was asked for; None for `lrf_pose`, if the recording has it.

    Raises:
        BagError: the topic that was asked for is missing or of another type.
    """
    topic = asked or messages.absolute_name(messages.LRF_POSE)
    if asked is not None:
        check_topic(bag, topic, messages.POSE_TYPE)
    elif topic not in bag.topics or bag.topics[topic].type_name != messages.POSE_TYPE:
        return None
    found = [bag.message(record) for record in bag.records({topic})]
    stamps: NDArray[np.int64] = np.array([messages.stamp_ns(m) for m in found], dtype=np.int64)
    pose = np.array([messages.planar_pose(message) for message in found]).reshape(-1, 3)
    return Fixes(stamps, pose)


def _noise_topic(bag: BagReader, odom_topic: str) -> str:
    """Return the topic of the noise: beside odom, of a node without namespace, or the only one."""
    ending = f"/{NODE_NAME}/{messages.NOISE}"
    beside = odom_topic.rpartition("/")[0] + ending
    known = [
        name for name, topic in bag.topics.items()
        if name.endswith(ending) and topic.type_name == messages.NOISE_TYPE
    ]  # fmt: skip
    if beside in known or ending in known or len(known) != 1:
        return beside if beside in known else ending
    return known[0]


def _take_statuses(found: _Collected, output: Output) -> None:
    for status in output.statuses or ():
        found.status(status.name, StatusReport(output.stamp_ns, int(status.level), status.message))
