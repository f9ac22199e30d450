# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The rates of the fake robot's sensors: how many readings, when, and what they say."""

import hashlib
import math
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from localizers import SECOND_NS, START_NS, as_object, feed, make_localizer, simulated
from places import FAULTS_EXAMPLE

from fnn_ekf_ros import messages
from fnn_ekf_ros.messages import Message
from fnn_ekf_ros.parameters.fake_robot import FakeRobotParameters
from fnn_ekf_ros.parameters.fault_files import read_faults
from fnn_ekf_ros.parameters.faults import (
    Burst,
    ClockJump,
    Delay,
    Dropout,
    Fault,
    Frozen,
    Kidnap,
    Outliers,
    Reordered,
)
from fnn_ekf_ros.parameters.schema import ParameterError, build
from fnn_ekf_ros.simulation.delivery import STEP_NS
from fnn_ekf_ros.simulation.fake_robot import FakeRobot
from fnn_ekf_ros.simulation.reading_times import ReadingTimes

RATES = [0.1, 1.0, 2.6667, 8.0, 10.0, 20.0, 50.0]
MEASURING = ("compass", "lrf_pose")
COUNTERS = ("left_ticks", "right_ticks", "joint_states")
QUIET: dict[str, Any] = {
    "slip_std": (0.0, 0.0), "wheel_speed_error": 0.0, "lrf_std": (0.0, 0.0, 0.0),
    "compass_std": 0.0,
}  # fmt: skip


class Entry(NamedTuple):
    """A message that is sent: at what time [ns], and what."""

    time_ns: int
    topic: str
    message: Message

    @property
    def stamp_ns(self) -> int:
        stamp = self.message.fields["header"].fields["stamp"].fields
        return int(stamp["sec"] * 10**9 + stamp["nanosec"])


def drive(
    seconds: float, faults: Sequence[Fault] = (), start_ns: int = START_NS, **changes: Any
) -> list[Entry]:
    """Return what a robot sends."""
    robot = FakeRobot(build(FakeRobotParameters, changes), start_ns, faults)
    sent: list[Entry] = []
    for _ in range(round(seconds * 80)):
        sent += [Entry(robot.time_ns, *entry) for entry in robot.step()]
    return sent


def on(entries: Sequence[Entry], topic: str) -> list[Entry]:
    return [entry for entry in entries if entry.topic == topic]


def digest(entries: Sequence[Entry]) -> str:
    """Return a hash of messages, in order; numbers to six digits after the point."""
    found = hashlib.sha256()
    for entry in entries:
        found.update(repr((entry.time_ns, entry.topic, rounded(entry.message))).encode())
    return found.hexdigest()[:16]


def rounded(field: Any) -> Any:
    """Return a message as lists and numbers, without what another processor's sine changes."""
    if isinstance(field, Message):
        return (field.type_name, {name: rounded(value) for name, value in field.fields.items()})
    if isinstance(field, list | np.ndarray):
        return [rounded(entry) for entry in field]
    return round(float(field), 6) + 0.0 if isinstance(field, float) else field


# What is sent.


@pytest.mark.slow
def test_the_default_rates_send_what_they_always_have(tmp_path: Path) -> None:
    """Hashes from before the rates were parameters."""
    assert digest(drive(10.0)) == "7d832e481269fc13"
    assert (
        digest(drive(10.0, start_ns=1_700_000_000_123_456_789, path="sim1", seed=8))
        == "7c7dcd249f5669b8"
    )
    faults = tmp_path / "faults.yaml"
    # Ten times as fast, so that each fault has its turn.
    faults.write_text(
        re.sub(r"(start|duration): (\d+)\.0", r"\1: \2e-1", FAULTS_EXAMPLE.read_text())
    )
    assert digest(drive(30.0, read_faults(str(faults)).faults, seed=9)) == "44ed0eefec494a63"


@pytest.mark.parametrize("rate", [*RATES, 3.0, 80.0, 100.0])
@pytest.mark.slow
def test_compass_and_fixes_are_stamped_at_multiples_of_their_interval(rate: float) -> None:
    """Each exactly then, and sent at the end of its step."""
    heard = drive(20.0, compass_rate=rate, lrf_rate=rate)
    first, last = START_NS + 1, START_NS + 20 * SECOND_NS
    interval = 0.375 if rate == 2.6667 else 1.0 / rate
    numbers = range(math.ceil(first * 1e-9 / interval), math.floor(last * 1e-9 / interval) + 1)
    expected = [math.ceil(round(n * interval * 1e9, 3)) for n in numbers]
    assert len(expected) == pytest.approx(20.0 / interval, abs=1)
    for topic in MEASURING:
        sent = on(heard, topic)
        assert [entry.stamp_ns for entry in sent] == expected
        assert [entry.time_ns for entry in sent] == [-(-s // STEP_NS) * STEP_NS for s in expected]


@pytest.mark.parametrize("rate", [*RATES, 30.0, 80.0])
@pytest.mark.slow
def test_encoders_are_read_at_the_first_step_at_or_after_their_time(rate: float) -> None:
    sent = drive(20.0, encoder_rate=rate)
    interval = 0.375 if rate == 2.6667 else 1.0 / rate
    due = [round(n * interval * 1e9) + STEP_NS for n in range(round(30.0 * rate))]
    steps = [-(-time // STEP_NS) * STEP_NS for time in due]
    expected = [time for time in steps if START_NS < time <= START_NS + 20 * SECOND_NS]
    assert len(expected) == pytest.approx(20.0 / interval, abs=1)
    for topic in COUNTERS:
        assert [entry.time_ns for entry in on(sent, topic)] == expected
    for entry in on(sent, "joint_states"):
        assert entry.stamp_ns == entry.time_ns


@pytest.mark.slow
def test_ground_truth_and_the_other_topics_keep_their_rates() -> None:
    one, other = drive(10.0), drive(10.0, encoder_rate=50.0)
    for topic in ("ground_truth", "compass", "lrf_pose"):
        assert digest(on(one, topic)) == digest(on(other, topic))
    fast = drive(10.0, compass_rate=100.0, lrf_rate=0.1)
    for topic in ("ground_truth", *COUNTERS):
        assert digest(on(one, topic)) == digest(on(fast, topic))
    # One stream serves both sensors: their noise is other noise.
    slow = drive(10.0, compass_rate=1.0)
    assert [e.stamp_ns for e in on(one, "lrf_pose")] == [e.stamp_ns for e in on(slow, "lrf_pose")]
    assert digest(on(one, "lrf_pose")) != digest(on(slow, "lrf_pose"))


def test_counters_say_the_same_whenever_they_are_read() -> None:
    counts = {}
    for rate in (80.0, 20.0, 7.3):
        for entry in on(drive(10.0, encoder_rate=rate), "left_ticks"):
            count = entry.message.fields["data"]
            assert counts.setdefault(entry.time_ns, count) == count
    assert len(counts) == 800


def test_readings_within_a_step_lie_on_the_way() -> None:
    """On a circle, without noise, at 100 Hz: the truth at the stamp, through the wrap of yaw."""
    robot = FakeRobot(
        build(
            FakeRobotParameters,
            {"path": "cmd_vel", "compass_rate": 100.0, "lrf_rate": 99.0, **QUIET},
        ),
        START_NS,
    )
    speed, turn_rate = 1.0, 1.5
    robot.set_command(speed, turn_rate)
    for _ in range(400):
        for sent in robot.step():
            heard = as_object(sent.message)
            if sent.topic not in MEASURING:
                continue
            yaw = turn_rate * (messages.stamp_ns(heard) - START_NS) * 1e-9
            radius = speed / turn_rate
            true = [radius * math.sin(yaw), radius * (1.0 - math.cos(yaw)), yaw]
            if sent.topic == "lrf_pose":
                pose = messages.planar_pose(heard)
                np.testing.assert_allclose(pose[:2], true[:2], atol=1e-4)
                read = pose[2]
            else:
                read = float(messages.yaw_of(heard.orientation) or 0.0)
            assert math.remainder(read - yaw, 2.0 * math.pi) == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("rate", [1.0, 50.0])
@pytest.mark.slow
def test_noise_is_as_large_as_it_is_set_at_any_rate(rate: float) -> None:
    still = {"path": "cmd_vel", "compass_rate": rate, "lrf_rate": rate}
    sent = drive(max(40.0, 100.0 / rate), **still)
    yaws = [messages.yaw_of(as_object(e.message).orientation) for e in on(sent, "compass")]
    fixes = np.array([messages.planar_pose(as_object(e.message)) for e in on(sent, "lrf_pose")])
    p = FakeRobotParameters()
    for errors, std in zip((*fixes.T, np.array(yaws)), (*p.lrf_std, p.compass_std), strict=True):
        assert abs(np.mean(errors)) < 6.0 * std / math.sqrt(len(errors))
        assert abs(np.std(errors) / std - 1.0) < 6.0 / math.sqrt(2.0 * len(errors))


# The times.


@pytest.mark.parametrize("rate", [2.6667, 8.0 / 3.0, 2.66667])
def test_a_rate_near_a_whole_number_of_steps_never_drifts(rate: float) -> None:
    times = ReadingTimes(rate)
    year_ns = 365 * 86400 * SECOND_NS
    late = 60 * year_ns - 60 * year_ns % 375_000_000
    assert times.within(late - 1, late + SECOND_NS) == [
        late,
        late + 375_000_000,
        late + 750_000_000,
    ]


@pytest.mark.parametrize("rate", [0.1, 0.3, 2.667, 7.3, 29.97, 50.0, 99.9])
def test_the_mean_rate_is_exact_however_long(rate: float) -> None:
    """1000 s after sixty years hold 1000 times the rate, whatever the steps."""
    times, begin = ReadingTimes(rate), 1_900_000_000 * SECOND_NS
    found = sum(
        len(times.within(begin + n * STEP_NS, begin + (n + 1) * STEP_NS)) for n in range(80_000)
    )
    assert found == round(1_000 * rate)
    assert len(times.within(begin, begin + 1_000 * SECOND_NS)) == found


def test_a_drive_finds_its_times_again_after_the_clock_was_set() -> None:
    robot = FakeRobot(build(FakeRobotParameters, {"lrf_rate": 10.0}), START_NS)
    robot.jump_to(1_000 * SECOND_NS + 1)
    stamps = []
    for _ in range(80):
        stamps += [Entry(0, *e).stamp_ns for e in robot.step() if e.topic == "lrf_pose"]
    assert stamps == [1_000 * SECOND_NS + n * 100_000_000 for n in range(1, 11)]


# Faults at other rates.


FAST = {"compass_rate": 100.0, "lrf_rate": 30.0, "encoder_rate": 45.0}


@pytest.mark.parametrize("topic", ["compass", "lrf_pose", "joint_states"])
@pytest.mark.slow
def test_messages_are_held_lost_delayed_and_swapped_at_other_rates(topic: str) -> None:
    lasting: dict[str, Any] = {"topic": topic, "start": 4.0, "duration": 2.0}
    on_ns, off_ns = START_NS + 4 * SECOND_NS, START_NS + 6 * SECOND_NS

    def heard(*faults: Fault) -> list[tuple[int, int]]:
        return [(e.time_ns, e.stamp_ns) for e in on(drive(9.0, faults, **FAST), topic)]

    true = heard()
    within = [on_ns <= time < off_ns for time, _ in true]
    assert heard(Dropout(**lasting)) == [
        e for e, held in zip(true, within, strict=True) if not held
    ]
    burst = [(off_ns if h else e[0], e[1]) for e, h in zip(true, within, strict=True)]
    assert heard(Burst(**lasting)) == burst
    delayed = [(e[0] + (20 * STEP_NS if h else 0), e[1]) for e, h in zip(true, within, strict=True)]
    assert sorted(heard(Delay(size=0.25, **lasting))) == sorted(delayed)
    swapped = heard(Reordered(**lasting))
    assert sorted(s for _, s in swapped) == [s for _, s in true]
    assert sum(np.diff([s for _, s in swapped]) < 0) >= sum(within) // 2 - 1
    frozen = drive(9.0, [Frozen(**lasting)], **FAST)
    assert [(e.time_ns, e.stamp_ns) for e in on(frozen, topic)] == true


@pytest.mark.slow
def test_slow_sensors_suffer_too() -> None:
    slow = {"compass_rate": 0.1, "lrf_rate": 0.5, "encoder_rate": 1.0}
    delay = Delay(topic="lrf_pose", start=0.0, size=0.7)
    late = {e.time_ns - e.stamp_ns for e in on(drive(30.0, [delay], **slow), "lrf_pose")}
    assert late == {700_000_000}
    wild = on(drive(41.0, [Outliers(topic="compass", start=0.0, size=1.0)], **slow), "compass")
    assert [e.stamp_ns for e in wild] == [n * SECOND_NS for n in (10, 20, 30, 40)]


def test_a_clock_jump_moves_the_stamps_of_readings_taken_after_it() -> None:
    """It happens at the end of a step: a reading within that step has the old time."""
    jump = ClockJump(start=4.0, size=30.0)
    without, with_it = (on(drive(6.0, faults, **FAST), "compass") for faults in ([], [jump]))
    for one, other in zip(without, with_it, strict=True):
        jumped = one.stamp_ns >= START_NS + 4 * SECOND_NS
        assert other.stamp_ns - one.stamp_ns == (30 * SECOND_NS if jumped else 0)


def test_a_reading_within_the_step_of_a_kidnapping_was_taken_before_it() -> None:
    kidnap = Kidnap(start=4.0 - 0.0125, move=(50.0, 0.0, 0.0))
    runs = (on(drive(6.0, f, **FAST, path="cmd_vel"), "lrf_pose") for f in ([], [kidnap]))
    for one, other in zip(*runs, strict=True):
        poses = [messages.planar_pose(as_object(e.message)) for e in (one, other)]
        carried = one.stamp_ns >= START_NS + 4 * SECOND_NS - STEP_NS
        moved = poses[1][0] - poses[0][0]
        assert moved == pytest.approx(50.0 if carried else 0.0, abs=1e-9)


# Who listens.


@pytest.mark.parametrize(
    ("source", "rates"),
    [
        ("ticks", {"encoder_rate": 50.0}),
        ("joint_states", {"encoder_rate": 80.0, "compass_rate": 100.0, "lrf_rate": 10.0}),
        ("ticks", {"encoder_rate": 30.0, "compass_rate": 7.3, "lrf_rate": 1.0}),
        ("joint_states", {"encoder_rate": 30.0, "compass_rate": 7.3, "lrf_rate": 1.0}),
    ],
    ids=str,
)
@pytest.mark.slow
def test_a_localizer_follows_a_robot_with_other_rates(source: str, rates: dict[str, float]) -> None:
    sent = simulated(7, 40.0, source, path="round", **rates)
    outputs = feed(make_localizer(encoder_source=source), sent.arrivals)
    estimates = [output.estimate for output in outputs if output.estimate is not None]
    assert len(estimates) >= 100
    assert {np.diff([e.stamp_ns for e in estimates]).max()} == {375_000_000}
    errors = np.array([e.state.mean - sent.truth[e.stamp_ns] for e in estimates])[:, :2]
    # A fix alone is good to 0.141 m. With one fix a second the wheels' slip adds to it.
    worst = 0.2 if rates.get("lrf_rate") == 1.0 else 0.14
    assert np.sqrt(np.mean(np.sum(errors**2, axis=-1))) < worst


# What is refused.


@pytest.mark.parametrize("name", ["encoder_rate", "compass_rate", "lrf_rate"])
def test_rates_out_of_range_are_refused_by_name(name: str) -> None:
    most = 80 if name == "encoder_rate" else 100
    for value in (0.0, 0.05, -1.0, most + 0.5, 1000.0, math.nan, math.inf, "fast", True):
        with pytest.raises(ParameterError) as caught:
            build(FakeRobotParameters, {name: value})
        shown = repr(value)
        assert str(caught.value) == (
            f"parameter '{name}' is {shown}: expected a number from 0.1 to {most} [Hz]"
        )
    assert getattr(build(FakeRobotParameters, {name: 1}), name) == 1.0
    assert getattr(build(FakeRobotParameters, {name: most}), name) == most


def test_encoders_are_read_once_a_step_at_most() -> None:
    assert STEP_NS * 80 == SECOND_NS
