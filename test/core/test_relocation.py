# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The relocation hypothesis's memory of the time over which a sensor confirms it."""

from typing import Any

import numpy as np
import pytest

from fnn_ekf_ros.core.arrays import FloatArray
from fnn_ekf_ros.core.bank import Bank, Noise, Readings, innovate
from fnn_ekf_ros.core.gate import GateDecision, GateState, gate_for
from fnn_ekf_ros.core.relocation import (
    HypothesisPrediction,
    RelocationHypothesis,
    no_hypothesis,
    update_hypothesis,
)

GATE = gate_for(1e-6, 1e-6)
FAR, NEAR = 1e3, 0.5
"""NIS that the gate rejects, and one that it accepts."""
COMPASS_AND_FIX, FIX, COMPASS = [1.0, 2.0], [0.0, 2.0], [1.0, 0.0]
"""Rows that each of the two sensors measured."""


def after(rows: list[float], published: Any, hypothesized: Any) -> RelocationHypothesis:
    """Return a hypothesis of 2 s after one instant.

    Args:
        rows: that compass and fix measured.
        published: NIS of both against the published filter.
        hypothesized: NIS of both against the hypothesis.
    """
    ones = np.ones(2)
    hypothesis = no_hypothesis(())._replace(
        active=np.array(True), confirmations=3.0 * ones, age_s=2.0 * ones, spread=ones
    )
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
        GATE, gate_state, hypothesis, prediction, bank, readings, decision
    ).hypothesis


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
    hypothesis = after(rows, published, hypothesized)
    assert hypothesis.active
    np.testing.assert_array_equal(hypothesis.age_s, age_s)
