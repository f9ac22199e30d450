# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The status `encoders`: silent, stuck and jumping wheels, each named."""

from fnn_ekf_ros.core.pace import NOMINAL_PERIOD_S
from fnn_ekf_ros.diagnostics.messages import EncoderMessage, fill
from fnn_ekf_ros.diagnostics.noise_words import Values
from fnn_ekf_ros.diagnostics.stuck_wheel import StuckWheels, WheelObservation
from fnn_ekf_ros.diagnostics.wheel_distances import WheelDistances
from fnn_ekf_ros.parameters.localizer import LocalizerParameters
from fnn_ekf_ros.timeline.events import STALE_NS, Estimate, Level, Status, Wheel, WheelCount
from fnn_ekf_ros.timeline.filter_model import wheel_geometry
from fnn_ekf_ros.timeline.inputs import Counts
from fnn_ekf_ros.timeline.wheels import BufferChange


class EncoderStatus:
    """Counts the readings, jumps and timeouts of the wheels.

    Args:
        parameters: geometry and period.
    """

    def __init__(self, parameters: LocalizerParameters) -> None:
        self._geometry = wheel_geometry(parameters)
        self._period_scale = parameters.period / NOMINAL_PERIOD_S
        self._began_ns: int | None = None
        self._first_ns: dict[Wheel, int] = {}
        self._last_ns: dict[Wheel, int] = {}
        self._stuck = StuckWheels(parameters.wheel_separation)
        self._pose_set_ns: int | None = None
        self._jumps = self._timeouts = self._new_timeouts = 0
        self._new_jump = ""
        self._last_jump: Values = ()

    def saw(self, event: WheelCount, change: BufferChange) -> None:
        """Count a reading, and whether it jumped by a distance that cannot have been motion."""
        stamp_ns, wheel, _ = event
        if wheel not in self._first_ns:
            self._first_ns[wheel] = stamp_ns
        last_ns = self._last_ns.get(wheel)
        if last_ns is None or stamp_ns > last_ns:
            self._last_ns[wheel] = max(stamp_ns, 0)
        if change.jump:
            self._jumps += 1
            kind = (
                EncoderMessage.WHEEL_RESTARTED if change.silent_ns else EncoderMessage.WHEEL_JUMPED
            )
            self._new_jump = fill(kind, wheel=_name(wheel))
            self._last_jump = (
                ("last jump [m]", f"{change.jump * self._geometry.meters_per_count:.3f}"),
                ("silence before the last jump [s]", f"{change.silent_ns * 1e-9:.1f}"),
            )

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
        left, right = self._geometry.rolled(counts.left, counts.right)
        self._stuck.observe(
            WheelObservation(
                stamp_ns=end_ns,
                wheels=WheelDistances(float(left), float(right)),
                yaw=float(state.mean[2]),
                yaw_variance=float(state.covariance[2, 2]),
                rotation_variance=float(state.process_noise[1]) * self._period_scale,
            )
        )

    def status(self, common: Status, now_ns: int, *, refused: bool) -> Status:
        """Return the status; events since the last one decide its level.

        Args:
            common: what can be said of any sensor.
            now_ns: ROS time [ns].
            refused: whether `common` reports messages that were refused.
        """
        jump, self._new_jump = self._new_jump, ""
        timeouts, self._new_timeouts = self._new_timeouts, 0
        stuck = self._stuck.fault()
        status = common._replace(
            values=(
                *common.values,
                *self._ages(now_ns),
                ("periods closed without both wheels", str(self._timeouts)),
                ("of these since the last report", str(timeouts)),
                ("jumps", str(self._jumps)),
                *self._last_jump,
                *(() if stuck is None else stuck.values()),
            )
        )
        self._began_ns = now_ns if self._began_ns is None else self._began_ns
        if status.level is not Level.OK and not refused:
            starting = not self._last_ns and now_ns - self._began_ns <= STALE_NS
            return status._replace(level=Level.WARN if starting else Level.ERROR)
        missing = self._missing(now_ns) or ("" if stuck is None else stuck.message())
        if missing:
            return status._replace(level=Level.ERROR, message=missing)
        if jump:
            return status._replace(level=Level.WARN, message=jump)
        if timeouts and not refused:
            return status._replace(level=Level.WARN, message=EncoderMessage.TIMEOUT)
        return status

    def _ages(self, now_ns: int) -> Values:
        return tuple(
            (f"age of the {_name(wheel)} wheel [s]", f"{max(now_ns - last_ns, 0) * 1e-9:.3f}")
            for wheel, last_ns in sorted(self._last_ns.items())
        )

    def _missing(self, now_ns: int) -> str:
        """Return which wheel is silent while the other one is not; empty if none is."""
        for wheel in Wheel:
            other = Wheel(1 - wheel)
            if wheel in self._last_ns:
                if now_ns - self._last_ns[wheel] > STALE_NS:
                    return fill(EncoderMessage.WHEEL_SILENT, wheel=_name(wheel))
            elif other in self._first_ns and now_ns - self._first_ns[other] > STALE_NS:
                return fill(EncoderMessage.WHEEL_NONE_YET, wheel=_name(wheel))
        return ""


def _name(wheel: Wheel) -> str:
    return wheel.name.lower()
