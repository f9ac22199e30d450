# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Due times of the messages of a recording."""

import math
import time
from collections.abc import Callable


class Timetable:
    """Plays at a rate, and never further ahead of a listener than a lead.

    Until the listener's first stamp, the rate is at most 1, because it is not known yet whether it
    keeps up. Time that was spent waiting for it is not made up for later.

    Args:
        rate: times real time, at most.
        lead_ns: largest lead over the newest stamp of the listener [ns]; None: there is no
            listener.
        now_s: returns a steady wall time [s].
    """

    def __init__(
        self, rate: float, lead_ns: int | None, now_s: Callable[[], float] = time.monotonic
    ) -> None:
        self._rate, self._lead_ns, self._now_s = rate, lead_ns, now_s
        self.start(0)

    def start(self, first_ns: int) -> None:
        """Begin the recording at the time of its first message [ns]; no stamp is known yet."""
        self.played_ns = first_ns
        self.heard_ns: int | None = None
        self._anchor()

    def played(self, time_ns: int) -> None:
        """Record that everything up to a time [ns] has been played."""
        self.played_ns = time_ns

    def heard(self, stamp_ns: int) -> bool:
        """Take a stamp [ns] of the listener; return whether it is new.

        A stamp after what was played dates from before the recording was started again.
        """
        if stamp_ns > self.played_ns or stamp_ns <= (self.heard_ns or 0):
            return False
        if self.heard_ns is None:
            self._anchor()
        self.heard_ns = stamp_ns
        return True

    def held(self, due_ns: int) -> bool:
        """Return whether a time [ns] is too far ahead of the listener."""
        if self._lead_ns is None or self.heard_ns is None:
            return False
        return due_ns > self.heard_ns + self._lead_ns

    def wait_s(self, due_ns: int) -> float:
        """Return how long it is until a time [ns] is due [s]; infinity while it is held."""
        if self.held(due_ns):
            self._anchor()
            return math.inf
        rate = self._rate
        if self._lead_ns is not None and self.heard_ns is None:
            rate = min(rate, 1.0)
        due_s = (due_ns - self._anchor_ns) * 1e-9 / rate
        return max(0.0, due_s - (self._now_s() - self._anchor_s))

    def _anchor(self) -> None:
        self._anchor_ns, self._anchor_s = self.played_ns, self._now_s()
