# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The gate: thresholds, what is rejected, what a rejected reading does not do."""

import dataclasses
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from drives import TRUE_Q, TRUE_R

from fnn_ekf_ros.core.adaptation import Adaptation
from fnn_ekf_ros.core.angles import wrap_angle
from fnn_ekf_ros.core.arrays import FloatArray
from fnn_ekf_ros.core.chi_square import exceeded_with, upper_tail
from fnn_ekf_ros.core.filter import step
from fnn_ekf_ros.core.gate import (
    OPEN_GATE,
    GateDecision,
    GateState,
    after_decision,
    gate_for,
    start_gate,
)
from fnn_ekf_ros.core.joint_filters import SETTLED
from fnn_ekf_ros.core.joint_state import JointState
from fnn_ekf_ros.core.motion import MotionModel, displacement
from fnn_ekf_ros.core.results import Epoch, StepResult
from fnn_ekf_ros.core.rows import COMPASS, LRF_POSE
from fnn_ekf_ros.core.state import FilterModel, FilterState, start_filter

MODES = ("none", "r", "q", "joint")
PAPER_MODES = ("none", "r", "q", "rq")
EVERYTHING = ("mean", "covariance", "process_noise", "measurement_noise")
GATE = gate_for(1e-6, 1e-6)
START_COVARIANCE = np.diag([0.01, 0.01, 0.018])
Make = Callable[..., Any]


def drive(
    seed: int,
    steps: int,
    noise_scale: float = 1.0,
    rows: tuple[int, ...] = (0, 1, 2),
    duration_s: float = 0.375,
) -> tuple[FloatArray, list[Epoch]]:
    """Truth `(steps + 1, 3)` of a robot on a wavy way, and what it brings each period."""
    rng = np.random.default_rng(seed)
    pose = np.array([0.0, 0.0, 0.0])
    truth, periods = [pose], []
    available = np.zeros(4, dtype=np.bool_)
    available[list(rows)] = True
    for t in range(steps):
        control = np.array([0.11, 0.1 * math.sin(0.05 * t)])
        true_control = control + np.sqrt(TRUE_Q) * rng.standard_normal(2)
        pose = pose + displacement(MotionModel.EXACT_ARC, pose[2], true_control)
        z = pose[[0, 1, 2, 2]] + noise_scale * np.sqrt(TRUE_R) * rng.standard_normal(4)
        truth.append(pose)
        periods.append(Epoch(control, duration_s, z, available.copy()))
    return np.array(truth), periods


def run(
    model: FilterModel, periods: list[Epoch], start: FilterState | None = None
) -> tuple[list[FilterState], list[StepResult]]:
    state = start_filter(model, np.zeros(3), START_COVARIANCE) if start is None else start
    states, results = [], []
    for period in periods:
        state, result = step(model, state, [period])
        states.append(state)
        results.append(result)
    return states, results


def moved(periods: list[Epoch], at: slice, by: FloatArray) -> list[Epoch]:
    """The periods with the measurements of some of them moved."""
    found = list(periods)
    for i in range(*at.indices(len(periods))):
        found[i] = periods[i]._replace(measurement=periods[i].measurement + by)
    return found


@pytest.fixture
def model(
    make_model: Make, make_adaptation: Callable[..., Adaptation]
) -> Callable[..., FilterModel]:
    def make(mode: str, gate: Any = GATE, **changes: Any) -> FilterModel:
        adaptation = make_adaptation(mode=mode, window_length=45)
        return dataclasses.replace(make_model(adaptation=adaptation, **changes), gate=gate)

    return make


@pytest.mark.parametrize("n", [1, 2, 3, 4, 7, 20, 40])
@pytest.mark.slow
def test_chi_square_tail_against_quadrature_of_its_density(n: int) -> None:
    x = np.linspace(0.0, 400.0, 2_000_001)[1:]
    log_density = (0.5 * n - 1.0) * np.log(x) - 0.5 * x - 0.5 * n * math.log(2) - math.lgamma(n / 2)
    for value in (0.5, 3.0, 12.0, 60.0):
        part = x >= value
        expected = np.sum(np.exp(log_density[part])) * (x[1] - x[0])
        assert upper_tail(value, n) == pytest.approx(expected, rel=1e-3)


@pytest.mark.parametrize("n", [1, 2, 3, 40])
@pytest.mark.parametrize("chance", [0.5, 1e-3, 1e-6, 1e-12])
def test_what_is_exceeded_with_a_chance_is_the_tails_inverse(n: int, chance: float) -> None:
    assert upper_tail(exceeded_with(chance, n), n) == pytest.approx(chance, rel=1e-6)


def test_thresholds_are_those_of_the_tables() -> None:
    assert exceeded_with(0.05, 1) == pytest.approx(3.841, abs=5e-4)
    assert exceeded_with(0.01, 2) == pytest.approx(9.210, abs=5e-4)
    assert exceeded_with(0.001, 3) == pytest.approx(16.266, abs=5e-4)
    assert exceeded_with(0.0, 2) == math.inf
    assert gate_for(0.0, 0.0).is_open
    assert not gate_for(0.0, 1e-6).is_open


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.slow
def test_a_gate_that_rejects_nothing_changes_no_bit(
    model: Callable[..., FilterModel], mode: str
) -> None:
    _, periods = drive(1, 60)
    with_gate, results = run(model(mode), periods)
    without, _ = run(model(mode, OPEN_GATE), periods)
    assert not np.any([result.rejected for result in results])
    for a, b in zip(with_gate, without, strict=True):
        assert a.mean.tobytes() == b.mean.tobytes()
        assert a.process_noise.tobytes() == b.process_noise.tobytes()
        assert a.measurement_noise.tobytes() == b.measurement_noise.tobytes()


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.slow
def test_an_open_gate_remembers_nothing(model: Callable[..., FilterModel], mode: str) -> None:
    """Whatever is read; one that rejects fixes only remembers the compass, too."""
    _, periods = drive(1, 40)
    far = moved(periods, slice(20, 30), np.array([20.0, 5.0, 2.0, 0.0]))
    states, results = run(model(mode, OPEN_GATE), far)
    assert not np.any([result.rejected for result in results])
    for state in states:
        for kept, at_start in zip(state.gate, start_gate(), strict=True):
            np.testing.assert_array_equal(kept, at_start)
    states, _ = run(model(mode, gate_for(0.0, 1e-6)), far)
    assert np.all(states[20].gate.spread > 1.0)


@pytest.mark.parametrize("chance", [0.01, 0.1])
@pytest.mark.slow
def test_right_readings_are_rejected_as_often_as_was_asked_for(
    model: Callable[..., FilterModel], chance: float
) -> None:
    """Against a fresh gate each time: what came before opens it a little."""
    model_, robots, steps = model("none", gate_for(chance, chance)), 40, 100
    alone = [drive(seed, steps)[1] for seed in range(robots)]
    state = start_filter(model_, np.zeros((3, robots)), START_COVARIANCE)
    rejected = []
    for epochs in zip(*alone, strict=True):
        control, z, rows = (
            np.stack([getattr(epoch, name) for epoch in epochs], axis=-1)
            for name in ("control", "measurement", "available")
        )
        period = Epoch(control, epochs[0].duration_s, z, rows)
        _, result = step(model_, state._replace(gate=start_gate((robots,))), [period])
        state, _ = step(dataclasses.replace(model_, gate=OPEN_GATE), state, [period])
        rejected.append(result.rejected)
    share = np.mean(rejected, axis=(0, 2))
    sigma = math.sqrt(chance * (1.0 - chance) / (robots * steps))
    np.testing.assert_allclose(share, chance, atol=4.5 * sigma)


def assert_same(one: FilterState, other: FilterState, names: tuple[str, ...]) -> None:
    for name in names:
        assert np.asarray(getattr(one, name)).tobytes() == getattr(other, name).tobytes(), name


def joint_of(state: FilterState) -> JointState:
    assert state.joint is not None
    return state.joint


FIX_OUTLIER = ([20.0, 0.0, 0.0, 0.0], [0, 1])
COMPASS_OUTLIER = ([0.0, 0.0, 3.0, 0.0], [2])


def outliers_or_missing(
    model: FilterModel, seed: int, at: list[int], by: list[float], rows: list[int]
) -> tuple[list[FilterState], list[FilterState]]:
    """Return the states with outliers in some periods, and with these readings missing.

    All outliers are rejected and teach nothing; no other reading of their sensor is rejected.
    """
    _, periods = drive(seed, at[-1] + 80)
    wrong, missing = periods, list(periods)
    for t in at:
        wrong = moved(wrong, slice(t, t + 1), np.array(by))
        available = periods[t].available.copy()
        available[rows] = False
        missing[t] = periods[t]._replace(available=available)
    states, results = run(model, wrong)
    sensor = COMPASS if rows == [2] else LRF_POSE
    assert [t for t, result in enumerate(results) if result.rejected[sensor]] == at
    for t in at:
        assert not np.any(results[t].shown[0].teaches[rows])
    return states, run(model, missing)[0]


@pytest.mark.parametrize("mode", PAPER_MODES)
@pytest.mark.parametrize(("by", "rows"), [FIX_OUTLIER, COMPASS_OUTLIER])
@pytest.mark.parametrize("at", [[80], [60, 62], [60, 63], [60, 67]], ids=str)
@pytest.mark.slow
def test_outliers_have_the_effect_of_missing_readings(
    model: Callable[..., FilterModel], mode: str, by: list[float], rows: list[int], at: list[int]
) -> None:
    """Bit for bit, for ever after: pose, covariance, noise and innovations; one, or two apart."""
    for one, other in zip(*outliers_or_missing(model(mode), 3, at, by, rows), strict=True):
        assert_same(one, other, EVERYTHING)
        assert one.window.squares.tobytes() == other.window.squares.tobytes()


@pytest.mark.parametrize(("by", "rows"), [FIX_OUTLIER, COMPASS_OUTLIER])
@pytest.mark.parametrize(
    ("seed", "at"),
    [(3, [80]), (13, [60, 62]), (3, [60, 63]), (13, [60, 67])],
    ids=str,
)
@pytest.mark.slow
def test_in_mode_joint_outliers_have_the_effect_of_missing_readings_but_for_the_memory(
    model: Callable[..., FilterModel], by: list[float], rows: list[int], at: list[int], seed: int
) -> None:
    """Pose and covariance are the same bit for bit right after the outlier, the rest is close.

    A rejected reading counts for how fast what was learned of its sensor's noise fades, a missing
    one does not. So the learners' log variances differ, by less than 0.005 at once and by less
    than 0.04 later (measured: 0.0036 and 0.035), and the noise in use by less than 1 %.
    """
    states, missing = outliers_or_missing(model("joint"), seed, at, by, rows)
    first = at[0]
    for t in range(first):
        assert_same(states[t], missing[t], EVERYTHING)
    assert_same(states[first], missing[first], ("mean", "covariance"))
    memory = joint_of(states[first]).memory - joint_of(missing[first]).memory
    informed_by_sensor = [0, 2] if rows == [0, 1] else [3]
    np.testing.assert_array_less(0.0, memory[informed_by_sensor, SETTLED])
    assert np.all(memory >= 0.0)
    apart = np.array(
        [
            np.max(np.abs(joint_of(one).log_scale - joint_of(other).log_scale))
            for one, other in zip(states, missing, strict=True)
        ]
    )
    assert apart[first] < 0.005
    assert np.max(apart) < 0.04
    for one, other in zip(states, missing, strict=True):
        for name in ("process_noise", "measurement_noise"):
            ratio = getattr(one, name) / getattr(other, name)
            np.testing.assert_allclose(ratio, 1.0, rtol=0.0, atol=0.01)
        np.testing.assert_allclose(one.mean, other.mean, rtol=0.0, atol=1e-3)


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("jump", [2.0, 2000.0])
@pytest.mark.slow
def test_a_carried_robot_is_found_and_the_noise_is_not_poisoned(
    model: Callable[..., FilterModel], mode: str, jump: float
) -> None:
    """Three seconds after 2 m to 2 km: there, with the noise that a quiet run has."""
    truth, periods = drive(4, 300)
    by = np.array([0.6 * jump, -0.8 * jump, 0.0, 0.0])
    states, results = run(model(mode), moved(periods, slice(150, None), by))
    quiet, _ = run(model(mode), periods)
    relocated = [t for t, result in enumerate(results) if result.relocated]
    assert len(relocated) == 1
    assert 150 < relocated[0] <= 150 + 10
    for t in range(relocated[0], 300):
        assert np.hypot(*(states[t].mean[:2] - truth[t + 1, :2] - by[:2])) < 0.6
    errors = [states[t].mean[:2] - truth[t + 1, :2] - by[:2] for t in range(relocated[0], 300)]
    usual = [quiet[t].mean[:2] - truth[t + 1, :2] for t in range(relocated[0], 300)]
    assert np.sqrt(np.mean(np.square(errors))) < 1.25 * np.sqrt(np.mean(np.square(usual)))
    for field in ("process_noise", "measurement_noise"):
        ratio = getattr(states[-1], field) / getattr(quiet[-1], field)
        np.testing.assert_array_less(np.abs(np.log(ratio[:3])), math.log(1.6))


@pytest.mark.slow
def test_a_fast_sensor_that_is_wrong_for_a_moment_moves_nothing(
    model: Callable[..., FilterModel],
) -> None:
    """At 50 ms eight readings are 0.4 s: fixes off for 2.5 s are no place, for 3 s they are."""
    fast = model("none", period_s=0.05)
    truth, periods = drive(10, 400, duration_s=0.05)
    by = np.array([3.0, 0.0, 0.0, 0.0])
    states, results = run(fast, moved(periods, slice(100, 150), by))
    assert not np.any([result.relocated for result in results])
    assert np.hypot(*(states[160].mean[:2] - truth[161, :2])) < 0.5
    _, results = run(fast, moved(periods, slice(100, None), by))
    relocated = [t for t, result in enumerate(results) if result.relocated]
    assert len(relocated) == 1
    assert 100 + 58 <= relocated[0] <= 100 + 64


@pytest.mark.parametrize("mode", ["none", "joint"])
@pytest.mark.slow
def test_fixes_in_millimeters_are_never_followed(
    model: Callable[..., FilterModel], mode: str
) -> None:
    """For a minute: the pose is what wheels and compass say, and afterwards soon right again."""
    truth, periods = drive(12, 340)
    wrong = [
        p._replace(measurement=p.measurement * np.array([1e3, 1e3, 1.0, 1.0]))
        if 100 <= t < 260
        else p
        for t, p in enumerate(periods)
    ]
    states, results = run(model(mode), wrong)
    assert not np.any([result.relocated for result in results[:260]])
    errors = [np.hypot(*(states[t].mean - truth[t + 1])[:2]) for t in range(340)]
    assert max(errors[:260]) < 3.0
    assert max(errors[280:]) < 0.6


def test_a_compass_without_fixes_beside_it_decides_nothing(
    model: Callable[..., FilterModel],
) -> None:
    only_yaw = np.array([False, False, True, False])
    still = [Epoch(np.zeros(2), 0.375, np.zeros(4), only_yaw)] * 200
    _, results = run(model("none"), moved(still, slice(60, None), np.array([0.0, 0.0, 2.0, 0.0])))
    assert not np.any([result.relocated for result in results])


def test_a_robot_turned_by_hand_is_found_by_the_compass(model: Callable[..., FilterModel]) -> None:
    """At a standstill, where fixes say nothing of it; a fix every third period."""
    still = Epoch(np.zeros(2), 0.375, np.zeros(4), np.array([True, True, True, False]))
    no_fix = still._replace(available=np.array([False, False, True, False]))
    before = [still if t % 3 == 0 else no_fix for t in range(60)]
    turned = moved(before, slice(0, None), np.array([0.0, 0.0, 2.0, 0.0]))
    states, results = run(model("none"), before + turned)
    relocated = [t for t, result in enumerate(results) if result.relocated]
    assert len(relocated) == 1
    assert 60 < relocated[0] < 75
    assert states[-1].mean[2] == pytest.approx(2.0, abs=0.05)


@pytest.mark.parametrize("mode", ["none", "joint"])
@pytest.mark.slow
def test_a_compass_that_lies_while_the_robot_drives_is_not_followed(
    model: Callable[..., FilterModel], mode: str
) -> None:
    """By a right angle, for a minute: the fixes say which way it goes."""
    truth, periods = drive(5, 320)
    lying = moved(periods, slice(80, 240), np.array([0.0, 0.0, 1.57, 0.0]))
    states, results = run(model(mode), lying)
    errors = np.array([states[t].mean - truth[t + 1] for t in range(80, 240)])
    errors[:, 2] = wrap_angle(errors[:, 2])
    assert np.sqrt(np.mean(errors[:, 2] ** 2)) < 0.15
    assert np.sqrt(np.mean(errors[:, :2] ** 2)) < 0.2
    assert np.mean([result.rejected[COMPASS] for result in results[80:240]]) > 0.8


@pytest.mark.parametrize("mode", ["none", "q", "joint"])  # r takes a wrong Q for a wrong R
@pytest.mark.parametrize("too_tight", [25.0, 625.0, 1e4])
@pytest.mark.slow
def test_noise_that_is_wrong_by_far_locks_nothing_out(
    model: Callable[..., FilterModel], mode: str, too_tight: float
) -> None:
    """Q and R too small: most readings look like outliers, and soon are accepted all the same."""
    small = {
        "process_noise": tuple(TRUE_Q / too_tight), "measurement_noise": tuple(TRUE_R / too_tight),
    }  # fmt: skip
    truth, periods = drive(6, 400)
    states, results = run(model(mode, **small), periods)
    rejected = np.array([result.rejected for result in results])
    assert np.mean(rejected[40:]) < 0.05
    error = np.array([state.mean for state in states]) - truth[1:]
    assert np.max(np.abs(error[40:, :2])) < 1.0


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.slow
def test_half_of_the_fixes_wild_in_all_directions(
    model: Callable[..., FilterModel], mode: str
) -> None:
    """No promise of accuracy, but one of sanity: finite, definite, and not carried away."""
    truth, periods = drive(7, 300)
    rng = np.random.default_rng(8)
    for t in range(100, 200):
        if rng.random() < 0.5:
            wild = np.zeros(4)
            wild[:2] = 20.0 * rng.standard_normal(2)
            periods[t] = periods[t]._replace(measurement=periods[t].measurement + wild)
    states, _ = run(model(mode), periods)
    for state in states:
        assert np.all(np.linalg.eigvalsh(state.covariance) > 0.0)
    last = np.array([states[t].mean[:2] - truth[t + 1, :2] for t in range(260, 300)])
    assert np.max(np.abs(last)) < 1.0


@pytest.mark.parametrize("mode", ["none", "joint"])
@pytest.mark.slow
def test_each_robot_of_a_batch_has_a_gate_of_its_own(
    model: Callable[..., FilterModel], mode: str
) -> None:
    _, periods = drive(9, 60)
    robots = [
        periods,
        moved(periods, slice(30, 31), np.array([20.0, 0.0, 0.0, 0.0])),
        moved(periods, slice(30, None), np.array([20.0, 5.0, 1.5, 0.0])),
    ]
    together = [
        Epoch(
            np.stack([robot[t].control for robot in robots], axis=-1),
            0.375,
            np.stack([robot[t].measurement for robot in robots], axis=-1),
            np.stack([robot[t].available for robot in robots], axis=-1),
        )
        for t in range(60)
    ]
    start = start_filter(model(mode), np.zeros((3, 3)), START_COVARIANCE)
    states, results = run(model(mode), together, start)
    assert np.any([result.relocated for result in results], axis=0).tolist() == [False, False, True]
    for i, robot in enumerate(robots):
        alone, _ = run(model(mode), robot)
        for one, other in zip(states, alone, strict=True):
            np.testing.assert_allclose(one.mean[:, i], other.mean, rtol=1e-10, atol=1e-12)
            np.testing.assert_allclose(
                one.measurement_noise[:, i], other.measurement_noise, rtol=1e-9
            )


def test_a_sensor_that_is_not_read_keeps_what_the_gate_remembers_of_it() -> None:
    state = GateState(np.array([3.0, 5.0]), np.array([2.0, 4.0]), np.array([0.2, 0.4]))
    nothing = GateDecision(np.zeros(2), np.zeros(2), np.zeros(2, dtype=np.bool_))
    only_fix = nothing._replace(nis=np.array([0.0, 2.0]), degrees_of_freedom=np.array([0.0, 2.0]))
    agrees, elapsed = np.zeros(2, dtype=np.bool_), np.ones(2)
    for decision, kept in ((nothing, [COMPASS, LRF_POSE]), (only_fix, [COMPASS])):
        after = after_decision(state, decision, agrees, elapsed, learns=False)
        for before, now in zip(state, after, strict=True):
            np.testing.assert_array_equal(now[kept], before[kept])
    assert after.spread[LRF_POSE] < state.spread[LRF_POSE]
    assert after.rejections[LRF_POSE] == 0.0
