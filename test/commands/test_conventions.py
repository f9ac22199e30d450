# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""What commands have in common: where results go, what they replace, what an interrupt leaves."""

import argparse
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from commands import HEARS_SIGINT, Refuse, Succeed, contents, parameters_of
from places import ROOT

from fnn_ekf_ros import cli
from fnn_ekf_ros.commands import study as study_command
from fnn_ekf_ros.commands import study_faults, study_lasting, study_rates, train
from fnn_ekf_ros.reports.results import text_result
from fnn_ekf_ros.study.monte_carlo import STUDIES

SMALL = ("--runs", 2, "--steps", 10, "--jobs", 1)
STUDY_SIZES: dict[str, tuple[object, ...]] = {
    **dict.fromkeys(STUDIES, (*SMALL, "--filters", "ekf")),
    "lasting": SMALL,
    "rates": ("--runs", 2, "--fixes", 4, "--jobs", 1),
    "faults": ("--runs", 1, "--quiet-runs", 0, "--faults", "compass_nan", "--jobs", 1),
    "mistakes": ("--runs", 1, "--seconds", 1, "--mistakes", "swapped", "--jobs", 1),
    "tune": ("--runs", 1, "--seconds", 60, "--kinds", "sim2", "--jobs", 1),
}
"""Words that make a study of simulated robots small, by its name."""
PATIENCE_S = 120.0
"""Time after which what a test waits for will not come [s]."""
PLAIN = ("-p", "adaptation:=none")
"""A filter that takes little time."""
BAGS_TO_WRITE = {"simulate": "out", "replay": "out", "import-csv": "out"}
"""The argument that names the bag to write, by command."""
INPUTS = {
    ("compare", "truth_bag"), ("evaluate", "truth_bag"), ("evaluate", "findings"),
    ("import-csv", "fixes"), ("import-csv", "geometry"), ("study real", "state_file"),
}  # fmt: skip
"""Options that name what is read; all others with a path name a result."""
WITHOUT_ROS = [
    name for name, command in cli.COMMANDS.items() if name != "play" and not command.is_node
]
READ = [
    ("replay", ["out"]), ("doctor", []), ("tune", []), ("evaluate", []),
    ("compare", ["nowhere2", "--labels", "a"]), ("study", ["--out", "out"]),
]  # fmt: skip
"""Commands that read bags, and what they need beside the bag."""


def parsers() -> Iterator[tuple[str, argparse.ArgumentParser]]:
    """Yield the parsers of commands without ROS, those of the studies one by one."""
    for name in WITHOUT_ROS:
        parser = argparse.ArgumentParser(prog=name)
        module = cli._declare(parser, name, cli.COMMANDS[name])
        if name != "study":
            yield name, parser
            continue
        for study, own in module.add_arguments(argparse.ArgumentParser()).items():
            yield f"study {study}", own


def result_options() -> Iterator[tuple[str, argparse.Action]]:
    """Yield the options of all commands that name a result."""
    for name, parser in parsers():
        for action in parser._actions:
            names_path = action.type in (Path, text_result)
            optional = action.option_strings and action.dest != "params"
            if names_path and optional and (name, action.dest) not in INPUTS:
                yield name, action


OPTIONS = [(name, action.option_strings[0]) for name, action in result_options()]
"""Command and option for each result."""


def test_every_option_for_a_text_takes_standard_output_and_every_command_has_force() -> None:
    for name, action in result_options():
        if action.metavar == "FILE":
            assert action.type is text_result, (name, action.option_strings)
            assert action.help is not None
            assert "- for standard output" in action.help
    with_force = {name for name, parser in parsers() if "--force" in parser.format_help()}
    assert with_force == {name for name, _ in OPTIONS} | set(BAGS_TO_WRITE)
    assert with_force == {name for name, _ in parsers()}
    with_json = {name for name, option in OPTIONS if option == "--json"}
    assert with_json == with_force - {"simulate", "import-csv", "train"}


@pytest.fixture
def made(tmp_path: Path, recorded: Path) -> Path:
    """A folder with a recording, its parameters, a CSV table and its geometry."""
    shutil.copytree(recorded, tmp_path / "run")
    shutil.copy(parameters_of(recorded), tmp_path / "run.yaml")
    lines = ["t,left_ticks,right_ticks,fix_x,fix_y,heading_meas"]
    lines += [f"{0.1 * i},{i},{i},{0.001 * i},0,0" for i in range(30)]
    (tmp_path / "t.csv").write_text("\n".join(lines) + "\n")
    (tmp_path / "g.json").write_text('{"wheel_base_m": 0.5, "metres_per_tick": 0.001}')
    return tmp_path


def words_for(folder: Path, command: str) -> list[object]:
    """Return a command with all that it needs beside its results, but for `--out`."""
    bag, given = folder / "run", ["--params", folder / "run.yaml"]
    name, _, study = command.partition(" ")
    if study:
        size = STUDY_SIZES.get(study, ())
        return [name, study, *([bag, *given] if study == "real" else size)]
    return {
        "simulate": ["simulate", folder / "new", "--duration", 1],
        "replay": ["replay", bag, folder / "new", *given, *PLAIN],
        "import-csv": ["import-csv", folder / "t.csv", folder / "new", "--geometry",
                       folder / "g.json"],
        "doctor": ["doctor", bag, *given],
        "tune": ["tune", bag, *given],
        "evaluate": ["evaluate", bag, "--odom-topic", "/ground_truth"],
        "compare": ["compare", bag, "--params", *[folder / "run.yaml"] * 2, "--labels", "a", "b",
                    *PLAIN],
        "train": ["train", "--epochs", 1],
    }[name]  # fmt: skip


@pytest.mark.parametrize(("command", "option"), OPTIONS)
def test_a_result_that_is_there_is_refused_before_any_work(
    made: Path, refuse: Refuse, command: str, option: str
) -> None:
    """A file, or for the option of a folder a folder with the files that there would be."""
    suffix = {"--plot": ".png", "--report": ".html"}.get(option, "")
    there = made / f"there{suffix}"
    words = words_for(made, command)
    needed = {"train", *(f"study {name}" for name in (*STUDY_SIZES, "real"))}
    folder = option in ("--tum", "--kitti", "--plots") or (
        option == "--out" and command.startswith("study")
    )
    if folder:
        there.mkdir()
        for name in ("a_odom.tum", "a_odom.kitti", "loss.png", "results.md"):
            (there / name).write_text("mine")
    else:
        there.write_text("mine")
    if command in needed and option != "--out":
        words += ["--out", made / "other"]
    if command == "evaluate":
        words += ["--labels", "a"]
    name, *rest = words
    line = refuse(str(name), *rest, option, there)
    assert f"{option} '{there}" in line
    assert line.endswith(
        ("or --force to replace it", "or --force to replace files of the same name")
    )


@pytest.mark.parametrize("command", BAGS_TO_WRITE)
def test_a_bag_that_is_there_is_replaced_only_if_asked(
    made: Path, refuse: Refuse, succeed: Succeed, command: str
) -> None:
    name, *words = map(str, words_for(made, command))
    succeed(name, *words)
    beside = parameters_of(made / "new")
    before = contents(made / "new")
    line = refuse(name, *words)
    assert (
        line
        == f"{name}: '{made / 'new'}' exists already: choose another name, or --force to "
        + ("replace it")
    )
    (made / "new" / "metadata.yaml").write_text("old")
    if command != "replay":
        beside.write_text("old")
    succeed(name, *words, "--force")
    assert contents(made / "new") == before
    assert command == "replay" or "ros__parameters" in beside.read_text()
    assert not [path for path in made.iterdir() if path.name.startswith(".")]


@pytest.mark.parametrize("command", BAGS_TO_WRITE)
def test_force_replaces_nothing_but_recordings_that_are_no_input(
    made: Path, refuse: Refuse, command: str
) -> None:
    name, *words = words_for(made, command)
    (made / "new").mkdir()
    (made / "new" / "mine").write_text("mine")
    assert "is there and no bag: --force replaces nothing else" in refuse(
        str(name), *words, "--force"
    )
    shutil.rmtree(made / "new")
    (made / "new").symlink_to(made / "run")
    line = refuse(str(name), *words, "--force")
    assert "would replace the input" in line or "is there and no bag" in line
    (made / "new").unlink()
    if command == "replay":
        line = refuse("replay", made / "run" / "recorded.mcap", made / "run", "--force", "--params",
                      made / "run.yaml")  # fmt: skip
        assert f"'{made / 'run'}' would replace the input" in line
    if command == "simulate":
        line = refuse("simulate", made / "run", "--params", made / "run.yaml", "--force")
        assert "has no section for fake_robot" in line


def test_a_bag_that_cannot_be_finished_does_not_replace_the_old_one(
    made: Path, run: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    words = words_for(made, "simulate")
    assert run(*words).code == 0
    before = contents(made / "new"), parameters_of(made / "new").read_text()
    rename = Path.rename

    def fails_at_the_end(self: Path, target: Path) -> Path:
        if self.name != "new.yaml.old" and target == parameters_of(made / "new"):
            raise OSError(28, "full")
        return rename(self, target)

    monkeypatch.setattr(Path, "rename", fails_at_the_end)
    ended = run(*words, "--force", "-p", "seed:=9")
    assert ended.code == 1
    assert "full" in ended.err
    assert (contents(made / "new"), parameters_of(made / "new").read_text()) == before
    assert not [path for path in made.iterdir() if path.name.startswith(".")]


@pytest.mark.parametrize("step", range(4))
def test_an_interrupt_while_bags_change_places_loses_none(
    made: Path, run: Callable[..., Any], monkeypatch: pytest.MonkeyPatch, step: int
) -> None:
    """After each of the four renames: the old bag and file away, the new ones there."""
    words = words_for(made, "simulate")
    assert run(*words).code == 0
    before = contents(made / "new"), parameters_of(made / "new").read_text()
    rename, done = Path.rename, []

    def interrupted_after(self: Path, target: Path) -> Path:
        place = rename(self, target)
        done.append(target)
        if len(done) == step + 1:
            raise KeyboardInterrupt
        return place

    monkeypatch.setattr(Path, "rename", interrupted_after)
    assert run(*words, "--force", "-p", "seed:=9").code == 130
    assert len(done) > step
    assert (contents(made / "new"), parameters_of(made / "new").read_text()) == before
    assert not [path for path in made.iterdir() if path.name.startswith(".")]


@pytest.mark.parametrize("command", ["replay", "doctor", "evaluate", "compare"])
def test_numbers_alone_go_to_standard_output(
    made: Path, run: Callable[..., Any], command: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(made)
    words = words_for(made, command)
    file = made / "numbers.json"
    to_file = run(*words, "--json", file)
    shutil.rmtree(made / "new", ignore_errors=True)
    to_stdout = run(*words, "--json", "-")
    assert to_file.code == to_stdout.code == 0
    assert to_stdout.out == file.read_text()
    assert isinstance(json.loads(to_stdout.out), dict)
    assert len(to_stdout.err.splitlines()) == len(to_file.out.splitlines()) > 1
    assert not (made / "-").exists()


def test_a_parameter_file_goes_to_standard_output(made: Path, run: Callable[..., Any]) -> None:
    given = words_for(made, "doctor")
    found = run(*given, "--write-params", "-")
    assert found.out.startswith("# Localizer parameters after `doctor run`.\n/**/localizer:\n")
    both = run(*given, "--write-params", "-", "--json", "-")
    assert both.code == 1
    assert both.err.count("\n") == 1
    assert "--json and --write-params: both go to standard output" in both.err


@pytest.mark.parametrize("name", ["grid", "lasting"])
@pytest.mark.slow
def test_the_numbers_of_a_study_go_to_standard_output(
    made: Path, run: Callable[..., Any], name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(STUDIES, "grid", STUDIES["grid"]._replace(figures=lambda *_: None))
    monkeypatch.setattr(study_lasting, "draw_lasting", lambda *_: None)
    words = words_for(made, f"study {name}")
    ended = run(*words, "--out", made / "new", "--json", "-")
    assert ended.code == 0, ended.err
    assert json.loads(ended.out)["study"] == name
    assert "results.md" in {path.name for path in (made / "new").iterdir()}
    assert "results.json" not in {path.name for path in (made / "new").iterdir()}


def interrupt(*_: object, **__: object) -> Any:
    raise KeyboardInterrupt


@pytest.mark.parametrize(
    ("name", "module", "where"),
    [
        ("grid", study_command, "work_through"), ("grid", study_command, "write_text"),
        ("faults", study_faults, "run_faults"), ("rates", study_rates, "run_rates"),
        ("lasting", study_lasting, "run_lasting"), ("lasting", study_lasting, "draw_lasting"),
    ],
)  # fmt: skip
@pytest.mark.parametrize("there", [False, True])
@pytest.mark.slow
def test_a_study_that_is_interrupted_leaves_nothing(
    tmp_path: Path, run: Callable[..., Any], monkeypatch: pytest.MonkeyPatch, name: str,
    module: Any, where: str, there: bool,
) -> None:  # fmt: skip
    out = tmp_path / "above" / "out"
    if there:
        out.mkdir(parents=True)
        (out / "results.md").write_text("old")
    before = {path: path.is_file() and path.read_text() for path in tmp_path.rglob("*")}
    monkeypatch.setattr(module, where, interrupt)
    ended = run("study", name, "--out", out, *STUDY_SIZES[name], "--force")
    assert (ended.code, ended.out, ended.err) == (130, "", "")
    assert {path: path.is_file() and path.read_text() for path in tmp_path.rglob("*")} == before


def test_a_training_that_is_interrupted_leaves_nothing(
    tmp_path: Path, run: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(train, "read_membership", interrupt)
    ended = run("train", "--out", tmp_path / "t.yaml", "--plots", tmp_path / "p", "--epochs", 1)
    assert ended.code == 130
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_a_signal_in_the_middle_of_a_study_leaves_nothing(tmp_path: Path) -> None:
    words = [
        *HEARS_SIGINT, sys.executable, "-m", "fnn_ekf_ros", "study", "lasting",
        "--out", tmp_path / "out", "--runs", 40, "--jobs", 2,
    ]  # fmt: skip
    process = subprocess.Popen(
        [str(word) for word in words], env=os.environ | {"PYTHONPATH": str(ROOT)},
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    try:
        children = Path(f"/proc/{process.pid}/task/{process.pid}/children")
        until = time.monotonic() + PATIENCE_S
        while not children.read_text():  # it works
            assert process.poll() is None
            assert time.monotonic() < until
            time.sleep(0.02)
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=PATIENCE_S)
    finally:
        process.kill()
    assert process.returncode == 130
    assert (out, err) == ("", "")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(("command", "rest"), READ)
def test_a_missing_bag_is_named_first(
    tmp_path: Path, refuse: Refuse, monkeypatch: pytest.MonkeyPatch, command: str, rest: list[str]
) -> None:
    """Before the parameters that are not set, too."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "x").write_text("x")
    words = ["real"] if command == "study" else []
    wrong = ["--plot", "nothing"] if command == "evaluate" else ["-p", "wheel_radius:=x"]
    line = refuse(command, *words, "nowhere", *rest, *wrong)
    assert line.endswith("bag 'nowhere' does not exist: expected a rosbag2 recording")


def test_play_names_a_missing_bag_first(refuse: Refuse) -> None:
    pytest.importorskip("rclpy")
    line = refuse("play", "nowhere", "--rate", "-1")
    assert line == "play: bag 'nowhere' does not exist: expected a rosbag2 recording"


def test_all_that_read_recordings_are_here() -> None:
    no_bags = {"import-csv", "simulate", "train", "localizer", "fake_robot"}
    assert {command for command, _ in READ} | {"play"} == set(cli.COMMANDS) - no_bags
