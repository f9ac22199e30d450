# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""What is believed of errors that last: its numbers, and what follows for the suspects."""

import dataclasses

import numpy as np
import pytest

from fnn_ekf_ros.core.arrays import FloatArray, Row
from fnn_ekf_ros.core.bank import Bank, Noise, Readings
from fnn_ekf_ros.core.lasting.augmented import Component
from fnn_ekf_ros.core.lasting.compass_offset import offset_of
from fnn_ekf_ros.core.lasting.lasting import (
    LastingState,
    after_readings,
    compare_with_members,
    start_lasting,
)
from fnn_ekf_ros.core.lasting.members import (
    CHALLENGER,
    HORIZONS_S,
    MEMBER_COUNT,
    MEMBERS,
    WITNESS,
    Member,
)
from fnn_ekf_ros.core.lasting.outages import weights_of
from fnn_ekf_ros.core.lasting.report import report_lasting
from fnn_ekf_ros.core.state import FilterModel, start_filter, with_noise
from fnn_ekf_ros.core.suspects import SUSPICION
from fnn_ekf_ros.membership.files import networks_for
from fnn_ekf_ros.parameters.localizer import LocalizerParameters
from fnn_ekf_ros.timeline.filter_model import filter_model
from fnn_ekf_ros.timeline.period import check_finite

R = np.array([0.04, 0.16, 0.01, 0.01])
"""Measurement noise: fixes of 0.2 and 0.4 m."""


def lasting(weights: FloatArray | None = None) -> LastingState:
    """Return a state at the origin, with weights of the members."""
    pose = Bank(np.zeros((3, 1)), 0.01 * np.eye(3)[:, :, None])
    state = start_lasting(pose, R, from_readings=False)
    return state if weights is None else state._replace(weights=weights)


def only(*members: Member) -> FloatArray:
    """Return equal weights of some members."""
    weights = np.array([float(member in members) for member in MEMBERS])
    return weights / weights.sum()


def test_numbers_are_those_of_the_mixture() -> None:
    report = report_lasting(lasting(only(Member(3.0, 0.1))))
    assert report.fix_std == pytest.approx(3.0 * np.sqrt(0.1))
    assert report.yaw_std == pytest.approx(0.1)
    assert (report.fixes_last, report.yaws_last) == (1.0, 1.0)
    mixed = report_lasting(lasting(only(Member(0.0, 0.0), Member(10.0, 0.0))))
    assert mixed.fix_std == pytest.approx(np.sqrt(0.5) * 10.0 * np.sqrt(0.1))
    assert (mixed.fixes_last, mixed.yaws_last, mixed.yaw_std) == (0.5, 0.0, 0.0)
    assert mixed.offset_std == pytest.approx(1.5)
    assert not any((mixed.believed, mixed.likely, mixed.doubted))
    assert mixed.of_fix_yaw  # no compass has been read


def test_the_prior_makes_no_error_believed() -> None:
    assert 0.0 < report_lasting(lasting()).fixes_last < 0.2
    np.testing.assert_array_equal(lasting().believed_fix_variance, 0.0)
    known = lasting(only(Member(3.0, 0.0)))
    np.testing.assert_allclose(known.believed_fix_variance, 9.0 * R[:2])


def joint_model() -> FilterModel:
    """Return the model of mode joint, with the suspects."""
    parameters = LocalizerParameters(
        wheel_radius=0.025, wheel_separation=0.6, encoder_counts_per_revolution=500.0
    )
    return dataclasses.replace(filter_model(parameters, networks_for(parameters)), suspects=True)


def test_suspects_take_fix_errors_that_last_for_noise() -> None:
    model = joint_model()
    state = start_filter(model, np.zeros(3), 0.01 * np.eye(3), measurement_noise=R)
    assert state.lasting is not None
    known = state.lasting._replace(weights=only(Member(10.0, 0.0)))
    after = with_noise(model, state._replace(lasting=known), state.process_noise, R)
    before = state.noise.filters(model.layout.suspects).measurement
    suspects = after.noise.filters(model.layout.suspects).measurement
    for row, wider in ((Row.X, 101.0), (Row.Y, 101.0), (Row.COMPASS_YAW, 1.0), (Row.LRF_YAW, 1.0)):
        np.testing.assert_allclose(suspects[row], wider * before[row])
    assert suspects[Row.X, 3] == pytest.approx(SUSPICION * 101.0 * R[0])
    rest = slice(0, model.layout.suspects.start)
    np.testing.assert_array_equal(
        after.noise.filters(rest).measurement, state.noise.filters(rest).measurement
    )


def test_a_filter_starts_with_weights_that_were_saved() -> None:
    model = joint_model()
    weights = np.linspace(0.5, 1.5, MEMBER_COUNT) / MEMBER_COUNT
    log_weight = np.log(np.tile(weights, (len(HORIZONS_S), 1)))
    state = start_filter(model, np.zeros(3), 0.01 * np.eye(3), log_weight=log_weight)
    assert state.lasting is not None
    np.testing.assert_array_equal(state.lasting.outages.log_weight, log_weight)
    np.testing.assert_array_equal(state.lasting.weights, weights_of(log_weight))


def test_filters_of_lasting_errors_have_to_be_finite() -> None:
    state = start_filter(joint_model(), np.zeros(3), 0.01 * np.eye(3))
    check_finite(state)
    assert state.lasting is not None
    bank = state.lasting.bank
    bank.mean[Component.FIX_X, WITNESS] = np.nan
    with pytest.raises(ArithmeticError, match="a filter of lasting errors is not finite"):
        check_finite(state)


def test_readings_of_a_turned_compass_correct_the_witness_alone() -> None:
    """Or it would never be used again: the witness finds its offset."""
    state = lasting()
    state = state._replace(
        offset=state.offset._replace(doubted=np.array(True)), compass_seen=np.array(True)
    )
    seen_rows = np.array([False, False, True, False])
    readings = Readings(np.array([0.0, 0.0, 1.2, 0.0]), seen_rows)
    noise = Noise(np.full((2, 1), 1e-4), R[:, None])
    before = state.bank
    for _ in range(5):
        seen = compare_with_members(state, readings, noise)
        state, _ = after_readings(state, seen, noise, seen_rows, seen_rows, np.array(True), 0.375)
    offset, variance = offset_of(state.bank)
    assert offset == pytest.approx(1.2, abs=0.05)
    assert variance < 0.2**2
    others = [k for k in range(before.mean.shape[1]) if k not in (WITNESS, CHALLENGER)]
    np.testing.assert_allclose(state.bank.mean[:, others], before.mean[:, others], atol=1e-4)
