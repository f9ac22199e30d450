# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""A period of several instants: every reading at its own time, at whatever rate it comes."""

import math
from collections.abc import Callable

import numpy as np
import pytest
from periods import (
    FIX,
    FIX_AND_COMPASS,
    MODES,
    NO_ROWS,
    ONLY_COMPASS,
    START,
    START_COVARIANCE,
    arrays_of,
    bytes_of,
    wild_epochs,
)
from textbook_ekf import textbook_step

from fnn_ekf_ros.core.filter import fuse, step
from fnn_ekf_ros.core.joint_state import ALARM_MEMORY
from fnn_ekf_ros.core.motion import MotionModel
from fnn_ekf_ros.core.results import Epoch
from fnn_ekf_ros.core.rows import FIX_ROWS
from fnn_ekf_ros.core.state import JOINT, FilterModel, reset_pose, start_filter


@pytest.mark.parametrize("motion_model", list(MotionModel))
@pytest.mark.slow
def test_several_readings_a_period_equal_the_textbook_filter(
    make_model: Callable[..., FilterModel], motion_model: MotionModel
) -> None:
    """Each is fused at its instant, any rows of it; some instants are the same."""
    model = make_model(motion_model=motion_model)
    rng = np.random.default_rng(110)
    state, x, P = start_filter(model, START, START_COVARIANCE), START, START_COVARIANCE
    own = np.diag(model.measurement_noise)
    for _ in range(80):
        period, nis, rows_read = wild_epochs(rng, int(rng.integers(1, 7))), 0.0, 0
        for control, duration_s, z, available, reported in period:
            Q = np.diag(model.process_noise) * duration_s / 0.375
            R, fix = own.copy(), list(FIX_ROWS)
            if reported is not None:
                R[np.ix_(fix, fix)] = reported
            # The textbook's arc needs a turn; without any motion both models are the same.
            paper = motion_model is MotionModel.PAPER or duration_s == 0.0
            rows = [int(row) for row in np.flatnonzero(available)]
            before, P_minus = textbook_step(paper, x, P, control, Q, z, R, [])
            x, P = textbook_step(paper, x, P, control, Q, z, R, rows)
            components = [(0, 1, 2, 2)[row] for row in rows]
            r = np.array([z[row] - before[i] for row, i in zip(rows, components, strict=True)])
            r = np.where(np.array(components) == 2, np.arctan2(np.sin(r), np.cos(r)), r)
            S = P_minus[np.ix_(components, components)] + R[np.ix_(rows, rows)]
            nis += float(r @ np.linalg.solve(S, r)) if rows else 0.0
            rows_read += len(rows)
        state, result = step(model, state, period)
        np.testing.assert_allclose(state.mean[:2], x[:2], atol=1e-9, rtol=0.0)
        assert abs(math.remainder(state.mean[2] - x[2], 2.0 * math.pi)) < 1e-9
        np.testing.assert_allclose(state.covariance, P, atol=1e-11, rtol=0.0)
        assert result.nis == pytest.approx(nis, rel=1e-8)
        assert result.degrees_of_freedom == rows_read
        assert len(result.shown) == sum(bool(epoch.available.any()) for epoch in period)


def test_the_order_of_readings_of_one_instant_does_not_matter(
    make_model: Callable[..., FilterModel],
) -> None:
    """Fix and compass together, or one after the other without time between."""
    model, control = make_model(), np.array([0.4, 0.5])
    state = start_filter(model, START, START_COVARIANCE)
    z, still = np.array([1.5, 2.2, 1.1, 0.0]), np.zeros(2)
    expected, _ = step(model, state, [Epoch(control, 0.375, z, FIX_AND_COMPASS)])
    for first, second in ((FIX, ONLY_COMPASS), (ONLY_COMPASS, FIX)):
        period = [Epoch(control, 0.375, z, first), Epoch(still, 0.0, z, second)]
        got, _ = step(model, state, period)
        np.testing.assert_allclose(got.mean, expected.mean, rtol=0.0, atol=1e-13)
        np.testing.assert_allclose(got.covariance, expected.covariance, rtol=0.0, atol=1e-15)


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.slow
def test_a_period_is_its_instants_fused_one_after_the_other(
    model_of: Callable[..., FilterModel], mode: str
) -> None:
    model, rng = model_of(mode), np.random.default_rng(111)
    state = start_filter(model, START, START_COVARIANCE)
    for _ in range(20):
        period, alone, shown = wild_epochs(rng, 3), state, []
        for epoch in period:
            alone, seen = fuse(model, alone, epoch)
            shown += [] if seen is None else [seen]
        state, result = step(model, state, period)
        assert bytes_of(*result.shown) == bytes_of(*shown)
        assert bytes_of(state.bank, state.gate, state.pace) == bytes_of(
            alone.bank, alone.gate, alone.pace
        )


def cut(rng: np.random.Generator, epoch: Epoch, parts: int) -> list[Epoch]:
    """Return an epoch without readings cut at arbitrary instants."""
    shares = rng.dirichlet(np.ones(parts))
    return [
        epoch._replace(control=share * epoch.control, duration_s=float(share) * epoch.duration_s)
        for share in shares
    ]


@pytest.mark.parametrize("parts", [2, 3, 10])
@pytest.mark.slow
def test_cutting_a_period_without_readings_changes_neither_pose_nor_clocks(
    model_of: Callable[..., FilterModel], parts: int
) -> None:
    """Alarms fade, a hypothesis ages, and sensors are silent as long as without the cuts."""
    model, rng = model_of("joint"), np.random.default_rng(112)
    state = start_filter(model, START, START_COVARIANCE)
    for epoch in wild_epochs(rng, 60):
        state, _ = fuse(model, state, epoch)
    far = state.mean[[0, 1, 2, 2]] + np.array([500.0, 0.0, 0.0, 0.0])
    state, _ = fuse(model, state, Epoch(np.array([0.1, 0.1]), 0.2, far, FIX))
    assert state.relocation_hypothesis.active
    assert state.joint is not None
    state = state._replace(joint=state.joint._replace(lead=np.array([3.0, 7.0])))
    assert state.joint is not None
    blind = Epoch(np.array([0.4, -0.7]), 0.9, np.full(4, np.nan), NO_ROWS)
    whole, _ = step(model, state, [blind])
    split, result = step(model, state, cut(rng, blind, parts))
    assert not result.shown
    assert whole.joint is not None
    assert split.joint is not None
    assert bytes_of(whole.gate, whole.window) == bytes_of(split.gate, split.window)
    assert bytes_of(whole.gate, whole.window) == bytes_of(state.gate, state.window)
    elapsed = 0.9 / 0.375
    np.testing.assert_allclose(split.joint.lead, ALARM_MEMORY**elapsed * state.joint.lead)
    for now, before in zip(split.pace, state.pace, strict=True):
        np.testing.assert_allclose(now, before + elapsed, rtol=1e-13)
    np.testing.assert_allclose(
        split.relocation_hypothesis.age_s, state.relocation_hypothesis.age_s + 0.9, rtol=1e-13
    )
    close = {"rtol": 1e-12, "atol": 1e-12}
    np.testing.assert_allclose(split.bank.mean, whole.bank.mean, **close)
    for one, other in zip(arrays_of(split.joint), arrays_of(whole.joint), strict=True):
        np.testing.assert_allclose(one, other, **close)
    for one, other in zip(arrays_of(split.noise), arrays_of(whole.noise), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-12)
    # Yaw's variance is a sum over time; the same for every filter whose noise stays.
    variances = [each.bank.covariance[2, 2, JOINT] for each in (split, whole)]
    np.testing.assert_allclose(variances[0], variances[1], rtol=1e-12)


@pytest.mark.parametrize("parts", [1, 2, 3, 10])
def test_sideways_variance_of_a_straight_way_in_parts(
    make_model: Callable[..., FilterModel], parts: int
) -> None:
    """q way^2 (1/3 - 1/(12 n^2)) for n equal parts: from 1/4 to the integral's 1/3."""
    model, way = make_model(), 0.4
    epoch = Epoch(
        np.array([way / parts, 0.0]), 0.375 / parts, np.full(4, np.nan), NO_ROWS
    )  # fmt: skip
    state, _ = step(model, start_filter(model, np.zeros(3), np.zeros((3, 3))), [epoch] * parts)
    distance, rotation = model.process_noise
    sideways = rotation * way**2 * (1.0 / 3.0 - 1.0 / (12.0 * parts**2))
    lean = 0.5 * rotation * way
    expected = [[distance, 0.0, 0.0], [0.0, sideways, lean], [0.0, lean, rotation]]
    np.testing.assert_allclose(state.covariance, expected, rtol=1e-12, atol=1e-18)


def test_headings_are_wrapped_wherever_a_pose_comes_from(
    model_of: Callable[..., FilterModel],
) -> None:
    """A pose that is set may have any yaw, and a reading that starts a hypothesis, too."""
    model = model_of("none", suspects=True)
    turned = np.array([[0.0], [0.0], [7.0]])
    state = start_filter(model, turned, np.diag([0.01, 0.01, 0.02])[:, :, None])
    expected = 7.0 - 2.0 * np.pi
    np.testing.assert_allclose(state.bank.mean[2], expected, rtol=1e-12)
    state = reset_pose(model, state, -turned, state.covariance)
    np.testing.assert_allclose(state.bank.mean[2], -expected, rtol=1e-12)
