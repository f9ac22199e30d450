# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""What import-csv says of columns that it leaves out, and of sigmas."""

import json
from pathlib import Path

import numpy as np
import pytest
from commands import Succeed

from fnn_ekf_ros import messages
from fnn_ekf_ros.parameters.localizer import LocalizerParameters
from fnn_ekf_ros.parameters.schema import fields_of
from fnn_ekf_ros.recordings.bag_files import BagReader
from fnn_ekf_ros.recordings.csv_hints import COVARIANCE_PARAMETER, position_pairs
from fnn_ekf_ros.recordings.csv_tables import Table

NEEDED = "no fixes were imported, and the localizer needs them"


def table(*names: str, empty: str = "") -> Table:
    """Return a table of numbers, but for a column that is empty."""
    return Table(
        Path("run.csv"),
        {name: np.full(3, np.nan if name == empty else 1.0) for name in names},
    )


def write(path: Path, names: str, *rows: str) -> Path:
    path.write_text("\n".join([names, *rows]) + "\n")
    return path


def imported(tmp_path: Path, succeed: Succeed, names: str, rows: list[str], *words: object) -> str:
    """Import a table of ticks, with further columns; return what is said after the counts."""
    source = write(
        tmp_path / "run.csv", f"t,left_ticks,right_ticks{names}",
        *(f"{number},{number},{number}{row}" for number, row in enumerate(rows, start=1)),
    )  # fmt: skip
    geometry = tmp_path / "run.json"
    geometry.write_text(json.dumps({"wheel_base_m": 0.3, "metres_per_tick": 0.001}))
    said = succeed("import-csv", source, tmp_path / "bag", "--geometry", geometry, *words)
    _, *notes = said.splitlines()
    return "\n".join(notes)


@pytest.mark.parametrize(
    ("names", "pairs"),
    [
        (("t", "gps_x", "gps_y"), [("gps_x", "gps_y")]),
        (("x", "y", "theta"), [("x", "y")]),
        (("X_utm", "Y_utm"), [("X_utm", "Y_utm")]),
        (("pos.x", "pos.y", "pos.z"), [("pos.x", "pos.y")]),
        (("x_m", "y_m", "amcl_x", "amcl_y"), [("x_m", "y_m"), ("amcl_x", "amcl_y")]),
        (("gps_x", "uwb_y"), []),
        (("vel_x", "vel_y"), []),
        (("sig_x", "sig_y"), []),
        (("gt_x_aligned", "gt_y_aligned"), []),
        (("max", "may"), []),
    ],
)
def test_positions_are_pairs_of_names_that_differ_in_x_and_y(
    names: tuple[str, ...], pairs: list[tuple[str, str]]
) -> None:
    assert position_pairs(table(*names), []) == pairs


def test_columns_that_are_used_or_empty_are_no_positions() -> None:
    assert position_pairs(table("a_x", "a_y", "b_x", "b_y"), ["a_x", "a_y"]) == [("b_x", "b_y")]
    assert position_pairs(table("b_x", "b_y", empty="b_y"), []) == []


def test_fixes_that_are_forgotten_are_named(tmp_path: Path, succeed: Succeed) -> None:
    said = imported(tmp_path, succeed, ",gps_x,gps_y,heading_meas", [",1,2,0.1", ",,,0.2"])
    assert said == (
        f"import-csv: {NEEDED}; '{tmp_path / 'run.csv'}' has gps_x, gps_y: --fix-columns gps_x "
        "gps_y takes them"
    )


def test_a_table_without_positions_needs_fixes_from_elsewhere(
    tmp_path: Path, succeed: Succeed
) -> None:
    said = imported(tmp_path, succeed, ",gt_x,gt_y", [",1,2", ",1,2"])
    assert said == f"import-csv: {NEEDED}: --fixes CSV, or --fix-columns X Y of " + (
        f"'{tmp_path / 'run.csv'}'"
    )


def test_fixes_without_a_number_are_reported(tmp_path: Path, succeed: Succeed) -> None:
    said = imported(tmp_path, succeed, ",fix_x,fix_y", [",1,", ",,2"])
    assert said == (
        f"import-csv: no fix was imported: no line of '{tmp_path / 'run.csv'}' has a number in "
        "each of fix_x, fix_y"
    )


def test_a_yaw_that_is_forgotten_is_named(tmp_path: Path, succeed: Succeed) -> None:
    said = imported(tmp_path, succeed, ",fix_x,fix_y,imu_yaw,true_yaw", [",1,2,3,3", ",1,2,3,3"])
    assert said.startswith("import-csv: no yaw was imported, and the localizer needs one to start")
    assert said.endswith(f"'{tmp_path / 'run.csv'}' has imu_yaw")


@pytest.mark.parametrize("words", [("--fix-columns", "gps_x", "gps_y"), ()])
def test_nothing_is_said_of_a_recording_that_is_whole(
    tmp_path: Path, succeed: Succeed, words: tuple[str, ...]
) -> None:
    names = ",gps_x,gps_y,heading_meas" if words else ",fix_x,fix_y,heading_meas"
    assert imported(tmp_path, succeed, names, [",1,2,3", ",1,2,3"], *words) == ""


def test_sigmas_name_the_parameter_that_uses_them(tmp_path: Path, succeed: Succeed) -> None:
    """Fixes without a yaw need no sigma of it."""
    names = ",fix_x,fix_y,heading_meas,sig_x,sig_y"
    said = imported(tmp_path, succeed, names, [",1,2,3,0.1,0.2", ",1,2,3,0.1,", ",,,,,"])
    first, second = said.splitlines()
    path = tmp_path / "run.csv"
    assert first == (
        f"import-csv: sig_x, sig_y of '{path}' are the covariance of lrf_pose: the localizer uses "
        "them with lrf_use_message_covariance: true only (-p lrf_use_message_covariance:=true)"
    )
    assert second == (
        "import-csv: 1 of 2 fixes have no usable sig_x, sig_y: with lrf_use_message_covariance "
        "they are refused"
    )
    assert COVARIANCE_PARAMETER in {name for name, _, _ in fields_of(LocalizerParameters)}
    with BagReader(tmp_path / "bag") as bag:
        one, other = (bag.message(record) for record in bag.records({"/lrf_pose"}))
    np.testing.assert_allclose(
        messages.planar_block(one.pose.covariance), np.diag([0.01, 0.04, 0.0]), atol=1e-15
    )
    np.testing.assert_array_equal(messages.planar_block(other.pose.covariance), 0.0)


def test_sigmas_that_are_of_no_use_are_reported(tmp_path: Path, succeed: Succeed) -> None:
    """A fix with a yaw needs a sigma of it."""
    names = ",fix_x,fix_y,fix_theta,sig_x,sig_y"
    said = imported(tmp_path, succeed, names, [",1,2,3,0.1,0.2"] * 2)
    assert said == (
        f"import-csv: sig_x, sig_y of '{tmp_path / 'run.csv'}' were not used: expected standard "
        "deviations of fix_x, fix_y, fix_theta, all greater than 0"
    )
