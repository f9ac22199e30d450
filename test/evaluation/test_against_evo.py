# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""ATE, RPE, alignments and files against evo, which is another implementation of each."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tracks import noisy, wiggling

from fnn_ekf_ros.evaluation.alignment import Alignment, aligned
from fnn_ekf_ros.evaluation.errors import RelativeDelta, Statistics, relative_errors, track_errors
from fnn_ekf_ros.evaluation.export import kitti_text, tum_text
from fnn_ekf_ros.evaluation.matching import Matched, match
from fnn_ekf_ros.timeline.trajectory import Trajectory

pytest.importorskip("evo", reason="evo is not installed: make test does so")

from evo.core import metrics, trajectory
from evo.core.units import Unit
from evo.tools import file_interface


@pytest.fixture(scope="module")
def pair() -> Matched:
    """A noisy track in another frame, beside its truth."""
    truth = wiggling()
    track = noisy(truth)
    c, s = np.cos(0.4), np.sin(0.4)
    moved = track.pose @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    moved += (3.0, -2.0, 0.4)
    found = match(Trajectory(track.time_ns, moved, track.covariance), truth)
    assert found is not None
    return found


def evo_path(pose: Any) -> Any:
    """Return poses as evo's trajectory."""
    half = 0.5 * pose[:, 2]
    zero = np.zeros(len(pose))
    return trajectory.PosePath3D(
        positions_xyz=np.column_stack([pose[:, :2], zero]),
        orientations_quat_wxyz=np.column_stack([np.cos(half), zero, zero, np.sin(half)]),
    )


def assert_same(found: Statistics, evo: dict[str, float]) -> None:
    for name, value in found._asdict().items():
        assert value == pytest.approx(evo[name], rel=1e-9, abs=1e-12), name


@pytest.mark.parametrize("alignment", Alignment)
def test_ate_is_that_of_evo(pair: Matched, alignment: Alignment) -> None:
    truth, estimate = evo_path(pair.truth), evo_path(pair.estimate)
    if alignment is Alignment.SE2:
        estimate.align(truth)
    elif alignment is Alignment.ORIGIN:
        estimate.align_origin(truth)
    found, _ = aligned(pair, alignment)
    for relation, mine in (
        (metrics.PoseRelation.translation_part, track_errors(found).position),
        (metrics.PoseRelation.rotation_angle_rad, track_errors(found).yaw),
    ):
        ape = metrics.APE(relation)
        ape.process_data((truth, estimate))
        assert_same(mine, ape.get_all_statistics())
    assert track_errors(found).position.rmse > 0.05


@pytest.mark.parametrize(
    ("delta", "unit"),
    [
        (RelativeDelta(1.0, "m"), Unit.meters), (RelativeDelta(7.5, "m"), Unit.meters),
        (RelativeDelta(1, "poses"), Unit.frames), (RelativeDelta(10, "poses"), Unit.frames),
    ],
)  # fmt: skip
def test_rpe_is_that_of_evo(pair: Matched, delta: RelativeDelta, unit: Unit) -> None:
    found = relative_errors(pair, delta)
    for relation, mine in (
        (metrics.PoseRelation.translation_part, found.translation),
        (metrics.PoseRelation.rotation_angle_rad, found.rotation),
    ):
        rpe = metrics.RPE(relation, delta.value, unit)
        rpe.process_data((evo_path(pair.truth), evo_path(pair.estimate)))
        assert len(rpe.error) == found.pairs > 5
        assert_same(mine, rpe.get_all_statistics())


def test_evo_reads_the_tum_file(tmp_path: Path) -> None:
    track = noisy(wiggling())
    stamped = Trajectory(track.time_ns + 1_700_000_000_123_456_789, track.pose, track.covariance)
    (tmp_path / "track.tum").write_text(tum_text(stamped))
    read = file_interface.read_tum_trajectory_file(tmp_path / "track.tum")
    np.testing.assert_allclose(read.positions_xyz[:, :2], track.pose[:, :2], atol=1e-9)
    np.testing.assert_allclose(read.timestamps, stamped.time_ns * 1e-9, rtol=0.0, atol=5e-7)
    yaw = read.get_orientations_euler()[:, 2]
    np.testing.assert_allclose(np.cos(yaw - track.pose[:, 2]), 1.0, atol=1e-12)
    assert (tmp_path / "track.tum").read_text().startswith("1700000000.123456789 ")


def test_evo_reads_the_kitti_file(tmp_path: Path) -> None:
    pose = noisy(wiggling()).pose
    (tmp_path / "track.kitti").write_text(kitti_text(pose))
    read = file_interface.read_kitti_poses_file(tmp_path / "track.kitti")
    assert read.num_poses == len(pose)
    np.testing.assert_allclose(read.positions_xyz[:, :2], pose[:, :2], atol=1e-9)
    assert read.check()[0]
    yaw = read.get_orientations_euler()[:, 2]
    np.testing.assert_allclose(np.cos(yaw - pose[:, 2]), 1.0, atol=1e-12)
