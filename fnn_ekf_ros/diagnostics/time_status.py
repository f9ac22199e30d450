# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The status `time`: late, repeated and reordered messages, clocks that jump."""

from collections import Counter

from fnn_ekf_ros.diagnostics.messages import DROPPED, TimeMessage, dropped_key, fill
from fnn_ekf_ros.diagnostics.noise_words import Values
from fnn_ekf_ros.timeline.events import Level, Sensor, Status


class TimeStatus:
    """Counts late, repeated and reordered inputs, and jumps of the clock."""

    def __init__(self) -> None:
        self._dropped: Counter[str] = Counter()
        self._repeated = self._out_of_order = self._redone = self._restarts = 0
        self._overruns = self._pauses = self._shed = self._steps_back = 0
        self._new_trouble = self._new_jump = ""
        self._last_drop = self._last_jump = self._last_overrun = ""

    def dropped(self, message: TimeMessage, sensor: Sensor | None, delay_ns: int) -> None:
        """Count an event that was refused for its stamp.

        Args:
            message: `LATE` or `AHEAD`.
            sensor: whose it was; None for a pose that was set.
            delay_ns: the clock minus its stamp [ns].
        """
        name = sensor or "initialpose"
        self._dropped[name] += 1
        self._new_trouble = fill(message, input=name)
        self._last_drop = f"{delay_ns * 1e-9:.3f}"

    def repeated(self) -> None:
        """Count a message that had been there before."""
        self._repeated += 1

    def out_of_order(self) -> None:
        """Count a message that came after one with a later stamp."""
        self._out_of_order += 1

    def redone(self, periods: int) -> None:
        """Count the periods that were run again for late inputs."""
        self._redone += periods

    def restarted(self, from_ns: int, to_ns: int) -> None:
        """Count a restart by a jump of the clock between two instants [ns]."""
        self._restarts += 1
        self._new_jump = TimeMessage.WENT_BACK if to_ns < from_ns else TimeMessage.JUMPED_AHEAD
        self._last_jump = f"{(to_ns - from_ns) * 1e-9:.3f}"

    def set_back(self, from_ns: int, to_ns: int) -> None:
        """Count a step of the clock back between two instants [ns]."""
        self._steps_back += 1
        self._new_jump = TimeMessage.SET_BACK
        self._last_jump = f"{(to_ns - from_ns) * 1e-9:.3f}"

    def paused(self, time_ns: int) -> None:
        """Count a jump of the clock ahead that is no restart yet, or a pause [ns]."""
        self._pauses += 1
        self._new_jump = TimeMessage.PAUSED
        self._last_jump = f"{time_ns * 1e-9:.3f}"

    def overran(self, seconds: float) -> None:
        """Count a delay of more than a period [s]."""
        self._overruns += 1
        self._new_trouble = TimeMessage.OVERRUN
        self._last_overrun = f"{seconds:.2f}"

    def shed(self, count: int) -> None:
        """Count readings that were left out because the node is too slow."""
        self._shed += count
        self._new_trouble = TimeMessage.TOO_SLOW

    def status(self) -> Status:
        """Return the status; events since the last one decide its level."""
        values: Values = (
            (DROPPED, str(self._dropped.total())),
            *((dropped_key(name), str(count)) for name, count in self._dropped.items()),
            ("duplicates", str(self._repeated)),
            ("out of order", str(self._out_of_order)),
            ("periods run again for late inputs", str(self._redone)),
            ("restarts", str(self._restarts)),
            ("steps back", str(self._steps_back)),
            ("jumps ahead or pauses", str(self._pauses)),
            ("cycle overruns", str(self._overruns)),
            ("readings left out as the node is too slow", str(self._shed)),
        )
        values += tuple(
            (key, value)
            for key, value in (
                ("last dropped, delay [s]", self._last_drop),
                ("last jump of the clock [s]", self._last_jump),
                ("last overrun [s]", self._last_overrun),
            )
            if value
        )
        # Late and early stamps are what a jump leaves: the jump is reported first.
        trouble = self._new_jump or self._new_trouble
        self._new_trouble = self._new_jump = ""
        if trouble:
            return Status(name="time", level=Level.WARN, message=trouble, values=values)
        return Status(name="time", level=Level.OK, message=TimeMessage.IN_ORDER, values=values)
