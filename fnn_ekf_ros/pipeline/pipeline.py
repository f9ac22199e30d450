"""The pipeline: events in, in any order; estimates out, one a period.

A period ends at an integer multiple of `period` in ROS time. It is closed when its end is past by
`output_delay` and both wheels are known up to there, or `encoder_timeout` later. What arrives
after that changes later periods only: the filter goes back to the state before (states are
values, so they were simply kept), and the closed periods are run again with what is known now,
without being published again.

A period is cut into epochs (`epochs`) at the instants of its readings, so that each corrects the
filter at its own time: `period` says when something is published, not what is fused.

So what is published depends on the stamps, and not on when a message arrives, as long as it does
before its period is closed.
"""

import dataclasses
from collections import deque
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from fnn_ekf_ros.core.adaptation import AdaptationMode, Networks
from fnn_ekf_ros.core.arrays import FloatArray
from fnn_ekf_ros.core.pace import NOMINAL_PERIOD_S
from fnn_ekf_ros.core.state import FilterModel, FilterState, for_mode, lasting_noise
from fnn_ekf_ros.parameters.localizer import LocalizerParameters
from fnn_ekf_ros.pipeline.configure import filter_model
from fnn_ekf_ros.pipeline.events import (
    Estimate,
    Event,
    Move,
    Output,
    PoseReset,
    Rejected,
    Status,
)
from fnn_ekf_ros.pipeline.health import Health
from fnn_ekf_ros.pipeline.inputs import Counts, InputBuffer, PeriodInputs
from fnn_ekf_ros.pipeline.period import (
    FAILURES,
    Period,
    check_finite,
    run_period,
    without_measurements,
)
from fnn_ekf_ros.pipeline.saved import SavedState
from fnn_ekf_ros.pipeline.start import Waiting
from fnn_ekf_ros.pipeline.watch import Watch, watch_after

LONGEST_SILENCE_PERIODS = 1600
"""A clock that jumps ahead by more starts the localizer anew instead of filling the time; ten
minutes at 375 ms, and about a second of work."""
LARGEST_LEAD_NS = 10**9
"""Stamps further ahead of the clock are not believed [ns]."""
LONGEST_PAUSE_NS = 5 * 10**9
"""A clock that nobody looks at for longer has jumped, or the machine stood still [ns]."""
HEALTH_INTERVAL_NS = 10**9
"""Health is reported with the first period that ends in each of these intervals [ns]."""

_NEVER_NS = 2**63


class _Checkpoint(NamedTuple):
    """The localizer at a period's end."""

    stamp_ns: int
    state: FilterState | Waiting
    counts: Counts
    """What the wheels had counted for the periods so far."""
    model: FilterModel
    """The model the period was run with, for when it is run again."""
    watch: Watch | None = None
    """What the last periods showed of the sensors; None before the filter runs."""
    left_out: tuple[int, int] = (0, 0)
    """How many readings of compass and fixes were too many to be taken."""


class Pipeline:
    """The localizer without ROS.

    Args:
        parameters: the localizer's parameters.
        networks: the membership functions that the adaptation uses.
        on_period: is told of every period that is run, again when late inputs have it run again.
        warm_start: what to start from instead of the parameters' noise and initial pose. The robot
            may have been moved since: `initial_pose_std` is added to the pose's uncertainty.
    """

    def __init__(
        self,
        parameters: LocalizerParameters,
        networks: Networks,
        on_period: Callable[[Period], None] | None = None,
        warm_start: SavedState | None = None,
    ) -> None:
        self.parameters = parameters
        self._on_period = on_period
        self._model = _model(parameters, networks)
        self._health = Health(parameters)
        self._period_ns = round(parameters.period * 1e9)
        self._timeout_ns = round(parameters.encoder_timeout * 1e9)
        self._delay_ns = round(parameters.output_delay * 1e9)
        self._longest_wait_ns = max(self._timeout_ns, self._delay_ns)
        self._history_ns = round(parameters.history * 1e9)
        self._longest_silence_ns = LONGEST_SILENCE_PERIODS * self._period_ns + self._longest_wait_ns
        self._checkpoints: deque[_Checkpoint] = deque()
        self._changed_ns = _NEVER_NS
        self._now_ns = self._open_until_ns = -_NEVER_NS
        self.reset()
        self._warm_start = warm_start
        if warm_start is not None:
            self._start_noise = warm_start.process_noise, warm_start.measurement_noise

    def add(self, event: Event, now_ns: int) -> list[Output]:
        """Take an event in; return the periods closed by it and by the time that has passed.

        Args:
            event: stamped in ROS time, not necessarily in order.
            now_ns: ROS time at which it arrived [ns].
        """
        outputs = self.advance(now_ns)
        if isinstance(event, PoseReset):  # a command, not a measurement: never too late
            oldest_ns = self._checkpoints[0].stamp_ns
            event = event._replace(stamp_ns=max(event.stamp_ns, oldest_ns + 1))
        if self._accepts(event, now_ns):
            addition = self._inputs.add(event)
            if addition.changed_ns is not None and addition.changed_ns < self._changed_ns:
                self._changed_ns = addition.changed_ns
            self._health.took(event, addition)
        if self._now_ns >= self._open_until_ns:
            outputs += self._close_due()
        return outputs

    def advance(self, now_ns: int) -> list[Output]:
        """Let ROS time pass; return the periods that have waited for the wheels too long."""
        if (
            self._now_ns <= now_ns < self._open_until_ns
            and now_ns <= self._now_ns + LONGEST_PAUSE_NS
        ):  # most messages: the open period goes on, and the clock did not jump
            self._now_ns = now_ns
            return []
        if now_ns > self._now_ns + LONGEST_PAUSE_NS and self._checkpoints:
            self._health.paused(now_ns - self._now_ns)
        if now_ns < self._now_ns - self._history_ns:
            self._health.restarted("the clock went back", self._now_ns, now_ns)
            self._restart()
        elif (
            self._checkpoints and now_ns > self._checkpoints[-1].stamp_ns + self._longest_silence_ns
        ):
            self._health.restarted("the clock jumped ahead", self._now_ns, now_ns)
            self._restart()
        self._now_ns = max(now_ns, self._now_ns)
        if not self._checkpoints:
            self._begin(now_ns)
        return self._close_due()

    def reject(self, rejected: Rejected) -> None:
        """Count an input that was refused before it became an event."""
        self._health.rejected(rejected)

    def overran(self, seconds: float) -> None:
        """Count a time that whoever drives the pipeline was late by [s]."""
        self._health.overran(seconds)

    def report(self) -> tuple[Status, ...]:
        """Return the statuses as they are now."""
        now_ns = self._checkpoints[-1].stamp_ns if self._checkpoints else 0
        return self._health.report(now_ns, self._state(), None, self._mode(), self._watch())

    def saved(self) -> SavedState | None:
        """Return what is worth keeping for the next start; None while no pose is known."""
        if not self._checkpoints:
            return None
        last = self._checkpoints[-1]
        if isinstance(last.state, Waiting):
            pose, covariance = last.state.given_pose, last.state.given_covariance
        else:
            pose, covariance = last.state.mean, last.state.covariance
        if pose is None:
            return None
        return SavedState(last.stamp_ns, pose, covariance, *self._noise())

    def reset(self) -> None:
        """Forget the pose and all that was adapted, a warm start's too."""
        self._warm_start = None
        self._checkpoints.clear()
        self._start_noise = (
            np.asarray(self._model.process_noise),
            np.asarray(self._model.measurement_noise),
        )
        self._restart()

    def enable_adaptation(self, enabled: bool) -> None:
        """Let the network move the noise, or hold the noise where it is now."""
        self._model = dataclasses.replace(
            self._model, adaptation=dataclasses.replace(self._model.adaptation, learning=enabled)
        )

    def change(self, parameters: LocalizerParameters, networks: Networks) -> None:
        """Go on with other parameters, from the period that is open; noise and pose stay.

        Args:
            parameters: may differ in those that can change at run time, and in no others.
            networks: the membership functions that they ask for.
        """
        learning = self._model.adaptation.learning
        self.parameters = parameters
        self._model = _model(parameters, networks)
        self.enable_adaptation(learning)
        self._health.changed(parameters)

    def _mode(self) -> AdaptationMode:
        adaptation = self._model.adaptation
        return adaptation.mode if adaptation.learning else AdaptationMode.NONE

    def _restart(self) -> None:
        """Forget the pose and the inputs; the noise that was adapted last is kept."""
        self._start_noise = self._noise()
        self._checkpoints.clear()
        self._inputs = InputBuffer(self.parameters)
        self._changed_ns = _NEVER_NS
        self._now_ns = self._open_until_ns = -_NEVER_NS

    def _noise(self) -> tuple[FloatArray, FloatArray]:
        """Return Q and R as they were adapted last, without what an alarm adds for a moment."""
        if not self._checkpoints:
            return self._start_noise
        last = self._checkpoints[-1].state
        if isinstance(last, FilterState):
            return lasting_noise(self._model, last)
        return self._model.adaptation.bounds.within(last.process_noise, last.measurement_noise)

    def _state(self) -> FilterState | Waiting:
        return self._checkpoints[-1].state if self._checkpoints else Waiting(*self._start_noise)

    def _watch(self) -> Watch | None:
        return self._checkpoints[-1].watch if self._checkpoints else None

    def _accepts(self, event: Event, now_ns: int) -> bool:
        lead_ns = event.stamp_ns - now_ns
        if lead_ns > LARGEST_LEAD_NS:
            self._health.dropped(event, f"stamped {lead_ns * 1e-9:.3f} s ahead of the clock")
            return False
        if event.stamp_ns <= self._checkpoints[0].stamp_ns:  # the oldest state that is kept
            self._health.dropped(event, f"late by {-lead_ns * 1e-9:.3f} s")
            return False
        return True

    def _begin(self, now_ns: int) -> None:
        """Open the first period: so long ago that nothing that is on its way comes too late."""
        waiting = Waiting(*self._start_noise)
        covariance = np.diag(np.square(self.parameters.initial_pose_std))
        if self._warm_start is not None:  # once: after a jump of the clock it is too old
            waiting = waiting._replace(
                given_pose=self._warm_start.pose,
                given_covariance=covariance + self._warm_start.covariance,
            )
            self._warm_start = None
        elif not np.isnan(self.parameters.initial_pose[0]):
            waiting = waiting._replace(
                given_pose=np.array(self.parameters.initial_pose), given_covariance=covariance
            )
        begin_ns = now_ns - max(self._history_ns, self._longest_wait_ns)
        begin_ns = (begin_ns - 1) // self._period_ns * self._period_ns
        if now_ns >= 0:  # nothing is stamped before 0, where simulated time begins
            begin_ns = max(begin_ns, -self._period_ns)
        self._checkpoints.append(_Checkpoint(begin_ns, waiting, Counts(), self._model))

    def _close_due(self) -> list[Output]:
        """Close the periods that can be closed now; note before when none can be again."""
        outputs = self._close()
        self._open_until_ns = self._checkpoints[-1].stamp_ns + self._period_ns + self._delay_ns
        return outputs

    def _close(self) -> list[Output]:
        """Close the periods that can be closed now."""
        outputs: list[Output] = []
        while self._checkpoints:
            end_ns = self._checkpoints[-1].stamp_ns + self._period_ns
            if self._now_ns < end_ns + self._delay_ns:
                break
            known_ns = self._inputs.wheels_known_until_ns()
            complete = known_ns is not None and known_ns >= end_ns
            if not complete and self._now_ns < end_ns + self._longest_wait_ns:
                break
            known = self._watch()
            estimate = self._run_open_periods(end_ns)
            moved = _new_move(known, self._watch())
            last = self._checkpoints[-1]
            self._health.closed(end_ns, complete, last.counts, estimate)
            outputs.append(Output(end_ns, estimate, self._report(end_ns, estimate), moved))
            self._forget()
        return outputs

    def _run_open_periods(self, end_ns: int) -> Estimate | None:
        """Run the periods that late inputs belong to again, and then the one that ends now.

        A filter that leaves the finite numbers without any measurement, too, starts anew with the
        noise it had, and says so.
        """
        kept = deque(self._checkpoints)
        redo: list[_Checkpoint] = []
        while len(kept) > 1 and kept[-1].stamp_ns >= self._changed_ns:
            redo.append(kept.pop())
        self._changed_ns = _NEVER_NS
        estimate = None
        try:
            for stamp_ns, model in [
                *((before.stamp_ns, before.model) for before in reversed(redo)),
                (end_ns, self._model),
            ]:
                checkpoint, estimate = self._run_or_predict(kept[-1], stamp_ns, model)
                kept.append(checkpoint)
        except FAILURES as error:
            self._health.failed(end_ns, str(error), restarts=True)
            counts = self._inputs.counts_at(end_ns)
            lost = _Checkpoint(end_ns, Waiting(*self._noise()), counts, self._model)
            kept, estimate = deque([lost]), None
        self._checkpoints = kept
        self._count_left_out(redo)
        self._health.redone(len(redo))
        return estimate

    def _count_left_out(self, redo: list[_Checkpoint]) -> None:
        """Count what was left out of the newest period, and now of those that were run again."""
        told = {before.stamp_ns: before.left_out for before in redo}
        newest_ns = self._checkpoints[-1].stamp_ns
        for checkpoint in self._checkpoints:
            if checkpoint.stamp_ns in told or checkpoint.stamp_ns == newest_ns:
                before = told.get(checkpoint.stamp_ns, (0, 0))
                compass, fixes = (
                    max(now - then, 0)
                    for now, then in zip(checkpoint.left_out, before, strict=True)
                )
                self._health.left_out((compass, fixes))

    def _run_or_predict(
        self, before: _Checkpoint, end_ns: int, model: FilterModel
    ) -> tuple[_Checkpoint, Estimate | None]:
        """Run a period; from the state before by the wheels alone if its measurements fail it."""
        counts = before.counts
        if before.watch is not None:
            counts = self._inputs.counts_to_go_on_from(
                before.stamp_ns, counts, before.watch.measured_ns
            )
        inputs = self._inputs.period(before.stamp_ns, end_ns, counts)
        try:
            return self._run_period(before, end_ns, model, inputs)
        except FAILURES as error:
            predicted = self._run_period(before, end_ns, model, without_measurements(inputs))
            self._health.failed(end_ns, str(error), restarts=False)
            return predicted

    def _run_period(
        self, before: _Checkpoint, end_ns: int, model: FilterModel, inputs: PeriodInputs
    ) -> tuple[_Checkpoint, Estimate | None]:
        state = before.state
        if isinstance(state, FilterState):
            state = for_mode(model, state)
        begin = state
        state, result = run_period(model, state, inputs)
        if isinstance(state, FilterState):
            check_finite(state)
        if self._on_period is not None:
            self._on_period(Period(end_ns, inputs, before.state, state))
        watch = watch_after(model, before.watch, begin, state, inputs, result, end_ns)
        checkpoint = _Checkpoint(end_ns, state, inputs.counts, model, watch, inputs.left_out)
        if isinstance(state, Waiting):
            return checkpoint, None
        T = self.parameters.period
        return checkpoint, Estimate(
            stamp_ns=end_ns,
            state=state,
            twist=inputs.control / T,
            twist_variance=state.process_noise * (T / NOMINAL_PERIOD_S) / T**2,
            result=result,
        )

    def _report(self, end_ns: int, estimate: Estimate | None) -> tuple[Status, ...] | None:
        if end_ns // HEALTH_INTERVAL_NS == (end_ns - self._period_ns) // HEALTH_INTERVAL_NS:
            return None
        return self._health.report(end_ns, self._state(), estimate, self._mode(), self._watch())

    def _forget(self) -> None:
        """Drop what lies further back than `history`."""
        oldest_needed_ns = self._checkpoints[-1].stamp_ns - self._history_ns
        while len(self._checkpoints) > 1 and self._checkpoints[1].stamp_ns <= oldest_needed_ns:
            self._checkpoints.popleft()
        self._inputs.forget_before(self._checkpoints[0].stamp_ns)


def _model(parameters: LocalizerParameters, networks: Networks) -> FilterModel:
    """Return the filter's model; it follows who does not fit the others."""
    return dataclasses.replace(filter_model(parameters, networks), suspects=True)


def _new_move(before: Watch | None, after: Watch | None) -> Move | None:
    """Return a move of the pose that was not known before, if there is one."""
    moved = None if after is None else after.moved
    known = None if before is None else before.moved
    if moved is None or (known is not None and moved.stamp_ns <= known.stamp_ns):
        return None
    return moved
