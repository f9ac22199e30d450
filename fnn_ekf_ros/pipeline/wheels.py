"""Encoder readings as a continuous track that can be asked for any instant."""

from bisect import bisect_right


class WheelTrack:
    """Counts of one wheel, unwrapped and relative to the first reading.

    Args:
        modulus: counts at which the counter wraps, 2^bits; None for a position that does not.
    """

    def __init__(self, modulus: int | None) -> None:
        self._modulus = modulus
        self._stamps: list[int] = []
        self._counts: list[int | float] = []
        self._raw: list[int | float] = []

    @property
    def first_stamp_ns(self) -> int | None:
        """Time of the oldest reading that is kept [ns]; None without any."""
        return self._stamps[0] if self._stamps else None

    @property
    def last_stamp_ns(self) -> int | None:
        """Time of the newest reading [ns]; None without any."""
        return self._stamps[-1] if self._stamps else None

    def add(self, stamp_ns: int, raw: int | float) -> int:
        """Take a reading in; of two at the same time the later counts from then on.

        Returns:
            From when on the track has changed [ns]: just after the reading before.
        """
        if not self._stamps:
            self._insert(0, stamp_ns, 0, raw)
            return stamp_ns
        place = bisect_right(self._stamps, stamp_ns)
        neighbour = max(place - 1, 0)
        change = raw - self._raw[neighbour]
        if self._modulus is not None:
            half = self._modulus // 2
            change = (change + half) % self._modulus - half
        self._insert(place, stamp_ns, self._counts[neighbour] + change, raw)
        return self._stamps[place - 1] + 1 if place else stamp_ns

    def at(self, stamp_ns: int) -> float:
        """Return the count at an instant, linear between readings, held beyond them."""
        place = bisect_right(self._stamps, stamp_ns)
        if not self._stamps:
            return 0.0
        if place == 0:
            return float(self._counts[0])
        if place == len(self._stamps) or self._stamps[place - 1] == stamp_ns:
            return float(self._counts[place - 1])
        t0, t1 = self._stamps[place - 1], self._stamps[place]
        c0, c1 = self._counts[place - 1], self._counts[place]
        return c0 + (c1 - c0) * ((stamp_ns - t0) / (t1 - t0))

    def forget_before(self, stamp_ns: int) -> None:
        """Drop the readings that no instant from `stamp_ns` on needs."""
        first = bisect_right(self._stamps, stamp_ns) - 1
        if first > 64:  # in slabs: deleting from the front of a list moves all of it
            del self._stamps[:first], self._counts[:first], self._raw[:first]

    def _insert(self, place: int, stamp_ns: int, count: int | float, raw: int | float) -> None:
        self._stamps.insert(place, stamp_ns)
        self._counts.insert(place, count)
        self._raw.insert(place, raw)
