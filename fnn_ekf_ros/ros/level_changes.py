"""Which statuses are worth a line in the log: those that got better or worse, once in a while."""

import math
from collections.abc import Sequence

from fnn_ekf_ros.pipeline.events import Level, Status


class LevelChanges:
    """Remembers what the log has last said of each status.

    A change that comes too soon to be logged stays one: what lasts is logged in the end.

    Args:
        interval_s: a status is not logged twice at the same level in less time [s].
    """

    def __init__(self, interval_s: float) -> None:
        self._interval_s = interval_s
        self._told: dict[str, Level] = {}
        self._told_s: dict[tuple[str, Level], float] = {}

    def worth_a_line(self, statuses: Sequence[Status], now_s: float) -> list[Status]:
        """Return the statuses to log now [s]; they count as logged."""
        found = []
        for status in statuses:
            key = status.name, status.level
            if status.level == self._told.get(status.name, Level.OK):
                continue
            if now_s - self._told_s.get(key, -math.inf) < self._interval_s:
                continue
            self._told[status.name], self._told_s[key] = status.level, now_s
            found.append(status)
        return found
