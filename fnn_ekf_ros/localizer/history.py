# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The last periods, kept as states, so that they can be run again with late inputs.

A closed period leaves a checkpoint: the localizer at its end. An input that arrives later and
belongs before that end changes the periods from its stamp on. They are run again, from the
checkpoint before, when the next period is closed. States are immutable values, so rewinding needs
nothing but the old ones.
"""

from collections import deque
from collections.abc import Callable
from typing import NamedTuple

from fnn_ekf_ros.core.arrays import FloatArray
from fnn_ekf_ros.core.pace import NOMINAL_PERIOD_S
from fnn_ekf_ros.core.results import StepResult
from fnn_ekf_ros.core.state import FilterModel, FilterState, for_mode, persistent_noise
from fnn_ekf_ros.diagnostics.recent_periods import RecentPeriods, recent_after
from fnn_ekf_ros.diagnostics.report import DiagnosticsReport
from fnn_ekf_ros.parameters.localizer import LocalizerParameters
from fnn_ekf_ros.timeline.events import Estimate, Event
from fnn_ekf_ros.timeline.initialization import AwaitingStart
from fnn_ekf_ros.timeline.inputs import Counts, InputBuffer, LeftOut, Measured, PeriodInputs
from fnn_ekf_ros.timeline.period import (
    FAILURES,
    Period,
    check_finite,
    run_period,
    without_measurements,
)
from fnn_ekf_ros.timeline.wheels import BufferChange

MOST_REDONE = 400.0
"""Filter steps that are run again for late inputs, per second of ROS time [1/s]: less than half of
what a small processor can do. Only periods below 0.1 s, and fast sensors that are late, need more;
then late inputs are collected, so that one rewind serves many of them."""
LONGEST_KEPT = 2
"""Longest time that is kept for inputs that wait for a rewind, times `history`."""
NEVER_NS = 2**63
"""An instant later than every stamp [ns]."""


class Checkpoint(NamedTuple):
    """The localizer at a period's end.

    Attributes:
        stamp_ns: the end [ns].
        state: the filter, or what it waits with.
        counts: of the wheels, as far as the periods so far have used them.
        model: with which the period was run, and is run again.
        measured: when a position and a yaw were accepted last; None before the filter runs.
        recent: the last periods, for diagnostics; None before the filter runs.
        left_out: readings that were too many to be used.
        steps: number of filter steps that the period took.
    """

    stamp_ns: int
    state: FilterState | AwaitingStart
    counts: Counts
    model: FilterModel
    measured: Measured | None = None
    recent: RecentPeriods | None = None
    left_out: LeftOut = LeftOut()
    steps: int = 0


class LearnedState(NamedTuple):
    """What a localizer keeps when it starts anew.

    Attributes:
        process_noise: `(2,)` the adapted Q, without the temporary share of an alarm (m^2, rad^2).
        measurement_noise: `(4,)` the adapted R, likewise, rows as in `Row`.
        log_weight: `(H, M)` log weights of the members of lasting errors; None: the prior's.
    """

    process_noise: FloatArray
    measurement_noise: FloatArray
    log_weight: FloatArray | None = None


class History:
    """The checkpoints of the last periods, and the inputs that they were run with.

    Args:
        parameters: the localizer's parameters.
        diagnostics: counts what happens to inputs and periods.
        on_period: is called with every period that is run, also when it is run again.

    Attributes:
        inputs: of the checkpoints' periods, and later ones.
        too_late_ns: the stamp up to which an input is dropped [ns].
    """

    def __init__(
        self,
        parameters: LocalizerParameters,
        diagnostics: DiagnosticsReport,
        on_period: Callable[[Period], None] | None,
    ) -> None:
        self.inputs = InputBuffer(parameters)
        self._kept_ns = round(parameters.history * 1e9)
        self._diagnostics = diagnostics
        self._on_period = on_period
        self._checkpoints: deque[Checkpoint] = deque()
        self._changed_ns = NEVER_NS
        self._steps_left = MOST_REDONE
        self.too_late_ns = -NEVER_NS

    @property
    def is_empty(self) -> bool:
        """Whether no period has been begun."""
        return not self._checkpoints

    @property
    def oldest(self) -> Checkpoint:
        """The oldest checkpoint; there is one."""
        return self._checkpoints[0]

    @property
    def newest(self) -> Checkpoint:
        """The newest checkpoint; there is one."""
        return self._checkpoints[-1]

    def begin(self, stamp_ns: int, waiting: AwaitingStart, model: FilterModel) -> None:
        """Open the first period at an instant [ns]."""
        self.too_late_ns = stamp_ns
        self._checkpoints.append(
            Checkpoint(stamp_ns=stamp_ns, state=waiting, counts=Counts(), model=model)
        )

    def add(self, event: Event) -> BufferChange:
        """Take an event in; periods that it changes are run again with the next one."""
        change = self.inputs.add(event)
        if change.changed_ns is not None:
            self._changed_ns = min(self._changed_ns, change.changed_ns)
        return change

    def close(self, end_ns: int, model: FilterModel) -> Estimate | None:
        """Run the periods that late inputs belong to again, and then the one that ends now.

        Where this has been too much work lately, late inputs wait for a later period.

        A filter whose numbers do not stay finite even without measurements starts anew with what
        it had learned; diagnostics count it.

        Args:
            end_ns: the end of the open period [ns].
            model: it is run with.
        """
        kept = deque(self._checkpoints)
        redo = self._taken_back(kept, end_ns)
        estimate = None
        try:
            for stamp_ns, model_then in [
                *((before.stamp_ns, before.model) for before in reversed(redo)),
                (end_ns, model),
            ]:
                checkpoint, estimate = self._run_or_predict(kept[-1], stamp_ns, model_then)
                kept.append(checkpoint)
        except FAILURES as error:
            self._diagnostics.failed(end_ns, str(error), restarts=True)
            waiting = AwaitingStart(*learned_by(model, self.newest.state))
            lost = Checkpoint(
                stamp_ns=end_ns, state=waiting, counts=self.inputs.counts_at(end_ns), model=model
            )
            kept, estimate = deque([lost]), None
        self._checkpoints = kept
        self._count_left_out(redo)
        self._diagnostics.redone(len(redo))
        return estimate

    def _taken_back(self, kept: deque[Checkpoint], end_ns: int) -> list[Checkpoint]:
        """Remove the checkpoints from which periods are run again now; return them."""
        more = MOST_REDONE * (end_ns - self.newest.stamp_ns) / 1e9
        self._steps_left = min(self._steps_left + more, MOST_REDONE)
        if self._steps_left <= 0.0:
            return []
        redo: list[Checkpoint] = []
        while len(kept) > 1 and kept[-1].stamp_ns >= self._changed_ns:
            redo.append(kept.pop())
        self._steps_left -= sum(before.steps for before in redo)
        self._changed_ns = NEVER_NS
        return redo

    def move(self, by_ns: int) -> None:
        """Move all that is kept in time [ns], as the clock was set; diagnostics begin anew."""
        self.inputs.move(by_ns)
        self.too_late_ns += by_ns
        if self._changed_ns != NEVER_NS:
            self._changed_ns += by_ns
        self._checkpoints = deque(
            before._replace(
                stamp_ns=before.stamp_ns + by_ns,
                measured=None
                if before.measured is None
                else Measured(*(stamp_ns + by_ns for stamp_ns in before.measured)),
                recent=None,
            )
            for before in self._checkpoints
        )

    def forget(self) -> None:
        """Drop what lies further back than `history`, and no late input waits for."""
        newest_ns = self.newest.stamp_ns
        oldest_needed_ns = max(
            min(newest_ns - self._kept_ns, self._changed_ns - 1),
            newest_ns - LONGEST_KEPT * self._kept_ns,
        )
        while len(self._checkpoints) > 1 and self._checkpoints[1].stamp_ns <= oldest_needed_ns:
            self._checkpoints.popleft()
        oldest_ns = self.oldest.stamp_ns
        kept_ns = newest_ns - self._kept_ns
        earlier = (each.stamp_ns for each in self._checkpoints if each.stamp_ns <= kept_ns)
        self.too_late_ns = max(earlier, default=oldest_ns)
        if self._changed_ns <= oldest_ns:
            self._diagnostics.shed(self.inputs.readings_between(self._changed_ns - 1, oldest_ns))
            self._changed_ns = oldest_ns + 1
        self.inputs.forget_before(oldest_ns)

    def _count_left_out(self, redo: list[Checkpoint]) -> None:
        """Count the readings left out of the newest period, and new ones of periods run again."""
        counted = {before.stamp_ns: before.left_out for before in redo}
        for checkpoint in self._checkpoints:
            if checkpoint.stamp_ns in counted or checkpoint is self.newest:
                before = counted.get(checkpoint.stamp_ns, LeftOut())
                more = (
                    max(now - then, 0)
                    for now, then in zip(checkpoint.left_out, before, strict=True)
                )
                self._diagnostics.left_out(LeftOut(*more))

    def _run_or_predict(
        self, before: Checkpoint, end_ns: int, model: FilterModel
    ) -> tuple[Checkpoint, Estimate | None]:
        """Run a period; by the wheels alone if it fails with its measurements."""
        counts = before.counts
        if before.measured is not None:
            counts = self.inputs.counts_to_go_on_from(before.stamp_ns, counts, before.measured)
        inputs = self.inputs.period(before.stamp_ns, end_ns, counts)
        try:
            return self._run_period(before, end_ns, model, inputs)
        except FAILURES as error:
            predicted = self._run_period(before, end_ns, model, without_measurements(inputs))
            self._diagnostics.failed(end_ns, str(error), restarts=False)
            return predicted

    def _run_period(
        self, before: Checkpoint, end_ns: int, model: FilterModel, inputs: PeriodInputs
    ) -> tuple[Checkpoint, Estimate | None]:
        begin = before.state
        if isinstance(begin, FilterState):
            begin = for_mode(model, begin)
        state, result = run_period(model, begin, inputs)
        if isinstance(state, FilterState):
            check_finite(state)
        if self._on_period is not None:
            self._on_period(Period(end_ns=end_ns, inputs=inputs, before=before.state, after=state))
        recent = recent_after(model, before.recent, begin, state, inputs, result, end_ns)
        measured = _measured_after(before.measured, state, inputs, result, end_ns)
        checkpoint = Checkpoint(
            stamp_ns=end_ns,
            state=state,
            counts=inputs.counts,
            model=model,
            measured=measured,
            recent=recent,
            left_out=inputs.left_out,
            steps=len(inputs.epochs) + len(inputs.epochs_after_reset),
        )
        if isinstance(state, AwaitingStart):
            return checkpoint, None
        T = (end_ns - before.stamp_ns) / 1e9
        return checkpoint, Estimate(
            stamp_ns=end_ns,
            state=state,
            twist=inputs.control / T,
            twist_variance=state.process_noise * (T / NOMINAL_PERIOD_S) / T**2,
            result=result,
        )


def learned_by(model: FilterModel, state: FilterState | AwaitingStart) -> LearnedState:
    """Return what a localizer has learned."""
    if isinstance(state, FilterState):
        noise = persistent_noise(model, state.process_noise, state.measurement_noise, state.joint)
        lasting = state.lasting
        return LearnedState(*noise, None if lasting is None else lasting.outages.log_weight)
    noise = model.adaptation.bounds.within(state.process_noise, state.measurement_noise)
    return LearnedState(*noise, state.log_weight)


def _measured_after(
    before: Measured | None,
    state: FilterState | AwaitingStart,
    inputs: PeriodInputs,
    result: StepResult | None,
    end_ns: int,
) -> Measured | None:
    """Return when a position and a yaw were accepted last; a start or a set pose counts as both."""
    if isinstance(state, AwaitingStart):
        return None
    if before is None or result is None or inputs.reset is not None:
        return Measured(end_ns, end_ns)
    return Measured(
        end_ns if result.accepted_position else before.position_ns,
        end_ns if result.accepted_yaw else before.yaw_ns,
    )
