# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The relocation hypothesis's filter in the bank, its noise, and the move to its pose."""

import numpy as np

from fnn_ekf_ros.core.arrays import BoolArray, FloatArray, select
from fnn_ekf_ros.core.bank import Bank, Noise, correct, innovate, noise_of_readings
from fnn_ekf_ros.core.gate import GateDecision
from fnn_ekf_ros.core.instant import Instant
from fnn_ekf_ros.core.relocation import (
    HypothesisPrediction,
    HypothesisUpdate,
    nis_by_sensor,
    undoes_last,
    update_hypothesis,
)
from fnn_ekf_ros.core.state import WHITE, FilterModel, FilterState, reset_pose


def follow_hypothesis(
    model: FilterModel,
    state: FilterState,
    instant: Instant,
    decision: GateDecision,
    corrected: Bank,
) -> HypothesisUpdate:
    """Take the hypothesis over an instant, or start one.

    Args:
        model: the filter.
        state: before the readings.
        instant: the readings.
        decision: of the gate.
        corrected: the published filter after them, and maybe others behind it.
    """
    if state.has_relocation_hypothesis(model):
        prediction = _prediction(model, state, instant)
    else:
        prediction = HypothesisPrediction(
            predicted=instant.predicted.filters(WHITE),
            seen=instant.seen.filters(WHITE),
            noise=instant.noise.filters(WHITE),
            nis=decision.nis,
        )
    return update_hypothesis(
        model.gate,
        state.gate,
        state.relocation_hypothesis,
        prediction,
        corrected.filters(WHITE),
        instant.readings,
        decision,
        0.0 if state.lasting is None else state.lasting.rejections_agree,
    )


def with_hypothesis(
    model: FilterModel, state: FilterState, update: HypothesisUpdate
) -> FilterState:
    """Return the state with the hypothesis, or at the hypothesis's pose where it is confirmed."""
    state = _with_filter(model, state, update)
    return _relocated(model, state, update.confirmed) if update.confirmed.any() else state


def _with_filter(model: FilterModel, state: FilterState, update: HypothesisUpdate) -> FilterState:
    """Return the state with the hypothesis's filter in the bank, where any robot has one."""
    steady, before = model.layout.steady, state.relocation_hypothesis.active
    own = state.noise.filters(model.layout.relocation_hypothesis if before.any() else WHITE)
    bank, noise = state.bank.filters(steady), state.noise.filters(steady)
    if not update.hypothesis.active.any():
        return state._replace(bank=bank, noise=noise, relocation_hypothesis=update.hypothesis)
    return state._replace(
        bank=Bank(
            np.concatenate([bank.mean, update.corrected.mean], axis=1),
            np.concatenate([bank.covariance, update.corrected.covariance], axis=2),
        ),
        noise=Noise(
            _with_own(noise.process, own.process, before),
            _with_own(noise.measurement, own.measurement, before),
        ),
        relocation_hypothesis=update.hypothesis,
    )


def _relocated(model: FilterModel, state: FilterState, confirmed: BoolArray) -> FilterState:
    """Return the state with the filters of robots whose hypothesis is confirmed at its pose."""
    place = state.bank.filters(model.layout.relocation_hypothesis)
    moved = reset_pose(model, state, place.mean[:, 0], place.covariance[:, :, 0])
    recent = state.relocation_hypothesis.recent + 1.0
    white = state.bank.filters(WHITE)
    undoes = undoes_last(state.relocation_hypothesis, place, white)
    displacement = np.where(undoes, 0.0, place.mean[:2, 0] - white.mean[:2, 0])
    hypothesis = moved.relocation_hypothesis._replace(recent=recent, displacement=displacement)
    moved = moved._replace(relocation_hypothesis=hypothesis)
    if confirmed.all():
        return moved
    moved = moved._replace(
        bank=Bank(
            np.where(confirmed, place.mean, state.bank.mean),
            np.where(confirmed, place.covariance, state.bank.covariance),
        ),
        noise=state.noise,
    )
    chosen: FilterState = select(confirmed, moved, state)
    return chosen


def _prediction(model: FilterModel, state: FilterState, instant: Instant) -> HypothesisPrediction:
    """Return the hypothesis's filter before the readings.

    Robots that have no hypothesis yet take the published filter's noise.
    """
    which, active = model.layout.relocation_hypothesis, state.relocation_hypothesis.active
    predicted, available = instant.predicted.filters(which), instant.readings.available
    noise = noise_of_readings(
        select(active, state.noise.filters(which), state.noise.filters(WHITE)),
        model.measurement_noise,
        instant.fix_covariance,
        available,
    )
    seen = innovate(predicted, instant.readings, noise.measurement)
    nis = nis_by_sensor(seen, correct(predicted, seen, noise, available), 0)
    return HypothesisPrediction(predicted=predicted, seen=seen, noise=noise, nis=nis)


def _with_own(of_all: FloatArray, own: FloatArray, kept: BoolArray) -> FloatArray:
    """Return noise with the hypothesis's: its own where kept, otherwise the published filter's."""
    return np.concatenate([of_all, np.where(kept, own, of_all[:, WHITE])], axis=1)
