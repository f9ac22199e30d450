# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The readings of an instant at the gate."""

from typing import NamedTuple

from fnn_ekf_ros.core.arrays import BoolArray, FloatArray
from fnn_ekf_ros.core.bank import Bank
from fnn_ekf_ros.core.gate import (
    GateDecision,
    GateState,
    after_decision,
    judge,
    rows_of,
    teaching,
)
from fnn_ekf_ros.core.instant import Instant
from fnn_ekf_ros.core.relocation import HypothesisUpdate
from fnn_ekf_ros.core.relocation_filter import follow_hypothesis
from fnn_ekf_ros.core.state import FilterModel, FilterState

LASTING_PACE = 0.1
"""Rate at which the gate opens where fix errors last, compared with white errors: rejected readings
whose errors last are hardly more evidence than one of them."""


class Gated(NamedTuple):
    """The readings of an instant after the gate.

    Attributes:
        decision: which sensors' readings are rejected.
        corrected: the filters corrected by the accepted rows; at least the white filter and
            those of joint adaptation.
        teaches: `(4, *batch)` rows that the noise may be learned from.
        relocation: the relocation hypothesis after the readings; None without one.
    """

    decision: GateDecision
    corrected: Bank
    teaches: BoolArray
    relocation: HypothesisUpdate | None


def pass_gate(model: FilterModel, state: FilterState, instant: Instant, nis: FloatArray) -> Gated:
    """Gate the readings of an instant, and compare rejected ones with the relocation hypothesis.

    Args:
        model: the filter.
        state: before the readings.
        instant: the readings.
        nis: `(2, *batch)` NIS of each sensor.
    """
    available = instant.readings.available
    decision = judge(model.gate, state.gate, nis, instant.rows.of_sensor)
    corrected, teaches = instant.taken.bank, available
    relocation = None
    rejects = bool(decision.rejected.any())
    if rejects:
        accepted = available & ~rows_of(decision.rejected)
        corrected = instant.corrected_by(accepted, slice(0, model.layout.suspects.start)).bank
    if rejects or state.has_relocation_hypothesis(model):
        relocation = follow_hypothesis(model, state, instant, decision, corrected)
        teaches = available & rows_of(teaching(state.gate, decision, relocation.explains))
    return Gated(decision=decision, corrected=corrected, teaches=teaches, relocation=relocation)


def gate_after(model: FilterModel, state: FilterState, gated: Gated) -> GateState:
    """Return the gate's memory after the readings; an open gate needs none."""
    if model.gate.is_open:
        return state.gate
    decision, relocation = gated.decision, gated.relocation
    agrees = decision.rejected if relocation is None else relocation.agrees
    elapsed, lasting = state.pace.sensors, state.lasting
    if lasting is not None:
        elapsed = elapsed * (1.0 - (1.0 - LASTING_PACE) * lasting.rejections_agree)
    return after_decision(
        state.gate,
        decision,
        agrees,
        elapsed,
        learns=model.adaptation.learns_measurement_noise,
    )
