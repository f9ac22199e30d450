# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Rows of the fault matrix through the command's own code: what was promised about them."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from faults import matrix as fault_matrix
from faults import processes as row_processes
from faults import scenarios as fault_runs
from faults.matrix import SAME_M, SETTLED_S, fault_effect, position_error
from faults.rows import ROWS
from faults.scenarios import LASTS_S, ONSET_S, Run

from fnn_ekf_ros.errors import FnnEkfError
from fnn_ekf_ros.timeline.events import Level

pytestmark = pytest.mark.live
RATES = (8.0, 4.0, 2.0)
END_S = ONSET_S + LASTS_S + 15.0
"""Runs end sooner than those of the document: nothing is expected of them later on."""
NEAR_M = 0.4
"""Four standard deviations of a fix."""


@pytest.fixture
def run_row(
    ros_environment: None, processes: Any, monkeypatch: pytest.MonkeyPatch
) -> Callable[[str], Run]:
    """Runs a row by its name."""
    # So that what the command sets is put back.
    for name in ("FASTRTPS_DEFAULT_PROFILES_FILE", "PYTHONPATH"):
        monkeypatch.setenv(name, processes.environment.get(name, ""))
    for module in (fault_matrix, fault_runs, row_processes):
        monkeypatch.setattr(module, "END_S", END_S)

    def run(name: str) -> Run:
        (row,) = [row for row in ROWS if row.name == name]
        for rate in RATES:
            try:
                folder = processes.folder / f"{rate:g}" / f"{len(name)}"
                found = row_processes.run_row(row, folder, rate)
                break
            except FnnEkfError as error:  # the machine was too busy
                print(error)
        else:
            pytest.fail(f"{name} does not run")
        assert found.finite
        assert fault_effect(row, found, found).missing == 0
        return found

    return run


def test_kidnapping_is_accepted_nan_refused_and_a_stuck_wheel_named(
    run_row: Callable[[str], Run],
) -> None:
    kidnapped, with_nan = run_row("kidnap, 20 m"), run_row("fixes: NaN")
    seconds = kidnapped.odom.time_ns * 1e-9
    error = position_error(kidnapped.odom, kidnapped.truth)
    assert np.max(error[(seconds >= SETTLED_S) & (seconds < ONSET_S)]) < NEAR_M
    assert np.max(error[(seconds >= ONSET_S) & (seconds < ONSET_S + 2.0)]) > 15.0
    assert np.max(error[seconds >= ONSET_S + 15.0]) < NEAR_M
    told = [r for r in kidnapped.remarks if r.status == "filter" and "pose moved" in r.message]
    assert told, "no status reports that the pose has jumped by 20 m"
    assert ONSET_S < told[0].time_s < ONSET_S + 15.0

    refused = [
        r for r in with_nan.remarks if r.status == "lrf_pose" and "not a number" in r.message
    ]
    assert refused
    assert all(remark.level is Level.WARN for remark in refused)
    assert refused[0].time_s == pytest.approx(ONSET_S, abs=2.0)
    assert any(r.status == "filter" and "degraded" in r.message for r in with_nan.remarks)
    assert np.max(position_error(with_nan.odom, with_nan.truth)) < 2.0

    same, mine, others = np.intersect1d(
        kidnapped.odom.time_ns, with_nan.odom.time_ns, return_indices=True
    )
    before = same < ONSET_S * 1e9
    apart = kidnapped.odom.pose[mine] - with_nan.odom.pose[others]
    assert np.max(np.abs(apart[before])) < SAME_M, "until the fault the same seed is the same run"

    stuck = run_row("stuck wheel")
    named = [r for r in stuck.remarks if "left wheel stuck" in r.message]
    assert named
    assert named[0].level is Level.ERROR
    assert named[0].time_s < ONSET_S + 15.0
    assert np.max(position_error(stuck.odom, stuck.truth)) < NEAR_M
