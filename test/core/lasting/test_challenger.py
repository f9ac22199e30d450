# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The witness's challenger: what fixes say of the two, and when they change places."""

import math

import numpy as np
import pytest
from augmented_ekf import assert_semidefinite
from lasting_drives import Errors, lasting_drive, tracked

from fnn_ekf_ros.core.angles import wrap_angle
from fnn_ekf_ros.core.bank import Bank
from fnn_ekf_ros.core.filter import fuse
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
from fnn_ekf_ros.core.lasting.report import report_lasting
from fnn_ekf_ros.core.state import FilterModel

YAW, OFFSET = Component.YAW, Component.YAW_OFFSET
ROBOTS = 3


@pytest.fixture
def bank() -> Bank:
    rng = np.random.default_rng(1)
    mean = 0.1 * rng.standard_normal((AUGMENTED_SIZE, FILTER_COUNT, ROBOTS))
    A = rng.standard_normal((AUGMENTED_SIZE, AUGMENTED_SIZE, FILTER_COUNT, ROBOTS))
    return opposite_of_witness(Bank(mean, 0.01 * np.einsum("ijkn,ljkn->ilkn", A, A)))


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
    # A Gaussian would gain a quarter where the noise that is assumed is twice too large.
    larger = challenged(lead, bank, nis / 4.0, 16.0 * determinant, fixed, ~ALL)
    assert larger.lead[0] - 1.0 > 0.7 * gained


def test_no_few_fixes_decide_and_those_that_fit_neither_do_not(bank: Bank) -> None:
    assert np.all(after_fix(1.0, bank, 50.0).lead == 1.0 + LARGEST_GAIN)
    assert np.all(after_fix(1.0, bank, -50.0).lead == 1.0 - LARGEST_GAIN)
    assert np.all(after_fix(1.0, bank, 50.0, nis=1.1 * FITTING_NIS).lead == 1.0)
    one_fits = np.array([[2.0 * FITTING_NIS], [1.0]]) * np.ones(ROBOTS)
    found = challenged(np.ones(ROBOTS), bank, one_fits, np.ones((2, ROBOTS)), ALL, ~ALL)
    assert np.all(found.lead == 1.0 + LARGEST_GAIN)


def test_numbers_that_are_none_leave_no_challenger(bank: Bank) -> None:
    lead = np.zeros(ROBOTS)
    found = challenged(
        lead, bank, np.ones((2, ROBOTS)), np.array([[1.0], [np.inf]]) * np.ones(ROBOTS), ALL, ~ALL
    )
    assert np.all(found.lead == -LARGEST_GAIN)
    nothing = np.full((2, ROBOTS), np.nan)
    found = challenged(lead, bank, np.ones((2, ROBOTS)), nothing, ALL, ~ALL)
    assert np.all(found.lead == LOST_AT)
    assert not found.won.any()


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


def test_challenger_that_has_become_like_the_witness_and_has_no_lead_begins_anew(
    bank: Bank,
) -> None:
    for array, axis in ((bank.mean, 1), (bank.covariance, 2)):
        filters = np.moveaxis(array, axis, 0)
        filters[CHALLENGER] = filters[WITNESS]
    assert not after_fix(-1.0, bank, 0.0, needed=True).lead.any()
    assert np.all(after_fix(-1.0, bank, 0.0).lead == -1.0)
    assert np.all(after_fix(1.0, bank, 0.0, needed=True).lead == 1.0)
    other = Bank(bank.mean.copy(), bank.covariance)
    other.mean[YAW, CHALLENGER] += 3.0 * np.sqrt(bank.covariance[YAW, YAW, WITNESS])
    assert np.all(after_fix(-1.0, other, 0.0, needed=True).lead == -1.0)


def test_robots_of_a_batch_change_places_each_by_itself(bank: Bank) -> None:
    """And only by a fix of their own; one robot alone goes the same way."""
    lead = np.array([WON_AT, 0.0, LOST_AT])
    nis, determinant = np.ones((2, ROBOTS)), np.ones((2, ROBOTS))
    found = challenged(lead, bank, nis, determinant, ALL, ALL)
    assert found.won.tolist() == [True, False, False]
    assert found.lead.tolist() == [LOST_AT, 0.0, 0.0]
    for one, before in zip(found.bank, bank, strict=True):
        after, then = (each[..., [WITNESS, CHALLENGER], :] for each in (one, before))
        np.testing.assert_array_equal(after[..., 0], then[..., ::-1, 0])
        np.testing.assert_array_equal(after[..., 1], then[..., 1])
        np.testing.assert_array_equal(after[..., 0, 2], then[..., 0, 2])
    no_fix = challenged(lead, bank, nis, determinant, ~ALL, ALL)
    assert no_fix.lead is lead
    assert no_fix.bank is bank
    alone = Bank(bank.mean[..., 2], bank.covariance[..., 2])
    after = challenged(lead[2], alone, nis[:, 2], determinant[:, 2], np.True_, np.True_)
    np.testing.assert_array_equal(after.bank.covariance, found.bank.covariance[..., 2])


@pytest.mark.slow
@pytest.mark.parametrize("wrong", [0.9, -1.0, 2.0])
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
        assert state.lasting is not None
        assert not report_lasting(state.lasting).doubted.any()  # nobody says that it was turned
    late = np.abs(errors[160:])  # 60 s
    assert late[:, :2].max() < 0.3
    assert late[:, 2].max() < 0.2


@pytest.mark.slow
@pytest.mark.parametrize("errors", [Errors(), Errors(fix_std=0.3), Errors(fix_std=0.3, fix_s=60.0)])
@pytest.mark.parametrize("offset", [0.0, 0.8])
def test_what_is_right_of_the_compass_stays_believed(
    joint: FilterModel, errors: Errors, offset: float
) -> None:
    """However the errors of the fixes last, for ten minutes; challengers come and go."""
    track = tracked(joint, lasting_drive(3, 6, 1600, errors._replace(offset=offset)), offset)
    challenged_robots = np.zeros(6, dtype=np.bool_)
    for state in track.states[200:]:
        assert state.lasting is not None
        belief = state.lasting.offset
        challenged_robots |= (belief.challenger != 0.0) & (belief.challenger > LOST_AT)
        assert not (belief.doubted & belief.turned).any()
        found = wrap_angle(state.lasting.bank.mean[OFFSET, WITNESS] - offset)
        assert np.all(np.abs(found) < 0.4)
        if offset == 0.0:
            assert not belief.believed.any()
    believed = np.array([state.lasting.offset.believed for state in track.states[200:]])  # type: ignore[union-attr]
    assert offset == 0.0 or believed.mean() > 0.95
    assert offset == 0.0 or challenged_robots.all()
    assert np.abs(track.error[200:, 2]).max() < 0.5
