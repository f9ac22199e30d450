# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Learning: descent, the training set, and the file that holds what was learned."""

import itertools
import math
from pathlib import Path

import numpy as np
import pytest

from fnn_ekf_ros.core.adaptation import FuzzyNetwork
from fnn_ekf_ros.core.arrays import FloatArray
from fnn_ekf_ros.core.fuzzy import FuzzySets, infer
from fnn_ekf_ros.membership.files import (
    EXPLAINED,
    MembershipError,
    read_membership,
    render_membership,
)
from fnn_ekf_ros.parameters.fake_robot import FakeRobotParameters
from fnn_ekf_ros.parameters.paper import MEASUREMENT_STD, SIMULATION_1_STD
from fnn_ekf_ros.study.scenarios import NOMINAL, Scenario, record
from fnn_ekf_ros.training import training_set
from fnn_ekf_ros.training.descent import Epoch, LearningNetwork, descend
from fnn_ekf_ros.training.five_layers import (
    as_sets,
    first_sets,
    five_layers,
    in_unit,
    joint_network,
    learned_network,
    mirrored,
    odd_layers,
)
from fnn_ekf_ros.training.joint_set import JointObservations, average, observe_joint
from fnn_ekf_ros.training.training_set import Observations, make_training_set, observe, pick

# P, N, D, I, M, Z of order 1; all twelve numbers different.
KNOWN = FuzzySets(-1.6, -1.1, 1.4, 0.9, -2.1, -1.2, 1.9, 1.3, 0.05, 0.2, -0.1, 0.8)
OTHER = FuzzySets(-2.0, -0.8, 1.1, 1.2, -1.7, -1.5, 2.3, 1.0, -0.1, 0.3, 0.1, 1.0)


def epoch_after(steps: int, start: FuzzySets, D: FloatArray, dR: FloatArray, rate: float) -> Epoch:
    """Return where the five layers are after so many steps of descent."""
    descent = descend(five_layers(start), np.array(start), D, dR, rate)
    return next(itertools.islice(descent, steps, None))


# --- descent -------------------------------------------------------------------------------------


def test_one_step_equals_the_one_by_hand() -> None:
    # z = p0 x + p1 at p = (2, 1); pairs (1, 2) and (3, 4): z = 3, 7, errors 1, 3;
    # E = (1/2 + 9/2) / 2; dE/dp0 = (1*1 + 3*3) / 2 = 5; dE/dp1 = (1 + 3) / 2 = 2.
    line = LearningNetwork(
        output=lambda p, x: p[0] * x + p[1],
        gradient=lambda _, x: np.stack([x, np.ones_like(x)]),
        feasible=lambda p: p,
    )
    start = np.array([2.0, 1.0])
    first, second = itertools.islice(
        descend(line, start, np.array([1.0, 3.0]), np.array([2.0, 4.0]), 0.1), 2
    )
    assert first.loss == pytest.approx(2.5)
    np.testing.assert_allclose(second.parameters, [1.5, 0.8])
    np.testing.assert_array_equal(start, [2.0, 1.0])


def test_a_step_of_the_five_layers_is_downhill_by_every_parameter() -> None:
    D, dR, rate, h = np.linspace(-3.0, 3.0, 13), np.linspace(2.0, -1.0, 13), 1e-3, 1e-6

    def loss(p: FloatArray) -> float:
        return float(np.mean(0.5 * (infer(FuzzySets(*p), D).change - dR) ** 2))

    p = np.array(OTHER)
    slope = [(loss(p + h * e) - loss(p - h * e)) / (2.0 * h) for e in np.eye(12)]
    stepped = epoch_after(1, OTHER, D, dR, rate).parameters
    np.testing.assert_allclose((p - stepped) / rate, slope, rtol=1e-5, atol=1e-8)
    assert np.all(np.abs(slope) > 1e-4)  # not one parameter stands still


@pytest.mark.slow
def test_descent_finds_the_function_of_a_known_network() -> None:
    D = np.linspace(-5.0, 5.0, 101)
    wanted = infer(KNOWN, D).change
    off = np.max(np.abs(infer(OTHER, D).change - wanted))
    learned = as_sets(epoch_after(6000, OTHER, D, wanted, 0.05).parameters)
    assert off > 0.5
    assert np.max(np.abs(infer(learned, D).change - wanted)) < 0.02 * off


def test_a_small_rate_lets_the_loss_only_fall() -> None:
    D = np.linspace(-5.0, 5.0, 101)
    noise = np.random.default_rng(0).normal(0.0, 0.3, D.shape)
    steps = descend(five_layers(OTHER), np.array(OTHER), D, infer(KNOWN, D).change + noise, 0.01)
    losses = np.array([epoch.loss for epoch in itertools.islice(steps, 500)])
    assert np.all(np.diff(losses) < 0.0)


def test_parameters_stay_feasible_whatever_the_step() -> None:
    network = five_layers(KNOWN)
    kept = as_sets(network.feasible(-7.0 * np.array(KNOWN)))
    for name, value in kept._asdict().items():
        if name.endswith("_slope"):
            assert math.copysign(1.0, value) == math.copysign(1.0, getattr(KNOWN, name))
    assert kept.zero_width > 0.0
    assert kept.maintain_width == 0.0
    assert kept.zero_center == -7.0 * KNOWN.zero_center
    np.testing.assert_array_equal(network.feasible(np.array(KNOWN)), np.array(KNOWN))


def test_pairs_count_by_their_weight() -> None:
    D, dR = np.linspace(-3.0, 3.0, 13), np.linspace(2.0, -1.0, 13)

    def after(chosen: FloatArray, weight: FloatArray | None) -> Epoch:
        steps = descend(five_layers(OTHER), np.array(OTHER), D[chosen], dR[chosen], 0.1, weight)
        return next(itertools.islice(steps, 3, None))

    once, twice = np.arange(13), np.repeat(np.arange(13), 1 + (np.arange(13) > 6))
    weighted = after(once, (1.0 + (once > 6)) / 19.0)
    repeated = after(twice, None)
    np.testing.assert_allclose(weighted.parameters, repeated.parameters, rtol=1e-12)
    assert weighted.loss == pytest.approx(repeated.loss)


def test_the_network_of_mode_joint_stays_odd_while_it_learns() -> None:
    u = np.linspace(-3.0, 3.0, 62)
    wanted = np.tanh(u) + 0.1  # the 0.1 cannot be learned
    start = mirrored(OTHER)
    steps = descend(odd_layers(start), np.array(start), -u, wanted, 0.02)
    epochs = list(itertools.islice(steps, 300))
    assert np.all(np.diff([epoch.loss for epoch in epochs]) < 0.0)
    learned = joint_network(as_sets(epochs[-1].parameters), 2.0)
    answer = infer(learned.sets, -u).change
    np.testing.assert_allclose(answer, -answer[::-1], rtol=0.0, atol=1e-14)
    assert abs(float(infer(learned.sets, np.zeros(1)).change[0])) < 1e-14
    assert (learned.position_unit, learned.yaw_unit) == (1.0, 1.0)


# --- what descent starts from and what it gives --------------------------------------------------


def test_the_initial_sets_are_mended_where_descent_is_blind() -> None:
    initial, first = read_membership("initial").sets, first_sets(read_membership("initial"))
    same = in_unit(first, 1.0 / 15.0)
    assert same.decrease_slope == pytest.approx(-0.1)
    assert same.zero_width == pytest.approx(15.0)
    for name in set(FuzzySets._fields) - {"decrease_slope", "zero_width"}:
        assert getattr(same, name) == pytest.approx(getattr(initial, name)), name
    D = np.linspace(-3.0, 3.0, 61)
    gradient = five_layers(first).gradient(np.array(first), D)
    assert np.all(np.max(np.abs(gradient), axis=-1) > 1e-3)


def test_sets_in_another_unit_are_the_same_function() -> None:
    D = np.linspace(-4.0, 4.0, 33)
    smaller = infer(in_unit(KNOWN, 0.1), 10.0 * D).change
    np.testing.assert_allclose(smaller, 10.0 * infer(KNOWN, D).change, rtol=1e-12)


def test_a_learned_network_answers_in_si_units_what_the_scaled_one_does() -> None:
    D = np.linspace(-4.0, 4.0, 33)
    network = learned_network(KNOWN, 3e-3, 5e-3, 0.25, 250.0)
    for unit, scale in ((network.position_unit, 3e-3), (network.yaw_unit, 5e-3)):
        change = unit * infer(network.sets, D * scale / unit).change
        np.testing.assert_allclose(change, 0.25 * scale * infer(KNOWN, D).change, rtol=1e-4)


# --- training set --------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def seen() -> Observations:
    """What filters saw of 60 robots on the path of simulation 1 over 120 steps."""
    rng = np.random.default_rng(4)
    robot = FakeRobotParameters(path="sim1")
    return observe(record(robot, NOMINAL, 120, 60, rng), 45, rng)


@pytest.mark.slow
def test_half_of_the_filters_are_right_and_the_others_wrong_both_ways(seen: Observations) -> None:
    R = np.square(MEASUREMENT_STD)
    assert seen.mismatch.shape == seen.wanted_change.shape == ((120 - 14) * 60, 3)
    wrong_by = (1.0 - seen.wanted_change[:60] / (0.25 * R)).ravel()
    right = np.isclose(wrong_by, 1.0)
    assert 0.35 < np.mean(right) < 0.65
    logs = np.log(wrong_by[~right]) / math.log(25.0)
    assert -1.0 <= logs.min() < -0.8
    assert 0.8 < logs.max() <= 1.0
    assert abs(np.mean(logs)) < 6.0 / math.sqrt(3.0 * logs.size)
    np.testing.assert_array_equal(seen.wanted_change[:60], seen.wanted_change[-60:])  # held


def test_mismatch_scatters_as_a_mean_of_45_squares_where_the_noise_is_right(
    seen: Observations,
) -> None:
    # Heading alone: P- = q/2 + sqrt(q^2/4 + q R), S = P- + R; the fixes add a little knowledge.
    q, R = SIMULATION_1_STD[1] ** 2, MEASUREMENT_STD[2] ** 2
    S = 0.5 * q + math.sqrt(0.25 * q**2 + q * R) + R
    settled = seen.mismatch[:, 2][seen.settled[:, 2]]
    assert np.std(settled) == pytest.approx(math.sqrt(2.0 / 45.0) * S, rel=0.2)
    assert abs(np.mean(settled)) < 0.5 * np.std(settled)
    assert np.all(seen.wanted_change[seen.settled] == 0.0)


def test_a_wrong_noise_shows_in_the_mismatch(seen: Observations) -> None:
    R = np.square(MEASUREMENT_STD)
    too_large, too_small = seen.wanted_change < -0.25 * R, seen.wanted_change > 0.125 * R
    assert np.mean(seen.mismatch[too_large] > 0.0) > 0.99
    assert np.mean(seen.mismatch[too_small] < 0.0) > 0.9


def test_pairs_are_scaled_by_row_and_even_over_mismatch() -> None:
    rng = np.random.default_rng(2)
    scale = np.array([0.2, 0.2, 0.7])
    D = 3.0 * rng.standard_normal((40_000, 3)) * scale
    settled = np.zeros(D.shape, dtype=bool)
    settled[:20_000] = True
    D[:20_000] /= 3.0
    pairs = pick(Observations(D, -0.25 * D, settled), rng)
    assert pairs.position_scale == pytest.approx(0.2, rel=0.02)
    assert pairs.yaw_scale == pytest.approx(0.7, rel=0.02)
    np.testing.assert_allclose(pairs.wanted_change, -pairs.mismatch, rtol=1e-12)
    # Between 0 and 1 scale the intervals are about 0.4 wide; the normal's middle is full.
    for first in (-3.0, -1.0, 1.0):
        low, high = math.sinh(first * 0.369), math.sinh((first + 2.0) * 0.369)
        assert np.sum((pairs.mismatch >= low) & (pairs.mismatch < high)) in range(115, 126)


@pytest.mark.slow
def test_a_seed_makes_the_training_set(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(training_set, "RUNS", 6)
    monkeypatch.setattr(training_set, "STEPS", 60)
    made = [make_training_set(45, np.random.default_rng(seed)) for seed in (1, 1, 2)]
    np.testing.assert_array_equal(made[0].mismatch, made[1].mismatch)
    np.testing.assert_array_equal(made[0].wanted_change, made[1].wanted_change)
    assert made[0].position_scale != made[2].position_scale


# --- training set of mode joint ------------------------------------------------------------------


@pytest.fixture(scope="module")
def asked() -> JointObservations:
    """What settled learners asked for of 60 robots, some of them with noisier sensors."""
    rng = np.random.default_rng(4)
    robot = FakeRobotParameters(path="sim1")
    scenario = Scenario(measurement_scale=25.0)
    return observe_joint(record(robot, scenario, 100, 60, rng), read_membership("joint"), rng)


def test_the_wanted_change_leads_to_the_true_noise(asked: JointObservations) -> None:
    steps = 98  # two forecasts come first
    u, wanted, right = (np.reshape(part, (steps, 60, -1)) for part in asked)
    assert np.mean(right) == pytest.approx(0.25, abs=0.15)
    told_right = right[0, :, 0] == 1.0
    np.testing.assert_allclose(wanted[0, told_right], 0.0, atol=1e-12)
    wrong = wanted[0, ~told_right]
    assert np.max(np.abs(wrong)) < math.log(25.0)
    assert np.std(wrong) == pytest.approx(math.log(25.0) / math.sqrt(3.0), rel=0.15)
    # What was wanted and was not done is wanted again; R's true scale jumps by log 25 at step 40.
    network = read_membership("joint")
    rest = wanted[:-1] - infer(network.sets, -u[:-1]).change
    jump = np.zeros((steps - 1, 1, 4))
    jump[37, 0, 2:], jump[57, 0, 2:] = math.log(25.0), -math.log(25.0)
    np.testing.assert_allclose(wanted[1:], rest + jump, atol=1e-9)
    fixes = np.sqrt(np.mean(wanted[[0, 37], :, 2] ** 2, axis=-1))
    assert fixes[1] < 0.3 * fixes[0]  # learned


def test_evidence_points_to_the_true_noise_from_both_sides(asked: JointObservations) -> None:
    u, wanted = asked.asked, asked.wanted_change
    for side in (u > 0.3, u < -0.3):
        assert np.mean(np.sign(u[side]) * wanted[side]) > 0.15


def test_crisp_pairs_are_means_mirrored_and_bounded() -> None:
    rng = np.random.default_rng(6)
    u = rng.uniform(-2.0, 2.0, (60_000, 4))
    u[:100, 0] = 2.9  # too few for a pair
    delta = 0.8 * u + rng.standard_normal(u.shape)
    pairs = average(JointObservations(u, delta, np.ones(len(u), dtype=bool)))
    np.testing.assert_array_equal(pairs.asked, -pairs.asked[::-1])
    np.testing.assert_array_equal(pairs.wanted_change, -pairs.wanted_change[::-1])
    np.testing.assert_array_equal(pairs.weight, pairs.weight[::-1])
    assert np.all(np.diff(pairs.asked) > 0.0)
    assert np.max(pairs.asked) < 2.0
    assert np.sum(pairs.weight) == pytest.approx(1.0)
    np.testing.assert_allclose(
        pairs.wanted_change, np.clip(0.8 * pairs.asked, -1.0, 1.0), atol=0.08
    )
    assert np.max(pairs.wanted_change) == 1.0


# --- the file ------------------------------------------------------------------------------------


def test_a_written_file_is_read_bit_for_bit(tmp_path: Path) -> None:
    rng = np.random.default_rng(8)
    for number in range(50):
        values = np.abs(rng.standard_normal(15)) * 10.0 ** rng.uniform(-12.0, 12.0, 15)
        network = FuzzyNetwork(FuzzySets(*values[:12].tolist()), *values[12:].tolist())
        path = tmp_path / f"{number}.yaml"
        path.write_text(render_membership(network, ["seed 3", "loss 1 before"]))
        assert read_membership(str(path)) == network
        assert "# seed 3\n" in path.read_text()
    assert len(list(tmp_path.iterdir())) == 50


def test_a_file_says_what_its_sets_are_functions_of() -> None:
    network = joint_network(mirrored(KNOWN), 2.0)
    of_mismatch, of_evidence = (
        render_membership(network, []),
        render_membership(network, [], EXPLAINED),
    )
    assert "x = C_hat - S in the units below." in of_mismatch
    assert "# m^2, of position variances" in of_mismatch
    assert "x = u in log variance." in of_evidence
    assert "m^2" not in of_evidence


def test_a_file_cut_short_anywhere_is_refused(tmp_path: Path) -> None:
    text = render_membership(read_membership("published"), ["a note"])
    path = tmp_path / "cut.yaml"
    for length in range(len(text) - 1):
        path.write_text(text[:length])
        with pytest.raises(MembershipError) as caught:
            read_membership(str(path))
        line = str(caught.value)
        assert str(path) in line
        assert "write it again with `train --out`" in line
        assert "\n" not in line
    path.write_text(text)
    assert read_membership(str(path)) == read_membership("published")


@pytest.mark.parametrize(
    ("version", "words"),
    [
        ("0", "'version' is 0: expected 1; mend"),
        ("2", "'version' is 2: expected 1, or a newer fnn_ekf"),
    ],
)
def test_files_of_another_age_are_refused(tmp_path: Path, version: str, words: str) -> None:
    text = render_membership(read_membership("published"), [])
    path = tmp_path / "aged.yaml"
    path.write_text(text.replace("version: 1", f"version: {version}"))
    with pytest.raises(MembershipError, match=r"aged\.yaml") as caught:
        read_membership(str(path))
    assert words in str(caught.value)
