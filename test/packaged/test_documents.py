# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""What the documents say of the code: links, commands, targets, parameters and numbers."""

import ast
import re
from pathlib import Path

import pytest
import write_thresholds
import yaml
from diagnostic_tables import message_tables
from documents import blocks
from faults.rows import ROWS
from places import ROOT

from fnn_ekf_ros import cli
from fnn_ekf_ros.calibration.findings import KINDS
from fnn_ekf_ros.commands.study import OWN_MODULES
from fnn_ekf_ros.core import relocation
from fnn_ekf_ros.diagnostics.messages import MESSAGES, NAMES
from fnn_ekf_ros.localizer import localizer
from fnn_ekf_ros.messages import (
    LASTING_TOPICS,
    NIS_TOPICS,
    NOISE_FIELDS,
    NUMBER_TOPICS,
    STD_TOPICS,
)
from fnn_ekf_ros.parameters.fake_robot import FakeRobotParameters
from fnn_ekf_ros.parameters.faults import FAULTS
from fnn_ekf_ros.parameters.localizer import LocalizerParameters
from fnn_ekf_ros.parameters.schema import build, default_of, fields_of
from fnn_ekf_ros.study import fault_naming
from fnn_ekf_ros.study.monte_carlo import STUDIES

DOCUMENTS = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]
EVERY_DOCUMENT = pytest.mark.parametrize(
    "path", DOCUMENTS, ids=[str(path.relative_to(ROOT)) for path in DOCUMENTS]
)
STUDY_NAMES = {*STUDIES, *OWN_MODULES}
NS = 1e9


def flat(name: str) -> str:
    """Return a document as one line, so that a phrase may be broken anywhere."""
    return " ".join((ROOT / name).read_text(encoding="utf-8").split())


def anchors(path: Path) -> set[str]:
    """Return the names that a document's headings can be linked by."""
    headings = re.findall(r"^#+ (.*)$", path.read_text(encoding="utf-8"), flags=re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


@EVERY_DOCUMENT
def test_every_relative_link_leads_somewhere(path: Path) -> None:
    for target in re.findall(r"\]\(([^)\s]+)\)", path.read_text(encoding="utf-8")):
        if re.match(r"\w+:", target):
            continue
        name, _, anchor = target.partition("#")
        file = path.parent / name if name else path
        assert file.is_file(), f"{path.name}: {target}"
        if anchor:
            assert anchor in anchors(file), f"{path.name}: {target}"


@EVERY_DOCUMENT
def test_every_file_that_is_named_exists(path: Path) -> None:
    """Named from the root, or from the package; NAME stands for any name."""
    text = path.read_text(encoding="utf-8")
    for name in re.findall(
        r"`((?:\.\./)?\w[\w.-]*/(?:[\w./-]*(?:/|\.(?:py|ya?ml|md|sh|png)))?)`", text
    ):
        if "NAME" not in name and name != "demo/tracks.png":
            assert (ROOT / name).exists() or (ROOT / "fnn_ekf_ros" / name).exists(), name


@EVERY_DOCUMENT
def test_every_command_that_is_named_exists(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    named = re.findall(r"(?:-m|ros2 run) fnn_ekf_ros (\S+)", text)
    assert {name.strip("`") for name in named} - {"NAME"} <= cli.COMMANDS.keys()
    studies = re.findall(r"(?:fnn_ekf_ros |`)study (\w+)", text)
    assert set(studies) - {"WHICH"} <= STUDY_NAMES


def test_the_readme_lists_each_command_and_study() -> None:
    rows = re.findall(r"^\| `([\w-]+)", (ROOT / "README.md").read_text(), flags=re.MULTILINE)
    assert cli.COMMANDS.keys() <= set(rows)
    (line,) = re.findall(r"^\| `study.*$", (ROOT / "README.md").read_text(), flags=re.MULTILINE)
    assert set(re.findall(r"`(\w+)`", line)) == STUDY_NAMES


@EVERY_DOCUMENT
def test_every_target_of_make_exists(path: Path) -> None:
    (phony,) = re.findall(r"^\.PHONY: (.*)$", (ROOT / "Makefile").read_text(), flags=re.MULTILINE)
    text = path.read_text(encoding="utf-8")
    named = re.findall(r"`make (\w+)`", text) + re.findall(r"^ {4,}make (\w+)", text, re.MULTILINE)
    assert set(named) <= set(phony.split())


def test_contributing_names_every_target_of_make_and_every_part_of_the_package() -> None:
    text = (ROOT / "CONTRIBUTING.md").read_text()
    (phony,) = re.findall(r"^\.PHONY: (.*)$", (ROOT / "Makefile").read_text(), flags=re.MULTILINE)
    for target in phony.split():
        assert f"make {target}" in text, target
    for part in (ROOT / "fnn_ekf_ros").iterdir():
        is_module = part.suffix == ".py" and not part.name.startswith("__")
        if is_module or (part / "__init__.py").exists():
            assert f"    {part.name} " in text, part.name


def of_the_layers(name: str) -> dict[str, set[str]]:
    """Return one of the tables of test_layers.py."""
    tree = ast.parse((ROOT / "test" / "test_layers.py").read_text(encoding="utf-8"))
    (found,) = (
        ast.literal_eval(node.value)
        for node in tree.body
        if isinstance(node, ast.AnnAssign | ast.Assign)
        and node.value is not None
        and name in ast.unparse(node).partition(" = ")[0]
    )
    return dict(found)


def test_architecture_has_the_tables_of_the_layers() -> None:
    expected = [
        f"| `{room}` | {', '.join(sorted(may_import))} |".replace("|  |", "| |")
        for room, may_import in of_the_layers("MAY_IMPORT").items()
        if room
    ]
    text = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    _, _, rest = text.partition("| room | may import |\n| --- | --- |\n")
    assert rest.partition("\n\n")[0].splitlines() == expected
    for library, rooms in of_the_layers("ONLY_IN").items():
        phrase = f"{library} in {' and '.join(f'`{room}`' for room in sorted(rooms))}"
        assert phrase in flat("docs/architecture.md"), phrase


@EVERY_DOCUMENT
def test_every_parameter_that_is_set_exists(path: Path) -> None:
    known = {
        name
        for kind in (LocalizerParameters, FakeRobotParameters)
        for name, _, _ in fields_of(kind)
    }
    named = re.findall(r"-p ([^\s:]+):=", path.read_text(encoding="utf-8"))
    assert {name for name in named if not name.startswith("qos_overrides.")} <= known


def test_the_robot_of_the_readme_is_one_that_the_localizer_takes() -> None:
    (block,) = [b for b in blocks((ROOT / "README.md").read_text()) if "ros__parameters" in b]
    given = yaml.safe_load(block.partition("\n\n")[0])["/**/localizer"]["ros__parameters"]
    parameters = build(LocalizerParameters, given)
    assert (parameters.encoder_source, parameters.odom_frame) == ("joint_states", "odom")


def test_diagnostics_has_the_table_of_thresholds_of_the_code() -> None:
    text = (ROOT / "docs" / "diagnostics.md").read_text(encoding="utf-8")
    assert text == write_thresholds.with_table(text), "scripts/write_thresholds.py writes it"


def test_doctor_lists_every_finding_and_no_others() -> None:
    rows = re.findall(
        r"^\| `(\w+)` \| (.*) \|$", (ROOT / "docs/doctor.md").read_text(), re.MULTILINE
    )
    assert rows == list(KINDS.items())


def test_no_threshold_is_in_the_table_twice() -> None:
    words = [each.words for each in write_thresholds.THRESHOLDS]
    assert len(set(words)) == len(words)


def test_diagnostics_lists_every_message_of_every_status_and_no_others() -> None:
    listed = message_tables()
    assert listed.keys() == MESSAGES.keys()
    for status, messages in MESSAGES.items():
        assert sorted(listed[status]) == sorted(messages), status


def test_diagnostics_explains_every_name_in_the_messages() -> None:
    text = (ROOT / "docs" / "diagnostics.md").read_text(encoding="utf-8")
    explained = {
        name: tuple(re.findall(r"`([^`]+)`", meaning))
        for name, meaning in re.findall(r"^- `<(.+?)>`:(.*\n(?:  .*\n)*)", text, re.MULTILINE)
    }
    assert explained == NAMES
    for messages in MESSAGES.values():
        assert {name for text in messages for name in re.findall(r"<(.+?)>", text)} <= NAMES.keys()


def test_the_table_of_noise_has_each_number_once() -> None:
    _, _, table = (ROOT / "docs" / "diagnostics.md").read_text().partition("| index | meaning |")
    indices: list[int] = []
    meaning = {}
    for cell, words in re.findall(r"^\| (\d[\d, -]*) \| (.*) \|$", table, flags=re.MULTILINE):
        for span in cell.split(","):
            first, _, last = span.strip().partition("-")
            indices += range(int(first), int(last or first) + 1)
            meaning[int(first)] = words
    assert indices == list(range(len(NOISE_FIELDS)))
    for name, word in (
        ("measurement_noise_x", "R: x, y"), ("process_noise_forward", "Q for 375 ms"),
        ("nis", "NIS and its degrees"), ("innovation_x", "innovation"),
        ("innovation_variance_x", "variance"), ("mismatch_x", "mismatch"),
        ("firing_increase_x", "firing"), ("log_scale_forward", "log of the variance"),
        ("weight_start", "weights of the hypotheses"), ("nis_compass", "NIS of the compass"),
        ("rejected_compass", "rejected the compass"), ("relocated", "moved"),
        ("firing_increase_distance", "of Q's rules"), ("weight_fix_0", "weights of the members"),
        ("lasting_fix_std", "fixes' lasting errors"), ("compass_offset", "offset of the compass"),
        ("compass_offset_believed", "believed"),
    ):  # fmt: skip
        assert word in meaning[NOISE_FIELDS.index(name)], name


def test_the_table_of_numbers_to_plot_has_each_topic_once_with_its_number() -> None:
    _, _, table = (ROOT / "docs" / "diagnostics.md").read_text().partition("| topic | number |")
    rows = re.findall(r"^\| (`~/.*?`) \| (.*) \|$", table, flags=re.MULTILINE)
    topics = [re.findall(r"`~/([\w/]+)`", cell) for cell, _ in rows]
    assert sorted(topic for row in topics for topic in row) == sorted(NUMBER_TOPICS)
    numbers = {topic: field for field, topic in (STD_TOPICS | LASTING_TOPICS).items()} | {
        topic: topic.replace("/", "_") for topic in NIS_TOPICS
    }
    for row, (_, words) in zip(topics, rows, strict=True):
        found = re.search(r"(?:roots? of|\(number) ([\d, ]+)", words)
        assert found is not None, words
        indices = [NOISE_FIELDS.index(numbers[topic]) for topic in row]
        assert [int(index) for index in found[1].strip().split(", ")] == indices, words
    readme = flat("README.md")
    assert len(NUMBER_TOPICS) == 12
    assert "twelve of its numbers, to plot by name" in readme
    (row_of_readme,) = re.findall(r"\| (`~/noise/.*?) \(out\) \|", readme)
    assert set(re.findall(r"`~/([\w/]+)`", row_of_readme)) <= set(NUMBER_TOPICS)


def test_time_has_the_defaults_and_limits_of_the_code() -> None:
    text = flat("docs/time.md")
    for name in ("period", "output_delay", "encoder_timeout"):
        assert f"`{name}` ({default_of(LocalizerParameters, name):g} s)" in text, name
    assert f"up to `history` ({default_of(LocalizerParameters, 'history'):g} s) late" in text
    assert f"stamps more than {localizer.LARGEST_LEAD_NS / NS:g} s ahead" in text
    assert f"ahead by more than {localizer.LONGEST_SILENCE_PERIODS} periods" in text


def test_time_has_the_defaults_of_the_player_and_its_lead_fits_the_localizer() -> None:
    pytest.importorskip("rclpy")
    from fnn_ekf_ros.ros import play

    text = flat("docs/time.md")
    assert f"`--lead` ({play.DEFAULT_LEAD_S:g} s of recorded time)" in text
    assert f"`--patience` ({play.DEFAULT_PATIENCE_S:g} s)" in text
    period, timeout = (
        default_of(LocalizerParameters, name) for name in ("period", "encoder_timeout")
    )
    wheels_interval_s = 0.1
    assert period + wheels_interval_s < play.DEFAULT_LEAD_S < period + timeout


def test_the_readme_has_the_defaults_of_the_code() -> None:
    text = flat("README.md")
    defaults = {name: value for name, _, value in fields_of(LocalizerParameters)}
    distance, rotation = defaults["process_noise_std"]
    for names, shown in (
        ("max_wheel_speed", f"{defaults['max_wheel_speed']}"),
        ("process_noise_std", f"[{distance:g}, {rotation:.4f}]"),
        (
            "measurement_noise_std",
            "[{:g}, {:g}, {:.4g}]".format(*defaults["measurement_noise_std"]),
        ),
        ("adaptation", defaults["adaptation"]),
        ("compass_gate, lrf_pose_gate", f"{defaults['compass_gate']:.0e}".replace("e-0", "e-")),
        (
            "period, encoder_timeout, history, output_delay",
            "{period}, {encoder_timeout}, {history}, {output_delay}".format(**defaults),
        ),
    ):
        cell = ", ".join(f"`{name}`" for name in names.split(", "))
        assert f"| {cell} | {shown} |" in text, names
    assert defaults["compass_gate"] == defaults["lrf_pose_gate"]
    assert (relocation.CONFIRMATIONS, relocation.CONFIRMATION_S) == (8, 3.0)
    assert "after eight fixes that agree with each other, over three seconds at least" in text


def test_the_rates_of_the_simulated_robot_are_those_of_the_code() -> None:
    text = (ROOT / "docs" / "operation.md").read_text(encoding="utf-8")
    for name, spec, default in fields_of(FakeRobotParameters):
        if name.endswith("_rate"):
            limits = f"{spec.at_least:g} to {spec.at_most:g}"
            assert f"| `{name}` | {default:.5g} | {limits} |" in text


def test_the_lists_of_faults_are_as_long_as_the_documents_say() -> None:
    assert f"{len(FAULTS)} kinds of fault" in flat("docs/results.md")
    assert f"{len(FAULTS)} kinds of fault" in flat("docs/operation.md")
    assert f"**{len(fault_naming.NAMING_CASES)} cases of `study faults`**" in flat(
        "docs/results.md"
    )


def test_the_fault_matrix_is_of_one_version_and_has_all_rows() -> None:
    text = (ROOT / "docs" / "faults.md").read_text(encoding="utf-8")
    assert re.search(r"\(fnn_ekf_ros [\d.]+, commit [0-9a-f]{7,}\); do not edit", text)
    table, _, _ = text.partition("## The vocabulary")
    names = re.findall(r"^\| \*\*(.+?)\*\*<br>", table, flags=re.MULTILINE)
    assert names == [row.name for row in ROWS]
