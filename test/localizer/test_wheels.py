# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Encoders that wrap, jump, come in bursts or restart."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from localizers import SECOND_NS, Arrival, feed, make_localizer, same_estimates
from wheel_counts import (
    AT_ORIGIN,
    BEGIN_NS,
    METERS_PER_COUNT,
    SOURCES,
    STEP_NS,
    encoder_reports,
    encoders,
    last_mean,
    straight,
)

from fnn_ekf_ros.timeline.events import Level, Wheel, WheelCount


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
    reference = feed(make_localizer(encoder_bits=32, **changes), plain)
    outputs = feed(make_localizer(encoder_bits=bits, **changes), wrapping)
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
    localizer = make_localizer(encoder_source=source, **AT_ORIGIN)
    outputs = feed(localizer, reset)
    whole = feed(make_localizer(encoder_source=source, **AT_ORIGIN), arrivals)
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
    values = dict(encoders(localizer).values)
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
    localizer = make_localizer(encoder_source=source, **AT_ORIGIN)
    outputs = feed(localizer, with_reading(arrivals, 401, round(size * scale)))
    whole = feed(make_localizer(encoder_source=source, **AT_ORIGIN), arrivals)
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
    outputs = feed(make_localizer(**AT_ORIGIN), arrivals)
    np.testing.assert_array_equal(
        last_mean(outputs), last_mean(feed(make_localizer(**AT_ORIGIN), whole))
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
        localizer = make_localizer(**AT_ORIGIN)
        outputs = feed(localizer, changed)
        assert dict(encoders(localizer).values)["jumps"] == "0"
        whole = feed(make_localizer(**AT_ORIGIN), arrivals)
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
    localizer = make_localizer(encoder_source=source, **AT_ORIGIN)
    outputs = feed(localizer, restarted)
    counted = 20 * METERS_PER_COUNT * (600 - 281) if drives_on else 0.0
    assert last_mean(outputs)[0] == pytest.approx(counted, abs=0.2 * drives_on + 1e-9)
    np.testing.assert_allclose(last_mean(outputs)[1:], 0.0, atol=1e-9)
    values = dict(encoders(localizer).values)
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
    localizer = make_localizer(encoder_source=source, **AT_ORIGIN)
    outputs = feed(localizer, after_silence(arrivals, 3 * SECOND_NS))
    whole = feed(make_localizer(encoder_source=source, **AT_ORIGIN), arrivals)
    np.testing.assert_allclose(last_mean(outputs), last_mean(whole), atol=1e-9)
    assert dict(encoders(localizer).values)["jumps"] == "0"


@settings(derandomize=True, deadline=None, max_examples=20)
@given(seed=st.integers(0, 2**32 - 1))
@pytest.mark.slow
def test_stamps_that_jitter_by_a_drivers_cycle_are_no_jumps(seed: int) -> None:
    """At full speed, stamps of a 50 Hz driver up to 20 ms off, two of them the same."""
    rng = np.random.default_rng(seed)
    speed = 4.99 / 0.025
    localizer = make_localizer(encoder_source="joint_states", **AT_ORIGIN)
    before = 0
    for number in range(200):
        measured = BEGIN_NS + number * 20_000_000
        stamp = measured + int(rng.integers(0, 20_000_001))
        stamp = max(stamp, before)
        before = stamp
        for wheel in Wheel:
            reading = speed * (measured - BEGIN_NS) * 1e-9
            localizer.add(WheelCount(stamp, wheel, reading), stamp)
    assert dict(encoders(localizer).values)["jumps"] == "0"
