# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Trajectories and position fixes in recordings."""

import numpy as np

from fnn_ekf_ros import messages
from fnn_ekf_ros.core.arrays import FloatArray
from fnn_ekf_ros.core.limits import LARGEST_POSITION
from fnn_ekf_ros.recordings.bag_files import BagError, BagReader
from fnn_ekf_ros.recordings.scoring import Trajectory


def read_trajectory(bag: BagReader, topic: str) -> Trajectory:
    """Return the poses of a nav_msgs/Odometry topic in the order of their stamps.

    Raises:
        BagError: no such topic, another type, or no message.
    """
    _check_topic(bag, topic, messages.ODOMETRY_TYPE)
    stamps, poses, covariances = [], [], []
    for record in bag.records({topic}):
        message = bag.message(record)
        stamps.append(messages.stamp_ns(message))
        pose = messages.planar_pose(message)
        if not np.all(np.abs(pose[:2]) <= LARGEST_POSITION):
            raise BagError(
                f"bag '{bag.path}': {topic} at {stamps[-1]} ns is at ({pose[0]:g}, {pose[1]:g}) m, "
                "expected finite coordinates"
            )
        poses.append(pose)
        covariances.append(messages.planar_block(message.pose.covariance))
    if not stamps:
        raise BagError(f"bag '{bag.path}': topic {topic} is empty")
    time_ns, first = np.unique(np.array(stamps), return_index=True)
    return Trajectory(
        time_ns=time_ns, pose=np.array(poses)[first], covariance=np.array(covariances)[first]
    )


def read_fixes(bag: BagReader, asked: str | None) -> FloatArray:
    """Return the positions `(n, 2)` of pose fixes [m].

    Args:
        bag: the recording.
        asked: the topic that was asked for; None for `lrf_pose`, if the recording has it.

    Raises:
        BagError: the topic that was asked for is missing or of another type.
    """
    topic = asked or messages.absolute_name(messages.LRF_POSE)
    if asked is not None:
        _check_topic(bag, topic, messages.POSE_TYPE)
    elif topic not in bag.topics or bag.topics[topic].type_name != messages.POSE_TYPE:
        return np.zeros((0, 2))
    fixes = [messages.planar_pose(bag.message(record))[:2] for record in bag.records({topic})]
    return np.array(fixes).reshape(-1, 2)


def _check_topic(bag: BagReader, topic: str, type_name: str) -> None:
    found = bag.topics.get(topic)
    if found is None or found.type_name != type_name:
        kind = "missing" if found is None else f"of type {found.type_name}"
        raise BagError(
            f"bag '{bag.path}': topic {topic} is {kind}, expected {type_name}; "
            f"it has {', '.join(sorted(bag.topics)) or 'no topics'}"
        )
