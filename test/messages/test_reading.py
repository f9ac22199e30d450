# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""What messages mean, and what is refused in them."""

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from localizers import make_parameters

from fnn_ekf_ros import messages
from fnn_ekf_ros.core.arrays import FloatArray
from fnn_ekf_ros.timeline.events import (
    CompassYaw,
    PassedOver,
    PoseFix,
    PoseReset,
    Rejected,
    Sensor,
    Wheel,
    WheelCount,
)

STAMP_NS = 1_700_000_000_987_654_321


def header(frame: str = "map") -> Any:
    stamp = SimpleNamespace(sec=STAMP_NS // 10**9, nanosec=STAMP_NS % 10**9)
    return SimpleNamespace(stamp=stamp, frame_id=frame)


def quaternion(x: float, y: float, z: float, w: float) -> Any:
    return SimpleNamespace(x=x, y=y, z=z, w=w)


def turned(yaw: float) -> Any:
    return quaternion(0.0, 0.0, math.sin(0.5 * yaw), math.cos(0.5 * yaw))


def pose_message(
    x: float = 1.0, y: float = 2.0, orientation: Any = None, frame: str = "map",
    covariance: Any = None,
) -> Any:  # fmt: skip
    pose = SimpleNamespace(
        position=SimpleNamespace(x=x, y=y, z=0.0),
        orientation=turned(0.5) if orientation is None else orientation,
    )
    full = np.zeros(36) if covariance is None else covariance
    return SimpleNamespace(header=header(frame), pose=SimpleNamespace(pose=pose, covariance=full))


def imu(orientation: Any, first: float = 0.0, frame: str = "imu_link") -> Any:
    covariance = np.zeros(9)
    covariance[0] = first
    return SimpleNamespace(
        header=header(frame), orientation=orientation, orientation_covariance=covariance
    )


def joints(names: list[str], positions: list[float]) -> Any:
    return SimpleNamespace(header=header(""), name=names, position=np.array(positions))


def refused(found: Any, sensor: Sensor) -> str:
    """Return why an input was refused."""
    assert isinstance(found, Rejected)
    assert found.sensor is sensor
    assert "\n" not in found.reason
    return found.reason


BAD_QUATERNIONS = [
    (0.0, 0.0, 0.0, 0.0),
    (math.nan, 0.0, 0.0, 1.0),
    (0.0, 0.0, math.inf, 1.0),
    (1.0, 1.0, 1.0, 1.0),
    (0.0, 0.0, 0.0, 0.5),
    (0.0, 0.0, 0.0, 1.2),
    (1e300, 1e300, 0.0, 0.0),
]


@pytest.mark.parametrize("topic", ["left_ticks", "right_ticks"])
@pytest.mark.parametrize("data", [0, -(2**31), 2**31 - 1, np.int32(7)])
def test_ticks_are_stamped_on_arrival(topic: str, data: int) -> None:
    found = messages.read_input(topic, SimpleNamespace(data=data), 123, make_parameters())
    wheel = Wheel.LEFT if topic == "left_ticks" else Wheel.RIGHT
    assert found == [WheelCount(123, wheel, int(data))]


def test_joints_are_found_by_name_and_carry_their_stamp() -> None:
    parameters = make_parameters(encoder_source="joint_states", left_joint="l", right_joint="r")

    def read(names: list[str], positions: list[float]) -> Any:
        return messages.read_input("joint_states", joints(names, positions), 1, parameters)

    left, right = WheelCount(STAMP_NS, Wheel.LEFT, 1.5), WheelCount(STAMP_NS, Wheel.RIGHT, -2.5)
    assert read(["l", "r"], [1.5, -2.5]) == [left, right]
    assert read(["arm", "r", "l"], [9.0, -2.5, 1.5]) == [left, right]
    assert read(["r", "arm"], [-2.5, 9.0]) == [right]


@pytest.mark.parametrize(
    ("names", "listed"),
    [
        (["arm"], "'arm'"),
        ([], "(none)"),
        (["a\nb", *16 * "c"], r"'a\nb', " + 15 * "'c', " + "..."),
    ],
)
def test_joints_that_are_none_of_the_wheels_are_listed(names: list[str], listed: str) -> None:
    parameters = make_parameters(encoder_source="joint_states", left_joint="l", right_joint="r")
    found = messages.read_input("joint_states", joints(names, [0.0] * len(names)), 1, parameters)
    assert found == PassedOver(
        Sensor.ENCODERS,
        f"joint_states has the joints {listed}, expected 'l' (left_joint) and 'r' (right_joint)",
    )


@pytest.mark.parametrize(
    ("names", "positions", "words"),
    [
        (["left_wheel_joint"], [], "no position for 'left_wheel_joint'"),
        (["right_wheel_joint", "left_wheel_joint"], [1.0], "no position for 'left_wheel_joint'"),
        (["left_wheel_joint"], [math.nan], "'left_wheel_joint' is at nan rad"),
        (["right_wheel_joint"], [-math.inf], "'right_wheel_joint' is at -inf rad"),
        (["right_wheel_joint"], [1e9], "'right_wheel_joint' is at 1e+09 rad"),
    ],
)
def test_joints_without_a_usable_position_are_refused(
    names: list[str], positions: list[float], words: str
) -> None:
    parameters = make_parameters(encoder_source="joint_states")
    found = messages.read_input("joint_states", joints(names, positions), 1, parameters)
    assert words in refused(found, Sensor.ENCODERS)


@settings(derandomize=True, deadline=None, max_examples=100)
@given(yaw=st.floats(-3.14, 3.14), scale=st.floats(0.91, 1.09), flip=st.booleans())
def test_yaw_of_a_quaternion_of_about_unit_length(yaw: float, scale: float, flip: bool) -> None:
    q = turned(yaw)
    factor = -scale if flip else scale
    found = messages.yaw_of(quaternion(0.0, 0.0, factor * q.z, factor * q.w))
    assert found == pytest.approx(yaw, abs=1e-9)


@settings(derandomize=True, deadline=None, max_examples=100)
@given(yaw=st.floats(-3.1, 3.1), pitch=st.floats(-1.4, 1.4), roll=st.floats(-3.1, 3.1))
def test_yaw_of_a_tilted_robot(yaw: float, pitch: float, roll: float) -> None:
    """Yaw, pitch, roll about z, y, x in turn (REP-103)."""
    (cy, sy), (cp, sp), (cr, sr) = (
        (math.cos(0.5 * a), math.sin(0.5 * a)) for a in (yaw, pitch, roll)
    )
    q = quaternion(
        sr * cp * cy - cr * sp * sy, cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy, cr * cp * cy + sr * sp * sy,
    )  # fmt: skip
    assert messages.yaw_of(q) == pytest.approx(yaw, abs=1e-8)


@pytest.mark.parametrize("q", BAD_QUATERNIONS)
def test_what_is_no_rotation_has_no_yaw(q: Any) -> None:
    assert messages.yaw_of(quaternion(*q)) is None
    found = messages.read_input("compass", imu(quaternion(*q)), 1, make_parameters())
    assert "no unit quaternion" in refused(found, Sensor.COMPASS)


@pytest.mark.parametrize("frame", ["", "imu_link", "somewhere"])
def test_the_compass_frame_is_not_checked(frame: str) -> None:
    parameters = make_parameters(compass_offset=1.0)  # added later, not here
    (found,) = messages.read_input("compass", imu(turned(-2.5), frame=frame), 1, parameters)
    assert isinstance(found, CompassYaw)
    assert found.stamp_ns == STAMP_NS
    assert found.yaw == pytest.approx(-2.5)


def test_the_delay_of_a_sensor_is_subtracted_from_its_stamps() -> None:
    parameters = make_parameters(compass_delay=0.25, lrf_pose_delay=-0.5)
    (yaw,) = messages.read_input("compass", imu(turned(1.0)), 1, parameters)
    assert yaw.stamp_ns == STAMP_NS - 250_000_000
    (fix,) = messages.read_input("lrf_pose", pose_message(), 1, parameters)
    assert fix.stamp_ns == STAMP_NS + 500_000_000
    (reset,) = messages.read_input("initialpose", pose_message(), STAMP_NS, parameters)
    assert reset.stamp_ns == STAMP_NS  # a command, not a reading of the sensor


def test_an_imu_without_an_orientation_is_no_compass() -> None:
    nothing = quaternion(0.0, 0.0, 0.0, 0.0)
    for orientation in (nothing, turned(1.0)):
        found = messages.read_input("compass", imu(orientation, -1.0), 1, make_parameters())
        assert isinstance(found, PassedOver)
        assert found.sensor is Sensor.COMPASS
        assert "has no orientation" in found.reason


@pytest.mark.parametrize("frame", ["x" * 10**6, "a\nb", "\x00", "\x1b[2J", "\u2028", "'"])
def test_any_frame_is_named_in_one_short_line(frame: str) -> None:
    found = messages.read_input("lrf_pose", pose_message(frame=frame), 1, make_parameters())
    reason = refused(found, Sensor.LRF_POSE)
    assert reason.isprintable()
    assert len(reason) < 150
    assert reason.endswith(", expected 'map' (frame_id)")


@pytest.mark.parametrize("topic", ["lrf_pose", "initialpose"])
@pytest.mark.parametrize("frame", ["", "odom", "/map", "Map", "map "])
def test_poses_in_foreign_frames_are_quarantined(topic: str, frame: str) -> None:
    found = messages.read_input(topic, pose_message(frame=frame), 1, make_parameters())
    expected = f"{topic} in frame '{frame}', expected 'map' (frame_id)"
    assert refused(found, Sensor.LRF_POSE) == expected
    taken = messages.read_input(
        topic, pose_message(frame="here"), 1, make_parameters(frame_id="here")
    )
    assert isinstance(taken, list)
    assert len(taken) == 1


@pytest.mark.parametrize("topic", ["lrf_pose", "initialpose"])
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 1e9, -1e8])
@pytest.mark.parametrize("axis", ["x", "y"])
def test_positions_that_are_none_are_quarantined(topic: str, value: float, axis: str) -> None:
    found = messages.read_input(topic, pose_message(**{axis: value}), 1, make_parameters())
    assert f"{value:g}" in refused(found, Sensor.LRF_POSE)


def test_a_fix() -> None:
    covariance = np.arange(36.0)
    message = pose_message(3.0, -4.0, turned(2.0), covariance=covariance)
    (found,) = messages.read_input("lrf_pose", message, 1, make_parameters())
    assert isinstance(found, PoseFix)
    assert found.stamp_ns == STAMP_NS
    np.testing.assert_allclose(found.pose, [3.0, -4.0, 2.0])
    np.testing.assert_array_equal(found.covariance, [[0, 1, 5], [6, 7, 11], [30, 31, 35]])


@pytest.mark.parametrize("q", BAD_QUATERNIONS)
def test_a_fix_needs_a_yaw_only_where_it_is_used(q: Any) -> None:
    message = pose_message(orientation=quaternion(*q))
    (found,) = messages.read_input("lrf_pose", message, 1, make_parameters())
    assert isinstance(found, PoseFix)
    np.testing.assert_array_equal(found.pose[:2], [1.0, 2.0])
    with_yaw = messages.read_input("lrf_pose", message, 1, make_parameters(lrf_use_yaw=True))
    assert "no unit quaternion" in refused(with_yaw, Sensor.LRF_POSE)
    reset = messages.read_input("initialpose", message, 1, make_parameters())
    assert "no unit quaternion" in refused(reset, Sensor.LRF_POSE)


def planar(block: Any) -> FloatArray:
    full = np.zeros((6, 6))
    full[np.ix_([0, 1, 5], [0, 1, 5])] = block
    return full.ravel()


NO_COVARIANCES = [
    np.zeros((3, 3)),
    np.diag([1.0, 0.0, 1.0]),
    np.diag([1.0, -1.0, 1.0]),
    np.diag([1.0, math.nan, 1.0]),
    np.diag([1.0, math.inf, 1.0]),
    np.diag([1e13, 1.0, 1.0]),
    np.diag([1e-13, 1.0, 1.0]),
    np.array([[1.0, 2.0, 0.0], [2.0, 1.0, 0.0], [0.0, 0.0, 1.0]]),
    np.array([[0.25, 1.7e308, 0.0], [1.7e308, 0.25, 0.0], [0.0, 0.0, 1.0]]),
    np.array([[0.25, -1.7e308, 0.0], [1.7e308, 0.25, 0.0], [0.0, 0.0, 1.0]]),
]


@pytest.mark.parametrize("block", NO_COVARIANCES)
def test_a_reported_covariance_must_be_one_where_it_is_used(block: FloatArray) -> None:
    message = pose_message(covariance=planar(block))
    using = make_parameters(lrf_use_message_covariance=True)
    reason = refused(messages.read_input("lrf_pose", message, 1, using), Sensor.LRF_POSE)
    assert "lrf_use_message_covariance is true" in reason
    assert isinstance(messages.read_input("lrf_pose", message, 1, make_parameters()), list)


@pytest.mark.parametrize("yaw_variance", [0.0, -1.0, math.nan, math.inf])
def test_the_yaw_of_a_reported_covariance_matters_only_where_it_is_used(
    yaw_variance: float,
) -> None:
    message = pose_message(covariance=planar(np.diag([0.1, 0.2, yaw_variance])))
    without = make_parameters(lrf_use_message_covariance=True)
    assert isinstance(messages.read_input("lrf_pose", message, 1, without), list)
    with_yaw = make_parameters(lrf_use_message_covariance=True, lrf_use_yaw=True)
    refused(messages.read_input("lrf_pose", message, 1, with_yaw), Sensor.LRF_POSE)


def test_a_set_pose() -> None:
    message = pose_message(3.0, -4.0, turned(-1.0), covariance=planar(np.diag([0.25, 0.3, 0.07])))
    for now_ns, stamp_ns in ((STAMP_NS + 7, STAMP_NS), (STAMP_NS - 7, STAMP_NS - 7)):
        (found,) = messages.read_input("initialpose", message, now_ns, make_parameters())
        assert isinstance(found, PoseReset)
        assert found.stamp_ns == stamp_ns  # RViz on another machine may be ahead
        np.testing.assert_allclose(found.pose, [3.0, -4.0, -1.0])
        np.testing.assert_array_equal(found.covariance, np.diag([0.25, 0.3, 0.07]))
    message.header.stamp = SimpleNamespace(sec=0, nanosec=0)
    (found,) = messages.read_input("initialpose", message, 123, make_parameters())
    assert isinstance(found, PoseReset)
    assert found.stamp_ns == 123


def test_a_set_pose_without_a_covariance_gets_the_parameters() -> None:
    parameters = make_parameters(initial_pose_std=[0.3, 0.2, 0.1])
    (found,) = messages.read_input("initialpose", pose_message(), STAMP_NS, parameters)
    assert isinstance(found, PoseReset)
    np.testing.assert_allclose(found.covariance, np.diag([0.09, 0.04, 0.01]))


@pytest.mark.parametrize(
    "block",
    [
        *NO_COVARIANCES[2:],
        np.diag([math.inf, 1.0, 1.0]),
        np.diag([1e18] * 3),  # "unknown": makes two yaws of one period one equation
        np.diag([1e300] * 3),
        np.diag([1e-320] * 3),
        np.array([[1.0, 0.9, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]),
    ],
)
def test_a_set_pose_with_a_covariance_that_is_none_is_quarantined(block: FloatArray) -> None:
    message = pose_message(covariance=planar(block))
    found = messages.read_input("initialpose", message, STAMP_NS, make_parameters())
    assert "initialpose has the covariance" in refused(found, Sensor.LRF_POSE)


def test_the_localizer_listens_to_one_source_of_counts() -> None:
    others = {"compass", "lrf_pose", "initialpose"}
    by_ticks = messages.input_topics(make_parameters())
    assert set(by_ticks) == others | {"left_ticks", "right_ticks"}
    by_joints = messages.input_topics(make_parameters(encoder_source="joint_states"))
    assert set(by_joints) == others | {"joint_states"}
    assert set(by_ticks[-2:]) == {"left_ticks", "right_ticks"}  # they close periods: last
    assert by_joints[-1] == "joint_states"
    assert set(messages.INPUT_TYPES) == others | {"left_ticks", "right_ticks", "joint_states"}
