# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The examples of each command's help, and what the shell is offered for completion."""

import argparse
import itertools
import os
import shlex
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest
from places import ROOT

from fnn_ekf_ros import cli, messages
from fnn_ekf_ros.commands.arguments import possible_assignments, possible_remappings
from fnn_ekf_ros.commands.study import OWN_MODULES
from fnn_ekf_ros.parameters.fake_robot import FakeRobotParameters
from fnn_ekf_ros.parameters.files import parse_assignment
from fnn_ekf_ros.parameters.localizer import LocalizerParameters
from fnn_ekf_ros.parameters.schema import build, fields_of
from fnn_ekf_ros.recordings.inputs import TopicNames
from fnn_ekf_ros.study.monte_carlo import STUDIES

STUDIES_BY_NAME = {**STUDIES, **OWN_MODULES}
NEEDS_ROS = {"localizer", "fake_robot", "play"}
SETS = {"fake_robot": FakeRobotParameters, "simulate": FakeRobotParameters}
"""Parameter set of a command, if it is not the localizer's."""


def declared(name: str) -> argparse.ArgumentParser:
    """Return the parser of a command."""
    if name in NEEDS_ROS:
        pytest.importorskip("rclpy")
    parser = argparse.ArgumentParser(prog=name)
    cli._declare(parser, name, cli.COMMANDS[name])
    return parser


@pytest.mark.parametrize("name", cli.COMMANDS)
def test_the_examples_of_a_command_parse_and_are_in_its_help(name: str) -> None:
    parser = declared(name)
    examples = cli.COMMANDS[name].examples
    assert examples
    shown = parser.format_help()
    run = "ros2 run" if cli.COMMANDS[name].is_node else "python3 -m"
    for example in examples:
        assert f"\n  {run} fnn_ekf_ros {name} {example}".rstrip() in shown
        words = shlex.split(example)
        own, ros = cli._split(words) if cli.COMMANDS[name].is_node else (words, [])
        given = parser.parse_args(own)  # exits if it cannot
        pairs = list(itertools.pairwise(ros))
        assignments = getattr(given, "assignments", []) + [b for a, b in pairs if a == "-p"]
        remappings = getattr(given, "remappings", []) + [b for a, b in pairs if a == "-r"]
        kind = SETS.get(name, LocalizerParameters)
        values = dict(map(parse_assignment, assignments))
        assert set(values) <= {known for known, _, _ in fields_of(kind)}
        if "wheel_radius" in values:
            build(kind, values)
        TopicNames(remappings)


def test_every_study_has_examples_of_its_own(capsys: pytest.CaptureFixture[str]) -> None:
    for study in STUDIES_BY_NAME:
        with pytest.raises(SystemExit):
            cli.run_command("study", [study, "--help"])
        shown = capsys.readouterr().out.partition("\nexamples:\n")[2]
        lines = shown.splitlines()
        assert lines, study
        assert all(f"-m fnn_ekf_ros study {study} " in line for line in lines)


def test_play_names_topics_that_there_are() -> None:
    given = declared("play").parse_args(shlex.split(cli.COMMANDS["play"].examples[1]))
    assert set(given.topics) <= set(messages.INPUT_TYPES)
    assert given.keep_pace_with == messages.ODOM


@pytest.mark.parametrize(
    ("kind", "prefix", "offered"),
    [
        (LocalizerParameters, "adaptation:=j", ["adaptation:=none", "adaptation:=joint"]),
        (
            LocalizerParameters,
            "lasting_errors:=",
            ["lasting_errors:=true", "lasting_errors:=false"],
        ),
        (FakeRobotParameters, "path:=", ["path:=round"]),
    ],
)
def test_values_are_offered_where_they_are_words(
    kind: type[LocalizerParameters], prefix: str, offered: list[str]
) -> None:
    assert set(offered) <= set(possible_assignments(kind, prefix))


def test_names_are_offered_before_values() -> None:
    names = possible_assignments(LocalizerParameters, "wheel")
    assert names == [f"{name}:=" for name, _, _ in fields_of(LocalizerParameters)]
    assert possible_assignments(LocalizerParameters, "wheel_radius:=0.") == []
    assert possible_assignments(LocalizerParameters, "nothing:=") == []
    assert {"lrf_pose:=", "odom:=", "/tf:="} <= set(possible_remappings())


def offered(tmp_path: Path, line: str, *call: str, before: int = 1) -> list[str]:
    """Return what a shell would offer for the last word of a line.

    Args:
        tmp_path: for the answer.
        line: as it was typed.
        call: what the shell runs to ask.
        before: of argcomplete: 1 for an executable, 3 for `python -m`.
    """
    answer = tmp_path / "answer"
    asked = {
        "_ARGCOMPLETE": str(before), "COMP_LINE": line, "COMP_POINT": str(len(line)),
        "_ARGCOMPLETE_STDOUT_FILENAME": str(answer), "_ARGCOMPLETE_COMP_WORDBREAKS": " ",
        "_ARGCOMPLETE_IFS": "\n", "PYTHONPATH": str(ROOT),
    }  # fmt: skip
    subprocess.run(
        [sys.executable, *call], env=os.environ | asked, cwd=tmp_path, check=True,
        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
    )  # fmt: skip
    return [each.strip() for each in answer.read_text().splitlines()]


WITH_ARGCOMPLETE = pytest.mark.skipif(
    find_spec("argcomplete") is None, reason="argcomplete is not installed"
)


@WITH_ARGCOMPLETE
@pytest.mark.parametrize(
    ("typed", "expected"),
    [
        ("re", {"replay"}),
        ("replay a b --s", {"--strict", "--save-params", "--storage"}),
        ("replay a b -p lrf_pose_g", {"lrf_pose_gate:="}),
    ],
)
@pytest.mark.slow
def test_completion_of_the_package(tmp_path: Path, typed: str, expected: set[str]) -> None:
    line = f"python3 -m fnn_ekf_ros {typed}"
    assert set(offered(tmp_path, line, "-m", "fnn_ekf_ros", before=3)) == expected


@WITH_ARGCOMPLETE
@pytest.mark.parametrize(
    ("typed", "expected"), [("a b --storage ", {"mcap", "sqlite3"}), ("ru", {"run.csv", "run.d/"})]
)
@pytest.mark.slow
def test_completion_of_an_executable(tmp_path: Path, typed: str, expected: set[str]) -> None:
    (tmp_path / "run.csv").touch()
    (tmp_path / "run.d").mkdir()
    code = "from fnn_ekf_ros.cli import replay; replay()"
    assert set(offered(tmp_path, f"replay {typed}", "-c", code)) == expected


def test_a_question_that_cannot_be_answered_runs_nothing(tmp_path: Path) -> None:
    (tmp_path / "argcomplete.py").write_text("raise ImportError('it is not here')\n")
    asked = {"_ARGCOMPLETE": "1", "COMP_LINE": "simulate run ", "COMP_POINT": "13"}
    ended = subprocess.run(
        [sys.executable, "-c", "from fnn_ekf_ros.cli import simulate; simulate()", "run"],
        env=os.environ | asked | {"PYTHONPATH": f"{tmp_path}{os.pathsep}{ROOT}"}, cwd=tmp_path,
        capture_output=True, text=True,
    )  # fmt: skip
    assert (ended.returncode, ended.stdout, ended.stderr) == (1, "", "")
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize("file", ["__main__.py", "cli.py"])
def test_the_shell_finds_that_it_may_ask(file: str) -> None:
    """The global completion looks for this word in the first kilobyte of a script."""
    assert b"PYTHON_ARGCOMPLETE_OK" in (ROOT / "fnn_ekf_ros" / file).read_bytes()[:1024]


def test_argcomplete_is_imported_only_if_the_shell_asks() -> None:
    code = (
        "import contextlib, sys\n"
        "from fnn_ekf_ros import cli\n"
        "with contextlib.suppress(SystemExit): cli.run_command('replay', ['--help'])\n"
        "sys.exit('argcomplete' in sys.modules)\n"
    )
    ended = subprocess.run(
        [sys.executable, "-c", code], env=os.environ | {"PYTHONPATH": str(ROOT)},
        stdout=subprocess.DEVNULL,
    )  # fmt: skip
    assert ended.returncode == 0
