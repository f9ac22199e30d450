# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Truth between its samples, against numbers worked out by hand."""

import math

import numpy as np
import pytest
from localizers import SECOND_NS
from tracks import STRAIGHT, track

from fnn_ekf_ros.timeline.trajectory import interpolate


def test_truth_turns_the_short_way_round() -> None:
    truth = track([0.0, 1.0], [[0, 0, 3.0], [0, 0, -3.0]])
    gap = 2.0 * math.pi - 6.0
    for part in (0.0, 0.25, 0.5, 0.9, 1.0):
        (pose,) = interpolate(truth, np.array([round(part * SECOND_NS)]))
        assert math.cos(pose[2] - (3.0 + part * gap)) == pytest.approx(1.0)


def test_truth_is_interpolated_linearly_and_kept_at_its_samples() -> None:
    times = np.array([0, SECOND_NS // 4, SECOND_NS, 3 * SECOND_NS])
    np.testing.assert_allclose(interpolate(STRAIGHT, times)[:, 0], [0.0, 0.25, 1.0, 3.0])
