# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The order and the times in which a node takes its messages, with clocks of the test's own."""

import itertools

import pytest

from fnn_ekf_ros.messages import CLOCK
from fnn_ekf_ros.ros.arrivals import (
    CATCHING_UP_S,
    HELD_LOOKS,
    HELD_S,
    LAG_S,
    LONGEST_HELD_S,
    Arrivals,
    Message,
    Moment,
)

S = 10**9
LOOK_S = 0.1
T0_NS = 1000 * S


def at(seconds: float, *, simulated: bool = False) -> Moment:
    system_ns = T0_NS + round(seconds * S)
    return Moment(seconds, system_ns, None if simulated else round(seconds * S) + S)


def clock(seconds: float, time_s: float, arrived: float | None = None) -> Message:
    """Return simulated time that was sent after so many seconds."""
    return sent(CLOCK, seconds, arrived)._replace(content=round(time_s * S))


def sent(topic: str, seconds: float, arrived: float | None = None) -> Message:
    sent_ns = T0_NS + round(seconds * S)
    received_s = seconds + 0.001 if arrived is None else arrived
    return Message(topic, None, sent_ns, T0_NS + round(received_s * S))


def ran(seconds: float = 1.0, *, simulated: bool = False) -> Arrivals:
    """Return what a node had that has heard two topics until then; nothing waits.

    Simulated time is ten times as fast.
    """
    arrivals = Arrivals()
    for place in range(round(seconds / LOOK_S) + 1):
        now_s = place * LOOK_S
        found = [sent("wheels", now_s), sent("fixes", now_s)]
        if simulated:
            found.append(clock(now_s, 10.0 * now_s))
        arrivals.look(at(now_s, simulated=simulated), found)
    while arrivals.first is not None:
        arrivals.take()
    return arrivals


def released_s(arrivals: Arrivals, begin_s: float, *, simulated: bool = False) -> float:
    """Look without finding anything until all is released; return when."""
    for looks in itertools.count():
        now_s = begin_s + looks * LOOK_S
        arrivals.look(at(now_s, simulated=simulated), [])
        if arrivals.first is not None or arrivals.time_may_pass:
            return now_s
    raise AssertionError


def test_messages_come_at_once_and_in_the_order_of_sending() -> None:
    arrivals = ran()
    assert arrivals.time_may_pass
    arrivals.look(at(1.1), [sent("wheels", 1.05), sent("wheels", 1.09), sent("fixes", 1.07)])
    assert not arrivals.time_may_pass
    taken = [arrivals.take() for _ in range(3)]
    assert [each.message for each in taken] == [
        sent("wheels", 1.05), sent("fixes", 1.07), sent("wheels", 1.09)
    ]  # fmt: skip
    assert [each.ros_ns for each in taken] == [at(s + 0.001).ros_ns for s in (1.05, 1.07, 1.09)]
    assert arrivals.time_may_pass


def test_in_simulated_time_messages_come_at_the_time_that_was_sent_before_them() -> None:
    arrivals = ran(simulated=True)
    found = [sent("wheels", s) for s in (1.05, 1.07, 1.09)] + [clock(1.06, 17.0), clock(1.08, 16.0)]
    arrivals.look(at(1.1, simulated=True), found)
    taken = [arrivals.take() for _ in found]
    assert [each.message.topic for each in taken] == ["wheels", CLOCK, "wheels", CLOCK, "wheels"]
    assert [each.ros_ns for each in taken] == [10 * S, 17 * S, 17 * S, 16 * S, 16 * S]


def test_before_the_first_simulated_time_it_is_0() -> None:
    arrivals = Arrivals()
    arrivals.look(at(0.0, simulated=True), [sent("wheels", 0.0), clock(0.1, 5.0)])
    assert [arrivals.take().ros_ns for _ in range(2)] == [0, 5 * S]


def test_after_a_stop_each_message_comes_when_it_was_sent() -> None:
    """Also what comes later, one topic after the other."""
    arrivals = ran()
    arrivals.look(at(6.0), [])
    assert not arrivals.time_may_pass, "nothing was delivered yet"
    arrivals.look(at(6.1), [sent("wheels", s, 6.1) for s in (1.5, 3.0, 6.05)])
    assert arrivals.first is None
    arrivals.look(at(6.2), [sent("fixes", s, 6.2) for s in (1.2, 2.0, 6.15)])
    end_s = released_s(arrivals, 6.3)
    assert end_s == pytest.approx(6.2 + HELD_S, abs=0.5 * LOOK_S)
    taken = [arrivals.take() for _ in range(len(arrivals))]
    assert [each.message.topic[0] for each in taken] == list("fwfwwf")
    for each in taken:
        sent_s = (each.message.sent_ns - T0_NS) / S
        assert each.ros_ns == pytest.approx(at(sent_s).ros_ns, abs=2)
    assert arrivals.time_may_pass


def test_after_a_stop_simulated_time_passes_among_the_messages() -> None:
    arrivals = ran(simulated=True)
    arrivals.look(at(6.1, simulated=True), [clock(s, 10.0 * s, 6.1) for s in (2.0, 4.0, 6.0)])
    late = [sent("wheels", s, 6.2) for s in (1.5, 3.0, 5.0)]
    arrivals.look(at(6.2, simulated=True), late)
    released_s(arrivals, 6.3, simulated=True)
    taken = [arrivals.take() for _ in range(len(arrivals))]
    assert [each.ros_ns for each in taken] == [each * S for each in (10, 20, 20, 40, 40, 60)]


def test_a_clock_that_stands_ends_the_waiting_for_other_topics() -> None:
    """As that of a player that waits for the node: it sends nothing more before."""
    arrivals = ran(simulated=True)
    for looks in itertools.count():
        now_s = 6.0 + looks * LOOK_S
        arrivals.look(at(now_s, simulated=True), [clock(now_s, 12.0)])
        if arrivals.first is not None:
            break
    assert now_s == pytest.approx(6.0 + HELD_S, abs=LOOK_S)


def test_a_clock_that_goes_on_does_not_end_it() -> None:
    arrivals = ran(simulated=True)
    for looks in itertools.count():
        now_s = 6.0 + looks * LOOK_S
        arrivals.look(at(now_s, simulated=True), [clock(now_s, 10.0 * now_s)])
        if arrivals.first is not None:
            break
    assert now_s == pytest.approx(6.0 + LONGEST_HELD_S, abs=LOOK_S)


def test_a_topic_that_was_heard_before_is_waited_for_but_not_for_good() -> None:
    arrivals = ran()
    arrivals.look(at(6.0), [sent("wheels", 6.0)])
    assert released_s(arrivals, 6.1) == pytest.approx(6.0 + LONGEST_HELD_S, abs=LOOK_S)


def test_a_topic_that_gives_only_what_waited_before_the_stop_is_waited_for() -> None:
    """As a reliable topic does whose sender has not yet been asked for what is missing."""
    arrivals = ran()
    waited = [sent("wheels", 1.05, 6.0), sent("fixes", 1.05, 6.0), sent("wheels", 1.5, 6.0)]
    arrivals.look(at(6.0), waited)
    for place in range(1, 30):
        arrivals.look(at(6.0 + place * LOOK_S), [])
        assert arrivals.first is None
    late = [sent("wheels", s, 9.0) for s in (2.0, 4.0, 8.9)]
    arrivals.look(at(9.0), [*late, sent("fixes", 8.0, 9.0)])
    assert released_s(arrivals, 9.1) == pytest.approx(9.0 + HELD_S, abs=0.5 * LOOK_S)
    assert [arrivals.take().message.sent_ns for _ in range(len(arrivals))] == sorted(
        each.sent_ns for each in [*waited, *late, sent("fixes", 8.0)]
    )


def test_a_stop_soon_after_another_expects_what_was_held() -> None:
    """A topic whose messages were all held counts as heard."""
    arrivals = ran()
    arrivals.look(at(6.0), [sent("wheels", 6.0), sent("fixes", 6.0)])
    now_s = released_s(arrivals, 6.1)
    while arrivals.first is not None:
        arrivals.take()
    arrivals.look(at(now_s + 0.3), [sent("wheels", now_s + 0.3)])
    assert released_s(arrivals, now_s + 0.4) == pytest.approx(
        now_s + 0.3 + LONGEST_HELD_S, abs=LOOK_S
    )


def test_a_node_that_is_stopped_again_waits_for_what_is_sent_after_that() -> None:
    arrivals = ran()
    arrivals.look(at(6.0), [sent("wheels", 6.0), sent("fixes", 6.0)])
    arrivals.look(at(7.0), [sent("wheels", 6.2), sent("fixes", 6.2)])
    for place in range(1, 15):
        arrivals.look(at(7.0 + place * LOOK_S), [])
        assert arrivals.first is None
    arrivals.look(at(8.5), [sent("wheels", 8.4), sent("fixes", 8.4)])
    assert arrivals.first is not None


def test_nothing_is_expected_where_nothing_was_heard() -> None:
    arrivals = Arrivals()
    arrivals.look(at(0.0), [])
    arrivals.look(at(6.0), [])
    assert released_s(arrivals, 6.1) == pytest.approx(6.0 + HELD_S, abs=0.5 * LOOK_S)


def test_a_clock_of_a_sender_that_is_off_does_not_matter() -> None:
    """By a minute: what a topic's messages seemed to take before the stop is what it is off."""
    skew_ns = 60 * S
    arrivals = Arrivals()
    for place in range(11):
        message = sent("wheels", place * LOOK_S)
        arrivals.look(at(place * LOOK_S), [message._replace(sent_ns=message.sent_ns - skew_ns)])
        arrivals.take()
    late = [sent("wheels", sent_s, 6.0) for sent_s in (2.0, 4.0)]
    arrivals.look(at(6.0), [each._replace(sent_ns=each.sent_ns - skew_ns) for each in late])
    released_s(arrivals, 6.1)
    assert [arrivals.take().ros_ns for _ in late] == [at(2.001).ros_ns, at(4.001).ros_ns]


def test_one_stop_after_the_other_does_not_hold_the_time_for_good() -> None:
    arrivals = ran()
    now_s, began_s = 1.0, 1.0 + 0.4
    while now_s < 60.0:
        now_s += 0.4
        arrivals.look(at(now_s), [sent("wheels", now_s - 0.3, now_s), sent("fixes", now_s)])
        if arrivals.first is not None:
            break
    assert now_s - began_s < LONGEST_HELD_S + 1.0


def test_a_node_that_keeps_up_leaves_nothing_out() -> None:
    arrivals = ran()
    arrivals.look(at(6.0), [])
    found = [
        sent(topic, 1.0 + place / 10, 6.0) for place in range(50) for topic in ("wheels", "fixes")
    ]
    arrivals.look(at(6.05), found)
    now_s = released_s(arrivals, 6.1)
    while len(arrivals):
        assert arrivals.shed(now_s, ("fixes",)) == 0
        for _ in range(min(5, len(arrivals))):
            arrivals.take()
        now_s += LOOK_S


def test_a_node_that_is_too_slow_leaves_readings_out_and_never_wheels() -> None:
    """Of 20 messages in a look it takes 10: the lag stays bounded."""
    arrivals = ran()
    shed, worst_s, wheels = 0, 0.0, 0
    for place in range(600):
        now_s = 1.1 + place * LOOK_S
        arrivals.look(
            at(now_s),
            [sent("wheels", now_s)] * 2 + [sent("fixes", now_s)] * 18,
        )
        shed += arrivals.shed(now_s, ("fixes",))
        for _ in range(min(10, len(arrivals))):
            wheels += arrivals.take().message.topic == "wheels"
        if arrivals.first is not None:
            worst_s = max(worst_s, (round(now_s * S) + S - arrivals.first.ros_ns) / S)
    wheels += sum(arrivals.take().message.topic == "wheels" for _ in range(len(arrivals)))
    assert shed > 1000
    assert wheels == 1200
    assert worst_s < 2.0 * (LAG_S + CATCHING_UP_S)


def test_looks_count_and_not_time_alone() -> None:
    """A node that is stopped again makes no looks: its queues may be as full as before."""
    arrivals = ran()
    arrivals.look(at(2.0), [sent("wheels", 2.0), sent("fixes", 2.0)])
    for looks in range(1, HELD_LOOKS - 1):
        arrivals.look(at(2.0 + looks * 0.24), [])
        assert arrivals.first is None, looks
    arrivals.look(at(2.0 + (HELD_LOOKS - 1) * 0.24), [])
    assert arrivals.first is not None
