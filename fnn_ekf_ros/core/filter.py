# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The filter's step, in the paper's order.

`fuse` takes a filter from one instant with readings to the next: predict by the wheels, innovate,
gate, correct, learn. `step` takes it over a period with any number of such instants, up to the
period's end, where the paper's modes adapt the noise. A `FilterState` is never changed: an old
state that was kept is enough to repeat the steps after it.

Every array has its components first and may have batch dimensions last: a mean is `(3, *batch)`.
"""

from collections.abc import Sequence

import numpy as np

from fnn_ekf_ros.core.adaptation import Adapted, Scales, adapt
from fnn_ekf_ros.core.arrays import (
    MEASUREMENT_SIZE,
    STATES_OF_ROWS,
    Constant,
    FloatArray,
    diagonal_of,
)
from fnn_ekf_ros.core.bank import (
    Bank,
    correct,
    innovate,
    noise_of_readings,
    predict,
    wrapped,
)
from fnn_ekf_ros.core.frozen import without_frozen
from fnn_ekf_ros.core.gated import Gated, gate_after, pass_gate
from fnn_ekf_ros.core.instant import Instant
from fnn_ekf_ros.core.joint_learning import learn_at
from fnn_ekf_ros.core.joint_state import Learned, fading, noise_in_use, report
from fnn_ekf_ros.core.lasting.report import report_lasting
from fnn_ekf_ros.core.lasting_step import (
    MembersAtInstant,
    as_white_filters_see,
    lasting_after,
    lasting_at_instant,
    members_at_instant,
    restarted_from_witness,
)
from fnn_ekf_ros.core.pace import (
    NOMINAL_PERIOD_S,
    after_readings,
    is_step,
    later,
    scored_rows,
)
from fnn_ekf_ros.core.relocation import later_hypothesis, nis_by_sensor
from fnn_ekf_ros.core.relocation_filter import with_hypothesis
from fnn_ekf_ros.core.results import (
    Epoch,
    Shown,
    StepResult,
    last_of_each_row,
    nothing_shown,
)
from fnn_ekf_ros.core.rows import FIX_ROWS, Rows, rows_where
from fnn_ekf_ros.core.state import (
    WHITE,
    WHITE_INDEX,
    FilterModel,
    FilterState,
    with_noise,
)
from fnn_ekf_ros.core.suspect_filters import suspects_after
from fnn_ekf_ros.core.window import push

_ONES = Constant([1.0] * MEASUREMENT_SIZE)
"""Change of R in use per change of the filter's own R where fixes report none, rows as in `Row`."""


def step(
    model: FilterModel, state: FilterState, epochs: Sequence[Epoch]
) -> tuple[FilterState, StepResult]:
    """Take the filter over one period.

    Args:
        model: the filter.
        state: its state at the start of the period; not changed.
        epochs: of the period, at least one.

    Returns:
        The state at the period's end, and the results of the period.
    """
    begin, shown = state, []
    for epoch in epochs:
        state, seen = fuse(model, state, epoch)
        if seen is not None:
            shown.append(seen)
    last = last_of_each_row(shown) if shown else _without_readings(begin, state)
    state, adapted = _adapt_by_mismatch(model, state, last)
    return state, _step_result(state, last, adapted, tuple(shown))


def _adapt_by_mismatch(
    model: FilterModel, state: FilterState, last: Shown
) -> tuple[FilterState, Adapted]:
    """Adapt the noise by the paper's modes at a period's end, from the last reading of each row."""
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
    return state, adapted


def _step_result(
    state: FilterState, last: Shown, adapted: Adapted, shown: tuple[Shown, ...]
) -> StepResult:
    """Return the results of a period that ends with a state."""
    joint = None if state.joint is None else report(state.joint, last.learned)
    return StepResult(
        innovation=last.innovation,
        innovation_variance=last.innovation_variance,
        available=last.available,
        nis=last.nis,
        degrees_of_freedom=last.degrees_of_freedom,
        mismatch=adapted.mismatch,
        firing_strength=adapted.firing_strength if joint is None else joint.firing_strength,
        process_firing_strength=adapted.process_firing_strength,
        joint=joint,
        lasting=None if state.lasting is None else report_lasting(state.lasting),
        sensor_nis=last.sensor_nis,
        sensor_degrees_of_freedom=last.sensor_degrees_of_freedom,
        rejected=last.rejected,
        relocated=last.relocated,
        shown=shown,
    )


def _without_readings(begin: FilterState, end: FilterState) -> Shown:
    """Return the results of a period without readings."""
    variance = end.covariance[STATES_OF_ROWS, STATES_OF_ROWS]
    return nothing_shown(end.mean[2], variance + begin.measurement_noise)


def fuse(model: FilterModel, state: FilterState, epoch: Epoch) -> tuple[FilterState, Shown | None]:
    """Take the filter to the next instant.

    Args:
        model: the filter.
        state: its state at the instant before; not changed.
        epoch: the step of the wheels, and the readings at its end.

    Returns:
        The state after the readings, and their results; None without readings. Those of a frozen
        sensor are not available.
    """
    measured = epoch.available.any()
    unchanged, epoch = without_frozen(state.unchanged, epoch, model.measurement_noise)
    state = state._replace(unchanged=unchanged)
    elapsed = epoch.duration_s / NOMINAL_PERIOD_S
    Q = elapsed * state.noise.process
    predicted = predict(model.motion_model, state.bank, epoch.control, Q)
    state = _later(state, epoch, elapsed)
    state, noise_of_members = lasting_at_instant(model, state, epoch)
    rows = rows_where(epoch.available)
    if not rows.some.any():
        state, _ = lasting_after(state, epoch, None, None)
        state = _alarm_faded(model, state._replace(bank=wrapped(predicted)))
        return state, _without_readings(state, state) if measured else None

    members = members_at_instant(model, state, epoch, noise_of_members)
    instant = _instant(model, state, epoch, predicted, rows)
    nis = nis_by_sensor(instant.seen, instant.taken, WHITE_INDEX)
    gated = pass_gate(model, state, instant, nis if members is None else members.seen.nis)
    state, restart = lasting_after(state, epoch, members, gated)
    scored = scored_rows(state.pace, rows)
    steps = is_step(state.pace, scored)
    bank, lead = _corrected_bank(model, state, instant, gated.corrected, scored)
    learned = None
    if state.joint is not None:
        state, learned = learn_at(model, state, instant, bank, gated.teaches, scored, steps)
    state = state._replace(
        bank=wrapped(bank),
        gate=gate_after(model, state, gated),
        lead=lead,
        pace=after_readings(state.pace, rows, scored, steps),
    )
    if gated.relocation is not None:
        state = with_hypothesis(model, state, gated.relocation)
    state = restarted_from_witness(model, state, restart)
    if learned is not None and state.joint is not None:
        state = with_noise(model, state, *noise_in_use(state.joint, model.adaptation.bounds))
    else:
        state = _alarm_faded(model, state)
    shown = _shown(model, epoch, instant, gated, learned)
    return state, shown if members is None else _as_mixture_shows(shown, members)


def _instant(
    model: FilterModel, state: FilterState, epoch: Epoch, predicted: Bank, rows: Rows
) -> Instant:
    """Return the instant at the end of an epoch with readings."""
    compared = model.layout.compared
    noise = noise_of_readings(
        state.noise.filters(compared),
        model.measurement_noise,
        epoch.fix_covariance,
        epoch.available,
    )
    readings, noise = as_white_filters_see(state, epoch, noise)
    seen = innovate(predicted.filters(compared), readings, noise.measurement)
    taken = correct(predicted, seen, noise, epoch.available)
    return Instant(
        predicted=predicted,
        readings=readings,
        rows=rows,
        noise=noise,
        seen=seen,
        taken=taken,
        fix_covariance=epoch.fix_covariance,
    )


def _shown(
    model: FilterModel, epoch: Epoch, instant: Instant, gated: Gated, learned: Learned | None
) -> Shown:
    """Return the results of an instant."""
    decision, relocation = gated.decision, gated.relocation
    nowhere = np.zeros(instant.rows.total.shape, dtype=np.bool_)
    return Shown(
        innovation=instant.seen.innovation[:, WHITE_INDEX],
        innovation_variance=instant.seen.variance[:, WHITE_INDEX],
        available=epoch.available,
        teaches=gated.teaches,
        heading=instant.predicted.mean[2, WHITE_INDEX],
        reported_scale=_reported_scale(model, epoch),
        nis=instant.taken.nis[WHITE_INDEX],
        degrees_of_freedom=instant.rows.total,
        sensor_nis=decision.nis,
        sensor_degrees_of_freedom=instant.rows.of_sensor,
        rejected=decision.rejected,
        relocated=nowhere if relocation is None else relocation.confirmed,
        learned=learned,
    )


def _as_mixture_shows(shown: Shown, members: MembersAtInstant) -> Shown:
    """Return the results of an instant with the innovations of the published mixture."""
    return shown._replace(
        innovation=members.seen.mixed,
        innovation_variance=members.seen.variance,
        nis=members.seen.nis.sum(axis=0),
    )


def _later(state: FilterState, epoch: Epoch, elapsed: float) -> FilterState:
    """Return the state with all times advanced to the next instant."""
    joint = state.joint
    if joint is not None:
        joint = fading(joint, epoch.control, elapsed)
    hypothesis = later_hypothesis(state.relocation_hypothesis, epoch.duration_s)
    pace = later(state.pace, elapsed)
    return state._replace(joint=joint, relocation_hypothesis=hypothesis, pace=pace)


def _corrected_bank(
    model: FilterModel, state: FilterState, instant: Instant, corrected: Bank, scored: Rows
) -> tuple[Bank, FloatArray]:
    """Return the bank after the readings, without the relocation hypothesis, and suspects' leads.

    Args:
        model: the filter.
        state: before the readings.
        instant: the readings.
        corrected: at least the white filter and those of joint adaptation, after the readings.
        scored: rows that are scored.
    """
    bank, which = instant.taken.bank.filters(model.layout.steady), model.layout.suspects
    if corrected is not instant.taken.bank:
        bank.mean[:, : which.start] = corrected.mean
        bank.covariance[:, :, : which.start] = corrected.covariance
    if not model.suspects:
        return bank, state.lead
    suspects, lead = suspects_after(model, state, instant, bank.filters(WHITE), scored)
    bank.mean[:, which] = suspects.mean
    bank.covariance[:, :, which] = suspects.covariance
    return bank, lead


def _alarm_faded(model: FilterModel, state: FilterState) -> FilterState:
    """Return the state with the noise in use after alarms have faded; unchanged without alarms."""
    if state.joint is None or not (state.joint.lead > 0.0).any():
        return state
    return with_noise(model, state, *noise_in_use(state.joint, model.adaptation.bounds))


def _reported_scale(model: FilterModel, epoch: Epoch) -> FloatArray:
    """Return the change of R in use per change of the filter's own R, `(4, *batch)`."""
    if epoch.fix_covariance is None:
        return _ONES.behind(epoch.available.ndim - 1)
    scale = np.ones(epoch.available.shape)
    reported = diagonal_of(epoch.fix_covariance)
    for place, row in enumerate(FIX_ROWS):
        own = model.measurement_noise[row]
        scale[row] = np.where(epoch.available[row], reported[place], own) / own
    return scale
