# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from drives import UNEVEN_Q as Q
from drives import UNEVEN_R as R
from hypothesis import given, settings
from hypothesis import strategies as st
from periods import ALL_ROWS

from fnn_ekf_ros.core.adaptation import (
    LARGEST_DECREASE,
    Adaptation,
    Adapted,
    FuzzyNetwork,
    Scales,
    adapt,
)
from fnn_ekf_ros.core.arrays import BoolArray, FloatArray
from fnn_ekf_ros.core.bounds import NoiseBounds
from fnn_ekf_ros.core.fuzzy import FuzzySets, infer, infer_centroid
from fnn_ekf_ros.core.window import InnovationWindow, empty_window, mean_square, push

PROPERTY = settings(derandomize=True, deadline=None, database=None, max_examples=200)

DISTANCE, ROTATION = 0, 1
AS_IN_USE = Scales(process=1.0, measurement=np.ones(4))
"""The noise in use is the noise that is adapted."""
TIGHT = NoiseBounds((1e-4, 1e-4), (1e-3, 1e-3), (5e-3,) * 4, (3e-2,) * 4)


def filled_window(squares: FloatArray, length: int = 45, filled: int = 45) -> InnovationWindow:
    """Return a window whose mean squares are `squares`, from so many innovations."""
    window = empty_window(length)
    for _ in range(filled):
        window = push(window, np.sqrt(squares), ALL_ROWS)
    return window


def run(
    adaptation: Adaptation,
    S: FloatArray,
    C: FloatArray,
    available: BoolArray = ALL_ROWS,
    heading: float = 0.4,
    filled: int = 45,
    scales: Scales = AS_IN_USE,
) -> Adapted:
    window = filled_window(C, filled=filled)
    return adapt(adaptation, Q, R, window, S, available, np.array(heading), scales)


S = np.array([0.020, 0.030, 0.040, 0.050])
C_HAT = np.array([0.021, 0.029, 0.0405, 0.047])


@pytest.mark.parametrize("kind", ["tsukamoto", "centroid"])
def test_mode_r_moves_every_row_by_its_fuzzy_output_in_its_unit(
    make_adaptation: Callable[..., Adaptation], either_set: FuzzySets, kind: str
) -> None:
    adaptation = make_adaptation(
        mode="r", kind=kind, sets=either_set, position_unit=2e-6, yaw_unit=5e-7
    )
    after = run(adaptation, S, C_HAT)
    unit = np.array([2e-6, 2e-6, 5e-7, 5e-7])
    np.testing.assert_allclose(after.mismatch, S - C_HAT, rtol=1e-9)
    for row in range(4):
        D = after.mismatch[row] / unit[row]
        inference = (
            infer(either_set, D)
            if kind == "tsukamoto"
            else infer_centroid(either_set, D, adaptation.networks.measurement.change_limit)
        )
        expected = max(R[row] + float(inference.change) * unit[row], 0.25 * R[row])
        assert after.measurement_noise[row] == pytest.approx(expected, rel=1e-12)
        np.testing.assert_allclose(after.firing_strength[:, row], inference.firing_strength)
    assert after.process_noise.tobytes() == Q.tobytes()


def test_mode_r_in_millimeters_by_hand(make_adaptation: Callable[..., Adaptation]) -> None:
    """C_hat 1000 mm^2 above S: I at 24.2 + .1515 / .103 * (1000 - 13.8108) = 1474.76 mm^2."""
    after = run(make_adaptation(mode="r"), S, S + 1e-3)
    np.testing.assert_allclose(after.measurement_noise - R, 1474.76e-6, rtol=1e-5)


def test_one_row_does_not_touch_the_others(make_adaptation: Callable[..., Adaptation]) -> None:
    base = run(make_adaptation(mode="r"), S, C_HAT).measurement_noise
    for row in range(4):
        C = C_HAT.copy()
        C[row] += 1e-3
        moved = run(make_adaptation(mode="r"), S, C).measurement_noise != base
        np.testing.assert_array_equal(np.flatnonzero(moved), [row])


@pytest.mark.parametrize("heading", [0.0, 0.4, math.pi / 2.0, 2.0, -3.0])
def test_mode_q_projects_the_mismatch_on_the_way(
    make_adaptation: Callable[..., Adaptation], published: FuzzySets, heading: float
) -> None:
    adaptation = make_adaptation(mode="q", position_unit=2e-6, yaw_unit=5e-7)
    C = S + np.array([1e-4, 3e-4, 2e-4, 5e-4])
    after = run(adaptation, S, C, heading=heading)
    D = after.mismatch
    along = D[0] * math.cos(heading) ** 2 + D[1] * math.sin(heading) ** 2
    change = [
        float(infer(published, np.array(along / 2e-6)).change) * 2e-6,
        float(infer(published, np.array(D[2] / 5e-7)).change) * 5e-7,
    ]
    np.testing.assert_allclose(after.process_noise, Q + change, rtol=1e-12)
    assert after.measurement_noise.tobytes() == R.tobytes()
    for axis, argument in ((DISTANCE, along / 2e-6), (ROTATION, D[2] / 5e-7)):
        np.testing.assert_allclose(
            after.process_firing_strength[:, axis],
            infer(published, np.array(argument)).firing_strength,
        )
    in_rows = np.zeros((3, 4))
    in_rows[:, [0, 2]] = after.process_firing_strength
    np.testing.assert_array_equal(after.firing_strength, in_rows)


def test_mode_q_by_centroid(
    make_adaptation: Callable[..., Adaptation], published: FuzzySets
) -> None:
    adaptation = make_adaptation(mode="q", kind="centroid")
    after = run(adaptation, S, S + 1e-4, heading=0.0)
    change = float(infer_centroid(published, after.mismatch[0] / 1e-6, 1e4).change) * 1e-6
    assert change > 0.0
    np.testing.assert_allclose(after.process_noise, Q + change, rtol=1e-9)


@pytest.mark.parametrize(
    ("rows", "distance_moves", "yaw_row"),
    [
        ([0, 1, 2, 3], True, 2),
        ([0, 1, 3], True, 3),
        ([0, 2], False, 2),
        ([1, 3], False, 3),
        ([0, 1], True, None),
        ([], False, None),
    ],
)
def test_mode_q_uses_only_what_was_measured(
    make_adaptation: Callable[..., Adaptation],
    published: FuzzySets,
    rows: list[int],
    distance_moves: bool,
    yaw_row: int | None,
) -> None:
    """Distance needs both x and y; rotation the compass, else the laser's yaw."""
    available = np.isin(np.arange(4), rows)
    C = S + np.array([1e-4, 1e-4, 2e-4, 5e-4])
    after = run(make_adaptation(mode="q"), S, C, available)
    assert (after.process_noise[0] != Q[0]) == distance_moves
    assert np.any(after.process_firing_strength[:, DISTANCE] != 0.0) == distance_moves
    assert np.any(after.process_firing_strength[:, ROTATION] != 0.0) == (yaw_row is not None)
    if yaw_row is None:
        assert after.process_noise[1] == Q[1]
    else:
        change = float(infer(published, after.mismatch[yaw_row] / 1e-6).change) * 1e-6
        assert after.process_noise[1] == pytest.approx(Q[1] + change, rel=1e-12)


@pytest.mark.parametrize("mode", ["r", "q", "rq"])
def test_nothing_moves_without_a_measurement(
    make_adaptation: Callable[..., Adaptation], mode: str
) -> None:
    after = run(make_adaptation(mode=mode), S, C_HAT + 1.0, np.zeros(4, dtype=np.bool_))
    assert after.process_noise.tobytes() == Q.tobytes()
    assert after.measurement_noise.tobytes() == R.tobytes()
    assert np.all(after.firing_strength == 0.0)
    assert np.all(after.process_firing_strength == 0.0)


@pytest.mark.parametrize("row", range(4))
def test_mode_r_leaves_unmeasured_rows_bit_for_bit(
    make_adaptation: Callable[..., Adaptation], row: int
) -> None:
    available = np.arange(4) != row
    after = run(make_adaptation(mode="r"), S, C_HAT + 1e-3, available)
    unmoved = after.measurement_noise == R
    np.testing.assert_array_equal(unmoved, ~available)
    assert np.all(after.firing_strength[:, row] == 0.0)
    assert np.all(after.firing_strength[:, available].sum(axis=0) > 0.0)


@pytest.mark.parametrize(("filled", "teaches"), [(1, False), (14, False), (15, True), (45, True)])
@pytest.mark.parametrize("mode", ["r", "q", "rq"])
def test_row_teaches_once_a_third_of_its_window_is_filled(
    make_adaptation: Callable[..., Adaptation], mode: str, filled: int, teaches: bool
) -> None:
    after = run(make_adaptation(mode=mode), S, C_HAT + 1e-3, filled=filled)
    assert np.all((after.measurement_noise != R) == (teaches and "r" in mode))
    assert np.all((after.process_noise != Q) == (teaches and "q" in mode))


@pytest.mark.parametrize("kind", ["tsukamoto", "centroid"])
def test_mode_rq_moves_both_by_the_same_mismatch_each_by_its_own_network(
    make_adaptation: Callable[..., Adaptation], initial: FuzzySets, kind: str
) -> None:
    """R as mode r, Q as mode q, bit for bit: neither knows what the other one did."""
    process = FuzzyNetwork(initial, 2e-6, 5e-7, change_limit=2e3)
    C = S + np.array([1e-4, -3e-4, 2e-4, 5e-4])
    alone = {
        mode: run(make_adaptation(mode=mode, kind=kind, process=process), S, C)
        for mode in ("r", "q")
    }
    both = run(make_adaptation(mode="rq", kind=kind, process=process), S, C)
    assert both.measurement_noise.tobytes() == alone["r"].measurement_noise.tobytes()
    assert both.firing_strength.tobytes() == alone["r"].firing_strength.tobytes()
    assert both.process_noise.tobytes() == alone["q"].process_noise.tobytes()
    assert both.process_firing_strength.tobytes() == alone["q"].process_firing_strength.tobytes()
    shared = run(make_adaptation(mode="rq", kind=kind), S, C)
    assert np.all(both.process_noise != Q)
    assert np.all(shared.process_noise != both.process_noise)
    assert shared.measurement_noise.tobytes() == both.measurement_noise.tobytes()


def test_mode_none_leaves_the_noise_bit_for_bit_and_still_reports_the_mismatch(
    make_adaptation: Callable[..., Adaptation],
) -> None:
    after = run(make_adaptation(mode="none", bounds=TIGHT), S, C_HAT + 1.0)
    assert after.process_noise.tobytes() == Q.tobytes()
    assert after.measurement_noise.tobytes() == R.tobytes()
    np.testing.assert_allclose(after.mismatch, S - C_HAT - 1.0, rtol=1e-12)
    assert np.all(after.firing_strength == 0.0)


def test_rows_that_have_seen_nothing_have_no_mismatch(
    make_adaptation: Callable[..., Adaptation],
) -> None:
    window = push(empty_window(45), np.ones(4), np.array([True, False, True, False]))
    after = adapt(make_adaptation(mode="r"), Q, R, window, S, ALL_ROWS, np.array(0.0), AS_IN_USE)
    np.testing.assert_allclose(after.mismatch, [S[0] - 1.0, 0.0, S[2] - 1.0, 0.0])


@pytest.mark.parametrize("mode", ["r", "q", "rq"])
def test_one_step_takes_away_three_quarters_at_most(
    make_adaptation: Callable[..., Adaptation], mode: str
) -> None:
    assert LARGEST_DECREASE == 0.75
    after = run(make_adaptation(mode=mode), S + 10.0, C_HAT)
    np.testing.assert_allclose(
        after.measurement_noise, R * (0.25 if "r" in mode else 1.0), rtol=1e-14
    )
    np.testing.assert_allclose(after.process_noise, Q * (0.25 if "q" in mode else 1.0), rtol=1e-14)


@pytest.mark.parametrize("mode", ["r", "q", "rq"])
@pytest.mark.parametrize("excess", [10.0, -10.0])
def test_bounds_hold(make_adaptation: Callable[..., Adaptation], mode: str, excess: float) -> None:
    after = run(make_adaptation(mode=mode, bounds=TIGHT), S + np.maximum(excess, 0.0),
                C_HAT + np.maximum(-excess, 0.0))  # fmt: skip
    if "r" in mode:
        limit = TIGHT.measurement_min if excess > 0.0 else TIGHT.measurement_max
        np.testing.assert_array_equal(after.measurement_noise, limit)
    if "q" in mode:
        limit = TIGHT.process_min if excess > 0.0 else TIGHT.process_max
        np.testing.assert_array_equal(after.process_noise, limit)


def test_each_variance_has_its_own_bound(make_adaptation: Callable[..., Adaptation]) -> None:
    bounds = NoiseBounds((1e-5, 2e-5), (3e-2, 4e-2), (1e-5,) * 4, (0.02, 0.03, 0.04, 0.05))
    raised = run(make_adaptation(mode="r", bounds=bounds), S, C_HAT + 1.0)
    np.testing.assert_array_equal(raised.measurement_noise, bounds.measurement_max)
    raised = run(make_adaptation(mode="q", bounds=bounds), S, C_HAT + 1.0)
    np.testing.assert_array_equal(raised.process_noise, bounds.process_max)


MAGNITUDE = st.one_of(
    st.just(0.0),
    st.floats(min_value=0.0, max_value=1.0),
    st.floats(min_value=-150.0, max_value=140.0).map(lambda exponent: 10.0**exponent),
)


@PROPERTY
@given(
    st.sampled_from(["r", "q", "rq"]),
    st.sampled_from(["tsukamoto", "centroid"]),
    st.lists(st.tuples(MAGNITUDE, MAGNITUDE, MAGNITUDE, MAGNITUDE), min_size=1, max_size=8),
    st.integers(min_value=1, max_value=15),
    st.floats(min_value=-4.0, max_value=4.0),
)
@pytest.mark.slow
def test_noise_stays_positive_and_inside_its_bounds_whatever_comes(
    make_adaptation: Callable[..., Adaptation],
    either_set: FuzzySets,
    mode: str,
    kind: str,
    innovations: list[tuple[float, ...]],
    seen: int,
    heading: float,
) -> None:
    adaptation = make_adaptation(
        mode=mode, kind=kind, sets=either_set, window_length=3, bounds=TIGHT
    )
    window, process_noise, measurement_noise = empty_window(3), Q, R
    available = np.array([bool(seen & 1 << row) for row in range(4)])
    # The exponent of a Gaussian that is nowhere near may overflow to -inf: a firing of 0.
    with np.errstate(over="ignore"):
        for innovation in innovations:
            window = push(window, np.array(innovation), available)
            after = adapt(
                adaptation, process_noise, measurement_noise, window, measurement_noise + 1e-3,
                available, np.array(heading), AS_IN_USE,
            )  # fmt: skip
            process_noise, measurement_noise = after.process_noise, after.measurement_noise
            for noise, low, high in (
                (process_noise, TIGHT.process_min, TIGHT.process_max),
                (measurement_noise, TIGHT.measurement_min, TIGHT.measurement_max),
            ):
                assert np.all(np.isfinite(noise))
                assert np.all((noise >= np.array(low)) & (noise <= np.array(high)))
            assert np.all(np.isfinite(after.firing_strength))
            assert np.all(np.isfinite(after.process_firing_strength))


@pytest.mark.parametrize("kind", ["tsukamoto", "centroid"])
def test_change_of_the_noise_in_use_is_divided_by_its_scale(
    make_adaptation: Callable[..., Adaptation], kind: str
) -> None:
    """Reports of a sensor move by more than the noise that is adapted, or by less."""
    C = S + np.array([1e-4, 2e-4, 2e-4, 5e-4])
    adaptation = make_adaptation(mode="rq", kind=kind)
    scales = Scales(process=4.0, measurement=np.array([0.5, 2.0, 8.0, 1.0]))
    plain, scaled = run(adaptation, S, C), run(adaptation, S, C, scales=scales)
    change = plain.measurement_noise - R
    assert np.all(change > 0.0)
    np.testing.assert_allclose(scaled.measurement_noise - R, change / scales.measurement, rtol=1e-9)
    np.testing.assert_allclose(
        scaled.process_noise - Q, (plain.process_noise - Q) / scales.process, rtol=1e-9
    )
    for one, other in zip(plain[2:], scaled[2:], strict=True):
        assert one.tobytes() == other.tobytes()


@pytest.mark.parametrize("mode", ["r", "q", "rq"])
def test_learning_that_is_off_leaves_the_noise_and_still_reports_the_mismatch(
    make_adaptation: Callable[..., Adaptation], mode: str
) -> None:
    adaptation = replace(make_adaptation(mode=mode, bounds=TIGHT), learning=False)
    after = run(adaptation, S, C_HAT + 1.0)
    assert after.process_noise.tobytes() == Q.tobytes()
    assert after.measurement_noise.tobytes() == R.tobytes()
    np.testing.assert_allclose(after.mismatch, S - C_HAT - 1.0, rtol=1e-12)
    assert not np.any(after.firing_strength)
    assert not np.any(after.process_firing_strength)


@pytest.mark.parametrize("mode", ["none", "r", "q", "rq"])
def test_batches_equal_one_by_one_and_arguments_are_not_changed(
    make_adaptation: Callable[..., Adaptation], mode: str
) -> None:
    rng = np.random.default_rng(50)
    batch = (2, 3)
    adaptation = make_adaptation(mode=mode, window_length=6)
    window = empty_window(6, batch)
    for _ in range(5):
        window = push(window, 0.2 * rng.standard_normal((4, *batch)), rng.random((4, *batch)) < 0.7)
    process_noise = Q[:, None, None] * rng.uniform(0.5, 2.0, (2, *batch))
    measurement_noise = R[:, None, None] * rng.uniform(0.5, 2.0, (4, *batch))
    variance = 2.0 * measurement_noise
    available, heading = rng.random((4, *batch)) < 0.7, rng.uniform(-3.0, 3.0, batch)
    scale = rng.uniform(0.5, 2.0, (4, *batch))
    for array in (process_noise, measurement_noise, *window, variance, available, heading, scale):
        array.flags.writeable = False
    together = adapt(
        adaptation, process_noise, measurement_noise, window, variance, available, heading,
        Scales(2.0, scale),
    )  # fmt: skip
    assert together.firing_strength.shape == (3, 4, *batch)
    assert together.process_firing_strength.shape == (3, 2, *batch)
    for i in np.ndindex(*batch):
        alone = adapt(
            adaptation, process_noise[:, *i], measurement_noise[:, *i],
            InnovationWindow(window.squares[:, :, *i], window.counts[:, *i]),
            variance[:, *i], available[:, *i], heading[i], Scales(2.0, scale[:, *i]),
        )  # fmt: skip
        for one, other in zip(together, alone, strict=True):
            np.testing.assert_allclose(one[..., *i], other, rtol=1e-12, atol=1e-300)
    assert np.all(mean_square(window) >= 0.0)
