# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Encoders that wrap, jump, repeat themselves, come out of order, fall silent or get stuck."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from localizers import (
    PERIOD_NS,
    SECOND_NS,
    Arrival,
    feed,
    make_pipeline,
    same_estimates,
    simulated,
)

from fnn_ekf_ros.localizer import history
from fnn_ekf_ros.localizer.localizer import Localizer
from fnn_ekf_ros.timeline.events import (
    CompassYaw,
    Level,
    Output,
    PoseReset,
    Status,
    Wheel,
    WheelCount,
)
from fnn_ekf_ros.timeline.wheels import UnwrappedWheel

STEP_NS = 25_000_000
BEGIN_NS = 8 * PERIOD_NS
METERS_PER_COUNT = math.pi * 0.05 / 500.0
AT_ORIGIN = {"initial_pose": [0.0, 0.0, 0.0], "adaptation": "none"}
SOURCES = ["ticks", "joint_states"]
Reading = tuple[int, float]


def encoders(pipeline: Localizer) -> Status:
    return next(status for status in pipeline.report() if status.name == "encoders")


def encoder_reports(outputs: list[Output]) -> list[Status]:
    return [s for output in outputs for s in output.statuses or () if s.name == "encoders"]


def last_mean(outputs: list[Output]) -> np.ndarray:
    estimate = outputs[-1].estimate
    assert estimate is not None
    return estimate.state.mean


def straight(source: str, steps: int, per_step: int = 20, start: int = 0) -> list[Any]:
    """Return arrivals of a robot that drives straight ahead, so many counts in each 25 ms."""
    scale = 1 if source == "ticks" else METERS_PER_COUNT / 0.025
    return [
        Arrival(stamp, WheelCount(stamp, wheel, (start + per_step * number) * scale))
        for number in range(steps)
        for stamp in [BEGIN_NS + number * STEP_NS]
        for wheel in Wheel
    ]


def with_reading(arrivals: Sequence[Any], index: int, change: float) -> list[Any]:
    changed = list(arrivals)
    event = changed[index].event
    changed[index] = changed[index]._replace(event=event._replace(reading=event.reading + change))
    return changed


# Wrapping


@settings(derandomize=True, deadline=None, max_examples=60)
@given(
    data=st.data(), bits=st.integers(8, 32), signed=st.booleans(),
    inverted=st.tuples(st.booleans(), st.booleans()),
)  # fmt: skip
@pytest.mark.slow
def test_a_wrapped_run_is_bit_for_bit_the_unwrapped_one(
    data: st.DataObject, bits: int, signed: bool, inverted: tuple[bool, bool]
) -> None:
    """Whatever the width, the sign, the start and the wheels' directions."""
    largest = min(2 ** (bits - 1) - 1, 3000)  # up to 5 m/s are motion
    start = data.draw(st.tuples(*[st.integers(0, 2**bits - 1)] * 2))
    steps = data.draw(
        st.lists(st.tuples(*[st.integers(-largest, largest)] * 2), min_size=8, max_size=16)
    )
    counts = np.cumsum(np.array([(0, 0), *steps], dtype=object), axis=0)
    plain, wrapping = [], []
    for number, both in enumerate(counts):
        stamp = BEGIN_NS + number * 200_000_000
        for wheel in Wheel:
            shown = int(both[wheel]) * (-1 if inverted[wheel] else 1)
            plain.append(Arrival(stamp, WheelCount(stamp, wheel, shown)))
            shown = (shown + start[wheel]) % 2**bits
            if signed and shown >= 2 ** (bits - 1):
                shown -= 2**bits
            wrapping.append(Arrival(stamp, WheelCount(stamp, wheel, shown)))
    changes = AT_ORIGIN | {"left_inverted": inverted[0], "right_inverted": inverted[1]}
    reference = feed(make_pipeline(encoder_bits=32, **changes), plain)
    outputs = feed(make_pipeline(encoder_bits=bits, **changes), wrapping)
    assert sum(output.estimate is not None for output in outputs) >= 4
    same_estimates(outputs, reference)


# Jumps


@pytest.mark.parametrize("source", SOURCES)
@pytest.mark.parametrize("wheel", list(Wheel))
def test_a_reset_controller_starts_a_new_base(source: str, wheel: Wheel) -> None:
    """Counts begin at 0 again: it costs the way of one interval, and is said once."""
    arrivals = straight(source, 400, start=30_000)
    half = len(arrivals) // 2
    lost = arrivals[half].event.reading
    reset = [
        a._replace(event=a.event._replace(reading=a.event.reading - lost))
        if i >= half and a.event.wheel is wheel else a
        for i, a in enumerate(arrivals)
    ]  # fmt: skip
    pipeline = make_pipeline(encoder_source=source, **AT_ORIGIN)
    outputs = feed(pipeline, reset)
    whole = feed(make_pipeline(encoder_source=source, **AT_ORIGIN), arrivals)
    interval = 20 * METERS_PER_COUNT
    way, turn = last_mean(whole)[0] - last_mean(outputs)[0], abs(last_mean(outputs)[2])
    assert way == pytest.approx(0.5 * interval, rel=0.1)
    assert turn == pytest.approx(interval / 0.6, rel=1e-6)
    warned = [s for s in encoder_reports(outputs) if "jumped" in s.message]
    assert [s.level for s in warned] == [Level.WARN]
    jump = -lost * (METERS_PER_COUNT if source == "ticks" else 0.025) + interval
    assert warned[0].message == (
        f"{wheel.name.lower()} wheel jumped: taken for a reset or a glitch, not for motion"
    )
    values = dict(encoders(pipeline).values)
    assert values["jumps"] == "1"
    assert values["last jump [m]"] == f"{jump:.3f}"
    assert values["silence before the last jump [s]"] == "0.0"


@pytest.mark.parametrize("source", SOURCES)
@pytest.mark.parametrize("size", [-9000, 5000, 2**30])
@pytest.mark.slow
def test_a_glitch_costs_no_way(source: str, size: int) -> None:
    """One reading is corrupt: what the wheel did meanwhile is counted with the next one."""
    arrivals = straight(source, 400)
    scale = 1.0 if source == "ticks" else METERS_PER_COUNT / 0.025
    pipeline = make_pipeline(encoder_source=source, **AT_ORIGIN)
    outputs = feed(pipeline, with_reading(arrivals, 401, round(size * scale)))
    whole = feed(make_pipeline(encoder_source=source, **AT_ORIGIN), arrivals)
    np.testing.assert_array_equal(last_mean(outputs), last_mean(whole))
    furthest = max(
        float(np.max(np.abs(one.estimate.state.mean - other.estimate.state.mean)))
        for one, other in zip(outputs, whole, strict=True)
        if one.estimate is not None and other.estimate is not None
    )
    assert furthest < 1.01 * 20 * METERS_PER_COUNT / 0.6
    (warned,) = [s for s in encoder_reports(outputs) if "jumped" in s.message]
    assert warned.level is Level.WARN
    assert warned.message.startswith("right wheel jumped: ")


@pytest.mark.parametrize("glitches", [2, 3])
def test_corrupt_readings_that_contradict_each_other_are_no_new_base(glitches: int) -> None:
    arrivals = whole = straight("ticks", 400)
    for number in range(glitches):
        arrivals = with_reading(arrivals, 401 + 2 * number, (-1) ** number * 40_000)
    outputs = feed(make_pipeline(**AT_ORIGIN), arrivals)
    np.testing.assert_array_equal(
        last_mean(outputs), last_mean(feed(make_pipeline(**AT_ORIGIN), whole))
    )


@pytest.mark.parametrize(("source", "stall_ns"), [("ticks", 90_000_000), ("ticks", 2 * SECOND_NS)])
def test_a_burst_after_a_stall_is_no_jump(source: str, stall_ns: int) -> None:
    """At nearly full speed: ticks that come in together after a stall, or are lost in it."""
    arrivals = straight(source, 400, per_step=390)  # 4.9 m/s
    begin, end = BEGIN_NS + 4 * SECOND_NS + 1, BEGIN_NS + 4 * SECOND_NS + stall_ns
    burst = [
        a._replace(now_ns=end, event=a.event._replace(stamp_ns=end)) if begin < a.now_ns < end
        else a
        for a in arrivals
    ]  # fmt: skip
    lost = [a for a in arrivals if not begin < a.now_ns < end]
    for changed in (burst, lost):
        pipeline = make_pipeline(**AT_ORIGIN)
        outputs = feed(pipeline, changed)
        assert dict(encoders(pipeline).values)["jumps"] == "0"
        whole = feed(make_pipeline(**AT_ORIGIN), arrivals)
        np.testing.assert_allclose(last_mean(outputs), last_mean(whole), atol=1e-9)


def after_silence(arrivals: Sequence[Any], silent_ns: int) -> list[Any]:
    """Return arrivals without those of a while from 4 s on."""
    begin = BEGIN_NS + 4 * SECOND_NS
    return [a for a in arrivals if not begin < a.now_ns < begin + silent_ns]


@pytest.mark.parametrize("source", SOURCES)
@pytest.mark.parametrize("way", [12.0, -3.0])
@pytest.mark.parametrize("drives_on", [False, True])
@pytest.mark.slow
def test_a_controller_that_restarts_after_a_silence_is_no_motion(
    source: str, way: float, drives_on: bool
) -> None:
    """Silent for 3 s, then 0 and on from there: at 5 m/s the way back could have been driven."""
    start = round(way / METERS_PER_COUNT)
    scale = 1.0 if source == "ticks" else METERS_PER_COUNT / 0.025
    silent = after_silence(straight(source, 600, 0, start), 3 * SECOND_NS)
    again = BEGIN_NS + 7 * SECOND_NS
    restarted = [
        a._replace(
            event=a.event._replace(
                reading=(a.now_ns - again) // STEP_NS * 20 * drives_on * scale
            )
        ) if a.now_ns >= again else a
        for a in silent
    ]  # fmt: skip
    pipeline = make_pipeline(encoder_source=source, **AT_ORIGIN)
    outputs = feed(pipeline, restarted)
    counted = 20 * METERS_PER_COUNT * (600 - 281) if drives_on else 0.0
    assert last_mean(outputs)[0] == pytest.approx(counted, abs=0.2 * drives_on + 1e-9)
    np.testing.assert_allclose(last_mean(outputs)[1:], 0.0, atol=1e-9)
    values = dict(encoders(pipeline).values)
    assert values["jumps"] == "2"
    assert values["last jump [m]"] == f"{-way:.3f}"
    assert values["silence before the last jump [s]"] == "3.0"
    (said,) = [s for s in encoder_reports(outputs) if "jumped" in s.message]
    assert said.level is Level.WARN
    assert said.message == (
        "right wheel jumped after a silence: taken for a restart or a glitch, not for motion"
    )


@pytest.mark.parametrize("source", SOURCES)
@pytest.mark.parametrize("speed", [-4.9, 0.5, 4.9])
@pytest.mark.parametrize("start", [0, 40_000])
@pytest.mark.slow
def test_a_robot_whose_messages_were_lost_keeps_its_way(
    source: str, speed: float, start: int
) -> None:
    per_step = round(speed * STEP_NS * 1e-9 / METERS_PER_COUNT)
    arrivals = straight(source, 400, per_step, start)
    pipeline = make_pipeline(encoder_source=source, **AT_ORIGIN)
    outputs = feed(pipeline, after_silence(arrivals, 3 * SECOND_NS))
    whole = feed(make_pipeline(encoder_source=source, **AT_ORIGIN), arrivals)
    np.testing.assert_allclose(last_mean(outputs), last_mean(whole), atol=1e-9)
    assert dict(encoders(pipeline).values)["jumps"] == "0"


def test_a_reading_of_0_that_is_a_glitch_after_a_silence_costs_no_way() -> None:
    one = track()
    for stamp, raw in [(0, 30.0), (10**9, 33.0), (5 * 10**9, 0.0)]:
        taken = one.add(stamp, raw)
    assert (taken.jump, taken.silent_ns) == (-33.0, 4 * 10**9)
    assert one.at(5 * 10**9) == 33.0
    assert one.add(501 * 10**7, 45.0).jump == 0.0
    assert one.at(501 * 10**7) == 45.0


@settings(derandomize=True, deadline=None, max_examples=20)
@given(seed=st.integers(0, 2**32 - 1))
@pytest.mark.slow
def test_stamps_that_jitter_by_a_drivers_cycle_are_no_jumps(seed: int) -> None:
    """At full speed, stamps of a 50 Hz driver up to 20 ms off, two of them the same."""
    rng = np.random.default_rng(seed)
    speed = 4.99 / 0.025
    pipeline = make_pipeline(encoder_source="joint_states", **AT_ORIGIN)
    before = 0
    for number in range(200):
        measured = BEGIN_NS + number * 20_000_000
        stamp = measured + int(rng.integers(0, 20_000_001))
        stamp = max(stamp, before)
        before = stamp
        for wheel in Wheel:
            reading = speed * (measured - BEGIN_NS) * 1e-9
            pipeline.add(WheelCount(stamp, wheel, reading), stamp)
    assert dict(encoders(pipeline).values)["jumps"] == "0"


# The track itself


def track(*, stamped: bool = True, modulus: int | None = None) -> UnwrappedWheel:
    """Return a track on which 10 a second are motion, or 0.2 (1 on arrival) at once."""
    return UnwrappedWheel(modulus, stamped=stamped, fastest=10.0, resolution=0.0)


def readings(draw: Any) -> list[Reading]:
    """Return readings of a wheel that drives, is reset and now and then misread."""
    position, found = 0.0, []
    stamp = 0
    for _ in range(draw(st.integers(2, 12))):
        stamp += draw(st.integers(1, 300_000_000))
        position += draw(st.floats(-0.2, 0.2))
        position += draw(st.sampled_from([0.0, 0.0, 0.0, 0.0, 500.0, -300.0]))
        glitch = draw(st.sampled_from([0.0, 0.0, 0.0, 0.0, 77.0]))
        found.append((stamp, position + glitch))
        if draw(st.integers(0, 5)) == 0:
            found.append((stamp, position))
    return found


@settings(derandomize=True, deadline=None, max_examples=150)
@given(data=st.data())
@pytest.mark.slow
def test_a_track_does_not_depend_on_the_order_of_stamped_readings(data: st.DataObject) -> None:
    made = readings(data.draw)
    shuffled = data.draw(st.permutations([*made, *made[:3]]))
    ordered, mixed = track(), track()
    for stamp, raw in made:
        ordered.add(stamp, raw)
    for stamp, raw in shuffled:
        mixed.add(stamp, raw)
    last = made[-1][0]
    for instant in {stamp for stamp, _ in made} | set(range(0, last + 1, last // 20 + 1)):
        assert mixed.at(instant) == ordered.at(instant)


@settings(derandomize=True, deadline=None, max_examples=100)
@given(data=st.data())
@pytest.mark.slow
def test_a_late_reading_changes_nothing_before_what_it_says(data: st.DataObject) -> None:
    made = readings(data.draw)
    late = data.draw(st.sampled_from(sorted(set(made))))
    without, whole = track(), track()
    for stamp, raw in made:
        whole.add(stamp, raw)
        if (stamp, raw) != late:
            without.add(stamp, raw)
    before = {instant: without.at(instant) for instant in range(0, made[-1][0], 7_000_000)}
    changed_ns = without.add(*late).changed_ns
    assert changed_ns is not None
    for instant, count in before.items():
        assert without.at(instant) == whole.at(instant)
        if instant < changed_ns and instant >= min(s for s, r in made if (s, r) != late):
            assert without.at(instant) == count


def test_a_reading_that_is_there_already_changes_nothing() -> None:
    one = track()
    for stamp, raw in [(0, 0.0), (100, 0.1), (200, 90.0)]:
        one.add(stamp, raw)
    assert one.add(200, 90.0).changed_ns is None
    assert one.at(200) == 0.1  # a jump is not confirmed by its own repetition


def test_ticks_keep_their_order_where_the_clock_goes_back() -> None:
    one = track(stamped=False, modulus=2**16)
    for stamp, raw in [(10**9, 0), (2 * 10**9, 8), (15 * 10**8, 9), (16 * 10**8, 10)]:
        taken = one.add(stamp, raw)
        assert not taken.out_of_order
    one.add(3 * 10**9, 20)
    assert [one.at(s) for s in (10**9, 15 * 10**8, 2 * 10**9, 3 * 10**9)] == [0.0, 4.0, 10.0, 20.0]


# Silent and stuck wheels


@pytest.mark.parametrize("wheel", list(Wheel))
def test_a_silent_wheel_is_named(wheel: Wheel) -> None:
    arrivals = straight("ticks", 600)
    since = BEGIN_NS + 10 * SECOND_NS
    kept = [a for a in arrivals if a.now_ns < since or a.event.wheel is not wheel]
    reports = encoder_reports(feed(make_pipeline(**AT_ORIGIN), kept))
    said = [s for s in reports if f"{wheel.name.lower()} wheel silent" in s.message]
    assert len(said) >= 1
    assert {status.level for status in said} == {Level.ERROR}
    age_s = float(dict(said[0].values)[f"age of the {wheel.name.lower()} wheel [s]"])
    assert 3.0 <= age_s < 4.1
    other = Wheel(1 - wheel).name.lower()
    assert not any(f"{other} wheel" in status.message for status in reports)


def test_a_wheel_that_never_spoke_is_named() -> None:
    arrivals = [a for a in straight("ticks", 300) if a.event.wheel is Wheel.LEFT]
    last = encoder_reports(feed(make_pipeline(**AT_ORIGIN), arrivals))[-1]
    assert (last.level, last.message) == (Level.ERROR, "no message yet from the right wheel")


def stuck_at(arrivals: Sequence[Any], wheel: Wheel, since_ns: int) -> list[Any]:
    held: Any = None
    changed = []
    for a in arrivals:
        now = a
        if isinstance(a.event, WheelCount) and a.event.wheel is wheel:
            if a.now_ns < since_ns:
                held = a.event.reading
            else:
                now = a._replace(event=a.event._replace(reading=held))
        changed.append(now)
    return changed


@pytest.mark.parametrize("adaptation", ["none", "joint"])
@pytest.mark.parametrize("wheel", list(Wheel))
@pytest.mark.slow
def test_a_stuck_wheel_is_named(adaptation: str, wheel: Wheel) -> None:
    arrivals = simulated(11, 30.0, path="sim2").arrivals
    stuck_ns = BEGIN_NS + 15 * SECOND_NS
    outputs = feed(make_pipeline(adaptation=adaptation), stuck_at(arrivals, wheel, stuck_ns))
    name = f"{wheel.name.lower()} wheel stuck: "
    found = [
        (o.stamp_ns, s) for o in outputs for s in o.statuses or ()
        if s.name == "encoders" and "stuck" in s.message
    ]  # fmt: skip
    assert found
    assert all(s.message.startswith(name) and s.level is Level.ERROR for _, s in found)
    values = dict(found[0][1].values)
    assert float(values["count constant for [s]"]) >= 3.0
    by_wheels = float(values["rotation by the wheels meanwhile [rad]"])
    of_filter = float(values["rotation of the filter meanwhile [rad]"])
    assert abs(by_wheels) >= 0.5
    assert abs(by_wheels - of_filter) > 0.5 * abs(by_wheels)
    assert stuck_ns + 3 * SECOND_NS <= found[0][0] <= stuck_ns + 12 * SECOND_NS


@pytest.mark.parametrize("wheel", list(Wheel))
@pytest.mark.parametrize(
    ("adaptation", "assumed"), [("none", 0.2), ("none", 1.0), ("none", 5.0), ("joint", 0.2)]
)
@pytest.mark.slow
def test_a_robot_may_pivot_about_a_wheel(wheel: Wheel, assumed: float, adaptation: str) -> None:
    """Even where the configured noise of the filter is too small or too large."""
    for seed in range(2):
        rng = np.random.default_rng(seed)
        pipeline = make_pipeline(
            adaptation=adaptation, initial_pose=[0.0, 0.0, 0.0],
            process_noise_std=[0.05 * assumed, 0.05236 * assumed],
            measurement_noise_std=[0.1 * assumed, 0.1 * assumed, 0.134 * assumed],
        )  # fmt: skip
        outputs, yaw, count = [], 0.0, 0
        for number in range(1000):
            stamp = BEGIN_NS + number * STEP_NS
            count += 20
            side = 1.0 if wheel is Wheel.LEFT else -1.0
            yaw += side * 20 * METERS_PER_COUNT / 0.6
            yaw += 0.05236 * math.sqrt(STEP_NS / PERIOD_NS) * rng.standard_normal()
            if number % 5 == 0:
                seen = math.remainder(yaw + 0.134 * rng.standard_normal(), 2.0 * math.pi)
                outputs += pipeline.add(CompassYaw(stamp, seen), stamp)
            outputs += pipeline.add(WheelCount(stamp, Wheel(1 - wheel), count), stamp)
            outputs += pipeline.add(WheelCount(stamp, wheel, 0), stamp)
        assert not [s.message for s in encoder_reports(outputs) if "stuck" in s.message]


def test_a_pose_that_is_set_is_no_turn() -> None:
    pipeline, outputs = make_pipeline(**AT_ORIGIN), []
    for number in range(400):
        stamp = BEGIN_NS + number * STEP_NS
        if number == 200:
            there = np.array([1.0, 2.0, 3.0])
            outputs += pipeline.add(PoseReset(stamp, there, 1e-4 * np.eye(3)), stamp)
        outputs += pipeline.add(WheelCount(stamp, Wheel.RIGHT, 10 * number), stamp)
        outputs += pipeline.add(WheelCount(stamp, Wheel.LEFT, 0), stamp)
    assert not [s.message for s in encoder_reports(outputs) if "stuck" in s.message]


@pytest.mark.parametrize("relocated", [False, True])
def test_a_pose_that_the_gate_moves_is_no_turn(
    monkeypatch: pytest.MonkeyPatch, relocated: bool
) -> None:
    """The yaw jumps against the wheels' turn while a wheel stands: it may be stuck, or not."""
    run = history.run_period

    def jumping(model: Any, before: Any, inputs: Any) -> Any:
        after, result = run(model, before, inputs)
        if result is not None and inputs.counts.right == 13 * 150.0:
            turned = after.bank.mean - np.array([[0.0], [0.0], [1.0]])
            after = after._replace(bank=after.bank._replace(mean=turned))
            result = result._replace(relocated=np.array(relocated))
        return after, result

    monkeypatch.setattr(history, "run_period", jumping)
    sure = {"initial_pose_std": [0.1, 0.1, 0.01], "process_noise_std": [0.05, 0.001]}
    pipeline, outputs = make_pipeline(**AT_ORIGIN, **sure), []
    for number in range(400):
        stamp = BEGIN_NS + number * STEP_NS
        outputs += pipeline.add(WheelCount(stamp, Wheel.RIGHT, 10 * number), stamp)
        outputs += pipeline.add(WheelCount(stamp, Wheel.LEFT, 0), stamp)
    said = [s.message for s in encoder_reports(outputs) if "left wheel stuck" in s.message]
    assert bool(said) is not relocated


def test_encoders_that_are_not_there_are_an_error_after_a_while() -> None:
    pipeline, levels = make_pipeline(), []
    for number in range(40):
        outputs = pipeline.advance(BEGIN_NS + number * PERIOD_NS)
        levels += [(o.stamp_ns, s.level) for o in outputs for s in encoder_reports([o])]
    assert levels
    assert [level for _, level in levels] == [
        Level.WARN if stamp <= levels[0][0] + 3 * SECOND_NS else Level.ERROR for stamp, _ in levels
    ]
    assert {level for _, level in levels} == {Level.WARN, Level.ERROR}
