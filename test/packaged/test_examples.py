# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The examples of the documents: each command runs, and gives what the document shows."""

import argparse
import json
import re
import shlex
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from documents import COMMAND, DOCUMENTS, ROOT, Block, blocks, examples, files, read

from fnn_ekf_ros.cli import run_command
from fnn_ekf_ros.commands import study_lasting, study_rates
from fnn_ekf_ros.messages import INPUT_TYPES, ODOM
from fnn_ekf_ros.parameters.fake_robot import NODE_NAME as FAKE_ROBOT
from fnn_ekf_ros.parameters.fake_robot import FakeRobotParameters
from fnn_ekf_ros.parameters.localizer import NODE_NAME as LOCALIZER
from fnn_ekf_ros.parameters.localizer import LocalizerParameters
from fnn_ekf_ros.parameters.schema import build, fields_of
from fnn_ekf_ros.recordings.bag_files import BagReader, Record
from fnn_ekf_ros.recordings.bag_writer import BagWriter
from fnn_ekf_ros.study import rates
from fnn_ekf_ros.study.monte_carlo import STUDIES

pytest.importorskip("rclpy")

import write_examples
from write_examples import MEASURED, SHOWN, Shown

from fnn_ekf_ros.ros import play
from fnn_ekf_ros.ros.runtime import parameters_from_ros, ros_started

NODES = {LOCALIZER: LocalizerParameters, FAKE_ROBOT: FakeRobotParameters}
SHORTER = {
    "study grid": "--runs 2 --steps 10 --jobs 1",
    "study paper": "--runs 2 --steps 10 --jobs 1",
    "study dynamic": "--runs 2 --steps 10 --jobs 1",
    "simulate fast": "--duration 10",
    "simulate run -p faults_file:=config/": "--duration 20",
    "simulate run --duration 60": "--duration 10",
    "study faults": "--runs 1 --quiet-runs 0 --faults compass_nan --jobs 1",
    "study mistakes": "--runs 1 --seconds 3 --mistakes swapped --jobs 1",
    "study rates": "--runs 2 --fixes 4 --jobs 1",
    "study lasting": "--runs 2 --steps 10 --jobs 1",
}
"""Arguments put behind those of an example that would take minutes or hours: the last one wins."""
PLAY = f"{COMMAND}play "
"""How an example begins that is not run: a node that plays to a localizer."""
NUMBER = re.compile(r"\d+(?:\.\d+)?")
OTHERS = [
    block
    for document in DOCUMENTS
    for block in examples(document)
    if not any(word in " ".join(block.lines) for word in (*MEASURED, PLAY))
]


def amcl_bag(folder: Path) -> None:
    """Write my_bag, as a robot like that of my_robot.yaml would: fixes by AMCL, wheel odometry."""
    geometry = ("wheel_radius:=0.033", "wheel_separation:=0.16", "base_frame:=base_footprint",
                "left_joint:=wheel_left_joint", "right_joint:=wheel_right_joint")  # fmt: skip
    words = [word for text in geometry for word in ("-p", text)]
    write_examples.run(["simulate", "driven", "--duration", "15", *words], folder)
    topics = {"/joint_states": "/joint_states", "/lrf_pose": "/amcl_pose", "/ground_truth": "/odom"}
    with BagReader(folder / "driven") as bag, BagWriter(folder / "my_bag") as out:
        for topic, name in topics.items():
            out.add_topic(bag.topics[topic]._replace(name=name))
        for record in bag.records(set(topics)):
            out.write_raw(Record(topics[record.topic], *record[1:]))


def csv_files(folder: Path) -> None:
    """Write run.csv, run_fixes.csv and run.json of a straight drive at 0.1 m/s, 1 mm a count."""
    times = [0.05 * step for step in range(600)]
    rows = [f"{t:.2f},{100 * t:.0f},{100 * t:.0f},{0.1 * t:.4f},0.0,0.0" for t in times]
    head = "t,left_ticks,right_ticks,gt_x,gt_y,gt_theta"
    (folder / "run.csv").write_text("\n".join([head, *rows]) + "\n")
    fixes = [
        f"{t:.2f},{0.1 * t + (-1) ** i * 0.05:.4f},0.02,0.01" for i, t in enumerate(times[::7])
    ]
    (folder / "run_fixes.csv").write_text("\n".join(["t,fix_x,fix_y,fix_theta", *fixes]) + "\n")
    (folder / "run.json").write_text(json.dumps({"wheel_base_m": 0.3, "metres_per_tick": 0.001}))


def clone(folder: Path) -> None:
    """Make the folder look like a clone to commands that name a file of it."""
    (folder / "config").symlink_to(ROOT / "config")


PREPARED: dict[str, Callable[[Path], None]] = {
    "my_bag": amcl_bag,
    "run.csv": csv_files,
    "config/": clone,
}
"""What an example with this word in its commands takes for granted."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where the examples run whose output is shown; several need the same recording."""
    return tmp_path_factory.mktemp("examples")


def same_but_for_rounding(shown: str, given: str) -> bool:
    """Return whether two texts are the same, numbers to one unit of their last digit."""
    if NUMBER.sub("#", shown) != NUMBER.sub("#", given):
        return False
    for one, other in zip(NUMBER.findall(shown), NUMBER.findall(given), strict=True):
        digits = len(one.partition(".")[2])
        if abs(float(one) - float(other)) > 1.5 * 10.0**-digits * ("." in one):
            return False
    return True


@pytest.mark.parametrize("shown", SHOWN, ids=lambda shown: shown.name)
@pytest.mark.slow
def test_an_example_gives_what_the_document_shows(shown: Shown, folder: Path) -> None:
    text = read(shown.document)
    there = write_examples.shown_in(text, shown).group(1)
    given = shown.value(folder)
    assert same_but_for_rounding(there, given), (
        f"{shown.document} shows\n{there}\nand its commands give\n{given}\n"
        "scripts/write_examples.py writes what they give"
    )


def test_numbers_may_differ_by_rounding_and_words_not_at_all() -> None:
    assert same_but_for_rounding("0.053 of 8 x", "0.054 of 8 x")
    assert not same_but_for_rounding("0.053 of 8 x", "0.055 of 8 x")
    assert not same_but_for_rounding("0.053 of 8 x", "0.053 of 9 x")
    assert not same_but_for_rounding("0.053 of 8 x", "0.053 of 8 y")


def test_the_live_run_of_the_readme_is_its_replay() -> None:
    rows = re.findall(r"^\| FNN-EKF, (\w+) \| (.*) \|$", read("README.md"), re.MULTILINE)
    assert [name for name, _ in rows] == ["live", "replay"]
    assert same_but_for_rounding(rows[0][1], rows[1][1])


@pytest.mark.parametrize("block", OTHERS, ids=lambda block: f"{block.document}: {block.lines[0]}")
@pytest.mark.slow
def test_the_commands_of_a_document_run(
    block: Block, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, study in STUDIES.items():  # pictures take most of the time; they have other tests
        monkeypatch.setitem(STUDIES, name, study._replace(figures=lambda *_: None))
    monkeypatch.setattr(study_rates, "draw_rates", lambda *_: None)
    monkeypatch.setattr(study_lasting, "draw_lasting", lambda *_: None)
    monkeypatch.setattr(rates, "RATE_CASES", rates.RATE_CASES[:2])
    for name, text in files(block.document).items():
        (tmp_path / name).write_text(text)
    for word, prepare in PREPARED.items():
        if word in " ".join(block.lines):
            prepare(tmp_path)
    for line in block.lines:
        own = line.removeprefix(COMMAND)
        more = next((m for begin, m in SHORTER.items() if own.startswith(begin)), "")
        write_examples.run(shlex.split(f"{own} {more}"), tmp_path)


def nodes_started() -> list[tuple[str, str]]:
    """Return the `ros2 run` lines of all documents, each with its document."""
    return [
        (document, line.strip())
        for document in DOCUMENTS
        for block in blocks(read(document))
        for line in block.replace("\\\n", " ").splitlines()
        if line.strip().startswith("ros2 run fnn_ekf_ros ")
    ]


@pytest.mark.parametrize(("document", "line"), nodes_started())
def test_a_node_takes_the_arguments_of_a_document(
    document: str, line: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for name, text in files(document).items():
        (tmp_path / name).write_text(text)
    _, _, _, node, *arguments = shlex.split(line)
    with ros_started(arguments, node):
        given = parameters_from_ros(node)
    given.pop("use_sim_time", None)
    build(NODES[node], given)
    assert len(given) >= line.count(" -p ")


def test_play_takes_the_arguments_of_a_document(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    parser = argparse.ArgumentParser()
    play.add_arguments(parser)
    lines = [
        line.removeprefix(PLAY)
        for document in DOCUMENTS
        for block in examples(document)
        for line in block.lines
        if line.startswith(PLAY)
    ]
    assert lines
    for line in lines:
        assert run_command("play", shlex.split(line)) == 1, line
        assert "bag 'my_bag' does not exist" in capsys.readouterr().err, line  # the only trouble
        given = parser.parse_args(shlex.split(line))
        assert given.keep_pace_with == ODOM
        assert set(given.topics) < set(INPUT_TYPES), "a recorded odom cannot be played"


def test_parameters_that_a_document_sets_at_run_time_can_be_set() -> None:
    found = [
        line.split()
        for document in DOCUMENTS
        for line in read(document).splitlines()
        if line.startswith("    ros2 param set ")
    ]
    assert found
    changing = {name for name, spec, _ in fields_of(LocalizerParameters) if spec.at_run_time}
    robot = {"wheel_radius": 0.1, "wheel_separation": 0.5, "encoder_counts_per_revolution": 1.0}
    for *_, node, name, value in found:
        assert node == f"/{LOCALIZER}"
        assert name in changing
        changes: dict[str, Any] = {name: value}
        replace(build(LocalizerParameters, robot), **changes)
