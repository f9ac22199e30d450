# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Dependencies point one way: what may import what, and what must work without ROS."""

import ast
import graphlib
import os
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path

import pytest

import fnn_ekf_ros
from fnn_ekf_ros import cli
from fnn_ekf_ros.version import version

PACKAGE = Path(str(fnn_ekf_ros.__file__)).resolve().parent
ROOT = PACKAGE.parent
SOURCE = Path(__file__).resolve().parents[1]
MODULES = {
    ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__"): path
    for path in sorted(PACKAGE.rglob("*.py"))
}

# Part -> the parts it may import besides itself.
MAY_IMPORT: dict[str, set[str]] = {
    "": set(),
    "errors": set(),
    "stopping": set(),
    "version": set(),
    "core": set(),
    "calibration": {"core"},
    "files": {"errors"},
    "parameters": {"core", "errors", "files"},
    "membership": {"core", "errors", "files", "parameters"},
    "timeline": {"core", "parameters"},
    "messages": {"core", "parameters", "timeline"},
    "diagnostics": {"calibration", "core", "parameters", "timeline"},
    "localizer": {"core", "diagnostics", "errors", "files", "messages", "parameters", "timeline"},
    "recordings": {
        "calibration", "core", "diagnostics", "errors", "files", "localizer", "messages",
        "parameters", "timeline",
    },
    "evaluation": {"core", "errors", "recordings", "timeline"},
    "reports": {
        "calibration", "core", "errors", "evaluation", "files", "membership", "parameters",
        "recordings", "timeline",
    },
    "simulation": {"core", "messages", "parameters", "timeline"},
    "study": {
        "calibration", "core", "diagnostics", "errors", "evaluation", "files", "localizer",
        "membership", "messages", "parameters", "recordings", "reports", "simulation", "timeline",
    },
    "training": {
        "core", "errors", "membership", "parameters", "reports", "study", "timeline",
    },
    "tuning": {"core", "errors", "parameters", "simulation", "study", "timeline"},
    "commands": {
        "calibration", "core", "diagnostics", "errors", "evaluation", "files", "localizer",
        "membership", "messages", "parameters", "recordings", "reports", "simulation", "stopping",
        "study", "timeline", "training", "tuning", "version",
    },
    "ros": {
        "core", "diagnostics", "errors", "files", "localizer", "membership", "messages",
        "parameters", "recordings", "reports", "simulation", "stopping", "timeline",
    },
    "cli": {"errors", "stopping", "version"},
    "__main__": {"cli"},
}  # fmt: skip
PURE_STDLIB = {"collections", "dataclasses", "enum", "functools", "itertools", "math", "typing"}
IMPURE_CALLS = {"print", "open", "input", "exec", "eval", "__import__", "breakpoint"}
ROS_SUFFIXES = ("_msgs", "_interfaces", "_srvs", "_py")
ROS_PACKAGES = {"rclpy", "rcl_interfaces", "rosidl_runtime_py", "tf2_ros"}
# (module that needs it, what it needs): the one place for each.
ONLY_IN = {
    "rosbags": {"recordings"}, "matplotlib": {"reports", "study"}, "tqdm": {"reports"},
    "argcomplete": {"cli"},
    "jinja2": {"reports"},
}  # fmt: skip
PURE_PARTS = (
    "calibration", "core", "parameters", "timeline", "messages", "diagnostics", "localizer",
    "simulation", "membership", "training", "errors", "evaluation",
)  # fmt: skip


def imports(path: Path) -> Iterator[str]:
    """Yield every module a file imports, anywhere in it, by its full name."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative imports hide where they lead"
            assert node.module is not None
            yield node.module
            for alias in node.names:  # `from fnn_ekf_ros import messages` names a module, too
                if f"{node.module}.{alias.name}" in MODULES:
                    yield f"{node.module}.{alias.name}"


def part_of(module: str) -> str:
    """Return the part of the package that a module belongs to."""
    _, _, rest = module.partition(".")
    return rest.split(".")[0]


def is_ros(top: str) -> bool:
    return top in ROS_PACKAGES or top.endswith(ROS_SUFFIXES)


def python(code: str, *words: str, path: str = "") -> subprocess.CompletedProcess[str]:
    """Run Python in a process of its own with the package and, before it, `path`."""
    places = os.pathsep.join(filter(None, [path, str(ROOT), os.environ.get("PYTHONPATH", "")]))
    return subprocess.run(
        [sys.executable, *(["-c", code] if code else []), *words],
        capture_output=True, text=True, timeout=60, env=os.environ | {"PYTHONPATH": places},
    )  # fmt: skip


@pytest.fixture(scope="module")
def without_ros(tmp_path_factory: pytest.TempPathFactory) -> str:
    """A folder that hides what may be missing from a process that looks there first."""
    folder = tmp_path_factory.mktemp("without_ros")
    for name in (
        "rclpy", "matplotlib", "tqdm", "argcomplete", "jinja2", "std_msgs", "nav_msgs",
    ):  # fmt: skip
        (folder / f"{name}.py").write_text(f'raise ImportError("{name} is not here")\n')
    return str(folder)


def test_every_part_of_the_package_has_its_place_among_the_layers() -> None:
    assert {part_of(module) for module in MODULES} == set(MAY_IMPORT)


@pytest.mark.parametrize("module", MODULES)
def test_dependencies_point_one_way(module: str) -> None:
    part = part_of(module)
    for imported in imports(MODULES[module]):
        if imported.split(".")[0] == "fnn_ekf_ros" and part_of(imported) not in ("", part):
            assert part_of(imported) in MAY_IMPORT[part], f"{module} imports {imported}"


def test_no_modules_import_each_other() -> None:
    graph = {
        module: {i for i in imports(path) if i in MODULES and i not in ("fnn_ekf_ros", module)}
        for module, path in MODULES.items()
    }
    graphlib.TopologicalSorter(graph).prepare()  # raises CycleError


@pytest.mark.parametrize("module", [m for m in MODULES if part_of(m) == "core"])
def test_core_knows_numpy_and_pure_standard_library_only(module: str) -> None:
    allowed = PURE_STDLIB | {"numpy", "fnn_ekf_ros"}
    assert {imported.split(".")[0] for imported in imports(MODULES[module])} <= allowed


@pytest.mark.parametrize("module", [m for m in MODULES if part_of(m) == "core"])
def test_core_prints_nothing_opens_nothing_and_draws_from_no_global_state(module: str) -> None:
    for node in ast.walk(ast.parse(MODULES[module].read_text(encoding="utf-8"))):
        assert not isinstance(node, ast.Global), f"{module} line {node.lineno}: global"
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
            assert node.func.id not in IMPURE_CALLS, f"{module}, line {node.lineno}"
        if isinstance(node, ast.Attribute) and ast.unparse(node.value) in ("np.random", "random"):
            assert node.attr == "Generator", f"{module} line {node.lineno}: {ast.unparse(node)}"


@pytest.mark.parametrize("module", MODULES)
def test_only_one_place_knows_each_heavy_library(module: str) -> None:
    for imported in imports(MODULES[module]):
        top = imported.split(".")[0]
        if top in ONLY_IN:
            assert part_of(module) in ONLY_IN[top], f"{module} imports {imported}"
        if is_ros(top):
            assert part_of(module) == "ros", f"{module} imports {imported}"


def test_the_check_for_ros_packages_would_find_one() -> None:
    assert all(map(is_ros, ("rclpy", "nav_msgs", "std_srvs", "builtin_interfaces")))
    assert any(is_ros(i.split(".")[0]) for i in imports(MODULES["fnn_ekf_ros.ros.localizer"]))


@pytest.mark.parametrize("module", [m for m in MODULES if part_of(m) not in ("cli", "ros")])
def test_modules_are_imported_by_statements_that_these_tests_can_see(module: str) -> None:
    words = MODULES[module].read_text(encoding="utf-8")
    assert "import_module" not in words
    assert "__import__" not in words


def test_every_module_but_the_nodes_is_imported_without_ros(without_ros: str) -> None:
    names = [m for m in MODULES if part_of(m) not in ("ros", "__main__")]
    code = (
        "import importlib, sys\n"
        f"for name in {names!r}: importlib.import_module(name)\n"
        "print(*sorted({'rclpy', 'matplotlib', 'tqdm', 'jinja2'} & set(sys.modules)))\n"
    )
    ended = python(code, path=without_ros)
    assert (ended.returncode, ended.stdout.strip(), ended.stderr) == (0, "", "")


@pytest.mark.parametrize("part", PURE_PARTS)
@pytest.mark.slow
def test_what_computes_pulls_in_no_library_of_files_or_pictures(part: str) -> None:
    names = [m for m in MODULES if part_of(m) == part]
    heavy = "{'rosbags', 'rclpy', 'matplotlib', 'tqdm'}"
    code = (
        "import importlib, sys\n"
        f"for name in {names!r}: importlib.import_module(name)\n"
        f"print(*sorted({heavy} & set(sys.modules)))\n"
    )
    ended = python(code)
    assert (ended.returncode, ended.stdout.strip(), ended.stderr) == (0, "", "")


def test_the_localizer_node_pulls_in_nothing_heavy() -> None:
    if find_spec("rclpy") is None:
        pytest.skip("rclpy is not installed")
    code = (
        "import sys, fnn_ekf_ros.ros.localizer\n"
        "print(*sorted({'rosbags', 'matplotlib', 'tqdm', 'scipy'} & set(sys.modules)))\n"
    )
    ended = python(code)
    assert (ended.returncode, ended.stdout.strip()) == (0, "")


@pytest.mark.parametrize(
    "name",
    ["simulate", "replay", "import-csv", "doctor", "evaluate", "compare", "train", "study"],
)
@pytest.mark.slow
def test_tools_help_without_ros(without_ros: str, name: str) -> None:
    ended = python("", "-m", "fnn_ekf_ros", name, "--help", path=without_ros)
    assert (ended.returncode, ended.stderr) == (0, "")
    assert ended.stdout.startswith(f"usage: {name} ")


@pytest.mark.parametrize("name", ["localizer", "fake_robot", "play"])
@pytest.mark.slow
def test_nodes_without_ros_say_so_in_one_line(without_ros: str, name: str) -> None:
    ended = python("", "-m", "fnn_ekf_ros", name, *(["x"] if name == "play" else []),
                   path=without_ros)  # fmt: skip
    assert (ended.returncode, ended.stdout) == (1, "")
    assert ended.stderr.startswith(f"{name}: ROS 2 is not here")
    assert ended.stderr.count("\n") == 1


@pytest.mark.parametrize("name", ["", *cli.COMMANDS])
def test_every_command_tells_its_version_without_ros(without_ros: str, name: str) -> None:
    ended = python("", "-m", "fnn_ekf_ros", *filter(None, [name]), "--version", path=without_ros)
    assert (ended.returncode, ended.stderr) == (0, "")
    asked = f"{name} (fnn_ekf_ros)" if name else "fnn_ekf_ros"
    assert ended.stdout == f"{asked} {version()}\n"


def test_the_version_is_that_of_the_manifest_and_in_a_clone_tells_the_commit() -> None:
    number, *commit = version().split(", commit ")
    assert number == ElementTree.parse(SOURCE / "package.xml").findtext("version")
    said = subprocess.run(["git", "-C", ROOT, "rev-parse", "HEAD"], capture_output=True, text=True)
    assert bool(commit) == ((ROOT / ".git").exists() and said.returncode == 0)
    for described in commit:
        assert said.stdout.startswith(described.removesuffix("-dirty").rpartition("-g")[2])


@pytest.mark.parametrize("name", ["localizer", "play"])
@pytest.mark.slow
def test_the_version_is_not_looked_up_for_anything_else(name: str) -> None:
    code = (
        "import fnn_ekf_ros.cli as cli\n"
        "def fail(): raise AssertionError\n"
        "cli.version = fail\n"
        f"cli.run_command('{name}', ['--help'])\n"
    )
    ended = python(code)
    assert ended.returncode == 0, ended.stderr
    assert "--version" in ended.stdout


def test_the_package_lists_its_commands() -> None:
    ended = python("", "-m", "fnn_ekf_ros", "--help")
    assert ended.returncode == 0
    listed = {line.split()[0] for line in ended.stdout.splitlines() if line.startswith("    ")}
    assert listed >= {
        "localizer", "fake_robot", "simulate", "play", "replay", "import-csv", "doctor", "evaluate",
        "compare", "train", "study",
    }  # fmt: skip


def test_an_unknown_command_is_refused() -> None:
    ended = python("", "-m", "fnn_ekf_ros", "reply")
    assert (ended.returncode, ended.stdout) == (2, "")
    assert "reply" in ended.stderr
    assert "Traceback" not in ended.stderr
