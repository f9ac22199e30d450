# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The simulated robot: exact truth, honest encoders, slip and noise of the size they are set to."""

import math
from typing import Any

import numpy as np
import pytest
from localizers import START_NS, as_object

from fnn_ekf_ros import messages
from fnn_ekf_ros.core.angles import wrap_angle
from fnn_ekf_ros.core.arrays import FloatArray
from fnn_ekf_ros.core.motion import MotionModel, move
from fnn_ekf_ros.messages import Message
from fnn_ekf_ros.parameters.fake_robot import FakeRobotParameters
from fnn_ekf_ros.parameters.schema import build
from fnn_ekf_ros.simulation.delivery import STEP_NS, Sent
from fnn_ekf_ros.simulation.fake_robot import OUTPUT_TYPES, FakeRobot
from fnn_ekf_ros.simulation.paths import SPACING, scripted_path
from fnn_ekf_ros.simulation.robot import (
    STEP_S,
    RobotState,
    advance,
    at_rest,
    encoder_counts,
    wheel_geometry,
)

PATHS = ["square", "round", "figure_eight", "sim1", "sim2"]
QUIET: dict[str, Any] = {"slip_std": (0.0, 0.0), "wheel_speed_error": 0.0}
PERIOD_STEPS = 30


def drive(
    parameters: FakeRobotParameters, state: RobotState, command: FloatArray, steps: int, seed: int
) -> RobotState:
    rng = np.random.default_rng(seed)
    for _ in range(steps):
        state = advance(parameters, state, command, rng)
    return state


def sent_by(seconds: float, **changes: Any) -> list[tuple[int, Sent]]:
    """Return what a fake robot sends, with its time."""
    robot = FakeRobot(build(FakeRobotParameters, changes), START_NS)
    found: list[tuple[int, Sent]] = []
    while robot.stamp_ns < START_NS + seconds * 1e9:
        found += [(robot.stamp_ns, sent) for sent in robot.step()]
    return found


def plain(field: Any) -> Any:
    """Return a message as lists and numbers, which can be compared."""
    if isinstance(field, Message):
        return (field.type_name, {name: plain(value) for name, value in field.fields.items()})
    if isinstance(field, list):
        return [plain(entry) for entry in field]
    return field.tolist() if isinstance(field, np.ndarray) else field


def test_thirty_steps_are_a_period() -> None:
    assert pytest.approx(0.375) == PERIOD_STEPS * STEP_S
    assert round(STEP_S * 1e9) == STEP_NS


@pytest.mark.parametrize("direction", [1.0, -1.0])
@pytest.mark.parametrize("speed", [0.3, -0.5, 0.0])
def test_a_circle_closes(direction: float, speed: float) -> None:
    parameters = FakeRobotParameters(**QUIET)
    steps = 400
    command = np.array([speed, direction * 2.0 * math.pi / (steps * STEP_S)])
    start = np.array([1.0, -2.0, 3.0])
    half = drive(parameters, at_rest(start), command, steps // 2, 0)
    radius = speed / command[1]
    opposite = [1.0 - 2.0 * radius * math.sin(3.0), -2.0 + 2.0 * radius * math.cos(3.0)]
    np.testing.assert_allclose(half.pose[:2], opposite, atol=1e-9)
    whole = drive(parameters, half, command, steps // 2, 0)
    np.testing.assert_allclose(whole.pose, start, atol=1e-9)


def test_truth_moves_on_an_arc_whatever_the_step() -> None:
    """Thirty steps on an arc are one step thirty times as long: nothing is cut at the corners."""
    parameters = FakeRobotParameters(**QUIET)
    command = np.array([0.4, 0.9])
    driven = drive(parameters, at_rest(np.zeros(3)), command, PERIOD_STEPS, 0)
    arc = move(MotionModel.EXACT_ARC, np.zeros(3), command * 0.375).mean
    np.testing.assert_allclose(driven.pose, arc, atol=1e-12)


def test_yaw_stays_wrapped() -> None:
    parameters = FakeRobotParameters(**QUIET)
    state = at_rest(np.zeros(3))
    rng = np.random.default_rng(0)
    for _ in range(1500):
        state = advance(parameters, state, np.array([0.0, 1.0]), rng)
        assert -math.pi < state.pose[2] <= math.pi
    assert state.travel[1] == pytest.approx(0.3 * 1500 * STEP_S)


def test_a_batch_is_as_good_as_one_robot() -> None:
    parameters = FakeRobotParameters(**QUIET)
    starts = np.array([[0.0, 0.0, 0.0], [1.0, 2.0, 3.0]])
    commands = np.array([[0.3, 0.5], [-0.2, 1.0]])
    both = drive(parameters, at_rest(starts), commands, 50, 0)
    for index in (0, 1):
        one = drive(parameters, at_rest(starts[index]), commands[index], 50, 0)
        np.testing.assert_allclose(both.pose[index], one.pose, atol=1e-12)
        np.testing.assert_allclose(both.travel[index], one.travel, atol=1e-12)


def test_motor_errors_move_truth_and_wheels_alike() -> None:
    """Without slip, the wheels' distances are right in each step."""
    parameters = FakeRobotParameters(slip_std=(0.0, 0.0), wheel_speed_error=0.05)
    rng = np.random.default_rng(3)
    state = at_rest(np.zeros(3))
    reckoned = np.zeros(3)
    parts = []
    command = np.array([0.3, 0.4])
    expected = np.array([0.3 - 0.3 * 0.4, 0.3 + 0.3 * 0.4]) * STEP_S
    for _ in range(2000):
        after = advance(parameters, state, command, rng)
        ways = after.travel - state.travel
        parts.append(ways / expected - 1.0)
        control = np.array([ways.mean(), (ways[1] - ways[0]) / 0.6])
        reckoned = move(MotionModel.EXACT_ARC, reckoned, control).mean
        state = after
    np.testing.assert_allclose(state.pose[:2], reckoned[:2], atol=1e-9)
    assert abs(float(wrap_angle(state.pose[2] - reckoned[2]))) < 1e-9
    errors = np.array(parts)
    assert np.max(np.abs(errors)) <= 0.05 + 1e-9
    assert np.max(np.abs(errors)) > 0.049
    # Uniform within +-5 %: mean 0, standard deviation 0.05 / sqrt(3); 6 sigma of either.
    assert np.all(np.abs(errors.mean(axis=0)) < 6.0 * 0.05 / math.sqrt(3.0 * 2000))
    np.testing.assert_allclose(errors.std(axis=0), 0.05 / math.sqrt(3.0), rtol=6 / math.sqrt(5000))
    assert abs(np.corrcoef(errors.T)[0, 1]) < 6.0 / math.sqrt(2000)


@pytest.mark.parametrize("slip_std", [(0.02, math.radians(1.0)), (0.05, math.radians(3.0))])
@pytest.mark.parametrize("speed", [0.3, -1.0])
def test_slip_is_as_large_as_it_is_set(slip_std: tuple[float, float], speed: float) -> None:
    """Per 375 ms, within 6 sigma of what 20000 samples of it allow."""
    count = 20_000
    command = np.array([speed, 0.0])

    def end(std: tuple[float, float]) -> FloatArray:
        parameters = FakeRobotParameters(slip_std=std, wheel_speed_error=0.0)
        return drive(parameters, at_rest(np.zeros((count, 3))), command, PERIOD_STEPS, 8).pose

    way = end((slip_std[0], 0.0))[:, 0] - speed * 0.375
    turn = end(slip_std)[:, 2]
    for error, std in ((way, slip_std[0]), (turn, slip_std[1])):
        assert abs(np.mean(error)) < 6.0 * std / math.sqrt(count)
        assert abs(np.std(error) / std - 1.0) < 6.0 / math.sqrt(2.0 * count)


def test_slip_of_way_and_turn_are_independent_and_unseen_by_the_wheels() -> None:
    count = 5000
    parameters = FakeRobotParameters(slip_std=(0.05, 0.001), wheel_speed_error=0.0)
    state = drive(parameters, at_rest(np.zeros((count, 3))), np.array([0.3, 0.0]), 30, 9)
    assert abs(np.corrcoef(state.pose[:, 0], state.pose[:, 2])[0, 1]) < 6.0 / math.sqrt(count)
    np.testing.assert_allclose(state.travel, 0.3 * 0.375, rtol=1e-12)


def test_a_robot_at_rest_does_not_slip() -> None:
    state = drive(FakeRobotParameters(), at_rest(np.ones(3)), np.zeros(2), 100, 0)
    np.testing.assert_array_equal(state.pose, np.ones(3))
    np.testing.assert_array_equal(state.travel, 0.0)


def test_counts_are_whole_and_rounded_down() -> None:
    parameters = FakeRobotParameters(gear_ratio=3.0)
    per_count = 2.0 * math.pi * 0.025 / (3.0 * 500.0)
    assert wheel_geometry(parameters).meters_per_count == pytest.approx(per_count)
    travel = np.array([[0.999, 1.001], [-0.001, 12.5]]) * per_count
    counts = encoder_counts(parameters, RobotState(np.zeros((2, 3)), travel, np.zeros(2)))
    np.testing.assert_array_equal(counts, [[0, 1], [-1, 12]])


@pytest.mark.parametrize("bits", [8, 12, 16, 32])
@pytest.mark.slow
def test_counters_start_anywhere_and_wrap(bits: int) -> None:
    def counts(**changes: Any) -> list[int]:
        return [
            sent.message.fields["data"]
            for _, sent in sent_by(20.0, path="round", **changes)
            if sent.topic == "left_ticks"
        ]

    start = 2 ** (bits - 1) - 5
    straight = counts()
    wrapping = counts(encoder_bits=bits, left_start_count=start, right_start_count=-3)
    assert all(isinstance(count, int) for count in wrapping)
    assert min(straight) >= 0
    assert max(straight) > 10_000
    half = 2 ** (bits - 1)
    assert wrapping == [(start + count + half) % (2 * half) - half for count in straight]
    assert wrapping[0] != start + straight[0]  # it has wrapped


def test_joint_states_say_the_same_as_the_counters() -> None:
    sent = [entry for _, entry in sent_by(5.0, left_joint="l", right_joint="r", gear_ratio=2.0)]
    left = [s.message.fields["data"] for s in sent if s.topic == "left_ticks"]
    right = [s.message.fields["data"] for s in sent if s.topic == "right_ticks"]
    joints = [s.message.fields for s in sent if s.topic == "joint_states"]
    assert len(left) == len(right) == len(joints) == 100
    assert joints[0]["name"] == ["l", "r"]
    positions = np.array([fields["position"] for fields in joints])
    expected = np.stack([left, right], axis=-1) * 2.0 * math.pi / 1000.0
    np.testing.assert_allclose(positions, expected, atol=1e-12)


def test_joints_of_one_name_are_two_joints() -> None:
    sent = [entry for _, entry in sent_by(1.0, left_joint="j", right_joint="j")]
    joints = [s.message.fields for s in sent if s.topic == "joint_states"]
    assert {(*fields["name"], len(fields["position"])) for fields in joints} == {("j", "j", 2)}


def test_counts_are_within_one_of_the_truth() -> None:
    """Dead reckoning over the counts of a straight way, without slip."""
    parameters = FakeRobotParameters(slip_std=(0.0, 0.0), wheel_speed_error=0.05)
    state = drive(parameters, at_rest(np.zeros(3)), np.array([0.3, 0.0]), 3000, 1)
    per_count = wheel_geometry(parameters).meters_per_count
    lag = state.travel / per_count - encoder_counts(parameters, state)
    assert np.all((lag >= 0.0) & (lag < 1.0))


def test_the_same_seed_sends_the_same_and_another_seed_does_not() -> None:
    def run(seed: int) -> list[Any]:
        return [(time, s.topic, plain(s.message)) for time, s in sent_by(10.0, seed=seed)]

    first, again, other = run(4), run(4), run(5)
    assert first == again
    for topic in ("ground_truth", "compass", "lrf_pose", "left_ticks", "right_ticks"):
        assert [e for e in first if e[1] == topic] != [e for e in other if e[1] == topic]


def test_what_the_sensors_draw_does_not_change_the_drive() -> None:
    def truth(**changes: Any) -> list[Any]:
        return [plain(s.message) for _, s in sent_by(10.0, **changes) if s.topic == "ground_truth"]

    assert truth() == truth(compass_std=0.5, lrf_std=[1.0, 2.0, 3.0])


def test_messages_have_their_types_rates_and_stamps() -> None:
    sent = sent_by(30.0)
    rates = {
        "left_ticks": 20.0, "right_ticks": 20.0, "joint_states": 20.0, "compass": 8.0,
        "ground_truth": 8.0, "lrf_pose": 1.0 / 0.375,
    }  # fmt: skip
    assert set(OUTPUT_TYPES) == set(rates)
    for topic, rate in rates.items():
        own = [(time, s.message) for time, s in sent if s.topic == topic]
        assert len(own) == pytest.approx(30.0 * rate, abs=1)
        assert {message.type_name for _, message in own} == {OUTPUT_TYPES[topic]}
        for time, message in own:
            if "header" in message.fields:
                assert messages.stamp_ns(as_object(message)) == time
    fixes = [time for time, s in sent if s.topic == "lrf_pose"]
    assert {time % 375_000_000 for time in fixes} == {0}
    truth = {time for time, s in sent if s.topic == "ground_truth"}
    assert truth >= {n * 375_000_000 for n in range(9, 80)}  # truth at every period's end


@pytest.mark.slow
def test_sensors_are_as_noisy_as_they_are_set() -> None:
    sent = sent_by(110.0, lrf_std=[0.1, 0.3, 0.05], compass_std=0.2, **QUIET)
    truth = {t: messages.planar_pose(as_object(s.message)) for t, s in sent
             if s.topic == "ground_truth"}  # fmt: skip
    fixes = np.array(
        [
            messages.planar_pose(as_object(s.message)) - truth[t]
            for t, s in sent
            if s.topic == "lrf_pose"
        ]
    )
    yaws = np.array(
        [
            float(messages.yaw_of(as_object(s.message).orientation) or 0.0) - truth[t][2]
            for t, s in sent
            if s.topic == "compass"
        ]
    )
    errors = [fixes[:, 0], fixes[:, 1], wrap_angle(fixes[:, 2]), wrap_angle(yaws)]
    for error, std in zip(errors, [0.1, 0.3, 0.05, 0.2], strict=True):
        count = len(error)
        assert count > 280
        assert abs(np.mean(error)) < 6.0 * std / math.sqrt(count)
        assert abs(np.std(error) / std - 1.0) < 6.0 / math.sqrt(2.0 * count)


@pytest.mark.parametrize("name", PATHS)
def test_paths_are_closed_and_evenly_spaced(name: str) -> None:
    path = scripted_path(name)
    gaps = np.linalg.norm(np.diff(path.points, axis=0, append=path.points[:1]), axis=1)
    assert np.all(gaps < 1.05 * SPACING)
    assert np.median(gaps) == pytest.approx(SPACING, rel=0.01)
    length = len(path.points) * SPACING
    np.testing.assert_array_equal(path.at(np.array(0.0)), path.at(np.array(length + 1e-9)))
    start = path.start()
    np.testing.assert_array_equal(start[:2], path.points[0])


@pytest.mark.parametrize("name", PATHS)
@pytest.mark.slow
def test_the_driver_keeps_to_the_path(name: str) -> None:
    path = scripted_path(name)
    truth = np.array(
        [
            messages.planar_pose(as_object(s.message))[:2]
            for _, s in sent_by(56.0, path=name, speed=0.5)
            if s.topic == "ground_truth"
        ]
    )
    distance = np.linalg.norm(truth[:, None] - path.points[None, ::5], axis=-1)
    assert np.max(np.min(distance, axis=1)) < 0.5
    assert np.max(np.min(distance, axis=0)) < 0.5  # and has been everywhere along it


def test_an_unknown_path_is_refused() -> None:
    with pytest.raises(ValueError, match="'triangle'"):
        scripted_path("triangle")


def test_it_follows_commands() -> None:
    robot = FakeRobot(build(FakeRobotParameters, {"path": "cmd_vel", **QUIET}), START_NS)
    for _ in range(80):
        robot.step()
    robot.set_command(0.5, 0.0)
    last = None
    for _ in range(80):
        for sent in robot.step():
            last = sent if sent.topic == "ground_truth" else last
    assert last is not None
    pose = messages.planar_pose(as_object(last.message))
    np.testing.assert_allclose(pose, [0.5, 0.0, 0.0], atol=1e-9)
    assert as_object(last.message).twist.twist.linear.x == 0.5


@pytest.mark.parametrize(("start", "stamp"), [(0, 0), (1, STEP_NS), (STEP_NS, STEP_NS)])
def test_it_starts_on_a_step(start: int, stamp: int) -> None:
    assert FakeRobot(FakeRobotParameters(), start).stamp_ns == stamp
