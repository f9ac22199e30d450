# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Planar transforms, and map -> odom from poses and somebody else's odometry."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fnn_ekf_ros.timeline.events import STALE_NS
from fnn_ekf_ros.timeline.frames import (
    BUFFER_NS,
    MOST_PENDING,
    MapToOdom,
    Transform,
    TransformBuffer,
    between,
    compose,
    inverse,
)

S = 10**9
POSES = st.tuples(
    st.floats(-50.0, 50.0), st.floats(-50.0, 50.0), st.floats(-math.pi, math.pi)
).map(np.array)  # fmt: skip


def matrix(pose: np.ndarray) -> np.ndarray:
    c, s = math.cos(pose[2]), math.sin(pose[2])
    return np.array([[c, -s, pose[0]], [s, c, pose[1]], [0.0, 0.0, 1.0]])


def at(stamp_ns: int, *pose: float) -> Transform:
    return Transform(stamp_ns, np.array(pose, dtype=np.float64))


@given(POSES, POSES)
def test_composition_and_inverse_are_those_of_matrices(
    first: np.ndarray, second: np.ndarray
) -> None:
    np.testing.assert_allclose(
        matrix(compose(first, second)), matrix(first) @ matrix(second), atol=1e-11
    )
    np.testing.assert_allclose(matrix(inverse(first)) @ matrix(first), np.eye(3), atol=1e-11)


@pytest.mark.parametrize("part", [0.0, 0.25, 0.5, 1.0])
def test_between_two_the_yaw_takes_the_shorter_way(part: float) -> None:
    middle = between(at(0, 1.0, 2.0, 3.0), at(S, 3.0, 0.0, -3.0), round(part * S))
    turn = 2.0 * math.pi - 6.0
    expected = 3.0 + part * turn
    np.testing.assert_allclose(middle[:2], [1.0 + 2.0 * part, 2.0 - 2.0 * part])
    assert math.cos(middle[2] - expected) == pytest.approx(1.0, abs=1e-12)
    assert abs(middle[2]) <= math.pi


def test_a_track_knows_what_lies_between_its_ends_only() -> None:
    track = TransformBuffer()
    assert track.at(S) is None
    for stamp in (2 * S, S, 4 * S):  # not in order
        track.add(at(stamp, stamp / S, 0.0, 0.0))
    assert track.at(S - 1) is None
    assert track.at(4 * S + 1) is None
    for seconds in (1.0, 1.5, 3.0, 4.0):
        found = track.at(round(seconds * S))
        assert found is not None
        assert found[0] == pytest.approx(seconds)


def test_of_two_at_one_instant_the_last_counts() -> None:
    track = TransformBuffer()
    track.add(at(S, 1.0, 0.0, 0.0))
    track.add(at(S, 2.0, 0.0, 0.0))
    found = track.at(S)
    assert found is not None
    assert found[0] == 2.0


def test_a_track_forgets_what_is_old_and_begins_anew_when_the_clock_is_set_back() -> None:
    track = TransformBuffer()
    for second in range(100):
        track.add(at(second * S, 0.0, 0.0, 0.0))
    assert track.at(99 * S - BUFFER_NS) is not None
    assert track.at(99 * S - BUFFER_NS - 1) is None
    track.add(at(98 * S, 6.0, 0.0, 0.0))
    assert track.at(99 * S) is not None
    for second in (96, 5):
        track.add(at(second * S, 7.0, 0.0, 0.0))
        assert track.at(99 * S) is None
        found = track.at(second * S)
        assert found is not None
        assert found[0] == 7.0


def test_map_to_odom_puts_the_base_where_the_localizer_says() -> None:
    """Odometry that drifts: at each pose, map -> odom -> base is map -> base."""
    rng = np.random.default_rng(3)
    joined = MapToOdom()
    for step in range(1, 40):
        odom = at(step * S, *rng.normal(0.0, 3.0, 3))
        base = at(step * S, *rng.normal(0.0, 3.0, 3))
        assert joined.moved(odom) == []
        (answer,) = joined.located(base)
        assert answer.stamp_ns == step * S
        np.testing.assert_allclose(
            matrix(compose(answer.pose, odom.pose)), matrix(base.pose), atol=1e-11
        )


def test_a_pose_waits_for_odometry_and_is_answered_once() -> None:
    joined = MapToOdom()
    joined.moved(at(0, 0.0, 0.0, 0.0))
    assert joined.located(at(2 * S, 5.0, 0.0, 0.0)) == []
    assert joined.located(at(3 * S, 6.0, 0.0, 0.0)) == []
    assert joined.moved(at(S, 0.0, 0.0, 0.0)) == []
    answers = joined.moved(at(4 * S, 3.0, 0.0, 0.0))
    assert [answer.stamp_ns for answer in answers] == [2 * S, 3 * S]
    np.testing.assert_allclose([a.pose[0] for a in answers], [5.0 - 1.0, 6.0 - 2.0])
    assert joined.moved(at(5 * S, 3.0, 0.0, 0.0)) == []


def test_only_the_newest_few_wait() -> None:
    joined = MapToOdom()
    for second in range(1, MOST_PENDING + 4):
        assert joined.located(at(second * S, 0.0, 0.0, 0.0)) == []
    joined.moved(at(0, 0.0, 0.0, 0.0))
    answers = joined.moved(at(100 * S, 0.0, 0.0, 0.0))
    assert answers == []  # the two are too far apart: the first is forgotten
    for second in range(3, 14):
        joined.located(at((100 + second) * S, 0.0, 0.0, 0.0))
    answers = joined.moved(at(108 * S, 0.0, 0.0, 0.0))
    assert [answer.stamp_ns // S for answer in answers] == [106, 107, 108]


def test_odometry_that_never_comes_is_missed_after_a_while() -> None:
    joined = MapToOdom()
    for tenth in range(31):
        joined.located(at(S + tenth * S // 10, 0.0, 0.0, 0.0))
        assert joined.missing_ns == 0
    joined.located(at(S + STALE_NS + 1, 0.0, 0.0, 0.0))
    assert joined.missing_ns == STALE_NS + 1
    joined.moved(at(0, 0.0, 0.0, 0.0))
    joined.moved(at(S + STALE_NS + 1, 0.0, 0.0, 0.0))
    assert joined.missing_ns == 0


def test_poses_after_the_clock_was_set_back_do_not_wait_for_those_before() -> None:
    joined = MapToOdom()
    joined.located(at(100 * S, 0.0, 0.0, 0.0))
    joined.located(at(S, 1.0, 0.0, 0.0))
    joined.moved(at(S, 0.0, 0.0, 0.0))
    assert [answer.stamp_ns for answer in joined.moved(at(100 * S, 0.0, 0.0, 0.0))] == []
    assert joined.missing_ns == 0
