# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The same result live and in replay, to the last bit."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from own_nodes import OwnNode
from rosgraph_msgs.msg import Clock

from fnn_ekf_ros import messages
from fnn_ekf_ros.recordings.bag_files import BagReader
from fnn_ekf_ros.ros.record import Recorder

pytestmark = pytest.mark.live

S = 10**9
COMPARED = 40
"""Number of odom messages that are compared."""
RECORDED = {
    "/joint_states": messages.JOINT_STATES_TYPE,
    "/compass": messages.COMPASS_TYPE,
    "/lrf_pose": messages.POSE_TYPE,
    "/odom": messages.ODOMETRY_TYPE,
}
OUTPUT_DELAY_S = 3.0
LOCALIZER = [
    "-p", "wheel_radius:=0.025", "-p", "wheel_separation:=0.6",
    "-p", "encoder_source:=joint_states", "-p", f"output_delay:={OUTPUT_DELAY_S}",
    "-p", "encoder_timeout:=60.0",
]  # fmt: skip
MEETING_S = 40
"""For so long no fix is of the localizer's frame; the processes have met by then."""


def numbers(bag: Path) -> dict[int, tuple[float, ...]]:
    """Return all numbers of each odom message, by its stamp."""
    found = {}
    with BagReader(bag) as reader:
        for record in reader.records({"/odom"}):
            m = reader.message(record)
            pose, twist = m.pose.pose, m.twist.twist
            found[messages.stamp_ns(m)] = (
                *(getattr(pose.position, axis) for axis in "xyz"),
                *(getattr(pose.orientation, axis) for axis in "xyzw"),
                *m.pose.covariance,
                *(getattr(twist.linear, axis) for axis in "xyz"),
                *(getattr(twist.angular, axis) for axis in "xyz"),
                *m.twist.covariance,
            )
    return found


class PatientClock(OwnNode):
    """A /clock of the test's own, which waits for the slowest node, however busy the machine is.

    Args:
        recorder: is spun, too; it hears the robot.
    """

    STEP_NS = 50_000_000
    """The interval of the wheels' messages."""
    ROBOT_LEAD_NS = S // 2
    LOCALIZER_LEAD_NS = round((OUTPUT_DELAY_S + 1.75) * S)
    """Diagnostics are published once a second, of a period that ended `output_delay` before."""

    def __init__(self, recorder: Recorder) -> None:
        super().__init__("clock")
        self._recorder = recorder
        self._publisher = self.node.create_publisher(Clock, "/clock", 10)
        self.node.create_subscription(DiagnosticArray, "/diagnostics", self._hear, 1000)
        self.now_ns = self._health_ns = 0
        self._met_ns = self._wheels_before = 0
        self._health: dict[str, dict[str, str]] = {}

    def found_by_all(self) -> bool:
        """Return whether robot, localizer and recorder listen to the time, which stands still."""
        self._spin_both(0.05)
        return self._publisher.get_subscription_count() >= 3 and self._recorder.connected()

    def go_on_until_met(self) -> bool:
        """Let some time pass; return whether all hear the robot's sensors."""
        self.now_ns += self.STEP_NS
        self._tell()
        self._spin_both(0.02)
        self._met_ns, self._wheels_before = self.now_ns, self._recorder.counts["/joint_states"]
        return all(self._recorder.counts[topic] for topic in RECORDED if topic != "/odom") and all(
            int(self._health.get(name, {}).get(key, "0"))
            for name, key in (
                ("encoders", "received"), ("compass", "received"), ("lrf_pose", "refused"),
            )
        )  # fmt: skip

    def go_on(self) -> None:
        """Let some time pass, if robot, recorder and localizer have kept up."""
        wheels = self._recorder.counts["/joint_states"] - self._wheels_before
        robot_ns = self._met_ns + wheels * self.STEP_NS
        if self.now_ns < min(
            robot_ns + self.ROBOT_LEAD_NS, self._health_ns + self.LOCALIZER_LEAD_NS
        ):
            self.now_ns += self.STEP_NS
        self._tell()
        self._spin_both(0.002)

    def _tell(self) -> None:
        message = Clock()
        message.clock.sec, message.clock.nanosec = divmod(self.now_ns, S)
        self._publisher.publish(message)

    def _spin_both(self, seconds: float) -> None:
        self.spin(seconds)
        self._recorder.spin_once(seconds)
        for _ in range(5):
            self._recorder.spin_once(0.0)

    def _hear(self, message: DiagnosticArray) -> None:
        self._health_ns = messages.stamp_ns(message)
        for status in message.status:
            name = status.name.removeprefix("localizer: ")
            self._health[name] = {entry.key: entry.value for entry in status.values}


@pytest.fixture
def clock_beside(ros_environment: None) -> Iterator[Callable[[Recorder], PatientClock]]:
    """Makes the clock of a recorder."""
    opened: list[PatientClock] = []

    def make(recorder: Recorder) -> PatientClock:
        opened.append(PatientClock(recorder))
        return opened[-1]

    yield make
    for each in opened:
        each.close()


def test_replay_of_what_was_recorded_is_what_was_published(
    processes: Any,
    clock_beside: Callable[[Recorder], PatientClock],
    patiently: Callable[..., None],
) -> None:
    """Stamped wheels, late fixes; started by the first fix of the right frame, which both hear.

    Localizer and recorder have heard the robot's fixes by then, of another frame.
    """
    faults = processes.folder / "faults.yaml"
    faults.write_text(
        f"- {{fault: wrong_frame, topic: lrf_pose, start: 0.0, duration: {MEETING_S}, "
        "frame: elsewhere}\n"
        "- {fault: delay, topic: lrf_pose, start: 0.0, size: 0.3, rate: 0.5}\n"
    )
    live, again = processes.folder / "live", processes.folder / "again"
    with Recorder(live, RECORDED, use_sim_time=True) as recorder:
        localizer = processes.start(
            "localizer", "--ros-args", *LOCALIZER, "-p", "use_sim_time:=true"
        )
        robot = processes.start(
            "fake_robot", "--ros-args", "-p", "use_sim_time:=true", "-p", "path:=figure_eight",
            "-p", f"faults_file:={faults}",
        )  # fmt: skip
        clock = clock_beside(recorder)
        patiently(clock.found_by_all, "robot and localizer")
        patiently(clock.go_on_until_met, "all to hear the robot")
        assert clock.now_ns < MEETING_S * S, "the robot was heard too late"
        patiently(lambda: clock.go_on() or recorder.counts["/odom"] > COMPARED + 3, "odom", 240.0)
        processes.stop(localizer)
        processes.stop(robot)
    replayed = processes.run("replay", live, again, *LOCALIZER)
    assert replayed.returncode == 0, replayed.stderr

    published, computed = numbers(live), numbers(again)
    stamps = sorted(published)[:COMPARED]  # what closed the last may not have been recorded
    assert len(stamps) == COMPARED
    assert set(np.diff(stamps)) == {375_000_000}
    assert stamps[0] == min(computed), "both start with the same fix"
    for stamp in stamps:
        assert published[stamp] == computed[stamp], f"odom at {stamp} ns"
