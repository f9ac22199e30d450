# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""`study` as from a shell: what it writes, that it writes the same again, and what it refuses."""

import json
import math
import re
from pathlib import Path
from typing import IO, Any

import pytest
from commands import Refuse, Succeed

from fnn_ekf_ros.errors import FnnEkfError
from fnn_ekf_ros.parameters.fake_robot import FakeRobotParameters
from fnn_ekf_ros.parameters.files import read_parameter_file
from fnn_ekf_ros.parameters.localizer import LocalizerParameters
from fnn_ekf_ros.parameters.schema import build
from fnn_ekf_ros.reports.pictures import save
from fnn_ekf_ros.study import dynamic, grid
from fnn_ekf_ros.study.monte_carlo import STUDIES
from fnn_ekf_ros.study.report.paper_figures import paper_figures

TINY = ("--runs", 3, "--steps", 20, "--jobs", 1)
# What the paper has a figure of; 1, 2, 15 and 16 are blocks and hardware.
PAPER_FIGURES = [*range(3, 15), *range(17, 21)]


def size_of_png(path: Path) -> tuple[int, int]:
    """Return width and height in pixels."""
    head = path.read_bytes()[:24]
    assert head[:8] == b"\x89PNG\r\n\x1a\n"
    return int.from_bytes(head[16:20], "big"), int.from_bytes(head[20:24], "big")


def results(path: Path) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(path.read_text())
    return found


def suffixes(folder: Path, suffix: str) -> set[str]:
    return {path.name for path in folder.iterdir() if path.suffix == suffix}


@pytest.mark.slow
def test_grid(tmp_path: Path, succeed: Succeed) -> None:
    out = tmp_path / "new" / "out"
    said = succeed("study", "grid", "--out", out, *TINY, "--filters", "ekf,r_published")
    assert said == (
        f"{out}: 2 trials of 3 runs, oracle, ekf, r_published\n{out / 'results.md'}: the tables\n"
    )
    assert suffixes(out, ".png") == {
        f"grid_{trial}_{name}_{kind}.png"
        for trial in ("sim1", "sim2")
        for name in ("whole", "last_half")
        for kind in ("ratio", "nees")
    }
    assert all(min(size_of_png(path)) > 300 for path in out.glob("*.png"))

    found = results(out / "results.json")
    assert (found["study"], found["runs"], found["steps"], found["seed"]) == ("grid", 3, 20, 1)
    assert found["filters"] == ["ekf", "r_published"]
    keys = {(r["trial"], r["filter"], r["q"], r["k"], r["range"]) for r in found["results"]}
    assert len(keys) == len(found["results"]) == 2 * 2 * (1 + 2 * 25)
    right = next(r for r in found["results"] if (r["filter"], r["q"], r["k"]) == ("ekf", 1, 1))
    assert right["ratio_x"] == right["ratio_theta"] == [1.0, 1.0, 1.0]
    value, low, high = right["rmse_y"]
    assert 0.0 < low < value < high < 0.3

    table = (out / "results.md").read_text()
    assert "`study grid --runs 3 --steps 20 --seed 1 --filters ekf,r_published`" in table
    assert table.count("| q = 1/25 |") == 2 * 2 * 2
    assert [line.count("|") for line in table.splitlines() if line.startswith("| q = ")] == [7] * 40

    for path, std in (("sim1", (0.02, math.radians(1.0))), ("sim2", (0.05, math.radians(3.0)))):
        robot = read_parameter_file(out / f"fake_robot_{path}.yaml", "fake_robot")
        assert build(FakeRobotParameters, robot).path == path
        told = read_parameter_file(out / f"localizer_{path}.yaml", "localizer")
        assert build(LocalizerParameters, told).process_noise_std == pytest.approx(std)


@pytest.mark.slow
def test_the_same_seed_writes_the_same_files(
    tmp_path: Path, succeed: Succeed, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(grid, "SIMULATIONS", {"sim2": grid.SIMULATIONS["sim2"]})
    written = []
    for folder, seed in (("one", 5), ("two", 5), ("three", 6)):
        out = tmp_path / folder
        succeed("study", "grid", "--out", out, *TINY, "--filters", "ekf", "--seed", seed)
        written.append({path.name: path.read_bytes() for path in out.iterdir()})
    assert written[0] == written[1]
    changed = {name for name in written[0] if written[0][name] != written[2][name]}
    assert changed == {name for name in written[0] if not name.endswith(".yaml")}


@pytest.mark.slow
def test_paper(tmp_path: Path, succeed: Succeed) -> None:
    numbers = tmp_path / "numbers.json"
    succeed(
        "study", "paper", "--out", tmp_path / "out", *TINY, "--json", numbers,
        "--filters", "dead_reckoning,r_published",
    )  # fmt: skip
    out = tmp_path / "out"
    assert "results.json" not in {path.name for path in out.iterdir()}
    assert suffixes(out, ".png") == {figure.file for figure in paper_figures()}
    drawn = [int(name[3:5]) for name in suffixes(out, ".png") if name.startswith("fig")]
    assert sorted(drawn) == PAPER_FIGURES
    assert all(min(size_of_png(path)) > 300 for path in out.glob("*.png"))
    found = results(numbers)
    assert found["parameters"] == {"motion_model": "paper"}
    # The EKF and the paper's filter are in its figures, named or not.
    assert found["filters"] == ["dead_reckoning", "ekf", "rq_published", "r_published"]
    assert {r["trial"] for r in found["results"]} == {"sim1", "sim2", "round"}
    blind = [r for r in found["results"] if r["filter"] == "dead_reckoning"]
    assert all(r["nis_per_dof"] is None for r in blind)
    table = (out / "results.md").read_text()
    for figure in paper_figures():
        assert f"| {figure.file} | {figure.shows} |" in table
    for words in ("Simulation 1", "Simulation 2", "Experiment (simulated)"):
        assert f"## {words}, right start, whole run" in table
    cell = re.escape("| EKF | ") + r"0\.\d{4} \(-?0\.\d{4}-0\.\d{4}\) \|"
    assert len(re.findall(cell, table)) == 3 * 3 * 2
    assert "## What the numbers show" in table
    assert "*FNN-EKF R and Q, published*" in table
    assert "the paper's filters too, take every reading" in table


@pytest.mark.slow
def test_dynamic(tmp_path: Path, succeed: Succeed, monkeypatch: pytest.MonkeyPatch) -> None:
    cases = {name: dynamic.CASES[name] for name in ("nominal", "slip")}
    monkeypatch.setattr(dynamic, "CASES", cases)
    succeed(
        "study", "dynamic", "--out", tmp_path, *TINY, "--filters", "ekf",
        "-p", "motion_model:=paper",
    )  # fmt: skip
    assert suffixes(tmp_path, ".png") == {
        f"dynamic_{case}_{word}.png" for case in cases for word in ("position", "heading")
    }
    found = results(tmp_path / "results.json")
    assert found["parameters"] == {"motion_model": "paper"}
    assert len(found["results"]) == 2 * 3 * (1 + 5)
    table = (tmp_path / "results.md").read_text()
    assert table.count("| EKF | right start |") == 2
    assert len(re.findall(r"\| EKF \| Q [x/] 25, R [x/] 25 \|", table)) == 2


@pytest.fixture
def undrawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leaves out the pictures of `study grid`, which take most of its time."""
    without = STUDIES["grid"]._replace(figures=lambda *_: None)
    monkeypatch.setitem(STUDIES, "grid", without)


@pytest.mark.slow
def test_parameters_reach_the_filters(tmp_path: Path, succeed: Succeed, undrawn: None) -> None:
    found = []
    for name, words in (("a", []), ("b", ["-p", "innovation_window:=6"])):
        out = tmp_path / name
        succeed("study", "grid", "--out", out, *TINY, "--filters", "ekf,r_published", *words)
        found.append(results(out / "results.json")["results"])
    for one, other in zip(*found, strict=True):
        differs = one["filter"] == "r_published"
        assert (one != other) == differs


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["--runs", "0"], "--runs 0: expected 2 to 10000"),
        (["--runs", "1"], "--runs 1: expected 2 to 10000"),
        (["--steps", "9"], "--steps 9: expected 10 to"),
        (["--steps", "1000000"], "--steps 1000000: expected 10 to"),
        (["--seed", "-1"], "--seed -1: expected 0 to"),
        (["--jobs", "0"], "--jobs 0: expected 1 to"),
        (["--jobs", "-2"], "--jobs -2: expected 1 to"),
        (["--jobs", "100000"], "--jobs 100000: expected 1 to"),
        (["--runs", "10000", "--steps", "201"], "--runs 10000 --steps 201: expected 2000000 p"),
        (["--filters", "ekf,ukf"], "--filters ukf: expected some of dead_reckoning, ekf, "),
        (["--filters", ""], "--filters : expected some of "),
        (["--filters", "oracle"], "--filters oracle: expected some of "),
        (["-p", "adaptation:=r"], "parameter 'adaptation': the study sets it; expected"),
        (["-p", "inference:=centroid"], "parameter 'inference': the study sets it; expected"),
        (["-p", "motion_modle:=paper"], "unknown parameter 'motion_modle': did you mean"),
        (["-p", "innovation_window:=1"], "parameter 'innovation_window' is 1: expected"),
        (["--params", "missing.yaml"], "parameter file 'missing.yaml' does not exist"),
        (["--json", "nowhere/numbers.json"], "there is no folder 'nowhere'"),
        (["--json", "."], "--json '.': is a folder"),
        (["--json", ""], "--json '.': is a folder"),
        (["--json", "x" * 300], "File name too long"),
    ],
)
@pytest.mark.parametrize("name", ["paper", "grid", "dynamic"])
@pytest.mark.slow
def test_what_is_refused(
    tmp_path: Path, refuse: Refuse, name: str, words: list[str], expected: str
) -> None:
    assert expected in refuse("study", name, "--out", tmp_path / "out", *words)


def test_a_folder_that_cannot_be_made(tmp_path: Path, refuse: Refuse) -> None:
    (tmp_path / "file").write_text("mine")
    assert "--out" in refuse("study", "grid", "--out", tmp_path / "file", *TINY)
    assert "--out" in refuse("study", "grid", "--out", tmp_path / "file" / "below", *TINY)


@pytest.mark.parametrize("name", ["results.json", "results.md"])
def test_a_folder_in_the_place_of_a_result(tmp_path: Path, refuse: Refuse, name: str) -> None:
    (tmp_path / name).mkdir()
    assert f"{name}': is a folder" in refuse(
        "study", "dynamic", "--out", tmp_path, "--force", *TINY
    )
    assert f"{name}': is a folder" in refuse("study", "faults", "--out", tmp_path, "--force")


@pytest.mark.parametrize("name", ["results.md", "localizer_round.yaml", "dynamic.png"])
def test_numbers_under_the_name_of_another_result(
    tmp_path: Path, refuse: Refuse, name: str
) -> None:
    out = tmp_path / "out"
    line = refuse("study", "dynamic", "--out", out, "--json", out / name, *TINY)
    assert "expected a name that ends in .json beside the other results" in line


def test_a_picture_is_replaced_only_by_a_whole_one(tmp_path: Path) -> None:
    class Breaking:
        def savefig(self, file: IO[bytes], **_: object) -> None:
            file.write(b"half")
            raise OSError(28, "full")

    picture = tmp_path / "picture.png"
    picture.write_bytes(b"before")
    with pytest.raises(FnnEkfError, match=re.escape(f"'{picture}' cannot be written: full")):
        save(Breaking(), picture)
    assert [path.read_bytes() for path in tmp_path.iterdir()] == [b"before"]


@pytest.mark.slow
def test_nothing_half_written_is_left(
    tmp_path: Path,
    succeed: Succeed,
    refuse: Refuse,
    undrawn: None,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """It fails at the first of its files, before there would be pictures."""
    succeed("study", "grid", "--out", tmp_path, *TINY, "--filters", "ekf")
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    assert not [name for name in before if name.startswith(".")]
    monkeypatch.setattr(Path, "replace", lambda *_: (_ for _ in ()).throw(OSError(28, "full")))
    refuse("study", "grid", "--out", tmp_path, *TINY, "--filters", "ekf", "--seed", 9)
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before
