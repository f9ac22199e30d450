# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The track of one wheel: jumps, late readings, repeated ones."""

from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fnn_ekf_ros.timeline.wheels import UnwrappedWheel

Reading = tuple[int, float]


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


def test_a_reading_of_0_that_is_a_glitch_after_a_silence_costs_no_way() -> None:
    one = track()
    for stamp, raw in [(0, 30.0), (10**9, 33.0), (5 * 10**9, 0.0)]:
        taken = one.add(stamp, raw)
    assert (taken.jump, taken.silent_ns) == (-33.0, 4 * 10**9)
    assert one.at(5 * 10**9) == 33.0
    assert one.add(501 * 10**7, 45.0).jump == 0.0
    assert one.at(501 * 10**7) == 45.0
