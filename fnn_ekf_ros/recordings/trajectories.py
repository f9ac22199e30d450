# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Trajectories in recordings."""

import numpy as np

from fnn_ekf_ros import messages
from fnn_ekf_ros.core.limits import LARGEST_POSITION
from fnn_ekf_ros.recordings.bag_files import BagError, BagReader
from fnn_ekf_ros.timeline.trajectory import Trajectory


def read_trajectory(bag: BagReader, topic: str) -> Trajectory:
    """Return the poses of a nav_msgs/Odometry topic in the order of their stamps.

    Raises:
        BagError: no such topic, another type, or no message.
    """
    check_topic(bag, topic, messages.ODOMETRY_TYPE)
    stamps, poses, covariances = [], [], []
    frame = ""
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
        frame = str(message.header.frame_id)
    if not stamps:
        raise BagError(f"bag '{bag.path}': topic {topic} is empty")
    time_ns, first = np.unique(np.array(stamps), return_index=True)
    return Trajectory(
        time_ns=time_ns,
        pose=np.array(poses)[first],
        covariance=np.array(covariances)[first],
        frame=frame,
    )


def check_topic(bag: BagReader, topic: str, type_name: str) -> None:
    """Check that a recording has a topic of a type.

    Raises:
        BagError: it is missing or of another type.
    """
    found = bag.topics.get(topic)
    if found is None or found.type_name != type_name:
        kind = "missing" if found is None else f"of type {found.type_name}"
        raise BagError(
            f"bag '{bag.path}': topic {topic} is {kind}, expected {type_name}; "
            f"it has {', '.join(sorted(bag.topics)) or 'no topics'}"
        )
