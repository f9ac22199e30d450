"""The same result live and in replay, to the last bit."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fnn_ekf_ros import messages
from fnn_ekf_ros.bag_files import BagReader
from fnn_ekf_ros.ros.record import Recorder

pytestmark = pytest.mark.live

COMPARED = 40
"""So many odom messages are compared."""
RECORDED = {
    "/joint_states": messages.JOINT_STATES_TYPE,
    "/compass": messages.COMPASS_TYPE,
    "/lrf_pose": messages.POSE_TYPE,
    "/odom": messages.ODOMETRY_TYPE,
}
LOCALIZER = [
    "-p", "wheel_radius:=0.025", "-p", "wheel_separation:=0.6",
    "-p", "encoder_source:=joint_states", "-p", "output_delay:=2.0",
]  # fmt: skip


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


@pytest.mark.parametrize(("factor", "alone_s"), [(2.0, 14.0), (6.0, 40.0)])
def test_replay_of_what_was_recorded_is_what_was_published(
    processes: Any,
    ros_environment: None,
    patiently: Callable[..., None],
    factor: float,
    alone_s: float,
) -> None:
    """Stamped wheels, late fixes, an own clock; started by the first fix, which both hear.

    The fixes begin after a while, when localizer and recorder have long found the robot.
    """
    faults = processes.folder / "faults.yaml"
    faults.write_text(
        f"- {{fault: dropout, topic: lrf_pose, start: 0.0, duration: {alone_s}}}\n"
        "- {fault: delay, topic: lrf_pose, start: 0.0, size: 0.3, rate: 0.5}\n"
    )
    live, again = processes.folder / "live", processes.folder / "again"
    localizer = processes.start("localizer", "--ros-args", *LOCALIZER, "-p", "use_sim_time:=true")
    with Recorder(live, RECORDED, use_sim_time=True) as recorder:
        patiently(
            lambda: recorder.spin_once(0.05) or recorder.publisher_count("/odom"), "the localizer"
        )
        robot = processes.start(
            "fake_robot", "--ros-args", "-p", "publish_clock:=true", "-p", "path:=figure_eight",
            "-p", f"real_time_factor:={factor}", "-p", f"faults_file:={faults}",
        )  # fmt: skip
        patiently(
            lambda: recorder.spin_once(0.05) or recorder.counts["/odom"] > COMPARED, "odom", 120.0
        )
        processes.stop(localizer)
        processes.stop(robot)
    replayed = processes.run("replay", live, again, *LOCALIZER)
    assert replayed.returncode == 0, replayed.stderr

    published, computed = numbers(live), numbers(again)
    assert len(published) > COMPARED
    stamps = sorted(published)
    assert set(np.diff(stamps)) == {375_000_000}
    assert stamps[0] == min(computed), "both start with the same fix"
    for stamp in stamps:
        assert published[stamp] == computed[stamp], f"odom at {stamp} ns"
