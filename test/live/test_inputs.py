# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""What reaches the localizer, at which quality of service, and whether it keeps pace."""

import time
from collections.abc import Callable
from typing import Any

import pytest
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.duration import Duration
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import Imu, JointState
from std_msgs.msg import Int32
from std_srvs.srv import SetBool

from fnn_ekf_ros.ros import localizer as localizer_module
from fnn_ekf_ros.timeline.events import CompassYaw, WheelCount

pytestmark = pytest.mark.live

MakeBench = Callable[..., Any]
S = 10**9
START = ("-p", "initial_pose:=[1.0, 2.0, 0.5]")
INPUTS = ("compass", "lrf_pose", "initialpose", "left_ticks", "right_ticks")


def offered(bench: Any, topic: str) -> QoSProfile:
    """Return what the localizer's subscription is like, as others see it."""
    bench.spin_until(lambda: bench.node.count_subscribers(topic), topic)
    (info,) = bench.node.get_subscriptions_info_by_topic(topic)
    assert info.node_name == "localizer"
    return info.qos_profile


def depth(bench: Any, topic: str) -> int:
    found = {entry.topic_name: entry for entry in bench.localizer.subscriptions}
    return int(found[f"/{topic}"].qos_profile.depth)


def values_of(bench: Any, status: str) -> dict[str, str]:
    (found,) = (entry for entry in bench.localizer.localizer.report() if entry.name == status)
    return dict(found.values)


@pytest.mark.parametrize("topic", INPUTS)
def test_each_input_can_be_overridden(bench: MakeBench, topic: str) -> None:
    opened = bench(
        "-p", f"qos_overrides./{topic}.subscription.depth:=7",
        "-p", f"qos_overrides./{topic}.subscription.reliability:=reliable",
    )  # fmt: skip
    for name in INPUTS:
        asked = name == topic
        assert depth(opened, name) == (7 if asked else localizer_module.INPUT_QOS.depth)
        reliability = ReliabilityPolicy.RELIABLE if asked else ReliabilityPolicy.BEST_EFFORT
        assert offered(opened, name).reliability == reliability


def test_an_override_that_makes_no_sense_ends_the_node_with_one_line(processes: Any) -> None:
    ended = processes.run(
        "localizer", "--ros-args", "-p", "wheel_radius:=0.025", "-p", "wheel_separation:=0.6",
        "-p", "encoder_counts_per_revolution:=500.0",
        "-p", "qos_overrides./compass.subscription.reliability:=always",
    )  # fmt: skip
    assert ended.returncode == 1
    (line,) = ended.stderr.strip().splitlines()
    assert line.startswith("localizer: the node cannot start: ")
    assert "always" in line


@pytest.mark.parametrize("wheels_first", [True, False])
def test_messages_that_wait_together_are_taken_in_the_order_of_sending(
    bench: MakeBench, monkeypatch: pytest.MonkeyPatch, wheels_first: bool
) -> None:
    """Wheels close periods: a reading that was sent before must not come too late for its own."""
    overrides = (
        f"qos_overrides./{topic}.subscription.reliability:=reliable"
        for topic in ("compass", "joint_states")
    )
    words = [word for override in overrides for word in ("-p", override)]
    opened = bench("-p", "encoder_source:=joint_states", *words)
    opened.set_clock(100 * S)
    wheels = opened.node.create_publisher(JointState, "joint_states", 10)
    compass = opened.node.create_publisher(Imu, "compass", 10)
    for publisher in (wheels, compass):
        opened.spin_until(publisher.get_subscription_count, "a subscriber")
    taken: list[type] = []
    localizer = opened.localizer.localizer
    add = localizer.add
    monkeypatch.setattr(localizer, "add", lambda e, now: taken.append(type(e)) or add(e, now))
    turned = JointState(name=["left_wheel_joint", "right_wheel_joint"], position=[0.0, 0.0])
    facing = Imu()
    facing.orientation.w = 1.0
    turned.header.stamp.sec = facing.header.stamp.sec = 100
    both = [(wheels, turned), (compass, facing)]
    for publisher, message in both if wheels_first else reversed(both):
        publisher.publish(message)
        assert publisher.wait_for_all_acked(Duration(seconds=60))
    opened.spin_until(lambda: len(taken) == 3, "all of them")
    counts = [WheelCount, WheelCount]
    assert taken == ([*counts, CompassYaw] if wheels_first else [CompassYaw, *counts])


def test_a_burst_of_joint_states_is_taken_whole(
    bench: MakeBench, monkeypatch: pytest.MonkeyPatch
) -> None:
    opened = bench("-p", "encoder_source:=joint_states")
    publisher = opened.node.create_publisher(JointState, "joint_states", 1000)
    opened.set_clock(100 * S)

    def message(index: int) -> JointState:
        made = JointState(name=["left_wheel_joint", "right_wheel_joint"])
        made.position = [0.01 * index, 0.01 * index]
        made.header.stamp.sec = 99
        made.header.stamp.nanosec = index * 1_000_000
        return made

    def received() -> int:
        return int(values_of(opened, "encoders")["received"])

    heard: list[int] = []
    add = opened.localizer.localizer.add
    monkeypatch.setattr(
        opened.localizer.localizer,
        "add",
        lambda event, now_ns: heard.append(event.stamp_ns) or add(event, now_ns),
    )
    until_heard(opened, publisher, message(0), received)
    publisher.publish(message(1))
    opened.spin_until(lambda: 99 * S + 1_000_000 in heard, "what was sent until now")
    before = received()
    for index in range(500):
        publisher.publish(message(2 + index))
    opened.spin_until(lambda: received() == before + 1000, "all of them")
    assert values_of(opened, "time")["dropped"] == "0"


def test_a_best_effort_sensor_is_heard(bench: MakeBench) -> None:
    opened = bench()
    publisher = opened.node.create_publisher(
        Imu, "compass", QoSProfile(depth=5, reliability=ReliabilityPolicy.BEST_EFFORT)
    )
    opened.set_clock(100 * S)
    message = Imu()
    message.header.stamp.sec = 100
    until_heard(
        opened, publisher, message, lambda: int(values_of(opened, "compass")["received"]) > 0
    )


def until_heard(bench: Any, publisher: Any, message: Any, heard: Callable[[], Any]) -> None:
    """Publish a message until it has an effect: the first may find nobody listening yet."""
    bench.spin_until(lambda: publisher.publish(message) or heard(), "an effect of the message")


def stall(seconds: float) -> None:
    """Be busy, as a slow disk or another process on the core would make the node."""
    until = time.monotonic() + seconds
    while time.monotonic() < until:
        pass


def test_a_node_that_was_held_up_says_so(
    bench: MakeBench, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    opened = bench("-p", "period:=0.05", *START)
    found: list[Any] = []
    opened.node.create_subscription(
        DiagnosticArray, "/diagnostics", lambda message: found.extend(message.status), 100
    )
    ticks = opened.node.create_publisher(Int32, "left_ticks", 10)
    opened.set_clock(100 * S)
    before = int(values_of(opened, "time")["cycle overruns"])
    add = opened.localizer.localizer.add
    monkeypatch.setattr(opened.localizer.localizer, "add", lambda *given: stall(0.2) or add(*given))
    until_heard(
        opened, ticks, Int32(data=1),
        lambda: int(values_of(opened, "time")["cycle overruns"]) > before,
    )  # fmt: skip
    monkeypatch.undo()
    opened.localizer.localizer.overran(0.25)
    opened.set_clock(103 * S)
    opened.spin_until(
        lambda: any(
            status.name == "localizer: time"
            and status.level == b"\x01"
            and status.message == "the node was late by more than a period"
            for status in found
        ),
        "the diagnostics",
    )
    assert "[WARN]" in capfd.readouterr().err


def test_a_message_that_waited_for_a_busy_node_is_an_overrun(
    bench: MakeBench, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The node is asleep, not its middleware: the wait shows by when the message had arrived."""
    opened = bench("-p", "period:=0.1", *START)
    late: list[float] = []
    monkeypatch.setattr(opened.localizer._pace, "_late", late.append)
    ticks = opened.node.create_publisher(Int32, "left_ticks", 10)
    opened.set_clock(100 * S)
    now_ns = iter(range(101 * S, 10**6 * S, S))  # each message closes periods
    heard: list[None] = []
    add = opened.localizer.localizer.add
    monkeypatch.setattr(
        opened.localizer.localizer,
        "add",
        lambda event, _: heard.append(None) or add(event, next(now_ns)),
    )
    until_heard(opened, ticks, Int32(data=1), lambda: len(heard) > 1)
    opened.spin_until(lambda: not late or late.clear(), "the node to have caught up")
    ticks.publish(Int32(data=1))
    stall(0.4)
    opened.spin_until(lambda: sum(wait > 0.25 for wait in late) >= 2, "both signs of it")


def test_an_error_is_logged_as_one(bench: MakeBench, capfd: pytest.CaptureFixture[str]) -> None:
    opened = bench(*START)
    for second in range(100, 108):
        opened.set_clock(second * S)
    logged: list[str] = []

    def has_error() -> bool:
        logged.extend(capfd.readouterr().err.splitlines())
        return any("[ERROR]" in line and "encoders: " in line for line in logged)

    opened.spin_until(has_error, "the error")


def test_a_jump_of_the_clock_is_closed_in_parts_and_services_answer_in_between(
    bench: MakeBench, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nearly ten minutes, of which no period may be missing."""
    opened = bench(*START)
    opened.set_clock(100 * S)
    localizer = opened.localizer.localizer
    advance = localizer.advance
    closed: list[int] = []

    def advance_and_count(*arguments: int) -> Any:
        outputs = advance(*arguments)
        closed.append(len(outputs))
        return outputs

    monkeypatch.setattr(localizer, "advance", advance_and_count)
    opened.set_clock(600 * S)
    assert opened.call(SetBool, "localizer/enable_adaptation", SetBool.Request()).success
    answered_after = sum(closed)
    opened.spin_until(lambda: sum(closed) > 1300, "all periods")
    assert max(closed) == localizer_module.MOST_PERIODS
    assert answered_after < 1300
