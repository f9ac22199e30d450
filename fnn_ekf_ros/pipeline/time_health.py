"""What the localizer says about time: late, repeated and reordered messages, clocks that jump."""

from fnn_ekf_ros.pipeline.events import Level, Status


class TimeHealth:
    """Counts what time does to the inputs."""

    def __init__(self) -> None:
        self._dropped = self._repeated = self._out_of_order = self._redone = self._restarts = 0
        self._overruns = self._pauses = 0
        self._new_trouble = self._new_jump = ""

    def dropped(self, name: str, reason: str) -> None:
        """Count an event that was refused for its stamp."""
        self._dropped += 1
        self._new_trouble = f"{name} {reason}"

    def repeated(self) -> None:
        """Count a message that had been there before."""
        self._repeated += 1

    def out_of_order(self) -> None:
        """Count a message that came after one with a later stamp."""
        self._out_of_order += 1

    def redone(self, periods: int) -> None:
        """Count the periods that were run again for late inputs."""
        self._redone += periods

    def restarted(self, reason: str, from_ns: int, to_ns: int) -> None:
        """Count a restart by a jump of the clock."""
        self._restarts += 1
        self._new_jump = f"{reason} from {from_ns * 1e-9:.3f} s to {to_ns * 1e-9:.3f} s"

    def paused(self, time_ns: int) -> None:
        """Count a jump of the clock ahead that is no restart yet, or a pause [ns]."""
        self._pauses += 1
        self._new_jump = f"the clock jumped ahead, or nothing was heard, for {time_ns * 1e-9:.1f} s"

    def overran(self, seconds: float) -> None:
        """Count a delay of more than a period [s]."""
        self._overruns += 1
        self._new_trouble = f"late by {seconds:.2f} s, more than a period"

    def status(self) -> Status:
        """Return how it is; what is new since the last time decides the level."""
        values = (
            ("dropped", str(self._dropped)),
            ("duplicates", str(self._repeated)),
            ("out of order", str(self._out_of_order)),
            ("periods run again for late inputs", str(self._redone)),
            ("restarts", str(self._restarts)),
            ("jumps ahead or pauses", str(self._pauses)),
            ("cycle overruns", str(self._overruns)),
        )
        # Late and early stamps are what a jump leaves: the jump is told first.
        trouble = self._new_jump or self._new_trouble
        self._new_trouble = self._new_jump = ""
        if trouble:
            return Status("time", Level.WARN, trouble, values)
        return Status("time", Level.OK, "in order", values)
