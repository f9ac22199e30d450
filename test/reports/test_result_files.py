# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Results: where they may go, and files that are written whole or not at all."""

import os
import re
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from fnn_ekf_ros.errors import FnnEkfError
from fnn_ekf_ros.files.text_files import remove_partials, write_text
from fnn_ekf_ros.reports.results import (
    TextResult,
    check_result_file,
    check_result_folder,
    check_results,
    result_folder,
    study_results,
    text_result,
)

LONG = "x" * 300


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    folder = tmp_path / "bag"
    folder.mkdir()
    (folder / "metadata.yaml").write_text("of the bag")
    return folder


def test_a_result_is_new_or_asked_to_replace_a_file(tmp_path: Path) -> None:
    check_result_file("--json", tmp_path / "new.json")
    (tmp_path / "old.json").write_text("{}")
    (tmp_path / "link.json").symlink_to(tmp_path / "nothing")
    for name in ("old.json", "link.json"):
        with pytest.raises(FnnEkfError, match=r"exists already, expected a new name, or --force"):
            check_result_file("--json", tmp_path / name, [tmp_path / "new.json"])
        check_result_file("--json", tmp_path / name, [tmp_path / "new.json"], replaces=True)


def test_one_text_can_go_to_standard_output(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text, numbers, file = text_result("-"), text_result("-"), text_result(str(tmp_path / "-"))
    check_results({"--output": text, "--json": file, "--plot": None})
    text.write("a: 1\n")
    file.write_json({"a": 1})
    assert capsys.readouterr().out == "a: 1\n"
    assert (tmp_path / "-").read_text() == '{\n "a": 1\n}\n'
    with pytest.raises(FnnEkfError, match=r"--output and --json: both go to standard output"):
        check_results({"--output": text, "--json": numbers})
    with pytest.raises(FnnEkfError, match=r"--plot -: is no text, expected the name of a file"):
        check_results({"--plot": Path("-")})
    with pytest.raises(FnnEkfError, match=r"--tum -: is no text, expected the name of a folder"):
        check_result_folder("--tum", Path("-"), replaces=True)


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("no/x.json", "there is no folder '"),
        ("file/x.json", "there is no folder '"),
        ("", "is a folder, expected the name of a file"),
        ("pipe", "is no file, expected the name of a file"),
        (LONG, "File name too long"),
        ("nul\0", "null byte"),
        ("bag/metadata.yaml", "lies inside a bag"),
        ("bag/new.json", "lies inside a bag"),
        ("bag/../file", "is an input or another result"),
    ],
)
def test_where_no_result_can_go(tmp_path: Path, bag: Path, name: str, expected: str) -> None:
    (tmp_path / "file").write_text("mine")
    os.mkfifo(tmp_path / "pipe")
    path = tmp_path / name
    with pytest.raises(FnnEkfError, match=re.escape(f"--json '{path}': ") + f".*{expected}"):
        check_result_file("--json", path, [tmp_path / "file"])


def test_links_that_lead_in_a_circle_are_not_followed(tmp_path: Path) -> None:
    (tmp_path / "circle").symlink_to(tmp_path / "circle")
    check_result_file("--json", tmp_path / "circle", [tmp_path / "other"], replaces=True)


@pytest.mark.parametrize("below", ["", "deeper"])
def test_no_folder_of_results_is_a_bag(bag: Path, below: str) -> None:
    with pytest.raises(FnnEkfError, match=r"--plots '.*': is a bag's folder"):
        check_result_folder("--plots", bag / below, replaces=True)
    assert [entry.name for entry in bag.iterdir()] == ["metadata.yaml"]


def test_a_study_has_its_numbers_in_its_folder_or_elsewhere(tmp_path: Path) -> None:
    out = tmp_path / "new" / "out"
    for given, numbers in (
        (None, out / "results.json"),
        (out / "mine.json", out / "mine.json"),
        (tmp_path / "mine", tmp_path / "mine"),
    ):
        results = study_results(out, None if given is None else TextResult(given))
        assert not out.exists()
        with results.written({"a": 1}) as folder:
            (folder / "results.md").write_text("")
            assert not out.exists()
            assert not numbers.exists()
        inside = {"results.md"} | ({numbers.name} if numbers.parent == out else set())
        assert {path.name for path in out.iterdir()} == inside
        assert numbers.read_text() == '{\n "a": 1\n}\n'
        assert {path.name for path in tmp_path.iterdir()} == {"new", *({"mine"} & {numbers.name})}
        shutil.rmtree(out.parent)


def test_a_folder_of_results_is_new_or_asked_to_replace_files(tmp_path: Path) -> None:
    out = tmp_path / "out"
    out.mkdir()
    check_result_folder("--out", out, replaces=False)
    (out / "mine").write_text("mine")
    (out / "results.md").write_text("old")
    check_result_folder("--tum", out, replaces=False, names=["a.tum"])
    for names in (None, ["a.tum", "results.md"]):
        with pytest.raises(
            FnnEkfError, match=r"^--out .* expected a new (folder|name), or --force"
        ):
            check_result_folder("--out", out, replaces=False, names=names)
        check_result_folder("--out", out, replaces=True, names=names)
    with result_folder(out) as folder:
        (folder / "results.md").write_text("new")
    assert {path.name: path.read_text() for path in out.iterdir()} == {
        "mine": "mine", "results.md": "new",
    }  # fmt: skip


@pytest.mark.parametrize("error", [KeyboardInterrupt, SystemExit, OSError(28, "full")])
@pytest.mark.parametrize("there", [True, False])
def test_what_breaks_off_leaves_a_folder_as_it_was(
    tmp_path: Path, error: BaseException, there: bool
) -> None:
    out = tmp_path / "above" / "out"
    if there:
        out.mkdir(parents=True)
        (out / "results.md").write_text("old")
    before = {path: path.is_file() and path.read_text() for path in tmp_path.rglob("*")}

    def break_off() -> None:
        with result_folder(out) as folder:
            (folder / "results.md").write_text("half")
            raise error

    with pytest.raises((KeyboardInterrupt, SystemExit, FnnEkfError)):
        break_off()
    assert {path: path.is_file() and path.read_text() for path in tmp_path.rglob("*")} == before


@pytest.mark.parametrize(
    ("numbers", "expected"),
    [
        ("out/results.md", "expected a name that ends in .json"),
        ("out/../out/localizer_x.yaml", "expected a name that ends in .json"),
        ("out", "is an input or another result"),
        ("parameters.yaml", "is an input or another result"),
        ("bag/metadata.yaml", "lies inside a bag"),
        (LONG, "File name too long"),
    ],
)
def test_numbers_that_a_study_refuses(
    tmp_path: Path, bag: Path, numbers: str, expected: str
) -> None:
    parameters = tmp_path / "parameters.yaml"
    parameters.write_text("mine")
    with pytest.raises(FnnEkfError, match=f"--json .*{expected}"):
        study_results(tmp_path / "out", TextResult(tmp_path / numbers), [parameters])
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("name", ["results.json", "results.md"])
def test_a_folder_in_the_place_of_a_study_s_result(tmp_path: Path, name: str) -> None:
    (tmp_path / name).mkdir()
    with pytest.raises(FnnEkfError, match=rf"--out '.*{name}': is a folder"):
        study_results(tmp_path, replaces=True)


def save_picture(path: Path) -> None:
    pytest.importorskip("matplotlib")
    from fnn_ekf_ros.reports.pictures import new_figure, save

    save(new_figure(1.0, 1.0), path)


@pytest.mark.parametrize("write", [lambda path: write_text(path, "text"), save_picture])
@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("file/x.png", "Not a directory"),
        ("no/x.png", "folder '.*no' does not exist"),
        (LONG, "File name too long"),
        ("nul\0", "null byte"),
        ("", None),
    ],
)
def test_a_file_that_cannot_be_written_is_one_line(
    tmp_path: Path, write: Callable[[Path], None], name: str, reason: str | None
) -> None:
    (tmp_path / "file").write_text("mine")
    expected = f"cannot be written: .*{reason}" if reason else "is no file"
    with pytest.raises(FnnEkfError, match=re.escape(f"'{tmp_path / name}' ") + expected):
        write(tmp_path / name)
    assert [entry.name for entry in tmp_path.iterdir()] == ["file"]


def test_text_that_is_no_text_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(FnnEkfError, match=r"cannot be written: .*surrogates"):
        write_text(tmp_path / "x", "\udcff")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", ["state.yaml", "y" * 240, "y" * 255, "\N{EURO SIGN}" * 85])
def test_every_name_has_room_for_its_partial(
    tmp_path: Path, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / name
    write_text(path, "first")
    assert path.read_text() == "first"
    with monkeypatch.context() as killed:
        killed.setattr(Path, "replace", lambda *_: (_ for _ in ()).throw(OSError(28, "full")))
        killed.setattr(Path, "unlink", lambda *_, **__: None)
        with pytest.raises(FnnEkfError, match="full"):
            write_text(path, "second")
    assert len(list(tmp_path.iterdir())) == 2
    assert remove_partials(path.with_name(f"{name[:50]}_")) == 0
    assert remove_partials(path) == 1
    assert [entry.name for entry in tmp_path.iterdir()] == [name]
