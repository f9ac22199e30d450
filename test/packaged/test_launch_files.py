# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Launch files: they parse, and whatever they name exists. Needs no ROS."""

import ast
import importlib.util
import re
import runpy
import sys
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

import pytest
from places import ROOT

from fnn_ekf_ros import cli, messages
from fnn_ekf_ros.parameters.fake_robot import FakeRobotParameters
from fnn_ekf_ros.parameters.localizer import LocalizerParameters
from fnn_ekf_ros.parameters.schema import build, fields_of

FILES = sorted((ROOT / "launch").glob("*.launch.py"))
SETS = {"localizer": LocalizerParameters, "fake_robot": FakeRobotParameters}
STUBBED = {
    "ament_index_python": (),
    "ament_index_python.packages": ("get_package_prefix",),
    "launch": ("LaunchDescription",),
    "launch.actions": ("DeclareLaunchArgument", "LogInfo", "Shutdown"),
    "launch.conditions": ("IfCondition",),
    "launch.substitutions": ("LaunchConfiguration", "PathJoinSubstitution"),
    "launch_ros": (),
    "launch_ros.actions": ("Node",),
    "launch_ros.parameter_descriptions": ("ParameterValue",),
    "launch_ros.substitutions": ("FindPackageShare",),
}
"""What the launch files import: module -> names; the first part of a module is one, too."""


@dataclass(frozen=True, eq=False)
class Made:
    """What a launch file has made: the name of a class of launch and its arguments."""

    kind: str
    given: tuple[Any, ...]
    named: dict[str, Any]


class Described(NamedTuple):
    """A launch file that was run: its arguments, and the rest in order."""

    arguments: dict[str, dict[str, Any]]
    nodes: dict[str, dict[str, Any]]
    others: list[Made]
    made: list[Made]

    def value(self, given: Any, **values: str) -> Any:
        """Return what launch makes of a value; arguments have their defaults, or `values`."""
        if isinstance(given, list | tuple):
            return "".join(self.value(part, **values) for part in given)
        if not isinstance(given, Made):
            return given
        if given.kind == "LaunchConfiguration":
            (name,) = given.given
            return values.get(name, self.arguments[name].get("default_value"))
        if given.kind == "ParameterValue":
            return given.named["value_type"](self.value(given.given[0], **values))
        if given.kind == "FindPackageShare":
            assert given.given == ("fnn_ekf_ros",)
            return str(ROOT)
        assert given.kind == "PathJoinSubstitution", given
        return "/".join(self.value(part, **values) for part in given.given[0])

    def parameters(self, executable: str) -> dict[str, Any]:
        """Return a node's parameters."""
        entries = self.nodes[executable].get("parameters", [])
        return {n: self.value(v) for entry in entries for n, v in entry.items()}


Describe = Callable[..., Described]


@pytest.fixture
def describe(monkeypatch: pytest.MonkeyPatch) -> Describe:
    """Runs a launch file on stand-ins of launch and launch_ros."""
    made: list[Made] = []
    installed: set[str] = set()

    def stand_in(kind: str) -> Callable[..., Made]:
        def make(*given: Any, **named: Any) -> Made:
            made.append(Made(kind, given, named))
            return made[-1]

        return make

    class PackageNotFoundError(KeyError):
        pass

    def get_package_prefix(name: str) -> str:
        if name not in installed:
            raise PackageNotFoundError(name)
        return "/prefix"

    for name, contents in STUBBED.items():
        module = ModuleType(name)
        for kind in contents:
            setattr(module, kind, stand_in(kind))
        monkeypatch.setitem(sys.modules, name, module)
    packages: Any = sys.modules["ament_index_python.packages"]
    packages.get_package_prefix = get_package_prefix
    packages.PackageNotFoundError = PackageNotFoundError

    def run(name: str, *there: str) -> Described:
        installed.update(there)
        made.clear()
        run_file = runpy.run_path(str(ROOT / "launch" / name))
        description = run_file["generate_launch_description"]()
        assert description.kind == "LaunchDescription"
        (entities,) = description.given
        by_kind = [(entity.kind, entity) for entity in entities]
        nodes = [entity.named for kind, entity in by_kind if kind == "Node"]
        return Described(
            {e.given[0]: e.named for kind, e in by_kind if kind == "DeclareLaunchArgument"},
            {node["executable"]: node for node in nodes},
            [e for kind, e in by_kind if kind not in ("Node", "DeclareLaunchArgument")],
            list(made),
        )

    return run


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.name)
def test_a_launch_file_names_what_exists(describe: Describe, path: Path) -> None:
    found = describe(path.name, "rviz2")
    for node in found.nodes.values():
        if node["package"] == "fnn_ekf_ros":
            assert cli.COMMANDS[node["executable"]].is_node
            known = {name for name, _, _ in fields_of(SETS[node["executable"]])}
            assert found.parameters(node["executable"]).keys() <= known
        else:
            assert (node["package"], node["executable"]) == ("rviz2", "rviz2")
    used = [m.given[0] for m in found.made if m.kind == "LaunchConfiguration"]
    assert set(used) == set(found.arguments)
    for argument in found.arguments.values():
        assert argument["description"].endswith(".")


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.name)
def test_a_launch_file_imports_what_the_manifest_depends_on(path: Path) -> None:
    manifest = ElementTree.parse(ROOT / "package.xml").getroot()
    depends = {element.text for element in manifest.iter("exec_depend")}
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom | ast.Import):
            names = (
                [node.module] if isinstance(node, ast.ImportFrom) else [a.name for a in node.names]
            )
            assert {str(name).partition(".")[0] for name in names} <= depends


def test_localizer_launch_needs_a_parameter_file_and_hands_on_its_arguments(
    describe: Describe,
) -> None:
    found = describe("localizer.launch.py")
    assert [n for n, a in found.arguments.items() if "default_value" not in a] == ["params_file"]
    (node,) = found.nodes.values()
    given = {"params_file": "my.yaml", "use_sim_time": "true", "log_level": "warn"}
    assert [found.value(word, **given) for word in node["ros_arguments"]] == [
        "--params-file", "my.yaml", "-p", "use_sim_time:=true", "--log-level", "warn",
    ]  # fmt: skip
    assert found.value(node["namespace"]) == ""
    assert found.value(node["namespace"], namespace="robot1") == "robot1"
    for name in ("use_sim_time", "log_level"):
        assert found.arguments[name]["default_value"] in found.arguments[name]["choices"]


def test_localizer_launch_remaps_every_topic_that_has_no_tilde(describe: Describe) -> None:
    found = describe("localizer.launch.py")
    (node,) = found.nodes.values()
    topics = {*messages.INPUT_TYPES, messages.ODOM}
    assert {source for source, _ in node["remappings"]} == topics
    for source, target in node["remappings"]:
        assert found.value(target) == source
        assert found.value(target, **{source: "/other"}) == "/other"


def test_demo_launch_starts_the_robot_and_a_localizer_that_fits(describe: Describe) -> None:
    found = describe("demo.launch.py")
    assert set(found.nodes) == {"fake_robot", "localizer"}
    robot = build(FakeRobotParameters, found.parameters("fake_robot"))
    localizer = build(LocalizerParameters, found.parameters("localizer"))
    assert robot == build(FakeRobotParameters, {"path": robot.path})
    for name in ("wheel_radius", "wheel_separation", "encoder_counts_per_revolution", "gear_ratio"):
        assert getattr(localizer, name) == getattr(robot, name), name
    assert (localizer.frame_id, localizer.base_frame) == (robot.frame_id, robot.base_frame)
    specs = {name: spec for name, spec, _ in fields_of(FakeRobotParameters)}
    for path in specs["path"].choices:
        assert path in found.arguments["path"]["description"], path
    for node in found.nodes.values():
        assert node["on_exit"].kind == "Shutdown"
    (example,) = re.findall(r"share/fnn_ekf_ros/(\S+)\.$",
                            found.arguments["faults_file"]["description"])  # fmt: skip
    assert (ROOT / example).is_file()


def test_demo_launch_opens_rviz_only_where_it_is_installed(describe: Describe) -> None:
    (said,) = describe("demo.launch.py").others
    assert said.kind == "LogInfo"
    assert said.named["condition"].given[0].given == ("rviz",)
    found = describe("demo.launch.py", "rviz2")
    rviz = found.nodes["rviz2"]
    assert not found.others
    assert rviz["condition"].given[0].given == ("rviz",)
    option, config = map(found.value, rviz["arguments"])
    assert option == "-d"
    assert Path(config).is_file()


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.name)
def test_a_launch_file_runs_on_launch_itself(path: Path) -> None:
    """Where a ROS installation has it; the folder `launch` is no package."""
    if not (importlib.util.find_spec("launch_ros") and importlib.util.find_spec("launch.actions")):
        pytest.skip("launch is not installed")
    description = runpy.run_path(str(path))["generate_launch_description"]()
    names = [argument.name for argument in description.get_launch_arguments()]
    assert len(names) == len(set(names)) >= 3


def test_setup_installs_every_launch_file_and_layout() -> None:
    (shared,) = [
        ast.literal_eval(node.value)
        for node in ast.parse((ROOT / "setup.py").read_text()).body
        if isinstance(node, ast.Assign) and getattr(node.targets[0], "id", "") == "SHARED"
    ]
    for folder in ("launch", "config"):
        files = [p.name for p in (ROOT / folder).iterdir() if p.is_file()]
        assert sorted(shared[folder]) == sorted(files)


def test_the_readme_names_launch_files_and_layouts() -> None:
    readme = (ROOT / "README.md").read_text()
    for path in (ROOT / "README.md", *(ROOT / "docs").glob("*.md")):
        launched = re.findall(r"ros2 launch fnn_ekf_ros (\S+)(.*)", path.read_text())
        for name, words in launched:
            text = (ROOT / "launch" / name).read_text()
            for argument in re.findall(r"(\w+):=", words):
                assert f'"{argument}"' in text, argument
    assert {path.name for path in FILES} <= set(re.findall(r"\w+\.launch\.py", readme))
    for name in ("localizer.rviz", "foxglove_layout.json", "plotjuggler_layout.xml"):
        assert name in readme
