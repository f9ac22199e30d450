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

from fnn_ekf_ros.errors import FnnEkfError
from fnn_ekf_ros.localizer.localizer import Localizer
from fnn_ekf_ros.localizer.saved_state import SavedState
from fnn_ekf_ros.localizer.state_file import render_state
from fnn_ekf_ros.membership.files import networks_for
from fnn_ekf_ros.parameters.files import read_parameter_file
from fnn_ekf_ros.parameters.localizer import LocalizerParameters
from fnn_ekf_ros.parameters.schema import build
from fnn_ekf_ros.study.filters import localizer_models
from fnn_ekf_ros.study.real import batch_start, collect, recording_localizer, run_starts
from fnn_ekf_ros.study.starts import ALL_CELLS, CORNERS, with_noise_factors
from fnn_ekf_ros.study.taught import Teacher, check_same_robot, taught_noise
from fnn_ekf_ros.timeline.period import Period

PARAMETERS = make_parameters()
SAVED = SavedState(
    0, np.zeros(3), np.eye(3), np.array([9e-4, 4e-4]), np.array([0.04, 0.05, 0.01, 0.02])
)


@pytest.fixture(scope="module")
def periods() -> list[Period]:
    """Periods of 20 s of a simulated robot."""
    localizer, recorder = recording_localizer(PARAMETERS)
    feed(localizer, simulated(11, 20.0).arrivals)
    return recorder.periods


def joint_localizer(parameters: LocalizerParameters) -> Localizer:
    told = dataclasses.replace(parameters, adaptation="joint")
    return Localizer(told, networks_for(told))


def test_a_recording_teaches_a_start_what_a_localizer_would_save(periods: list[Period]) -> None:
    batch = batch_start(PARAMETERS, periods, ALL_CELLS)
    taught = taught_noise(Teacher("it", PARAMETERS, batch), "joint")
    for cell in CORNERS[1:3]:
        localizer = joint_localizer(with_noise_factors(PARAMETERS, cell))
        feed(localizer, simulated(11, 20.0).arrivals)
        saved = localizer.saved()
        assert saved is not None
        index = ALL_CELLS.index(cell)
        np.testing.assert_allclose(taught.process[index], saved.process_noise, rtol=1e-8)
        np.testing.assert_allclose(taught.measurement[index], saved.measurement_noise, rtol=1e-8)


def test_a_taught_start_is_a_warm_start_without_its_pose(periods: list[Period]) -> None:
    distance, rotation = np.sqrt(SAVED.process_noise).tolist()
    x, y, compass_yaw, lrf_yaw = np.sqrt(SAVED.measurement_noise).tolist()
    told = dataclasses.replace(
        PARAMETERS,
        process_noise_std=(distance, rotation),
        measurement_noise_std=(x, y, compass_yaw),
        lrf_yaw_std=lrf_yaw,
    )
    outputs = feed(joint_localizer(told), simulated(11, 20.0).arrivals)
    estimates = {o.stamp_ns: o.estimate.state for o in outputs if o.estimate is not None}
    noise = taught_noise(Teacher("file", PARAMETERS, SAVED), "joint")
    batch = batch_start(PARAMETERS, periods, ALL_CELLS, noise)
    run = collect(run_starts(localizer_models(PARAMETERS)["joint"].model, batch))
    stamps = [batch.stamp_ns, *batch.stamps_ns]
    assert set(estimates) == set(stamps)
    for mean, covariance, stamp_ns in zip(run.mean, run.covariance, stamps, strict=True):
        expected = estimates[stamp_ns]
        for index in (0, 24):  # the cell does not matter
            np.testing.assert_allclose(mean[index], expected.mean, atol=1e-9)
            np.testing.assert_allclose(covariance[index], expected.covariance, rtol=1e-8)


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
    file = tmp_path / "state.yaml"
    file.write_text(render_state(SAVED, parameters, datetime(2026, 11, 28, tzinfo=UTC)))
    found = {}
    for teacher in (None, file, recorded):
        words = () if teacher is None else ("--state-file", teacher)
        out = tmp_path / f"out_{len(found)}"
        succeed("study", "real", recorded, "--out", out, *words)
        (bag,) = json.loads((out / "results.json").read_text())["bags"]
        assert bag["taught_by"] == ("" if teacher is None else teacher.name)
        said = f"noise that {bag['taught_by']} taught them" in (out / "results.md").read_text()
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
