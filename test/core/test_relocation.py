# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The relocation hypothesis's memory of the time over which a sensor confirms it."""

import math
from typing import Any

import numpy as np
import pytest

from fnn_ekf_ros.core.arrays import FloatArray
from fnn_ekf_ros.core.bank import Bank, Noise, Readings, innovate
from fnn_ekf_ros.core.gate import GateDecision, GateState, gate_for
from fnn_ekf_ros.core.relocation import (
    CONFIRMATION_S,
    CONFIRMATIONS,
    LASTING_CONFIRMATION_S,
    LONGEST_CONFIRMATION_S,
    RECENT_S,
    HypothesisPrediction,
    HypothesisUpdate,
    RelocationHypothesis,
    later_hypothesis,
    no_hypothesis,
    update_hypothesis,
)

GATE = gate_for(1e-6, 1e-6)
FAR, NEAR = 1e3, 0.5
"""NIS that the gate rejects, and one that it accepts."""
COMPASS_AND_FIX, FIX, COMPASS = [1.0, 2.0], [0.0, 2.0], [1.0, 0.0]
"""Rows that each of the two sensors measured."""


def hypothesis_of(age_s: float, confirmations: float) -> RelocationHypothesis:
    ones = np.ones(2)
    return no_hypothesis(())._replace(
        active=np.array(True),
        confirmations=confirmations * ones,
        age_s=age_s * ones,
        spread=ones,
    )


def updated(
    rows: list[float], published: Any, hypothesized: Any, hypothesis: RelocationHypothesis,
    fixes_last: float = 0.0,
) -> HypothesisUpdate:  # fmt: skip
    """Return a hypothesis after one instant.

    Args:
        rows: that compass and fix measured.
        published: NIS of both against the published filter.
        hypothesized: NIS of both against the hypothesis.
        hypothesis: before it.
        fixes_last: weight of the members whose fix errors last.
    """
    ones = np.ones(2)
    bank = Bank(np.zeros((3, 1)), 0.01 * np.eye(3)[:, :, None])
    noise = Noise(np.ones((2, 1)), np.full((4, 1), 0.01))
    measured: FloatArray = np.array(rows)
    readings = Readings(np.zeros(4), np.array([rows[1] > 0, rows[1] > 0, rows[0] > 0, False]))
    prediction = HypothesisPrediction(
        bank, innovate(bank, readings, noise.measurement), noise, np.array(hypothesized)
    )
    decision = GateDecision(np.array(published), measured, np.array(published) > 100.0)
    gate_state = GateState(ones, 2.0 * ones, 0.0 * ones)
    return update_hypothesis(
        GATE, gate_state, hypothesis, prediction, bank, readings, decision, fixes_last
    )


@pytest.mark.parametrize(
    ("rows", "published", "hypothesized", "age_s"),
    [
        (COMPASS_AND_FIX, [FAR, FAR], [NEAR, NEAR], [2.0, 2.0]),
        (COMPASS_AND_FIX, [FAR, NEAR], [NEAR, NEAR], [2.0, 0.0]),  # the fix is accepted
        (COMPASS_AND_FIX, [NEAR, FAR], [NEAR, NEAR], [0.0, 2.0]),
        (COMPASS, [FAR, 0.0], [NEAR, 0.0], [2.0, 2.0]),
        (COMPASS, [FAR, 0.0], [FAR, 0.0], [0.0, 0.0]),  # starts anew, for both sensors
        (FIX, [0.0, FAR], [0.0, FAR], [0.0, 0.0]),
    ],
)
def test_the_time_begins_with_the_hypothesis_or_with_a_reading_that_does_not_confirm_it(
    rows: list[float], published: list[float], hypothesized: list[float], age_s: list[float]
) -> None:
    hypothesis = updated(rows, published, hypothesized, hypothesis_of(2.0, 3.0)).hypothesis
    assert hypothesis.active
    np.testing.assert_array_equal(hypothesis.age_s, age_s)


@pytest.mark.parametrize("fixes_last", [0.0, 0.5, 1.0])
@pytest.mark.parametrize("recent", [0.0, 1.0, 1.5, 9.0])
def test_fixes_whose_errors_last_or_that_jump_again_confirm_it_for_longer(
    fixes_last: float, recent: float
) -> None:
    white, lasting = CONFIRMATION_S, LASTING_CONFIRMATION_S
    needed = (1.0 - fixes_last) * white + fixes_last * lasting
    needed = min(needed * 2.0**recent, LONGEST_CONFIRMATION_S)
    for age_s, confirmed in ((needed - 0.1, False), (needed + 0.1, True)):
        hypothesis = hypothesis_of(age_s, CONFIRMATIONS)._replace(recent=np.array(recent))
        found = updated(FIX, [0.0, FAR], [0.0, NEAR], hypothesis, fixes_last)
        assert found.confirmed == confirmed


def test_earlier_relocations_are_forgotten() -> None:
    before = hypothesis_of(2.0, 3.0)._replace(recent=np.array(1.5))
    found = later_hypothesis(before, 30.0)
    assert found.recent == pytest.approx(1.5 * math.exp(-30.0 / RECENT_S))
    np.testing.assert_array_equal(found.age_s, [32.0, 32.0])
