# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The witness's challenger: what fixes say of the two, and when they change places."""

import dataclasses
import math
from collections.abc import Callable

import numpy as np
import pytest
from augmented_ekf import assert_semidefinite
from drives import TRUE_Q, TRUE_R
from lasting_drives import Errors, lasting_drive, tracked

from fnn_ekf_ros.core.angles import wrap_angle
from fnn_ekf_ros.core.bank import Bank
from fnn_ekf_ros.core.filter import fuse
from fnn_ekf_ros.core.gate import gate_for
from fnn_ekf_ros.core.lasting.augmented import AUGMENTED_SIZE, Component
from fnn_ekf_ros.core.lasting.challenger import (
    FITTING_NIS,
    LARGEST_GAIN,
    LOST_AT,
    SMALLEST_NIS,
    WON_AT,
    YAW_STD,
    Challenge,
    challenged,
    opposite_of_witness,
)
from fnn_ekf_ros.core.lasting.members import CHALLENGER, FILTER_COUNT, WITNESS
from fnn_ekf_ros.core.state import FilterModel

YAW, OFFSET = Component.YAW, Component.YAW_OFFSET
ROBOTS = 3


@pytest.fixture
def bank() -> Bank:
    rng = np.random.default_rng(1)
    mean = 0.1 * rng.standard_normal((AUGMENTED_SIZE, FILTER_COUNT, ROBOTS))
    A = rng.standard_normal((AUGMENTED_SIZE, AUGMENTED_SIZE, FILTER_COUNT, ROBOTS))
    return opposite_of_witness(Bank(mean, np.einsum("ijkn,ljkn->ilkn", A, A)))


ALL = np.ones(ROBOTS, dtype=np.bool_)


def after_fix(
    lead: float, bank: Bank, gain: float, nis: float = 1.0, *, needed: bool = False
) -> Challenge:
    """Return both after a fix of all robots, of which the challenger is likelier by the gain."""
    determinant = np.exp(-2.0 * np.array([[0.0], [gain]])) * np.ones(ROBOTS)
    each_nis = np.full((2, ROBOTS), nis)
    return challenged(np.full(ROBOTS, lead), bank, each_nis, determinant, ALL, ALL & needed)


def test_challenger_begins_with_the_opposite_yaw_and_expects_the_same_of_the_compass(
    bank: Bank,
) -> None:
    yaw, offset = bank.mean[[YAW, OFFSET]][:, [WITNESS, CHALLENGER]]
    np.testing.assert_allclose(np.abs(yaw[1] - yaw[0]), math.pi)
    np.testing.assert_allclose(wrap_angle((yaw + offset)[1] - (yaw + offset)[0]), 0.0, atol=1e-15)
    np.testing.assert_array_equal(bank.covariance[:, :, CHALLENGER], bank.covariance[:, :, WITNESS])


def test_lead_is_the_log_ratio_of_likelihoods_with_a_free_factor_of_the_noise(bank: Bank) -> None:
    """A density of x and y whose scale is free falls with the NIS; the factor cancels."""
    nis, determinant = np.array([[1.3], [0.9]]), np.array([[2.0], [2.2]])
    gained = math.log((1.3 + SMALLEST_NIS) / (0.9 + SMALLEST_NIS)) - 0.5 * math.log(2.2 / 2.0)
    assert 0.0 < gained < LARGEST_GAIN
    lead = np.array([1.0, 2.0, 3.0])
    fixed = np.array([True, True, False])
    found = challenged(lead, bank, nis, determinant, fixed, ~ALL)
    np.testing.assert_allclose(found.lead, [1.0 + gained, 2.0 + gained, 3.0])
    assert found.bank is bank
    np.testing.assert_allclose(
        challenged(lead, bank, nis, 100.0 * determinant, fixed, ~ALL).lead, found.lead
    )


def test_no_few_fixes_decide_and_those_that_fit_neither_do_not(bank: Bank) -> None:
    assert np.all(after_fix(1.0, bank, 50.0).lead == 1.0 + LARGEST_GAIN)
    assert np.all(after_fix(1.0, bank, -50.0).lead == 1.0 - LARGEST_GAIN)
    assert np.all(after_fix(1.0, bank, 50.0, nis=1.1 * FITTING_NIS).lead == 1.0)


def test_they_change_places_when_the_lead_is_large(bank: Bank) -> None:
    """There is no challenger then; the filters before are not changed."""
    before = Bank(bank.mean.copy(), bank.covariance.copy())
    found = after_fix(WON_AT - LARGEST_GAIN, bank, 9.0, needed=True)
    assert found.won.all()
    assert np.all(found.lead == LOST_AT)
    for one, other in ((WITNESS, CHALLENGER), (CHALLENGER, WITNESS)):
        np.testing.assert_array_equal(found.bank.mean[:, one], before.mean[:, other])
        np.testing.assert_array_equal(found.bank.covariance[:, :, one],
                                      before.covariance[:, :, other])  # fmt: skip
    np.testing.assert_array_equal(bank.mean, before.mean)
    np.testing.assert_array_equal(bank.covariance, before.covariance)


def test_what_is_decided_for_the_witness_stays_unless_a_challenger_is_needed(bank: Bank) -> None:
    lost = after_fix(LOST_AT + LARGEST_GAIN, bank, -9.0, needed=True)
    assert np.all(lost.lead == LOST_AT)
    assert not lost.won.any()
    assert lost.bank is bank
    kept = after_fix(LOST_AT, bank, 9.0)
    assert np.all(kept.lead == LOST_AT)
    assert kept.bank is bank
    assert not after_fix(LOST_AT, bank, 9.0, needed=True).lead.any()


def test_new_challenger_begins_with_yaw_and_offset_unknown_but_for_their_sum(bank: Bank) -> None:
    found = after_fix(LOST_AT, bank, -9.0, needed=True).bank
    np.testing.assert_array_equal(found.mean[:, CHALLENGER], bank.mean[:, WITNESS])
    P, of_witness = found.covariance[:, :, CHALLENGER], bank.covariance[:, :, WITNESS]
    np.testing.assert_allclose(P[YAW, YAW] - of_witness[YAW, YAW], YAW_STD**2)
    expected = np.zeros(AUGMENTED_SIZE)  # h of a compass: the sum of yaw, drift and offset
    expected[[YAW, Component.YAW_DRIFT, OFFSET]] = 1.0
    for robot in range(ROBOTS):
        assert_semidefinite(P[..., robot])
        np.testing.assert_allclose(P[..., robot] @ expected, of_witness[..., robot] @ expected)
    np.testing.assert_array_equal(found.covariance[:, :, WITNESS], of_witness)


def test_robots_of_a_batch_change_places_each_by_itself(bank: Bank) -> None:
    lead = np.array([WON_AT, 0.0, LOST_AT])
    nis = np.ones((2, ROBOTS))
    found = challenged(lead, bank, nis, np.ones((2, ROBOTS)), ALL, ALL)
    assert found.won.tolist() == [True, False, False]
    assert found.lead.tolist() == [LOST_AT, 0.0, 0.0]
    for k in (WITNESS, CHALLENGER):
        np.testing.assert_array_equal(found.bank.mean[:, k, 1], bank.mean[:, k, 1])
    np.testing.assert_array_equal(found.bank.mean[:, WITNESS, 0], bank.mean[:, CHALLENGER, 0])
    np.testing.assert_array_equal(found.bank.mean[:, WITNESS, 2], bank.mean[:, WITNESS, 2])


@pytest.fixture(scope="module")
def joint(
    make_model: Callable[..., FilterModel], make_adaptation: Callable[..., object]
) -> FilterModel:
    return dataclasses.replace(
        make_model(
            adaptation=make_adaptation(mode="joint"),
            process_noise=tuple(TRUE_Q),
            measurement_noise=tuple(TRUE_R),
        ),
        gate=gate_for(1e-6, 1e-6),
        lasting_errors=True,
    )


@pytest.mark.slow
@pytest.mark.parametrize("wrong", [0.5, -1.0, 2.0])
def test_witness_that_is_sure_of_a_wrong_yaw_is_corrected(joint: FilterModel, wrong: float) -> None:
    """A right compass that is believed to be off is right again, and so is the pose."""
    drive = lasting_drive(7, 6, 300, Errors())
    state = tracked(joint, drive[:40]).states[-1]
    lasting = state.lasting
    assert lasting is not None
    mean, covariance = lasting.bank.mean.copy(), lasting.bank.covariance.copy()
    mean[YAW, WITNESS] = wrap_angle(mean[YAW, WITNESS] - wrong)
    mean[OFFSET, WITNESS] += wrong
    covariance[[YAW, OFFSET], :, WITNESS] = covariance[:, [YAW, OFFSET], WITNESS] = 0.0
    covariance[YAW, YAW, WITNESS] = covariance[OFFSET, OFFSET, WITNESS] = 0.05**2
    offset = lasting.offset._replace(believed=np.ones(6, dtype=np.bool_))
    state = state._replace(lasting=lasting._replace(bank=Bank(mean, covariance), offset=offset))
    errors = []
    for epoch, truth in drive[40:]:
        state, _ = fuse(joint, state, epoch)
        error = state.mean - truth
        errors.append([*error[:2], wrap_angle(error[2])])
    late = np.abs(errors[160:])  # 60 s
    assert late[:, :2].max() < 0.3
    assert late[:, 2].max() < 0.2


@pytest.mark.slow
@pytest.mark.parametrize("errors", [Errors(), Errors(fix_std=0.3), Errors(fix_std=0.3, fix_s=60.0)])
def test_challenger_does_not_replace_a_witness_that_is_right(
    joint: FilterModel, errors: Errors
) -> None:
    """However the errors of the fixes last: ten minutes, no belief in an offset that is not."""
    for state in tracked(joint, lasting_drive(3, 6, 1600, errors)).states[100:]:
        assert state.lasting is not None
        assert not state.lasting.offset.believed.any()
        assert not state.lasting.offset.doubted.any()
        assert np.all(np.abs(wrap_angle(state.lasting.bank.mean[OFFSET, WITNESS])) < 0.4)
