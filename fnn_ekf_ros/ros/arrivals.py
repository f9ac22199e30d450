# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Messages in the order in which they were sent, each with the time at which it came.

A node that was stopped, or got no share of the processor, finds its queues full and a clock that
has gone on. The messages are older than that: each is taken at the ROS time at which it was sent,
so that no period is closed before what belongs to it was taken. The middleware delivers what waited
only while the node runs again, one topic after the other, and what it has dropped seconds later, if
a reliable subscription asks for it. So nothing is taken, and no time passes, before some looks in a
row have found nothing that had waited, and each topic has given a message that was sent after the
stop: of one topic, messages are delivered in the order of sending.

Simulated time passes with messages of its own, which wait beside the others: a message comes at the
time that was sent before it. A clock that stands, as that of a player that waits for this node,
ends the waiting for what is sent after a stop.

Nothing here knows ROS: a look is made with what was found and the time at which.
"""

from collections import deque
from collections.abc import Collection, Sequence
from typing import Any, NamedTuple

from fnn_ekf_ros.messages import CLOCK

STALL_S = 0.25
"""Steady time between two looks from which on the node was stopped [s]: well above the interval of
looks, and below the default `encoder_timeout`, after which periods end without the wheels."""
HELD_S = 0.5
"""Steady time without old messages after which everything that waited has been delivered [s]: the
middleware takes a tenth of it on a busy machine."""
HELD_LOOKS = 4
"""Number of looks that have to be made in that time: a node that is stopped again makes none."""
LONGEST_HELD_S = 4.0
"""Longest time for which messages are held after a stop, while a topic is silent or gives old ones
[s]. A reliable one of Fast DDS may be silent for 3 s, the interval at which its sender asks what is
missing. Neither a sender's wrong clock nor one stop after the other holds the time for longer."""
SAME_MACHINE_NS = 20 * 10**6
"""Smallest delay of a topic that is taken for an offset of its sender's clock [ns]: below it topics
keep the order in which they were sent."""
FORGOTTEN_NS = 10**6
"""Growth of a topic's smallest delay with each message [ns], so that a clock may be set."""
LAST_HEARD_S = 1.0
"""Steady time before a stop in which a topic was heard if it is expected afterwards [s]."""
LAG_S = 1.0
"""Time for which a message may wait in here until the node counts as being behind [s]."""
CATCHING_UP_S = 5.0
"""Shortest time in which a node that is behind may catch up before readings are left out [s]; it
has as much as it is behind. One that is twice as fast as its inputs makes it after any stop."""


class Message(NamedTuple):
    """A message as the middleware gave it.

    Attributes:
        topic: of the localizer, or `CLOCK`.
        content: the message; of `CLOCK` the simulated time [ns].
        sent_ns: time of its sender's system clock [ns]; 0 if it is not known.
        received_ns: system time at which it reached the process [ns]; 0 if it is not known.
    """

    topic: str
    content: Any
    sent_ns: int
    received_ns: int


class Moment(NamedTuple):
    """The clocks at a look.

    Attributes:
        steady_s: steady time [s].
        system_ns: system time [ns], with which messages are marked.
        ros_ns: ROS time, where it is that of the system [ns]; None: it comes as messages.
    """

    steady_s: float
    system_ns: int
    ros_ns: int | None


class Arrival(NamedTuple):
    """A message with the ROS time at which it came [ns], in the order of coming.

    Simulated time is 0 before the first message of it.
    """

    ros_ns: int
    message: Message


class _Stop(NamedTuple):
    """A time in which the node did not run.

    Attributes:
        before: the last look before it.
        over_ns: system time of the first look after it [ns].
        expected: topics that were heard shortly before it.
        missing: those of them that have given no message yet that was sent after it.
        quiet_s: steady time since which no old message was found [s].
        looks: number of looks since then.
        clock_ns: the newest simulated time that was sent [ns]; 0 if there is none.
        ran_s: steady time since which it stands [s].
        until_s: steady time at which it counts as over in any case [s].
    """

    before: Moment
    over_ns: int
    expected: frozenset[str]
    missing: frozenset[str]
    quiet_s: float
    looks: int
    clock_ns: int
    ran_s: float
    until_s: float


class Arrivals:
    """The messages that wait to be taken."""

    def __init__(self) -> None:
        self._waiting: deque[Arrival] = deque()
        self._held: list[Message] = []
        self._last: Moment | None = None
        self._stop: _Stop | None = None
        self._delay_ns: dict[str, int] = {}
        self._heard_s: dict[str, float] = {}
        self._simulated_ns = 0
        self._late_after_s: float | None = None

    def look(self, moment: Moment, found: Sequence[Message]) -> None:
        """Take in what a look has found."""
        if self._last is not None and self.stopped(moment.steady_s):
            self._stop = self._stopped_before(moment, self._last)
        last, self._last = self._last, moment
        self._heard_s.update((message.topic, moment.steady_s) for message in found)
        if self._stop is not None:
            self._hold(self._stop, moment, found)
            return
        for message in found:
            if message.sent_ns and message.received_ns:
                delay_ns = message.received_ns - message.sent_ns
                known_ns = self._delay_ns.get(message.topic, delay_ns)
                self._delay_ns[message.topic] = min(delay_ns, known_ns + FORGOTTEN_NS)
        came_ns = 0 if last is None or last.ros_ns is None else last.ros_ns
        for message in sorted(found, key=self._came_ns):
            if moment.ros_ns is None:
                came_ns = self._simulated(message)
            else:
                received_ns = moment.ros_ns
                if last is not None and message.received_ns:
                    received_ns -= max(moment.system_ns - message.received_ns, 0)
                came_ns = min(max(came_ns, received_ns), moment.ros_ns)
            self._waiting.append(Arrival(came_ns, message))

    def _simulated(self, message: Message) -> int:
        """Return the simulated time at which a message comes, in the order of sending [ns]."""
        if message.topic == CLOCK:
            self._simulated_ns = int(message.content)
        return self._simulated_ns

    def _stopped_before(self, moment: Moment, last: Moment) -> _Stop:
        """Return the stop that is over now; it goes on where the node was stopped in it again."""
        if self._stop is not None:
            return self._stop._replace(
                over_ns=moment.system_ns, missing=self._stop.expected, looks=0
            )
        since_s = last.steady_s - LAST_HEARD_S
        expected = frozenset(topic for topic, at_s in self._heard_s.items() if at_s > since_s)
        return _Stop(
            before=last,
            over_ns=moment.system_ns,
            expected=expected,
            missing=expected,
            quiet_s=moment.steady_s,
            looks=0,
            clock_ns=0,
            ran_s=moment.steady_s,
            until_s=moment.steady_s + LONGEST_HELD_S,
        )

    def _hold(self, stop: _Stop, moment: Moment, found: Sequence[Message]) -> None:
        """Hold what was found after a stop; let all of it be taken once all was delivered."""
        self._held += found
        old_ns = moment.system_ns - round(0.5e9 * STALL_S)
        if any(self._came_ns(message) < old_ns for message in found):
            stop = stop._replace(quiet_s=moment.steady_s, looks=0)
        else:
            stop = stop._replace(looks=stop.looks + 1)
        new = {message.topic for message in found if self._came_ns(message) >= stop.over_ns}
        clock_ns = max((each.content for each in found if each.topic == CLOCK), default=0)
        if clock_ns > stop.clock_ns:
            stop = stop._replace(clock_ns=clock_ns, ran_s=moment.steady_s)
        self._stop = stop = stop._replace(missing=stop.missing - new)
        delivered = moment.steady_s - stop.quiet_s >= HELD_S and stop.looks >= HELD_LOOKS
        stands = moment.ros_ns is None and moment.steady_s - stop.ran_s >= HELD_S
        is_over = delivered and (stands or not stop.missing)
        if is_over or moment.steady_s >= stop.until_s:
            self._release(stop.before, moment)

    def _release(self, before: Moment, now: Moment) -> None:
        """Let what was held during a stop be taken, each message at its time."""
        for message in sorted(self._held, key=self._came_ns):
            if now.ros_ns is None or before.ros_ns is None:
                came_ns = self._simulated(message)
            else:
                came_ns = _at(self._came_ns(message), before, now)
            self._waiting.append(Arrival(came_ns, message))
        self._held, self._stop = [], None

    def _came_ns(self, message: Message) -> int:
        """Return the system time at which a message would have come without the stop [ns]."""
        offset_ns = self._delay_ns.get(message.topic, 0)
        return message.sent_ns + (offset_ns if abs(offset_ns) > SAME_MACHINE_NS else 0)

    def stopped(self, steady_s: float) -> bool:
        """Return whether the node has not run for a while before a steady time [s]."""
        return self._last is not None and steady_s - self._last.steady_s > STALL_S

    @property
    def time_may_pass(self) -> bool:
        """Whether everything that came so far was taken, as far as that can be known."""
        return not self._waiting and self._stop is None

    @property
    def first(self) -> Arrival | None:
        """The message that came first; None if none waits."""
        return self._waiting[0] if self._waiting else None

    def __len__(self) -> int:
        """Return how many messages are here."""
        return len(self._waiting) + len(self._held)

    def take(self) -> Arrival:
        """Return the message that came first; it waits no longer."""
        return self._waiting.popleft()

    def shed(self, steady_s: float, topics: Collection[str]) -> int:
        """Drop messages if they come faster than they are taken; return how many.

        Args:
            steady_s: steady time [s].
            topics: of which messages may be left out.
        """
        lag_s = self._lag_s()
        if lag_s < LAG_S:
            self._late_after_s = None
            return 0
        if self._late_after_s is None:
            self._late_after_s = steady_s + max(lag_s, CATCHING_UP_S)
        if steady_s < self._late_after_s:
            return 0
        before = len(self._waiting)
        self._waiting = deque(each for each in self._waiting if each.message.topic not in topics)
        self._late_after_s = None
        return before - len(self._waiting)

    def _lag_s(self) -> float:
        """Return how long the first message has been waiting [s], in ROS time."""
        if self._last is None or not self._waiting:
            return 0.0
        now_ns = self._last.ros_ns
        if now_ns is None:
            now_ns = self._simulated_ns
        return (now_ns - self._waiting[0].ros_ns) * 1e-9


def _at(system_ns: int, before: Moment, now: Moment) -> int:
    """Return the ROS time at a system time [ns] between two moments."""
    assert before.ros_ns is not None
    assert now.ros_ns is not None
    past_ns = now.system_ns - before.system_ns
    if past_ns <= 0:  # the clock was set back meanwhile
        return now.ros_ns
    part = min(max((system_ns - before.system_ns) / past_ns, 0.0), 1.0)
    return before.ros_ns + round(part * (now.ros_ns - before.ros_ns))
