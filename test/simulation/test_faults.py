# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Timelines of faults: what they leave alone, clocks that jump, any timeline at all."""

from typing import Any

import numpy as np
import pytest
from fault_drives import LASTING, START_NS, TYPESTORE, drive, off, on, plain, same
from hypothesis import given, settings
from hypothesis import strategies as st

from fnn_ekf_ros import messages
from fnn_ekf_ros.messages import Message
from fnn_ekf_ros.parameters.fake_robot import FakeRobotParameters
from fnn_ekf_ros.parameters.fault_files import faults_from
from fnn_ekf_ros.parameters.faults import (
    COUNTERS,
    FAULTS,
    GROUPS,
    BadCovariance,
    Bias,
    Burst,
    ClockJump,
    Delay,
    Dropout,
    Duplicates,
    Fault,
    Frozen,
    Kidnap,
    Misplaced,
    Noise,
    NotANumber,
    Outliers,
    Reordered,
    SilentWheel,
    Slip,
    StuckWheel,
    TickGlitch,
    TickReset,
    UnequalWheels,
    Wander,
    WrongFrame,
    WrongStamp,
    WrongUnit,
    ZeroQuaternion,
)
from fnn_ekf_ros.parameters.schema import build, fields_of
from fnn_ekf_ros.simulation.delivery import STEP_NS
from fnn_ekf_ros.simulation.fake_robot import OUTPUT_TYPES, FakeRobot

# What is not touched stays.

SENSOR_FAULTS: list[Any] = [
    Outliers(topic="lrf_pose", size=5.0, rate=0.5, **LASTING),
    Outliers(topic="compass", size=0.5, rate=0.5, **LASTING),
    Misplaced(topic="lrf_pose", place=(1.0, 2.0), rate=0.5, **LASTING),
    Bias(topic="lrf_pose", size=(1.0, 2.0, 0.3), **LASTING),
    Bias(topic="lrf_pose", size=(0.5, 0.0, 0.0), rate=0.5, **LASTING),
    Wander(topic="compass", std=0.5, **LASTING),
    Noise(topic="compass", factor=10.0, **LASTING),
    Frozen(topic="lrf_pose", **LASTING),
    Frozen(topic="left_ticks", **LASTING),
    NotANumber(topic="joint_states", **LASTING),
    ZeroQuaternion(topic="compass", **LASTING),
    WrongFrame(topic="lrf_pose", **LASTING),
    WrongUnit(topic="lrf_pose", **LASTING),
    WrongStamp(topic="compass", size=7.0, **LASTING),
    BadCovariance(topic="lrf_pose", **LASTING),
    Dropout(topic="joint_states", rate=0.5, **LASTING),
    Delay(topic="compass", size=0.3, **LASTING),
    Burst(topic="lrf_pose", **LASTING),
    Reordered(topic="right_ticks", **LASTING),
    Duplicates(topic="lrf_pose", **LASTING),
]


@pytest.mark.parametrize("fault", SENSOR_FAULTS, ids=lambda f: f"{type(f).__name__} {f.topic}")
@pytest.mark.slow
def test_other_topics_and_other_times_are_as_without_the_fault(fault: Any) -> None:
    without, with_it = drive(9.0), drive(9.0, [fault])
    assert same(
        [e for e in without if e.topic != fault.topic],
        [e for e in with_it if e.topic != fault.topic],
    )
    settled = 6.4  # what was held back has been sent
    for part in (slice(0.0, 3.999), slice(settled, 9.0)):
        inside = [
            [e for e in on(run, fault.topic) if part.start <= e.time <= part.stop]
            for run in (without, with_it)
        ]
        assert len(inside[0]) > 3
        assert same(*inside)
    assert not same(without, with_it)


@pytest.mark.parametrize(
    "fault",
    [
        StuckWheel(wheel="left", **LASTING),
        SilentWheel(wheel="left", **LASTING),
        TickReset(start=4.0, wheel="left"),
        TickGlitch(start=4.0, wheel="left"),
    ],
    ids=lambda fault: type(fault).__name__,
)
def test_faults_of_a_wheel_leave_all_else_as_it_is(fault: Fault) -> None:
    without, with_it = drive(9.0), drive(9.0, [fault])
    assert same(
        *[
            [e for e in run if e.time < 4.0 or e.topic not in ("left_ticks", "joint_states")]
            for run in (without, with_it)
        ]
    )
    right = [[e.fields["position"][-1] for e in on(r, "joint_states")] for r in (without, with_it)]
    assert right[0] == right[1]
    for topic in ("left_ticks", "joint_states"):
        assert not same(on(without, topic), on(with_it, topic))


@pytest.mark.parametrize(
    "fault",
    [Slip(start=4.0), UnequalWheels(start=4.0, wheel="left"), Kidnap(start=4.0, move=(1, 2, 0.5))],
    ids=lambda fault: type(fault).__name__,
)
def test_faults_of_the_drive_leave_the_noise_as_it_is(fault: Fault) -> None:
    without, with_it = drive(9.0), drive(9.0, [fault])
    assert same([e for e in without if e.time < 4.0], [e for e in with_it if e.time < 4.0])
    for topic in ("lrf_pose", "compass"):
        noise = []
        for run in (without, with_it):
            truth = {e.time: e for e in on(run, "ground_truth")}
            own = on(run, topic)
            noise.append(off(own, [truth[e.time] for e in own]))
        np.testing.assert_allclose(noise[0], noise[1], atol=1e-9)
    late = [[e for e in on(run, "ground_truth") if e.time > 5.0] for run in (without, with_it)]
    assert np.min(np.linalg.norm(off(*late), axis=1)) > 0.0


def test_a_further_fault_leaves_the_draws_of_the_others() -> None:
    first = Outliers(start=0.0, topic="lrf_pose", size=5.0, rate=0.5)
    one = drive(20.0, [first])
    two = drive(20.0, [first, Outliers(start=0.0, topic="compass", size=1.0, rate=0.5)])
    assert same(on(one, "lrf_pose"), on(two, "lrf_pose"))
    assert not same(on(one, "compass"), on(two, "compass"))


def test_no_two_faults_draw_the_same() -> None:
    faults = [Dropout(start=0.0, topic=topic, rate=0.5) for topic in COUNTERS]
    heard = drive(20.0, faults)
    left, right = ({e.time for e in on(heard, topic)} for topic in COUNTERS)
    assert len(left & right) < 0.75 * min(len(left), len(right))


# The clock.


@pytest.mark.parametrize("size", [30.0, -2.5, 0.001])
def test_when_the_clock_jumps_all_stamps_do_and_nothing_else(size: float) -> None:
    without, with_it = drive(9.0), drive(9.0, [ClockJump(start=4.0, size=size)])
    assert len(without) == len(with_it)
    for one, other in zip(without, with_it, strict=True):
        assert (one.time, one.topic) == (other.time, other.topic)
        kept, now = dict(one.fields), dict(other.fields)
        if "header" in kept:
            jumped = size if one.time >= 4.0 else 0.0
            assert other.stamp - one.stamp == pytest.approx(jumped, abs=1e-9)
            kept.pop("header"), now.pop("header")
        assert plain(Message("", kept)) == plain(Message("", now))


def test_the_robots_clock_jumps_and_its_time_does_not() -> None:
    faults = [ClockJump(start=1.0, size=10.0), ClockJump(start=2.0, size=-1e6)]
    robot = FakeRobot(FakeRobotParameters(), START_NS, faults)
    errors = []
    for step in range(1, 241):
        robot.step()
        assert robot.time_ns == START_NS + step * STEP_NS
        errors.append(robot.stamp_ns - robot.time_ns)
    assert errors[:79] == [0] * 79
    assert errors[79:159] == [10 * 10**9] * 80
    assert errors[159:] == [-(START_NS + 160 * STEP_NS)] * 81  # to time 0, and on from there
    robot.jump_to(0)
    assert robot.stamp_ns == 0


def test_time_that_is_set_from_outside_moves_no_fault() -> None:
    faults = [Dropout(start=2.0, duration=1.0, topic="left_ticks")]
    robot = FakeRobot(FakeRobotParameters(), START_NS, faults)
    silent = []
    for step in range(1, 401):
        if step == 100:
            robot.jump_to(robot.time_ns + 4000 * STEP_NS)
        topics = {sent.topic for sent in robot.step()}
        silent += [step] if "right_ticks" in topics and "left_ticks" not in topics else []
    assert len(silent) == 20
    assert silent[0] >= 160
    assert silent[-1] < 240


# Any timeline.


def value_of(spec: Any, default: Any) -> st.SearchStrategy[Any]:
    """Values that a key may have, its limits among them."""
    if isinstance(default, str):
        return st.sampled_from(spec.choices) if spec.choices else st.just("elsewhere")
    if isinstance(default, tuple):
        return st.tuples(*[st.floats(spec.at_least, spec.at_most)] * len(default))
    if isinstance(default, int):
        return st.integers(int(spec.at_least), int(spec.at_most))
    return st.floats(spec.at_least, spec.at_most) | st.sampled_from([spec.at_least, spec.at_most])


@st.composite
def entries(draw: st.DrawFn) -> dict[str, Any]:
    """An entry of a timeline that begins within the first seconds."""
    name = draw(st.sampled_from(sorted(FAULTS)))
    entry: dict[str, Any] = {"fault": name}
    for key, spec, default in fields_of(FAULTS[name]):
        if spec.required or draw(st.booleans()):
            entry[key] = draw(value_of(spec, default))
    entry["start"] = draw(st.floats(0.0, 3.0))
    if "duration" in entry:
        entry["duration"] = draw(st.floats(0.0125, 3.0))
    if name == "slip" and "std" in entry:
        entry.pop("factor", None)
    if name == "frozen" and entry["topic"] not in ("lrf_pose", "compass"):
        entry.pop("jitter", None)
    if name == "bias" and entry["topic"] == "compass":
        entry["size"] = (0.0, 0.0, entry["size"][2])
    return entry


def target(entry: dict[str, Any]) -> tuple[str, str]:
    return entry["fault"], entry.get("topic", "wheel or robot")


def built(field: Any) -> Any:
    if isinstance(field, Message):
        kind = TYPESTORE.types[field.type_name]
        return kind(**{name: built(value) for name, value in field.fields.items()})
    return field


@settings(max_examples=40, deadline=None, derandomize=True)
@given(st.lists(entries(), max_size=6, unique_by=target), st.sampled_from([8, 32]))
@pytest.mark.slow
def test_any_timeline_sends_messages_that_can_be_sent(
    timeline: list[dict[str, Any]], bits: int
) -> None:
    faults = faults_from(timeline)
    robot = FakeRobot(build(FakeRobotParameters, {"encoder_bits": bits}), START_NS, faults)
    truth = 0
    for _ in range(80 * 4):
        for topic, message in robot.step():
            assert message.type_name == OUTPUT_TYPES[topic]
            data = TYPESTORE.serialize_cdr(built(message), message.type_name)
            back = TYPESTORE.deserialize_cdr(data, message.type_name)
            if "header" in message.fields:
                assert 0 <= messages.stamp_ns(back) <= 2_100_000_010 * 10**9
            if topic == "ground_truth":
                truth += 1
                assert np.all(np.isfinite(messages.planar_pose(back)))
                assert messages.stamp_ns(back) == robot.stamp_ns
    assert truth == 32


@pytest.mark.slow
def test_every_fault_has_its_group_and_its_place() -> None:
    """A fault that no module knows would do nothing: each must change what is sent."""
    needed: dict[str, Any] = {
        "topic": "lrf_pose", "wheel": "left", "move": (1.0, 0.0, 0.0), "size": 0.5,
        "place": (1.0, 2.0), "std": 0.5, "time_constant": 10.0,
    }  # fmt: skip
    without = drive(6.0)
    assert sum(len(group) for group in GROUPS.values()) == len(FAULTS)
    for name, kind in FAULTS.items():
        values = {
            key: needed[key] for key, spec, _ in fields_of(kind) if spec.required and key in needed
        }
        values |= {"bias": {"size": (1.0, 1.0, 0.0)}, "burst": {"duration": 1.0},
                   "outliers": {"rate": 1.0}}.get(name, {})  # fmt: skip
        fault = build(kind, {"start": 2.0, **values})
        assert not same(without, drive(6.0, [fault])), name
