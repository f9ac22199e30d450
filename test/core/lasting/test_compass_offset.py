# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""What is believed of the compass's offset, step by step."""

import math
from collections.abc import Sequence

import numpy as np
import pytest

from fnn_ekf_ros.core.bank import Bank
from fnn_ekf_ros.core.lasting.augmented import AUGMENTED_SIZE, Component
from fnn_ekf_ros.core.lasting.challenger import LARGEST_GAIN, WON_AT, opposite_of_witness
from fnn_ekf_ros.core.lasting.compass_offset import (
    BELIEVED_AFTER_S,
    BELIEVED_AT,
    DISAGREES_AT,
    GIVEN_UP_AT,
    KNOWN_AFTER_S,
    KNOWN_STD,
    LARGEST_SURPRISE,
    LIKELY_AT,
    SMALLEST_WEIGHT,
    SUPPORT_NEEDED,
    TURNED_AFTER_S,
    TURNED_AT,
    USUAL_OFFSET_STD,
    USUAL_SURPRISE,
    CompassOffset,
    after_compass,
    after_fix,
    later,
    log_odds,
    offset_of,
    reconsidered,
    start_offset,
    suspected_with,
)
from fnn_ekf_ros.core.lasting.members import (
    CHALLENGER,
    FILTER_COUNT,
    WITNESS,
    WITNESS_OFFSET_STD,
)
from fnn_ekf_ros.core.pace import NOMINAL_PERIOD_S

DT = 0.5
STD = 0.01
"""Standard deviation of the witness's innovation [rad]: 50 of them are less than pi / 2."""
OFFSET = Component.YAW_OFFSET


def witness(offset: float, std: float, robots: int = 1) -> Bank:
    """Return filters; the witness's offset is known, and correlated with its yaw."""
    mean = np.zeros((AUGMENTED_SIZE, FILTER_COUNT, robots))
    P = np.zeros((AUGMENTED_SIZE, AUGMENTED_SIZE, FILTER_COUNT, robots))
    for k in range(AUGMENTED_SIZE):
        P[k, k] = 0.04
    mean[OFFSET, WITNESS], P[OFFSET, OFFSET, WITNESS] = offset, std**2
    P[OFFSET, Component.YAW, WITNESS] = P[Component.YAW, OFFSET, WITNESS] = -0.1 * std
    return Bank(mean, P)


def considered(offset: CompassOffset, bank: Bank, seconds: float) -> tuple[CompassOffset, int]:
    """Return the belief after readings for some time, and how often it changed."""
    changes = 0
    for _ in range(round(seconds / DT)):
        offset, changed = reconsidered(offset, bank, DT)
        changes += int(changed.sum())
    return offset, changes


@pytest.mark.parametrize(("offset", "std"), [(0.0, 0.1), (0.4, 0.1), (-0.8, 0.05), (1.0, 1.5)])
def test_log_odds_by_hand(offset: float, std: float) -> None:
    """Of N(0, v + a prior of any size) against N(0, v), about."""
    v = std**2 + USUAL_OFFSET_STD**2
    expected = offset**2 / (2.0 * v) - 0.5 * math.log(WITNESS_OFFSET_STD**2 / v)
    assert log_odds(witness(offset, std)).item() == pytest.approx(expected)
    assert [x.item() for x in offset_of(witness(offset, std))] == pytest.approx([offset, std**2])


def test_offset_is_believed_after_the_time() -> None:
    bank = witness(0.8, 0.1)
    assert log_odds(bank) > BELIEVED_AT
    offset, changes = considered(start_offset((1,)), bank, BELIEVED_AFTER_S - DT)
    assert (bool(offset.believed), changes) == (False, 0)
    offset, changes = considered(offset, bank, DT)
    assert (bool(offset.believed), changes) == (True, 1)
    assert considered(offset, bank, 100.0)[1] == 0


def test_the_time_begins_anew_where_the_offset_was_less_likely() -> None:
    likely, unlikely = witness(0.8, 0.1), witness(0.2, 0.1)
    assert log_odds(unlikely) < BELIEVED_AT
    offset, _ = considered(start_offset((1,)), likely, BELIEVED_AFTER_S - DT)
    offset, _ = considered(offset, unlikely, DT)
    offset, _ = considered(offset, likely, BELIEVED_AFTER_S - DT)
    assert not offset.believed


def test_usual_or_unknown_offset_is_never_believed() -> None:
    for bank in (witness(0.05, 0.05), witness(0.8, WITNESS_OFFSET_STD)):
        offset, changes = considered(start_offset((1,)), bank, 10.0 * BELIEVED_AFTER_S)
        assert (bool(offset.believed), changes) == (False, 0)


def test_believed_offset_is_kept_while_it_is_likelier_and_given_up_then() -> None:
    believed, _ = considered(start_offset((1,)), witness(0.8, 0.1), BELIEVED_AFTER_S)
    less = witness(0.35, 0.1)
    assert GIVEN_UP_AT < log_odds(less) < BELIEVED_AT
    kept, changes = considered(believed, less, 100.0)
    assert (bool(kept.believed), changes) == (True, 0)
    given_up, changed = reconsidered(kept, witness(0.05, 0.1), DT)
    assert (bool(given_up.believed), bool(changed)) == (False, True)


def surprised(
    normalized: Sequence[float],
    apart_s: float,
    start: CompassOffset | None = None,
    fixes_last: float = 0.0,
    support: float = SUPPORT_NEEDED,
) -> CompassOffset:
    """Return the belief of one robot after innovations of the witness, in standard deviations.

    The fixes' log likelihood ratio for the wheels is `support` at each of them.
    """
    offset, bank = start or start_offset((1,)), witness(0.0, 0.05)
    for each in normalized:
        offset = later(offset._replace(support=np.array([support])), apart_s)
        offset, _ = after_compass(
            offset, bank, np.array([each * STD]), np.array([STD]), np.array([True]),
            apart_s / NOMINAL_PERIOD_S, np.array([fixes_last]),
        )  # fmt: skip
    return offset


def test_surprise_is_the_sum_of_innovations_to_one_side() -> None:
    """Page's: it never falls below 0; what is usual is subtracted, and outliers are limited."""
    normalized, left, right = [0.1, 2.0, 3.0, -0.4, 50.0, -3.0, 1.5], 0.0, 0.0
    for each in normalized:
        left = max(left + min(each, LARGEST_SURPRISE) - USUAL_SURPRISE, 0.0)
        right = max(right + min(-each, LARGEST_SURPRISE) - USUAL_SURPRISE, 0.0)
    found = surprised(normalized, NOMINAL_PERIOD_S).surprise
    np.testing.assert_allclose(found[:, 0], [left, right])
    fast = surprised([2.0], 0.2 * NOMINAL_PERIOD_S).surprise
    np.testing.assert_allclose(fast[:, 0], [0.2 * (2.0 - USUAL_SURPRISE), 0.0])


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_compass_is_doubted_when_the_sum_is_large_after_some_time(sign: float) -> None:
    """To either side; innovations that change sides add up to nothing."""
    count = math.floor(TURNED_AT / (LARGEST_SURPRISE - USUAL_SURPRISE)) + 1
    slow = TURNED_AFTER_S / (count - 1) + NOMINAL_PERIOD_S
    far = 10.0 * sign
    assert surprised([far] * count, slow).doubted
    assert not surprised([far] * (count - 1), slow).doubted
    assert not surprised([far, -far] * count, slow).doubted
    fast = 0.5 * TURNED_AFTER_S / count
    assert not surprised([far] * count, fast).doubted


def test_fixes_whose_errors_last_are_poor_evidence_against_the_compass() -> None:
    """The sum has to be larger by the weight that they do not last, at most by its bound."""
    gained = LARGEST_SURPRISE - USUAL_SURPRISE
    for fixes_last, part in ((0.0, 1.0), (0.5, 0.5), (1.0, SMALLEST_WEIGHT)):
        count = math.floor(TURNED_AT / part / gained) + 1
        assert surprised([9.0] * count, TURNED_AFTER_S, fixes_last=fixes_last).doubted
        assert not surprised([9.0] * (count - 1), TURNED_AFTER_S, fixes_last=fixes_last).doubted


def test_compass_is_not_turned_where_the_fixes_take_its_side() -> None:
    """As where a wheel is stuck: they have to speak for the wheels since the surprise began."""
    far = [10.0] * 20
    assert not surprised(far, TURNED_AFTER_S, support=SUPPORT_NEEDED - 0.1).doubted
    assert surprised(far, TURNED_AFTER_S).doubted
    assert surprised([0.0], TURNED_AFTER_S, support=9.0).support == 0.0
    assert surprised([3.0], TURNED_AFTER_S, support=9.0).support == 9.0


def test_readings_off_by_about_pi_are_off_to_either_side() -> None:
    """Noise takes them across pi, where their sign changes."""
    near_pi = (math.pi - 0.05) / STD
    found = surprised([near_pi, -near_pi, near_pi], NOMINAL_PERIOD_S).surprise
    np.testing.assert_allclose(found, 3.0 * (LARGEST_SURPRISE - USUAL_SURPRISE))


def with_fixes(
    ratios: Sequence[tuple[float, float]], start: CompassOffset, bank: Bank
) -> tuple[CompassOffset, Bank]:
    """Return both after fixes, by their log ratios of challenger and advocate to the witness."""
    for challenger, advocate in ratios:
        determinant = np.exp(-2.0 * np.array([[0.0], [challenger], [advocate]]))
        start, bank = after_fix(start, bank, np.ones((3, 1)), determinant, np.array([True]))
    return start, bank


def test_support_of_the_wheels_is_the_sum_of_the_fixes_ratios() -> None:
    bank = witness(0.0, 0.1)
    found, after = with_fixes([(0.0, -0.5), (0.0, 2.0)], start_offset((1,)), bank)
    assert found.support == pytest.approx(0.5 - 2.0)
    assert after is bank
    determinant = np.array([[1.0], [1.0], [9.0]])
    no_fix, _ = after_fix(found, bank, np.ones((3, 1)), determinant, np.array([False]))
    assert no_fix.support == found.support


def test_belief_in_the_witness_ends_where_its_challenger_takes_its_place() -> None:
    """And the compass is doubted if an offset was believed."""
    bank = opposite_of_witness(witness(0.4, 0.1))
    steps = round(WON_AT / LARGEST_GAIN)
    for believed in (False, True):
        start = start_offset((1,))._replace(likely_s=np.array([3.0]), believed=np.array([believed]))
        found, after = with_fixes([(9.0, 0.0)] * (steps - 1), start, bank)
        assert (found.likely_s, found.believed, after is bank) == (3.0, believed, True)
        won, after = with_fixes([(9.0, 0.0)], found, bank)
        assert (bool(won.believed), bool(won.doubted)) == (False, believed)
        assert won.likely_s == won.agreeing_s == won.surprised_s == won.support == 0.0
        assert not won.surprise.any()
        assert not won.turned
        np.testing.assert_array_equal(after.mean[:, WITNESS], bank.mean[:, CHALLENGER])


@pytest.mark.parametrize("which", ["believed", "doubted"])
def test_challenger_begins_while_an_offset_is_believed_or_the_compass_doubted(which: str) -> None:
    none = start_offset((1,), from_readings=False)
    bank = witness(0.4, 0.1)
    same, after = with_fixes([(9.0, 0.0)] * 50, none, bank)
    assert same.challenger == none.challenger
    assert after is bank
    begun, after = with_fixes([(9.0, 0.0)], none._replace(**{which: np.array([True])}), bank)
    assert begun.challenger == 0.0
    np.testing.assert_array_equal(after.mean[:, CHALLENGER], bank.mean[:, WITNESS])


def test_right_noise_does_not_turn_the_compass() -> None:
    """A day of readings, 400 robots for 225 s each, with the prior weight of lasting fix errors."""
    rng = np.random.default_rng(50)
    offset, bank, read = start_offset((400,)), witness(0.0, 0.05, 400), np.ones(400, dtype=np.bool_)
    usual, supported, std = (np.full(400, each) for each in (0.13, SUPPORT_NEEDED, STD))
    for _ in range(600):
        noise = rng.standard_normal(400)
        offset = later(offset._replace(support=supported), NOMINAL_PERIOD_S)
        offset, _ = after_compass(offset, bank, STD * noise, std, read, 1.0, usual)
    assert not offset.doubted.any()


def test_time_without_a_reading_turns_no_compass() -> None:
    """As for a robot of a batch where another one has a reading."""
    offset = surprised([10.0] * 2, 0.1 * TURNED_AFTER_S)
    large = np.array([[2.0 * TURNED_AT], [0.0]])
    offset = later(offset._replace(surprise=large), 2.0 * TURNED_AFTER_S)
    bank, none, std = witness(0.0, 0.05), np.zeros(1), np.array([STD])
    after, found = after_compass(offset, bank, none, std, np.array([False]), 1.0, none)
    assert not after.doubted
    assert found is bank
    after, _ = after_compass(offset, bank, 9.0 * std, std, np.array([True]), 1.0, none)
    assert after.doubted


def test_readings_that_fit_end_the_surprise_and_missing_ones_do_not() -> None:
    bank, half, none = witness(0.0, 0.05), [10.0] * 3, np.zeros(1)
    before = surprised(half, TURNED_AFTER_S)
    assert not before.doubted
    after, _ = after_compass(before, bank, none, np.array([STD]), np.array([False]), 1.0, none)
    assert surprised(half, TURNED_AFTER_S, after).doubted
    ended = surprised([0.0] * 20, TURNED_AFTER_S, before)
    assert not ended.surprise.any()
    assert not surprised(half, TURNED_AFTER_S, ended).doubted


def test_offset_of_a_turned_compass_is_unknown_again() -> None:
    """The witness's alone; pose and lasting errors keep what was known."""
    one_less = math.floor(TURNED_AT / (LARGEST_SURPRISE - USUAL_SURPRISE))
    offset = surprised([10.0] * one_less, TURNED_AFTER_S)
    offset = CompassOffset(*(np.repeat(array, 2, axis=-1) for array in offset))
    bank = witness(0.4, 0.05, robots=2)
    after, found = after_compass(
        later(offset, TURNED_AFTER_S), bank, np.array([10.0 * STD, 0.0]), np.full(2, STD),
        np.array([True, True]), 1.0, np.zeros(2),
    )  # fmt: skip
    assert after.doubted.tolist() == after.turned.tolist() == [True, False]
    assert not after.surprise[:, 0].any()
    expected = bank.covariance.copy()
    expected[OFFSET, :, WITNESS, 0] = expected[:, OFFSET, WITNESS, 0] = 0.0
    expected[OFFSET, OFFSET, WITNESS, 0] = WITNESS_OFFSET_STD**2
    np.testing.assert_array_equal(found.covariance, expected)
    np.testing.assert_array_equal(found.mean, bank.mean)


def test_reading_to_come_is_suspected_if_it_makes_an_offset_likely() -> None:
    """D is that of the witness corrected by the reading, as a dense Kalman filter does it."""
    rng, robots, R, read = np.random.default_rng(3), 200, 0.01, np.ones(200, dtype=np.bool_)
    bank = witness(0.0, 0.05, robots)
    h = np.zeros(AUGMENTED_SIZE)
    h[[Component.YAW, Component.YAW_DRIFT, OFFSET]] = 1.0
    z = rng.uniform(-math.pi, math.pi, robots)
    corrected = Bank(bank.mean.copy(), bank.covariance.copy())
    for i in range(robots):
        root = 0.1 * rng.standard_normal((AUGMENTED_SIZE, AUGMENTED_SIZE))
        P, x = root @ root.T, rng.uniform(-0.5, 0.5, AUGMENTED_SIZE)
        bank.mean[:, WITNESS, i], bank.covariance[:, :, WITNESS, i] = x, P
        gain = P @ h / (h @ P @ h + R)
        e = math.remainder(z[i] - h @ x, math.tau)
        corrected.mean[:, WITNESS, i] = x + gain * e
        corrected.covariance[:, :, WITNESS, i] = P - np.outer(gain, h @ P)
    likely = log_odds(corrected) > LIKELY_AT
    assert 0.1 < likely.mean() < 0.9
    start = start_offset((robots,))
    found, kept_bank = suspected_with(start, bank, z, np.full(robots, R), read)
    assert kept_bank is bank
    np.testing.assert_array_equal(found.suspected, likely)
    np.testing.assert_array_equal(found.unknown, likely)
    # What is believed is not suspected; without a reading nothing changes.
    believed = start._replace(believed=read)
    assert not suspected_with(believed, bank, z, np.full(robots, R), read)[0].suspected.any()
    kept, _ = suspected_with(found, bank, z, np.full(robots, R), ~read)
    np.testing.assert_array_equal(kept.suspected, likely)


def test_reading_that_disagrees_makes_an_offset_in_doubt_unknown_before_it_is_taken() -> None:
    """So that a compass without sense does not pull the witness's yaw."""
    R, read = 0.01, np.ones(3, dtype=np.bool_)
    bank = witness(0.4, 0.05, 3)
    h = np.zeros(AUGMENTED_SIZE)
    h[[Component.YAW, Component.YAW_DRIFT, OFFSET]] = 1.0
    expected = h @ bank.mean[:, WITNESS]
    P = np.moveaxis(bank.covariance[:, :, WITNESS], -1, 0)
    std = np.sqrt(h @ P @ h + R)
    z = expected + std * [DISAGREES_AT + 0.1, DISAGREES_AT - 0.1, DISAGREES_AT + 0.1]
    doubted = np.array([True, True, False])
    before = start_offset((3,))._replace(doubted=doubted, agreeing_s=np.full(3, 2.0))
    offset, found = suspected_with(before, bank, z, np.full(3, R), read)
    assert offset.agreeing_s.tolist() == [0.0, 2.0, 2.0]
    assert found.covariance[OFFSET, OFFSET, WITNESS].tolist() == pytest.approx(
        [WITNESS_OFFSET_STD**2, 0.05**2, 0.05**2]
    )
    np.testing.assert_array_equal(found.mean, bank.mean)


def test_doubt_ends_when_the_offset_is_known_and_decided() -> None:
    new = start_offset((1,))._replace(doubted=np.array([True]))
    before, _ = considered(new, witness(0.0, 0.5 * KNOWN_STD), KNOWN_AFTER_S - 2.0 * DT)
    assert before.doubted
    doubted = new._replace(agreeing_s=np.array([KNOWN_AFTER_S]), turned=np.array([True]))
    for std in (1.0, 1.1 * KNOWN_STD):  # not known yet
        offset, changed = reconsidered(doubted, witness(0.0, std), DT)
        assert (bool(offset.doubted), bool(offset.turned), bool(changed)) == (True, True, False)
    # Known, and as usual: the compass is as it was.
    offset, changed = reconsidered(doubted, witness(0.0, 0.5 * KNOWN_STD), DT)
    assert (bool(offset.doubted), bool(offset.believed), bool(changed)) == (False, False, True)
    assert not offset.turned
    # Known, and off: only once it is believed.
    bank = witness(1.6, 0.5 * KNOWN_STD)
    offset, changes = considered(doubted, bank, BELIEVED_AFTER_S - DT)
    assert (bool(offset.doubted), changes) == (True, 0)
    offset, changed = reconsidered(offset, bank, DT)
    assert (bool(offset.doubted), bool(offset.believed), bool(changed)) == (False, True, True)


def test_robots_of_a_batch_are_believed_each_by_itself() -> None:
    bank = witness(0.8, 0.1, robots=2)
    bank.mean[OFFSET, WITNESS, 1] = 0.0
    offset, changes = considered(start_offset((2,)), bank, 2.0 * BELIEVED_AFTER_S)
    assert (offset.believed.tolist(), changes) == ([True, False], 1)
