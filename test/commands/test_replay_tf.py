# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""What replay writes to /tf."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import Refuse, Succeed, parameters_of

from fnn_ekf_ros import messages
from fnn_ekf_ros.core.arrays import FloatArray
from fnn_ekf_ros.messages import Message
from fnn_ekf_ros.recordings.bag_files import BagReader
from fnn_ekf_ros.recordings.bag_writer import BagWriter

NAV2 = ("--tf", "-p", "odom_frame:=odom", "-p", "transform_tolerance:=0.25")
AHEAD_NS = 250_000_000


def matrix(pose: FloatArray) -> FloatArray:
    """Return the 3x3 matrix of a planar pose."""
    c, s = np.cos(pose[2]), np.sin(pose[2])
    return np.array([[c, -s, pose[0]], [s, c, pose[1]], [0.0, 0.0, 1.0]])


def stamped(stamp_ns: int, *entries: tuple[str, str, FloatArray]) -> Message:
    """Return a TFMessage of several transforms: parent, child, pose."""
    made = [messages.transform_message(stamp_ns, *entry) for entry in entries]
    return Message(messages.TF_TYPE, {"transforms": [m.fields["transforms"][0] for m in made]})


def with_wheel_odometry(recorded: Path, out: Path) -> Path:
    """Copy a recording and add odom -> base_link at each ground truth, among other transforms.

    The wheel odometry's frame lies at (3, -1), turned by 2 rad, in the map.
    """
    to_map = np.linalg.inv(matrix(np.array([3.0, -1.0, 2.0])))
    with BagReader(recorded) as source, BagWriter(out) as copy:
        for record in source.records():
            copy.write_raw(record)
            if record.topic == "/ground_truth":
                truth = source.message(record)
                stamp_ns, pose = messages.stamp_ns(truth), messages.planar_pose(truth)
                moved = to_map @ matrix(pose)
                own = np.array([*moved[:2, 2], np.arctan2(moved[1, 0], moved[0, 0])])
                zero = np.zeros(3)
                sent = stamped(
                    stamp_ns, ("odom", "base_link", own), ("base_link", "laser", zero),
                    ("map", "odom", zero),
                )  # fmt: skip
                copy.write("/tf", sent, record.time_ns)
                copy.write("/tf", stamped(stamp_ns, ("map", "/odom", zero)), record.time_ns)
    return out


def transforms(bag: Path, child: str) -> list[Any]:
    """Return the transforms to a frame, in their order."""
    with BagReader(bag) as reader:
        return [
            entry
            for record in reader.records({"/tf"})
            for entry in reader.message(record).transforms
            if entry.child_frame_id.lstrip("/") == child
        ]


def planar(entry: Any) -> FloatArray:
    """Return the pose of a transform."""
    yaw = messages.yaw_of(entry.transform.rotation)
    assert yaw is not None
    return np.array([entry.transform.translation.x, entry.transform.translation.y, yaw])


def odoms(bag: Path) -> list[Any]:
    """Return the odometry of a bag."""
    with BagReader(bag) as reader:
        return [reader.message(record) for record in reader.records({"/odom"})]


@pytest.mark.slow
def test_every_odom_has_its_transform(tmp_path: Path, recorded: Path, succeed: Succeed) -> None:
    out = tmp_path / "out"
    succeed("replay", recorded, out, "--params", parameters_of(recorded), "--tf")
    found = transforms(out, "base_link")
    assert len(found) > 30
    for odom, entry in zip(odoms(out), found, strict=True):
        assert entry.header == odom.header
        np.testing.assert_allclose(planar(entry), messages.planar_pose(odom), atol=1e-12)
    with BagReader(out) as bag:
        *_, last = (bag.message(record) for record in bag.records({"/diagnostics"}))
    assert [s.message for s in last.status if s.name == "localizer: tf"] == ["published"]


@pytest.mark.slow
def test_the_transform_to_odom_completes_the_recorded_one(
    tmp_path: Path, recorded: Path, succeed: Succeed
) -> None:
    """A recorded transform to odom is not copied: a frame has one parent."""
    bag = with_wheel_odometry(recorded, tmp_path / "bag")
    out = tmp_path / "out"
    said = succeed("replay", bag, out, "--params", parameters_of(recorded), *NAV2)
    replaced = len(transforms(bag, "odom"))
    assert f"replay: {replaced} transforms to odom of {bag} not copied: OUT gets new ones" in said
    known = {messages.stamp_ns(each): planar(each) for each in transforms(bag, "base_link")}
    poses = {messages.stamp_ns(odom): messages.planar_pose(odom) for odom in odoms(out)}
    found = transforms(out, "odom")
    compared = 0
    for entry in found:
        assert entry.header.frame_id == "map"
        stamp_ns = messages.stamp_ns(entry) - AHEAD_NS
        if stamp_ns in known:
            whole = matrix(planar(entry)) @ matrix(known[stamp_ns])
            np.testing.assert_allclose(whole, matrix(poses[stamp_ns]), atol=1e-9)
            compared += 1
    assert compared == len(found) >= len(poses) - 1 > 30
    assert np.median([planar(entry) for entry in found], axis=0) == pytest.approx(
        [3.0, -1.0, 2.0], abs=0.3
    )
    for child in ("base_link", "laser"):
        assert transforms(out, child) == transforms(bag, child)


@pytest.mark.slow
def test_without_tf_what_was_recorded_is_copied_as_it_is(
    tmp_path: Path, recorded: Path, succeed: Succeed
) -> None:
    bag = with_wheel_odometry(recorded, tmp_path / "bag")
    words = ["--params", parameters_of(recorded), "-p", "publish_tf:=true"]
    succeed("replay", bag, tmp_path / "out", *words)
    assert transforms(tmp_path / "out", "odom") == transforms(bag, "odom")


@pytest.mark.slow
def test_tf_of_another_type_or_between_equal_frames_is_refused(
    tmp_path: Path, recorded: Path, refuse: Refuse
) -> None:
    with BagReader(recorded) as source, BagWriter(tmp_path / "bag") as copy:
        for record in source.records():
            copy.write_raw(record)
            if record.topic == "/left_ticks":
                copy.write_raw(record._replace(topic="/tf"))
    words = ["--params", parameters_of(recorded), "--tf"]
    line = refuse("replay", tmp_path / "bag", tmp_path / "out", *words)
    assert "topic /tf is std_msgs/msg/Int32, expected tf2_msgs/msg/TFMessage" in line
    line = refuse("replay", recorded, tmp_path / "out", *words, "-p", "odom_frame:=map")
    assert "parameter 'publish_tf' is True: expected frames of different names" in line
