# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Every start on a real recording: the localizer's own periods, all 25 starts as one batch.

The localizer orders what was recorded into periods, cut into epochs at the readings,
once: they do not depend on the noise. Where late inputs had it run periods again, the last version
counts; so the filters see all that came within `history` in its place, and what they say is what a
localizer would say that had all of it in time. Each start then goes through `run_period`, from the
waiting for the first pose on: P at the start is R of that start.

A factor k of R multiplies the R that the filter assumes at the start, wherever it is from: where
the fixes bring covariances of their own, they count k times, too.
"""

import dataclasses
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import NamedTuple

import numpy as np

from fnn_ekf_ros.core.arrays import (
    STATE_SIZE,
    FloatArray,
    Row,
    components_first,
    components_last,
)
from fnn_ekf_ros.core.filter import step
from fnn_ekf_ros.core.results import Epoch
from fnn_ekf_ros.core.state import FilterModel, FilterState, start_filter
from fnn_ekf_ros.localizer.history import LearnedState
from fnn_ekf_ros.localizer.localizer import Localizer
from fnn_ekf_ros.membership.files import networks_for
from fnn_ekf_ros.parameters.localizer import LocalizerParameters
from fnn_ekf_ros.study.filters import SMALLEST_WINDOW
from fnn_ekf_ros.study.recording import Start
from fnn_ekf_ros.study.scores import LOST_FACTOR
from fnn_ekf_ros.study.starts import Cell, with_noise_factors
from fnn_ekf_ros.timeline.filter_model import filter_model
from fnn_ekf_ros.timeline.initialization import AwaitingStart, wait
from fnn_ekf_ros.timeline.inputs import PeriodInputs
from fnn_ekf_ros.timeline.period import Period, run_period, state_at_begin
from fnn_ekf_ros.timeline.trajectory import pose_errors

POSITION_SIZE = 2
"""Number of components of an error whose yaw is not known: x and y."""


class PeriodRecorder:
    """Keeps the periods of a localizer as they were run last; for its `on_period`.

    Attributes:
        periods: in the order of time.
        broken_ns: end of the first period that does not continue the one before; None if all do.
    """

    def __init__(self) -> None:
        self.periods: list[Period] = []
        self.broken_ns: int | None = None
        self._begin: FilterState | AwaitingStart | None = None

    def __call__(self, period: Period) -> None:
        """Take a period in, in place of all that were run for this time or later before."""
        while self.periods and self.periods[-1].end_ns >= period.end_ns:
            self.periods.pop()
        if self._begin is None:
            self._begin = period.before
        before = self.periods[-1].after if self.periods else self._begin
        if period.before is not before and self.broken_ns is None:
            self.broken_ns = period.end_ns
        self.periods.append(period)


class BatchStart(NamedTuple):
    """All starts at the first pose.

    Attributes:
        stamp_ns: of the first pose, ROS time [ns].
        start: `(n,)` starts, one for each cell, at the instant at which the filters start; without
            errors that last.
        from_readings: whether they are of a fix and a yaw.
        rest: epochs from that instant to the first pose.
        inputs: of the periods that follow.
        stamps_ns: their ends [ns].
        log_weight: `(H, M, n)` log weights of the members of lasting errors; None: the prior's.
    """

    stamp_ns: int
    start: Start
    from_readings: bool
    rest: tuple[Epoch, ...]
    inputs: tuple[PeriodInputs, ...]
    stamps_ns: tuple[int, ...]
    log_weight: FloatArray | None = None


class Run(NamedTuple):
    """Estimates of a filter from every start.

    Attributes:
        mean: `(T, n, 3)` poses, the first one included (m, m, rad; map frame).
        covariance: `(T, n, 3, 3)` their covariances.
        process_noise: `(n, 2)` diagonal of Q in use at the end (m^2, rad^2).
        measurement_noise: `(n, 4)` diagonal of R in use at the end.
    """

    mean: FloatArray
    covariance: FloatArray
    process_noise: FloatArray
    measurement_noise: FloatArray


class _FirstState(NamedTuple):
    """The start of a filter.

    Attributes:
        taken: number of periods that it needs to start.
        state: at its start.
        from_readings: whether it is of a fix and a yaw.
        rest: epochs of the last of these periods that it has still to see.
    """

    taken: int
    state: FilterState
    from_readings: bool
    rest: tuple[Epoch, ...]


class RealScore(NamedTuple):
    """Errors of a filter from every start; infinite where its numbers were not finite.

    Attributes:
        rmse: `(n, 3)` root mean square error (m, m, rad); NaN yaw if truth has none.
        position: `(n,)` of the distance [m].
        furthest: `(n,)` largest distance [m].
        median_nees: `(n,)` median of e' P^-1 e over time.
        mean_nees: `(n,)` mean of it.
        nees_size: number of components of e: 3, or 2 (x and y alone) if truth has no yaw.
    """

    rmse: FloatArray
    position: FloatArray
    furthest: FloatArray
    median_nees: FloatArray
    mean_nees: FloatArray
    nees_size: int


def recording_localizer(parameters: LocalizerParameters) -> tuple[Localizer, PeriodRecorder]:
    """Return the localizer, adapting nothing, and what keeps its periods."""
    fixed = dataclasses.replace(parameters, adaptation="none", innovation_window=SMALLEST_WINDOW)
    recorder = PeriodRecorder()
    return Localizer(fixed, networks_for(fixed), recorder), recorder


def batch_start(
    parameters: LocalizerParameters,
    periods: Sequence[Period],
    cells: Sequence[Cell],
    taught: LearnedState | None = None,
) -> BatchStart:
    """Return the starts of all cells, as the localizer finds them.

    Args:
        parameters: with the noise that a factor of 1 stands for.
        periods: in which a filter starts, or has started before.
        cells: how wrong the starts are.
        taught: what was learned before, each with a last axis of the cells; it replaces their
            noise, as a warm start's replaces the configured one. Covariances that fixes report then
            count once.

    Raises:
        ParameterError: the noise of a cell would leave its bounds.
    """
    networks = networks_for(parameters)
    taken, states, noises = 0, [], []
    from_readings = False
    rest: tuple[Epoch, ...] = ()
    for index, cell in enumerate(cells):
        model = filter_model(with_noise_factors(parameters, cell), networks)
        # The filters that start here add the errors that last themselves.
        model = dataclasses.replace(model, lasting_errors=False)
        noise = np.asarray(model.process_noise), np.asarray(model.measurement_noise)
        factor = cell.k
        if taught is not None:
            noise = taught.process_noise[:, index], taught.measurement_noise[:, index]
            factor = 1.0
        taken, state, from_readings, rest = _first_state(model, noise, factor, periods)
        states.append(state)
        noises.append(noise)
    period_ns = round(parameters.period * 1e9)
    following = periods[taken:]
    return BatchStart(
        stamp_ns=periods[taken - 1].end_ns if taken else periods[0].end_ns - period_ns,
        start=Start(
            mean=np.stack([state.mean for state in states]),
            covariance=np.stack([state.covariance for state in states]),
            process_noise=np.stack([Q for Q, _ in noises]),
            measurement_noise=np.stack([R for _, R in noises]),
        ),
        from_readings=from_readings,
        rest=rest,
        inputs=tuple(period.inputs for period in following),
        stamps_ns=tuple(period.end_ns for period in following),
        log_weight=None if taught is None else taught.log_weight,
    )


def run_starts(
    model: FilterModel,
    batch: BatchStart,
    hold: Callable[[FilterState], FilterState] = lambda state: state,
) -> Iterator[FilterState]:
    """Yield the state at the start and after each period, all starts as one batch.

    Args:
        model: the filter, with the noise that a factor of 1 stands for.
        batch: starts and periods.
        hold: changes each of these states before the filter goes on from it.
    """
    start = batch.start
    begin = start_filter(
        model,
        components_first(start.mean),
        components_first(start.covariance, 2),
        components_first(start.process_noise),
        components_first(start.measurement_noise),
        from_readings=batch.from_readings,
        log_weight=batch.log_weight,
    )
    cells = len(start.mean)
    begin = hold(begin)
    if batch.rest:
        begin, _ = step(model, begin, [_of_all(epoch, cells) for epoch in batch.rest])
        begin = hold(begin)
    yield begin
    for inputs in batch.inputs:
        after, _ = run_period(model, begin, _for_cells(inputs, cells))
        assert isinstance(after, FilterState)  # a filter that runs never waits again
        begin = hold(after)
        yield begin


def _for_cells(inputs: PeriodInputs, cells: int) -> PeriodInputs:
    """Return the same inputs for so many filters."""
    return inputs._replace(
        epochs=tuple(_of_all(epoch, cells) for epoch in inputs.epochs),
        epochs_after_reset=tuple(_of_all(epoch, cells) for epoch in inputs.epochs_after_reset),
    )


def _of_all(epoch: Epoch, cells: int) -> Epoch:
    reported = epoch.fix_covariance
    return Epoch(
        control=np.broadcast_to(epoch.control[:, None], (len(epoch.control), cells)),
        duration_s=epoch.duration_s,
        measurement=np.broadcast_to(epoch.measurement[:, None], (len(epoch.measurement), cells)),
        available=np.broadcast_to(epoch.available[:, None], (len(epoch.available), cells)),
        fix_covariance=None
        if reported is None
        else np.broadcast_to(reported[..., None], (*reported.shape, cells)),
    )


def collect(states: Iterable[FilterState]) -> Run:
    """Return what a filter estimated, of its states; there is at least one."""
    means, covariances, last = [], [], None
    for state in states:
        means.append(components_last(state.mean))
        covariances.append(components_last(state.covariance, 2))
        last = state
    if last is None:
        raise ValueError("no states: expected one at least")
    return Run(
        mean=np.stack(means),
        covariance=np.stack(covariances),
        process_noise=components_last(last.process_noise),
        measurement_noise=components_last(last.measurement_noise),
    )


def score_starts(run: Run, truth: FloatArray) -> RealScore:
    """Return the errors wherever the truth is known.

    Args:
        run: `(T, n)`.
        truth: `(T, 3)` true poses, NaN where they are not known; the position is somewhere.
    """
    known = np.isfinite(truth[:, 0])
    error = pose_errors(run.mean[known], truth[known, None])
    rmse = np.sqrt(np.mean(error[..., :2] ** 2, axis=0))
    yaw, covariance = np.full(error.shape[1], np.nan), run.covariance[known]
    with_yaw = np.isfinite(truth[known, 2])
    if np.any(with_yaw):
        size = STATE_SIZE
        yaw = _or_infinite(np.sqrt(np.mean(error[with_yaw, :, 2] ** 2, axis=0)))
        nees = _nees(error[with_yaw], covariance[with_yaw])
    else:
        size = POSITION_SIZE
        nees = _nees(error[..., :size], covariance[..., :size, :size])
    return RealScore(
        rmse=np.column_stack([_or_infinite(rmse), yaw]),
        position=_or_infinite(np.hypot(rmse[:, 0], rmse[:, 1])),
        furthest=_or_infinite(np.max(np.hypot(error[..., 0], error[..., 1]), axis=0)),
        median_nees=_or_infinite(np.median(nees, axis=0)),
        mean_nees=_or_infinite(np.mean(nees, axis=0)),
        nees_size=size,
    )


def _nees(error: FloatArray, covariance: FloatArray) -> FloatArray:
    """Return e' P^-1 e, `(...)`, of errors `(..., m)` with covariances `(..., m, m)`."""
    weighted = np.linalg.solve(covariance, error[..., None])[..., 0]
    return np.asarray(np.sum(error * weighted, axis=-1))


def diverged(score: RealScore, best_position: float) -> FloatArray:
    """Return from which starts a filter was lost, `(n,)`, 1 or 0.

    Args:
        score: of the filter.
        best_position: position RMSE of the best fixed EKF [m].
    """
    return np.asarray(score.furthest > LOST_FACTOR * best_position, dtype=np.float64)


def rows_measured(batch: BatchStart) -> tuple[Row, ...]:
    """Return the rows that were measured at least once after the start."""
    seen = np.any([epoch.available for inputs in batch.inputs for epoch in _epochs(inputs)], axis=0)
    return tuple(row for row in Row if seen[row])


def _first_state(
    model: FilterModel,
    noise: tuple[FloatArray, FloatArray],
    factor: float,
    periods: Sequence[Period],
) -> _FirstState:
    """Return the first state of a filter.

    Args:
        model: the filter.
        noise: Q `(2,)` and R `(4,)` to start with.
        factor: of the covariances that fixes report.
        periods: in which it starts, or has started before.
    """
    before = periods[0].before
    if isinstance(before, FilterState):
        known = start_filter(model, before.mean, before.covariance, *noise)
        return _FirstState(0, known, from_readings=False, rest=())
    state: FilterState | AwaitingStart = AwaitingStart(
        *noise, given_pose=before.given_pose, given_covariance=before.given_covariance
    )
    for taken, period in enumerate(periods, 1):
        state = state_at_begin(model, state, period.inputs)
        if isinstance(state, FilterState):  # from `initial_pose`
            return _FirstState(taken - 1, state, from_readings=False, rest=())
        inputs = _reported_times(period.inputs, factor)
        if inputs.reset is not None:
            state, _ = run_period(model, state, inputs._replace(epochs_after_reset=()))
            assert isinstance(state, FilterState)
            rest = period.inputs.epochs_after_reset
            return _FirstState(taken, state, from_readings=False, rest=rest)
        for place, epoch in enumerate(inputs.epochs if inputs.wheels_known else (), 1):
            state = wait(model, state, epoch)
            if isinstance(state, FilterState):
                rest = period.inputs.epochs[place:]
                return _FirstState(taken, state, from_readings=True, rest=rest)
    raise ValueError("the filter never starts: expected periods in which it does")


def _epochs(inputs: PeriodInputs) -> tuple[Epoch, ...]:
    return (*inputs.epochs, *inputs.epochs_after_reset)


def _reported_times(inputs: PeriodInputs, factor: float) -> PeriodInputs:
    """Return the inputs with the covariances that fixes reported times a factor."""
    return inputs._replace(
        epochs=tuple(
            epoch
            if epoch.fix_covariance is None
            else epoch._replace(fix_covariance=factor * epoch.fix_covariance)
            for epoch in inputs.epochs
        )
    )


def _or_infinite(values: FloatArray) -> FloatArray:
    return np.where(np.isfinite(values), values, np.inf)
