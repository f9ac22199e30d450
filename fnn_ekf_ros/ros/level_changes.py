# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Statuses that are worth a line in the log: those that got better or worse, once in a while."""

import math
from collections.abc import Sequence

from fnn_ekf_ros.timeline.events import Level, Status


class LevelChanges:
    """Remembers the last logged level of each status.

    A change that comes too soon to be logged remains a change: one that lasts is logged later.

    Args:
        interval_s: a status is not logged twice at the same level in less time [s].
    """

    def __init__(self, interval_s: float) -> None:
        self._interval_s = interval_s
        self._logged: dict[str, Level] = {}
        self._logged_s: dict[tuple[str, Level], float] = {}

    def worth_a_line(self, statuses: Sequence[Status], now_s: float) -> list[Status]:
        """Return the statuses to log now [s]; they count as logged."""
        found = []
        for status in statuses:
            key = status.name, status.level
            if status.level == self._logged.get(status.name, Level.OK):
                continue
            if now_s - self._logged_s.get(key, -math.inf) < self._interval_s:
                continue
            self._logged[status.name], self._logged_s[key] = status.level, now_s
            found.append(status)
        return found
