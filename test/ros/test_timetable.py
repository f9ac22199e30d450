# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""When messages of a recording are due, with a wall clock that the test sets."""

import math

import pytest

from fnn_ekf_ros.ros.timetable import Timetable

S = 10**9


class Wall:
    """A wall clock [s]."""

    def __init__(self) -> None:
        self.now_s = 100.0

    def __call__(self) -> float:
        return self.now_s


@pytest.fixture
def wall() -> Wall:
    return Wall()


def started(wall: Wall, rate: float, lead_ns: int | None) -> Timetable:
    timetable = Timetable(rate, lead_ns, wall)
    timetable.start(5 * S)
    return timetable


def test_without_a_listener_only_the_rate_counts(wall: Wall) -> None:
    timetable = started(wall, 10.0, None)
    assert timetable.wait_s(15 * S) == pytest.approx(1.0)
    wall.now_s += 0.75
    assert timetable.wait_s(15 * S) == pytest.approx(0.25)
    wall.now_s += 2.0
    assert timetable.wait_s(15 * S) == 0.0


def test_real_time_until_the_listener_is_heard_and_the_rate_from_then_on(wall: Wall) -> None:
    timetable = started(wall, 10.0, S)
    assert timetable.wait_s(6 * S) == pytest.approx(1.0)
    wall.now_s += 1.0
    timetable.played(6 * S)
    assert timetable.heard(6 * S - 1)
    assert timetable.wait_s(7 * S - 1) == pytest.approx(0.1)


def test_a_rate_below_1_stays_where_nothing_is_heard_yet(wall: Wall) -> None:
    assert started(wall, 0.5, S).wait_s(6 * S) == pytest.approx(2.0)


def test_no_further_ahead_of_the_listener_than_the_lead(wall: Wall) -> None:
    timetable = started(wall, 10.0, S // 2)
    timetable.played(6 * S)
    timetable.heard(6 * S)
    wall.now_s += 1000.0
    assert timetable.wait_s(6 * S + S // 2) == 0.0
    assert not timetable.held(6 * S + S // 2)
    assert timetable.wait_s(6 * S + S // 2 + 1) == math.inf
    timetable.played(6 * S + S // 2)
    timetable.heard(6 * S + S // 4)
    assert not timetable.held(6 * S + 3 * S // 4)


def test_time_spent_waiting_is_not_made_up_for(wall: Wall) -> None:
    timetable = started(wall, 10.0, S // 2)
    timetable.played(6 * S)
    timetable.heard(6 * S)
    timetable.played(6 * S + S // 2)
    wall.now_s += 50.0
    assert timetable.wait_s(7 * S) == math.inf
    wall.now_s += 50.0
    assert timetable.wait_s(7 * S) == math.inf
    timetable.heard(6 * S + S // 2)
    assert timetable.wait_s(7 * S) == pytest.approx(0.05)


def test_only_a_later_stamp_is_new(wall: Wall) -> None:
    timetable = started(wall, 1.0, S)
    timetable.played(8 * S)
    assert timetable.heard(7 * S)
    assert not timetable.heard(7 * S)
    assert not timetable.heard(6 * S)
    assert timetable.heard_ns == 7 * S


def test_what_is_left_of_the_last_round_does_not_count_in_the_next(wall: Wall) -> None:
    timetable = started(wall, 1.0, S)
    timetable.played(9 * S)
    timetable.heard(8 * S)
    timetable.start(5 * S)
    assert timetable.heard_ns is None
    assert not timetable.heard(9 * S)
    timetable.played(6 * S)
    assert timetable.heard(6 * S)
