# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Readings inside of a period, rows that are missing, and covariances that fixes report."""

import math
from collections.abc import Callable

import numpy as np
import pytest
from banks import BOTH_MODELS
from periods import ALL_ROWS, NO_ROWS, START, START_COVARIANCE, arrays_of, bytes_of
from random_periods import one_epoch, random_covariance
from textbook_ekf import textbook_step

from fnn_ekf_ros.core.adaptation import Adaptation
from fnn_ekf_ros.core.arrays import FloatArray
from fnn_ekf_ros.core.filter import step
from fnn_ekf_ros.core.motion import MotionModel, displacement
from fnn_ekf_ros.core.results import Epoch
from fnn_ekf_ros.core.rows import FIX_ROWS
from fnn_ekf_ros.core.state import FilterModel, start_filter


def arc_pose(start: FloatArray, control: FloatArray) -> FloatArray:
    """Where an arc from `start` ends; radius form."""
    radius = control[0] / control[1]
    end = start[2] + control[1]
    return np.array(
        [
            start[0] + radius * (math.sin(end) - math.sin(start[2])),
            start[1] + radius * (math.cos(start[2]) - math.cos(end)),
            end,
        ]
    )


@pytest.mark.parametrize("heading", [0.5, 3.1, -2.0])
def test_readings_inside_the_period_are_compared_with_the_arc_at_their_instants(
    make_model: Callable[..., FilterModel], heading: float
) -> None:
    """Noise-free arc, every row sampled at another instant: no innovation is left."""
    model, parts = make_model(), (0.1, 0.45, 0.7, 1.0)
    truth = np.array([1.0, 2.0, heading])
    state = start_filter(model, truth, START_COVARIANCE)
    for control in (np.array([0.4, 0.5]), np.array([-0.2, 0.9]), np.array([0.3, -1.4])):
        period = []
        for row, part, since in zip(range(4), parts, np.diff(parts, prepend=0.0), strict=True):
            seen = arc_pose(truth, part * control)[[0, 1, 2, 2]]
            only = np.arange(4) == row
            z = np.where(only, seen, np.nan)
            period.append(Epoch(since * control, float(since) * 0.375, z, only))
        state, result = step(model, state, period)
        truth = arc_pose(truth, control)
        assert np.all(result.available)
        np.testing.assert_allclose(result.innovation, 0.0, atol=1e-14)
        np.testing.assert_allclose(state.mean[:2], truth[:2], rtol=0.0, atol=1e-14)
        assert abs(math.remainder(state.mean[2] - truth[2], 2.0 * math.pi)) < 1e-14


@BOTH_MODELS
def test_a_reading_inside_the_period_is_compared_with_the_way_until_then(
    make_model: Callable[..., FilterModel], model: MotionModel
) -> None:
    """The innovation is less by the model's own way from the instant to the period's end."""
    control, z = np.array([0.4, 0.5]), np.array([1.2, 2.3, 0.9, 1.1])
    filter_model = make_model(motion_model=model)
    state = start_filter(filter_model, START, START_COVARIANCE)
    _, direct = step(filter_model, state, one_epoch(control, z, ALL_ROWS))
    end = displacement(model, START[2], control)
    for part in (0.0, 0.3, 0.6, 0.9):
        rest = Epoch((1.0 - part) * control, (1.0 - part) * 0.375, z, NO_ROWS)
        inside = [Epoch(part * control, part * 0.375, z, ALL_ROWS), rest]
        _, result = step(filter_model, state, inside)
        since = end - displacement(model, START[2], part * control)
        added = since[[0, 1, 2, 2]]
        difference = result.innovation - direct.innovation
        np.testing.assert_allclose(difference, added, rtol=0.0, atol=1e-15)
        assert np.all(np.abs(added) > 1e-3)


@pytest.mark.parametrize("mode", ["none", "joint"])
def test_missing_rows_may_hold_anything(
    make_model: Callable[..., FilterModel], make_adaptation: Callable[..., Adaptation], mode: str
) -> None:
    """Not-a-number in the masked rows' measurement."""
    model = make_model(adaptation=make_adaptation(mode=mode))
    available = np.array([True, False, True, False])
    control = np.array([0.4, 0.5])
    z = np.array([1.2, 2.3, 0.9, 1.1])
    state = start_filter(model, START, START_COVARIANCE)
    clean = step(model, state, one_epoch(control, z, available))
    dirty = step(model, state, one_epoch(control, np.where(available, z, np.nan), available))
    assert bytes_of(*clean) == bytes_of(*dirty)


@pytest.mark.parametrize("mode", ["none", "joint"])
@pytest.mark.parametrize("rows", [[0, 1], [2], [3], [0, 1, 2], [0], [1, 3]])
def test_missing_rows_may_hold_anything_in_the_reported_covariance(
    make_model: Callable[..., FilterModel],
    make_adaptation: Callable[..., Adaptation],
    mode: str,
    rows: list[int],
) -> None:
    """Not-a-number gets nowhere, and any other number is the same as that."""
    model = make_model(adaptation=make_adaptation(mode=mode))
    available = np.isin(np.arange(4), rows)
    measured = available[list(FIX_ROWS)]
    full = random_covariance(np.random.default_rng(68))
    found = []
    for other in (np.nan, 7.0):
        covariance = np.where(measured[:, None] & measured, full, other)
        state = start_filter(model, START, START_COVARIANCE)
        z = np.where(available, [1.2, 2.3, 0.9, 1.1], np.nan)
        for _ in range(4):
            period = one_epoch(np.array([0.1, 0.1]), z, available, covariance)
            state, result = step(model, state, period)
        assert all(np.all(np.isfinite(array)) for array in arrays_of(state, result))
        found.append(bytes_of(state, result))
    assert found[0] == found[1]


@pytest.mark.parametrize(
    "rows", [[0, 1, 2, 3], [0, 1, 3], [0, 1], [1, 3], [0, 3], [1], [3], [2, 3]]
)
def test_reported_covariance_is_multiplied_by_the_adapted_scale(
    make_model: Callable[..., FilterModel], rows: list[int]
) -> None:
    """R of row i and j times the root of both rows' (adapted / started); the compass keeps its."""
    model, control = make_model(), np.array([0.4, 0.5])
    scale = np.array([4.0, 0.25, 9.0, 1.7])
    reported = random_covariance(np.random.default_rng(66))
    adapted = scale * np.array(model.measurement_noise)
    state = start_filter(model, START, START_COVARIANCE, measurement_noise=adapted)
    z, available = np.array([1.5, 2.1, 1.2, 0.9]), np.isin(np.arange(4), rows)
    after, result = step(model, state, one_epoch(control, z, available, reported))
    R, fix = np.diag(adapted), list(FIX_ROWS)
    R[np.ix_(fix, fix)] = reported * np.sqrt(np.outer(scale[fix], scale[fix]))
    Q = np.diag(model.process_noise)
    x, P = textbook_step(False, START, START_COVARIANCE, control, Q, z, R, rows)
    np.testing.assert_allclose(after.mean, x, rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(after.covariance, P, rtol=0.0, atol=1e-12)
    # S of the rows together, from the definition.
    before, P_minus = textbook_step(False, START, START_COVARIANCE, control, Q, z, R, [])
    components = np.array([0, 1, 2, 2])[rows]
    S = P_minus[np.ix_(components, components)] + R[np.ix_(rows, rows)]
    r = z[rows] - before[components]
    np.testing.assert_allclose(result.nis, r @ np.linalg.solve(S, r), rtol=1e-10)
    np.testing.assert_allclose(result.innovation[rows], r, rtol=0.0, atol=1e-14)
    np.testing.assert_allclose(result.innovation_variance[rows], np.diag(S), rtol=1e-12)


def test_reported_covariance_alone_is_used_before_anything_was_adapted(
    make_model: Callable[..., FilterModel],
) -> None:
    state = start_filter(make_model(), START, START_COVARIANCE)
    [epoch] = one_epoch(np.array([0.4, 0.5]), np.array([1.5, 2.1, 1.2, 0.9]), ALL_ROWS)
    reported = np.diag(np.array(make_model().measurement_noise)[list(FIX_ROWS)])
    plain = step(make_model(), state, [epoch])
    with_report = step(make_model(), state, [epoch._replace(fix_covariance=reported)])
    for one, other in zip(arrays_of(*plain), arrays_of(*with_report), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-14)


def test_reported_covariance_moves_by_the_network_output(
    make_model: Callable[..., FilterModel], make_adaptation: Callable[..., Adaptation]
) -> None:
    """Sensors that report ten times the filter's R: what is used moves by dR, not by 10 dR."""
    model = make_model(adaptation=make_adaptation(mode="r", window_length=3))
    own = np.array(model.measurement_noise)
    reported = np.diag(10.0 * own[list(FIX_ROWS)])
    rows = np.array([True, True, False, True])
    [epoch] = one_epoch(np.array([0.1, 0.1]), START[[0, 1, 2, 2]] + 1.0, rows)
    state = start_filter(model, START, START_COVARIANCE)
    after, _ = step(model, state, [epoch._replace(fix_covariance=reported)])
    used = make_model(
        measurement_noise=tuple(10.0 * own), adaptation=make_adaptation(mode="r", window_length=3)
    )
    own_ten, _ = step(used, start_filter(used, START, START_COVARIANCE), [epoch])
    effective = 10.0 * own * after.measurement_noise / own
    np.testing.assert_allclose(effective[rows], own_ten.measurement_noise[rows], rtol=1e-9)
    assert np.all(after.measurement_noise[rows] != own[rows])
