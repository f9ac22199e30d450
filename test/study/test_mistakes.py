# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""`study mistakes`: what counts as named, and what the command writes."""

import json
import math
from pathlib import Path

import pytest
from commands import Refuse, Succeed

from fnn_ekf_ros.parameters.fake_robot import FakeRobotParameters
from fnn_ekf_ros.study import told_mistakes
from fnn_ekf_ros.study.fault_naming import Report
from fnn_ekf_ros.study.mistake_runs import mistake_table, summary
from fnn_ekf_ros.study.mistakes import MISTAKES, NOTHING, SLIPS
from fnn_ekf_ros.study.told_mistakes import follow_mistake
from fnn_ekf_ros.timeline.events import Level, Status

SLIP = next(iter(SLIPS))
WHEELS = (("mistake", "x"), ("parameter that would fit", "wheel_radius: 0.02"))
SYMPTOM = (("parameter that would fit", "wheel_radius: 0.02"),)
WRONG_SYMPTOM = (("parameter that would fit", "compass_offset: 0.5"),)
OTHER = (("mistake", "y"), ("parameter that would fit", "wheel_separation: 0.5"))


def report(time_s: float, values: tuple[tuple[str, str], ...], compass: Level) -> Report:
    level = Level.WARN if values else Level.OK
    encoders = Status("encoders", level, "said", values)
    return Report(time_s, (encoders, Status("compass", compass, "other", ())))


@pytest.mark.parametrize(
    ("reports", "named_s", "others", "wrong"),
    [
        ([report(1, (), Level.WARN), report(2, WHEELS, Level.OK)], 2.0, (), ()),
        ([report(1, WHEELS, Level.OK), report(2, (), Level.OK)], math.nan, (), ()),
        ([report(1, WHEELS, Level.OK), report(2, (), Level.OK), report(3, WHEELS, Level.OK)],
         3.0, (), ()),
        ([report(1, WHEELS, Level.OK), report(2, WHEELS, Level.WARN)], 1.0, ("compass",), ()),
        ([report(1, OTHER, Level.OK)], math.nan, (), ("said",)),
        ([report(1, SYMPTOM, Level.OK)], 1.0, (), ()),
        ([report(1, WRONG_SYMPTOM, Level.OK)], math.nan, (), ("said",)),
    ],
)  # fmt: skip
def test_a_mistake_counts_as_named_from_when_it_stays(
    monkeypatch: pytest.MonkeyPatch,
    reports: list[Report],
    named_s: float,
    others: tuple[str, ...],
    wrong: tuple[str, ...],
) -> None:
    monkeypatch.setattr(told_mistakes, "_reports", lambda *_: iter(reports))
    told = follow_mistake("radius", SLIP, FakeRobotParameters(path="square"), 3.0, {})
    assert told.named_s == pytest.approx(named_s, nan_ok=True)
    assert (told.others, told.wrong) == (others, wrong)
    assert told.in_time is not math.isnan(named_s)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("mistake", "slip", "by_s"),
    [
        # The yaw of fixes is not used, and instruments tell its delay hardly: least squares do.
        ("fixes_late", 1, 60.0),
        # Averages of radians across the wrap are nothing.
        ("compass_radians", 0, 50.0),
    ],
)
def test_what_takes_longest_is_told_in_time(mistake: str, slip: int, by_s: float) -> None:
    name = list(SLIPS)[slip]
    robot = FakeRobotParameters(path="square", seed=1, slip_std=SLIPS[name])
    told = follow_mistake(mistake, name, robot, 63.0, {})
    assert told.named_s < by_s
    assert not told.wrong


@pytest.mark.slow
def test_wheels_that_explain_little_of_the_yaw_show_no_small_size() -> None:
    """Gentle curves and much slip: the standard error of the ratio comes out too small."""
    slip = list(SLIPS)[1]
    robot = FakeRobotParameters(path="figure_eight", seed=46, slip_std=SLIPS[slip])
    assert not follow_mistake(NOTHING, slip, robot, 63.0, {}).wrong


def test_the_table_has_a_row_for_each_mistake_and_slip(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(told_mistakes, "_reports", lambda *_: iter([report(5, WHEELS, Level.OK)]))
    told = [
        follow_mistake(name, slip, FakeRobotParameters(path="square"), 9.0, {})
        for name in ("radius", NOTHING)
        for slip in SLIPS
    ]
    assert mistake_table(["radius", NOTHING], told).count("\n| radius |") == len(SLIPS)
    assert summary(told) == (
        "2 of 2 mistakes told in time, 0 runs with another one, 0 named by doctor, 0 drives with "
        "another finding, without a mistake 2 of 2 runs with one told"
    )


def test_mistakes_have_different_names_and_fit_the_robot() -> None:
    assert len({mistake.name for mistake in MISTAKES}) == len(MISTAKES) == 20


def test_the_command_writes_a_table_and_numbers(
    tmp_path: Path, succeed: Succeed, refuse: Refuse
) -> None:
    out = tmp_path / "out"
    said = succeed(
        "study", "mistakes", "--out", out, "--runs", 1, "--seconds", 3, "--jobs", 1,
        "--mistakes", f"swapped,{NOTHING}",
    )  # fmt: skip
    assert said.startswith(f"{out}: 0 of 2 mistakes told in time, 0 runs with another one")
    found = json.loads((out / "results.json").read_text())
    assert [row["mistake"] for row in found["results"]] == ["swapped"] * 2 + [NOTHING] * 2
    assert found["results"][0]["named_s"] is None
    assert "| swapped | left and right ticks are exchanged |" in (out / "results.md").read_text()
    line = refuse("study", "mistakes", "--out", tmp_path / "no", "--mistakes", "sweapped")
    assert "sweapped" in line
