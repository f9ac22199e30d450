"""Encoder readings as a continuous track that can be asked for any instant.

A reading that would mean a wheel faster than `max_wheel_speed` is a controller's reset or a
glitch, and no motion. Which of the two shows with the next reading: if that one continues the
jump, counting goes on from the new base; if it is back where the wheel was before, the base never
changed and the way in between is counted. So a reset costs the way of one interval, and a single
corrupt reading none, it only comes one interval late.

Time buys way, so after a silence even a jump to 0 is slow enough to be motion; but that is how a
controller restarts: silent, then 0. A wheel that drives is seldom found just there, so after a
silence such a reading is taken for a restart, whatever speed it would mean. Any other one is motion
if it is slow enough: messages were lost. What the wheel did before a restart nobody has counted.

The track is a function of its readings alone, not of the order in which stamped ones arrive: a
late one is put in its place, and what follows is gone through again.
"""

from bisect import bisect_left, bisect_right
from typing import NamedTuple

ARRIVAL_SLACK_S = 0.1
"""Readings that are stamped on arrival come in bursts, which squeeze the time between them: so
long a stall of the machine or the network may lie between two readings [s]."""
STAMP_SLACK_S = 0.02
"""Stamps of a driver are off by up to a cycle of its loop, depending on whether it reads the
encoders before or after the clock: a cycle of 50 Hz, the slowest that is common [s]."""
SILENCE_NS = 10**9
"""In less time hardly a controller restarts, and the slowest encoders speak more often [ns]."""


class Addition(NamedTuple):
    """What a reading changed.

    Attributes:
        changed_ns: from when on the past looks different [ns]; None: it was there already.
        out_of_order: whether a later one of its kind was there already.
        jump: by how much a wheel's differs from the one believed before if that is too much to be
            motion; otherwise 0 [counts].
        silent_ns: how long before it nothing was heard if it jumped after a silence; otherwise 0
            [ns].
    """

    changed_ns: int | None
    out_of_order: bool = False
    jump: float = 0.0
    silent_ns: int = 0


class _Belief(NamedTuple):
    """How far a wheel is known to have turned after a reading.

    Attributes:
        stamp_ns: of the last reading that was believed [ns].
        value: that reading, unwrapped.
        base: the value at which the count is zero.
        suspect: stamp and unwrapped value of the reading after it, if that jumped.
    """

    stamp_ns: int
    value: int | float
    base: int | float
    suspect: tuple[int, int | float] | None

    def counted(self) -> int | float:
        return self.value - self.base


class WheelTrack:
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
        self._beliefs: list[_Belief] = []

    @property
    def first_stamp_ns(self) -> int | None:
        """Time of the oldest reading that is kept [ns]; None without any."""
        return self._stamps[0] if self._stamps else None

    @property
    def last_stamp_ns(self) -> int | None:
        """Time of the newest reading [ns]; None without any."""
        return self._stamps[-1] if self._stamps else None

    def add(self, stamp_ns: int, raw: int | float) -> Addition:
        """Take a reading in."""
        stamps = self._stamps
        place = len(stamps)
        if place and stamp_ns <= stamps[-1]:
            if not self._stamped:
                stamp_ns = stamps[-1]
            else:
                place = bisect_right(stamps, stamp_ns)
                first = bisect_left(stamps, stamp_ns)
                if raw in self._raw[first:place]:
                    return Addition(None)
                place = bisect_left(self._raw, raw, first, place)
        if self._anchor is None:
            # Counts are small integers where counting begins, wherever that is: exact, and the
            # same as of a counter that started at 0. Positions are taken as they are.
            self._anchor = 0.0 if self._modulus is None else raw
        before = self._beliefs[place - 1] if place else None
        belief = self._after(before, stamp_ns, raw)
        stamps.insert(place, stamp_ns)
        self._raw.insert(place, raw)
        self._beliefs.insert(place, belief)
        out_of_order = place < len(stamps) - 1
        if out_of_order:
            self._go_through_again_from(place + 1)
        changed_ns = stamps[place - 1] + 1 if place else stamp_ns
        if before is None or belief.suspect is None:
            return Addition(changed_ns, out_of_order)
        jump = float(belief.suspect[1] - before.value)
        silent_ns = stamp_ns - stamps[place - 1]
        return Addition(changed_ns, out_of_order, jump, silent_ns if silent_ns > SILENCE_NS else 0)

    def at(self, stamp_ns: int) -> float:
        """Return the count at an instant, linear between readings, held beyond them."""
        place = bisect_right(self._stamps, stamp_ns)
        if not self._stamps:
            return 0.0
        if place == 0:
            return float(self._beliefs[0].counted())
        if place == len(self._stamps) or self._stamps[place - 1] == stamp_ns:
            return float(self._beliefs[place - 1].counted())
        t0, t1 = self._stamps[place - 1], self._stamps[place]
        c0, c1 = self._beliefs[place - 1].counted(), self._beliefs[place].counted()
        return c0 + (c1 - c0) * ((stamp_ns - t0) / (t1 - t0))

    def heard_ns(self, stamp_ns: int) -> int | None:
        """Return the time of the last reading up to an instant [ns]; None before the first."""
        place = bisect_right(self._stamps, stamp_ns)
        return self._stamps[place - 1] if place else None

    def forget_before(self, stamp_ns: int) -> None:
        """Drop the readings that no instant from `stamp_ns` on needs."""
        first = bisect_right(self._stamps, stamp_ns) - 1
        if first > 64:  # in slabs: deleting from the front of a list moves all of it
            del self._stamps[:first], self._raw[:first], self._beliefs[:first]

    def _go_through_again_from(self, place: int) -> None:
        for later in range(place, len(self._stamps)):
            belief = self._after(self._beliefs[later - 1], self._stamps[later], self._raw[later])
            if belief == self._beliefs[later]:
                return
            self._beliefs[later] = belief

    def _after(self, before: _Belief | None, stamp_ns: int, raw: int | float) -> _Belief:
        """Return what is believed after a reading that follows."""
        if before is None:
            assert self._anchor is not None
            return _Belief(stamp_ns, self._near(self._anchor, raw), self._anchor, None)
        value = self._near(before.value, raw)
        if before.suspect is None and abs(value - before.value) <= self._slack:  # most readings
            return _Belief(stamp_ns, value, before.base, None)
        strange = self._strangeness(before.value, value, stamp_ns - before.stamp_ns)
        if before.suspect is not None:
            suspect_ns, suspected = before.suspect
            continued = self._near(suspected, raw)
            fits = self._strangeness(suspected, continued, stamp_ns - suspect_ns)
            if fits < min(strange, 1.0):
                return _Belief(stamp_ns, continued, suspected - before.counted(), None)
        if strange <= 1.0:
            return _Belief(stamp_ns, value, before.base, None)
        return before._replace(suspect=(stamp_ns, value))

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
