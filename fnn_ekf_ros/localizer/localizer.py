# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The localizer: messages in, in any order; estimates out, one a period.

A period ends at an integer multiple of `period` in ROS time. It is closed `output_delay` after its
end if both wheels are known up to there, otherwise `encoder_timeout` after its end. Later inputs
change later periods only: closed periods are run again with all that is known now (`history`), but
are not published again.

A period is cut into epochs (`timeline.epochs`) at the instants of its readings, so that each
reading corrects the filter at its own time: `period` decides when an estimate is published, not
what is fused.

The output thus depends on the stamps and not on the time of arrival of a message, as long as it
arrives before its period is closed. Node, `replay`, `study real` and the fault studies drive this
one object.
"""

import dataclasses
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from fnn_ekf_ros.core.adaptation import AdaptationMode, Networks
from fnn_ekf_ros.core.state import FilterModel, FilterState
from fnn_ekf_ros.diagnostics.messages import TimeMessage
from fnn_ekf_ros.diagnostics.recent_periods import RecentPeriods, last_move, new_move
from fnn_ekf_ros.diagnostics.report import DiagnosticsReport
from fnn_ekf_ros.localizer.history import NEVER_NS, History, LearnedState, learned_by
from fnn_ekf_ros.localizer.saved_state import SavedState, saved_pose
from fnn_ekf_ros.messages.reading import read_input
from fnn_ekf_ros.parameters.localizer import LocalizerParameters
from fnn_ekf_ros.timeline.events import (
    CompassYaw,
    Estimate,
    Event,
    Output,
    PassedOver,
    PoseFix,
    PoseReset,
    Rejected,
    Status,
)
from fnn_ekf_ros.timeline.filter_model import filter_model
from fnn_ekf_ros.timeline.initialization import AwaitingStart
from fnn_ekf_ros.timeline.period import Period

LONGEST_SILENCE_PERIODS = 1600
"""Number of periods from which on a jump of the clock ahead starts the localizer anew instead of
filling the time: ten minutes at 375 ms, and about a second of work."""
LARGEST_LEAD_NS = 10**9
"""Largest lead of a stamp over the clock that is accepted [ns]: synchronized clocks differ less."""
SMALLEST_STEP_NS = 10**8
"""Step back from which on the clock was set [ns]: what clocks that are kept synchronized may differ
from one look to the next, of several threads or publishers."""
LONGEST_PAUSE_NS = 5 * 10**9
"""Time without a look at the clock from which on it has jumped, or the machine stood still [ns]."""
REPORT_INTERVAL_NS = 10**9
"""Interval of diagnostics [ns]: they are reported with the first period that ends in each one."""


class Received(NamedTuple):
    """The result of a message.

    Attributes:
        outputs: of the periods that were closed with it.
        rejected: why it was refused; None if it was used.
    """

    outputs: list[Output]
    rejected: Rejected | None = None


class _OldClock(NamedTuple):
    """What the clock was before it was set back.

    Attributes:
        ahead_ns: by how much it was ahead of the new one [ns].
        until_ns: new time until which messages may come that were stamped by it [ns].
    """

    ahead_ns: int = 0
    until_ns: int = 0

    def read(self, stamp_ns: int, now_ns: int) -> int:
        """Return a stamp that is ahead of the clock as the new clock would have shown it [ns]."""
        was_ns = stamp_ns - self.ahead_ns
        return was_ns if now_ns < self.until_ns and was_ns <= now_ns else stamp_ns


class Localizer:
    """The localizer without ROS.

    Args:
        parameters: the localizer's parameters.
        networks: the membership functions that the adaptation uses.
        on_period: is called with every period that is run, also when it is run again.
        warm_start: pose and what was learned, to start from instead of the parameters. The robot
            may have been moved since then: the square of `initial_pose_std` is added to the pose's
            variance.
        dead_reckoning: whether compass and fixes are ignored once the filter has started.
    """

    def __init__(
        self,
        parameters: LocalizerParameters,
        networks: Networks,
        on_period: Callable[[Period], None] | None = None,
        warm_start: SavedState | None = None,
        dead_reckoning: bool = False,
    ) -> None:
        self.parameters = parameters
        self._on_period = on_period
        self._dead_reckoning = dead_reckoning
        self._model = _model(parameters, networks)
        self._diagnostics = DiagnosticsReport(parameters)
        self._period_ns = round(parameters.period * 1e9)
        self._timeout_ns = round(parameters.encoder_timeout * 1e9)
        self._delay_ns = round(parameters.output_delay * 1e9)
        self._longest_wait_ns = max(self._timeout_ns, self._delay_ns)
        self._kept_ns = round(parameters.history * 1e9)
        self._longest_silence_ns = LONGEST_SILENCE_PERIODS * self._period_ns + self._longest_wait_ns
        self._now_ns: int
        self._is_behind = False
        self.reset()
        self._warm_start = warm_start
        if warm_start is not None:
            self._at_start = LearnedState(
                warm_start.process_noise, warm_start.measurement_noise, warm_start.log_weight
            )

    def receive(self, topic: str, message: Any, now_ns: int) -> Received:
        """Take a message in; return the periods closed by it and by the time that has passed.

        Args:
            topic: one of `messages.input_topics`.
            message: of the topic's type, as rclpy or rosbags gives it.
            now_ns: ROS time at which it arrived [ns].
        """
        events = read_input(topic, message, now_ns, self.parameters)
        if isinstance(events, Rejected):
            self._diagnostics.rejected(events)
            return Received(self.advance(now_ns), events)
        if isinstance(events, PassedOver):
            self._diagnostics.passed_over(events)
            return Received(self.advance(now_ns))
        outputs = [output for event in events for output in self.add(event, now_ns)]
        return Received(outputs + self.advance(now_ns))

    def add(self, event: Event, now_ns: int) -> list[Output]:
        """Take an event in; return the periods closed by it and by the time that has passed.

        Args:
            event: stamped in ROS time, not necessarily in order.
            now_ns: ROS time at which it arrived [ns].
        """
        outputs = self.advance(now_ns)
        if event.stamp_ns > now_ns + SMALLEST_STEP_NS:
            event = event._replace(stamp_ns=self._old_clock.read(event.stamp_ns, now_ns))
        if isinstance(event, PoseReset):  # a command, not a measurement: never too late
            oldest_ns = self._history.oldest.stamp_ns
            event = event._replace(stamp_ns=max(event.stamp_ns, oldest_ns + 1))
        if self._accepts(event, now_ns):
            self._diagnostics.took(event, self._history.add(event))
        if self._now_ns >= self._open_until_ns:
            outputs += self._close_due()
        return outputs

    def advance(self, now_ns: int, most: int | None = None) -> list[Output]:
        """Let ROS time pass; return the periods that have waited for the wheels too long.

        Args:
            now_ns: ROS time [ns].
            most: number of periods to close at once, so that a caller can do something else before
                it calls again, with the same time, as long as `is_behind`; None: all of them.
        """
        if (
            self._now_ns <= now_ns < self._open_until_ns
            and now_ns <= self._now_ns + LONGEST_PAUSE_NS
        ):  # most messages: the open period goes on, and the clock did not jump
            self._now_ns = now_ns
            return []
        if now_ns > self._now_ns + LONGEST_PAUSE_NS and not self._history.is_empty:
            self._diagnostics.paused(now_ns - self._now_ns)
        if self._history.is_empty or now_ns >= self._now_ns - SMALLEST_STEP_NS:
            pass
        elif now_ns >= self._now_ns - self._kept_ns:
            self._set_back(now_ns)
        went_back = now_ns < self._now_ns - self._kept_ns
        jumped_ahead = (
            not self._history.is_empty
            and now_ns > self._history.newest.stamp_ns + self._longest_silence_ns
        )
        if went_back or jumped_ahead:
            self._diagnostics.restarted(self._now_ns, now_ns)
            self._start_anew(self._learned())
        self._now_ns = max(now_ns, self._now_ns)
        if self._history.is_empty:
            self._begin(now_ns)
        return self._close_due(most)

    @property
    def is_behind(self) -> bool:
        """Whether periods are still to be closed that could have been."""
        return self._is_behind

    def shed(self, count: int) -> None:
        """Count readings that the caller has left out because there was no time for them."""
        self._diagnostics.shed(count)

    def _set_back(self, now_ns: int) -> None:
        """Go on at an earlier time: all that is kept moves with the clock."""
        by_ns = now_ns - self._now_ns
        self._diagnostics.set_back(self._now_ns, now_ns)
        self._history.move(by_ns)
        self._now_ns = now_ns
        self._old_clock = _OldClock(-by_ns, now_ns + self._kept_ns)

    def overran(self, seconds: float) -> None:
        """Count a delay of the caller of more than a period [s]."""
        self._diagnostics.overran(seconds)

    def report(self) -> tuple[Status, ...]:
        """Return the statuses as they are now."""
        now_ns = 0 if self._history.is_empty else self._history.newest.stamp_ns
        return self._diagnostics.report(now_ns, self._state(), None, self._mode(), self._recent())

    def saved(self) -> SavedState | None:
        """Return the state to save for the next start; None while no pose is known."""
        if self._history.is_empty:
            return None
        last = self._history.newest
        if isinstance(last.state, AwaitingStart):
            pose, covariance = last.state.given_pose, last.state.given_covariance
        else:
            pose, covariance = last.state.mean, last.state.covariance
        if pose is None:
            return None
        learned, at = self._learned(), saved_pose(pose, covariance)
        return SavedState(
            stamp_ns=last.stamp_ns,
            pose=at.mean,
            covariance=at.covariance,
            process_noise=learned.process_noise,
            measurement_noise=learned.measurement_noise,
            log_weight=learned.log_weight,
        )

    def reset(self) -> None:
        """Forget the pose and what was learned, also those of a warm start."""
        self._warm_start = None
        self._start_anew(
            LearnedState(
                np.asarray(self._model.process_noise), np.asarray(self._model.measurement_noise)
            )
        )

    def enable_adaptation(self, enabled: bool) -> None:
        """Let the noise adapt, or keep it as it is now."""
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
        self._diagnostics.changed(parameters)

    def _mode(self) -> AdaptationMode:
        adaptation = self._model.adaptation
        return adaptation.mode if adaptation.learning else AdaptationMode.NONE

    def _start_anew(self, learned: LearnedState) -> None:
        """Forget the pose and the inputs, and start with what was learned."""
        self._at_start = learned
        self._history = History(self.parameters, self._diagnostics, self._on_period)
        self._now_ns = self._open_until_ns = -NEVER_NS
        self._old_clock = _OldClock()
        self._is_behind = False

    def _learned(self) -> LearnedState:
        """Return what was learned so far."""
        if self._history.is_empty:
            return self._at_start
        return learned_by(self._model, self._history.newest.state)

    def _state(self) -> FilterState | AwaitingStart:
        if self._history.is_empty:
            return AwaitingStart(*self._at_start)
        return self._history.newest.state

    def _recent(self) -> RecentPeriods | None:
        return None if self._history.is_empty else self._history.newest.recent

    def _accepts(self, event: Event, now_ns: int) -> bool:
        if event.stamp_ns - now_ns > LARGEST_LEAD_NS:
            self._diagnostics.dropped(TimeMessage.AHEAD, event, now_ns)
            return False
        if event.stamp_ns <= self._history.too_late_ns:
            self._diagnostics.dropped(TimeMessage.LATE, event, now_ns)
            return False
        measured = isinstance(event, CompassYaw | PoseFix)
        return not (self._dead_reckoning and measured and isinstance(self._state(), FilterState))

    def _begin(self, now_ns: int) -> None:
        """Open the first period, early enough for all messages that are on their way."""
        waiting = AwaitingStart(*self._at_start)
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
        begin_ns = now_ns - max(self._kept_ns, self._longest_wait_ns)
        begin_ns = (begin_ns - 1) // self._period_ns * self._period_ns
        if now_ns >= 0:  # nothing is stamped before 0, where simulated time begins
            begin_ns = max(begin_ns, -self._period_ns)
        self._history.begin(begin_ns, waiting, self._model)

    def _close_due(self, most: int | None = None) -> list[Output]:
        """Close the periods that can be closed now, and note when the next one can be."""
        outputs: list[Output] = []
        while (complete := self._is_due()) is not None:
            if len(outputs) == most:
                break
            outputs.append(self._close(complete))
        self._is_behind = complete is not None
        self._open_until_ns = self._open_end_ns() + self._delay_ns
        return outputs

    def _open_end_ns(self) -> int:
        """Return the end of the open period [ns]; it is shorter after the clock was set back."""
        return (self._history.newest.stamp_ns // self._period_ns + 1) * self._period_ns

    def _is_due(self) -> bool | None:
        """Return whether both wheels are known up to the end of the open period; None: wait."""
        end_ns = self._open_end_ns()
        if self._now_ns < end_ns + self._delay_ns:
            return None
        known_ns = self._history.inputs.wheels_known_until_ns()
        if known_ns is not None and known_ns >= end_ns:
            return True
        return False if self._now_ns >= end_ns + self._longest_wait_ns else None

    def _close(self, complete: bool) -> Output:
        """Close the open period, with both wheels known up to its end or not."""
        end_ns = self._open_end_ns()
        known = last_move(self._recent())
        estimate = self._history.close(end_ns, self._model)
        moved = new_move(known, self._recent())
        self._diagnostics.closed(end_ns, complete, self._history.newest.counts, estimate)
        output = Output(
            stamp_ns=end_ns,
            estimate=estimate,
            statuses=self._report(end_ns, estimate),
            moved=moved,
        )
        self._history.forget()
        return output

    def _report(self, end_ns: int, estimate: Estimate | None) -> tuple[Status, ...] | None:
        if end_ns // REPORT_INTERVAL_NS == (end_ns - self._period_ns) // REPORT_INTERVAL_NS:
            return None
        return self._diagnostics.report(
            end_ns, self._state(), estimate, self._mode(), self._recent()
        )


def _model(parameters: LocalizerParameters, networks: Networks) -> FilterModel:
    """Return the filter's model, with the suspects that fault isolation needs."""
    return dataclasses.replace(filter_model(parameters, networks), suspects=True)
