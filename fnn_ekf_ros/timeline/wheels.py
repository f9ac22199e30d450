# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Encoder readings as continuous counts that are known at any instant.

A reading that would mean a wheel faster than `max_wheel_speed` is a controller's reset or a
glitch, and no motion. The next reading decides: if it continues the jump, counting goes on
from the new base; if it is back where the wheel was before, the base never changed and the
distance in between is counted. A reset thus loses the distance of one interval. A single corrupt
reading loses none; its distance is counted one interval late.

The distance that may be motion grows with time, so after a silence even a jump to 0 may be slow
enough. But a controller that restarts is silent and then starts at 0, and a driving wheel is
seldom found just there. After a silence a reading near 0 is therefore taken for a restart,
whatever speed it would mean. Any other one is motion if it is slow enough: messages were lost. The
distance before a restart is unknown.

The counts are a function of the readings alone, not of the order in which stamped ones arrive: a
late one is put in its place, and the readings after it are evaluated again. Of readings with one
stamp two are kept, which decide the counts before and after it: the smallest and the greatest one;
where they are stamped on arrival, the first and the last one.
"""

from bisect import bisect_left, bisect_right
from typing import NamedTuple

ARRIVAL_SLACK_S = 0.1
"""Longest stall of the machine or the network between two readings that are stamped on arrival
[s]: they come in bursts, which shorten the time between their stamps."""
STAMP_SLACK_S = 0.02
"""Largest error of a driver's stamps [s]: one cycle of its loop, as it may read the encoders before
or after the clock; 50 Hz is the slowest loop that is common."""
SILENCE_NS = 10**9
"""Time without a reading from which on a reading near 0 is a restart [ns]: a controller hardly
restarts in less, and the slowest encoders send more often."""

MOST_KEPT = 10_000
"""Largest number of readings of one sensor or wheel that are kept: those of 1 kHz in the longest
`history`, 10 s. Of more, every other one is dropped, so that memory and the work for a message stay
bounded whatever comes, also while the clock stands still."""


class BufferChange(NamedTuple):
    """Change of a buffer by an event.

    Attributes:
        changed_ns: first instant at which the inputs are different now [ns]; None: a duplicate.
        out_of_order: whether the buffer held a later event of the same kind.
        jump: difference of a wheel's reading from the last accepted one if it is too large for
            motion; otherwise 0 [counts].
        silent_ns: time without readings before a jump that followed a silence; otherwise 0 [ns].
        left_out: readings of a sensor that were dropped because there were too many.
    """

    changed_ns: int | None
    out_of_order: bool = False
    jump: float = 0.0
    silent_ns: int = 0
    left_out: int = 0


class _Jumped(NamedTuple):
    """A reading that is too far from the one before it for motion.

    Attributes:
        stamp_ns: its stamp [ns].
        value: the reading, unwrapped [counts].
    """

    stamp_ns: int
    value: int | float


class _Unwrapped(NamedTuple):
    """The count of a wheel after a reading.

    Attributes:
        stamp_ns: of the last accepted reading [ns].
        value: that reading, unwrapped [counts].
        base: the value at which the count is zero [counts].
        jumped: the reading after it, if that one jumped.
    """

    stamp_ns: int
    value: int | float
    base: int | float
    jumped: _Jumped | None

    def counted(self) -> int | float:
        return self.value - self.base

    def moved(self, by_ns: int) -> "_Unwrapped":
        jumped = self.jumped
        if jumped is not None:
            jumped = jumped._replace(stamp_ns=jumped.stamp_ns + by_ns)
        return self._replace(stamp_ns=self.stamp_ns + by_ns, jumped=jumped)


class UnwrappedWheel:
    """Counts of one wheel, unwrapped and without jumps.

    Args:
        modulus: counts at which the counter wraps, 2^bits; None for a position that does not.
        stamped: whether the readings carry stamps of their own: then they may come in any order,
            and of two with the same stamp the greater counts from then on. Readings that are
            stamped on arrival keep their order even where the clock goes back.
        fastest: counts a second that are still motion.
        resolution: by how much a wheel at rest may seem to move [counts].
    """

    def __init__(
        self, modulus: int | None, *, stamped: bool, fastest: float, resolution: float
    ) -> None:
        self._modulus = modulus
        self._stamped = stamped
        self._fastest = fastest
        self._slack = fastest * (STAMP_SLACK_S if stamped else ARRIVAL_SLACK_S) + resolution
        self._anchor: int | float | None = None
        self._stamps: list[int] = []
        self._raw: list[int | float] = []
        self._unwrapped: list[_Unwrapped] = []

    @property
    def first_stamp_ns(self) -> int | None:
        """Time of the oldest reading that is kept [ns]; None without any."""
        return self._stamps[0] if self._stamps else None

    @property
    def last_stamp_ns(self) -> int | None:
        """Time of the newest reading [ns]; None without any."""
        return self._stamps[-1] if self._stamps else None

    def add(self, stamp_ns: int, raw: int | float) -> BufferChange:
        """Take a reading in."""
        stamps = self._stamps
        place = len(stamps)
        crowded = False
        if place and stamp_ns <= stamps[-1]:
            if self._stamped:
                found = self._place_for(stamp_ns, raw)
                if found is None:
                    return BufferChange(None)
                place = found
            else:
                stamp_ns = stamps[-1]
                crowded = place > 1 and stamps[-2] == stamp_ns
        if self._anchor is None:
            # Counts are small integers where counting begins, wherever that is: exact, and the
            # same as of a counter that started at 0. Positions are taken as they are.
            self._anchor = 0.0 if self._modulus is None else raw
        before = self._unwrapped[place - 1] if place else None
        unwrapped = self._after(before, stamp_ns, raw)
        if crowded:
            self._delete(slice(place - 1, place))
            place -= 1
        stamps.insert(place, stamp_ns)
        self._raw.insert(place, raw)
        self._unwrapped.insert(place, unwrapped)
        out_of_order = place < len(stamps) - 1
        if out_of_order:
            self._evaluate_again_from(place + 1)
        known_ns = stamps[place - 1] if place else stamp_ns - 1
        if len(stamps) > MOST_KEPT:
            self._delete(slice(1, -1, 2))
        changed_ns = known_ns + 1
        if before is None or unwrapped.jumped is None:
            return BufferChange(changed_ns, out_of_order)
        jump = float(unwrapped.jumped.value - before.value)
        silent_ns = stamp_ns - known_ns
        return BufferChange(
            changed_ns=changed_ns,
            out_of_order=out_of_order,
            jump=jump,
            silent_ns=silent_ns if silent_ns > SILENCE_NS else 0,
        )

    def at(self, stamp_ns: int) -> float:
        """Return the count at an instant, linear between readings, held beyond them."""
        place = bisect_right(self._stamps, stamp_ns)
        if not self._stamps:
            return 0.0
        if place == 0:
            return float(self._unwrapped[0].counted())
        if place == len(self._stamps) or self._stamps[place - 1] == stamp_ns:
            return float(self._unwrapped[place - 1].counted())
        t0, t1 = self._stamps[place - 1], self._stamps[place]
        c0, c1 = self._unwrapped[place - 1].counted(), self._unwrapped[place].counted()
        return c0 + (c1 - c0) * ((stamp_ns - t0) / (t1 - t0))

    def heard_ns(self, stamp_ns: int) -> int | None:
        """Return the time of the last reading up to an instant [ns]; None before the first."""
        place = bisect_right(self._stamps, stamp_ns)
        return self._stamps[place - 1] if place else None

    def forget_before(self, stamp_ns: int) -> None:
        """Drop the readings that no instant from `stamp_ns` on needs."""
        first = bisect_right(self._stamps, stamp_ns) - 1
        if first > 64:  # in slabs: deleting from the front of a list moves all of it
            self._delete(slice(first))

    def move(self, by_ns: int) -> None:
        """Move all readings in time [ns], as the clock was set."""
        self._stamps = [stamp_ns + by_ns for stamp_ns in self._stamps]
        self._unwrapped = [each.moved(by_ns) for each in self._unwrapped]

    def _delete(self, which: slice) -> None:
        del self._stamps[which], self._raw[which], self._unwrapped[which]

    def _place_for(self, stamp_ns: int, raw: int | float) -> int | None:
        """Make room for a stamped reading and return its place; None if it says nothing new."""
        first = bisect_left(self._stamps, stamp_ns)
        last = bisect_right(self._stamps, stamp_ns, first)
        if first == last:
            return first
        if self._raw[first] <= raw <= self._raw[last - 1]:
            return None
        place = first if raw < self._raw[first] else last - 1
        if last - first > 1:
            self._delete(slice(place, place + 1))
            return place
        return first if raw < self._raw[first] else last

    def _evaluate_again_from(self, place: int) -> None:
        for later in range(place, len(self._stamps)):
            before = self._unwrapped[later - 1]
            unwrapped = self._after(before, self._stamps[later], self._raw[later])
            if unwrapped == self._unwrapped[later]:
                return
            self._unwrapped[later] = unwrapped

    def _after(self, before: _Unwrapped | None, stamp_ns: int, raw: int | float) -> _Unwrapped:
        """Return the count after a reading that follows."""
        if before is None:
            assert self._anchor is not None
            return _Unwrapped(
                stamp_ns=stamp_ns,
                value=self._near(self._anchor, raw),
                base=self._anchor,
                jumped=None,
            )
        value = self._near(before.value, raw)
        if before.jumped is None and abs(value - before.value) <= self._slack:  # most readings
            return _Unwrapped(stamp_ns=stamp_ns, value=value, base=before.base, jumped=None)
        strange = self._strangeness(before.value, value, stamp_ns - before.stamp_ns)
        if before.jumped is not None:
            jumped = before.jumped
            continued = self._near(jumped.value, raw)
            fits = self._strangeness(jumped.value, continued, stamp_ns - jumped.stamp_ns)
            if fits < min(strange, 1.0):
                return _Unwrapped(
                    stamp_ns=stamp_ns,
                    value=continued,
                    base=jumped.value - before.counted(),
                    jumped=None,
                )
        if strange <= 1.0:
            return _Unwrapped(stamp_ns=stamp_ns, value=value, base=before.base, jumped=None)
        return before._replace(jumped=_Jumped(stamp_ns, value))

    def _near(self, value: int | float, raw: int | float) -> int | float:
        """Return the reading, unwrapped to what is nearest to a value."""
        if self._modulus is None:
            return raw
        half = self._modulus // 2
        return value + (raw - value + half) % self._modulus - half

    def _strangeness(self, before: float, value: float, time_ns: int) -> float:
        """Return a change as a part of what may be motion."""
        limit = self._slack
        if time_ns <= SILENCE_NS or self._is_near_0(before) or not self._is_near_0(value):
            limit += self._fastest * time_ns * 1e-9
        return abs(value - before) / limit

    def _is_near_0(self, value: int | float) -> bool:
        """Return whether a counter that has just started to count may show a value."""
        return abs(self._near(0, value)) <= self._slack
