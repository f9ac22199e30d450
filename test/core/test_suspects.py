"""Suspects: the one that does not fit the others is found, and nobody without a reason."""

from collections.abc import Callable

import numpy as np
import pytest

from fnn_ekf_ros.core.arrays import FloatArray, Row
from fnn_ekf_ros.core.motion import MotionModel, move
from fnn_ekf_ros.core.plant import Plant, StepInput
from fnn_ekf_ros.core.suspects import (
    LONGEST_LEAD,
    SUSPECTS,
    SuspectState,
    no_suspects,
    suspect,
)

PLANT = Plant(MotionModel.EXACT_ARC, 1.0, (0.01, 0.01, 0.018, 0.018))
Q, R = np.array([0.02, 0.0175]) ** 2, np.array([0.01, 0.01, 0.018, 0.018])
START_P = np.diag([0.01, 0.01, 0.018])
AVAILABLE = np.array([True, True, True, False])
Spoil = Callable[[int, np.random.Generator], tuple[FloatArray, FloatArray]]


def drive(spoil: Spoil, steps: int = 200, runs: int = 4, seed: int = 3) -> list[FloatArray]:
    """Return the leads `(runs, 3)` of robots on a bent path after each step.

    `spoil` returns what is added to the controls that are told and to the measurements.
    """
    rng = np.random.default_rng(seed)
    truth = np.zeros((runs, 3))
    state = no_suspects(truth, np.broadcast_to(START_P, (runs, 3, 3)))
    leads = []
    for step in range(steps):
        told = np.tile([0.11, 0.03], (runs, 1))
        truth = move(PLANT.motion_model, truth, told + np.sqrt(Q) * rng.normal(size=(runs, 2))).mean
        z = truth[:, [0, 1, 2, 2]] + np.sqrt(R) * rng.normal(size=(runs, 4))
        wrong_control, wrong_z = spoil(step, rng)
        period = StepInput(told + wrong_control, z + wrong_z, np.tile(AVAILABLE, (runs, 1)))
        state = suspect(PLANT, state, (Q, R), period, (state.mean[:, 0], state.covariance[:, 0]))
        leads.append(state.lead)
    return leads


def nothing(_: int, __: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    return np.zeros(2), np.zeros(4)


def turned_compass(step: int, _: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    return np.zeros(2), np.array([0.0, 0.0, 1.5 * (step >= 50), 0.0])


def noisy_fixes(step: int, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    return np.zeros(2), np.array([1.0, 1.0, 0.0, 0.0]) * 0.5 * (step >= 50) * rng.normal(size=4)


def stuck_left_wheel(step: int, _: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """Of a robot with wheels 0.6 m apart: half of the way, and a turn that there is not."""
    left = 0.11 - 0.3 * 0.03
    return -np.array([0.5 * left, -left / 0.6]) * (step >= 50), np.zeros(4)


def test_nobody_is_suspected_without_a_reason() -> None:
    leads = np.array(drive(nothing, steps=1000))
    assert np.mean(leads > 10.0) < 5e-3
    assert np.mean(leads > 0.0) < 0.4


@pytest.mark.parametrize(
    ("spoil", "culprit"),
    [(turned_compass, "compass"), (noisy_fixes, "lrf_pose"), (stuck_left_wheel, "encoders")],
)
def test_who_does_not_fit_the_others_leads_within_seconds(spoil: Spoil, culprit: str) -> None:
    leads = np.array(drive(spoil))
    assert leads[:50].max() < 12.0
    who = SUSPECTS.index(culprit)
    others = [index for index in range(len(SUSPECTS)) if index != who]
    for later in (65, 80):
        assert np.all(leads[later, :, who] > 10.0), leads[later]
        assert np.all(leads[later, :, who] - leads[later][:, others].max(axis=-1) > 6.0)


def test_leads_are_capped_together() -> None:
    """Who leads by how much stays when a lead is at its cap."""
    state = no_suspects(np.zeros(3), START_P)._replace(lead=np.array([LONGEST_LEAD, 30.0, 0.0]))
    far = np.array([0.0, 0.0, 0.6, 0.0])  # explained best by the compass
    published = state.mean[0], state.covariance[0]
    after = suspect(PLANT, state, (Q, R), StepInput(np.zeros(2), far, AVAILABLE), published)
    free = suspect(
        PLANT,
        state._replace(lead=np.array([20.0, 10.0, 0.0])),
        (Q, R),
        StepInput(np.zeros(2), far, AVAILABLE),
        published,
    )
    assert after.lead.max() == LONGEST_LEAD
    np.testing.assert_allclose(after.lead[0] - after.lead[1], free.lead[0] - free.lead[1])


def test_a_cleared_suspect_starts_again_from_the_one_that_suspects_nobody() -> None:
    mean = np.arange(12.0).reshape(4, 3) * 0.001
    state = SuspectState(np.array([5.0, 0.0, 0.0]), mean, np.tile(START_P, (4, 1, 1)))
    published = np.array([9.0, 9.0, 0.9]), 2.0 * START_P
    right = StepInput(np.zeros(2), np.array([0.0, 0.001, 0.002, 0.0]), AVAILABLE)
    after = suspect(PLANT, state, (Q, R), right, published)
    assert after.lead[0] > 0.0
    np.testing.assert_array_equal(after.lead[1:], 0.0)
    np.testing.assert_array_equal(after.mean[2:], [after.mean[0]] * 2)
    assert not np.array_equal(after.mean[1], after.mean[0])
    cleared = suspect(PLANT, state._replace(lead=np.zeros(3)), (Q, R), right, published)
    np.testing.assert_array_equal(cleared.mean, [published[0]] * 4)
    np.testing.assert_array_equal(cleared.covariance, [published[1]] * 4)


def test_a_period_without_measurements_changes_no_lead() -> None:
    lead = np.array([3.0, 1.0, 0.0])
    state = no_suspects(np.zeros(3), START_P)._replace(lead=lead)
    blind = StepInput(np.array([0.1, 0.0]), np.full(4, np.nan), np.zeros(4, dtype=np.bool_))
    after = suspect(PLANT, state, (Q, R), blind, (np.zeros(3), START_P))
    np.testing.assert_array_equal(after.lead, lead)
    np.testing.assert_allclose(after.mean[:, 0], 0.1)


def test_a_wild_fix_moves_the_filters_by_a_bounded_way() -> None:
    """Twice as wild moves them by far less than twice as much, and the next one is not wild."""
    state = no_suspects(np.zeros(3), START_P)
    moved = []
    for far in (20.0, 40.0):
        wild = StepInput(np.zeros(2), np.array([far, 0.0, 0.0, 0.0]), AVAILABLE)
        after = suspect(PLANT, state, (Q, R), wild, (np.zeros(3), START_P))
        assert after.lead[SUSPECTS.index("lrf_pose")] > 10.0
        moved.append(after.mean[0, Row.X])
    assert moved[0] < 1.0
    assert moved[1] < 1.2 * moved[0]


def test_robots_of_a_batch_do_not_mix() -> None:
    poses = np.array([[0.0, 0.0, 0.0], [5.0, 1.0, 1.0]])
    z = np.array([[0.1, 0.0, 0.9, 0.0], [5.0, 3.0, 1.0, 0.0]])
    both = suspect(
        PLANT,
        no_suspects(poses, np.tile(START_P, (2, 1, 1))),
        (Q, R),
        StepInput(np.tile([0.1, 0.0], (2, 1)), z, np.tile(AVAILABLE, (2, 1))),
        (poses, np.tile(START_P, (2, 1, 1))),
    )
    for index in range(2):
        alone = suspect(
            PLANT,
            no_suspects(poses[index], START_P),
            (Q, R),
            StepInput(np.array([0.1, 0.0]), z[index], AVAILABLE),
            (poses[index], START_P),
        )
        for whole, part in zip(both, alone, strict=True):
            np.testing.assert_allclose(whole[index], part, rtol=1e-12, atol=1e-12)
