"""What the localizer says about the encoders: silent, stuck and jumping wheels, named."""

from fnn_ekf_ros.core.pace import NOMINAL_PERIOD_S
from fnn_ekf_ros.parameters.localizer import LocalizerParameters
from fnn_ekf_ros.pipeline.configure import wheel_geometry
from fnn_ekf_ros.pipeline.events import STALE_NS, Estimate, Level, Status, Wheel, WheelCount
from fnn_ekf_ros.pipeline.inputs import Counts
from fnn_ekf_ros.pipeline.stuck_wheel import Look, StuckWheels
from fnn_ekf_ros.pipeline.wheels import Addition


class EncoderHealth:
    """Counts what the wheels do.

    Args:
        parameters: geometry and period.
    """

    def __init__(self, parameters: LocalizerParameters) -> None:
        self._metres_per_count = wheel_geometry(parameters).metres_per_count
        self._turn_scale = parameters.period / NOMINAL_PERIOD_S
        self._began_ns: int | None = None
        self._first_ns: dict[Wheel, int] = {}
        self._last_ns: dict[Wheel, int] = {}
        self._stuck = StuckWheels(parameters.wheel_separation)
        self._pose_set_ns: int | None = None
        self._jumps = self._timeouts = self._new_timeouts = 0
        self._new_jump = ""

    def saw(self, event: WheelCount, addition: Addition) -> None:
        """Count a reading, and whether it jumped by a way that cannot have been motion."""
        stamp_ns, wheel, _ = event
        if wheel not in self._first_ns:
            self._first_ns[wheel] = stamp_ns
        last_ns = self._last_ns.get(wheel)
        if last_ns is None or stamp_ns > last_ns:
            self._last_ns[wheel] = max(stamp_ns, 0)
        if addition.jump:
            self._jumps += 1
            jump_m = addition.jump * self._metres_per_count
            jumped = f"{wheel.name.lower()} wheel jumped by {jump_m:.3f} m"
            if addition.silent_ns:
                self._new_jump = (
                    f"{jumped} after {addition.silent_ns * 1e-9:.1f} s of silence: taken for a "
                    "restart or a glitch, and no motion; after a restart its way meanwhile is "
                    "unknown"
                )
            else:
                self._new_jump = f"{jumped}: taken for a reset or a glitch, and no motion"

    def pose_was_set(self, stamp_ns: int) -> None:
        """Expect the pose to jump at an instant [ns]."""
        self._pose_set_ns = max(stamp_ns, self._pose_set_ns or 0)

    def restarted(self) -> None:
        """Begin anew after a jump of the clock."""
        self._began_ns = None
        self._first_ns.clear()
        self._last_ns.clear()
        self._stuck.forget()
        self._pose_set_ns = None

    def closed(
        self, end_ns: int, complete: bool, counts: Counts, estimate: Estimate | None
    ) -> None:
        """Count a period; `complete` if both wheels were known up to its end."""
        if not complete:
            self._timeouts += 1
            self._new_timeouts += 1
        if self._pose_set_ns is not None and end_ns >= self._pose_set_ns:
            self._pose_set_ns = None
            self._stuck.forget()
        if estimate is None or counts.left is None or counts.right is None:
            self._stuck.forget()
            return
        if estimate.result is not None and estimate.result.relocated:
            self._stuck.forget()
        state = estimate.state
        self._stuck.look(
            Look(
                end_ns,
                (counts.left * self._metres_per_count, counts.right * self._metres_per_count),
                float(state.mean[2]),
                float(state.covariance[2, 2]),
                float(state.process_noise[1]) * self._turn_scale,
            )
        )

    def status(self, common: Status, now_ns: int, *, refused: bool) -> Status:
        """Return how they are; what is new since the last time decides the level.

        Args:
            common: what can be said of any sensor.
            now_ns: ROS time [ns].
            refused: whether `common` tells of messages that were refused.
        """
        status = common._replace(
            values=(
                *common.values,
                ("periods closed without both wheels", str(self._timeouts)),
                ("jumps", str(self._jumps)),
            )
        )
        jump, self._new_jump = self._new_jump, ""
        timeouts, self._new_timeouts = self._new_timeouts, 0
        self._began_ns = now_ns if self._began_ns is None else self._began_ns
        if status.level is not Level.OK and not refused:
            starting = not self._last_ns and now_ns - self._began_ns <= STALE_NS
            return status._replace(level=Level.WARN if starting else Level.ERROR)
        missing = self._missing(now_ns) or self._stuck.accusation()
        if missing:
            return status._replace(level=Level.ERROR, message=missing)
        if jump:
            return status._replace(level=Level.WARN, message=jump)
        if timeouts and not refused:
            message = f"{timeouts} periods closed without both wheels"
            return status._replace(level=Level.WARN, message=message)
        return status

    def _missing(self, now_ns: int) -> str:
        """Return which wheel is silent while the other one is not; empty if none is."""
        for wheel in Wheel:
            name, other = wheel.name.lower(), Wheel(1 - wheel)
            if wheel in self._last_ns:
                age_ns = now_ns - self._last_ns[wheel]
                if age_ns > STALE_NS:
                    return f"{name} wheel silent for {age_ns * 1e-9:.1f} s"
            elif other in self._first_ns and now_ns - self._first_ns[other] > STALE_NS:
                return f"no message yet from the {name} wheel"
        return ""
