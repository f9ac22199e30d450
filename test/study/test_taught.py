# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""`study real --state-file`: what another recording taught, and who starts with it."""

import dataclasses
import json
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
from commands import Succeed
from localizers import feed, make_parameters, simulated

from fnn_ekf_ros.core import lasting_step
from fnn_ekf_ros.core.lasting.members import FIXES_LAST, HORIZONS_S, LASTING_SHARE
from fnn_ekf_ros.core.lasting.outages import start_outages
from fnn_ekf_ros.errors import FnnEkfError
from fnn_ekf_ros.localizer.localizer import Localizer
from fnn_ekf_ros.localizer.saved_state import SavedState
from fnn_ekf_ros.localizer.state_file import render_state
from fnn_ekf_ros.membership.files import networks_for
from fnn_ekf_ros.parameters.files import read_parameter_file
from fnn_ekf_ros.parameters.localizer import LocalizerParameters
from fnn_ekf_ros.parameters.schema import build
from fnn_ekf_ros.study.filters import localizer_models
from fnn_ekf_ros.study.real import batch_start, recording_localizer, run_starts
from fnn_ekf_ros.study.starts import ALL_CELLS, CORNERS, with_noise_factors
from fnn_ekf_ros.study.taught import Teacher, check_same_robot, taught_by, teacher_from_file

PARAMETERS = make_parameters()
_WEIGHTS = 0.001 + FIXES_LAST
SAVED = SavedState(
    stamp_ns=0,
    pose=np.array([0.3, -0.2, 0.1]),
    covariance=np.diag([0.05, 0.04, 0.02]),
    process_noise=np.array([9e-4, 4e-4]),
    measurement_noise=np.array([0.04, 0.05, 0.01, 0.02]),
    log_weight=np.tile(np.log(_WEIGHTS / _WEIGHTS.sum()), (len(HORIZONS_S), 1)),
)
"""Of a robot whose fix errors last."""


def joint_localizer(
    parameters: LocalizerParameters, warm_start: SavedState | None = None
) -> Localizer:
    told = dataclasses.replace(parameters, adaptation="joint")
    return Localizer(told, networks_for(told), warm_start=warm_start)


def written(path: Path, state: SavedState, parameters: LocalizerParameters) -> Path:
    """Write the state file of a localizer."""
    path.write_text(render_state(state, parameters, datetime(2026, 11, 28, tzinfo=UTC)))
    return path


def test_a_recording_teaches_a_start_what_a_localizer_would_save(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Noise, and weights of lasting errors that are no longer the prior's."""
    monkeypatch.setattr(lasting_step, "MEMORY_NEEDED", 10.0)  # so that they change within 20 s
    arrivals, cells = simulated(11, 20.0).arrivals, CORNERS[1:3]
    localizer, recorder = recording_localizer(PARAMETERS)
    feed(localizer, arrivals)
    batch = batch_start(PARAMETERS, recorder.periods, cells)
    taught = taught_by(Teacher("it", PARAMETERS, batch), "joint")
    prior = start_outages(()).log_weight
    for index, cell in enumerate(cells):
        localizer = joint_localizer(with_noise_factors(PARAMETERS, cell))
        feed(localizer, arrivals)
        saved = localizer.saved()
        assert saved is not None
        assert saved.log_weight is not None
        for of_start, expected in zip(taught, saved[-3:], strict=True):
            assert of_start is not None
            np.testing.assert_allclose(of_start[..., index], expected, rtol=1e-8)
        assert np.any(np.abs(saved.log_weight - prior) > 0.01)


@pytest.mark.parametrize("weights", [True, False])
def test_a_taught_start_is_a_warm_start_without_its_pose(weights: bool, tmp_path: Path) -> None:
    """The pose is given to the study, which adds nothing of the file's to its uncertainty."""
    saved = SAVED if weights else SAVED._replace(log_weight=None)
    std = np.array([0.4, 0.3, 0.2])
    told = dataclasses.replace(PARAMETERS, initial_pose_std=tuple(std.tolist()))
    arrivals = simulated(11, 10.0).arrivals
    outputs = feed(joint_localizer(told, saved), arrivals)
    estimates = {o.stamp_ns: o.estimate.state for o in outputs if o.estimate is not None}
    whole = np.sqrt(std**2 + np.diag(saved.covariance))
    placed = dataclasses.replace(
        PARAMETERS, initial_pose=tuple(saved.pose.tolist()), initial_pose_std=tuple(whole.tolist())
    )
    localizer, recorder = recording_localizer(placed)
    feed(localizer, arrivals)
    teacher = teacher_from_file(written(tmp_path / "state", saved, placed), placed)
    learned = taught_by(teacher, "joint")
    batch = batch_start(placed, recorder.periods, ALL_CELLS, learned)
    first, *states = run_starts(localizer_models(placed)["joint"].model, batch)
    assert first.lasting is not None
    assert np.all((first.lasting.fixes_last > LASTING_SHARE) == weights)
    assert set(estimates) == set(batch.stamps_ns)
    for state, stamp_ns in zip(states, batch.stamps_ns, strict=True):
        expected = estimates[stamp_ns]
        for index in (0, 24):  # the cell does not matter
            np.testing.assert_allclose(state.mean[:, index], expected.mean, atol=1e-9)
            np.testing.assert_allclose(state.covariance[..., index], expected.covariance, rtol=1e-8)


def test_a_teacher_is_of_the_same_robot() -> None:
    teacher = Teacher("it", make_parameters(wheel_separation=0.3), SAVED)
    check_same_robot(teacher, "a", make_parameters(wheel_separation=0.3, lrf_pose_gate=0.0))
    with pytest.raises(
        FnnEkfError, match=r"'it' has wheel_separation 0\.3: expected 0\.6, as of 'a'"
    ):
        check_same_robot(teacher, "a", make_parameters(wheel_separation=0.6))


@pytest.mark.slow
def test_the_command_with_a_teacher(tmp_path: Path, succeed: Succeed, recorded: Path) -> None:
    parameters = build(
        LocalizerParameters, read_parameter_file(recorded.with_name("recorded.yaml"), "localizer")
    )
    file = written(tmp_path / "state.yaml", SAVED, parameters)
    found = {}
    for teacher in (None, file, recorded):
        words = () if teacher is None else ("--state-file", teacher)
        out = tmp_path / f"out_{len(found)}"
        succeed("study", "real", recorded, "--out", out, *words)
        (bag,) = json.loads((out / "results.json").read_text())["bags"]
        assert bag["taught_by"] == ("" if teacher is None else teacher.name)
        said = f"what {bag['taught_by']} taught them" in (out / "results.md").read_text()
        assert said == (teacher is not None)
        found[bag["taught_by"]] = {
            name: [row["rmse_position"] for row in bag["results"] if row["filter"] == name]
            for name in ("ekf", "ekf_gated", "joint")
        }
    alone, of_file, of_bag = found.values()
    for taught in (of_file, of_bag):
        assert {**taught, "joint": 0} == {**alone, "joint": 0}  # the reference learns nothing
    assert len(set(of_file["joint"])) == 1
    assert max(of_bag["joint"]) < max(alone["joint"])
