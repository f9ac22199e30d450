# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Which readings are scored, and which of them are steps of the forecasts."""

import itertools
import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import pytest
from drives import Drive, drive, fused, start_of, steps_of, times
from periods import FIX, FIX_AND_COMPASS, NO_ROWS, ONLY_COMPASS, bytes_of

from fnn_ekf_ros.core.arrays import Row
from fnn_ekf_ros.core.filter import fuse
from fnn_ekf_ros.core.joint_filters import NEWER_COUNT
from fnn_ekf_ros.core.pace import (
    COMPASS_INTERVAL,
    NO_FIXES,
    NOMINAL_PERIOD_S,
    after_readings,
    is_step,
    later,
    scored_rows,
    start_pace,
)
from fnn_ekf_ros.core.results import Epoch
from fnn_ekf_ros.core.rows import rows_where
from fnn_ekf_ros.core.state import JOINT, FilterModel, start_filter


class Scored(NamedTuple):
    """Times at which readings were scored [s]."""

    fixes: list[float]
    compass: list[float]
    steps: list[float]


def scored_of(fixes: list[float], compass: list[float]) -> Scored:
    """Return which readings at these times are scored."""
    pace, now, found = start_pace(()), 0.0, Scored([], [], [])
    for t in sorted({*fixes, *compass}):
        pace, now = later(pace, (t - now) / NOMINAL_PERIOD_S), t
        is_fix = t in fixes
        rows = rows_where(np.array([is_fix, is_fix, t in compass, False]))
        scored = scored_rows(pace, rows)
        steps = is_step(pace, scored)
        assert not np.any(scored.each & ~rows.each)
        assert scored.each[Row.X] == scored.each[Row.Y] == is_fix
        found.fixes.extend([t] if is_fix else [])
        found.compass.extend([t] if scored.each[Row.COMPASS_YAW] else [])
        found.steps.extend([t] if steps else [])
        pace = after_readings(pace, rows, scored, steps)
    return found


@pytest.mark.parametrize("fix_s", [0.1, 0.15, 0.2, 0.375, 0.4, 1.0])
@pytest.mark.parametrize("offset_s", [0.0, 0.007])
def test_every_fix_is_scored_and_is_a_step(fix_s: float, offset_s: float) -> None:
    fixes = times(fix_s, fix_s + offset_s)
    found = scored_of(fixes, times(0.02, 0.02))
    assert found.fixes == fixes
    assert [t for t in found.steps if t in set(fixes)] == steps_of(fixes)


@pytest.mark.parametrize("fix_s", [0.1, 0.15, 0.2, 0.25, 0.375])
@pytest.mark.parametrize("offset_s", [0.0, 0.007])
@pytest.mark.slow
def test_a_fast_compass_is_scored_once_after_each_fix(fix_s: float, offset_s: float) -> None:
    """With the fix, or next after it, which is no step of its own."""
    fixes = times(fix_s, fix_s + offset_s)
    found = scored_of(fixes, times(0.02, 0.02))
    before = [t for t in found.compass if t < fixes[0]]
    assert len(before) <= 1 + fix_s / (COMPASS_INTERVAL * NOMINAL_PERIOD_S)
    first_after = [next(t for t in times(0.02, 0.02, 13.0) if t >= fix) for fix in fixes]
    assert [t for t in found.compass if t >= fixes[0]] == [t for t in first_after if t < 12.0]
    assert [t for t in found.steps if t >= fixes[0]] == steps_of(fixes)


@pytest.mark.parametrize("compass_s", [0.02, 0.1, 0.3, 0.375, 1.0])
def test_without_fixes_a_compass_is_scored_a_few_times_a_second(compass_s: float) -> None:
    """The first one, and then the next after three quarters of a nominal period; all are steps."""
    found = scored_of([], times(compass_s, compass_s))
    least = COMPASS_INTERVAL * NOMINAL_PERIOD_S
    interval = compass_s * math.ceil(least / compass_s - 1e-9)
    np.testing.assert_allclose(np.diff(found.compass), interval, atol=1e-9)
    assert found.compass[0] == compass_s
    assert found.steps == found.compass


@pytest.mark.parametrize("fix_s", [0.4, 0.6, 1.0])
@pytest.mark.parametrize("offset_s", [0.0, 0.007])
def test_between_slow_fixes_a_compass_is_scored_by_time_once_none_came_for_a_nominal_period(
    fix_s: float, offset_s: float
) -> None:
    """The first reading from each fix on, then those due by time; the latter are steps."""
    fixes, compass = times(fix_s, fix_s + offset_s), times(0.02, 0.02)
    found = scored_of(fixes, compass)
    by_time_count = 0
    for fix, next_fix in itertools.pairwise(fixes):
        after_fix, *by_time = [t for t in found.compass if fix <= t < next_fix]
        assert after_fix == next(t for t in compass if t >= fix)
        last = after_fix
        for t in by_time:
            due = max(fix + NO_FIXES * NOMINAL_PERIOD_S, last + COMPASS_INTERVAL * NOMINAL_PERIOD_S)
            assert t == next(t for t in compass if t >= due - 1e-9)
            assert t in found.steps
            last, by_time_count = t, by_time_count + 1
    expected = round((fix_s - NO_FIXES * NOMINAL_PERIOD_S) / (0.02 * 15) + 0.5)
    assert by_time_count == expected * (len(fixes) - 1)


def test_sensors_once_a_period_are_scored_whatever_their_order_and_jitter() -> None:
    """And each pair of a fix and a compass reading is one step."""
    rng = np.random.default_rng(116)
    for offset_s in (0.0, 0.05, 0.19, 0.3):
        fixes = [
            round(t + float(rng.uniform(0.0, 0.04)), 6)
            for t in times(NOMINAL_PERIOD_S, 0.375 + offset_s)
        ]
        compass = times(NOMINAL_PERIOD_S, 0.375)
        found = scored_of(fixes, compass)
        assert found.fixes == fixes
        assert found.compass == compass
        assert abs(len(found.steps) - len(fixes)) <= 1


def test_robots_of_a_batch_are_scored_each_by_its_own_readings() -> None:
    rng = np.random.default_rng(117)
    together, alone = start_pace((3,)), [start_pace(()) for _ in range(3)]
    for _ in range(200):
        elapsed = float(rng.exponential(0.2))
        available = rng.random((4, 3)) < np.array([0.3, 0.3, 0.7, 0.1])[:, None]
        together, rows = later(together, elapsed), rows_where(available)
        scored = scored_rows(together, rows)
        steps = is_step(together, scored)
        for i in range(3):
            alone[i] = later(alone[i], elapsed)
            own = rows_where(available[:, i])
            mine = scored_rows(alone[i], own)
            np.testing.assert_array_equal(scored.each[:, i], mine.each)
            step_alone = is_step(alone[i], mine)
            assert steps[i] == step_alone
            alone[i] = after_readings(alone[i], own, mine, step_alone)
        together = after_readings(together, rows, scored, steps)
        for i in range(3):
            assert bytes_of([part[..., i] for part in together]) == bytes_of(alone[i])


def lessons(model: FilterModel, plan: Drive) -> tuple[int, int, int]:
    """Return how many compass readings and fixes teach mode joint, and steps of its forecasts."""
    states, shown = fused(model, plan.epochs, start_of(model, 1))
    compass = fixes = steps = 0
    for epoch, state, seen in zip(plan.epochs, states, shown, strict=True):
        newer = state.bank.filters(model.layout.newer_forecasts).mean
        steps += int(np.array_equal(newer, state.bank.filters(JOINT).mean[:, :NEWER_COUNT]))
        if seen is None or seen.learned is None:
            continue
        fixes += int(epoch.available[Row.X, 0])
        compass += int(epoch.available[Row.COMPASS_YAW, 0])
    return compass, fixes, steps


@pytest.mark.parametrize("fix_s", [0.375, 0.1])
@pytest.mark.slow
def test_a_fast_compass_teaches_as_often_as_one_as_slow_as_the_fixes(
    model_of: Callable[..., FilterModel], fix_s: float
) -> None:
    """And the forecasts step with the fixes, though not with each that comes fast."""
    model = model_of("joint", suspects=False)
    seconds = 40 * fix_s
    slow = lessons(model, drive(118, 1, seconds, fix_s, fix_s, late_s=0.007))
    fast = lessons(model, drive(119, 1, seconds, fix_s, 0.02, late_s=0.007))
    assert slow[1] == fast[1] == 39
    assert abs(slow[0] - fast[0]) <= 2, (slow, fast)
    steps = len(steps_of(times(fix_s, fix_s, seconds)))
    assert abs(slow[2] - steps) <= 2
    assert abs(fast[2] - steps) <= 2


def test_motion_is_summed_up_until_the_next_scored_reading(
    model_of: Callable[..., FilterModel],
) -> None:
    """Compass readings between fixes are not scored: standstill is judged over all the time."""
    model = model_of("joint", suspects=False)
    state = start_filter(model, np.zeros(3), np.diag([0.01, 0.01, 0.018]))
    control = np.array([0.02, 0.01])
    rows = [FIX_AND_COMPASS, ONLY_COMPASS, NO_ROWS, ONLY_COMPASS, FIX, NO_ROWS, ONLY_COMPASS]
    for available, steps in zip(rows, [0, 1, 2, 3, 0, 1, 0], strict=True):
        state, _ = fuse(model, state, Epoch(control, 0.05, np.zeros(4), available))
        assert state.joint is not None
        np.testing.assert_allclose(state.joint.control_since_scored, steps * control, rtol=1e-12)
