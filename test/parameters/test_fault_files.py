# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Timelines of faults as YAML: read as written, refused in one clear line."""

from pathlib import Path
from typing import Any

import pytest
from places import FAULTS_EXAMPLE

from fnn_ekf_ros.parameters.fault_files import (
    FaultError,
    Timeline,
    faults_from,
    read_faults,
    vocabulary_table,
)
from fnn_ekf_ros.parameters.faults import (
    FAULTS,
    NAMES,
    Bias,
    ClockJump,
    Dropout,
    Outliers,
    Slip,
    StuckWheel,
)
from fnn_ekf_ros.parameters.schema import ParameterError, fields_of


def read(folder: Path, text: str) -> Timeline:
    path = folder / "faults.yaml"
    path.write_text(text)
    return read_faults(str(path))


def test_a_timeline_is_read_as_it_is_written(tmp_path: Path) -> None:
    text = (
        "# what may happen\n"
        "- {fault: outliers, topic: lrf_pose, start: 60, duration: 30.0, size: 2e1, rate: 0.5}\n"
        "- fault: stuck_wheel\n  wheel: left\n  start: 100.0\n  duration: 10\n"
        "- {fault: dropout, topic: compass, start: 0}\n"
    )
    assert read(tmp_path, text) == Timeline(
        (
            Outliers(start=60.0, duration=30.0, topic="lrf_pose", size=20.0, rate=0.5),
            StuckWheel(start=100.0, duration=10.0, wheel="left"),
            Dropout(start=0.0, topic="compass"),
        ),
        text,
    )


def test_no_file_and_an_empty_list_are_no_faults(tmp_path: Path) -> None:
    assert read_faults("none") == Timeline((), "")
    assert read(tmp_path, "[]\n").faults == ()


def test_a_timeline_may_lie_in_the_current_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "x.yaml").write_text("- {fault: clock_jump, start: 1, size: -2}")
    monkeypatch.chdir(tmp_path)
    assert read_faults("x.yaml").faults == (ClockJump(start=1.0, size=-2.0),)


def test_the_example_holds_each_fault_once_within_the_usual_length_of_a_run() -> None:
    faults = read_faults(str(FAULTS_EXAMPLE)).faults
    assert [NAMES[type(fault)] for fault in faults] == list(FAULTS)
    assert max(fault.end for fault in faults) < 300.0


DROPOUT = "fault: dropout, topic: compass, start: 1"
TABLE = [
    ("", "holds None: expected a list of faults such as - {fault: dropout"),
    ("fault: dropout", "holds {'fault': 'dropout'}: expected a list of faults"),
    ("- {a: [", "is not YAML"),
    ("- dropout", "entry 1 holds 'dropout': expected the keys of a fault, such as {fault:"),
    ("- {topic: compass}", "entry 1: 'fault' is missing: expected one of slip"),
    (f"- {{{DROPOUT}}}\n- {{fault: dropuot}}", "entry 2: 'fault' is 'dropuot': did you mean 'dro"),
    ("- {fault: 3}", "entry 1: 'fault' is 3: expected one of slip, unequal_wheels"),
    ("- {fault: [slip]}", "entry 1: 'fault' is ['slip']: did you mean 'slip'?"),
    (f"- {{{DROPOUT}, rat: 1}}", "entry 1 (dropout): unknown key 'rat': did you mean 'rate'?"),
    (f"- {{{DROPOUT}, size: 1}}", "(dropout): unknown key 'size': expected one of start, topic"),
    (f"- {{{DROPOUT}, use_sim_time: true}}", "(dropout): unknown key 'use_sim_time'"),
    (f"- {{{DROPOUT}, 7: 1}}", "(dropout): unknown key 7: expected one of"),
    (f"- {{{DROPOUT}, start: 2}}", "key 'start' stands twice in the entry of line 1"),
    ("- {fault: slip}", "(slip): 'start' is missing: expected a number from 0 to 1000000000 [s]"),
    ("- {fault: dropout, start: 1}", "(dropout): 'topic' is missing: expected one of left"),
    ("- {fault: kidnap, start: 1}", "'move' is missing: expected a list of numbers from -1"),
    ("- {fault: slip, start: -1}", "'start' is -1: expected a number from 0 to 1000000000 [s]"),
    ("- {fault: slip, start: soon}", "(slip): parameter 'start' is 'soon': expected a number"),
    ("- {fault: slip, start: .nan}", "'start' is nan: expected a number"),
    ("- {fault: slip, start: true}", "'start' is True: expected a number"),
    ("- {fault: slip, start: }", "'start' is None: expected a number"),
    ("- {fault: slip, start: 1, duration: 0}", "'duration' is 0: expected a number from 0.0125"),
    ("- {fault: slip, start: 1, factor: -1}", "'factor' is -1: expected a number from 0 to 1000"),
    ("- {fault: slip, start: 1, factor: 2, std: [1, 1]}", "expected factor or std, not both"),
    ("- {fault: slip, start: 1, std: [1]}", "'std' is [1]: expected a list of 2 numbers [m, rad]"),
    ("- {fault: tick_reset, wheel: top, start: 1}", "'wheel' is 'top': expected one of left, rig"),
    ("- {fault: tick_reset, wheel: left, start: 1, count: 0.5}", "'count' is 0.5: expected a whol"),
    ("- {fault: unequal_wheels, wheel: both, start: 1}", "'wheel' is 'both': expected one of left"),
    ("- {fault: outliers, topic: left_ticks, start: 1, size: 1}", "expected one of compass, lrf_"),
    ("- {fault: dropout, topic: ground_truth, start: 1}", "'topic' is 'ground_truth': expected on"),
    ("- {fault: nan, topic: left_ticks, start: 1}", "expected one of joint_states, compass, lrf"),
    ("- {fault: bias, topic: compass, start: 1, size: [1, 0, 0]}", "expected [0, 0, yaw] for the"),
    ("- {fault: bad_covariance, topic: compass, start: 1, variance: 0.1}", "'variance' is 0.1: ex"),
    ("- {fault: burst, topic: compass, start: 1}", "(burst): 'duration' is missing: expected a n"),
    (f"- {{{DROPOUT}}}\n- {{{DROPOUT}}}", "entries 1 and 2: dropout of compass twice at 1 s"),
    (
        f"- {{{DROPOUT}}}\n- {{fault: slip, start: 0}}\n- {{{DROPOUT}00, duration: 2}}",
        "entries 1 and 3: dropout of compass twice at 100 s: expected one at a time",
    ),
    (
        "- {fault: stuck_wheel, wheel: both, start: 5, duration: 2}\n"
        "- {fault: stuck_wheel, wheel: right, start: 4, duration: 1.5}",
        "entries 1 and 2: stuck_wheel of right twice at 5 s",
    ),
    (
        "- {fault: kidnap, move: [1, 0, 0], start: 5}\n"
        "- {fault: kidnap, move: [2, 0, 0], start: 5}",
        "entries 1 and 2: kidnap of robot twice at 5 s",
    ),
]  # fmt: skip


@pytest.mark.parametrize(("text", "expected"), TABLE)
def test_a_wrong_timeline_is_refused_in_one_line(tmp_path: Path, text: str, expected: str) -> None:
    with pytest.raises(FaultError) as refused:
        read(tmp_path, text)
    said = str(refused.value)
    assert said.startswith(f"faults_file '{tmp_path / 'faults.yaml'}'")
    assert expected in said
    assert "\n" not in said


def test_one_after_the_other_is_no_overlap() -> None:
    stuck = {"fault": "stuck_wheel", "duration": 1.0}
    found = faults_from(
        [
            {**stuck, "wheel": "both", "start": 2.0},
            {**stuck, "wheel": "left", "start": 1.0},
            {**stuck, "wheel": "left", "start": 3.0},
            {**stuck, "wheel": "right", "start": 1.0},
        ]
    )
    assert [fault.start for fault in found] == [2.0, 1.0, 3.0, 1.0]


@pytest.mark.parametrize("name", ["missing.yaml", ".", "\0"])
def test_a_file_that_is_none_is_refused(name: str) -> None:
    with pytest.raises(FaultError, match="faults_file"):
        read_faults(name)


@pytest.mark.parametrize(
    ("kind", "values"),
    [
        (Dropout, {"start": 1.0}),
        (Dropout, {"topic": "compass"}),
        (Slip, {"start": -1.0}),
        (Bias, {"start": 1.0, "topic": "lrf_pose"}),
    ],
)
def test_values_made_in_memory_are_checked_as_well(kind: Any, values: dict[str, Any]) -> None:
    with pytest.raises(ParameterError):
        kind(**values)


def test_the_table_tells_every_fault_and_key_with_limits_and_default() -> None:
    table = vocabulary_table()
    rows = [line.split("|") for line in table.splitlines() if line.startswith("|")]
    assert all(len(row) == 7 for row in rows)
    for name, kind in FAULTS.items():
        at = next(i for i, row in enumerate(rows) if row[1].strip() == f"**`{name}`**")
        for row, (key, spec, _) in zip(rows[at + 1 :], fields_of(kind), strict=False):
            assert row[2].strip() == f"`{key}`"
            assert spec.doc in row[3]
            assert (row[5].strip() == "must be given") == spec.required
    assert "`duration` | How long it lasts; left out: to the end. [s] | from 0.0125 to " in table
    assert (
        "| `rate` | Share of the messages with the fault, drawn one by one. | from 0 to 1 | 0.1 |"
        in (table)
    )


@pytest.mark.parametrize("kind", FAULTS.values(), ids=FAULTS)
def test_sentences_are_sentences(kind: Any) -> None:
    for text in (" ".join(kind.__doc__.split()), *(spec.doc for _, spec, _ in fields_of(kind))):
        assert text[0].isupper()
        assert text.endswith(".")
