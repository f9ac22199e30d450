# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fnn_ekf_ros.core.arrays import FloatArray
from fnn_ekf_ros.core.fuzzy import (
    FuzzySets,
    gaussian,
    infer,
    infer_centroid,
    infer_gradient,
    sigmoid,
)

PROPERTY = settings(derandomize=True, deadline=None, database=None, max_examples=200)

# Rules in the order of the results' first axis.
INCREASE, MAINTAIN, DECREASE = 0, 1, 2

MISMATCH = st.one_of(
    st.floats(min_value=-300.0, max_value=300.0), st.floats(min_value=-0.5, max_value=0.5)
)


def plain_sigmoid(x: float, slope: float, center: float) -> float:
    return 1.0 / (1.0 + math.exp(-slope * (x - center)))


def inverse_sigmoid(alpha: float, slope: float, center: float) -> float:
    return center + math.log(alpha / (1.0 - alpha)) / slope


def literal_layers(s: FuzzySets, mismatch: float) -> tuple[list[float], list[float], float]:
    """The five layers as the paper writes them, (19)-(22), with its logarithms.

    The argument of the sets is C_hat - S; M^-1 is taken on the side its argument is on.
    """
    x = -mismatch
    alpha = [
        plain_sigmoid(x, s.negative_slope, s.negative_center),
        math.exp(-((x - s.zero_center) ** 2) / (2.0 * s.zero_width**2)),
        plain_sigmoid(x, s.positive_slope, s.positive_center),
    ]
    side = math.copysign(1.0, x - s.zero_center)
    z = [
        inverse_sigmoid(alpha[0], s.increase_slope, s.increase_center),
        math.nan,
        s.decrease_center
        if s.decrease_slope == 0.0
        else inverse_sigmoid(alpha[2], s.decrease_slope, s.decrease_center),
    ]
    if alpha[1] > 0.0:
        z[1] = s.maintain_center + side * s.maintain_width * math.sqrt(-2.0 * math.log(alpha[1]))
    weighted = sum(a * b for a, b in zip(alpha, z, strict=True) if a > 0.0)
    return alpha, z, weighted / sum(alpha)


@pytest.mark.parametrize("mismatch", np.linspace(-90.0, 90.0, 73))
def test_sigmoid_rules_equal_the_literal_inverse(either_set: FuzzySets, mismatch: float) -> None:
    result = infer(either_set, np.array(mismatch))
    alpha, z, change = literal_layers(either_set, mismatch)
    np.testing.assert_allclose(result.firing_strength, alpha, rtol=1e-12, atol=1e-300)
    for rule in (INCREASE, DECREASE):
        assert result.consequent[rule] == pytest.approx(z[rule], rel=1e-9)
    assert float(result.change) == pytest.approx(change, rel=1e-9)


@pytest.mark.parametrize("offset", [-0.3, -0.1, -0.01, 0.01, 0.1, 0.3])
def test_maintain_rule_equals_the_literal_inverse(either_set: FuzzySets, offset: float) -> None:
    mismatch = -(either_set.zero_center + offset)
    result = infer(either_set, np.array(mismatch))
    alpha, z, change = literal_layers(either_set, mismatch)
    assert result.firing_strength[MAINTAIN] == pytest.approx(alpha[MAINTAIN], rel=1e-9)
    assert result.consequent[MAINTAIN] == pytest.approx(z[MAINTAIN], rel=1e-9)
    assert float(result.change) == pytest.approx(change, rel=1e-9)


def test_published_set_at_no_mismatch_by_hand(published: FuzzySets) -> None:
    result = infer(published, np.array(0.0))
    # I: 24.2 - .1515 / .103 * 13.8108, M: .0571 - .1779 / .062 * .0467,
    # D: -143 + .1073 / .06552 * 17.0995
    expected = [3.88605631, -0.07689887, -114.99669841]
    np.testing.assert_allclose(result.consequent, expected, rtol=1e-7)
    expected = [
        1.0 / (1.0 + math.exp(0.1515 * 13.8108)),
        math.exp(-0.5 * (0.0467 / 0.062) ** 2),
        1.0 / (1.0 + math.exp(0.1073 * 17.0995)),
    ]
    np.testing.assert_allclose(result.firing_strength, expected, rtol=1e-14)
    assert float(result.change) == pytest.approx(-15.5, abs=0.1)


@pytest.mark.parametrize("mismatch", [2e3, -2e3, 1e4, -1e4, 1e6, -1e6])
def test_published_set_acts_as_one_and_a_half_times_the_mismatch_far_off(
    published: FuzzySets, mismatch: float
) -> None:
    change = float(infer(published, np.array(mismatch)).change)
    assert change / -mismatch == pytest.approx(1.5, abs=0.2)


def test_initial_set_decreases_crisply_and_increases_as_much_as_is_missing(
    initial: FuzzySets,
) -> None:
    mismatch = np.array([1e5, 1e3, 0.0, -1e3, -1e5])
    result = infer(initial, mismatch)
    np.testing.assert_array_equal(result.consequent[DECREASE], -100.0)
    np.testing.assert_allclose(result.consequent[MAINTAIN], 0.03, rtol=1e-15)
    np.testing.assert_allclose(result.consequent[INCREASE], 10.0 - mismatch, rtol=1e-12)
    np.testing.assert_allclose(result.change[:2], -100.0, rtol=1e-12)
    np.testing.assert_allclose(result.change[3:], [1010.0, 100_010.0], rtol=1e-12)


def test_each_rule_fires_where_it_should(either_set: FuzzySets) -> None:
    too_large = infer(either_set, np.array(1e3))
    too_small = infer(either_set, np.array(-1e3))
    right = infer(either_set, np.array(-either_set.zero_center))
    np.testing.assert_allclose(too_large.firing_strength, [0.0, 0.0, 1.0], atol=1e-12)
    np.testing.assert_allclose(too_small.firing_strength, [1.0, 0.0, 0.0], atol=1e-12)
    assert right.firing_strength[MAINTAIN] == pytest.approx(1.0, abs=1e-15)
    assert np.argmax(right.firing_strength) == MAINTAIN
    assert too_large.change < 0.0 < too_small.change


@PROPERTY
@given(st.floats(min_value=200.0, max_value=1e9))
@pytest.mark.slow
def test_noise_falls_where_S_is_too_large_and_rises_where_it_is_too_small(
    either_set: FuzzySets, size: float
) -> None:
    assert infer(either_set, np.array(size)).change < 0.0
    assert infer(either_set, np.array(-size)).change > 0.0


@PROPERTY
@given(st.floats(min_value=-1e150, max_value=1e150))
@pytest.mark.slow
def test_normalized_firing_sums_to_one_and_the_change_is_its_mean(
    either_set: FuzzySets, mismatch: float
) -> None:
    result = infer(either_set, np.array(mismatch))
    beta, z = result.normalized_firing, result.consequent
    assert np.all((result.firing_strength >= 0.0) & (result.firing_strength <= 1.0))
    assert np.all((beta >= 0.0) & (beta <= 1.0))
    assert float(np.sum(beta)) == pytest.approx(1.0, abs=1e-15)
    assert float(result.change) == pytest.approx(float(beta @ z), rel=1e-14)
    total = np.sum(result.firing_strength)
    np.testing.assert_allclose(beta, result.firing_strength / total, rtol=1e-9, atol=1e-300)


@pytest.mark.parametrize("exponent", [3, 10, 100, 153, 155, 200, 300])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_huge_mismatch_gives_a_finite_change(
    either_set: FuzzySets, exponent: int, sign: float
) -> None:
    # The exponent of a Gaussian that is nowhere near may overflow to -inf: a firing of 0.
    with np.errstate(over="ignore"):
        result = infer(either_set, np.array(sign * 10.0**exponent))
    for values in result:
        assert np.all(np.isfinite(values))
    assert math.copysign(1.0, float(result.change)) == -sign


def test_huge_mismatch_gives_no_warning(either_set: FuzzySets) -> None:
    with np.errstate(over="raise", invalid="raise"):
        infer(either_set, np.array([1e300, -1e300]))


def test_huge_mismatch_gives_a_finite_gradient(either_set: FuzzySets) -> None:
    with np.errstate(over="ignore", invalid="ignore"):
        gradient = infer_gradient(either_set, np.array([1e200, -1e200]))
    assert np.all(np.isfinite(gradient))


def steep_sets_with_a_gap() -> FuzzySets:
    """Sets so steep that between them every membership is 0 in double precision."""
    return FuzzySets(-100.0, -100.0, 100.0, 100.0, -1.0, -50.0, 1.0, 50.0, 0.0, 0.1, 0.0, 0.01)


def test_nearest_set_decides_where_none_fires() -> None:
    sets = steep_sets_with_a_gap()
    mismatch = np.array([-50.0, 50.0])
    result = infer(sets, mismatch)
    np.testing.assert_array_equal(result.firing_strength, np.zeros((3, 2)))
    np.testing.assert_array_equal(result.normalized_firing, [[1.0, 0.0], [0.0, 0.0], [0.0, 1.0]])
    np.testing.assert_array_equal(result.change, [50.0 - 5000.0, -50.0 + 5000.0])


def test_centroid_leaves_the_noise_where_no_set_fires() -> None:
    result = infer_centroid(steep_sets_with_a_gap(), np.array(50.0), 1e3)
    assert result.change == 0.0
    np.testing.assert_allclose(result.normalized_firing, np.full(3, 1.0 / 3.0), rtol=1e-15)
    np.testing.assert_array_equal(result.consequent, np.zeros(3))


@PROPERTY
@given(
    st.floats(min_value=-60.0, max_value=60.0),
    st.floats(min_value=-2.0, max_value=2.0).filter(lambda a: abs(a) > 1e-3),
    st.floats(min_value=-20.0, max_value=20.0),
)
@pytest.mark.slow
def test_sigmoid_is_the_logistic_function(x: float, slope: float, center: float) -> None:
    value = float(sigmoid(np.array(x), slope, center))
    assert value == pytest.approx(plain_sigmoid(x, slope, center), rel=1e-12)
    mirrored = float(sigmoid(np.array(x), -slope, center))
    assert value + mirrored == pytest.approx(1.0, abs=1e-15)


def test_memberships_far_away_are_exactly_0_or_1() -> None:
    x = np.array([-1e300, 1e300])
    np.testing.assert_array_equal(sigmoid(x, 2.0, 5.0), [0.0, 1.0])
    np.testing.assert_array_equal(sigmoid(x, -2.0, 5.0), [1.0, 0.0])


def test_gaussian_by_hand_and_crisp_without_width() -> None:
    x = np.array([1.0, 3.0, 5.0, 7.0])
    expected = [math.exp(-0.5), 1.0, math.exp(-0.5), math.exp(-2.0)]
    np.testing.assert_allclose(gaussian(x, 3.0, 2.0), expected, rtol=1e-15)
    np.testing.assert_array_equal(gaussian(x, 3.0, 0.0), [0.0, 1.0, 0.0, 0.0])


def numeric_gradient(sets: FuzzySets, mismatch: FloatArray) -> FloatArray:
    columns = []
    for i, value in enumerate(sets):
        h = 1e-5 * max(abs(value), 0.01)
        above, below = list(sets), list(sets)
        above[i] += h
        below[i] -= h
        difference = (
            infer(FuzzySets(*above), mismatch).change - infer(FuzzySets(*below), mismatch).change
        )
        columns.append(difference / (2.0 * h))
    return np.stack(columns)


@PROPERTY
@given(MISMATCH, st.lists(st.floats(min_value=0.7, max_value=1.4), min_size=12, max_size=12))
@pytest.mark.slow
def test_gradient_of_all_twelve_parameters_equals_central_differences(
    published: FuzzySets, mismatch: float, factors: list[float]
) -> None:
    sets = FuzzySets(*(value * by for value, by in zip(published, factors, strict=True)))
    D = np.array(mismatch)
    numeric = numeric_gradient(sets, D)
    np.testing.assert_allclose(infer_gradient(sets, D), numeric, rtol=1e-5, atol=1e-5)


def test_gradient_near_every_set_equals_central_differences(published: FuzzySets) -> None:
    """A fixed grid where all three rules matter, so that no entry is tested only as a 0."""
    D = np.concatenate([np.linspace(-0.25, 0.15, 41), np.linspace(-60.0, 60.0, 41)])
    gradient = infer_gradient(published, D)
    np.testing.assert_allclose(gradient, numeric_gradient(published, D), rtol=1e-5, atol=1e-5)
    assert gradient.shape == (12, 82)
    assert np.all(np.max(np.abs(gradient), axis=1) > 1e-2)


def test_gradient_of_the_initial_set_equals_central_differences(initial: FuzzySets) -> None:
    """A crisp D has no slope to learn; M's width can be learned from 0, on the chosen branch."""
    D = np.concatenate([np.linspace(-0.2, 0.1, 31), np.linspace(-60.0, 60.0, 31)])
    gradient, numeric = infer_gradient(initial, D), numeric_gradient(initial, D)
    decrease_slope = FuzzySets._fields.index("decrease_slope")
    np.testing.assert_array_equal(gradient[decrease_slope], 0.0)
    numeric[decrease_slope] = 0.0
    np.testing.assert_allclose(gradient, numeric, rtol=1e-5, atol=1e-5)
    assert np.any(gradient[FuzzySets._fields.index("maintain_width")] != 0.0)


def test_one_step_down_the_gradient_lowers_the_training_error(published: FuzzySets) -> None:
    """(23), (24): E = (z - dR)^2 / 2 on pairs that ask for another network."""
    D = np.linspace(-100.0, 100.0, 41)
    wanted = -0.7 * D
    error = infer(published, D).change - wanted
    descent = np.mean(error * infer_gradient(published, D), axis=1)
    stepped = FuzzySets(*(np.array(published) - 1e-9 * descent))
    after = infer(stepped, D).change - wanted
    assert np.mean(after**2) < np.mean(error**2)


def integrated_centroid(sets: FuzzySets, mismatch: float, limit: float, narrowest: float) -> float:
    """(18) by fine trapezoids over the clipped, united consequents."""
    x = -mismatch
    alpha = [
        plain_sigmoid(x, sets.negative_slope, sets.negative_center),
        math.exp(-((x - sets.zero_center) ** 2) / (2.0 * sets.zero_width**2)),
        plain_sigmoid(x, sets.positive_slope, sets.positive_center),
    ]
    z = np.linspace(-limit, limit, 200_001)
    width = max(sets.maintain_width, narrowest)
    if sets.decrease_slope == 0.0:  # a crisp D
        decrease = np.exp(-0.5 * ((z - sets.decrease_center) / narrowest) ** 2)
    else:
        decrease = 1.0 / (1.0 + np.exp(-sets.decrease_slope * (z - sets.decrease_center)))
    united = np.maximum.reduce(
        [
            np.minimum(
                alpha[0],
                1.0 / (1.0 + np.exp(-sets.increase_slope * (z - sets.increase_center))),
            ),
            np.minimum(alpha[1], np.exp(-0.5 * ((z - sets.maintain_center) / width) ** 2)),
            np.minimum(alpha[2], decrease),
        ]
    )
    weight = np.ones_like(z)
    weight[[0, -1]] = 0.5
    return float(np.sum(weight * z * united) / np.sum(weight * united))


@pytest.mark.parametrize("mismatch", [-80.0, -20.0, -5.0, -0.0467, 0.0, 0.05, 5.0, 20.0, 80.0])
@pytest.mark.parametrize("limit", [200.0, 1000.0])
@pytest.mark.slow
def test_centroid_equals_a_fine_integration(
    either_set: FuzzySets, mismatch: float, limit: float
) -> None:
    # A crisp set is as wide as the sampling, and so is the error of its clipped area.
    for points, tolerance in ((201, 0.01), (4001, 0.001)):
        narrowest = 2.0 * limit / (points - 1)
        expected = integrated_centroid(either_set, mismatch, limit, narrowest)
        result = infer_centroid(either_set, np.array(mismatch), limit, points)
        assert float(result.change) == pytest.approx(expected, abs=tolerance * limit)


@PROPERTY
@given(st.floats(min_value=-1e12, max_value=1e12), st.floats(min_value=1.0, max_value=1e6))
@pytest.mark.slow
def test_centroid_is_finite_and_inside_its_universe(
    either_set: FuzzySets, mismatch: float, limit: float
) -> None:
    result = infer_centroid(either_set, np.array(mismatch), limit)
    assert abs(float(result.change)) <= limit
    assert np.all(np.abs(result.consequent) <= limit)
    assert float(np.sum(result.normalized_firing)) == pytest.approx(1.0, abs=1e-15)


@PROPERTY
@given(st.floats(min_value=100.0, max_value=1e12), st.floats(min_value=500.0, max_value=1e6))
@pytest.mark.slow
def test_centroid_of_the_published_set_has_the_right_sign(
    published: FuzzySets, size: float, limit: float
) -> None:
    assert infer_centroid(published, np.array(size), limit).change < 0.0
    assert infer_centroid(published, np.array(-size), limit).change > 0.0


def test_centroid_of_the_initial_set_decreases_too(initial: FuzzySets) -> None:
    assert infer_centroid(initial, np.array(1e4), 1e3).change < 0.0


def test_centroid_reports_the_same_firing_as_inference(either_set: FuzzySets) -> None:
    D = np.linspace(-50.0, 50.0, 31)
    centroid, tsukamoto = infer_centroid(either_set, D, 1e3), infer(either_set, D)
    np.testing.assert_allclose(centroid.firing_strength, tsukamoto.firing_strength, rtol=1e-15)
    np.testing.assert_allclose(
        centroid.normalized_firing, tsukamoto.normalized_firing, rtol=1e-12, atol=1e-300
    )


def test_batches_equal_one_by_one(either_set: FuzzySets) -> None:
    D = np.random.default_rng(30).uniform(-40.0, 40.0, (3, 4))
    together, centroid = infer(either_set, D), infer_centroid(either_set, D, 500.0)
    gradient = infer_gradient(either_set, D)
    assert gradient.shape == (12, 3, 4)
    for results in (together, centroid):
        assert [part.shape for part in results] == [(3, 4), (3, 3, 4), (3, 3, 4), (3, 3, 4)]
    for i in np.ndindex(3, 4):
        for results, alone in (
            (together, infer(either_set, D[i])),
            (centroid, infer_centroid(either_set, D[i], 500.0)),
        ):
            for one, other in zip(results, alone, strict=True):
                np.testing.assert_allclose(one[..., *i], other, rtol=1e-12, atol=1e-300)
        np.testing.assert_allclose(gradient[:, *i], infer_gradient(either_set, D[i]), rtol=1e-10)
