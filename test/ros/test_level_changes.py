# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Which changes of level are logged."""

from fnn_ekf_ros.ros.level_changes import LevelChanges
from fnn_ekf_ros.timeline.events import Level, Status


def status(level: Level) -> Status:
    return Status("filter", level, "words", ())


def test_a_change_is_logged_once() -> None:
    changes = LevelChanges(10.0)
    levels = [Level.OK, Level.WARN, Level.WARN, Level.ERROR, Level.OK, Level.OK]
    told = [changes.worth_a_line([status(level)], float(s)) for s, level in enumerate(levels)]
    assert [len(lines) for lines in told] == [0, 1, 0, 1, 1, 0]
    assert told[1] == [status(Level.WARN)]


def test_a_change_that_comes_too_soon_is_logged_in_the_end_if_it_lasts() -> None:
    changes = LevelChanges(10.0)
    levels = [Level.WARN, Level.OK, *[Level.WARN] * 20]
    told = [s for s, level in enumerate(levels) if changes.worth_a_line([status(level)], float(s))]
    assert told == [0, 1, 10]


def test_what_flickers_does_not_fill_the_log() -> None:
    changes = LevelChanges(10.0)
    told = [s for s in range(40) if changes.worth_a_line([status(Level(s % 2))], float(s))]
    assert told == [1, 2, 11, 12, 21, 22, 31, 32]
