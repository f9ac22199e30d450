# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Parameter files: reading them as ROS does, writing them, and the ones in config/."""

import math
from dataclasses import asdict
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from places import CONFIG

from fnn_ekf_ros.parameters.fake_robot import FakeRobotParameters
from fnn_ekf_ros.parameters.files import (
    parse_assignment,
    read_parameter_file,
    render_parameter_file,
)
from fnn_ekf_ros.parameters.localizer import LocalizerParameters
from fnn_ekf_ros.parameters.schema import ParameterError, Parameters, build, fields_of


@pytest.fixture
def read(tmp_path: Path) -> Any:
    """Reads a text as a parameter file for `localizer`."""

    def reader(text: str, node_name: str = "localizer") -> dict[str, Any]:
        path = tmp_path / "parameters.yaml"
        path.write_text(text, encoding="utf-8")
        return read_parameter_file(path, node_name)

    return reader


def section(name: str, body: str = "wheel_radius: 0.1") -> str:
    return f"{name}:\n  ros__parameters:\n    {body}\n"


@pytest.mark.parametrize(
    "name",
    ["/**", "/*", "/**/localizer", "localizer", "/localizer", "/one/localizer", "/a/b/localizer"],
)
def test_sections_for_the_node_are_read(read: Any, name: str) -> None:
    assert read(section(name)) == {"wheel_radius": 0.1}


@pytest.mark.parametrize(
    "name", ["other", "/**/other", "/localizer/other", "my_localizer", "localizer2", "/localizer_x"]
)
def test_sections_for_others_are_not(read: Any, name: str, tmp_path: Path) -> None:
    with pytest.raises(ParameterError, match="has no section for localizer, but for ") as refused:
        read(section(name))
    assert f"but for /{name.strip('/')}: expected '/**/localizer:' or '/**:'" in str(refused.value)
    path = tmp_path / "parameters.yaml"
    assert read_parameter_file(path, "localizer", has_section=False) == {}
    assert read(section(name, "period: 0.1") + section("localizer")) == {"wheel_radius": 0.1}


def test_namespaces_may_be_nested(read: Any) -> None:
    text = "robot1:\n  inner:\n    localizer:\n      ros__parameters:\n        gear_ratio: 2\n"
    assert read(text) == {"gear_ratio": 2}


def test_of_several_sections_the_later_wins(read: Any) -> None:
    first, second = section("/**", "period: 0.1"), section("localizer", "period: 0.2")
    assert read(first + second) == {"period": 0.2}
    assert read(second + first) == {"period": 0.1}


def test_an_empty_section_and_one_without_parameters(read: Any) -> None:
    assert read("localizer:\n  ros__parameters:\n") == {}


def test_nested_parameters_get_dotted_names(read: Any) -> None:
    body = "qos_overrides:\n      /odom:\n        publisher: {depth: 5}"
    assert read(section("localizer", body)) == {"qos_overrides./odom.publisher.depth": 5}


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("1e-3", 1e-3), ("1E+3", 1e3), ("-2e2", -200.0), ("1.e-3", 1e-3), ("1.5e-3", 1.5e-3),
        ("0.1", 0.1), ("3", 3), (".inf", math.inf), ("off", False), ("'off'", "off"),
        ("none", "none"), ("[0.02, 1e-2]", [0.02, 1e-2]), ("true", True), ("e3", "e3"),
        ("1e", "1e"),
    ],
)  # fmt: skip
def test_values_are_read_as_ros_reads_them(read: Any, text: str, value: Any) -> None:
    for found in (
        read(section("localizer", f"wheel_radius: {text}"))["wheel_radius"],
        parse_assignment(f"wheel_radius:={text}")[1],
    ):
        assert (found, type(found)) == (value, type(value))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "holds no sections"),
        ("just words", "holds no sections"),
        ("- a\n- b\n", "holds no sections"),
        ("wheel_radius: 0.1\n", "has no 'ros__parameters'"),
        ("localizer:\n  wheel_radius: 0.1\n", "has no 'ros__parameters'"),
        ("localizer:\n  ros__parameters: 3\n", "expected '/**/localizer:'"),
        ("localizer:\n  ros__parameters: [1]\n", "expected '/**/localizer:'"),
        ("localizer: [1, 2\n", "is not YAML"),
        ("localizer:\n\t- a: b\n", "is not YAML"),
        ("a: &x\n  b: *y\n", "is not YAML"),
        ("a: !!python/object:os.system {}\n", "is not YAML"),
    ],
)
def test_what_is_no_parameter_file_is_refused_in_one_line(read: Any, text: str, words: str) -> None:
    with pytest.raises(ParameterError) as caught:
        read(text)
    line = str(caught.value)
    assert "\n" not in line
    assert "parameters.yaml" in line
    assert words in line


def test_parameters_without_a_node_are_refused(read: Any) -> None:
    with pytest.raises(ParameterError, match="expected '/\\*\\*/localizer:'"):
        read("ros__parameters:\n  wheel_radius: 0.1\n")


def test_files_that_cannot_be_read_are_refused_in_one_line(tmp_path: Path) -> None:
    binary = tmp_path / "binary.yaml"
    binary.write_bytes(b"\xff\xfe\x00\x80")
    for path, words in (
        (tmp_path / "missing.yaml", "does not exist: expected a text file"),
        (tmp_path, "is no file"),
        (binary, "is no text file"),
    ):
        with pytest.raises(ParameterError) as caught:
            read_parameter_file(path, "localizer")
        assert words in str(caught.value)
        assert str(path) in str(caught.value)
        assert "\n" not in str(caught.value)


def test_assignments() -> None:
    assert parse_assignment("a:=1") == ("a", 1)
    assert parse_assignment("a:=[0.02, 0.017]") == ("a", [0.02, 0.017])
    assert parse_assignment("a:=b:=c") == ("a", "b:=c")
    assert parse_assignment("a:=") == ("a", None)


@pytest.mark.parametrize("text", ["a=1", "a", "", ":=1", "a:=[1,", "a:={"])
def test_what_is_no_assignment_is_refused(text: str) -> None:
    with pytest.raises(ParameterError) as caught:
        parse_assignment(text)
    line = str(caught.value)
    assert line.startswith(f"-p {text.partition('=')[0]}")
    assert "\n" not in line
    assert "expected name:=value" in line or "is not YAML" in line


WORDS = st.text(
    st.characters(codec="utf-8", exclude_categories=("Cc", "Cs", "Zl", "Zp")),
    min_size=1, max_size=60,
).filter(str.isprintable)  # fmt: skip


def numbers(low: float, high: float) -> st.SearchStrategy[float]:
    return st.floats(low, high, allow_subnormal=False)


@settings(derandomize=True, deadline=None, max_examples=60)
@given(
    radius=numbers(1e-3, 10.0), bits=st.integers(8, 32), truth=st.booleans(),
    frame=WORDS, pose=st.tuples(*[numbers(-1e6, 1e6)] * 3),
)  # fmt: skip
@pytest.mark.slow
def test_written_read_and_built_it_is_the_same(
    tmp_path_factory: pytest.TempPathFactory, radius: float, bits: int, truth: bool, frame: str,
    pose: tuple[float, float, float],
) -> None:  # fmt: skip
    made = LocalizerParameters(
        wheel_radius=radius, wheel_separation=0.6, encoder_counts_per_revolution=500.0,
        encoder_bits=bits, left_inverted=truth, frame_id=frame, initial_pose=pose,
    )  # fmt: skip
    path = tmp_path_factory.mktemp("rendered") / "localizer.yaml"
    path.write_text(
        render_parameter_file(LocalizerParameters, asdict(made), "localizer", "A head."),
        encoding="utf-8",
    )
    assert build(LocalizerParameters, read_parameter_file(path, "localizer")) == made
    assert read_parameter_file(path, "other", has_section=False) == {}


@pytest.mark.parametrize(
    "path",
    [
        "off", "null", "~", "# comment", "a: b", "[1]", "'quoted'", "  ", "*x", "%y", "-",
        "/home/somebody/membership.yaml", "straße/ü.yaml",
        "1e-3",
        "/home/somebody/robots and sensors/" + "one folder and another/" * 4 + "sets.yaml",
    ],
)  # fmt: skip
def test_words_that_yaml_could_misread_survive(tmp_path: Path, path: str) -> None:
    made = LocalizerParameters(
        wheel_radius=0.1, wheel_separation=0.6, encoder_counts_per_revolution=1.0,
        membership_file=path,
    )  # fmt: skip
    file = tmp_path / "localizer.yaml"
    file.write_text(render_parameter_file(LocalizerParameters, asdict(made), "localizer"), "utf-8")
    found = read_parameter_file(file, "localizer")
    assert found["membership_file"] == path


def test_an_initial_pose_that_is_not_set_survives(tmp_path: Path) -> None:
    made = LocalizerParameters(
        wheel_radius=0.1, wheel_separation=0.6, encoder_counts_per_revolution=1.0
    )
    file = tmp_path / "localizer.yaml"
    file.write_text(render_parameter_file(LocalizerParameters, asdict(made), "localizer"))
    read_again = build(LocalizerParameters, read_parameter_file(file, "localizer"))
    assert all(map(math.isnan, read_again.initial_pose))
    assert asdict(read_again) | {"initial_pose": 0} == asdict(made) | {"initial_pose": 0}


@pytest.mark.parametrize(
    ("kind", "node_name"),
    [(LocalizerParameters, "localizer"), (FakeRobotParameters, "fake_robot")],
)
def test_the_files_in_config_hold_the_defaults(kind: type[Parameters], node_name: str) -> None:
    path = CONFIG / f"{node_name}.yaml"
    found = read_parameter_file(path, node_name)
    defaults = {name: default for name, _, default in fields_of(kind)}
    assert list(found) == list(defaults)
    for name, default in defaults.items():
        value = tuple(found[name]) if isinstance(default, tuple) else found[name]
        if default == default and not (isinstance(default, tuple) and math.isnan(default[0])):
            assert (value, type(value)) == (default, type(default)), name
        else:
            assert isinstance(value, tuple)
            assert all(map(math.isnan, value))
    assert f"\n/**/{node_name}:\n" in path.read_text(encoding="utf-8")


def test_the_localizer_file_in_config_needs_the_geometry_only() -> None:
    values = read_parameter_file(CONFIG / "localizer.yaml", "localizer")
    with pytest.raises(ParameterError, match="'wheel_radius' is not set"):
        build(LocalizerParameters, values)
    geometry = {
        "wheel_radius": 0.1, "wheel_separation": 0.5, "encoder_counts_per_revolution": 100,
    }  # fmt: skip
    assert build(LocalizerParameters, values | geometry).wheel_radius == 0.1
    robot = read_parameter_file(CONFIG / "fake_robot.yaml", "fake_robot")
    assert repr(build(FakeRobotParameters, robot)) == repr(FakeRobotParameters())
