# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import pytest
from banks import BOTH_MODELS
from jacobians import motion_jacobian
from periods import (
    ALL_ROWS,
    MODES,
    NO_ROWS,
    START,
    START_COVARIANCE,
    arrays_of,
    bytes_of,
    one_of_batch,
)
from textbook_ekf import textbook_step

from fnn_ekf_ros.core.adaptation import Adaptation
from fnn_ekf_ros.core.arrays import FloatArray
from fnn_ekf_ros.core.filter import step
from fnn_ekf_ros.core.joint_state import noise_without_alarms
from fnn_ekf_ros.core.motion import MotionModel, displacement, move
from fnn_ekf_ros.core.pace import NOMINAL_PERIOD_S
from fnn_ekf_ros.core.results import Epoch
from fnn_ekf_ros.core.rows import FIX_ROWS
from fnn_ekf_ros.core.state import FilterModel, for_mode, reset_pose, start_filter


def random_covariance(rng: np.random.Generator, size: float = 0.1) -> FloatArray:
    """Return a `(3, 3)` covariance of the rows of a fix."""
    root = size * rng.standard_normal((3, 3))
    return root @ root.T + 0.01 * np.eye(3)


def random_epoch(rng: np.random.Generator, batch: tuple[int, ...], duration_s: float) -> Epoch:
    """Return an epoch of robots near START, with any of the rows and a reported covariance."""
    size, few = duration_s / 0.375, (-1, *(1,) * len(batch))
    low, high = (np.reshape(limit, few) for limit in ([-0.1, 0.02], [0.2, 0.3]))
    reported = [random_covariance(rng) for _ in np.ndindex(*batch)]
    return Epoch(
        control=size * rng.uniform(low, high, (2, *batch)),
        duration_s=duration_s,
        measurement=rng.normal(np.reshape([1.0, 2.0, 0.5, 0.5], few), 0.3, (4, *batch)),
        available=rng.random((4, *batch)) < 0.6,
        fix_covariance=np.moveaxis(np.array(reported), 0, -1).reshape(3, 3, *batch),
    )


def random_periods(
    rng: np.random.Generator, steps: int, batch: tuple[int, ...] = (), most: int = 3
) -> list[list[Epoch]]:
    """Periods of one epoch to `most`."""
    periods = []
    for _ in range(steps):
        inside = np.sort(rng.uniform(0.0, 0.375, rng.integers(0, most)))
        durations = np.diff(inside, prepend=0.0, append=0.375).tolist()
        periods.append([random_epoch(rng, batch, duration_s) for duration_s in durations])
    return periods


def one_epoch(
    control: FloatArray,
    z: FloatArray,
    rows: FloatArray,
    fix_covariance: FloatArray | None = None,
    duration_s: float = 0.375,
) -> list[Epoch]:
    """Return a period with readings at its end only."""
    return [Epoch(control, duration_s, z, rows.astype(np.bool_), fix_covariance)]


def assert_same_results(one: NamedTuple, other: NamedTuple) -> None:
    """Rows without a reading show nothing: their S and D are not compared."""
    rows = one.available  # type: ignore[attr-defined]
    for name in one._fields:
        got, expected = getattr(one, name), getattr(other, name)
        if name == "shown":
            continue
        if name in ("innovation_variance", "mismatch"):
            got, expected = got[rows], expected[rows]
        parts = [(got, expected)]
        if isinstance(got, tuple):
            parts = list(zip(arrays_of(got), arrays_of(expected), strict=True))
        for a, b in parts:
            if a is not None:
                np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-12, err_msg=name)


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.slow
def test_step_changes_none_of_its_arguments_and_repeats_itself(
    make_model: Callable[..., FilterModel], make_adaptation: Callable[..., Adaptation], mode: str
) -> None:
    model = make_model(adaptation=make_adaptation(mode=mode, window_length=6))
    state = start_filter(model, START, START_COVARIANCE)
    for period in random_periods(np.random.default_rng(60), 30):
        before = bytes_of(state, *period)
        for array in arrays_of(state, *period):
            array.flags.writeable = False
        first, second = step(model, state, period), step(model, state, period)
        assert bytes_of(*first) == bytes_of(*second)
        assert bytes_of(state, *period) == before
        state = first[0]


@pytest.mark.parametrize("mode", MODES)
@BOTH_MODELS
@pytest.mark.slow
def test_batch_equals_single_filters(
    make_model: Callable[..., FilterModel],
    make_adaptation: Callable[..., Adaptation],
    mode: str,
    model: MotionModel,
) -> None:
    batch = (2, 2)
    filter_model = make_model(
        motion_model=model, adaptation=make_adaptation(mode=mode, window_length=6)
    )
    rng = np.random.default_rng(61)
    mean = START[:, None, None] + 0.1 * rng.standard_normal((3, *batch))
    together = start_filter(filter_model, mean, START_COVARIANCE)
    every = list(np.ndindex(*batch))
    alone = {i: start_filter(filter_model, mean[:, *i], START_COVARIANCE) for i in every}
    for period in random_periods(rng, 40, batch):
        together, result = step(filter_model, together, period)
        for i in every:
            mine = [one_of_batch(epoch, i) for epoch in period]
            alone[i], single = step(filter_model, alone[i], mine)
            got = arrays_of(one_of_batch(together, i))
            for one, other in zip(got, arrays_of(alone[i]), strict=True):
                np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-12)
            assert_same_results(one_of_batch(result._replace(shown=()), i), single)


@BOTH_MODELS
@pytest.mark.slow
def test_without_adaptation_the_run_equals_the_textbook_filter(
    make_model: Callable[..., FilterModel], model: MotionModel
) -> None:
    """The steps together: prediction with Q of the period, correction with R, masks."""
    filter_model = make_model(motion_model=model, period_s=0.15)
    Q = np.diag(filter_model.process_noise) * 0.15 / 0.375
    R = np.diag(filter_model.measurement_noise)
    state = start_filter(filter_model, START, START_COVARIANCE)
    x, P = START, START_COVARIANCE
    paper = model is MotionModel.PAPER
    rng = np.random.default_rng(64)
    for _ in range(300):
        epoch = random_epoch(rng, (), 0.375)._replace(duration_s=0.15, fix_covariance=None)
        rows = [int(row) for row in np.flatnonzero(epoch.available)]
        before = textbook_step(paper, x, P, epoch.control, Q, epoch.measurement, R, [])
        x, P = textbook_step(paper, x, P, epoch.control, Q, epoch.measurement, R, rows)
        state, result = step(filter_model, state, [epoch])
        np.testing.assert_allclose(state.mean[:2], x[:2], atol=1e-10, rtol=0.0)
        assert abs(math.remainder(state.mean[2] - x[2], 2.0 * math.pi)) < 1e-10
        np.testing.assert_allclose(state.covariance, P, atol=1e-12, rtol=0.0)
        variance = np.diag(before[1])[[0, 1, 2, 2]] + np.diag(R)
        np.testing.assert_allclose(result.innovation_variance, variance, rtol=1e-10)
        assert result.degrees_of_freedom == len(rows)
    assert state.process_noise.tobytes() == np.array(filter_model.process_noise).tobytes()
    assert state.measurement_noise.tobytes() == np.array(filter_model.measurement_noise).tobytes()


@pytest.mark.parametrize("mode", ["r", "q", "rq"])
def test_adaptation_changes_nothing_before_it_has_learned_something(
    make_model: Callable[..., FilterModel], make_adaptation: Callable[..., Adaptation], mode: str
) -> None:
    """The first step of the adapted noise is the one after the window is ready."""
    adaptive = make_model(adaptation=make_adaptation(mode=mode, window_length=45))
    state = start_filter(adaptive, START, START_COVARIANCE)
    plain = start_filter(make_model(), START, START_COVARIANCE)
    rng = np.random.default_rng(65)
    for i in range(16):
        period = [random_epoch(rng, (), 0.375)._replace(available=ALL_ROWS)]
        state, plain = step(adaptive, state, period)[0], step(make_model(), plain, period)[0]
        same = bytes_of(state._replace(gate=plain.gate)) == bytes_of(plain)
        # A third of 45 innovations: after the 15th the noise moves, and the 16th feels it.
        assert same == (i < 14)
        assert (state.mean.tobytes() == plain.mean.tobytes()) == (i < 15)


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


@pytest.mark.parametrize("period_s", [0.375, 0.1, 1.5])
def test_process_noise_grows_with_the_period(
    make_model: Callable[..., FilterModel], period_s: float
) -> None:
    model, control = make_model(period_s=period_s), np.array([0.4, 0.5])
    state = start_filter(model, START, START_COVARIANCE)
    period = one_epoch(control, np.zeros(4), NO_ROWS, duration_s=period_s)
    after, _ = step(model, state, period)
    motion = move(MotionModel.EXACT_ARC, START[:, None], control[:, None])
    A, W = motion_jacobian(motion)[..., 0], motion.noise_jacobian()[..., 0]
    Q = np.diag(model.process_noise) * period_s / 0.375
    expected = A @ START_COVARIANCE @ A.T + W @ Q @ W.T
    np.testing.assert_allclose(after.covariance, expected, rtol=0.0, atol=1e-15)
    np.testing.assert_array_equal(after.process_noise, model.process_noise)
    assert NOMINAL_PERIOD_S == 0.375


def test_start_takes_its_noise_from_the_model_or_from_its_caller(
    make_model: Callable[..., FilterModel],
) -> None:
    model = make_model()
    mean = np.zeros((3, 2, 5))
    state = start_filter(model, mean, np.eye(3))
    assert state.covariance.shape == (3, 3, 2, 5)
    assert state.window.squares.shape == (45, 4, 2, 5)
    np.testing.assert_array_equal(state.covariance[:, :, 1, 4], np.eye(3))
    np.testing.assert_array_equal(state.process_noise[:, 1, 4], model.process_noise)
    np.testing.assert_array_equal(state.measurement_noise[:, 1, 4], model.measurement_noise)
    assert not np.any(state.window.counts)
    Q, R = np.array([1.0, 2.0]), np.ones((4, 1, 1)) * np.arange(1.0, 11.0).reshape(2, 5)
    state = start_filter(model, mean, np.eye(3), Q, R)
    np.testing.assert_array_equal(state.process_noise[:, 0, 3], Q)
    np.testing.assert_array_equal(state.measurement_noise, R)


def test_new_pose_keeps_the_noise_and_forgets_the_innovations(
    make_model: Callable[..., FilterModel], make_adaptation: Callable[..., Adaptation]
) -> None:
    model = make_model(adaptation=make_adaptation(mode="r", window_length=6))
    state = start_filter(model, START, START_COVARIANCE)
    for period in random_periods(np.random.default_rng(67), 20):
        state, _ = step(model, state, period)
    before = bytes_of(state)
    fresh = reset_pose(model, state, np.array([7.0, 8.0, 0.9]), np.eye(3))
    assert bytes_of(state) == before
    np.testing.assert_array_equal(fresh.mean, [7.0, 8.0, 0.9])
    np.testing.assert_array_equal(fresh.covariance, np.eye(3))
    assert fresh.measurement_noise.tobytes() == state.measurement_noise.tobytes()
    assert fresh.process_noise.tobytes() == state.process_noise.tobytes()
    assert fresh.window.squares.shape == (6, 4)
    assert not np.any(fresh.window.counts)


def test_mode_q_projects_on_the_heading_at_the_end_of_the_step(
    make_model: Callable[..., FilterModel], make_adaptation: Callable[..., Adaptation]
) -> None:
    """Driving along y after a quarter turn, only y's innovations teach the forward noise."""
    model = make_model(adaptation=make_adaptation(mode="q", window_length=3))
    loud_x = np.array([5.0, 0.0, 0.0, 0.0])
    available = np.array([True, True, False, False])
    changes = []
    for heading in (0.0, -math.pi / 2.0):
        state = start_filter(model, np.array([0.0, 0.0, heading]), 1e-4 * np.eye(3))
        turned = state.mean + np.array([0.0, 0.0, math.pi / 2.0])
        z = turned[[0, 1, 2, 2]] + loud_x
        period = one_epoch(np.array([0.0, math.pi / 2.0]), z, available)
        after, _ = step(model, state, period)
        changes.append(after.process_noise[0] - model.process_noise[0])
    # Ends along y: y was quiet, so the noise falls; ends along x: it rises.
    assert changes[0] < 0.0 < changes[1]


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


@pytest.mark.parametrize("before", MODES)
@pytest.mark.parametrize("after", MODES)
@pytest.mark.slow
def test_a_change_of_mode_keeps_the_pose_and_the_noise_without_an_alarms_share(
    make_model: Callable[..., FilterModel],
    make_adaptation: Callable[..., Adaptation],
    before: str,
    after: str,
) -> None:
    old, new = (
        make_model(adaptation=make_adaptation(mode=mode, window_length=6))
        for mode in (before, after)
    )
    state = start_filter(old, START, START_COVARIANCE)
    periods = random_periods(np.random.default_rng(61), 25)
    for period in periods[:20]:
        state, _ = step(old, state, period)
    if state.joint is not None:  # slip leads: the noise in use is not the calm one
        state = state._replace(joint=state.joint._replace(lead=np.array([0.0, 12.0])))
    changed = for_mode(new, state)
    for name in ("mean", "covariance", "window", "gate", "pace"):
        assert bytes_of([getattr(changed, name)]) == bytes_of([getattr(state, name)])
    if (before == "joint") == (after == "joint"):
        assert changed is state
    elif before == "joint":
        assert state.joint is not None
        Q, R = noise_without_alarms(state.joint, old.adaptation.bounds)
        np.testing.assert_array_equal(changed.process_noise, Q)
        np.testing.assert_array_equal(changed.measurement_noise, R)
    else:
        assert changed.joint is not None
        np.testing.assert_array_equal(changed.process_noise, state.process_noise)
        np.testing.assert_array_equal(changed.measurement_noise, state.measurement_noise)
        np.testing.assert_array_equal(changed.joint.process_noise, state.process_noise)
        np.testing.assert_array_equal(changed.joint.measurement_noise, state.measurement_noise)
        np.testing.assert_array_equal(changed.joint.log_scale, 0.0)
    assert changed.bank.mean.shape == (3, new.layout.steady.stop)
    for period in periods[20:]:
        changed, _ = step(new, changed, period)
    assert (changed.joint is not None) == (after == "joint")
