# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Drives of examinations as bags, under the names and stamps that a test asks for."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from fnn_ekf_ros import messages
from fnn_ekf_ros.calibration.examination import Drive
from fnn_ekf_ros.messages import Message
from fnn_ekf_ros.recordings.bag_writer import BagWriter

START_NS = 100 * 10**9
"""Time of the first message [ns]."""


def write_bag(
    path: Path,
    drive: Drive,
    names: Mapping[str, str] = {},
    stamp_errors_s: Mapping[str, float] = {},
    drifts: Mapping[str, float] = {},
    joints: tuple[str, str] | None = None,
    frame: str = "map",
) -> None:
    """Write a bag.

    Args:
        path: of the bag.
        drive: what it holds.
        names: other names of topics; an empty one leaves a topic out.
        stamp_errors_s: by how much a topic's stamps are ahead of the time of recording [s].
        drifts: by which part of the time a topic's stamps go on too slowly.
        joints: names of the wheels in joint_states, which is written instead of ticks.
        frame: of the fixes.
    """
    found: list[tuple[int, str, Message]] = []
    turn = 2.0 * np.pi / 2000.0
    for topic, wheel in ((messages.LEFT_TICKS, drive.left), (messages.RIGHT_TICKS, drive.right)):
        for time, count in wheel:
            data = Message(messages.TICKS_TYPE, {"data": int(count)})
            if joints is None:
                found.append((_ns(time), topic, data))
    if joints is not None:
        for (time, left), (_, right) in zip(drive.left, drive.right, strict=True):
            fields = {
                "header": messages.header(_ns(time), ""),
                "name": ["caster", *joints],
                "position": np.array([0.0, left * turn, right * turn]),
                "velocity": np.zeros(0),
                "effort": np.zeros(0),
            }
            message = Message(messages.JOINT_STATES_TYPE, fields)
            found.append((_ns(time), messages.JOINT_STATES, message))
    for time, yaw in drive.compass:
        slow = drifts.get(messages.COMPASS, 0.0) * time
        stamp_ns = _ns(time + stamp_errors_s.get(messages.COMPASS, 0.0) - slow)
        message = messages.compass_message(stamp_ns, "base_link", yaw, 0.05)
        found.append((_ns(time), messages.COMPASS, message))
    for time, *pose in drive.fixes:
        stamp_ns = _ns(time + stamp_errors_s.get(messages.LRF_POSE, 0.0))
        covariance = messages.planar_covariance(np.diag([0.01, 0.01, 0.0025]))
        fields = {
            "header": messages.header(stamp_ns, frame),
            "pose": messages.pose_with_covariance(np.array(pose), covariance),
        }
        found.append((_ns(time), messages.LRF_POSE, Message(messages.POSE_TYPE, fields)))
    with BagWriter(path) as bag:
        for time_ns, topic, message in sorted(found, key=lambda each: each[0]):
            name = names.get(topic, topic)
            if name:
                bag.write(f"/{name}", message, time_ns)


def _ns(time_s: float) -> int:
    return START_NS + round(time_s * 1e9)
