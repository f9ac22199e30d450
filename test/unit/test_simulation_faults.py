"""Faults of the simulated robot: what is asked for goes wrong, and nothing else does."""

import functools
import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_typestore

from fnn_ekf_ros import messages
from fnn_ekf_ros.core.angles import wrap_angle
from fnn_ekf_ros.core.arrays import FloatArray
from fnn_ekf_ros.messages import Message
from fnn_ekf_ros.parameters.fake_robot import FakeRobotParameters
from fnn_ekf_ros.parameters.fault_files import faults_from
from fnn_ekf_ros.parameters.faults import (
    COUNTERS,
    FAULTS,
    GROUPS,
    JOINTS,
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
    WrongFrame,
    WrongStamp,
    WrongUnit,
    ZeroQuaternion,
)
from fnn_ekf_ros.parameters.schema import build, fields_of
from fnn_ekf_ros.simulation.delivery import STEP_NS, Delivery, Sent
from fnn_ekf_ros.simulation.fake_robot import OUTPUT_TYPES, FakeRobot

START_NS = 3 * 10**9
QUIET: dict[str, Any] = {"slip_std": (0.0, 0.0), "wheel_speed_error": 0.0}
_TYPESTORE = get_typestore(Stores.ROS2_JAZZY)


class Heard(NamedTuple):
    """A message as a listener gets it: when, in seconds since the start, and what."""

    time: float
    topic: str
    message: Message

    @property
    def fields(self) -> dict[str, Any]:
        return self.message.fields

    @property
    def stamp(self) -> float:
        """The stamp, in seconds since the start."""
        stamp = self.fields["header"].fields["stamp"].fields
        return (stamp["sec"] * 10**9 + stamp["nanosec"] - START_NS) * 1e-9


def drive(seconds: float, faults: Sequence[Fault] = (), **changes: Any) -> list[Heard]:
    """Return what a robot sends; messages change nothing, so runs are kept."""
    return list(_drive(seconds, tuple(faults), tuple(sorted(changes.items()))))


@functools.cache
def _drive(
    seconds: float, faults: tuple[Fault, ...], changes: tuple[tuple[str, Any], ...]
) -> list[Heard]:
    robot = FakeRobot(build(FakeRobotParameters, dict(changes)), START_NS, faults)
    heard: list[Heard] = []
    for _ in range(round(seconds * 80)):
        sent = robot.step()
        heard += [Heard((robot.time_ns - START_NS) * 1e-9, *entry) for entry in sent]
    return heard


def on(heard: Sequence[Heard], *topics: str) -> list[Heard]:
    return [entry for entry in heard if entry.topic in topics]


def plain(field: Any) -> Any:
    """Return a message as text that tells every bit of it."""
    if isinstance(field, Message):
        return (field.type_name, [(name, plain(value)) for name, value in field.fields.items()])
    if isinstance(field, list):
        return [plain(entry) for entry in field]
    return repr(field.tolist() if isinstance(field, np.ndarray) else field)


def same(one: Sequence[Heard], other: Sequence[Heard]) -> bool:
    return [(e.time, e.topic, plain(e.message)) for e in one] == [
        (e.time, e.topic, plain(e.message)) for e in other
    ]


def pose(entry: Heard) -> FloatArray:
    """Return [x, y, yaw] of a fix or of the truth; of the compass with NaN for x and y."""
    if entry.topic == "compass":
        q = entry.fields["orientation"].fields
        return np.array([math.nan, math.nan, 2.0 * math.atan2(q["z"], q["w"])])
    whole = entry.fields["pose"].fields["pose"].fields
    place, q = whole["position"].fields, whole["orientation"].fields
    return np.array([place["x"], place["y"], 2.0 * math.atan2(q["z"], q["w"])])


def off(one: Sequence[Heard], other: Sequence[Heard]) -> FloatArray:
    """Return by how much poses `(n, 3)` differ, yaw wrapped."""
    assert len(one) == len(other) > 0
    change = np.array([pose(a) - pose(b) for a, b in zip(one, other, strict=True)])
    change[:, 2] = wrap_angle(change[:, 2])
    return change


def counts(heard: Sequence[Heard], topic: str = "left_ticks") -> list[int]:
    return [entry.fields["data"] for entry in on(heard, topic)]


# What is not touched stays.

LASTING = {"start": 4.0, "duration": 2.0}
SENSOR_FAULTS: list[Any] = [
    Outliers(topic="lrf_pose", size=5.0, rate=0.5, **LASTING),
    Outliers(topic="compass", size=0.5, rate=0.5, **LASTING),
    Bias(topic="lrf_pose", size=(1.0, 2.0, 0.3), **LASTING),
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


# The robot.


def test_a_slipping_robot_slips_by_the_factor_and_the_ticks_do_not_see_it() -> None:
    """On a straight command the change of yaw per period has the std that is asked for."""

    def turns(*faults: Fault) -> FloatArray:
        parameters = FakeRobotParameters(
            wheel_speed_error=0.0, slip_std=(0.001, 0.01), path="cmd_vel"
        )
        robot = FakeRobot(parameters, 0, faults)
        robot.set_command(0.3, 0.0)
        truth, ticks = [], []
        for _ in range(30 * 400):
            for sent in robot.step():
                if sent.topic == "ground_truth":
                    truth.append(pose(Heard(0.0, sent.topic, sent.message))[2])
                if sent.topic == "left_ticks":
                    ticks.append(sent.message.fields["data"])
        assert ticks[-1] == pytest.approx(0.3 * 150.0 / (math.pi * 0.05 / 500.0), abs=40)
        return np.asarray(wrap_angle(np.diff(truth[2::3])))  # truth comes three times a period

    usual = turns()
    thrice = turns(Slip(start=75.0, duration=60.0, factor=3.0))
    expected = usual * np.where((np.arange(399) >= 199) & (np.arange(399) < 359), 3.0, 1.0)
    differs = np.abs(thrice - expected) > 1e-12
    # Periods 198 and 358 hold its first step and the first one after it.
    assert set(np.flatnonzero(differs)) <= {198, 358}
    given = turns(Slip(start=0.0, std=(0.0, 0.05)))
    assert np.std(given) == pytest.approx(0.05, rel=6.0 / math.sqrt(2.0 * 400))


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


# What is measured.


def through(fault: Fault, count: int) -> tuple[Heard, list[Heard]]:
    """Return a message and what a fault makes of it again and again."""
    one = on(drive(1.0), *fault.targets())[0]
    delivery = Delivery([fault], [np.random.default_rng(8)])
    sent = (
        entry
        for step in range(1, count + 1)
        for entry in delivery.sent(step, [Sent(one.topic, one.message)])
    )
    return one, [Heard(0.0, entry.topic, entry.message) for entry in sent]


def test_outliers_of_fixes_have_their_share_size_and_every_direction() -> None:
    count = 4000
    one, heard = through(Outliers(start=0.0, topic="lrf_pose", size=20.0, rate=0.1), count)
    change = off(heard, [one] * count)
    far = np.linalg.norm(change[:, :2], axis=1)
    hit = far > 0.0
    np.testing.assert_allclose(far[hit], 20.0, atol=1e-9)
    np.testing.assert_array_equal(change[:, 2], 0.0)
    assert abs(np.sum(hit) - 0.1 * count) < 6.0 * math.sqrt(count * 0.1 * 0.9)
    mean = np.mean(change[hit, :2] / 20.0, axis=0)
    assert np.max(np.abs(mean)) < 6.0 / math.sqrt(2.0 * np.sum(hit))


def test_outliers_of_the_compass_go_to_either_side() -> None:
    count = 4000
    one, heard = through(Outliers(start=0.0, topic="compass", size=0.7, rate=0.3), count)
    turn = off(heard, [one] * count)[:, 2]
    hit = np.abs(turn) > 1e-9
    np.testing.assert_allclose(np.abs(turn[hit]), 0.7, atol=1e-9)
    assert abs(np.mean(hit) - 0.3) < 6.0 * math.sqrt(0.3 * 0.7 / count)
    assert abs(np.mean(turn[hit] > 0.0) - 0.5) < 3.0 / math.sqrt(np.sum(hit))


def test_part_of_the_messages_is_dropped() -> None:
    _, heard = through(Dropout(start=0.0, topic="compass", rate=0.3), 4000)
    assert abs(len(heard) - 0.7 * 4000) < 6.0 * math.sqrt(4000 * 0.3 * 0.7)


def within(heard: Sequence[Heard], first: float = 4.0, end: float = 6.0) -> list[Heard]:
    return [e for e in heard if first <= e.time < end]


def faulty_and_true(fault: Any) -> tuple[list[Heard], list[Heard]]:
    """Return the faulty messages and what they should have been."""
    with_it, without = drive(9.0, [fault]), drive(9.0)
    return within(on(with_it, fault.topic)), within(on(without, fault.topic))


def test_a_bias_is_the_same_for_all() -> None:
    change = off(*faulty_and_true(Bias(topic="lrf_pose", size=(1.0, -2.0, 0.3), **LASTING)))
    np.testing.assert_allclose(change, np.tile([1.0, -2.0, 0.3], (len(change), 1)), atol=1e-9)
    change = off(*faulty_and_true(Bias(topic="compass", size=(0.0, 0.0, -3.0), **LASTING)))
    np.testing.assert_allclose(change[:, 2], -3.0, atol=1e-9)


@pytest.mark.parametrize("topic", ["lrf_pose", "compass"])
def test_noise_is_the_same_noise_times_the_factor(topic: str) -> None:
    fault = Noise(start=0.0, topic=topic, factor=2.5)
    errors = []
    for faults in ([], [fault]):
        run = drive(9.0, faults)
        truth = {e.time: e for e in on(run, "ground_truth")}
        own = on(run, topic)
        errors.append(off(own, [truth[e.time] for e in own]))
        said = own[0].fields if topic == "compass" else own[0].fields["pose"].fields
        name = "orientation_covariance" if topic == "compass" else "covariance"
        assert said[name][-1] == pytest.approx(0.018, rel=0.01)  # the sensor does not know
    np.testing.assert_allclose(errors[1], 2.5 * errors[0], atol=1e-9)


@pytest.mark.parametrize("topic", ["lrf_pose", "compass", "joint_states", "left_ticks"])
def test_what_is_frozen_repeats_the_last_value_with_new_stamps(topic: str) -> None:
    heard = on(drive(9.0, [Frozen(topic=topic, **LASTING)]), topic)
    last = [e for e in heard if e.time < 4.0][-1]
    frozen = within(heard)
    assert len(frozen) >= 5
    for entry in frozen:
        kept, now = dict(last.fields), dict(entry.fields)
        if topic != "left_ticks":
            assert entry.stamp == pytest.approx(entry.time, abs=1e-9)
            kept.pop("header"), now.pop("header")
        assert plain(Message("", kept)) == plain(Message("", now))


def test_what_is_frozen_from_the_start_repeats_its_first_value() -> None:
    assert set(counts(drive(2.0, [Frozen(start=0.0, topic="left_ticks")]))) == {
        counts(drive(2.0))[0]
    }


def test_not_a_number_stands_where_it_should() -> None:
    for entry in faulty_and_true(NotANumber(topic="lrf_pose", **LASTING))[0]:
        np.testing.assert_array_equal(np.isnan(pose(entry)), [True, False, False])
    for entry in faulty_and_true(NotANumber(topic="compass", **LASTING))[0]:
        assert all(map(math.isnan, entry.fields["orientation"].fields.values()))
    for entry in faulty_and_true(NotANumber(topic="joint_states", **LASTING))[0]:
        assert np.all(np.isnan(entry.fields["position"]))


@pytest.mark.parametrize("topic", ["lrf_pose", "compass"])
def test_a_zero_quaternion_is_zero_and_stays_so_under_other_faults(topic: str) -> None:
    also = Bias(topic=topic, size=(0.0, 0.0, 1.0), **LASTING)
    for faults in ([], [also]):
        heard = drive(9.0, [ZeroQuaternion(topic=topic, **LASTING), *faults])
        for entry in within(on(heard, topic)):
            whole = entry.fields if topic == "compass" else entry.fields["pose"].fields["pose"]
            q = (whole if topic == "compass" else whole.fields)["orientation"].fields
            assert set(q.values()) == {0.0}


def test_a_wrong_frame_is_all_that_is_wrong() -> None:
    wrong, true = faulty_and_true(WrongFrame(topic="lrf_pose", frame="attic", **LASTING))
    assert {e.fields["header"].fields["frame_id"] for e in wrong} == {"attic"}
    np.testing.assert_array_equal(off(wrong, true), 0.0)


def test_a_wrong_unit_multiplies() -> None:
    wrong, true = faulty_and_true(WrongUnit(topic="lrf_pose", **LASTING))
    for one, other in zip(wrong, true, strict=True):
        np.testing.assert_allclose(pose(one), pose(other) * [1000.0, 1000.0, 1.0])
    wrong, true = faulty_and_true(WrongUnit(topic="joint_states", factor=57.3, **LASTING))
    for one, other in zip(wrong, true, strict=True):
        np.testing.assert_allclose(one.fields["position"], other.fields["position"] * 57.3)
    wrong, true = faulty_and_true(WrongUnit(topic="compass", factor=57.3, **LASTING))
    for one, other in zip(wrong, true, strict=True):
        error = float(wrap_angle(pose(one)[2] - 57.3 * wrap_angle(pose(other)[2])))
        assert error == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("size", [0.5, -0.25])
@pytest.mark.parametrize("topic", ["lrf_pose", "compass", "joint_states"])
def test_a_wrong_stamp_is_off_by_its_size(topic: str, size: float) -> None:
    wrong, true = faulty_and_true(WrongStamp(topic=topic, size=size, **LASTING))
    assert [e.time for e in wrong] == [e.time for e in true]
    for entry in wrong:
        assert entry.stamp - entry.time == pytest.approx(size, abs=1e-9)


def test_a_stamp_is_never_before_time_zero() -> None:
    (wrong, *_), _ = faulty_and_true(WrongStamp(topic="compass", size=-1e9, **LASTING))
    assert wrong.fields["header"].fields["stamp"].fields == {"sec": 0, "nanosec": 0}


@pytest.mark.parametrize(
    "fault",
    [WrongStamp(start=0.0, topic="compass", size=1e9), ClockJump(start=0.0, size=1e9)],
    ids=lambda fault: type(fault).__name__,
)
def test_seconds_of_a_stamp_fit_their_32_bits(fault: Fault) -> None:
    robot = FakeRobot(FakeRobotParameters(), 1_790_000_000 * 10**9, [fault])
    sent = [entry for _ in range(80) for entry in robot.step() if entry.topic == "compass"]
    seconds = [entry.message.fields["header"].fields["stamp"].fields["sec"] for entry in sent]
    assert min(seconds) == 2_100_000_000
    assert max(seconds) <= 2_100_000_001


@pytest.mark.parametrize("variance", [0.0, -1.0])
def test_a_bad_covariance_has_the_variance_on_its_diagonal(variance: float) -> None:
    fix, *_ = faulty_and_true(BadCovariance(topic="lrf_pose", variance=variance, **LASTING))[0]
    said = np.reshape(fix.fields["pose"].fields["covariance"], (6, 6))
    np.testing.assert_array_equal(said, np.diag([variance] * 6))
    yaw, *_ = faulty_and_true(BadCovariance(topic="compass", variance=variance, **LASTING))[0]
    said = np.reshape(yaw.fields["orientation_covariance"], (3, 3))
    np.testing.assert_array_equal(said, np.diag([variance] * 3))


# When it is sent.


@pytest.mark.parametrize("topic", ["lrf_pose", "compass", "left_ticks", "joint_states"])
def test_what_is_dropped_does_not_come(topic: str) -> None:
    without, with_it = drive(9.0), drive(9.0, [Dropout(topic=topic, **LASTING)])
    kept = [e for e in on(without, topic) if not 4.0 <= e.time < 6.0]
    assert same(on(with_it, topic), kept)
    assert len(kept) < len(on(without, topic))


@pytest.mark.parametrize("topic", ["lrf_pose", "compass", "left_ticks"])
def test_what_is_delayed_is_sent_later_and_stamped_as_ever(topic: str) -> None:
    """0.31 s are rounded up to whole steps of 12.5 ms."""
    without, with_it = drive(9.0), drive(9.0, [Delay(topic=topic, size=0.31, **LASTING)])
    expected = [
        (e.time + (0.3125 if 4.0 <= e.time < 6.0 else 0.0), plain(e.message))
        for e in on(without, topic)
    ]
    heard = [(e.time, plain(e.message)) for e in on(with_it, topic)]
    expected = [e for e in sorted(expected, key=lambda e: e[0]) if e[0] <= 9.0]
    assert [time for time, _ in heard] == pytest.approx([time for time, _ in expected], abs=1e-9)
    assert sorted(heard) == sorted(heard, key=lambda e: (e[0], e[1]))
    assert sorted(m for _, m in heard) == sorted(m for _, m in expected)
    if topic != "left_ticks":
        for entry in on(with_it, topic):
            assert entry.time - entry.stamp == pytest.approx(
                0.3125 if 4.0 <= entry.stamp < 6.0 - 1e-9 else 0.0, abs=1e-9
            )


def test_a_burst_comes_at_once_in_order() -> None:
    without, with_it = drive(9.0), drive(9.0, [Burst(topic="compass", **LASTING)])
    true, heard = on(without, "compass"), on(with_it, "compass")
    assert [plain(e.message) for e in true] == [plain(e.message) for e in heard]
    for one, other in zip(true, heard, strict=True):
        held = 4.0 <= one.time < 6.0
        assert other.time == pytest.approx(6.0 if held else one.time, abs=1e-9)
    assert sum(4.0 <= e.time < 6.0 for e in true) == 16


def test_pairs_change_places() -> None:
    without, with_it = drive(9.0), drive(9.0, [Reordered(topic="compass", **LASTING)])
    true = [plain(e.message) for e in on(without, "compass")]
    heard = on(with_it, "compass")
    first = next(i for i, e in enumerate(on(without, "compass")) if e.time >= 4.0)
    swapped = true[:]
    for i in range(first, first + 16, 2):
        swapped[i], swapped[i + 1] = true[i + 1], true[i]
    assert [plain(e.message) for e in heard] == swapped
    assert heard[first].time == pytest.approx(heard[first + 1].time)


def test_the_odd_one_of_reordered_messages_comes_at_the_end() -> None:
    heard = on(drive(5.0, [Reordered(start=4.0, duration=0.2, topic="lrf_pose")]), "lrf_pose")
    true = on(drive(5.0), "lrf_pose")
    assert [plain(e.message) for e in heard] == [plain(e.message) for e in true]
    (late,) = [e for e in heard if e.time - e.stamp > 1e-9]
    assert 4.0 <= late.stamp < 4.2
    assert late.time == pytest.approx(4.2, abs=1e-9)


@pytest.mark.parametrize("topic", ["lrf_pose", "right_ticks"])
def test_duplicates_come_twice(topic: str) -> None:
    without, with_it = drive(9.0), drive(9.0, [Duplicates(topic=topic, **LASTING)])
    expected = [e for e in on(without, topic) for _ in range(1 + (4.0 <= e.time < 6.0))]
    assert same(on(with_it, topic), expected)


def test_what_is_measured_goes_wrong_before_its_delivery_whatever_the_order() -> None:
    faults = [
        Delay(topic="lrf_pose", size=0.5, start=0.0),
        Frozen(topic="lrf_pose", **LASTING),
        Outliers(topic="lrf_pose", size=3.0, rate=1.0, **LASTING),
    ]
    heard = on(drive(9.0, faults), "lrf_pose")
    frozen = [pose(e) for e in heard if 4.0 <= e.stamp < 6.0 - 1e-9]
    healthy = [pose(e) for e in heard if e.stamp < 4.0][-1]
    far = [np.linalg.norm((p - healthy)[:2]) for p in frozen]
    np.testing.assert_allclose(far, 3.0, atol=1e-9)


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
    if name == "bias" and entry["topic"] == "compass":
        entry["size"] = (0.0, 0.0, entry["size"][2])
    return entry


def target(entry: dict[str, Any]) -> tuple[str, str]:
    return entry["fault"], entry.get("topic", "wheel or robot")


def built(field: Any) -> Any:
    if isinstance(field, Message):
        kind = _TYPESTORE.types[field.type_name]
        return kind(**{name: built(value) for name, value in field.fields.items()})
    return field


@settings(max_examples=60, deadline=None, derandomize=True)
@given(st.lists(entries(), max_size=6, unique_by=target), st.sampled_from([8, 32]))
def test_any_timeline_sends_messages_that_can_be_sent(
    timeline: list[dict[str, Any]], bits: int
) -> None:
    faults = faults_from(timeline)
    robot = FakeRobot(build(FakeRobotParameters, {"encoder_bits": bits}), START_NS, faults)
    truth = 0
    for _ in range(80 * 5):
        for topic, message in robot.step():
            assert message.type_name == OUTPUT_TYPES[topic]
            data = _TYPESTORE.serialize_cdr(built(message), message.type_name)
            back = _TYPESTORE.deserialize_cdr(data, message.type_name)
            if "header" in message.fields:
                assert 0 <= messages.stamp_ns(back) <= 2_100_000_010 * 10**9
            if topic == "ground_truth":
                truth += 1
                assert np.all(np.isfinite(messages.planar_pose(back)))
                assert messages.stamp_ns(back) == robot.stamp_ns
    assert truth == 40


def test_every_fault_has_its_group_and_its_place() -> None:
    """A fault that no module knows would do nothing: each must change what is sent."""
    needed: dict[str, Any] = {
        "topic": "lrf_pose", "wheel": "left", "move": (1.0, 0.0, 0.0), "size": 0.5,
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
