"""A period of several instants: every reading at its own time, at whatever rate it comes."""

import dataclasses
import itertools
import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
import pytest

from fnn_ekf_ros.core.adaptation import Adaptation
from fnn_ekf_ros.core.arrays import BoolArray, FloatArray, Row
from fnn_ekf_ros.core.bank import FIX_ROWS
from fnn_ekf_ros.core.filter import (
    NOMINAL_PERIOD_S,
    Epoch,
    FilterModel,
    FilterState,
    Shown,
    fuse,
    step,
)
from fnn_ekf_ros.core.gate import (
    COMPASS,
    LRF_POSE,
    SPREAD_GROWTH,
    SPREAD_MEMORY,
    gate_for,
    rows_by_sensor,
)
from fnn_ekf_ros.core.joint import (
    ALARM_MEMORY,
    LONGEST_MEMORY,
    MEMORY_GROWTH,
    PRIOR_INFORMATION,
    SHORTEST_MEMORY,
    JointState,
    Lesson,
    fading,
    learn,
    start_joint,
)
from fnn_ekf_ros.core.joint_filters import JOINT_COUNT, NEWER_COUNT
from fnn_ekf_ros.core.motion import MotionModel, displacement
from fnn_ekf_ros.core.pace import (
    COMPASS_INTERVAL,
    NO_FIXES,
    STEP_INTERVAL,
    after_readings,
    is_step,
    later,
    scored_rows,
    start_pace,
)
from fnn_ekf_ros.core.state import JOINT, reset_pose, start_filter, with_noise

MakeModel = Callable[..., FilterModel]
MakeAdaptation = Callable[..., Adaptation]
MODES = ("none", "r", "q", "rq", "joint")
START = np.array([1.0, 2.0, 0.5])
START_COVARIANCE = np.array([[0.04, 0.01, 0.0], [0.01, 0.05, 0.002], [0.0, 0.002, 0.01]])
NO_ROWS = np.zeros(4, dtype=np.bool_)
FIX_AND_COMPASS = np.array([True, True, True, False])
FIX = np.array([True, True, False, False])
ONLY_COMPASS = np.array([False, False, True, False])
GATE = gate_for(1e-6, 1e-6)
TRUE_Q, TRUE_R = np.array([4e-4, 3.046e-4]), np.array([0.01, 0.01, 0.018, 0.018])


@pytest.fixture(scope="module")
def make(make_model: MakeModel, make_adaptation: MakeAdaptation) -> Callable[..., FilterModel]:
    """Filters with a gate and with suspects."""

    def of_mode(mode: str, *, gated: bool = True, suspects: bool = True) -> FilterModel:
        model = make_model(adaptation=make_adaptation(mode=mode, window_length=6))
        if gated:
            model = dataclasses.replace(model, gate=GATE)
        return dataclasses.replace(model, suspects=suspects)

    return of_mode


def arrays_of(*values: Sequence[Any]) -> list[np.ndarray[Any, Any]]:
    found: list[np.ndarray[Any, Any]] = []
    for value in values:
        for part in value:
            if isinstance(part, tuple):
                found += arrays_of(part)
            elif isinstance(part, np.ndarray | np.generic):
                found.append(np.asarray(part))
    return found


def bytes_of(*values: Sequence[Any]) -> list[bytes]:
    return [array.tobytes() for array in arrays_of(*values)]


def wild_epochs(
    rng: np.random.Generator, count: int, batch: tuple[int, ...] = (), most_s: float = 0.3
) -> list[Epoch]:
    """Epochs of a robot near START with any rows, outliers that agree, instants that coincide."""
    few, epochs = (-1, *(1,) * len(batch)), []
    for _ in range(count):
        duration_s = float(rng.choice([0.0, rng.uniform(0.0, most_s)]))
        low, high = (duration_s * np.reshape(limit, few) for limit in ([-0.2, 0.1], [0.5, 0.8]))
        z = rng.normal(np.reshape([1.0, 2.0, 0.5, 0.5], few), 0.3, (4, *batch))
        z[:2] += np.where(rng.random(batch) < 0.3, 20.0, 0.0)
        root = 0.1 * rng.standard_normal((3, 3, *batch))
        reported = np.einsum("ik...,jk...->ij...", root, root)
        reported += 0.01 * np.eye(3).reshape(3, 3, *(1,) * len(batch))
        epochs.append(
            Epoch(
                rng.uniform(low, high, (2, *batch)),
                duration_s,
                z,
                rng.random((4, *batch)) < rng.choice([0.0, 0.5, 1.0]),
                reported if rng.random() < 0.3 else None,
            )
        )
    return epochs


# The textbook.


@pytest.mark.parametrize("motion_model", list(MotionModel))
def test_several_readings_a_period_equal_the_textbook_filter(
    make_model: MakeModel, textbook_step: Any, motion_model: MotionModel
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


def test_the_order_of_readings_of_one_instant_does_not_matter(make_model: MakeModel) -> None:
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
def test_a_period_is_its_instants_fused_one_after_the_other(
    make: Callable[..., FilterModel], mode: str
) -> None:
    model, rng = make(mode), np.random.default_rng(111)
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


# A period that is cut.


def cut(rng: np.random.Generator, epoch: Epoch, parts: int) -> list[Epoch]:
    """Return an epoch without readings cut at arbitrary instants."""
    shares = rng.dirichlet(np.ones(parts))
    return [
        epoch._replace(control=share * epoch.control, duration_s=float(share) * epoch.duration_s)
        for share in shares
    ]


@pytest.mark.parametrize("parts", [2, 3, 10])
def test_cutting_a_period_without_readings_changes_neither_pose_nor_clocks(
    make: Callable[..., FilterModel], parts: int
) -> None:
    """Alarms fade, a candidate ages, and sensors are silent as long as without the cuts."""
    model, rng = make("joint"), np.random.default_rng(112)
    state = start_filter(model, START, START_COVARIANCE)
    for epoch in wild_epochs(rng, 60):
        state, _ = fuse(model, state, epoch)
    far = state.mean[[0, 1, 2, 2]] + np.array([500.0, 0.0, 0.0, 0.0])
    state, _ = fuse(model, state, Epoch(np.array([0.1, 0.1]), 0.2, far, FIX))
    assert state.candidate.active
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
    np.testing.assert_allclose(split.candidate.age_s, state.candidate.age_s + 0.9, rtol=1e-13)
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
def test_sideways_variance_of_a_straight_way_in_parts(make_model: MakeModel, parts: int) -> None:
    """q way^2 (1/3 - 1/(12 n^2)) for n equal parts: from 1/4 to the integral's 1/3."""
    model, way = make_model(), 0.4
    epoch = Epoch(
        np.array([way / parts, 0.0]), 0.375 / parts, np.full(4, np.nan), NO_ROWS
    )  # fmt: skip
    state, _ = step(model, start_filter(model, np.zeros(3), np.zeros((3, 3))), [epoch] * parts)
    forward, turn = model.process_noise
    sideways = turn * way**2 * (1.0 / 3.0 - 1.0 / (12.0 * parts**2))
    lean = 0.5 * turn * way
    expected = [[forward, 0.0, 0.0], [0.0, sideways, lean], [0.0, lean, turn]]
    np.testing.assert_allclose(state.covariance, expected, rtol=1e-12, atol=1e-18)


# Learning disabled, immutability, batches.


def test_joint_with_learning_disabled_from_the_start_is_the_plain_filter_bit_for_bit(
    make: Callable[..., FilterModel],
) -> None:
    """With gate, candidate and suspects, and several readings a period."""
    plain, joint = make("none"), make("joint")
    held = dataclasses.replace(
        joint, adaptation=dataclasses.replace(joint.adaptation, learning=False)
    )
    rng, rejected = np.random.default_rng(113), 0
    a, b = (start_filter(model, START, START_COVARIANCE) for model in (plain, held))
    for _ in range(80):
        period = wild_epochs(rng, int(rng.integers(1, 5)))
        (a, one), (b, other) = step(plain, a, period), step(held, b, period)
        for name in ("mean", "covariance", "process_noise", "measurement_noise", "lead"):
            assert getattr(a, name).tobytes() == getattr(b, name).tobytes()
        assert bytes_of(a.gate, a.candidate, a.pace) == bytes_of(b.gate, b.candidate, b.pace)
        suspects = [
            bytes_of(state.bank.filters(model.layout.suspects))
            for model, state in ((plain, a), (held, b))
        ]
        assert suspects[0] == suspects[1]
        for name in ("innovation", "innovation_variance", "nis", "sensor_nis", "rejected"):
            assert getattr(one, name).tobytes() == getattr(other, name).tobytes()
        rejected += int(one.rejected.sum())
    assert rejected > 5
    assert a.lead.any()


@pytest.mark.parametrize("mode", MODES)
def test_suspects_change_no_bit_of_the_published_filter_and_of_what_is_learned(
    make: Callable[..., FilterModel], mode: str
) -> None:
    """With gate and candidates, and several readings a period."""
    models = make(mode, suspects=True), make(mode, suspects=False)
    rng = np.random.default_rng(127)
    a, b = (start_filter(model, START, START_COVARIANCE) for model in models)
    rejected = candidates = led = 0
    for _ in range(60):
        period = wild_epochs(rng, int(rng.integers(1, 5)))
        (a, one), (b, other) = (
            step(model, state, period) for model, state in zip(models, (a, b), strict=True)
        )
        for name in ("mean", "covariance", "process_noise", "measurement_noise"):
            assert getattr(a, name).tobytes() == getattr(b, name).tobytes()
        assert bytes_of(a.window, a.gate, a.candidate, a.pace) == bytes_of(
            b.window, b.gate, b.candidate, b.pace
        )
        assert bytes_of(a.joint or ()) == bytes_of(b.joint or ())
        assert bytes_of(*one.shown) == bytes_of(*other.shown)
        rejected += int(one.rejected.sum())
        candidates += int(a.candidate.active)
        led += bool(a.lead.any())
        assert not b.lead.any()
    assert rejected > 5
    assert candidates > 2
    assert led > 5


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("batch", [(), (3,)], ids=["one robot", "batch"])
def test_nothing_that_is_given_is_changed_and_all_repeats_itself(
    make: Callable[..., FilterModel], mode: str, batch: tuple[int, ...]
) -> None:
    model, rng = make(mode), np.random.default_rng(114)
    mean = np.broadcast_to(START.reshape(3, *(1,) * len(batch)), (3, *batch))
    state = start_filter(model, mean, START_COVARIANCE)
    rejected = candidates = 0
    for _ in range(25):
        period = wild_epochs(rng, 2, batch)
        for array in arrays_of(state, *period):
            array.flags.writeable = False
        before = bytes_of(state, *period)
        first, second = step(model, state, period), step(model, state, period)
        assert bytes_of(*first) == bytes_of(*second)
        one, other = fuse(model, state, period[0]), fuse(model, state, period[0])
        assert bytes_of(one) == bytes_of(other)
        assert bytes_of(state, *period) == before
        state = first[0]
        rejected += bool(np.any(first[1].rejected))
        candidates += bool(np.any(state.candidate.active))
    assert rejected > 2
    assert candidates > 2


COMPARED = ("nis", "sensor_nis", "rejected", "relocated", "innovation")


def robot(value: Any, index: int) -> Any:
    """Return a tuple of arrays for one robot of a batch."""
    parts = [
        robot(part, index) if isinstance(part, tuple) else
        part[..., index] if isinstance(part, np.ndarray) else part
        for part in value
    ]  # fmt: skip
    return type(value)(*parts)


@pytest.mark.parametrize("mode", ["none", "rq", "joint"])
def test_robots_of_a_batch_are_what_they_are_alone(
    make: Callable[..., FilterModel], mode: str
) -> None:
    """With outliers, candidates, relocations and suspects, each its own."""
    model, rng, runs = make(mode), np.random.default_rng(115), 3
    together = start_filter(model, np.repeat(START[:, None], runs, axis=1), START_COVARIANCE)
    alone = [start_filter(model, START, START_COVARIANCE) for _ in range(runs)]
    relocated = np.zeros(runs)
    for t in range(40):
        period = wild_epochs(rng, 3, (runs,))
        if t >= 15:  # one of them is elsewhere
            for epoch in period:
                epoch.measurement[:2, 1] = np.array([40.0, 5.0]) + rng.normal(0.0, 0.1, 2)
                epoch.available[:2, 1] = True
        together, result = step(model, together, period)
        relocated += result.relocated
        for i in range(runs):
            alone[i], single = step(model, alone[i], [robot(epoch, i) for epoch in period])
            got, steady = robot(together, i), model.layout.steady
            pairs = [(got._replace(bank=(), noise=()), alone[i]._replace(bank=(), noise=()))]
            pairs += [(got.bank.filters(steady), alone[i].bank.filters(steady))]
            pairs += [(got.noise.filters(steady), alone[i].noise.filters(steady))]
            if alone[i].candidate.active:
                pairs += [
                    (part.filters(slice(-1, None)), other.filters(slice(-1, None)))
                    for part, other in zip(
                        (got.bank, got.noise), (alone[i].bank, alone[i].noise), strict=True
                    )
                ]
            else:
                inactive = alone[i].candidate._replace(active=alone[i].candidate.active)
                pairs[0] = (
                    pairs[0][0]._replace(candidate=inactive),
                    pairs[0][1]._replace(candidate=inactive),
                )
                assert not got.candidate.active
            for a, b in pairs:
                for one, other in zip(arrays_of(a), arrays_of(b), strict=True):
                    np.testing.assert_allclose(one, other, rtol=1e-8, atol=1e-11)
            for name in (*COMPARED, "firing_strength"):
                one, other = (
                    getattr(robot(result._replace(shown=()), i), name),
                    getattr(single, name),
                )
                np.testing.assert_allclose(one, other, rtol=1e-8, atol=1e-11)
    assert relocated[1] > 0.0 or mode != "none"  # where R is learned the gate opens meanwhile


def test_the_only_robot_of_a_batch_with_a_candidate_is_relocated_and_goes_on(
    make: Callable[..., FilterModel],
) -> None:
    model = make("joint", suspects=False)
    state = start_filter(model, np.zeros((3, 2)), START_COVARIANCE)
    rows = np.repeat(FIX[:, None], 2, axis=1)
    relocated = np.zeros(2)
    for t in range(25):
        z = np.zeros((4, 2))
        z[0, 1] = 20.0 * (t >= 5)
        state, result = step(model, state, [Epoch(np.zeros((2, 2)), 0.375, z, rows)])
        relocated += result.relocated
    np.testing.assert_array_equal(relocated, [0.0, 1.0])
    np.testing.assert_allclose(state.mean[0], [0.0, 20.0], atol=0.1)
    assert state.bank.mean.shape[1] == state.noise.process.shape[1] == model.layout.steady.stop


# Which readings are scored.


class Scored(NamedTuple):
    """Times at which readings were scored [s]."""

    fixes: list[float]
    compass: list[float]
    steps: list[float]


def times(interval_s: float, first_s: float, end_s: float = 12.0) -> list[float]:
    return [round(t, 6) for t in np.arange(first_s, end_s, interval_s).tolist()]


def scored_of(fixes: list[float], compass: list[float]) -> Scored:
    """Return which readings at these times are scored."""
    pace, now, found = start_pace(()), 0.0, Scored([], [], [])
    for t in sorted({*fixes, *compass}):
        pace, now = later(pace, (t - now) / NOMINAL_PERIOD_S), t
        is_fix = t in fixes
        available = np.array([is_fix, is_fix, t in compass, False])
        rows = rows_by_sensor(available)
        scored = scored_rows(pace, available, rows)
        assert not np.any(scored & ~available)
        assert scored[Row.X] == scored[Row.Y] == is_fix
        found.fixes.extend([t] if is_fix else [])
        found.compass.extend([t] if scored[Row.COMPASS_YAW] else [])
        found.steps.extend([t] if is_step(pace, scored) else [])
        pace = after_readings(pace, rows, scored)
    return found


def steps_of(fixes: list[float]) -> list[float]:
    """Return the fixes that are steps: the first, and then none sooner than `STEP_INTERVAL`."""
    found: list[float] = []
    for fix in fixes:
        if not found or fix - found[-1] >= STEP_INTERVAL * NOMINAL_PERIOD_S:
            found.append(fix)
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
        together, rows = later(together, elapsed), rows_by_sensor(available)
        scored = scored_rows(together, available, rows)
        steps = is_step(together, scored)
        for i in range(3):
            alone[i] = later(alone[i], elapsed)
            mine = scored_rows(alone[i], available[:, i], rows[:, i])
            np.testing.assert_array_equal(scored[:, i], mine)
            assert steps[i] == is_step(alone[i], mine)
            alone[i] = after_readings(alone[i], rows[:, i], mine)
        together = after_readings(together, rows, scored)
        for i in range(3):
            assert bytes_of([part[..., i] for part in together]) == bytes_of(alone[i])


# Sensors at their own rates, simulated.


class Drive(NamedTuple):
    """A batch of robots; epochs in time's order, with the truth `(3, runs)` at the end of each."""

    epochs: list[Epoch]
    truth: list[FloatArray]


def drive(
    seed: int,
    runs: int,
    seconds: float,
    fix_s: float | None,
    compass_s: float,
    late_s: float = 0.0,
    start: FloatArray | None = None,
) -> Drive:
    """Return robots on a bent path from `(3, runs)`; each fix is `late_s` later than in step."""
    rng = np.random.default_rng(seed)
    fixes = [] if fix_s is None else times(fix_s, fix_s + late_s, seconds + 1e-9)
    compass = times(compass_s, compass_s, seconds + 1e-9)
    truth, now, found = np.zeros((3, runs)) if start is None else start, 0.0, Drive([], [])
    for t in sorted({*fixes, *compass}):
        duration_s, now = t - now, t
        size = duration_s / NOMINAL_PERIOD_S
        turn = 0.03 + 0.05 * math.sin(0.05 * t / NOMINAL_PERIOD_S)
        control = size * np.repeat([[0.11], [turn]], runs, axis=1)
        driven = control + np.sqrt(size * TRUE_Q)[:, None] * rng.standard_normal((2, runs))
        truth = truth + displacement(MotionModel.EXACT_ARC, truth[2], driven)
        z = truth[[0, 1, 2, 2]] + np.sqrt(TRUE_R)[:, None] * rng.standard_normal((4, runs))
        rows = np.array([t in fixes, t in fixes, t in compass, False])
        found.epochs.append(Epoch(control, duration_s, z, np.repeat(rows[:, None], runs, axis=1)))
        found.truth.append(truth)
    return found


def fused(
    model: FilterModel, epochs: list[Epoch], state: FilterState
) -> tuple[list[FilterState], list[Shown | None]]:
    states, shown = [], []
    for epoch in epochs:
        state, seen = fuse(model, state, epoch)
        states.append(state)
        shown.append(seen)
    return states, shown


def start_of(model: FilterModel, runs: int, **noise: FloatArray) -> FilterState:
    return start_filter(model, np.zeros((3, runs)), np.diag([0.01, 0.01, 0.018]), **noise)


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
def test_a_fast_compass_teaches_as_often_as_one_as_slow_as_the_fixes(
    make: Callable[..., FilterModel], fix_s: float
) -> None:
    """And the forecasts step with the fixes, though not with each that comes fast."""
    model = make("joint", suspects=False)
    seconds = 40 * fix_s
    slow = lessons(model, drive(118, 1, seconds, fix_s, fix_s, late_s=0.007))
    fast = lessons(model, drive(119, 1, seconds, fix_s, 0.02, late_s=0.007))
    assert slow[1] == fast[1] == 39
    assert abs(slow[0] - fast[0]) <= 2, (slow, fast)
    steps = len(steps_of(times(fix_s, fix_s, seconds)))
    assert abs(slow[2] - steps) <= 2
    assert abs(fast[2] - steps) <= 2


def test_motion_is_summed_up_until_the_next_scored_reading(
    make: Callable[..., FilterModel],
) -> None:
    """Compass readings between fixes are not scored: standstill is judged over all the time."""
    model = make("joint", suspects=False)
    state = start_filter(model, np.zeros(3), np.diag([0.01, 0.01, 0.018]))
    control = np.array([0.02, 0.01])
    rows = [FIX_AND_COMPASS, ONLY_COMPASS, NO_ROWS, ONLY_COMPASS, FIX, NO_ROWS, ONLY_COMPASS]
    for available, steps in zip(rows, [0, 1, 2, 3, 0, 1, 0], strict=True):
        state, _ = fuse(model, state, Epoch(control, 0.05, np.zeros(4), available))
        assert state.joint is not None
        np.testing.assert_allclose(state.joint.way, steps * control, rtol=1e-12)


# The gate.


@pytest.mark.parametrize("sensor", [COMPASS, LRF_POSE])
@pytest.mark.parametrize("interval_s", [0.02, 0.05, 0.1875, 0.375, 0.75])
def test_spread_grows_and_decays_by_time_with_fast_sensors_and_by_readings_with_slow_ones(
    make: Callable[..., FilterModel], sensor: int, interval_s: float
) -> None:
    model, rng = make("none"), np.random.default_rng(120)
    state = start_filter(model, np.zeros(3), np.diag([0.01, 0.01, 0.018]))
    rows = ONLY_COMPASS if sensor == COMPASS else FIX
    part = min(interval_s / NOMINAL_PERIOD_S, 1.0)
    if sensor == COMPASS:  # no yaw is far off: a compass that is known to be as good as this
        certain = np.array([0.01, 0.01, 1e-6, 1e-6])
        state = start_filter(model, np.zeros(3), np.diag([0.01, 0.01, 1e-6]), None, certain)
        tiny = np.full(2, 1e-10)
        state = with_noise(model, state, tiny, certain)
    spread, count = [], round(1.5 / (part * NOMINAL_PERIOD_S))
    for i in range(count + 1):
        size = 1e4 if sensor == LRF_POSE else 1.0
        z = np.array([*(size * rng.standard_normal(2)), 0.9 + (i % 3), 0.0])
        state, result = step(model, state, [Epoch(np.zeros(2), interval_s, z, rows)])
        assert result.rejected[sensor]
        spread.append(float(state.gate.spread[sensor]))
    grown = SPREAD_GROWTH ** (part * np.arange(count + 1))
    np.testing.assert_allclose(np.array(spread) / spread[0], grown, rtol=1e-12)
    assert spread[0] == pytest.approx(SPREAD_GROWTH, rel=1e-12)  # the first one counts in full
    other = LRF_POSE if sensor == COMPASS else COMPASS
    assert state.gate.spread[other] == 1.0
    # Right ones without an innovation: the spread falls towards 1.
    before, found = spread[-1], []
    for _ in range(count):
        z = state.mean[[0, 1, 2, 2]]
        state, result = step(model, state, [Epoch(np.zeros(2), interval_s, z, rows)])
        assert not result.rejected.any()
        found.append(float(state.gate.spread[sensor]))
    left = before * SPREAD_MEMORY ** (part * np.arange(1, count + 1))
    np.testing.assert_allclose(found, np.maximum(left, 1.0), rtol=1e-9)
    assert left[-1] > 1.0 or found[-1] == 1.0


OUT_OF_STEP = {
    "apart": [FIX, ONLY_COMPASS],
    "fast compass": [ONLY_COMPASS, ONLY_COMPASS, FIX_AND_COMPASS, ONLY_COMPASS],
    "both fast": [FIX_AND_COMPASS] * 3,
}


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("order", OUT_OF_STEP)
@pytest.mark.parametrize("wild", [FIX, ONLY_COMPASS], ids=["fix", "compass"])
def test_a_lone_wild_reading_does_what_a_missing_one_does_out_of_step_too(
    make: Callable[..., FilterModel], mode: str, order: str, wild: BoolArray
) -> None:
    """Bit for bit in the modes of the paper, and close to it in mode joint.

    There which compass readings are scored differs, and how fast what was learned fades.
    """
    model, rng, truth = make(mode, suspects=False), np.random.default_rng(126), np.zeros(3)
    rows_of_period = OUT_OF_STEP[order]
    periods, at = [], next(i for i, rows in enumerate(rows_of_period) if np.all(rows[wild]))
    part = 1.0 / len(rows_of_period)
    for t in range(45):
        periods.append([])
        for rows in rows_of_period:
            control = part * np.array([0.11, 0.1 * math.sin(0.05 * t)])
            driven = control + np.sqrt(part * TRUE_Q) * rng.standard_normal(2)
            truth = truth + displacement(MotionModel.EXACT_ARC, truth[2], driven)
            z = truth[[0, 1, 2, 2]] + np.sqrt(TRUE_R) * rng.standard_normal(4)
            periods[-1].append(Epoch(control, part * NOMINAL_PERIOD_S, z, rows))
    usual = periods[25][at]
    far = usual._replace(measurement=usual.measurement + wild * np.array([20.0, 0.0, 3.0, 0.0]))
    missing = usual._replace(available=usual.available & ~wild)
    ways: list[list[FilterState]] = []
    rejected: list[int] = []
    for epoch in (far, missing):
        periods[25][at] = epoch
        state, states, count = start_filter(model, np.zeros(3), START_COVARIANCE), [], 0
        for period in periods:
            state, result = step(model, state, period)
            states.append(state)
            count += int(result.rejected.sum())
        ways.append(states)
        rejected.append(count)
    assert rejected[0] == rejected[1] + 1  # R that was learned too small rejects others in both
    for one, other in zip(*ways, strict=True):
        for name in ("mean", "covariance", "process_noise", "measurement_noise"):
            a, b = getattr(one, name), getattr(other, name)
            if mode != "joint":
                assert a.tobytes() == b.tobytes()
            elif name.endswith("noise"):
                np.testing.assert_allclose(a, b, rtol=0.05)
            else:
                np.testing.assert_allclose(a, b, rtol=0.0, atol=2e-3)


# Memory of the joint learners.


def nothing_new(scored: BoolArray, teaches: BoolArray, since_scored: float) -> Lesson:
    """Return readings of which all filters are equally right: they inform of nothing."""
    rows = teaches.sum(axis=0).astype(np.float64)
    none = np.zeros((4, JOINT_COUNT))
    since = np.asarray(since_scored)
    return Lesson(none, none + 1.0, none[0], teaches, rows, scored, since)


def after_lessons(
    model: FilterModel,
    state: JointState,
    plan: list[tuple[float, BoolArray]],
    teaches: BoolArray | None = None,
) -> JointState:
    """Return the state after such readings, each some nominal periods after the one before.

    Args:
        model: the filter.
        state: before them.
        plan: the time before each [nominal periods], and the rows that are scored.
        teaches: `(4,)` the rows that the gate lets teach; None for all.
    """
    sets, bounds = model.adaptation.networks.joint.sets, model.adaptation.bounds
    for elapsed, scored in plan:
        state = fading(state, elapsed * np.array([0.1, 0.1]), elapsed)
        lesson = nothing_new(scored, scored if teaches is None else scored & teaches, elapsed)
        state = learn(state, sets, bounds, lesson, learning=True).state
    return state


@pytest.fixture
def known(make: Callable[..., FilterModel]) -> tuple[FilterModel, JointState]:
    """A learner that knows much."""
    model = make("joint")
    start = start_joint(np.array(model.process_noise), np.array(model.measurement_noise))
    root = np.random.default_rng(121).standard_normal((4, 4, 2))
    much = np.einsum("ik...,jk...->ij...", root, root) + 5.0 * np.eye(4)[..., None]
    information = start.information + 10.0 * much
    return model, start._replace(information=information, forecast_count=np.array(2.0))


def left(before: JointState, after: JointState) -> FloatArray:
    """Return which part of what was learned is left, `(4, 4, 2)`."""
    prior = PRIOR_INFORMATION[..., None]
    part: FloatArray = (after.information - prior) / (before.information - prior)
    return part


def faded(counts: list[float]) -> tuple[FloatArray, FloatArray]:
    """Return which part of what was learned is left `(2,)`, and N `(2,)`.

    Args:
        counts: for how much of a reading each reading counts.
    """
    N, part = np.full(2, SHORTEST_MEMORY), np.ones(2)
    for count in counts:
        part = part * (1.0 - count / N)
        N = np.minimum(N + MEMORY_GROWTH * count, LONGEST_MEMORY)
    return part, N


def test_each_scale_fades_with_the_readings_that_inform_it(
    known: tuple[FilterModel, JointState],
) -> None:
    """A compass alone leaves what is known of the fixes' noise and of the way's as it is."""
    model, before = known
    for rows, informed in (
        (ONLY_COMPASS, [False, True, False, True]),
        (np.array([False, False, False, True]), [False, True, False, True]),
        (FIX, [True, True, True, False]),
        (FIX_AND_COMPASS, [True] * 4),
    ):
        part, N = faded([1.0] * 30)
        after = after_lessons(model, before, [(1.0, rows)] * 30)
        each = np.where(np.array(informed)[:, None], np.sqrt(part), 1.0)
        np.testing.assert_allclose(left(before, after), each[:, None] * each[None], rtol=1e-9)
        memory = np.where(np.array(informed)[:, None], N, SHORTEST_MEMORY)
        np.testing.assert_allclose(after.memory, memory, rtol=1e-12)


def test_rejected_readings_fade_a_scale_as_those_that_teach_do(
    known: tuple[FilterModel, JointState],
) -> None:
    """Memory is counted in the readings of a sensor, whatever the gate says about them."""
    model, before = known
    everything_teaches = after_lessons(model, before, [(1.0, FIX_AND_COMPASS)] * 30)
    compass_teaches = after_lessons(
        model, before, [(1.0, FIX_AND_COMPASS)] * 30, teaches=ONLY_COMPASS
    )
    assert bytes_of(compass_teaches) == bytes_of(everything_teaches)


@pytest.mark.parametrize("parts", [2, 5, 19])
def test_readings_that_come_fast_make_a_scale_fade_by_the_root_of_the_time(
    known: tuple[FilterModel, JointState], parts: int
) -> None:
    """One that follows the last one after a part p of a nominal period counts for sqrt(p) of one.

    So n readings in a nominal period count for sqrt(n) together; the first of all counts in full.
    """
    model, before = known
    readings = 20 * parts
    after = after_lessons(model, before, [(1.0 / parts, FIX_AND_COMPASS)] * readings)
    part, N = faded([1.0] + [math.sqrt(1.0 / parts)] * (readings - 1))
    np.testing.assert_allclose(left(before, after), np.broadcast_to(part, (4, 4, 2)), rtol=1e-8)
    np.testing.assert_allclose(after.memory, np.broadcast_to(N, (4, 2)), rtol=1e-12)
    by_time = SHORTEST_MEMORY + MEMORY_GROWTH * (1.0 + (readings - 1) / math.sqrt(parts))
    assert N[0] == pytest.approx(by_time, rel=1e-12)


@pytest.mark.parametrize("elapsed", [1.0, 1.5, 4.0])
def test_readings_that_come_slowly_count_for_one_each(
    known: tuple[FilterModel, JointState], elapsed: float
) -> None:
    model, before = known
    after = after_lessons(model, before, [(elapsed, FIX_AND_COMPASS)] * 20)
    part, N = faded([1.0] * 20)
    np.testing.assert_allclose(left(before, after), np.broadcast_to(part, (4, 4, 2)), rtol=1e-9)
    np.testing.assert_allclose(after.memory, np.broadcast_to(N, (4, 2)), rtol=1e-12)


def test_of_two_sensors_out_of_step_each_counts_for_the_root_of_a_half_of_the_heading(
    known: tuple[FilterModel, JointState],
) -> None:
    """Both inform the heading's scale; the other scales have one of them each, a period apart.

    So the heading fades by sqrt(2) readings in a nominal period, in step it fades by one.
    """
    model, before = known
    in_step = after_lessons(model, before, [(1.0, FIX_AND_COMPASS)] * 30)
    halves = [(0.5, FIX), (0.5, ONLY_COMPASS)]
    apart = after_lessons(model, before, halves * 30)
    own, heading = [0, 2, 3], 1
    np.testing.assert_allclose(apart.memory[own], in_step.memory[own], rtol=1e-12)
    ratio = left(before, apart) / left(before, in_step)
    np.testing.assert_allclose(ratio[own, own], 1.0, rtol=1e-9)
    part, N = faded([1.0] + [math.sqrt(0.5)] * 59)
    np.testing.assert_allclose(apart.memory[heading], N, rtol=1e-12)
    np.testing.assert_allclose(left(before, apart)[heading, heading], part, rtol=1e-8)
    assert np.all(ratio[heading, heading] < 1.0), ratio


def test_a_fast_compass_makes_nothing_of_the_fixes_be_forgotten(
    make: Callable[..., FilterModel],
) -> None:
    """Fixes stop; 20 s of compass readings later their scale is known as well as before."""
    model = make("joint", suspects=False)
    plan = drive(122, 1, 20.0, 0.375, 0.375)
    state = fused(model, plan.epochs, start_of(model, 1))[0][-1]
    blind = drive(123, 1, 20.0, None, 0.05, start=plan.truth[-1])
    after = fused(model, blind.epochs, state)[0][-1]
    assert state.joint is not None
    assert after.joint is not None
    for scale in (0, 2):
        known, now = state.joint.information[scale, scale], after.joint.information[scale, scale]
        assert np.all(now >= known - 1e-9), (known, now)
        np.testing.assert_array_equal(after.joint.memory[scale], state.joint.memory[scale])
    assert np.all(after.joint.memory[3, 0] > state.joint.memory[3, 0])


# Accuracy with fast sensors.

FAST = {"fix_s": 0.1, "compass_s": 0.04, "late_s": 0.007}


def squared_errors(states: list[FilterState], truth: list[FloatArray]) -> FloatArray:
    """Return `(T, 2, runs)` squared errors of position and yaw."""
    found = []
    for state, true in zip(states, truth, strict=True):
        error = state.mean - true
        error[2] = np.arctan2(np.sin(error[2]), np.cos(error[2]))
        found.append([error[0] ** 2 + error[1] ** 2, error[2] ** 2])
    return np.array(found)


def nees(state: FilterState, true: FloatArray) -> FloatArray:
    error = state.mean - true
    error[2] = np.arctan2(np.sin(error[2]), np.cos(error[2]))
    white = np.linalg.solve(np.moveaxis(state.covariance, -1, 0), error.T[..., None])[..., 0]
    return np.asarray(np.sum(error * white.T, axis=0))


def test_plain_filter_is_consistent_with_fast_sensors(make_model: MakeModel) -> None:
    """Mean NEES of 300 robots is 3, by four of its standard deviations at most."""
    model, runs = make_model(), 300
    plan = drive(124, runs, 12.0, **FAST)
    states, shown = fused(model, plan.epochs, start_of(model, runs))
    for at in (len(states) // 2, -1):
        assert abs(np.mean(nees(states[at], plan.truth[at])) - 3.0) < 4.0 * math.sqrt(6.0 / runs)
    nis = np.mean([seen.nis.sum() for seen in shown if seen is not None]) / runs
    rows = np.mean([seen.degrees_of_freedom.sum() for seen in shown if seen is not None]) / runs
    assert nis == pytest.approx(rows, rel=0.02)


def test_joint_with_fast_sensors_keeps_a_right_start_and_mends_a_wrong_one(
    make: Callable[..., FilterModel], make_model: MakeModel
) -> None:
    """Against the plain filter with the true noise; what is mended, in the last third."""
    runs, right, mended = 24, slice(0, 8), slice(8, None)
    joint, plain = make("joint", gated=False, suspects=False), make_model()
    plan = drive(125, runs, 30.0, **FAST)
    wrong = np.ones((2, runs))
    wrong[:, mended] = np.repeat([[25.0, 25.0, 0.04, 0.04], [25.0, 0.04, 25.0, 0.04]], 4, axis=1)
    noise = {
        "process_noise": TRUE_Q[:, None] * wrong[0],
        "measurement_noise": TRUE_R[:, None] * wrong[1],
    }
    starts = (
        (joint, start_of(joint, runs, **noise)),
        (plain, start_of(plain, runs)),
        (plain, start_of(plain, runs, **noise)),
    )
    of_joint, oracle, of_start = (
        squared_errors(fused(model, plan.epochs, start)[0], plan.truth) for model, start in starts
    )
    cost = of_joint[:, :, right].mean(axis=(0, 2)) / oracle[:, :, right].mean(axis=(0, 2))
    assert np.all(np.sqrt(cost) < 1.02), cost
    late = slice(2 * len(oracle) // 3, None)
    after = [each[late, :, mended].mean(axis=(0, 2)) for each in (of_joint, oracle, of_start)]
    assert np.all(np.sqrt(after[0] / after[1]) < 1.1), after
    assert np.sqrt(after[0][0] / after[2][0]) < 0.9, after


def test_headings_are_wrapped_wherever_a_pose_comes_from(make: Callable[..., FilterModel]) -> None:
    """A pose that is set may have any yaw, and a reading that starts a candidate, too."""
    model = make("none", suspects=True)
    turned = np.array([[0.0], [0.0], [7.0]])
    state = start_filter(model, turned, np.diag([0.01, 0.01, 0.02])[:, :, None])
    expected = 7.0 - 2.0 * np.pi
    np.testing.assert_allclose(state.bank.mean[2], expected, rtol=1e-12)
    state = reset_pose(model, state, -turned, state.covariance)
    np.testing.assert_allclose(state.bank.mean[2], -expected, rtol=1e-12)
