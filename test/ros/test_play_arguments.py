# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""What the command play refuses before it plays."""

from collections.abc import Callable

import pytest
from places import BAGS

from fnn_ekf_ros import messages

LONG = 300 * "a"


@pytest.mark.parametrize("name", ["", "/", "a b", "1x", LONG, "a//b", "a/", "a\n", "a-b", "~", "é"])
def test_a_name_that_ros_does_not_allow(refuse: Callable[..., str], name: str) -> None:
    pytest.importorskip("rclpy")
    line = refuse("play", BAGS / "round", "--keep-pace-with", name)
    assert line == f"play: --keep-pace-with {name[:80]!r}: expected a topic's name"


@pytest.mark.parametrize("name", ["odom", "/odom", "/robot_1/odom", "_a/b1", "/" + 246 * "a"])
def test_a_name_that_ros_allows(name: str) -> None:
    validate = pytest.importorskip("rclpy.validate_full_topic_name").validate_full_topic_name
    assert messages.is_topic_name(name)
    assert validate(messages.absolute_name(name))


def test_one_character_too_many() -> None:
    assert messages.is_topic_name(246 * "a")
    assert not messages.is_topic_name(247 * "a")
