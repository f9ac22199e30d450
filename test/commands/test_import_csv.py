# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The command import-csv, as from a shell: tables in, bags out."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
from commands import Refuse, Succeed, records, table_rows

from fnn_ekf_ros import messages
from fnn_ekf_ros.parameters.files import read_parameter_file
from fnn_ekf_ros.parameters.localizer import LocalizerParameters
from fnn_ekf_ros.parameters.schema import build
from fnn_ekf_ros.recordings.bag_files import BagReader

ARC_GEOMETRY = {"wheel_base_m": 0.5, "metres_per_tick": 1e-5}


def write_arc(folder: Path, truth_yaw: bool = True) -> tuple[Path, Path]:
    """Write an exact recording of a robot on a circle, and its geometry; returns the two files."""
    names = ["t", "left_ticks", "right_ticks", "gt_x", "gt_y", "fix_x", "fix_y", "heading_meas"]
    names += ["gt_theta"] if truth_yaw else []
    lines = [",".join(names)]
    speed, rate = 0.4, 0.25
    for number in range(801):
        time = 0.05 * number
        turn = rate * time
        x, y = speed / rate * math.sin(turn), speed / rate * (1.0 - math.cos(turn))
        left, right = (round((speed + s * 0.25 * rate) * time / 1e-5) for s in (-1.0, 1.0))
        yaw = math.remainder(turn, 2.0 * math.pi)
        values = [time + 100.0, left, right, x, y, x, y, yaw]
        values += [yaw] if truth_yaw else []
        cells = [repr(value) for value in values]
        if number % 5:
            cells[5] = cells[6] = ""
        if number % 3:
            cells[7] = "nan"
        lines.append(",".join(cells))
    table, geometry = folder / "arc.csv", folder / "arc.json"
    table.write_text("\n".join(lines) + "\n")
    geometry.write_text(json.dumps(ARC_GEOMETRY))
    return table, geometry


@pytest.mark.slow
def test_an_exact_arc_imported_replayed_and_evaluated(tmp_path: Path, succeed: Succeed) -> None:
    table, geometry = write_arc(tmp_path)
    said = succeed("import-csv", table, tmp_path / "bag", "--geometry", geometry)
    for part in ("801 left_ticks", "801 right_ticks", "161 lrf_pose", "267 compass",
                 "801 ground_truth"):  # fmt: skip
        assert part in said
    parameters = build(LocalizerParameters, read_parameter_file(tmp_path / "bag.yaml", "localizer"))
    assert parameters.wheel_separation == 0.5
    way = 2.0 * math.pi * parameters.wheel_radius / parameters.encoder_counts_per_revolution
    assert way == pytest.approx(1e-5)
    assert not parameters.lrf_use_yaw
    words = ["--params", tmp_path / "bag.yaml"]
    succeed("replay", tmp_path / "bag", tmp_path / "out", *words)
    succeed("evaluate", tmp_path / "out", "--labels", "arc", "--json", tmp_path / "errors.json")
    arc = json.loads((tmp_path / "errors.json").read_text())["arc"]
    assert arc["count"] > 100
    # Truth is interpolated linearly between samples 2 cm apart, on a radius of 1.6 m: 31 um.
    assert arc["rmse_position"] < 1e-4
    assert arc["rmse_theta"] < 1e-4


@pytest.mark.slow
def test_truth_without_heading_gives_no_theta(tmp_path: Path, succeed: Succeed) -> None:
    table, geometry = write_arc(tmp_path, truth_yaw=False)
    succeed("import-csv", table, tmp_path / "bag", "--geometry", geometry)
    succeed("replay", tmp_path / "bag", tmp_path / "out", "--params", tmp_path / "bag.yaml")
    said = succeed(
        "evaluate", tmp_path / "out", "--labels", "arc", "--json", tmp_path / "scores.json"
    )
    row = table_rows(said)["arc"]
    assert (row[3], row[5]) == ("n/a", "n/a")
    assert float(row[4]) < 1e-3
    scores = json.loads((tmp_path / "scores.json").read_text())["arc"]
    assert scores["rmse_theta"] is None
    assert scores["mean_nees"] is None
    assert scores["rmse_position"] < 1e-4


def test_recordings_from_before_zero_are_shifted(tmp_path: Path, succeed: Succeed) -> None:
    table, geometry = write_arc(tmp_path)
    lines = table.read_text().splitlines()
    moved = [lines[0]]
    for line in lines[1:]:
        time, _, rest = line.partition(",")
        moved.append(f"{float(time) - 120.0!r},{rest}")
    table.write_text("\n".join(moved))
    succeed("import-csv", table, tmp_path / "bag", "--geometry", geometry)
    with BagReader(tmp_path / "bag") as bag:
        assert bag.start_ns == 3 * 10**9
        assert bag.duration_s == pytest.approx(40.0)


@pytest.mark.slow
def test_ticks_beyond_32_bits_wrap(tmp_path: Path, succeed: Succeed) -> None:
    table, geometry = write_arc(tmp_path)
    lines = table.read_text().splitlines()
    far = [lines[0]]
    for line in lines[1:]:
        cells = line.split(",")
        cells[1] = repr(int(cells[1]) + 2**31 - 400_000)
        cells[2] = repr(int(cells[2]) + 5 * 2**32)
        far.append(",".join(cells))
    wide = tmp_path / "wide.csv"
    wide.write_text("\n".join(far) + "\n")
    for source, name in ((table, "plain"), (wide, "far")):
        succeed("import-csv", source, tmp_path / name, "--geometry", geometry)
        words = ["--params", tmp_path / f"{name}.yaml"]
        succeed("replay", tmp_path / name, tmp_path / f"{name}_out", *words)
    plain, wrapped = (records(tmp_path / f"{name}_out", "/odom") for name in ("plain", "far"))
    assert [record.data for record in plain] == [record.data for record in wrapped]


@pytest.mark.slow
def test_fixes_of_their_own_with_covariances(tmp_path: Path, succeed: Succeed) -> None:
    table, geometry = write_arc(tmp_path)
    fixes = tmp_path / "fixes.csv"
    fixes.write_text(
        "t,fix_x,fix_y,fix_theta,sig_x,sig_y,sig_theta,rho_xy\n"
        "101.5,1.0,2.0,0.5,0.1,0.2,0.05,0.5\n"
        "102.5,,2.0,0.5,0.1,0.2,0.05,0.5\n"
        "103.5,1.0,2.0,0.5,nan,0.2,0.05,0.5\n"
    )
    succeed("import-csv", table, tmp_path / "bag", "--geometry", geometry, "--fixes", fixes)
    with BagReader(tmp_path / "bag") as bag:
        first, second = [bag.message(record) for record in bag.records({"/lrf_pose"})]
    assert messages.stamp_ns(first) == 101_500_000_000
    np.testing.assert_allclose(messages.planar_pose(first), [1.0, 2.0, 0.5])
    np.testing.assert_allclose(
        messages.planar_block(first.pose.covariance),
        [[0.01, 0.01, 0.0], [0.01, 0.04, 0.0], [0.0, 0.0, 0.0025]],
    )
    np.testing.assert_array_equal(messages.planar_block(second.pose.covariance), 0.0)
    values = read_parameter_file(tmp_path / "bag.yaml", "localizer")
    assert values["lrf_use_yaw"] is True


CSV = "t,left_ticks,right_ticks\n1,0,0\n2,1,1\n"


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("", "has no data"),
        ("t,left_ticks,right_ticks\n", "has no data"),
        ("t,left_ticks\n1,0\n2,1\n", "has no column 'right_ticks': it has t, left_ticks"),
        ("time,left_ticks,right_ticks\n1,0,0\n", "has no column 't'"),
        ("t,left_ticks,right_ticks\n1,0,0\n2,one,1\n", "line 3: left_ticks is 'one', expected a"),
        ("t,left_ticks,right_ticks\n1,0,0\n2,1\n", "line 3: 2 fields, expected 3"),
        ("t,left_ticks,right_ticks\n1,0,0\n,1,1\n", "line 3: t is "),
        ("t,left_ticks,right_ticks\n1,0,0\ninf,1,1\n", "line 3: t is 'inf'"),
        ("t,left_ticks,right_ticks,gt_x\n1,0,0,0\n", "has no column 'gt_y'"),
        ("t,left_ticks,right_ticks,fix_y\n1,0,0,0\n", "has no column 'fix_x'"),
    ],
)
def test_import_refuses_tables(tmp_path: Path, refuse: Refuse, text: str, expected: str) -> None:
    (tmp_path / "table.csv").write_text(text)
    (tmp_path / "geometry.json").write_text(json.dumps(ARC_GEOMETRY))
    words = [tmp_path / "table.csv", tmp_path / "out", "--geometry", tmp_path / "geometry.json"]
    assert expected in refuse("import-csv", *words)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (None, "--geometry is needed"),
        ("", "is not JSON"),
        ("{", "is not JSON"),
        ("[1]", "expected an object"),
        ('{"metres_per_tick": 0.1}', "'wheel_base_m' is missing: expected a number"),
        ('{"wheel_base_m": "0.5", "metres_per_tick": 0.1}', "'wheel_base_m' is '0.5'"),
        ('{"wheel_base_m": true, "metres_per_tick": 0.1}', "'wheel_base_m' is True"),
        ('{"wheel_base_m": 0.5, "metres_per_tick": 0}', "'metres_per_tick' is 0:"),
        ('{"wheel_base_m": 0.5, "metres_per_tick": NaN}', "'metres_per_tick' is nan"),
        ('{"wheel_base_m": 5000, "metres_per_tick": 1e-3}', "'wheel_base_m' is 5000: expected"),
    ],
)
def test_import_refuses_geometries(
    tmp_path: Path, refuse: Refuse, text: str | None, expected: str
) -> None:
    (tmp_path / "table.csv").write_text(CSV)
    words: list[object] = [tmp_path / "table.csv", tmp_path / "out"]
    if text is not None:
        (tmp_path / "geometry.json").write_text(text)
        words += ["--geometry", tmp_path / "geometry.json"]
    assert expected in refuse("import-csv", *words)


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["--truth-columns", "gt_x"], "--truth-columns gt_x: expected two or three columns"),
        (["--truth-columns", "a", "b"], "has no column 'a'"),
        (["--fix-columns", "t", "b"], "has no column 'b'"),
        (["--compass-column", "yaw"], "has no column 'yaw'"),
        (["--fixes", "nowhere.csv"], "'nowhere.csv' does not exist"),
        (["--geometry", "nowhere.json"], "'nowhere.json' does not exist"),
    ],
)
def test_import_refuses_options(
    tmp_path: Path, refuse: Refuse, words: list[str], expected: str
) -> None:
    (tmp_path / "table.csv").write_text(CSV)
    (tmp_path / "geometry.json").write_text(json.dumps(ARC_GEOMETRY))
    line = refuse(
        "import-csv", tmp_path / "table.csv", tmp_path / "out", "--geometry",
        tmp_path / "geometry.json", *words,
    )  # fmt: skip
    assert expected in line


def test_import_overwrites_nothing(tmp_path: Path, refuse: Refuse) -> None:
    table, geometry = write_arc(tmp_path)
    (tmp_path / "bag").mkdir()
    (tmp_path / "other.yaml").write_text("mine")
    for name in ("bag", "other"):
        line = refuse("import-csv", table, tmp_path / name, "--geometry", geometry)
        assert "exists already" in line
    assert "does not exist" in refuse("import-csv", tmp_path / "no.csv", tmp_path / "new")


def test_import_refuses_times_that_are_no_seconds(tmp_path: Path, refuse: Refuse) -> None:
    (tmp_path / "table.csv").write_text("t,left_ticks,right_ticks\n1.5e18,0,0\n1.6e18,1,1\n")
    (tmp_path / "geometry.json").write_text(json.dumps(ARC_GEOMETRY))
    refuse(
        "import-csv", tmp_path / "table.csv", tmp_path / "out", "--geometry",
        tmp_path / "geometry.json",
    )  # fmt: skip


def test_a_blank_line_at_the_end_does_no_harm(tmp_path: Path, succeed: Succeed) -> None:
    (tmp_path / "table.csv").write_text(CSV + "\n")
    (tmp_path / "geometry.json").write_text(json.dumps(ARC_GEOMETRY))
    succeed(
        "import-csv", tmp_path / "table.csv", tmp_path / "out", "--geometry",
        tmp_path / "geometry.json",
    )  # fmt: skip
