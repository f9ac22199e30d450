# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The command compare, as from a shell."""

import json
from pathlib import Path

import pytest
from commands import Refuse, Succeed, parameters_of

from fnn_ekf_ros.cli import run_command
from fnn_ekf_ros.recordings.bag_files import BagReader
from fnn_ekf_ros.recordings.bag_writer import BagWriter

WRONG = "process_noise_std:=[0.01, 0.0105]"


@pytest.fixture(scope="module")
def sets(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[Path]]:
    """A short recording, and two parameter files for it: of the right noise and a wrong one."""
    folder = tmp_path_factory.mktemp("compare")
    words = ["simulate", folder / "run", "--duration", "30", "-p", "seed:=3"]
    assert run_command("simulate", [str(word) for word in words[1:]]) == 0
    text = parameters_of(folder / "run").read_text()
    files = [folder / "right.yaml", folder / "wrong.yaml"]
    plain = text.replace("adaptation: joint", "adaptation: none")
    assert plain != text
    files[0].write_text(plain)
    lines = [
        "    measurement_noise_std: [1.0, 1.0, 1.3]" if "measurement_noise_std:" in line else line
        for line in plain.splitlines()
    ]
    files[1].write_text("\n".join(lines) + "\n")
    return folder / "run", files


@pytest.mark.slow
def test_parameter_sets_on_one_recording(
    tmp_path: Path, sets: tuple[Path, list[Path]], succeed: Succeed
) -> None:
    bag, files = sets
    words = ["--params", *files, "--labels", "right", "wrong", "--json", tmp_path / "x.json"]
    said = succeed("compare", bag, *words)
    assert "position error: right is best" in said
    assert "NIS: right is honest, wrong is not" in said
    content = json.loads((tmp_path / "x.json").read_text())
    right, wrong = (content["runs"][name] for name in ("right", "wrong"))
    assert right["measures"]["position error"] < wrong["measures"]["position error"]
    assert wrong["nis"]["verdict"] == "too cautious"
    assert not wrong["sensors"]["fixes"]["white"]
    assert content["verdicts"] == said.partition("\n\n")[2].splitlines()
    assert sorted(path.name for path in bag.parent.iterdir()) == [
        "right.yaml", "run", "run.yaml", "wrong.yaml",
    ]  # fmt: skip


@pytest.mark.slow
def test_bags_of_replay_give_what_parameter_sets_give_and_without_truth_too(
    tmp_path: Path, sets: tuple[Path, list[Path]], succeed: Succeed
) -> None:
    bag, files = sets
    for name, file in zip(("right", "wrong"), files, strict=True):
        succeed("replay", bag, tmp_path / name, "--params", file)
        with BagReader(tmp_path / name) as whole, BagWriter(tmp_path / f"{name}_blind") as out:
            for record in whole.records(set(whole.topics) - {"/ground_truth"}):
                out.write_raw(record)
    labels = ["--labels", "right", "wrong"]
    by_sets = succeed("compare", bag, "--params", *files, *labels)
    by_bags = succeed("compare", tmp_path / "right", tmp_path / "wrong", *labels)
    assert by_bags == by_sets
    blind = [tmp_path / f"{name}_blind" for name in ("right", "wrong")]
    said = succeed("compare", *blind, *labels)
    assert "position error" not in said
    assert "mean forecast of fixes 10 s ahead: " in said
    assert "NIS: right is honest, wrong is not" in said
    assert "NEES" not in said
    lent = succeed("compare", *blind, *labels, "--truth-bag", bag)
    assert "position error: right is best" in lent


@pytest.mark.slow
def test_a_run_beside_itself_cannot_be_told_apart(
    sets: tuple[Path, list[Path]], succeed: Succeed
) -> None:
    bag, files = sets
    said = succeed("compare", bag, "--params", files[0], files[0], "--labels", "a", "b")
    assert "position error: the data cannot tell" in said
    assert " is best" not in said


def test_compare_refuses(tmp_path: Path, recorded: Path, refuse: Refuse) -> None:
    file = parameters_of(recorded)
    assert "expected at least two" in refuse("compare", recorded)
    assert "expected at least two" in refuse("compare", recorded, "--params", file)
    assert "expected one to run" in refuse("compare", recorded, recorded, "--params", file, file)
    assert "expected different labels" in refuse("compare", recorded, recorded)
    words = ["--labels", "a", "b"]
    assert "topic /odom is missing" in refuse("compare", recorded, recorded, *words)
    assert "expected --params" in refuse("compare", recorded, recorded, *words, "-p", WRONG)
    assert "2 labels, expected 3" in refuse("compare", *[recorded] * 3, *words)
    missing = ["--params", file, tmp_path / "no.yaml"]
    assert "no.yaml' does not exist" in refuse("compare", recorded, *missing)
    assert "lies inside a bag" in refuse(
        "compare", recorded, recorded, *words, "--json", recorded / "x.json"
    )
