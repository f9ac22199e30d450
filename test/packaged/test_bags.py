# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The recordings that are part of the project can be made again by the commands beside them."""

import contextlib
import dataclasses
import shlex
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from places import BAGS

from fnn_ekf_ros.cli import run_command
from fnn_ekf_ros.recordings.bag_files import BagReader

NAMES = ("sim1", "sim2", "round")
TOLERANCE = 1e-9


def make_again(name: str, folder: Path) -> Path:
    """Run the command that a bag's README gives."""
    lines = (BAGS / name / "README.md").read_text().splitlines()
    (line,) = [line for line in lines if line.startswith("    python3 -m fnn_ekf_ros ")]
    _, _, _, command, *arguments = shlex.split(line)
    with contextlib.chdir(folder):
        assert run_command(command, arguments) == 0
    return folder / name


def assert_same(one: Any, other: Any, where: str) -> None:
    """Check that two messages are equal, numbers to `TOLERANCE`."""
    assert type(one).__name__ == type(other).__name__, where
    if dataclasses.is_dataclass(one):
        for field in dataclasses.fields(one):
            assert_same(
                getattr(one, field.name), getattr(other, field.name), f"{where}.{field.name}"
            )
    elif isinstance(one, float | np.ndarray):
        np.testing.assert_allclose(one, other, rtol=0.0, atol=TOLERANCE, err_msg=where)
    else:
        assert one == other, where


@pytest.mark.parametrize("name", NAMES)
def test_bag_is_small(name: str) -> None:
    assert sum(file.stat().st_size for file in (BAGS / name).iterdir()) < 10**6


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.slow
def test_bag_has_the_content_its_command_makes(name: str, tmp_path: Path) -> None:
    made = make_again(name, tmp_path)
    assert Path(f"{made}.yaml").read_text() == (BAGS / f"{name}.yaml").read_text()
    with BagReader(BAGS / name) as kept, BagReader(made) as again:
        assert kept.topics == again.topics
        for one, other in zip(kept.records(), again.records(), strict=True):
            where = f"{one.topic} at {one.time_ns}"
            assert (one.topic, one.time_ns) == (other.topic, other.time_ns), where
            if one.data != other.data:
                assert_same(kept.message(one), again.message(other), where)
