# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The fault matrix: what is read off a recorded run, and how it is put into a table."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from faults.matrix import Said, back_after, fault_effect, missing_odom, moved, news, window
from faults.scenarios import FaultScenario, Remark, Run, read_run, robot_times
from faults.tables import document, draw

from fnn_ekf_ros import messages
from fnn_ekf_ros.errors import FnnEkfError
from fnn_ekf_ros.messages import Message
from fnn_ekf_ros.parameters.faults import ClockJump
from fnn_ekf_ros.recordings.bag_writer import BagWriter
from fnn_ekf_ros.timeline.events import Level, Status
from fnn_ekf_ros.timeline.trajectory import Trajectory

KIDNAP = FaultScenario(
    "kidnap", "carried", ({"fault": "kidnap", "start": 30.0, "move": [1, 0, 0]},)
)
DROPOUT = FaultScenario(
    "dropout", "cable",
    ({"fault": "dropout", "topic": "compass", "start": 30.0, "duration": 20.0},),
)  # fmt: skip
NO_FAULT = FaultScenario("no fault", "nothing")


def track(seconds: np.ndarray, x: np.ndarray | float = 0.0) -> Trajectory:
    pose = np.zeros((len(seconds), 3))
    pose[:, 0] = x
    return Trajectory(
        np.round(seconds * 1e9).astype(np.int64), pose, np.tile(np.eye(3), (len(seconds), 1, 1))
    )


def run(error: np.ndarray | float = 0.0, remarks: tuple[Remark, ...] = ()) -> Run:
    """A robot that stands in the origin, and an odom that is off by `error` along x."""
    return Run(track(PERIODS, error), track(np.arange(0.125, 90.001, 0.125)), remarks, finite=True)


PERIODS = 0.375 * np.arange(14, 240)


@pytest.mark.parametrize(
    ("size", "stamps", "expected"),
    [
        (None, [29.0, 30.0, 31.0], [29.0, 30.0, 31.0]),
        (30.0, [29.0, 30.0, 45.0, 60.125, 61.0], [29.0, 30.0, math.nan, 30.125, 31.0]),
        (-10.0, [29.0, 30.0, 20.125, 29.0, 31.0], [29.0, 30.0, 30.125, 39.0, 41.0]),
        (-0.5, [29.0, 29.875, 30.25], [29.0, 29.875, 30.75]),  # an output that never went back
    ],
)
def test_robot_time_sees_through_a_jump_of_the_clock(
    size: float | None, stamps: list[float], expected: list[float]
) -> None:
    jump = None if size is None else ClockJump(start=30.0, size=size)
    times = robot_times([round(stamp * 1e9) for stamp in stamps], jump)
    np.testing.assert_array_equal(times, expected)


def test_a_window_holds_its_begin_and_not_its_end() -> None:
    error = np.where(PERIODS < 30.0, 0.1, np.where(PERIODS < 50.25, 3.0, 0.2))
    error[np.searchsorted(PERIODS, 45.0)] = 5.0
    before, during = window(run(error), 15.0, 30.0), window(run(error), 30.0, 50.0)
    assert before == pytest.approx((0.1, 0.1, 0.01))
    assert during.largest == 5.0
    assert during.rmse == pytest.approx(math.sqrt((53 * 9.0 + 25.0) / 54))
    assert all(math.isnan(value) for value in window(run(), 200.0, 300.0))


def test_missing_odom_is_counted_at_both_ends_and_in_between() -> None:
    assert missing_odom(track(PERIODS), 30.0, 88.875) == 0
    shifted = track(PERIODS + 0.1)  # after a jump of the clock
    assert missing_odom(shifted, 30.0, 88.875) == 0
    odd = [p for p in PERIODS if not (40.0 < p < 42.0 or p < 31.0 or p > 88.0)]
    assert missing_odom(track(np.array(odd)), 30.0, 88.875) == 3 + 5 + 2
    assert missing_odom(track(PERIODS[:0]), 30.0, 60.0) == 80


def test_moved_compares_runs_that_were_the_same_before() -> None:
    later = np.where(PERIODS > 40.0, 0.25, 0.0)
    assert moved(run(later), run()) == pytest.approx(0.25)
    assert math.isnan(moved(run(0.002), run())), "they differ before the fault already"
    elsewhere = run()._replace(truth=track(np.arange(0.125, 90.001, 0.125), 0.1))
    assert math.isnan(moved(elsewhere, run())), "the robot drove elsewhere"


def test_news_are_told_once() -> None:
    ok = Remark(20.0, "compass", Level.OK, "received")
    remarks = (
        Remark(6.0, "filter", Level.WARN, "waiting for the first yaw"),
        ok,
        Remark(31.0, "compass", Level.WARN, "silent"),
        Remark(32.0, "compass", Level.WARN, "silent"),
        Remark(33.0, "compass", Level.ERROR, "silent"),
        ok._replace(time_s=34.0),
        Remark(35.0, "filter", Level.WARN, "waiting for the first yaw"),
    )
    assert news(remarks) == (
        Said(1.0, "compass", Level.WARN, "silent"),
        Said(3.0, "compass", Level.ERROR, "silent"),
        Said(5.0, "filter", Level.WARN, "waiting for the first yaw"),
    )


def test_back_after_the_last_bad_one() -> None:
    times = [10.0, 20.0, 30.0, 40.0]
    assert back_after(times, [True, False, False, False], 15.0) == 0.0
    assert back_after(times, [True, False, True, False], 15.0) == 25.0
    assert math.isnan(back_after(times, [False, False, False, True], 15.0))


def test_the_effect_counts_from_the_end_of_the_fault() -> None:
    usual = run(0.1)
    error = np.where((PERIODS >= 30.0) & (PERIODS < 56.25), 1.0, 0.1)
    remarks = tuple(
        Remark(float(t), "compass", Level.WARN if 33 <= t <= 52 else Level.OK, f"{t}")
        for t in range(1, 90)
    )
    lasting = fault_effect(DROPOUT, run(error, remarks), usual)
    assert (lasting.recovered_s, lasting.fine_s) == (6.25, 3.0)
    assert (lasting.before.rmse, lasting.during.rmse) == pytest.approx((0.1, 1.0))
    assert lasting.moved == pytest.approx(0.9)
    assert fault_effect(DROPOUT, run(error, remarks), usual, run(error)).moved == 0.0
    instant = fault_effect(KIDNAP, run(error, remarks), usual)
    assert (instant.recovered_s, instant.fine_s) == (26.25, 23.0)
    assert fault_effect(DROPOUT, run(0.14), usual).recovered_s == 0.0


def test_document_and_picture_show_every_row(tmp_path: Path) -> None:
    said = (Remark(31.0, "compass", Level.WARN, "a | b"),)
    effect = fault_effect(DROPOUT, run(0.2, said), run(0.1))
    text = document(
        [(DROPOUT, effect._replace(finite=False)), (KIDNAP, fault_effect(KIDNAP, run(), run()))],
        run(0.1), "v1", "p.png",
    )  # fmt: skip
    rows = [line for line in text.splitlines() if line.startswith("| **")]
    assert rows[0].startswith("| **dropout**<br>cable | `dropout` topic: compass | compass **WARN")
    assert "a \\| b (1.0)" in rows[0]
    assert "| nothing new |" in rows[1]
    assert "(fnn_ekf_ros v1)" in text
    assert "finite, but for: dropout." in text
    assert "above 0.15 m" in text
    assert "**`kidnap`**" in text, "the vocabulary"
    columns = {line.replace("\\|", "").count("|") for line in rows[:2]}
    assert columns == {12}
    pytest.importorskip("matplotlib")
    draw(tmp_path / "p.png", [(NO_FAULT, run(0.1)), (KIDNAP, run(0.3)), (DROPOUT, run())])
    assert (tmp_path / "p.png").read_bytes().startswith(b"\x89PNG")


class Bag:
    """A recorded run of the matrix, written by hand: truth in the origin, odom 0.1 m off it."""

    def __init__(self) -> None:
        self.entries: list[tuple[str, Message]] = []
        self.odom: dict[float, Message] = {}
        for step in range(1, 721):
            stamp_ns = step * 125_000_000
            self.entries.append(("/ground_truth", self.odometry(stamp_ns, 0.0)))
            if step % 3 == 0 and step > 42:
                self.odom[stamp_ns / 1e9] = self.odometry(stamp_ns, 0.1)
                self.entries.append(("/odom", self.odom[stamp_ns / 1e9]))
            if step % 8 == 0:
                status = Status("compass", Level.OK, "received", ())
                self.entries.append(
                    ("/diagnostics", messages.diagnostics(stamp_ns, "localizer", (status,)))
                )

    @staticmethod
    def odometry(stamp_ns: int, x: float) -> Message:
        pose = np.array([x, 0.0, 0.0])
        return messages.odometry_message(
            stamp_ns, "map", "base_link", pose, np.zeros(2), np.eye(6), np.eye(6)
        )

    def write(self, path: Path) -> Path:
        with BagWriter(path) as bag:
            for index, (topic, message) in enumerate(self.entries):
                bag.write(topic, message, index)
        return path


def test_a_run_is_read_from_its_bag(tmp_path: Path) -> None:
    found = read_run(Bag().write(tmp_path / "bag"), NO_FAULT)
    assert len(found.truth.time_ns) == 720
    assert window(found, 15.0, 90.0).rmse == pytest.approx(0.1)
    assert found.remarks[0] == Remark(1.0, "compass", Level.OK, "received")
    assert found.finite


def test_a_number_that_is_not_finite_is_seen(tmp_path: Path) -> None:
    bag = Bag()
    bag.entries.append(("/odom", Bag.odometry(89_900_000_000, math.nan)))
    assert not read_run(bag.write(tmp_path / "bag"), NO_FAULT).finite


def spoiled(entries: list[Any], how: str) -> list[Any]:
    truth = [entry for entry in entries if entry[0] == "/ground_truth"]
    others = [entry for entry in entries if entry[0] != "/ground_truth"]
    return {
        "two robots": [*entries, truth[100]],
        "lost truth": [*others, *truth[:100], *truth[101:]],
        "short": entries[: len(entries) // 2],
        "late": [*others, *truth[100:]],
        "no odom": truth,
    }[how]


@pytest.mark.parametrize(
    ("how", "expected"),
    [
        ("two robots", "more than one robot"),
        ("lost truth", "steps of 0.125 to 0.25 s"),
        ("short", "ends at 45"),
        ("late", "met too late"),
        ("no odom", "there is no odom"),
    ],
)
@pytest.mark.slow
def test_a_recording_that_is_not_the_whole_run_is_refused(
    tmp_path: Path, how: str, expected: str
) -> None:
    bag = Bag()
    bag.entries = spoiled(bag.entries, how)
    with pytest.raises(FnnEkfError, match=expected):
        read_run(bag.write(tmp_path / "bag"), NO_FAULT)


def test_odom_that_comes_later_than_the_localizer_may_send_it_is_the_machines_fault(
    tmp_path: Path,
) -> None:
    bag = Bag()
    places = {id(message): place for place, (_, message) in enumerate(bag.entries)}
    late = bag.entries.pop(places[id(bag.odom[45.0])])
    bag.entries.insert(places[id(bag.odom[46.5])], late)
    with pytest.raises(FnnEkfError, match=r"odom came up to 1\.5 s late, expected 0\.5 s"):
        read_run(bag.write(tmp_path / "bag"), NO_FAULT)


@pytest.mark.parametrize(
    ("fault", "allowed"),
    [
        ({"fault": "frozen", "topic": "compass"}, 0.5),
        ({"fault": "frozen", "topic": "joint_states"}, 1.0),
        ({"fault": "silent_wheel", "wheel": "left"}, 1.0),
        ({"fault": "clock_jump", "size": 10.0}, 1.0),
    ],
)
def test_odom_may_wait_for_wheels_that_do_not_come(fault: dict[str, Any], allowed: float) -> None:
    assert FaultScenario("row", "", ({"start": 30.0, **fault},)).latest_odom_s == allowed


def test_more_than_one_clock_jump_is_refused(tmp_path: Path) -> None:
    jumps = tuple({"fault": "clock_jump", "start": start, "size": 5.0} for start in (30.0, 40.0))
    with pytest.raises(FnnEkfError, match="2 clock jumps"):
        read_run(tmp_path / "bag", FaultScenario("jumps", "", jumps))
