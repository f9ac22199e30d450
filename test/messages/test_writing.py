# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""What is written into messages."""

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from localizers import Arrival, as_object, feed, make_localizer, make_parameters, simulated

from fnn_ekf_ros import messages
from fnn_ekf_ros.messages import NOISE_FIELDS
from fnn_ekf_ros.timeline.events import CompassYaw, Estimate, Level, PoseFix, Status

STAMP_NS = 1_700_000_000_987_654_321


@pytest.fixture(scope="module")
def estimates() -> list[Estimate]:
    """Estimates of a run of a filter that learns; the first is the start."""
    outputs = feed(make_localizer(adaptation="r"), simulated(11, 30.0).arrivals)
    return [output.estimate for output in outputs if output.estimate is not None]


@pytest.mark.slow
def test_odometry_carries_pose_twist_and_their_covariances(estimates: list[Estimate]) -> None:
    estimate = estimates[-1]
    made = messages.odometry(estimate, "map", "base_link")
    assert made.type_name == "nav_msgs/msg/Odometry"
    message = as_object(made)
    assert messages.stamp_ns(message) == estimate.stamp_ns
    assert (message.header.frame_id, message.child_frame_id) == ("map", "base_link")
    np.testing.assert_allclose(messages.planar_pose(message), estimate.state.mean, atol=1e-12)
    twist = message.twist.twist
    assert (twist.linear.x, twist.angular.z) == tuple(estimate.twist)
    zeros = (twist.linear.y, twist.linear.z, twist.angular.x, twist.angular.y)
    assert zeros == (0.0, 0.0, 0.0, 0.0)

    P = estimate.state.covariance
    expected = np.zeros((6, 6))
    for i, a in enumerate((0, 1, 5)):  # x, y, z, roll, pitch, yaw: row by row
        for j, b in enumerate((0, 1, 5)):
            expected[a, b] = P[i, j]
    expected[2, 2] = expected[3, 3] = expected[4, 4] = 1e-9
    assert np.shape(message.pose.covariance) == (36,)
    np.testing.assert_array_equal(np.reshape(message.pose.covariance, (6, 6)), expected)
    assert np.abs(P[0, 2]) > 1e-6  # or the test would not see a wrong layout
    linear, angular = estimate.twist_variance
    np.testing.assert_array_equal(
        np.reshape(message.twist.covariance, (6, 6)),
        np.diag([linear, 1e-9, 1e-9, 1e-9, 1e-9, angular]),
    )


def test_noise_numbers_are_as_many_as_their_names(estimates: list[Estimate]) -> None:
    assert len(set(NOISE_FIELDS)) == len(NOISE_FIELDS)
    for estimate in (estimates[0], estimates[-1]):
        made = messages.noise(estimate)
        assert made.type_name == "std_msgs/msg/Float64MultiArray"
        message = as_object(made)
        (dimension,) = message.layout.dim
        assert dimension.label.split(",") == list(NOISE_FIELDS)
        assert len(message.data) == dimension.size == dimension.stride == len(NOISE_FIELDS)
        assert message.layout.data_offset == 0
        assert np.all(np.isfinite(message.data))


def test_noise_numbers_are_what_their_names_say(estimates: list[Estimate]) -> None:
    estimate = estimates[-1]
    assert estimate.result is not None
    assert estimates[0].result is None
    values = dict(zip(NOISE_FIELDS, as_object(messages.noise(estimate)).data, strict=True))
    state, result = estimate.state, estimate.result
    rows = ["x", "y", "compass_yaw", "lrf_yaw"]
    for index, row in enumerate(rows):
        assert values[f"measurement_noise_{row}"] == state.measurement_noise[index]
        assert values[f"innovation_{row}"] == result.innovation[index]
        assert values[f"innovation_variance_{row}"] == result.innovation_variance[index]
        assert values[f"mismatch_{row}"] == result.mismatch[index]
        for rule, name in enumerate(("increase", "maintain", "decrease")):
            assert values[f"firing_{name}_{row}"] == result.firing_strength[rule, index]
    assert values["process_noise_forward"] == state.process_noise[0]
    assert values["process_noise_heading"] == state.process_noise[1]
    assert values["nis"] == result.nis
    assert values["degrees_of_freedom"] == 5.0  # of a fix and three readings of the compass
    first = dict(zip(NOISE_FIELDS, as_object(messages.noise(estimates[0])).data, strict=True))
    assert first["measurement_noise_x"] == pytest.approx(0.01)
    assert first["nis"] == first["innovation_x"] == 0.0


def test_noise_numbers_keep_their_places() -> None:
    """A plot selects them by the index that README names."""
    places = {
        0: "measurement_noise_x", 4: "process_noise_forward", 6: "nis", 7: "degrees_of_freedom",
        8: "innovation_x", 12: "innovation_variance_x", 16: "mismatch_x", 20: "firing_increase_x",
        31: "firing_decrease_lrf_yaw", 32: "log_scale_forward", 33: "log_scale_heading",
        34: "log_scale_position", 35: "log_scale_yaw", 36: "weight_start", 37: "weight_settled",
        38: "weight_fast", 39: "weight_slip", 40: "nis_compass", 41: "nis_lrf_pose",
        42: "rejected_compass", 43: "rejected_lrf_pose", 44: "relocated",
        45: "firing_increase_distance", 50: "firing_decrease_rotation", 51: "weight_fix_0",
        55: "weight_fix_30", 56: "weight_fix_0_yaw", 60: "weight_fix_30_yaw",
        61: "lasting_fix_std", 62: "lasting_time_constant", 63: "lasting_yaw_std",
        64: "compass_offset", 65: "compass_offset_std", 66: "compass_offset_believed",
        67: "compass_doubted",
    }  # fmt: skip
    assert {index: NOISE_FIELDS[index] for index in places} == places
    assert len(NOISE_FIELDS) == 68


def lasting_estimate(**changes: Any) -> Estimate:
    """Return the last estimate of a short run of mode joint."""
    outputs = feed(make_localizer(**changes), simulated(11, 30.0).arrivals[:300])
    return [output.estimate for output in outputs if output.estimate is not None][-1]


def test_noise_numbers_tell_what_lasts() -> None:
    estimate = lasting_estimate()
    result = estimate.result
    assert result is not None
    report = result.lasting
    assert report is not None
    known = report._replace(believed=np.array(True), offset=np.array(-1.2))
    estimate = estimate._replace(result=result._replace(lasting=known))
    data = as_object(messages.noise(estimate)).data
    np.testing.assert_array_equal(data[51:61], report.weights)
    numbers = (report.fix_std, 10.0, report.yaw_std, -1.2, report.offset_std, 1.0, 0.0)
    np.testing.assert_array_equal(data[61:], numbers)
    assert len(set(data[61:])) == 7  # or a swap would not be seen
    made = {topic: as_object(m).data for topic, m in messages.numbers(estimate).items()}
    values = dict(zip(NOISE_FIELDS, data, strict=True))
    for field, topic in messages.LASTING_TOPICS.items():
        assert made[topic] == values[field]
    without = lasting_estimate(lasting_errors=False)
    assert not np.any(as_object(messages.noise(without)).data[51:])
    assert not set(messages.numbers(without)) & set(messages.LASTING_TOPICS.values())


@pytest.mark.parametrize("mode", ["r", "q", "rq"])
@pytest.mark.slow
def test_noise_numbers_tell_what_fired(mode: str) -> None:
    outputs = feed(make_localizer(adaptation=mode), simulated(11, 30.0).arrivals)
    *_, last = (output.estimate for output in outputs if output.estimate is not None)
    data = as_object(messages.noise(last)).data
    rows, process = last.result.firing_strength, last.result.process_firing_strength
    assert (rows.shape, process.shape) == ((3, 4), (3, 2))  # the message has the rules side by side
    assert np.any(rows)
    assert np.any(process) == ("q" in mode)
    np.testing.assert_array_equal(data[45:51], np.ravel(process, order="F"))
    np.testing.assert_array_equal(data[20:32], np.ravel(rows, order="F"))
    if mode == "q":  # in the rows of x and compass yaw, too
        np.testing.assert_array_equal(data[[20, 21, 22, 26, 27, 28]], np.ravel(process, order="F"))


def test_numbers_to_plot_are_the_roots_of_the_noise_in_use(estimates: list[Estimate]) -> None:
    for estimate in (estimates[0], estimates[-1]):
        made = messages.numbers(estimate)
        assert {message.type_name for message in made.values()} == {"std_msgs/msg/Float64"}
        values = {topic: as_object(message).data for topic, message in made.items()}
        R, Q = estimate.state.measurement_noise, estimate.state.process_noise
        x, y, compass, lrf_yaw = np.sqrt(R)
        distance, rotation = np.sqrt(Q)
        expected = {
            "noise/lrf_x_std": x, "noise/lrf_y_std": y, "noise/lrf_yaw_std": lrf_yaw,
            "noise/compass_std": compass, "noise/distance_std": distance,
            "noise/rotation_std": rotation,
        }  # fmt: skip
        assert {t: v for t, v in values.items() if t.startswith("noise/")} == expected
        assert all(type(value) is float for value in values.values())
    assert len(np.unique(np.round([*R, *Q], 9))) >= 5  # or a swap would not be seen


@pytest.mark.slow
def test_a_nis_to_plot_is_per_degree_of_freedom_and_only_of_what_was_measured() -> None:
    """A compass that is silent for some periods, then fixes, then both."""
    silent = {CompassYaw: (8.0, 12.0, 18.0, 20.0), PoseFix: (14.0, 20.0)}

    def heard(now_ns: int, event: Any) -> bool:
        return sum(now_ns > s * 1e9 for s in silent.get(type(event), ())) % 2 == 0

    arrivals = [arrival for arrival in simulated(11, 25.0).arrivals if heard(*arrival)]
    outputs = feed(make_localizer(), arrivals)
    start, *later = (output.estimate for output in outputs if output.estimate is not None)
    assert not set(messages.numbers(start)) & set(messages.NIS_TOPICS)
    seen = set()
    for estimate in later:
        made = messages.numbers(estimate)
        fix, _, yaw, _ = map(bool, estimate.result.available)
        assert [topic in made for topic in ("nis/compass", "nis/lrf_pose")] == [yaw, fix]
        if yaw:
            rows = estimate.result.sensor_degrees_of_freedom[0]
            assert rows in {1, 2, 3}  # readings in the period, fewer where it falls silent
            assert as_object(made["nis/compass"]).data == estimate.result.sensor_nis[0] / rows
        if fix:
            assert as_object(made["nis/lrf_pose"]).data == estimate.result.sensor_nis[1] / 2.0
        seen.add((fix, yaw))
    assert len(seen) == 4


def test_what_is_published_with_an_estimate_is_what_is_announced(estimates: list[Estimate]) -> None:
    announced = messages.output_topics()
    assert set(announced) == {
        "odom", "~/noise", *(f"~/{topic}" for topic in messages.NUMBER_TOPICS),
    }  # fmt: skip
    published: dict[str, str] = {}
    for estimate in (*estimates, lasting_estimate()):
        made = messages.estimate_messages(estimate, "map", "base_link")
        published |= {topic: message.type_name for topic, message in made.items()}
    assert published == announced
    assert messages.absolute_name("~/noise/lrf_x_std") == "/localizer/noise/lrf_x_std"


@pytest.mark.parametrize("mode", ["none", "joint"])
@pytest.mark.slow
def test_noise_numbers_tell_what_the_gate_did(mode: str) -> None:
    """A lone compass reading that is off by 3 rad, and fixes that lie 20 m off from then on."""
    arrivals, wild_ns = [], None
    for now_ns, sent in simulated(11, 30.0).arrivals:
        event = sent
        if isinstance(sent, CompassYaw) and wild_ns is None and now_ns > 10 * 10**9:
            wild_ns, event = now_ns, sent._replace(yaw=sent.yaw + 3.0)
        if isinstance(sent, PoseFix) and now_ns > 20 * 10**9:
            event = sent._replace(pose=sent.pose + np.array([20.0, 0.0, 0.0]))
        arrivals.append(Arrival(now_ns, event))
    named = []
    for output in feed(make_localizer(adaptation=mode), arrivals):
        if output.estimate is not None and output.estimate.result is not None:
            values = as_object(messages.noise(output.estimate)).data
            named.append((output.stamp_ns, dict(zip(NOISE_FIELDS, values, strict=True))))
            assert values[40] == output.estimate.result.sensor_nis[0]
            assert values[41] == output.estimate.result.sensor_nis[1]
    compass = [(stamp, v["nis_compass"]) for stamp, v in named if v["rejected_compass"]]
    assert [stamp - wild_ns for stamp, _ in compass] == [0]
    assert compass[0][1] > 100.0
    rejected = [stamp for stamp, v in named if v["rejected_lrf_pose"]]
    moved = [stamp for stamp, v in named if v["relocated"]]
    assert len(moved) == 1
    assert rejected[0] > 20 * 10**9
    assert rejected[-1] <= moved[0] < rejected[0] + 5 * 10**9


def test_noise_numbers_tell_what_joint_adaptation_estimates() -> None:
    localizer = make_localizer(adaptation="joint", measurement_noise_std=[0.5, 0.5, 0.67])
    outputs = feed(localizer, simulated(11, 30.0).arrivals)
    first, *_, last = (output.estimate for output in outputs if output.estimate is not None)
    data = as_object(messages.noise(last)).data
    fired = last.result.joint.firing_strength
    assert fired.shape == (3, 4)
    np.testing.assert_array_equal(data[20:32], np.ravel(fired, order="F"))
    np.testing.assert_array_equal(data[32:36], last.result.joint.log_scale)
    np.testing.assert_array_equal(data[36:40], last.result.joint.weights)
    assert sum(data[36:40]) == pytest.approx(1.0)
    np.testing.assert_allclose(
        data[0:4], np.exp(data[[34, 34, 35, 35]]) * [0.25, 0.25, 0.67**2, 0.018]
    )
    np.testing.assert_allclose(data[4:6], np.exp(data[32:34]) * [0.05**2, math.radians(3.0) ** 2])
    np.testing.assert_array_equal(as_object(messages.noise(first)).data[32:], 0.0)


def test_noise_numbers_of_joint_adaptation_are_zero_in_other_modes(
    estimates: list[Estimate],
) -> None:
    for estimate in estimates:
        np.testing.assert_array_equal(as_object(messages.noise(estimate)).data[32:40], 0.0)


def test_diagnostics_names_levels_and_values() -> None:
    statuses = (
        Status("encoders", Level.ERROR, "no message yet", (("received", "0"),)),
        Status("filter", Level.OK, "running", (("NIS", "3.1"), ("adaptation", "r"))),
    )
    made = messages.diagnostics(STAMP_NS, "robot1/localizer", statuses)
    assert made.type_name == "diagnostic_msgs/msg/DiagnosticArray"
    message = as_object(made)
    assert messages.stamp_ns(message) == STAMP_NS
    assert [s.name for s in message.status] == [
        "robot1/localizer: encoders", "robot1/localizer: filter",
    ]  # fmt: skip
    assert [s.level for s in message.status] == [2, 0]
    assert message.status[0].message == "no message yet"
    assert [(v.key, v.value) for v in message.status[1].values] == [
        ("NIS", "3.1"), ("adaptation", "r"),
    ]  # fmt: skip


@pytest.mark.parametrize("yaw", [0.0, 1.0, -3.1, math.pi])
def test_yaw_there_and_back(yaw: float) -> None:
    found = messages.yaw_of(as_object(messages.quaternion(yaw)))
    assert found == pytest.approx(yaw)


def test_no_yaw_is_no_quaternion() -> None:
    assert messages.yaw_of(as_object(messages.quaternion(math.nan))) is None


@pytest.mark.parametrize("stamp", [0, 1, 999_999_999, 10**9, STAMP_NS])
def test_stamps_there_and_back(stamp: int) -> None:
    message = SimpleNamespace(header=as_object(messages.header(stamp, "map")))
    assert messages.stamp_ns(message) == stamp
    assert 0 <= message.header.stamp.nanosec < 10**9


def test_a_compass_message_can_be_read_again() -> None:
    made = as_object(messages.compass_message(STAMP_NS, "base_link", 1.25, 0.1))
    assert made.orientation_covariance[8] == pytest.approx(0.01)
    (found,) = messages.read_input("compass", made, 1, make_parameters())
    assert isinstance(found, CompassYaw)
    assert found.yaw == pytest.approx(1.25)
    unknown = as_object(messages.compass_message(STAMP_NS, "base_link", 1.25, 0.0))
    np.testing.assert_array_equal(unknown.orientation_covariance, 0.0)
    assert made.angular_velocity_covariance[0] == made.linear_acceleration_covariance[0] == -1.0
