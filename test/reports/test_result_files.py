# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Results: where they may go, and files that are written whole or not at all."""

import os
import re
from collections.abc import Callable
from pathlib import Path

import pytest

from fnn_ekf_ros.errors import FnnEkfError
from fnn_ekf_ros.files.text_files import remove_partials, write_text
from fnn_ekf_ros.reports.result_folder import check_result_file, make_folder, prepare_study

LONG = "x" * 300


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    folder = tmp_path / "bag"
    folder.mkdir()
    (folder / "metadata.yaml").write_text("of the bag")
    return folder


def test_a_result_may_be_new_or_replace_a_file(tmp_path: Path) -> None:
    check_result_file("--json", tmp_path / "new.json")
    (tmp_path / "old.json").write_text("{}")
    check_result_file("--json", tmp_path / "old.json", [tmp_path / "new.json"])


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
    check_result_file("--json", tmp_path / "circle", [tmp_path / "other"])


@pytest.mark.parametrize("below", ["", "deeper"])
def test_no_folder_of_results_is_a_bag(bag: Path, below: str) -> None:
    with pytest.raises(FnnEkfError, match=r"--plots '.*': is a bag's folder"):
        make_folder(bag / below, "--plots")
    assert [entry.name for entry in bag.iterdir()] == ["metadata.yaml"]


def test_a_study_has_its_numbers_in_its_folder_or_elsewhere(tmp_path: Path) -> None:
    out = tmp_path / "new" / "out"
    assert prepare_study(out, ["results.md"]) == out / "results.json"
    assert prepare_study(out, ["results.md"], out / "mine.json") == out / "mine.json"
    assert prepare_study(out, ["results.md"], tmp_path / "mine") == tmp_path / "mine"


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
        prepare_study(tmp_path / "out", ["results.md"], tmp_path / numbers, [parameters])
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("name", ["results.json", "results.md"])
def test_a_folder_in_the_place_of_a_study_s_result(tmp_path: Path, name: str) -> None:
    (tmp_path / name).mkdir()
    with pytest.raises(FnnEkfError, match=rf"--out '.*{name}': is a folder"):
        prepare_study(tmp_path, ["results.md"])


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
