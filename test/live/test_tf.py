# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The pose on /tf, with a tf2_msgs from a ROS installation or built for these tests."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import TransformStamped
from nav_msgs.msg import Odometry
from std_msgs.msg import Int32

from fnn_ekf_ros import messages
from fnn_ekf_ros.messages import Message
from fnn_ekf_ros.recordings.bag_files import BagReader, Topic
from fnn_ekf_ros.recordings.bag_writer import BagWriter
from fnn_ekf_ros.ros import localizer as localizer_module

pytestmark = pytest.mark.live

MakeBench = Callable[..., Any]
S = 10**9
PUBLISHING = ("-p", "publish_tf:=true", "-p", "initial_pose:=[1.0, 2.0, 0.5]")
NAV2 = (*PUBLISHING, "-p", "odom_frame:=odom", "-p", "transform_tolerance:=0.25")


def planar(transform: TransformStamped) -> np.ndarray:
    moved = transform.transform.translation
    return np.array([moved.x, moved.y, messages.yaw_of(transform.transform.rotation)])


def matrix(pose: np.ndarray) -> np.ndarray:
    c, s = np.cos(pose[2]), np.sin(pose[2])
    return np.array([[c, -s, pose[0]], [s, c, pose[1]], [0.0, 0.0, 1.0]])


class Tree:
    """Listens to /tf and to odom, and publishes odom -> base_link."""

    def __init__(self, bench: Any) -> None:
        from tf2_msgs.msg import TFMessage

        self.kind = TFMessage
        self.bench = bench
        self.heard: list[TransformStamped] = []
        self.odom: list[Odometry] = []
        bench.node.create_subscription(
            TFMessage, "/tf", lambda message: self.heard.extend(message.transforms), 100
        )
        bench.node.create_subscription(Odometry, "odom", self.odom.append, 100)
        self.publisher = bench.node.create_publisher(TFMessage, "/tf", 100)

    def connect(self) -> None:
        self.bench.spin_until(lambda: self.publisher.get_subscription_count() >= 2, "/tf")

    def drive(self, until_s: int) -> None:
        """Let the wheels speak once, at 5 s, and the time pass."""
        wheels = [
            self.bench.node.create_publisher(Int32, topic, 10)
            for topic in ("left_ticks", "right_ticks")
        ]
        self.bench.set_clock(5 * S)
        localizer = self.bench.localizer.localizer
        heard: list[Any] = []
        add = localizer.add
        localizer.add = lambda event, now_ns: heard.append(event.wheel) or add(event, now_ns)
        self.bench.spin_until(
            lambda: any(wheel.publish(Int32()) for wheel in wheels) or len(set(heard)) == 2, "both"
        )
        for second in range(6, until_s + 1):
            self.bench.set_clock(second * S)

    def publish(self, stamp_ns: int, pose: list[float], child: str = "base_link") -> None:
        sent = TransformStamped(child_frame_id=child)
        sent.header.frame_id = "odom"
        sent.header.stamp.sec, sent.header.stamp.nanosec = divmod(stamp_ns, S)
        sent.transform.translation.x, sent.transform.translation.y = pose[:2]
        sent.transform.rotation.z = np.sin(0.5 * pose[2])
        sent.transform.rotation.w = np.cos(0.5 * pose[2])
        self.publisher.publish(self.kind(transforms=[TransformStamped(), sent]))

    def of_the_localizer(self) -> list[TransformStamped]:
        return [transform for transform in self.heard if transform.header.frame_id == "map"]


def test_every_odom_has_its_transform(tf2_msgs: None, bench: MakeBench) -> None:
    opened = bench(*PUBLISHING)
    tree = Tree(opened)
    opened.spin_until(lambda: opened.node.count_publishers("/tf") == 2, "the publisher of /tf")
    tree.drive(12)
    opened.spin_until(lambda: len(tree.odom) >= 10 and len(tree.heard) >= 10, "ten of each")
    for odom, transform in zip(tree.odom, tree.heard, strict=False):
        assert transform.header == odom.header
        assert transform.child_frame_id == odom.child_frame_id == "base_link"
        np.testing.assert_allclose(planar(transform), messages.planar_pose(odom), atol=1e-12)
    (info,) = (
        info
        for info in opened.node.get_publishers_info_by_topic("/tf")
        if info.node_name == "localizer"
    )
    assert info.qos_profile.reliability.name == "RELIABLE"


def test_the_transform_to_odom_completes_somebody_elses(tf2_msgs: None, bench: MakeBench) -> None:
    """Before the wheel odometry's transform is there nothing is sent; then what waited for it."""
    opened = bench(*NAV2)
    tree = Tree(opened)
    tree.connect()
    tree.drive(8)
    opened.spin_until(lambda: len(tree.odom) >= 7, "odom")
    assert not tree.of_the_localizer()
    before, after = [3.0, -1.0, 3.0], [4.0, -2.0, -3.0]
    first_ns = messages.stamp_ns(tree.odom[0])
    tree.publish(first_ns - S, [9.0, 9.0, 9.0], child="camera")
    tree.publish(first_ns - S, before)
    tree.publish(first_ns + 9 * S, after)
    opened.spin_until(lambda: len(tree.of_the_localizer()) >= 7, "the transforms")
    turn = 2.0 * np.pi - 6.0
    for odom, transform in zip(tree.odom, tree.of_the_localizer(), strict=False):
        at_ns = messages.stamp_ns(odom)
        assert messages.stamp_ns(transform) == at_ns + S // 4
        assert transform.child_frame_id == "odom"
        part = (at_ns - first_ns + S) / (10 * S)
        moved = np.array([3.0 + part, -1.0 - part, 3.0 + part * turn])
        np.testing.assert_allclose(
            matrix(planar(transform)) @ matrix(moved), matrix(messages.planar_pose(odom)),
            atol=1e-9,
        )  # fmt: skip


def test_replay_writes_the_numbers_that_the_node_publishes(
    tf2_msgs: None, bench: MakeBench, tmp_path: Path, succeed: Callable[..., str]
) -> None:
    """The same wheel odometry, before and after the periods, to the node and in a recording."""
    opened = bench(*NAV2)
    tree = Tree(opened)
    tree.connect()
    tree.drive(9)
    opened.spin_until(lambda: len(tree.odom) >= 9, "odom")
    odometry = [(5 * S, [3.0, -1.0, 3.0]), (7 * S, [3.7, -1.1, -2.9]), (9 * S, [4.0, -2.0, -2.0])]
    for stamp_ns, pose in odometry:
        tree.publish(stamp_ns, pose)
    opened.spin_until(lambda: len(tree.of_the_localizer()) >= 8, "the transforms")

    with BagWriter(tmp_path / "bag") as bag:
        bag.add_topic(Topic("/lrf_pose", messages.POSE_TYPE, 0))
        for topic in ("/left_ticks", "/right_ticks"):
            bag.write(topic, Message(messages.TICKS_TYPE, {"data": 0}), 5 * S)
        for second in range(6, 10):
            clock = Message(messages.CLOCK_TYPE, {"clock": messages.time(second * S)})
            bag.write("/clock", clock, second * S)
        for stamp_ns, pose in odometry:
            sent = messages.transform_message(stamp_ns, "odom", "base_link", np.array(pose))
            bag.write("/tf", sent, 9 * S)
    geometry = (
        "wheel_radius:=0.025", "wheel_separation:=0.6", "encoder_counts_per_revolution:=500.0",
    )  # fmt: skip
    words = [word for text in geometry for word in ("-p", text)]
    succeed("replay", tmp_path / "bag", tmp_path / "out", *words, *NAV2, "--tf")
    with BagReader(tmp_path / "out") as replayed:
        made = [
            entry
            for record in replayed.records({"/tf"})
            for entry in replayed.message(record).transforms
            if entry.header.frame_id == "map"
        ]
    # The newest few poses wait for odometry: which they are depends on when it comes.
    published = {messages.stamp_ns(entry): entry for entry in tree.of_the_localizer()}
    both = [entry for entry in made if messages.stamp_ns(entry) in published]
    assert len(both) >= 5
    for one in both:
        other = published[messages.stamp_ns(one)]
        assert one.child_frame_id == other.child_frame_id == "odom"
        np.testing.assert_array_equal(planar(one), planar(other))


def test_odometry_that_never_comes_is_said(
    tf2_msgs: None, bench: MakeBench, capfd: pytest.CaptureFixture[str]
) -> None:
    opened = bench(*NAV2)
    found: list[Any] = []
    opened.node.create_subscription(
        DiagnosticArray, "/diagnostics", lambda message: found.extend(message.status), 100
    )
    Tree(opened).drive(15)
    said = "no transform from odom_frame to base_frame"
    opened.spin_until(
        lambda: any(s.name == "localizer: tf" and s.message == said for s in found),
        "the diagnostics",
    )
    assert f"tf: {said}" in capfd.readouterr().err


def test_transforms_that_make_no_sense_are_passed_over(tf2_msgs: None, bench: MakeBench) -> None:
    opened = bench(*NAV2)
    tree = Tree(opened)
    tree.connect()
    for stamp in (4 * S, 20 * S):
        tree.publish(stamp, [float("nan"), 0.0, 0.0])
        tree.publish(stamp, [0.0, 0.0, float("nan")])
    tree.drive(8)
    opened.spin_until(lambda: len(tree.odom) >= 7, "odom")
    assert not tree.of_the_localizer()
    tree.publish(4 * S, [0.0, 0.0, 0.0])
    tree.publish(12 * S, [0.0, 0.0, 0.0])
    opened.spin_until(lambda: len(tree.of_the_localizer()) >= 7, "the transforms")
    assert all(np.all(np.isfinite(planar(found))) for found in tree.of_the_localizer())


def test_without_publish_tf_there_is_no_tf(bench: MakeBench) -> None:
    opened = bench("-p", "odom_frame:=odom")
    opened.set_clock(5 * S)
    assert opened.node.count_publishers("/tf") == 0
    assert opened.node.count_subscribers("/tf") == 0


def test_without_tf2_msgs_the_node_says_so_and_ends(processes: Any) -> None:
    hidden = processes.folder / "hidden"
    hidden.mkdir()
    (hidden / "tf2_msgs.py").write_text("raise ImportError('it is not here')\n")
    path = processes.environment.get("PYTHONPATH", "")
    processes.environment["PYTHONPATH"] = f"{hidden}:{path}"
    ended = processes.run(
        "localizer", "--ros-args", "-p", "wheel_radius:=0.025", "-p", "wheel_separation:=0.6",
        "-p", "encoder_counts_per_revolution:=500.0", "-p", "publish_tf:=true",
    )  # fmt: skip
    assert ended.returncode == 1
    assert ended.stderr.strip() == (
        "localizer: publish_tf needs tf2_msgs, which is not here (it is not here): install "
        "ros-jazzy-tf2-msgs, or set publish_tf to false"
    )


def test_frames_of_the_same_name_are_refused(
    run: Callable[..., Any], ros_environment: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(localizer_module, "spin_until_stopped", lambda _: pytest.fail("it runs"))
    ended = run(
        "localizer", "--ros-args", "-p", "wheel_radius:=0.025", "-p", "wheel_separation:=0.6",
        "-p", "encoder_counts_per_revolution:=500.0", "-p", "publish_tf:=true",
        "-p", "odom_frame:=map",
    )  # fmt: skip
    assert ended.code == 1
    assert ended.err.strip() == (
        "localizer: parameter 'publish_tf' is True: expected frames of different names, not map, "
        "base_link, map"
    )
