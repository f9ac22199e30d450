# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""`study real`: what its summaries say, and what each filter is compared with."""

import json
import math

import numpy as np
import pytest

from fnn_ekf_ros.core.arrays import FloatArray, Row
from fnn_ekf_ros.study.real import RealScore
from fnn_ekf_ros.study.real_bags import BagResult, FilterResult, Reference
from fnn_ekf_ros.study.report.real_tables import (
    across_numbers,
    across_rows,
    real_tables,
    rows,
    summary_rows,
)


def result_of(label: str, positions: dict[str, FloatArray], yaw: float, size: int) -> BagResult:
    """Return a result whose yaw errors and NEES grow with the start's number."""
    number = np.arange(25.0)
    filters = []
    for name, position in positions.items():
        rmse = np.stack([position, position, yaw * (1.0 + number)], axis=-1)
        score = RealScore(rmse, position, position, 1.0 + number, 2.0 + number, size)
        noise = np.ones((25, 2)), np.ones((25, 4))
        filters.append(FilterResult(name, name.upper(), score, np.zeros(25), *noise, position))
    best = int(np.argmin(positions["ekf_gated"]))
    reference = Reference(best, positions["ekf_gated"][best], yaw * (1.0 + best))
    return BagResult(
        label, ("p.yaml",), (0.1, 0.1), (1.0,) * 4, (Row.X, Row.Y), 9.0, 10, 9, "", reference,
        tuple(filters),
    )  # fmt: skip


def test_each_filter_is_compared_with_the_best_gated_ekf() -> None:
    gated = 2.0 + np.roll(np.arange(25.0), 3)  # the best start is number 3
    one = result_of("one", {"ekf_gated": gated, "joint": np.full(25, 3.0)}, 0.01, 3)
    two = result_of("two", {"ekf_gated": gated, "joint": np.arange(1.0, 26.0)}, math.nan, 2)
    row = summary_rows(one)[1]
    assert (row.best_ratio, row.median_ratio, row.worst_ratio) == (1.5, 1.5, 1.5)
    assert row.yaw_ratio == pytest.approx(0.13 / 0.04)  # of start 12 and of start 3
    assert (row.median_nees, row.mean_nees, row.nees_size) == (13.0, 14.0, 3)
    row = summary_rows(two)[1]
    assert (row.best_position, row.median_position, row.worst_position) == (1.0, 13.0, 25.0)
    assert (row.median_ratio, row.worst_ratio) == (6.5, 12.5)

    fixed, joint = across_rows([one, two])
    assert fixed.median_ratio == pytest.approx(7.0)  # 14 over 2 on both
    assert joint.median_ratio == pytest.approx(math.sqrt(1.5 * 6.5))
    assert joint.worst_ratio == pytest.approx(math.sqrt(1.5 * 12.5))
    assert (joint.recordings, joint.recordings_with_yaw) == (2, 1)
    assert joint.yaw_ratio == pytest.approx(0.13 / 0.04)

    made_by = {"study": "real", "version": "1", "filters": ["joint"], "parameters": {}}
    table = real_tables(made_by, [one, two])
    assert f"| JOINT | {math.sqrt(9.75):.2f} | {math.sqrt(18.75):.2f} | 3.25 | 1 |" in table
    assert "| 1.50 | 1.50 | 1.50 | 0.130 | 3.25 | 13 (1 - 25) | 14 | 0% |" in table
    assert "| n/a | n/a | 13 (1 - 25) | 14 | 0% |" in table
    heads = [line for line in table.splitlines() if line.startswith("| filter | ")]
    assert ["NEES of x, y, mean" in head for head in heads] == [False, True]
    assert "All 2 recordings" not in real_tables(made_by, [one])
    json.dumps([rows(one), rows(two), across_numbers([one, two])], allow_nan=False)
