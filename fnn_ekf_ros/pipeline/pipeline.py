"""The pipeline: events in, in any order; estimates out, one a period.

A period ends at an integer multiple of `period` in ROS time. It is closed when both wheels are
known up to its end, or `encoder_timeout` later. What arrives after that changes later periods
only: the filter goes back to the state before (states are values, so they were simply kept), and
the closed periods are run again with what is known now, without being published again.
"""

import dataclasses
from collections import deque
from typing import NamedTuple

import numpy as np

from fnn_ekf_ros.core.adaptation import AdaptationMode, FuzzyNetwork
from fnn_ekf_ros.core.arrays import FloatArray
from fnn_ekf_ros.core.filter import (
    NOMINAL_PERIOD_S,
    FilterState,
    StepResult,
    reset_pose,
    start_filter,
    step,
)
from fnn_ekf_ros.core.motion import move
from fnn_ekf_ros.parameters.localizer import LocalizerParameters
from fnn_ekf_ros.pipeline.configure import filter_model
from fnn_ekf_ros.pipeline.events import Estimate, Event, Output, Rejected, Status
from fnn_ekf_ros.pipeline.health import Health
from fnn_ekf_ros.pipeline.inputs import Counts, InputBuffer, PeriodInputs
from fnn_ekf_ros.pipeline.start import Waiting, wait

LONGEST_SILENCE_NS = 600 * 10**9
"""A clock that jumps ahead by more starts the localizer anew instead of filling the time [ns]."""
LARGEST_LEAD_NS = 10**9
"""Stamps further ahead of the clock are not believed [ns]."""
HEALTH_INTERVAL_NS = 10**9
"""Health is reported with the first period that ends in each of these intervals [ns]."""

_NEVER_NS = 2**63


class _Checkpoint(NamedTuple):
    """The localizer at a period's end."""

    stamp_ns: int
    state: FilterState | Waiting
    counts: Counts


class Pipeline:
    """The localizer without ROS.

    Args:
        parameters: the localizer's parameters.
        network: the membership functions that `membership_file` names.
    """

    def __init__(self, parameters: LocalizerParameters, network: FuzzyNetwork) -> None:
        self.parameters = parameters
        self._model = filter_model(parameters, network)
        self._health = Health(parameters)
        self._period_ns = round(parameters.period * 1e9)
        self._timeout_ns = round(parameters.encoder_timeout * 1e9)
        self._history_ns = round(parameters.history * 1e9)
        self._checkpoints: deque[_Checkpoint] = deque()
        self._changed_ns = _NEVER_NS
        self._now_ns = -_NEVER_NS
        self._restart()

    def add(self, event: Event, now_ns: int) -> list[Output]:
        """Take an event in; return the periods closed by it and by the time that has passed.

        Args:
            event: stamped in ROS time, not necessarily in order.
            now_ns: ROS time at which it arrived [ns].
        """
        outputs = self.advance(now_ns)
        if self._accepts(event, now_ns):
            if not self._checkpoints:
                self._begin(event.stamp_ns)
            changed_ns = self._inputs.add(event)
            if changed_ns <= self._checkpoints[-1].stamp_ns:
                self._changed_ns = min(changed_ns, self._changed_ns)
            self._health.saw(event)
        return outputs + self._close()

    def advance(self, now_ns: int) -> list[Output]:
        """Let ROS time pass; return the periods that have waited for the wheels too long."""
        if now_ns < self._now_ns - self._history_ns:
            self._health.restarted("the clock went back", self._now_ns, now_ns)
            self._restart()
        elif self._checkpoints and now_ns > self._checkpoints[-1].stamp_ns + LONGEST_SILENCE_NS:
            self._health.restarted("the clock jumped ahead", self._now_ns, now_ns)
            self._restart()
        self._now_ns = max(now_ns, self._now_ns)
        return self._close()

    def reject(self, rejected: Rejected) -> None:
        """Count an input that was refused before it became an event."""
        self._health.rejected(rejected)

    def report(self) -> tuple[Status, ...]:
        """Return the statuses as they are now."""
        now_ns = self._checkpoints[-1].stamp_ns if self._checkpoints else 0
        return self._health.report(now_ns, self._state(), None)

    def reset(self) -> None:
        """Forget the pose and all that was adapted, as at start-up."""
        self._checkpoints.clear()
        self._restart()

    def enable_adaptation(self, enabled: bool) -> None:
        """Let the network move the noise, or hold the noise where it is now."""
        mode = AdaptationMode(self.parameters.adaptation) if enabled else AdaptationMode.NONE
        self._model = dataclasses.replace(
            self._model, adaptation=dataclasses.replace(self._model.adaptation, mode=mode)
        )

    def _restart(self) -> None:
        """Forget the pose and the inputs; the noise that was adapted last is kept."""
        if self._checkpoints:
            last = self._checkpoints[-1].state
            self._start_noise = last.process_noise, last.measurement_noise
        else:
            self._start_noise = (
                np.asarray(self._model.process_noise),
                np.asarray(self._model.measurement_noise),
            )
        self._checkpoints.clear()
        self._inputs = InputBuffer(self.parameters)
        self._changed_ns = _NEVER_NS
        self._now_ns = -_NEVER_NS

    def _state(self) -> FilterState | Waiting:
        return self._checkpoints[-1].state if self._checkpoints else Waiting(*self._start_noise)

    def _accepts(self, event: Event, now_ns: int) -> bool:
        lead_ns = event.stamp_ns - now_ns
        if lead_ns > LARGEST_LEAD_NS:
            self._health.dropped(event, f"stamped {lead_ns * 1e-9:.3f} s ahead of the clock")
            return False
        if self._checkpoints:
            late_ns = self._checkpoints[-1].stamp_ns - event.stamp_ns
            if late_ns > self._history_ns:
                self._health.dropped(event, f"late by {late_ns * 1e-9:.3f} s, more than history")
                return False
        return True

    def _begin(self, stamp_ns: int) -> None:
        """Open the first period: the one that an event of this time belongs to."""
        begin_ns = (stamp_ns - 1) // self._period_ns * self._period_ns
        waiting = Waiting(*self._start_noise)
        state: FilterState | Waiting = waiting
        if not np.isnan(self.parameters.initial_pose[0]):
            covariance = np.diag(np.square(self.parameters.initial_pose_std))
            state = self._started(waiting, np.array(self.parameters.initial_pose), covariance)
        self._checkpoints.append(_Checkpoint(begin_ns, state, Counts(0.0, 0.0)))

    def _close(self) -> list[Output]:
        """Close the periods that can be closed now."""
        outputs: list[Output] = []
        while self._checkpoints:
            end_ns = self._checkpoints[-1].stamp_ns + self._period_ns
            known_ns = self._inputs.wheels_known_until_ns()
            complete = known_ns is not None and known_ns >= end_ns
            if not complete and self._now_ns < end_ns + self._timeout_ns:
                break
            self._redo_changed()
            estimate = self._run_period(end_ns)
            self._health.closed(complete)
            outputs.append(Output(end_ns, estimate, self._report(end_ns, estimate)))
            self._forget()
        return outputs

    def _redo_changed(self) -> None:
        """Run the closed periods again that late inputs belong to."""
        if self._changed_ns == _NEVER_NS:
            return
        redo: list[int] = []
        while len(self._checkpoints) > 1 and self._checkpoints[-1].stamp_ns >= self._changed_ns:
            redo.append(self._checkpoints.pop().stamp_ns)
        self._changed_ns = _NEVER_NS
        for end_ns in reversed(redo):
            self._run_period(end_ns)
        self._health.redone(len(redo))

    def _run_period(self, end_ns: int) -> Estimate | None:
        before = self._checkpoints[-1]
        period = self._inputs.period(before.stamp_ns, end_ns, before.counts)
        state: FilterState | Waiting
        result: StepResult | None = None
        if isinstance(before.state, Waiting):
            state = before.state
            if self._inputs.wheels_known_at(before.stamp_ns):
                state = wait(self._model, before.state, period.step)
        else:
            state, result = step(self._model, before.state, period.step)
        state = self._set_pose(state, period)
        self._checkpoints.append(_Checkpoint(end_ns, state, period.counts))
        if isinstance(state, Waiting):
            return None
        T = self.parameters.period
        return Estimate(
            stamp_ns=end_ns,
            state=state,
            twist=period.step.control / T,
            twist_variance=state.process_noise * (T / NOMINAL_PERIOD_S) / T**2,
            result=result,
        )

    def _set_pose(
        self, state: FilterState | Waiting, period: PeriodInputs
    ) -> FilterState | Waiting:
        """Return the state after a pose that was set from outside, if one was."""
        if period.reset is None:
            return state
        moved = move(self._model.motion_model, period.reset.pose, period.control_since_reset)
        given = period.reset.covariance
        usable = np.all(np.isfinite(given)) and np.all(np.linalg.eigvalsh(given) > 0.0)
        covariance = given if usable else np.diag(np.square(self.parameters.initial_pose_std))
        if isinstance(state, Waiting):
            return self._started(state, moved.mean, covariance)
        return reset_pose(state, moved.mean, covariance)

    def _started(self, waiting: Waiting, mean: FloatArray, covariance: FloatArray) -> FilterState:
        return start_filter(
            self._model, mean, covariance, waiting.process_noise, waiting.measurement_noise
        )

    def _report(self, end_ns: int, estimate: Estimate | None) -> tuple[Status, ...] | None:
        if end_ns // HEALTH_INTERVAL_NS == (end_ns - self._period_ns) // HEALTH_INTERVAL_NS:
            return None
        return self._health.report(end_ns, self._state(), estimate)

    def _forget(self) -> None:
        """Drop what lies further back than `history`."""
        oldest_needed_ns = self._checkpoints[-1].stamp_ns - self._history_ns
        while len(self._checkpoints) > 1 and self._checkpoints[1].stamp_ns <= oldest_needed_ns:
            self._checkpoints.popleft()
        self._inputs.forget_before(self._checkpoints[0].stamp_ns)
