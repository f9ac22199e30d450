# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Simulated outages: clocks, windows, and the weights that follow, by hand."""

import math

import numpy as np
import pytest

from fnn_ekf_ros.core.arrays import FloatArray
from fnn_ekf_ros.core.lasting.members import HORIZONS_S, MEMBER_COUNT, PHASES, PRIOR, WHITE
from fnn_ekf_ros.core.lasting.outages import (
    LARGEST_LOSS,
    REDRAWN,
    WHITE_LEAD,
    WINDOW,
    Outages,
    advanced,
    scored,
    start_outages,
    weights_of,
)

H = len(HORIZONS_S)
ENDS = np.array([(1.0 + WINDOW) * horizon for horizon in HORIZONS_S])
PRIOR_WEIGHTS = PRIOR.behind(0)
DT = 0.5


def passed(outages: Outages, seconds: float, *, weighs: bool = True) -> tuple[Outages, FloatArray]:
    """Return the outages of one robot after some time, and how often each copy was renewed."""
    count = np.zeros((H, PHASES))
    for _ in range(round(seconds / DT)):
        after = advanced(outages, np.array(DT), np.array(weighs))
        outages, count = after.outages, count + after.renewed
    return outages, count


def likelihoods(of_members: FloatArray) -> FloatArray:
    """Return the same log likelihoods `(M,)` for the copies of each horizon and phase."""
    return np.broadcast_to(of_members, (H, PHASES, MEMBER_COUNT))


@pytest.mark.parametrize("horizon", range(H))
def test_copies_are_made_a_part_of_a_cycle_apart_and_anew_at_their_end(horizon: int) -> None:
    end = ENDS[horizon]
    outages, made = start_outages(()), []
    assert np.array_equal(outages.age_s[horizon], -end * np.arange(PHASES) / PHASES)
    for k in range(1, round(2.2 * end / DT)):
        after = advanced(outages, np.array(DT), np.array(True))
        outages = after.outages
        made += [(phase, k * DT) for phase in range(PHASES) if after.renewed[horizon, phase]]
    apart = [[t for phase, t in made if phase == one] for one in range(PHASES)]
    assert apart[0][:2] == [end, 2.0 * end]
    for phase in range(1, PHASES):
        assert apart[phase][0] == pytest.approx(end * phase / PHASES, abs=DT)
        assert np.diff(apart[phase]) == pytest.approx(end, abs=DT)


def test_clocks_stop_while_the_robot_stands() -> None:
    """A duration of 0: nothing moves, however often."""
    outages, _ = passed(start_outages(()), 7.0)
    for _ in range(1000):
        after = advanced(outages, np.array(0.0), np.array(True))
        assert not after.renewed.any()
        outages = after.outages
    assert np.array_equal(outages.age_s, passed(start_outages(()), 7.0)[0].age_s)


def test_fixes_are_scored_from_the_horizon_to_the_windows_end() -> None:
    outages = start_outages(())
    found: dict[float, bool] = {}
    for k in range(round(ENDS[0] / DT)):
        t = k * DT
        after = scored(outages, likelihoods(np.ones(MEMBER_COUNT)), np.array(True))
        found[t] = bool(after.fixes[0, 0] > outages.fixes[0, 0])
        assert np.array_equal(after.score[0, 0] > outages.score[0, 0],
                              np.full(MEMBER_COUNT, found[t]))  # fmt: skip
        outages = advanced(after, np.array(DT), np.array(True)).outages
    assert found == {t: t >= HORIZONS_S[0] for t in found}
    assert outages.fixes[0, 0] == 0.0  # renewed at its end
    assert not outages.score[0, 0].any()


def test_rejected_and_missing_fixes_are_not_scored() -> None:
    outages, _ = passed(start_outages(()), HORIZONS_S[0] + 1.0)
    assert scored(outages, likelihoods(np.ones(MEMBER_COUNT)), np.array(False)) is outages


def window_of(score: FloatArray, *, fixes: int = 1, weighs: bool = True) -> FloatArray:
    """Return log weights `(M,)` of the shorter horizon after one window of equal fixes."""
    outages, _ = passed(start_outages(()), HORIZONS_S[0])
    for _ in range(fixes):
        outages = scored(outages, likelihoods(score), np.array(True))
    outages, count = passed(outages, ENDS[0] - HORIZONS_S[0], weighs=weighs)
    assert count[0, 0] == 1.0
    return outages.log_weight[0]


def test_weights_after_a_window_by_hand() -> None:
    """The mean likelihood, a bounded loss against the best, and a part that is redrawn."""
    score = np.zeros(MEMBER_COUNT)
    score[2], score[5] = 1.0, -50.0
    gain = np.where(np.arange(MEMBER_COUNT) == 2, 0.0, -1.0)
    gain[5] = -LARGEST_LOSS
    expected = PRIOR_WEIGHTS * np.exp(gain)
    expected = (1.0 - REDRAWN) * expected / expected.sum() + REDRAWN * PRIOR_WEIGHTS
    np.testing.assert_allclose(np.exp(window_of(score)), expected, rtol=1e-12)
    # One window is one measurement, however many fixes it has.
    np.testing.assert_allclose(window_of(score, fixes=17), window_of(score), rtol=1e-12)


@pytest.mark.parametrize(("fixes", "weighs"), [(0, True), (3, False)])
def test_windows_that_do_not_count_leave_the_weights(fixes: int, weighs: bool) -> None:
    """Without a fix, and while the noise is not known."""
    score = np.linspace(-1.0, 1.0, MEMBER_COUNT)
    before = start_outages(()).log_weight[0]
    assert np.array_equal(window_of(score, fixes=fixes, weighs=weighs), before)


def test_no_member_is_ever_lost() -> None:
    """After many windows against it a member still has what is redrawn, and it comes back."""
    score = np.zeros(MEMBER_COUNT)
    score[WHITE] = -100.0
    outages = start_outages(())
    weights = []
    for part in range(2):
        for _ in range(40):
            outages, _ = passed(outages, 2.0)
            outages = scored(outages, likelihoods((1 - 2 * part) * score), np.array(True))
        weights.append(np.exp(outages.log_weight[0][WHITE]))
    assert REDRAWN * PRIOR_WEIGHTS[WHITE] <= weights[0] < 0.1 < 0.8 < weights[1]


def test_robots_of_a_batch_have_windows_of_their_own() -> None:
    """One stands, one has no fixes, one does not know its noise, two differ by their fixes."""
    moves = np.array([0.0, 1.0, 1.0, 1.0, 1.0])
    has = np.array([True, False, True, True, True])
    weighs = np.array([True, True, False, True, True])
    score = np.random.default_rng(3).normal(0.0, 1.0, (MEMBER_COUNT, 5))
    batch = start_outages((5,))
    alone = [start_outages(()) for _ in range(5)]
    for _ in range(60):
        batch = scored(batch, np.broadcast_to(score, (H, PHASES, *score.shape)), has)
        batch = advanced(batch, moves * DT, weighs).outages
        for n in range(5):
            one = scored(alone[n], likelihoods(score[:, n]), has[n])
            alone[n] = advanced(one, moves[n] * DT, weighs[n]).outages
    for n in range(5):
        for whole, one in zip(batch, alone[n], strict=True):
            np.testing.assert_allclose(whole[..., n], one, rtol=1e-12)
    prior = start_outages(()).log_weight
    for n in range(3):
        assert np.array_equal(batch.log_weight[..., n], prior)
    for n in (3, 4):
        assert np.any(batch.log_weight[..., n] != prior)


def test_learned_weights_are_kept_where_outages_begin_again() -> None:
    log_weight = np.log(np.random.default_rng(4).dirichlet(np.ones(MEMBER_COUNT), H))
    again = start_outages((), log_weight)
    assert again.log_weight is log_weight
    assert np.array_equal(again.age_s, start_outages(()).age_s)


def closed_form(log_weight: FloatArray) -> FloatArray:
    """Return the weights in use: softmax of L, whose white entry leads by its head start."""
    L = log_weight.mean(axis=0)
    lead = math.log(sum(math.exp(L[k]) for k in range(MEMBER_COUNT) if k != WHITE)) - L[WHITE]
    L = L.copy()
    L[WHITE] += max(0.0, WHITE_LEAD - max(0.0, lead))
    e = np.exp(L)
    return np.asarray(e / e.sum())


@pytest.mark.parametrize("white", [-30.0, -3.0, -2.0, 0.0, 3.0, 30.0])
def test_weights_in_use(white: float) -> None:
    """The white member keeps the say until others lead clearly."""
    rng = np.random.default_rng(5)
    log_weight = rng.normal(0.0, 1.0, (H, MEMBER_COUNT))
    log_weight[:, WHITE] = white + np.log(np.exp(log_weight[:, 1:]).sum())
    before = log_weight.copy()
    found = weights_of(log_weight)
    np.testing.assert_allclose(found, closed_form(log_weight), rtol=1e-12)
    assert found.sum() == pytest.approx(1.0)
    assert np.array_equal(log_weight, before)


def test_prior_weights_in_use_are_mostly_white() -> None:
    assert weights_of(start_outages(()).log_weight)[WHITE] > 0.85


def test_weights_in_use_of_a_batch() -> None:
    log_weight = np.random.default_rng(6).normal(0.0, 2.0, (H, MEMBER_COUNT, 3, 2))
    found = weights_of(log_weight)
    for i in range(3):
        for k in range(2):
            np.testing.assert_allclose(found[:, i, k], closed_form(log_weight[..., i, k]))
