# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

from collections import deque
from typing import Any

import numpy as np
import pytest

from fnn_ekf_ros.core.window import empty_window, mean_square, push


def test_mean_square_by_hand() -> None:
    window = empty_window(3)
    everything = np.ones(4, dtype=np.bool_)
    for value in (1.0, 2.0, 3.0, 4.0):
        window = push(window, value * np.array([1.0, -1.0, 10.0, 0.5]), everything)
    # The last three: (4 + 9 + 16) / 3
    np.testing.assert_allclose(mean_square(window), 29.0 / 3.0 * np.array([1, 1, 100, 0.25]))
    np.testing.assert_array_equal(window.counts, np.full(4, 3.0))


def test_half_filled_window_averages_what_it_has() -> None:
    window = push(empty_window(10), np.array([2.0, 3.0, 0.0, 1.0]), np.ones(4, dtype=np.bool_))
    np.testing.assert_array_equal(window.counts, np.ones(4))
    np.testing.assert_array_equal(mean_square(window), [4.0, 9.0, 0.0, 1.0])


def test_empty_window_has_no_mean_square_to_speak_of() -> None:
    window = empty_window(5, (2, 3))
    assert window.squares.shape == (5, 4, 2, 3)
    assert window.counts.shape == (4, 2, 3)
    np.testing.assert_array_equal(mean_square(window), np.zeros((4, 2, 3)))


def test_square_grows_with_the_innovation_not_with_its_sign() -> None:
    window = push(empty_window(4), np.array([-2.0, 2.0, 0.0, 0.0]), np.ones(4, dtype=np.bool_))
    assert mean_square(window)[0] == mean_square(window)[1] == 4.0


@pytest.mark.parametrize("length", [1, 7, 45])
@pytest.mark.parametrize("share", [1.0, 0.5, 0.05])
def test_every_row_keeps_its_own_last_innovations(length: int, share: float) -> None:
    """Against one plain deque per run and row."""
    rng = np.random.default_rng(40)
    batch = (2, 3)
    window = empty_window(length, batch)
    plain: dict[tuple[int, ...], deque[float]] = {
        index: deque(maxlen=length) for index in np.ndindex(4, *batch)
    }
    for _ in range(200):
        innovation = rng.standard_normal((4, *batch))
        available = rng.random((4, *batch)) < share
        window = push(window, innovation, available)
        for index, kept in plain.items():
            if available[index]:
                kept.append(float(innovation[index]))
        means = mean_square(window)
        for index, kept in plain.items():
            assert window.counts[index] == len(kept)
            expected = sum(value * value for value in kept) / max(len(kept), 1)
            assert means[index] == pytest.approx(expected, rel=1e-12)


def test_masked_row_keeps_what_it_has_whatever_is_in_its_place() -> None:
    everything = np.ones(4, dtype=np.bool_)
    window = push(empty_window(3), np.array([1.0, 2.0, 3.0, 4.0]), everything)
    left_over = np.array([np.nan, np.inf, 5.0, 6.0])
    after = push(window, left_over, np.array([False, False, True, False]))
    np.testing.assert_array_equal(mean_square(after), [1.0, 4.0, 17.0, 16.0])
    np.testing.assert_array_equal(after.counts, [1.0, 1.0, 2.0, 1.0])


def test_one_huge_innovation_is_forgotten_without_a_trace() -> None:
    everything = np.ones(4, dtype=np.bool_)
    window = push(empty_window(4), np.full(4, 1e100), everything)
    for _ in range(4):
        window = push(window, np.full(4, 0.1), everything)
    np.testing.assert_allclose(mean_square(window), np.full(4, 0.01), rtol=1e-15)


def test_push_changes_none_of_its_arguments() -> None:
    rng = np.random.default_rng(41)
    window = empty_window(5)
    for _ in range(7):
        innovation, available = rng.standard_normal(4), rng.random(4) < 0.5
        arguments: tuple[Any, ...] = (window.squares, window.counts, innovation, available)
        copies = [argument.copy() for argument in arguments]
        for argument in arguments:
            argument.flags.writeable = False
        window = push(window, innovation, available)
        mean_square(window)
        for argument, copy in zip(arguments, copies, strict=True):
            np.testing.assert_array_equal(argument, copy)
