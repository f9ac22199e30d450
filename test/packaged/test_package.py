# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""What is shipped: the manifest, the executables, a plain pip installation."""

import ast
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import license_headers
import pytest
from catkin_pkg.package import parse_package
from places import ROOT

from fnn_ekf_ros import cli
from fnn_ekf_ros.parameters.fake_robot import FakeRobotParameters
from fnn_ekf_ros.parameters.localizer import LocalizerParameters
from fnn_ekf_ros.parameters.schema import fields_of


def assigned_in_setup(name: str) -> dict[str, Any]:
    """Return a table of setup.py: COMMANDS, name to function, or SHARED, folder to files."""
    for node in ast.parse((ROOT / "setup.py").read_text()).body:
        if isinstance(node, ast.Assign) and getattr(node.targets[0], "id", "") == name:
            return dict(ast.literal_eval(node.value))
    raise AssertionError(f"setup.py has no {name}")


def test_the_manifest_is_valid() -> None:
    package = parse_package(str(ROOT / "package.xml"))
    assert package.name == "fnn_ekf_ros"
    assert package.package_format == 3
    assert package.get_build_type() == "ament_python"


def test_every_executable_is_declared_and_has_its_function() -> None:
    declared = assigned_in_setup("COMMANDS")
    assert declared.keys() == cli.COMMANDS.keys()
    for name, function in declared.items():
        assert getattr(cli, function).args == (name,)


def test_the_readme_names_every_executable_and_topic() -> None:
    readme = (ROOT / "README.md").read_text()
    for name in cli.COMMANDS:
        assert f"`{name}" in readme
    for topic in ("left_ticks", "joint_states", "compass", "lrf_pose", "initialpose", "~/noise"):
        assert f"`{topic}`" in readme


@pytest.mark.parametrize("kind", [LocalizerParameters, FakeRobotParameters])
def test_sentences_of_parameters_are_sentences(kind: type) -> None:
    for name, spec, _ in fields_of(kind):
        assert spec.doc[0].isupper() or spec.doc.startswith("tsukamoto"), name
        assert spec.doc.endswith("."), name


@pytest.mark.slow
def test_plain_pip_installs_a_package_that_runs(tmp_path: Path) -> None:
    target, source = tmp_path / "installed", tmp_path / "source"
    # pip builds inside the source tree and would take stale files of an earlier build along.
    ignored = shutil.ignore_patterns(".*", "build", "bags", "demo", "test", "*.egg-info")
    shutil.copytree(ROOT, source, ignore=ignored)
    subprocess.run(
        [
            sys.executable, "-m", "pip", "install", "--quiet", "--no-deps",
            "--no-build-isolation", "--disable-pip-version-check", "--target", str(target),
            str(source),
        ],
        check=True,
        capture_output=True,
    )  # fmt: skip
    shared = target / "share"
    for folder, files in assigned_in_setup("SHARED").items():
        for name in files:
            assert (shared / "fnn_ekf_ros" / folder / name).is_file()
    assert (shared / "ament_index" / "resource_index" / "packages" / "fnn_ekf_ros").is_file()
    environment = {**os.environ, "PYTHONPATH": str(target)}
    for arguments in (["simulate", "run", "--duration", "5"], ["replay", "run", "out",
                      "--params", "run.yaml", "-p", "adaptation:=r"]):  # fmt: skip
        ran = subprocess.run(
            [sys.executable, "-m", "fnn_ekf_ros", *arguments],
            env=environment, cwd=tmp_path, capture_output=True, text=True, check=False,
        )  # fmt: skip
        assert ran.returncode == 0, ran.stderr
    where = subprocess.run(
        [sys.executable, "-c", "import fnn_ekf_ros; print(fnn_ekf_ros.__file__)"],
        env=environment, cwd=tmp_path, capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert Path(where.stdout.strip()).is_relative_to(target)


def test_every_source_file_states_its_copyright_and_license() -> None:
    lines = license_headers.header(ROOT)
    assert "Apache-2.0" in lines
    for path in license_headers.sources(ROOT):
        text = path.read_text()
        assert license_headers.with_header(text, lines) == text, path.relative_to(ROOT)


def test_a_header_is_written_once_and_below_an_interpreter_line() -> None:
    lines = license_headers.header(ROOT)
    assert license_headers.with_header("import os\n", lines) == f"{lines}\nimport os\n"
    assert license_headers.with_header("#!/bin/sh\ntrue\n", lines) == f"#!/bin/sh\n{lines}\ntrue\n"
    assert license_headers.with_header(f"{lines}\nx\n", lines) == f"{lines}\nx\n"
