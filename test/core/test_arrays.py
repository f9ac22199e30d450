# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Components come first, then the filters of a bank, then the batch."""

from typing import NamedTuple

import numpy as np
import pytest

from fnn_ekf_ros.core.arrays import (
    Constant,
    FloatArray,
    against,
    components_first,
    components_last,
    diagonal_of,
    select,
    symmetrize,
    transpose,
)
from fnn_ekf_ros.core.bounds import NoiseBounds

BOUNDS = NoiseBounds((1e-5, 2e-5), (3e-2, 4e-2), (1e-6, 2e-6, 3e-6, 4e-6), (0.02, 0.03, 0.04, 0.05))


def test_matrices_are_those_of_each_filter_and_robot() -> None:
    rng = np.random.default_rng(1)
    M = rng.standard_normal((3, 3, 2, 4))
    for i in np.ndindex(2, 4):
        one = M[:, :, *i]
        np.testing.assert_array_equal(transpose(M)[:, :, *i], one.T)
        np.testing.assert_array_equal(symmetrize(M)[:, :, *i], 0.5 * (one + one.T))
        np.testing.assert_array_equal(diagonal_of(M)[:, *i], np.diag(one))


@pytest.mark.parametrize("count", [1, 2])
def test_components_go_first_and_come_back(count: int) -> None:
    array = np.arange(2.0 * 5 * 3 * 4).reshape(2, 5, 3, 4)
    first = components_first(array, count)
    assert first.shape == ((4, 2, 5, 3) if count == 1 else (3, 4, 2, 5))
    assert np.shares_memory(first, array)
    np.testing.assert_array_equal(components_last(first, count), array)
    index = (3, 1, 4, 2) if count == 1 else (2, 3, 1, 4)
    assert first[index] == array[1, 4, 2, 3]


@pytest.mark.parametrize("dimensions", [0, 1, 3])
def test_constants_go_with_arrays_of_filters_and_batch(dimensions: int) -> None:
    values = np.array([[1.0, 2.0], [3.0, 4.0], [5.0, 6.0]])
    constant = Constant(values)
    for _ in range(2):
        shaped = constant.behind(dimensions)
        assert shaped.shape == (3, 2, *(1,) * dimensions)
        np.testing.assert_array_equal(shaped.reshape(3, 2), values)
    assert against([1.0, 2.0], np.zeros((2, *(7,) * dimensions))).shape == (2, *(1,) * dimensions)


class Pair(NamedTuple):
    array: FloatArray
    nothing: None
    inner: "Pair | None"


def test_select_takes_each_robot_from_one_of_two() -> None:
    where = np.array([True, False, True])
    one = Pair(np.ones((2, 4, 3)), None, Pair(np.ones(3), None, None))
    other = Pair(np.zeros((2, 4, 3)), None, Pair(np.zeros(3), None, None))
    chosen = select(where, one, other)
    assert isinstance(chosen, Pair)
    np.testing.assert_array_equal(chosen.array, np.broadcast_to([1.0, 0.0, 1.0], (2, 4, 3)))
    assert chosen.nothing is None
    np.testing.assert_array_equal(chosen.inner.array, [1.0, 0.0, 1.0])


@pytest.mark.parametrize("batch", [(), (3,), (2, 3)])
def test_bounds_hold_each_variance_to_its_own_limits(batch: tuple[int, ...]) -> None:
    low, high = (limit.behind(0) for limit in BOUNDS.all_limits())
    np.testing.assert_array_equal(low, [*BOUNDS.process_min, *BOUNDS.measurement_min])
    np.testing.assert_array_equal(high, [*BOUNDS.process_max, *BOUNDS.measurement_max])
    for factor in (1e-9, 1.0, 1e9):
        given = factor * np.sqrt(low * high).reshape(6, *(1,) * len(batch)) * np.ones(batch)
        expected = np.clip(np.moveaxis(given, 0, -1), low, high)
        held = np.concatenate(BOUNDS.within(given[:2], given[2:]))
        assert held.shape == (6, *batch)
        np.testing.assert_array_equal(np.moveaxis(held, 0, -1), expected)
