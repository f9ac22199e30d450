# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The nodes as a user runs them: processes, topics, parameters, services, signals."""

import itertools
import math
import signal
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseWithCovarianceStamped, Twist
from localizers import PERIOD_NS
from nav_msgs.msg import Odometry
from own_nodes import OwnNode
from rcl_interfaces.srv import DescribeParameters, ListParameters, SetParameters
from rclpy.parameter import Parameter
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Imu, JointState
from std_msgs.msg import Float64, Float64MultiArray
from std_srvs.srv import SetBool, Trigger

from fnn_ekf_ros import messages
from fnn_ekf_ros.parameters.localizer import LocalizerParameters
from fnn_ekf_ros.parameters.schema import fields_of
from fnn_ekf_ros.ros import localizer as localizer_module

pytestmark = pytest.mark.live
ASK_AGAIN_S = 10.0
ROBOT = ["--ros-args", "-p", "publish_clock:=true", "-p", "real_time_factor:=5.0"]
GEOMETRY = [
    "-p", "wheel_radius:=0.025", "-p", "wheel_separation:=0.6",
    "-p", "encoder_counts_per_revolution:=500.0",
]  # fmt: skip
LOCALIZER = ["--ros-args", *GEOMETRY, "-p", "use_sim_time:=true"]


class Listener(OwnNode):
    """Collects messages and calls services."""

    def __init__(self) -> None:
        super().__init__("listener")

    def collect(self, kind: Any, topic: str) -> list[Any]:
        """Return a list that fills with a topic's messages."""
        received: list[Any] = []
        self.node.create_subscription(kind, topic, received.append, 1000)
        return received

    def call(self, kind: Any, name: str, request: Any, patiently: Callable[..., None]) -> Any:
        """Call a service and return its response."""
        client = self.node.create_client(kind, name)
        patiently(lambda: self.spin() or client.service_is_ready(), f"service {name}")
        asked = [(time.monotonic(), client.call_async(request))]

        def answered() -> bool:
            """An answer is lost if the server has not found our reader yet: ask once more."""
            self.spin()
            if time.monotonic() - asked[-1][0] > ASK_AGAIN_S:
                asked.append((time.monotonic(), client.call_async(request)))
            return any(future.done() for _, future in asked)

        patiently(answered, f"answer of {name}")
        return next(future.result() for _, future in asked if future.done())


@pytest.fixture
def listener(ros_environment: None) -> Iterator[Listener]:
    opened = Listener()
    yield opened
    opened.close()


def stamps_ns(received: list[Any]) -> list[int]:
    return [messages.stamp_ns(message) for message in received]


def with_truth(odom: list[Odometry], truth: list[Odometry]) -> list[tuple[Odometry, np.ndarray]]:
    """Return the odom messages for whose stamps the truth is known, with it."""
    poses = {messages.stamp_ns(message): messages.planar_pose(message) for message in truth}
    return [(m, poses[messages.stamp_ns(m)]) for m in odom if messages.stamp_ns(m) in poses]


@pytest.mark.parametrize(
    ("source", "ending"), [("ticks", signal.SIGINT), ("joint_states", signal.SIGTERM)]
)
def test_fake_robot_and_localizer_without_launch(
    processes: Any, listener: Listener, patiently: Callable[..., None], source: str, ending: int
) -> None:
    """Two processes: odom every 375 ms of ROS time, each one near the truth, clean exits.

    Ticks are stamped on arrival: where a busy machine held them up, some odom is off. Stamped
    wheels are waited for.
    """
    odom = listener.collect(Odometry, "odom")
    truth = listener.collect(Odometry, "ground_truth")
    noise = listener.collect(Float64MultiArray, "localizer/noise")
    numbers = {
        topic: listener.collect(Float64, f"localizer/{topic}") for topic in messages.NUMBER_TOPICS
    }
    diagnostics = listener.collect(DiagnosticArray, "/diagnostics")
    patience = ["-p", "encoder_timeout:=60.0", "-p", "history:=10.0"]
    localizer = processes.start(
        "localizer", *LOCALIZER, "-p", f"encoder_source:={source}",
        *(patience if source == "joint_states" else []),
    )  # fmt: skip
    robot = processes.start("fake_robot", *ROBOT, "-p", "path:=figure_eight")
    patiently(lambda: listener.spin() or len(with_truth(odom, truth)) >= 40, "40 odom and truth")
    beside = [noise, *numbers.values()]
    patiently(lambda: listener.spin() or min(map(len, beside)) >= 10, "the noise and its numbers")
    processes.stop(localizer, ending)
    processes.stop(robot, ending)

    stamps = stamps_ns(odom)
    assert set(np.diff(stamps)) == {PERIOD_NS}
    assert all(stamp % PERIOD_NS == 0 for stamp in stamps)
    errors = [messages.planar_pose(message) - pose for message, pose in with_truth(odom, truth)]
    distances = [np.hypot(error[0], error[1]) for error in errors]
    assert (np.median if source == "ticks" else np.max)(distances) < 0.5
    for message in odom:
        assert message.header.frame_id == "map"
        assert message.child_frame_id == "base_link"
        covariance = np.reshape(message.pose.covariance, (6, 6))
        np.testing.assert_array_equal(np.diag(covariance)[2:5], 1e-9)
        assert np.all(np.linalg.eigvalsh(covariance) > 0.0)
    assert all(len(message.data) == len(messages.NOISE_FIELDS) for message in noise)
    roots = {math.sqrt(message.data[0]) for message in noise}
    assert numbers["noise/lrf_x_std"][-2].data in roots
    assert noise[0].layout.dim[0].label.split(",") == list(messages.NOISE_FIELDS)
    names = {status.name for message in diagnostics for status in message.status}
    parts = ("encoders", "compass", "lrf_pose", "filter", "time")
    assert names == {f"localizer: {part}" for part in parts}
    levels = [
        status.level
        for message in diagnostics
        for status in message.status
        if status.name == "localizer: filter"
    ]
    assert b"\x00" in (levels if source == "ticks" else levels[-1:])


def test_two_localizers_of_one_name_name_each_other(
    processes: Any, listener: Listener, patiently: Callable[..., None]
) -> None:
    diagnostics = listener.collect(DiagnosticArray, "/diagnostics")
    first, second = (processes.start("localizer", "--ros-args", *GEOMETRY) for _ in range(2))
    said = "/odom is also published by /localizer (of the same name): end one of the two"
    patiently(
        lambda: listener.spin() or all(said in processes.output(each) for each in (first, second)),
        "both warnings",
    )

    def status() -> Any:
        listener.spin()
        found = [s for m in diagnostics for s in m.status if s.name == "localizer: odom"]
        return found[-1] if found else None

    patiently(lambda: status() is not None and status().level == b"\x01", "the status")
    assert status().message == "another node publishes odom, too"
    assert status().values[0].value == "/localizer (of the same name)"
    processes.stop(first)
    patiently(lambda: status().level == b"\x00", "the status without the other one")
    processes.stop(second)


def test_robots_in_namespaces_do_not_hear_each_other(
    processes: Any, listener: Listener, patiently: Callable[..., None], tmp_path: Path
) -> None:
    """One parameter file, two namespaces; the localizer without a robot of its own stays silent."""
    file = tmp_path / "robots.yaml"
    file.write_text(
        "/**/localizer:\n  ros__parameters:\n    wheel_radius: 0.025\n    wheel_separation: 0.6\n"
        "    encoder_counts_per_revolution: 500\n    use_sim_time: true\n"
    )
    one = listener.collect(Odometry, "/one/odom")
    two = listener.collect(Odometry, "/two/odom")
    for name in ("one", "two"):
        processes.start("localizer", "--ros-args", "--params-file", file, "-r", f"__ns:=/{name}")
    processes.start("fake_robot", *ROBOT, "-r", "__ns:=/one")
    patiently(lambda: listener.spin() or len(one) >= 10, "odom of robot one")
    assert not two


def test_services(processes: Any, listener: Listener, patiently: Callable[..., None]) -> None:
    odom = listener.collect(Odometry, "odom")
    processes.start("localizer", *LOCALIZER, "-p", "adaptation:=r", "-p", "innovation_window:=6")
    processes.start("fake_robot", *ROBOT)
    patiently(lambda: listener.spin() or len(odom) >= 20, "odom")
    off = listener.call(
        SetBool, "localizer/enable_adaptation", SetBool.Request(data=False), patiently
    )
    assert off.success
    noise = listener.collect(Float64MultiArray, "localizer/noise")
    patiently(lambda: listener.spin() or len(noise) >= 10, "noise")
    held = np.array([message.data[:6] for message in noise])
    assert np.all(held == held[0]), "the noise moves although adaptation is disabled"
    assert held[0, 0] != pytest.approx(0.01, rel=1e-9), "the noise had been adapted before"

    assert listener.call(SetBool, "localizer/enable_adaptation", SetBool.Request(data=True),
                         patiently).success  # fmt: skip
    noise.clear()
    patiently(
        lambda: listener.spin() or len({message.data[0] for message in noise}) > 3, "adaptation"
    )
    assert listener.call(Trigger, "localizer/reset", Trigger.Request(), patiently).success
    noise.clear()
    patiently(lambda: listener.spin() or noise, "noise after the reset")
    assert noise[0].data[0] == pytest.approx(0.01, rel=1e-9)


def test_parameters_are_those_of_the_dataclass(
    processes: Any, listener: Listener, patiently: Callable[..., None]
) -> None:
    processes.start("localizer", *LOCALIZER)
    names = listener.call(
        ListParameters, "localizer/list_parameters", ListParameters.Request(), patiently
    ).result.names
    specs = {name: spec for name, spec, _ in fields_of(LocalizerParameters)}
    declared = {name for name in names if not name.startswith("qos_overrides.")}
    assert declared - {"use_sim_time", "start_type_description_service"} == set(specs)
    described = listener.call(
        DescribeParameters, "localizer/describe_parameters",
        DescribeParameters.Request(names=sorted(specs)), patiently,
    ).descriptors  # fmt: skip
    assert [d.description for d in described] == [specs[name].doc for name in sorted(specs)]
    changeable = {descriptor.name for descriptor in described if not descriptor.read_only}
    assert changeable == {
        "adaptation", "process_noise_std_min", "process_noise_std_max",
        "measurement_noise_std_min", "measurement_noise_std_max",
    }  # fmt: skip
    period = described[sorted(specs).index("period")].floating_point_range[0]
    assert (period.from_value, period.to_value) == (0.01, 10.0)
    change = Parameter("period", value=1.0).to_parameter_msg()
    answer = listener.call(
        SetParameters, "localizer/set_parameters", SetParameters.Request(parameters=[change]),
        patiently,
    )  # fmt: skip
    assert not answer.results[0].successful


def test_fake_robot_follows_cmd_vel_and_stops_without(
    processes: Any, listener: Listener, patiently: Callable[..., None]
) -> None:
    truth = listener.collect(Odometry, "ground_truth")
    commands = listener.node.create_publisher(Twist, "cmd_vel", 10)
    processes.start("fake_robot", *ROBOT, "-p", "path:=cmd_vel", "-p", "slip_std:=[0.0, 0.0]")
    command = Twist()
    command.linear.x = 0.2

    def driven() -> float:
        return float(truth[-1].pose.pose.position.x) if truth else 0.0

    patiently(
        lambda: listener.spin() or commands.publish(command) or driven() > 0.5, "the robot to go"
    )
    patiently(lambda: listener.spin() or truth[-1].twist.twist.linear.x == 0.0, "the robot to stop")
    assert truth[-1].pose.pose.position.y == pytest.approx(0.0, abs=0.05)


def test_fake_robot_has_the_rates_it_is_given(
    processes: Any, listener: Listener, patiently: Callable[..., None]
) -> None:
    compass = listener.collect(Imu, "compass")
    joints = listener.collect(JointState, "joint_states")
    rates = ["-p", "compass_rate:=50.0", "-p", "encoder_rate:=80.0", "-p", "lrf_rate:=0.1"]
    processes.start("fake_robot", *ROBOT, *rates)
    patiently(
        lambda: listener.spin() or min(len(compass), len(joints)) >= 200, "200 of each sensor"
    )
    for received, interval_ns in ((compass, 20_000_000), (joints, 12_500_000)):
        stamps = stamps_ns(received)
        assert set(np.diff(stamps[-100:])) == {interval_ns}
        assert {stamp % interval_ns for stamp in stamps} == {0}


def test_hostile_messages_do_not_end_the_node(
    processes: Any, listener: Listener, patiently: Callable[..., None]
) -> None:
    odom = listener.collect(Odometry, "odom")
    diagnostics = listener.collect(DiagnosticArray, "/diagnostics")
    localizer = processes.start("localizer", *LOCALIZER)
    processes.start("fake_robot", *ROBOT)
    fixes = listener.node.create_publisher(PoseWithCovarianceStamped, "lrf_pose", 100)
    compass = listener.node.create_publisher(Imu, "compass", 100)
    patiently(
        lambda: (
            listener.spin()
            or (odom and fixes.get_subscription_count() and compass.get_subscription_count())
        ),
        "the localizer",
    )
    for value in (float("nan"), float("inf"), 1e300):
        for frame in ("map", "", "elsewhere"):
            fix = PoseWithCovarianceStamped()
            fix.header.frame_id = frame
            fix.header.stamp = odom[-1].header.stamp
            fix.pose.pose.position.x = value
            fixes.publish(fix)
        yaw = Imu()
        yaw.header.stamp = odom[-1].header.stamp
        yaw.orientation.w = value
        compass.publish(yaw)
    before = len(odom)
    patiently(lambda: listener.spin() or len(odom) >= before + 20, "odom after the attack")
    refusals = [
        status.message
        for message in diagnostics
        for status in message.status
        if status.message.startswith("message refused: ")
    ]
    assert refusals
    for message in odom:
        assert np.all(np.isfinite(messages.planar_pose(message)))
        assert np.all(np.isfinite(message.pose.covariance))
    assert "refused" in processes.stop(localizer)


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        ([], "'wheel_radius' is not set"),
        (["-p", "wheel_radius:=-0.1"], "'wheel_radius' is -0.1: expected a number from 0.0001"),
        ([*GEOMETRY, "-p", "perod:=0.5"], "unknown parameter 'perod': did you mean 'period'?"),
        ([*GEOMETRY, "-p", "period:=fast"], "'period' is 'fast': expected a number"),
        ([*GEOMETRY, "-p", "period:=99.0"], "'period' is 99.0: expected a number"),
        ([*GEOMETRY, "-p", "adaptation:=off"], "'adaptation' is False: expected one of none, r"),
        ([*GEOMETRY, "-p", "process_noise_std:=[0.02, 1]"], "expected a list of one type"),
        ([*GEOMETRY, "-p", "initial_pose:=[]"], "'initial_pose' has no value"),
        ([*GEOMETRY, "-p", "joint_membership_file:=/nowhere"], "membership_file '/nowhere'"),
        (["--params-file", "/nowhere.yaml"], "parameter file '/nowhere.yaml'"),
    ],
)
def test_wrong_parameters_end_the_node_with_one_line(
    run: Callable[..., Any],
    ros_environment: None,
    monkeypatch: pytest.MonkeyPatch,
    arguments: list[str],
    expected: str,
) -> None:
    """In this process: others test that what a command says and returns leaves its process."""
    monkeypatch.setattr(localizer_module, "spin_until_stopped", lambda _: pytest.fail("it runs"))
    ended = run("localizer", "--ros-args", *arguments)
    assert (ended.code, ended.out) == (1, "")
    lines = ended.err.strip().splitlines()
    assert len(lines) == 1, ended.err
    assert lines[0].startswith("localizer: ")
    assert expected in lines[0]


@pytest.mark.parametrize(("name", "renamed"), [("fnn_localizer", ""), ("localizer", "other")])
def test_a_parameter_file_for_a_node_of_another_name_is_named(
    run: Callable[..., Any], ros_environment: None, tmp_path: Path, name: str, renamed: str
) -> None:
    file = tmp_path / "robot.yaml"
    file.write_text(f"{name}:\n  ros__parameters:\n    wheel_radius: 0.1\n")
    remap = ["-r", f"__node:={renamed}"] if renamed else []
    ended = run("localizer", "--ros-args", "--params-file", file, *remap)
    assert ended.code == 1
    (line,) = ended.err.splitlines()
    node = renamed or "localizer"
    assert line.endswith(
        f"; parameter file '{file}' has no section for {node}, but for /{name}: expected "
        f"'/**/{node}:' or '/**:'; rename the section"
    )


def test_integers_count_as_floats(
    processes: Any, listener: Listener, patiently: Callable[..., None]
) -> None:
    odom = listener.collect(Odometry, "odom")
    processes.start(
        "localizer", *LOCALIZER, "-p", "encoder_counts_per_revolution:=500",
        "-p", "initial_pose:=[3, 0, 1]",
    )  # fmt: skip
    processes.start("fake_robot", *ROBOT)
    patiently(lambda: listener.spin() or odom, "odom")


def test_unknown_fake_robot_parameter_ends_it_with_one_line(processes: Any) -> None:
    ended = processes.run("fake_robot", "--ros-args", "-p", "path:=moon")
    assert ended.returncode == 1
    assert ended.stderr.strip().splitlines() == [
        "fake_robot: parameter 'path' is 'moon': expected one of square, round, figure_eight, "
        "sim1, sim2, cmd_vel"
    ]


def test_fake_robot_with_a_wrong_timeline_of_faults_ends_with_one_line(
    processes: Any, tmp_path: Path
) -> None:
    (tmp_path / "faults.yaml").write_text("- {fault: slip, start: soon}\n")
    path = tmp_path / "faults.yaml"
    ended = processes.run("fake_robot", "--ros-args", "-p", f"faults_file:={path}")
    assert ended.returncode == 1
    assert ended.stderr.strip().splitlines() == [
        f"fake_robot: faults_file '{path}', entry 1 (slip): parameter 'start' is 'soon': expected "
        "a number from 0 to 1000000000 [s]"
    ]


def test_fake_robot_has_its_faults(
    processes: Any, listener: Listener, patiently: Callable[..., None], tmp_path: Path
) -> None:
    """Its compass is silent from the start; its clock, which it publishes, jumps."""
    path = tmp_path / "faults.yaml"
    path.write_text(
        "- {fault: dropout, topic: compass, start: 0}\n- {fault: clock_jump, start: 30, size: 1000}"
    )
    compass = listener.collect(Imu, "compass")
    truth = listener.collect(Odometry, "ground_truth")
    clock = listener.collect(Clock, "/clock")
    processes.start("fake_robot", *ROBOT, "-p", f"faults_file:={path}")
    patiently(lambda: listener.spin() or (clock and clock[-1].clock.sec > 1000), "the jump")
    count = len(truth)
    patiently(lambda: listener.spin() or len(truth) > count + 10, "the truth after it")
    assert truth[-1].header.stamp.sec > 1000
    assert not compass
    times = [entry.clock.sec + 1e-9 * entry.clock.nanosec for entry in clock]
    jumps = [later - former for former, later in itertools.pairwise(times)]
    assert max(jumps) == pytest.approx(1000.0, abs=1.0)
    assert sum(jump > 1.0 for jump in jumps) == 1
    assert min(jumps) > 0.0
