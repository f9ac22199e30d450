"""The filter's step, in the paper's order.

`fuse` takes a filter from one instant at which something was measured to the next: predict by the
wheels, innovate, judge, correct, learn. `step` takes it over a period, which is as many instants as
there were readings, and ends at the period's boundary; there the paper's modes adapt the noise.
A `FilterState` is never changed, so keeping an old one is all it takes to go back in time.

Every array has its components first and may have batch dimensions last: a mean is `(3, *batch)`.
"""

from collections.abc import Sequence

import numpy as np

from fnn_ekf_ros.core.adaptation import Scales, adapt
from fnn_ekf_ros.core.arrays import (
    MEASUREMENT_SIZE,
    STATE_OF_ROW,
    BoolArray,
    Constant,
    FloatArray,
    diagonal_of,
)
from fnn_ekf_ros.core.bank import (
    Bank,
    Readings,
    correct,
    innovate,
    noise_of_readings,
    predict,
    wrapped,
)
from fnn_ekf_ros.core.candidate import follow_candidate, with_candidate
from fnn_ekf_ros.core.evidence import log_likelihood
from fnn_ekf_ros.core.gate import (
    GateState,
    Verdict,
    after_verdict,
    judge,
    rows_of,
    teaching,
)
from fnn_ekf_ros.core.instant import Instant
from fnn_ekf_ros.core.joint import (
    Learned,
    Lesson,
    fading,
    learn,
    noise_in_use,
    report,
    stepped,
)
from fnn_ekf_ros.core.joint_filters import FORECASTS, step_forecasts
from fnn_ekf_ros.core.pace import (
    NOMINAL_PERIOD_S,
    after_readings,
    is_step,
    later,
    scored_rows,
)
from fnn_ekf_ros.core.relocation import Followed, nis_by_sensor
from fnn_ekf_ros.core.results import (
    Epoch,
    Shown,
    StepResult,
    last_of_each_row,
    nothing_shown,
)
from fnn_ekf_ros.core.rows import FIX_ROWS, Rows, rows_where
from fnn_ekf_ros.core.state import (
    JOINT,
    PUBLISHED,
    FilterModel,
    FilterState,
    with_noise,
)
from fnn_ekf_ros.core.suspect_filters import suspects_after
from fnn_ekf_ros.core.window import push

__all__ = [
    "NOMINAL_PERIOD_S",
    "Epoch",
    "FilterModel",
    "FilterState",
    "Shown",
    "StepResult",
    "fuse",
    "step",
]

_ONES = Constant([1.0] * MEASUREMENT_SIZE)


def step(
    model: FilterModel, state: FilterState, epochs: Sequence[Epoch]
) -> tuple[FilterState, StepResult]:
    """Take the filter over one period.

    Args:
        model: the filter.
        state: its state at the period's begin; not changed.
        epochs: which the period consists of, one at least.

    Returns:
        The state at the period's end, and what the period showed.
    """
    begin, shown = state, []
    for epoch in epochs:
        state, seen = fuse(model, state, epoch)
        if seen is not None:
            shown.append(seen)
    last = last_of_each_row(shown) if shown else _nothing(begin, state)
    teaches = last.teaches & ~last.relocated
    window = push(state.window, last.innovation, teaches)
    adapted = adapt(
        model.adaptation,
        state.process_noise,
        state.measurement_noise,
        window,
        last.innovation_variance,
        teaches,
        last.heading,
        Scales(process=model.period_s / NOMINAL_PERIOD_S, measurement=last.reported_scale),
    )
    state = state._replace(window=window)
    if model.adaptation.moves_by_mismatch:
        state = with_noise(model, state, adapted.process_noise, adapted.measurement_noise)
    joint = None if state.joint is None else report(state.joint, last.learned)
    return state, StepResult(
        innovation=last.innovation,
        innovation_variance=last.innovation_variance,
        available=last.available,
        nis=last.nis,
        degrees_of_freedom=last.degrees_of_freedom,
        mismatch=adapted.mismatch,
        firing_strength=adapted.firing_strength if joint is None else joint.firing_strength,
        process_firing_strength=adapted.process_firing_strength,
        joint=joint,
        sensor_nis=last.sensor_nis,
        sensor_degrees_of_freedom=last.sensor_degrees_of_freedom,
        rejected=last.rejected,
        relocated=last.relocated,
        shown=tuple(shown),
    )


def _nothing(begin: FilterState, end: FilterState) -> Shown:
    """Return what a period without readings shows."""
    variance = end.covariance[list(STATE_OF_ROW), list(STATE_OF_ROW)]
    return nothing_shown(end.mean[2], variance + begin.measurement_noise)


def fuse(model: FilterModel, state: FilterState, epoch: Epoch) -> tuple[FilterState, Shown | None]:
    """Take the filter to the next instant.

    Args:
        model: the filter.
        state: its state at the instant before; not changed.
        epoch: the time until then, and what was measured at its end.

    Returns:
        The state after the readings, and what these showed; None without any.
    """
    elapsed = epoch.duration_s / NOMINAL_PERIOD_S
    Q = elapsed * state.noise.process
    predicted = predict(model.motion_model, state.bank, epoch.control, Q)
    state = _later(model, state, epoch, elapsed)
    rows = rows_where(epoch.available)
    if not rows.some.any():
        return _alarm_faded(model, state._replace(bank=wrapped(predicted))), None

    instant = _instant(model, state, epoch, predicted, rows)
    verdict = judge(
        model.gate, state.gate, nis_by_sensor(instant.seen, instant.taken, 0), rows.of_sensor
    )
    corrected, teaches = instant.taken.bank, epoch.available
    followed = None
    rejects = bool(verdict.rejected.any())
    if rejects:
        accepted = epoch.available & ~rows_of(verdict.rejected)
        corrected = instant.corrected_by(accepted, slice(0, model.layout.suspects.start)).bank
    if rejects or state.has_candidate(model):
        followed = follow_candidate(model, state, instant, verdict, corrected)
        explains = followed.relocation.explains
        teaches = epoch.available & rows_of(teaching(state.gate, verdict, explains))
    scored = scored_rows(state.pace, rows)
    steps = is_step(state.pace, scored)
    bank, lead = _corrected_bank(model, state, instant, corrected, scored)
    learned = None
    if state.joint is not None:
        state, learned = _learn(model, state, instant, bank, teaches, scored, steps)
    state = state._replace(
        bank=wrapped(bank),
        gate=_gate_after(model, state, verdict, followed),
        lead=lead,
        pace=after_readings(state.pace, rows, scored, steps),
    )
    if followed is not None:
        state = with_candidate(model, state, followed)
    if learned is not None and state.joint is not None:
        state = with_noise(model, state, *noise_in_use(state.joint, model.adaptation.bounds))
    else:
        state = _alarm_faded(model, state)
    return state, _shown(model, epoch, instant, verdict, teaches, followed, learned)


def _instant(
    model: FilterModel, state: FilterState, epoch: Epoch, predicted: Bank, rows: Rows
) -> Instant:
    """Return an instant with readings, whose filters are predicted to it."""
    readings = Readings(epoch.measurement, epoch.available)
    compared = model.layout.compared
    noise = noise_of_readings(
        state.noise.filters(compared),
        model.measurement_noise,
        epoch.fix_covariance,
        epoch.available,
    )
    seen = innovate(predicted.filters(compared), readings, noise.measurement)
    taken = correct(predicted, seen, noise, epoch.available)
    return Instant(predicted, readings, rows, noise, seen, taken, epoch.fix_covariance)


def _shown(
    model: FilterModel,
    epoch: Epoch,
    instant: Instant,
    verdict: Verdict,
    teaches: BoolArray,
    followed: Followed | None,
    learned: Learned | None,
) -> Shown:
    """Return what an instant showed."""
    nobody = np.zeros(instant.rows.total.shape, dtype=np.bool_)
    return Shown(
        innovation=instant.seen.innovation[:, 0],
        innovation_variance=instant.seen.variance[:, 0],
        available=epoch.available,
        teaches=teaches,
        heading=instant.predicted.mean[2, 0],
        reported_scale=_reported_scale(model, epoch),
        nis=instant.taken.nis[0],
        degrees_of_freedom=instant.rows.total,
        sensor_nis=verdict.nis,
        sensor_degrees_of_freedom=instant.rows.of_sensor,
        rejected=verdict.rejected,
        relocated=nobody if followed is None else followed.relocation.confirmed,
        learned=learned,
    )


def _later(model: FilterModel, state: FilterState, epoch: Epoch, elapsed: float) -> FilterState:
    """Return the state with its clocks at the next instant."""
    joint, candidate = state.joint, state.candidate
    if joint is not None:
        joint = fading(joint, epoch.control, elapsed)
    if state.has_candidate(model):
        candidate = candidate._replace(age_s=candidate.age_s + epoch.duration_s)
    return state._replace(joint=joint, candidate=candidate, pace=later(state.pace, elapsed))


def _gate_after(
    model: FilterModel, state: FilterState, verdict: Verdict, followed: Followed | None
) -> GateState:
    """Return what the gate remembers; one that rejects nothing need not remember anything."""
    if model.gate.is_open:
        return state.gate
    return after_verdict(
        state.gate,
        verdict,
        verdict.rejected if followed is None else followed.relocation.agrees,
        state.pace.sensors,
        learns=model.adaptation.learns_measurement_noise,
    )


def _corrected_bank(
    model: FilterModel, state: FilterState, instant: Instant, corrected: Bank, scored: Rows
) -> tuple[Bank, FloatArray]:
    """Return all filters but a candidate's after the readings, and the suspects' leads.

    Args:
        model: the filter.
        state: before the readings.
        instant: these.
        corrected: the published filter and those of joint adaptation, at least, after them.
        scored: which rows are scored.
    """
    bank, which = instant.taken.bank.filters(model.layout.steady), model.layout.suspects
    if corrected is not instant.taken.bank:
        bank.mean[:, : which.start] = corrected.mean
        bank.covariance[:, :, : which.start] = corrected.covariance
    if not model.suspects:
        return bank, state.lead
    suspects, lead = suspects_after(model, state, instant, bank.filters(PUBLISHED), scored)
    bank.mean[:, which] = suspects.mean
    bank.covariance[:, :, which] = suspects.covariance
    return bank, lead


def _learn(
    model: FilterModel,
    state: FilterState,
    instant: Instant,
    bank: Bank,
    teaches: BoolArray,
    scored: Rows,
    steps: BoolArray,
) -> tuple[FilterState, Learned | None]:
    """Learn from readings that are scored, and take the forecasts on in the bank.

    Args:
        model: the filter.
        state: before the readings, of mode joint.
        instant: the readings.
        bank: all filters after the readings; its forecasts are replaced.
        teaches: `(4, *batch)` which rows the noise may be learned from.
        scored: which rows are scored.
        steps: `(*batch)` whether these are a step of the forecasts.
    """
    joint = state.joint
    assert joint is not None
    of_joint, ahead = bank.filters(JOINT), instant.predicted.filters(JOINT)
    of_joint.mean[:, FORECASTS] = ahead.mean[:, FORECASTS]
    of_joint.covariance[:, :, FORECASTS] = ahead.covariance[:, :, FORECASTS]
    taught = rows_where(teaches & scored.each)
    learned = None
    if taught.some.any():
        shown, which = instant.taken, JOINT
        if taught is not instant.rows and not np.array_equal(taught.each, instant.rows.each):
            shown, which = instant.corrected_by(taught.each, JOINT), slice(None)
        likelihood = log_likelihood(shown.nis[which], shown.determinant[which], taught.total)
        seen = instant.seen.filters(JOINT)
        lesson = Lesson(
            seen.innovation, seen.variance, likelihood, taught, scored, state.pace.scored
        )
        adaptation = model.adaptation
        sets = adaptation.networks.joint.sets
        learned = learn(joint, sets, adaptation.bounds, lesson, learning=adaptation.learning)
        steps = steps & taught.some
        step_forecasts(of_joint, bank.filters(model.layout.newer_forecasts), steps)
        joint = stepped(learned.state, steps)
    joint = joint._replace(way=np.where(scored.some, 0.0, joint.way))
    return state._replace(joint=joint), learned


def _alarm_faded(model: FilterModel, state: FilterState) -> FilterState:
    """Return the state with the noise in use of an alarm that fades."""
    if state.joint is None or not (state.joint.lead > 0.0).any():
        return state
    return with_noise(model, state, *noise_in_use(state.joint, model.adaptation.bounds))


def _reported_scale(model: FilterModel, epoch: Epoch) -> FloatArray:
    """Return by how much the R in use moves when the filter's own R moves by one."""
    if epoch.fix_covariance is None:
        return _ONES.behind(epoch.available.ndim - 1)
    scale = np.ones(epoch.available.shape)
    reported = diagonal_of(epoch.fix_covariance)
    for place, row in enumerate(FIX_ROWS):
        own = model.measurement_noise[row]
        scale[row] = np.where(epoch.available[row], reported[place], own) / own
    return scale
