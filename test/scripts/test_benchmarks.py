# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The benchmark's outcomes, tables and files; nothing is measured here."""

import json
from pathlib import Path

import benchmarks
import numpy as np
import pytest
from bench import machine, recording, robot
from bench.document import as_json, document, number, table
from bench.results import MET, MISSED, Bar, Context, Line, Result, Row, missed, ratio
from bench.step_worker import own

from fnn_ekf_ros.errors import FnnEkfError
from fnn_ekf_ros.stopping import FAILURE


def measure(_: Context) -> Result:
    raise AssertionError


FAST = Line("fast", "us", [2.0, 1.0, 4.0])
SLOW = Line("slow", "us", [4.0, 3.0, 4.0])


@pytest.mark.parametrize(
    ("bar", "median", "outcome"),
    [
        (Bar(3.0), 3.0, MET),
        (Bar(3.0), 3.01, MISSED),
        (Bar(6.0, at_least=True), 6.0, MET),
        (Bar(6.0, at_least=True), 5.99, MISSED),
    ],
)
def test_a_bar_is_met_or_missed(bar: Bar, median: float, outcome: str) -> None:
    assert bar.outcome(median) == outcome
    assert Line("", "x", [0.0, median, 100.0], bar).outcome == outcome


def test_a_line_without_a_bar_has_no_outcome() -> None:
    assert FAST.outcome == ""
    assert FAST.as_json()["outcome"] is None


def test_a_ratio_is_taken_round_by_round() -> None:
    assert ratio("", SLOW, FAST).values == [2.0, 3.0, 1.0]
    with pytest.raises(ValueError, match="shorter"):
        ratio("", SLOW, Line("", "us", [1.0]))


def test_the_table_has_median_range_bar_and_outcome() -> None:
    shown = table([FAST, ratio("slow over fast", SLOW, FAST, Bar(1.5))]).splitlines()
    assert shown[2] == "| fast [us] | 2 | 1 | 4 |  |  |"
    assert shown[3] == "| slow over fast | 2 | 1 | 3 | <= 1.5 | **missed** |"
    assert len({line.count("|") for line in shown}) == 1


def test_numbers_have_three_digits() -> None:
    assert [number(x) for x in (0.01234, 1.0, 12.345, 99.96, 1234.5)] == [
        "0.0123", "1", "12.3", "100", "1234",
    ]  # fmt: skip


def test_the_document_names_machine_rows_and_what_is_missed() -> None:
    rows = [Row(name, name.upper(), f"\nHow {name} is.\n", measure) for name in ("one", "two")]
    results = {
        "one": Result([Line("a", "x", [2.0], Bar(1.0)), Line("b", "x", [2.0], Bar(3.0))]),
        "two": Result(skipped="there is no ROS"),
    }
    facts = {"CPU": "a fast one", "versions": {"numpy": "2", "rclpy": "7"}}
    text = document(facts, rows, results)
    assert "1 of 2 bars are met. Missed: one: a." in text
    assert "## ONE\n\nHow one is.\n\n| |" in text
    assert "## TWO\n\nHow two is.\n\nNot measured: there is no ROS.\n" in text
    assert "| versions | numpy 2, rclpy 7 |" in text
    assert missed(results) == ["one: a"]

    content = json.loads(as_json(facts, results))
    assert content["rows"]["one"]["lines"][0]["bar"] == "<= 1"
    assert content["rows"]["two"]["skipped"] == "there is no ROS"


def test_the_facts_of_this_machine_are_known(tmp_path: Path) -> None:
    commit = machine.commit(tmp_path)
    assert commit == "unknown: no clone"
    facts = machine.facts(commit, tmp_path, "abc", machine.load())
    assert all(facts.values())


def test_the_drive_is_the_same_each_time_and_what_the_filter_expects() -> None:
    drove, again = (robot.drive(400, 3, robot.PERIOD_S, seed=1) for _ in range(2))
    assert all(np.array_equal(a, b) for a, b in zip(drove, again, strict=True))
    advance = own("none", drove.truth[0, 0])
    error = [
        advance(u, z)[:2] - true
        for u, z, true in zip(
            drove.control[:, 0], drove.measurement[:, 0], drove.truth[1:, 0, :2], strict=True
        )
    ]
    assert np.sqrt(np.mean(np.square(error))) < robot.MEASUREMENT_STD[0]


def test_messages_come_at_their_rates_and_can_be_stamped_anew() -> None:
    sent = list(recording.sent(2.0))
    counts = {topic: sum(m.topic == topic for m in sent) for topic in recording.TYPES}
    assert list(counts.values()) == [20, 10, 100, 100]
    fix = next(m for m in sent if m.topic == "/lrf_pose")
    kind = recording.TYPES["/lrf_pose"]
    moved = recording.TYPESTORE.deserialize_cdr(recording.stamped(fix, 7_000_000_008), kind)
    assert (moved.header.stamp.sec, moved.header.stamp.nanosec) == (7, 8)
    before = recording.TYPESTORE.deserialize_cdr(fix.data, kind)
    assert moved.pose.pose == before.pose.pose


@pytest.fixture
def folders(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[Path, Path]:
    """Have a benchmark of two rows, of which `bad` fails, in folders of its own."""

    def fails(_: Context) -> Result:
        raise FnnEkfError("no such luck")

    rows = [Row("good", "Good", "", lambda _: Result([FAST])), Row("bad", "Bad", "", fails)]
    docs, build = tmp_path / "docs", tmp_path / "build"
    docs.mkdir()
    monkeypatch.setattr(benchmarks, "ROWS", {row.name: row for row in rows})
    monkeypatch.setattr(benchmarks, "DOCS", docs)
    monkeypatch.setattr(benchmarks, "BUILD", build)
    return docs, build


def test_a_row_that_fails_leaves_the_documents_alone(
    folders: tuple[Path, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    docs, build = folders
    assert benchmarks.main([]) == FAILURE
    assert capsys.readouterr().err.startswith("benchmarks: rows that failed: bad")
    assert not list(docs.iterdir())
    assert "it failed (no such luck)" in (build / "benchmarks.md").read_text()


def test_all_rows_make_the_documents_and_some_do_not(
    folders: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    docs, _ = folders
    assert benchmarks.main(["--only", "good"]) == 0
    assert not list(docs.iterdir())
    monkeypatch.setattr(benchmarks, "ROWS", {"good": benchmarks.ROWS["good"]})
    assert benchmarks.main([]) == 0
    assert {path.name for path in docs.iterdir()} == {"benchmarks.md", "benchmarks.json"}
    assert json.loads((docs / "benchmarks.json").read_text())["rows"]["good"]["lines"]
