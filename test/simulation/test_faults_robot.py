# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Faults of the robot and its encoders."""

import math

import numpy as np
import pytest
from fault_drives import QUIET, Heard, counts, drive, off, on, pose, same

from fnn_ekf_ros.core.angles import wrap_angle
from fnn_ekf_ros.core.arrays import FloatArray
from fnn_ekf_ros.parameters.fake_robot import FakeRobotParameters
from fnn_ekf_ros.parameters.faults import (
    COUNTERS,
    JOINTS,
    ClockJump,
    Fault,
    Kidnap,
    SilentWheel,
    Slip,
    StuckWheel,
    TickGlitch,
    TickReset,
    UnequalWheels,
)
from fnn_ekf_ros.simulation.fake_robot import FakeRobot

# The robot.


@pytest.mark.slow
def test_a_slipping_robot_slips_by_the_factor_and_the_ticks_do_not_see_it() -> None:
    """On a straight command the change of yaw per period has the std that is asked for."""

    def turns(*faults: Fault) -> FloatArray:
        parameters = FakeRobotParameters(
            wheel_speed_error=0.0, slip_std=(0.001, 0.01), path="cmd_vel"
        )
        robot = FakeRobot(parameters, 0, faults)
        robot.set_command(0.3, 0.0)
        truth, ticks = [], []
        for _ in range(30 * 200):
            for sent in robot.step():
                if sent.topic == "ground_truth":
                    truth.append(pose(Heard(0.0, sent.topic, sent.message))[2])
                if sent.topic == "left_ticks":
                    ticks.append(sent.message.fields["data"])
        assert ticks[-1] == pytest.approx(0.3 * 75.0 / (math.pi * 0.05 / 500.0), abs=40)
        return np.asarray(wrap_angle(np.diff(truth[2::3])))  # truth comes three times a period

    usual = turns()
    thrice = turns(Slip(start=37.5, duration=30.0, factor=3.0))
    expected = usual * np.where((np.arange(199) >= 99) & (np.arange(199) < 179), 3.0, 1.0)
    differs = np.abs(thrice - expected) > 1e-12
    # Periods 98 and 178 hold its first step and the first one after it.
    assert set(np.flatnonzero(differs)) <= {98, 178}
    given = turns(Slip(start=0.0, std=(0.0, 0.05)))
    assert np.std(given) == pytest.approx(0.05, rel=6.0 / math.sqrt(2.0 * 200))


def test_a_wheel_of_another_radius_turns_the_robot_and_not_the_ticks() -> None:
    parameters = FakeRobotParameters(**QUIET, path="cmd_vel")
    robot = FakeRobot(parameters, 0, [UnequalWheels(start=0.0, wheel="right", factor=1.1)])
    robot.set_command(0.3, 0.0)
    sent = [sent for _ in range(800) for sent in robot.step()]
    truth = [s.message for s in sent if s.topic == "ground_truth"][-1]
    # Ways of 3 m and 3.3 m on wheels 0.6 m apart turn by 0.5 rad.
    turn, way = 0.5, 3.15
    radius = way / turn
    expected = [radius * math.sin(turn), radius * (1.0 - math.cos(turn)), turn]
    np.testing.assert_allclose(pose(Heard(0, "ground_truth", truth)), expected, atol=1e-9)
    left, right = ([s.message.fields["data"] for s in sent if s.topic == t] for t in COUNTERS)
    assert left == right


@pytest.mark.slow
def test_a_kidnapped_robot_is_elsewhere_at_once_and_its_driver_brings_it_back() -> None:
    move = (2.0, -1.0, 3.0)
    fault = Kidnap(start=4.0, move=move)
    without, with_it = drive(40.0, **QUIET), drive(40.0, [fault], **QUIET)
    truth = [on(run, "ground_truth") for run in (without, with_it)]
    at = next(i for i, e in enumerate(truth[0]) if e.time >= 4.0)
    np.testing.assert_array_equal(off(truth[1][:at], truth[0][:at]), 0.0)
    np.testing.assert_allclose(off(truth[1], truth[0])[at], move, atol=1e-9)
    # No leap in the counts: a wheel turns by no more than 0.3 + 0.3 * 1.5 m/s.
    most = 0.75 * 0.05 / (math.pi * 0.05 / 500.0) + 1
    for topic in COUNTERS:
        assert np.max(np.abs(np.diff(counts(with_it, topic)))) <= most
    square = np.array([pose(e)[:2] for e in truth[1][-10:]])
    outside = np.maximum(np.abs(square - 1.5) - 1.5, 0.0)
    assert np.max(outside) < 0.3  # back on the square of 3 m


def test_the_yaw_of_a_kidnapped_robot_is_wrapped() -> None:
    truth = on(drive(5.0, [Kidnap(start=4.0, move=(0.0, 0.0, 5.0))], **QUIET), "ground_truth")
    moved = next(e for e in truth if e.time >= 4.0)
    assert pose(moved)[2] == pytest.approx(5.0 - math.tau, abs=1e-6)


def test_what_happens_once_at_the_start_happens() -> None:
    heard = drive(
        1.0,
        [
            Kidnap(start=0.0, move=(7.0, 0.0, 0.0)),
            TickReset(start=0.0, wheel="left", count=500),
            TickGlitch(start=0.0, wheel="right", size=9000),
            ClockJump(start=0.0, size=60.0),
        ],
    )
    assert pose(on(heard, "ground_truth")[0])[0] > 6.9
    assert counts(heard)[0] == 500
    assert counts(heard, "right_ticks")[0] >= 9000 > max(counts(heard, "right_ticks")[1:])
    assert on(heard, "compass")[0].stamp > 60.0


# The encoders.


@pytest.mark.parametrize("wheel", ["left", "right", "both"])
def test_counts_of_a_stuck_wheel_freeze_and_go_on_from_there(wheel: str) -> None:
    without = drive(9.0)
    with_it = drive(9.0, [StuckWheel(start=4.0, duration=2.0, wheel=wheel)])
    assert same(on(without, "ground_truth"), on(with_it, "ground_truth"))
    times = [e.time for e in on(without, "left_ticks")]
    stuck = [i for i, time in enumerate(times) if 4.0 <= time < 6.0]
    for side, topic in enumerate(COUNTERS):
        true, said = np.array(counts(without, topic)), np.array(counts(with_it, topic))
        steps = np.diff(true, prepend=0)
        if wheel in ("both", topic.removesuffix("_ticks")):
            steps[stuck] = 0
        np.testing.assert_array_equal(np.diff(said, prepend=0), steps)
        joints = [e.fields["position"][side] for e in on(with_it, "joint_states")]
        np.testing.assert_allclose(joints, said * math.tau / 500.0, atol=1e-9)


def test_a_silent_wheel_says_nothing() -> None:
    heard = drive(9.0, [SilentWheel(start=4.0, duration=2.0, wheel="left")])
    assert not [e for e in on(heard, "left_ticks") if 4.0 <= e.time < 6.0]
    assert len(on(heard, "left_ticks")) == 180 - 40
    assert len(on(heard, "right_ticks")) == len(on(heard, "joint_states")) == 180
    for entry in on(heard, "joint_states"):
        silent = 4.0 <= entry.time < 6.0
        assert entry.fields["name"] == ["left_wheel_joint", "right_wheel_joint"][silent:]
        assert len(entry.fields["position"]) == 2 - silent
    both = drive(9.0, [SilentWheel(start=4.0, duration=2.0, wheel="both")])
    assert [len(on(both, topic)) for topic in (*COUNTERS, *JOINTS)] == [140, 140, 140]


@pytest.mark.parametrize("count", [0, -1234])
def test_a_reset_counter_counts_on_from_where_it_jumped_to(count: int) -> None:
    fault = TickReset(start=4.0, wheel="right", count=count)
    without, with_it = (drive(9.0, f, right_start_count=77) for f in ([], [fault]))
    assert counts(without) == counts(with_it)
    true, said = (np.array(counts(run, "right_ticks")) for run in (without, with_it))
    at = next(i for i, e in enumerate(on(without, "right_ticks")) if e.time >= 4.0)
    np.testing.assert_array_equal(said[:at], true[:at])
    assert said[at] == count
    np.testing.assert_array_equal(said[at:] - count, true[at:] - true[at])
    angle = on(with_it, "joint_states")[at].fields["position"][1]
    assert angle == pytest.approx(count * math.tau / 500.0)


def test_a_glitch_is_one_reading() -> None:
    fault = TickGlitch(start=4.0, wheel="left", size=-3000)
    without, with_it = drive(9.0), drive(9.0, [fault])
    wrong = np.array(counts(with_it)) - np.array(counts(without))
    times = np.array([e.time for e in on(without, "left_ticks")])
    np.testing.assert_array_equal(wrong[wrong != 0], [-3000])
    assert 4.0 <= times[wrong != 0][0] < 4.05
    assert counts(without, "right_ticks") == counts(with_it, "right_ticks")


def test_faulty_counters_wrap_as_healthy_ones() -> None:
    faults = [TickReset(start=1.0, wheel="both", count=2**31 - 1), TickGlitch(2.0, wheel="left")]
    heard = drive(5.0, faults, encoder_bits=8)
    for topic in COUNTERS:
        assert max(counts(heard, topic)) < 128
        assert min(counts(heard, topic)) >= -128
