# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""`make faults`: which rows are run, what is kept of them, and when the document is written."""

import multiprocessing
import os
import shutil
import signal
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from documents import SCENARIOS, section, with_section
from faults.recordings import NOTE, Recordings
from faults.scenarios import FaultScenario

import fnn_ekf_ros
from fnn_ekf_ros import messages
from fnn_ekf_ros.errors import FnnEkfError
from fnn_ekf_ros.files.locks import lock
from fnn_ekf_ros.recordings.bag_writer import BagWriter

pytest.importorskip("rclpy")

import fault_matrix
from fault_matrix import main

CODE, OLDER = "1.0, commit aaaaaaa", "1.0, commit bbbbbbb"
NO_FAULT = FaultScenario("no fault", "nothing")
KIDNAP = FaultScenario(
    "kidnap, 20 m", "carried", ({"fault": "kidnap", "start": 30.0, "move": [1, 0, 0]},)
)
SLIP = FaultScenario(
    "slip", "ice", ({"fault": "slip", "start": 30.0, "duration": 20.0, "factor": 5.0},)
)
STUCK = FaultScenario(
    "stuck wheel", "jam",
    ({"fault": "stuck_wheel", "start": 30.0, "duration": 20.0, "wheel": "left"},),
)  # fmt: skip
ALL = (NO_FAULT, KIDNAP, SLIP, STUCK)
BEFORE = "as it was\n"


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A whole run: truth in the origin, odom 0.1 m off it."""
    path = tmp_path_factory.mktemp("run") / "run"
    with BagWriter(path) as writer:
        for step in range(1, 721):
            stamp_ns = step * 125_000_000
            topics = (
                {"/ground_truth": 0.0, "/odom": 0.1} if step % 3 == 0 else {"/ground_truth": 0.0}
            )
            for topic, x in topics.items():
                pose = np.array([x, 0.0, 0.0])
                message = messages.odometry_message(
                    stamp_ns, "map", "base_link", pose, np.zeros(2), np.eye(6), np.eye(6)
                )
                writer.write(topic, message, stamp_ns)
    return path


class Matrix:
    """The command with four rows, whose processes are replaced by copies of a recording."""

    def __init__(self, folder: Path, bag: Path) -> None:
        self.folder, self.bag = folder, bag
        self.out, self.table = folder / "out", folder / "docs" / "faults.md"
        self.recordings = Recordings(self.out, ALL, {False: NO_FAULT, True: NO_FAULT})
        self.ran: list[str] = []
        self.trouble: dict[str, Callable[[], None]] = {}
        self.code = CODE
        self.table.parent.mkdir()
        self.table.write_text(BEFORE)

    def run_row(self, row: FaultScenario, place: Path, _: float) -> None:
        self.ran.append(row.name)
        place.mkdir(parents=True)
        self.trouble.get(row.name, lambda: None)()
        shutil.copytree(self.bag, place / "run")

    def record(self, *some: FaultScenario, by: str = CODE) -> None:
        for row in some:
            place = self.recordings.place(row)
            shutil.rmtree(place, ignore_errors=True)
            shutil.copytree(self.bag, place / "run")
            (place / NOTE).write_text(by)

    def notes(self) -> list[str]:
        return [self.recordings.made_by(row) for row in ALL]

    def untouched(self) -> bool:
        """Return whether no document was written and nothing hidden is left."""
        hidden = [*self.out.glob(".*"), *self.table.parent.glob(".*")]
        picture = self.table.with_name("faults.png").exists()
        return self.table.read_text() == BEFORE and not hidden and not picture


@pytest.fixture
def matrix(tmp_path: Path, bag: Path, monkeypatch: pytest.MonkeyPatch) -> Matrix:
    made = Matrix(tmp_path, bag)

    def in_this_process(_: object, *task: Any) -> str:
        return fault_matrix.tried(*task)

    monkeypatch.setenv("ROS_DOMAIN_ID", "1")  # put back what tried() sets
    for name, value in (
        ("OUT", made.out), ("TABLE", made.table), ("ROWS", ALL),
        ("UNDISTURBED", {False: NO_FAULT, True: NO_FAULT}), ("run_row", made.run_row),
        ("code_version", lambda _: made.code), ("in_a_process", in_this_process),
        ("exit_by_signal", lambda: None), ("require_matplotlib", lambda: None),
        ("ROOT", Path(fnn_ekf_ros.__file__).parents[1]),
    ):  # fmt: skip
        monkeypatch.setattr(fault_matrix, name, value)
    return made


def test_the_section_with_the_scenarios_of_others_stays(matrix: Matrix) -> None:
    pytest.importorskip("matplotlib")
    matrix.table.write_text(with_section(BEFORE, SCENARIOS, "scenarios of others"))
    assert main([]) == 0
    text = matrix.table.read_text()
    assert BEFORE not in text
    assert section(text, SCENARIOS) == "scenarios of others"


def fails(reason: str) -> Callable[[], None]:
    def run() -> None:
        raise FnnEkfError(reason)

    return run


def test_all_rows_are_run_and_written(matrix: Matrix, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("matplotlib")
    assert main([]) == 0
    assert matrix.ran == [row.name for row in ALL]
    text = matrix.table.read_text()
    assert f"(fnn_ekf_ros {CODE})" in text
    assert all(f"| **{row.name}**" in text for row in ALL)
    assert matrix.table.with_name("faults.png").read_bytes().startswith(b"\x89PNG")
    assert not list(matrix.out.glob(".*"))
    assert "4 of 4" in capsys.readouterr().out


def test_only_refuses_before_it_runs_where_the_other_rows_are_not_recorded(
    matrix: Matrix, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["--only", "kidnap"]) == 1
    caught = capsys.readouterr()
    assert "3 of the other 3 rows have no recording" in caught.err
    assert caught.err.count("\n") == 1
    assert (matrix.ran, caught.out) == ([], "")
    assert matrix.untouched()


def test_only_refuses_beside_rows_of_another_version(
    matrix: Matrix, capsys: pytest.CaptureFixture[str]
) -> None:
    matrix.record(NO_FAULT, SLIP)
    matrix.record(KIDNAP, STUCK, by=OLDER)
    assert main(["--only", "kidnap"]) == 1
    assert "1 of the other 3 rows have no recording by this code" in capsys.readouterr().err
    assert matrix.ran == []
    assert matrix.untouched()


def test_only_keeps_the_other_rows(matrix: Matrix) -> None:
    pytest.importorskip("matplotlib")
    matrix.record(NO_FAULT, SLIP, STUCK)
    others = [matrix.recordings.place(row) / NOTE for row in (NO_FAULT, SLIP, STUCK)]
    before = [note.stat().st_mtime_ns for note in others]
    assert main(["--only", "kidnap"]) == 0
    assert matrix.ran == [KIDNAP.name]
    assert [note.stat().st_mtime_ns for note in others] == before
    assert all(f"| **{row.name}**" in matrix.table.read_text() for row in ALL)


def test_only_may_name_several_rows_and_one_word_several(matrix: Matrix) -> None:
    pytest.importorskip("matplotlib")
    matrix.record(NO_FAULT)
    assert main(["--only", "kidnap", "s"]) == 0
    assert matrix.ran == [KIDNAP.name, SLIP.name, STUCK.name]


def test_a_name_of_no_row_is_refused_beside_one_that_is(
    matrix: Matrix, capsys: pytest.CaptureFixture[str]
) -> None:
    matrix.record(*ALL)
    for words in (["kidnap", "kidnapp"], [""]):
        assert main(["--only", *words]) == 1
        assert f"--only '{words[-1]}': no row has this" in capsys.readouterr().err
    assert matrix.ran == []
    assert matrix.untouched()


def test_a_row_that_does_not_run_takes_no_good_ones_place(
    matrix: Matrix, capsys: pytest.CaptureFixture[str]
) -> None:
    matrix.record(*ALL)
    good = matrix.recordings.place(KIDNAP) / NOTE
    before = good.stat().st_mtime_ns
    matrix.trouble[KIDNAP.name] = fails("localizer ended with 1")
    assert main(["--only", "kidnap", "slip"]) == 1
    assert matrix.ran == [KIDNAP.name] * fault_matrix.ATTEMPTS + [SLIP.name]
    caught = capsys.readouterr()
    assert "kidnap, 20 m: did not run: localizer ended with 1" in caught.out
    assert "1 of 2 rows did not run, docs/faults.md stays as it was: kidnap, 20 m" in caught.err
    assert good.stat().st_mtime_ns == before
    assert matrix.notes() == [CODE] * 4
    assert matrix.untouched()


class Deadly:
    """No row: the process that is given it dies."""

    def __reduce__(self) -> tuple[Any, ...]:
        return os._exit, (3,)


@pytest.mark.parametrize(
    ("row", "expected"),
    [(None, "AttributeError: 'NoneType'"), (Deadly(), "its process ended with 3")],
)
@pytest.mark.slow
def test_a_process_that_breaks_down_is_one_row_that_did_not_run(row: Any, expected: str) -> None:
    reason = fault_matrix.in_a_process(fault_matrix.Processes(), row, 1, 1.0, CODE)
    assert expected in reason
    assert not multiprocessing.active_children()


def test_no_process_outlives_an_interrupt_nor_is_started_after_it() -> None:
    processes = fault_matrix.Processes()
    first, second = (fault_matrix.SPAWN.Process(target=time.sleep, args=(60.0,)) for _ in range(2))
    processes.start(first)
    processes.end()
    first.join(10.0)
    assert first.exitcode == -signal.SIGTERM
    with pytest.raises(FnnEkfError, match="interrupted"):
        processes.start(second)
    assert second.pid is None


@pytest.mark.slow
def test_an_interrupted_run_writes_nothing_and_can_go_on(
    matrix: Matrix, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("matplotlib")
    matrix.record(*ALL, by=OLDER)

    def interrupt() -> None:
        raise KeyboardInterrupt

    matrix.trouble[SLIP.name] = interrupt
    assert main([]) == 130
    assert "docs/faults.md stays as it was; --missing goes on" in capsys.readouterr().err
    assert matrix.untouched()
    assert matrix.notes()[:3] == [CODE, CODE, OLDER]
    matrix.record(STUCK, by=OLDER)
    matrix.trouble.clear()

    assert main(["--recorded"]) == 1
    assert "not of one version" in capsys.readouterr().err
    assert matrix.table.read_text() == BEFORE
    matrix.ran.clear()
    assert main(["--missing"]) == 0
    assert matrix.ran == [SLIP.name, STUCK.name]
    assert matrix.notes() == [CODE] * 4
    assert CODE in matrix.table.read_text()


def test_a_run_whose_code_is_changed_meanwhile_is_not_kept(
    matrix: Matrix, capsys: pytest.CaptureFixture[str]
) -> None:
    def change() -> None:
        matrix.code = OLDER

    matrix.trouble[KIDNAP.name] = change
    assert main([]) == 1
    assert "kidnap, 20 m: did not run: the code was changed" in capsys.readouterr().out
    assert matrix.notes() == [CODE, "", "", ""]
    assert matrix.untouched()


def test_recordings_of_another_version_can_be_written_if_all_are(matrix: Matrix) -> None:
    pytest.importorskip("matplotlib")
    matrix.record(*ALL, by=OLDER)
    assert main(["--recorded"]) == 0
    assert matrix.ran == []
    assert OLDER in matrix.table.read_text()


def test_a_recording_that_cannot_be_read_writes_nothing(
    matrix: Matrix, capsys: pytest.CaptureFixture[str]
) -> None:
    matrix.record(*ALL)
    shutil.rmtree(matrix.recordings.place(SLIP) / "run")
    assert main(["--recorded"]) == 1
    assert "slip" in capsys.readouterr().err
    assert matrix.untouched()


def test_a_picture_that_cannot_be_drawn_leaves_the_document(
    matrix: Matrix, monkeypatch: pytest.MonkeyPatch
) -> None:
    def draw(path: Path, _: object) -> None:
        path.write_bytes(b"half")
        raise FnnEkfError("no matplotlib")

    monkeypatch.setattr("faults.recordings.fault_tables.draw", draw)
    matrix.record(*ALL)
    assert main(["--recorded"]) == 1
    assert matrix.untouched()


def test_a_missing_matplotlib_is_said_before_anything_is_run(
    matrix: Matrix, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(fault_matrix, "require_matplotlib", fails("pictures need matplotlib"))
    assert main([]) == 1
    assert capsys.readouterr().err == "fault_matrix: pictures need matplotlib\n"
    assert matrix.ran == []


def test_a_folder_that_cannot_be_made_is_one_line(
    matrix: Matrix, capsys: pytest.CaptureFixture[str]
) -> None:
    matrix.out.write_text("a file")
    assert main([]) == 1
    err = capsys.readouterr().err
    assert err.startswith("fault_matrix: ")
    assert str(matrix.out) in err
    assert err.count("\n") == 1
    assert matrix.ran == []


def test_a_recording_that_cannot_be_kept_is_one_line(
    matrix: Matrix, capsys: pytest.CaptureFixture[str]
) -> None:
    new = matrix.recordings.new_place(SLIP)
    matrix.trouble[SLIP.name] = (new / NOTE).mkdir
    assert main([]) == 1
    err = capsys.readouterr().err
    assert err.startswith("fault_matrix: ")
    assert NOTE in err
    assert err.count("\n") == 1
    assert matrix.untouched()


def test_a_recording_whose_note_is_damaged_counts_as_missing(
    matrix: Matrix, capsys: pytest.CaptureFixture[str]
) -> None:
    matrix.record(*ALL)
    (matrix.recordings.place(SLIP) / NOTE).write_bytes(b"1.0, \xff")
    assert main(["--recorded"]) == 1
    assert capsys.readouterr().err == "fault_matrix: 1 of 4 rows have no recording\n"
    assert matrix.untouched()
    assert [row.name for row in matrix.recordings.missing(CODE)] == [SLIP.name]


def test_what_a_killed_run_has_left_is_removed(matrix: Matrix) -> None:
    matrix.record(*ALL)
    (matrix.out / ".slip.new" / "run").mkdir(parents=True)
    assert main(["--only", "kidnapp"]) == 1
    assert matrix.untouched()


def test_two_runs_do_not_share_recordings(
    matrix: Matrix, capsys: pytest.CaptureFixture[str]
) -> None:
    matrix.record(*ALL)
    held = lock(matrix.out, os.O_RDONLY | os.O_DIRECTORY, FnnEkfError("taken"))
    assert main(["--only", "kidnap"]) == 1
    held.close()
    assert "another run" in capsys.readouterr().err
    assert matrix.ran == []


def test_another_clones_package_is_not_recorded_for_this_one(
    matrix: Matrix, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(fault_matrix, "ROOT", matrix.folder)
    assert main([]) == 1
    assert "not in this clone" in capsys.readouterr().err
    assert matrix.ran == []


@pytest.mark.parametrize(
    "arguments",
    [["--jobs", "0"], ["--rate", "0"], ["--rate", "nan"], ["--only"],
     ["--only", "slip", "--missing"], ["--recorded", "--missing"]],
)  # fmt: skip
def test_wrong_arguments_are_refused(matrix: Matrix, arguments: list[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(arguments)
    assert ended.value.code == 2
    assert matrix.ran == []
