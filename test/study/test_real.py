# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""`study real`: every start is what the localizer itself would do; tables, refusals, real bags."""

import dataclasses
import json
import math
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import Refuse, Succeed
from localizers import SECOND_NS, Arrival, feed, make_parameters, simulated
from places import RECORDINGS, needs_recordings

from fnn_ekf_ros.commands import study_real
from fnn_ekf_ros.core.arrays import Row
from fnn_ekf_ros.errors import FnnEkfError
from fnn_ekf_ros.localizer.localizer import Localizer
from fnn_ekf_ros.membership.files import networks_for
from fnn_ekf_ros.parameters.files import read_parameter_file
from fnn_ekf_ros.parameters.localizer import LocalizerParameters
from fnn_ekf_ros.parameters.schema import build
from fnn_ekf_ros.study.filters import localizer_models
from fnn_ekf_ros.study.real import (
    Run,
    batch_start,
    collect,
    diverged,
    recording_localizer,
    run_starts,
    score_starts,
)
from fnn_ekf_ros.study.starts import ALL_CELLS, Cell, with_noise_factors
from fnn_ekf_ros.timeline.events import PoseFix, PoseReset

CELLS = (Cell(1.0, 1.0), Cell(1.0 / 25.0, 25.0), Cell(4.0, 1.0 / 25.0))
NO_GATE = {"compass_gate": 0.0, "lrf_pose_gate": 0.0}
FILTERS: dict[str, dict[str, Any]] = {
    "ekf": {"adaptation": "none"} | NO_GATE,
    "ekf_gated": {"adaptation": "none"},
    "joint": {"adaptation": "joint"},
    "rq_published": {"adaptation": "rq", "membership_file": "published"} | NO_GATE,
    "r_published": {"adaptation": "r", "membership_file": "published"} | NO_GATE,
    "q_trained": {"adaptation": "q", "membership_file": "trained"} | NO_GATE,
}
BEGIN_NS = 3 * SECOND_NS


@pytest.fixture(scope="module")
def arrivals() -> list[Any]:
    """20 s of a simulated robot whose fixes were taken up to 0.2 s before they are sent."""
    rng = np.random.default_rng(3)
    moved = []
    for each in simulated(11, 20.0).arrivals:
        event = each.event
        if isinstance(event, PoseFix):
            event = event._replace(stamp_ns=event.stamp_ns - int(rng.integers(1, 2 * 10**8)))
        moved.append(each._replace(event=event))
    return moved


def run_of(parameters: LocalizerParameters, name: str, arrivals: Any) -> Any:
    """Return stamps and run of a filter from `CELLS`, as the study does it."""
    localizer, recorder = recording_localizer(parameters)
    feed(localizer, arrivals)
    assert recorder.broken_ns is None
    batch = batch_start(parameters, recorder.periods, CELLS)
    run = collect(run_starts(localizer_models(parameters)[name].model, batch))
    assert len(run.mean) == 1 + len(batch.inputs) == 1 + len(batch.stamps_ns)
    assert any(len(inputs.epochs) > 2 for inputs in batch.inputs)  # readings at their own times
    return [batch.stamp_ns, *batch.stamps_ns], run


def outputs_of(parameters: LocalizerParameters, name: str, cell: Cell, arrivals: Any) -> list[Any]:
    """Return the estimates of the localizer itself."""
    told = dataclasses.replace(with_noise_factors(parameters, cell), **FILTERS[name])
    localizer = Localizer(told, networks_for(told))
    return [o.estimate for o in feed(localizer, arrivals) if o.estimate is not None]


def assert_row(run: Run, index: int, stamps: Sequence[int], estimates: Sequence[Any]) -> None:
    """Assert that a start of the batch says what the localizer said."""
    by_stamp = {stamp: step for step, stamp in enumerate(stamps)}
    assert len(estimates) > 10
    assert estimates[-1].stamp_ns == stamps[-1]
    for each in estimates:
        step = by_stamp[each.stamp_ns]
        np.testing.assert_allclose(run.mean[step, index], each.state.mean, atol=1e-9)
        np.testing.assert_allclose(
            run.covariance[step, index], each.state.covariance, rtol=1e-9, atol=1e-12
        )
    last = estimates[-1].state
    np.testing.assert_allclose(run.process_noise[index], last.process_noise, rtol=1e-8)
    np.testing.assert_allclose(run.measurement_noise[index], last.measurement_noise, rtol=1e-8)


@pytest.mark.parametrize("name", FILTERS)
@pytest.mark.slow
def test_every_start_is_what_the_localizer_does_with_that_noise(name: str, arrivals: Any) -> None:
    parameters = make_parameters(lrf_use_yaw=True)
    stamps, run = run_of(parameters, name, arrivals)
    for index, cell in enumerate(CELLS):
        estimates = outputs_of(parameters, name, cell, arrivals)
        assert estimates[0].stamp_ns == stamps[0]
        assert_row(run, index, stamps, estimates)
    assert np.all(np.ptp(run.mean, axis=1)[-1] > 0.0)


@pytest.mark.parametrize("name", ["joint", "r_published"])
@pytest.mark.slow
def test_covariances_that_the_fixes_bring_count_k_times(name: str, arrivals: Any) -> None:
    parameters = make_parameters(lrf_use_message_covariance=True)
    rng = np.random.default_rng(4)

    def claim(factor: float, each: Any, scale: float) -> Any:
        if not isinstance(each.event, PoseFix):
            return each
        covariance = factor * scale * np.diag([0.02, 0.01, 0.03])
        return each._replace(event=each.event._replace(covariance=covariance))

    scales = rng.uniform(0.5, 2.0, len(arrivals))
    claimed = {
        k: [claim(k, each, scale) for each, scale in zip(arrivals, scales, strict=True)]
        for k in {1.0} | {cell.k for cell in CELLS}
    }
    stamps, run = run_of(parameters, name, claimed[1.0])
    for index, cell in enumerate(CELLS):
        estimates = outputs_of(parameters, name, cell, claimed[cell.k])
        assert_row(run, index, stamps, estimates)


@pytest.mark.slow
def test_poses_that_were_set_from_outside(arrivals: Any) -> None:
    parameters = make_parameters(initial_pose=[0.1, -0.2, 0.3], initial_pose_std=[0.3, 0.3, 0.1])
    reset = PoseReset(BEGIN_NS + 10 * SECOND_NS + 7, np.array([5.0, 4.0, 1.0]), 0.04 * np.eye(3))
    both = sorted([*arrivals, Arrival(reset.stamp_ns, reset)], key=lambda each: each.now_ns)
    stamps, run = run_of(parameters, "joint", both)
    np.testing.assert_array_equal(run.mean[0], np.tile([0.1, -0.2, 0.3], (len(CELLS), 1)))
    for index, cell in enumerate(CELLS):
        estimates = outputs_of(parameters, "joint", cell, both)
        assert estimates[0].stamp_ns == stamps[1]
        assert_row(run, index, stamps, estimates)


def test_late_inputs_count_in_their_place(arrivals: Any) -> None:
    """The localizer says so from the next period on; the study from the period they belong to."""
    parameters = make_parameters()
    late = next(
        each for each in arrivals
        if isinstance(each.event, PoseFix) and each.now_ns > BEGIN_NS + 12 * SECOND_NS
    )  # fmt: skip
    arrived = late.now_ns + round(1.2 * SECOND_NS)
    moved = sorted(
        [each._replace(now_ns=arrived) if each is late else each for each in arrivals],
        key=lambda each: each.now_ns,
    )
    stamps, run = run_of(parameters, "joint", moved)
    _, in_time = run_of(parameters, "joint", arrivals)
    np.testing.assert_array_equal(run.mean, in_time.mean)
    estimates = outputs_of(parameters, "joint", CELLS[1], moved)
    between = [e for e in estimates if late.event.stamp_ns + 4 * 10**8 < e.stamp_ns < arrived]
    assert between
    for each in between:
        assert np.any(each.state.mean != run.mean[stamps.index(each.stamp_ns), 1])
    assert_row(
        run, 1, stamps, [e for e in estimates if not late.event.stamp_ns <= e.stamp_ns <= arrived]
    )


@pytest.mark.parametrize("jump_s", [-100.0, 3600.0])
def test_a_recording_that_is_not_in_one_piece_is_noticed(arrivals: Any, jump_s: float) -> None:
    localizer, recorder = recording_localizer(make_parameters())
    by_ns = round(jump_s * SECOND_NS)
    again = [
        each._replace(
            now_ns=each.now_ns + by_ns,
            event=each.event._replace(stamp_ns=each.event.stamp_ns + by_ns),
        )
        for each in arrivals
    ]
    feed(localizer, arrivals)
    assert recorder.broken_ns is None
    feed(localizer, again)
    assert recorder.broken_ns is not None


def test_scores() -> None:
    truth = np.array([[0.0, 0.0, 3.1], [math.nan] * 3, [1.0, 0.0, math.nan], [2.0, 0.0, -3.1]])
    mean = np.zeros((4, 2, 3))
    mean[:, 0] = [[3.0, 4.0, -3.1], [99.0, 99.0, 0.0], [1.0, 0.0, 7.0], [2.0, 0.0, 3.1]]
    mean[:, 1, 0] = math.nan
    run = Run(mean, np.tile(np.eye(3), (4, 2, 1, 1)), np.ones((2, 2)), np.ones((2, 4)))
    found = score_starts(run, truth)
    turn = 2.0 * math.pi - 6.2
    np.testing.assert_allclose(found.rmse[0], [math.sqrt(3.0), math.sqrt(16.0 / 3.0), turn])
    np.testing.assert_allclose(found.position, [math.sqrt(25.0 / 3.0), math.inf])
    np.testing.assert_allclose(found.furthest, [5.0, math.inf])
    # With a yaw at the first and the last estimate only: 25 + turn^2 and turn^2.
    np.testing.assert_allclose(found.median_nees, [12.5 + turn**2, math.inf])
    np.testing.assert_allclose(found.mean_nees, [12.5 + turn**2, math.inf])
    assert found.nees_size == 3
    assert diverged(found, 0.6).tolist() == [0.0, 1.0]
    assert diverged(found, 0.4).tolist() == [1.0, 1.0]
    truth[:, 2] = math.nan
    without_yaw = score_starts(run, truth)
    assert np.all(np.isnan(without_yaw.rmse[:, 2]))
    np.testing.assert_allclose(without_yaw.median_nees, [0.0, math.inf])
    np.testing.assert_allclose(without_yaw.mean_nees, [25.0 / 3.0, math.inf])
    assert without_yaw.nees_size == 2


@pytest.mark.slow
def test_the_command(tmp_path: Path, succeed: Succeed, recorded: Path) -> None:
    out = tmp_path / "new" / "out"
    said = succeed("study", "real", recorded, "--out", out, "--filters", "joint, r_published")
    assert said == (
        f"{out}: recorded from 25 starts, ekf, ekf_gated, joint, r_published\n"
        f"{out / 'results.md'}: the tables\n"
    )
    assert {path.name for path in out.iterdir()} == {
        "results.json", "results.md", "real_recorded.png", "localizer_recorded.yaml",
    }  # fmt: skip
    assert (out / "real_recorded.png").read_bytes()[:4] == b"\x89PNG"
    told = read_parameter_file(out / "localizer_recorded.yaml", "localizer")
    written = read_parameter_file(recorded.with_name("recorded.yaml"), "localizer")
    used, beside = build(LocalizerParameters, told), build(LocalizerParameters, written)
    assert repr(used) == repr(beside)  # NaN is not equal to itself

    found = json.loads((out / "results.json").read_text())
    assert found["filters"] == ["joint", "r_published"]
    (bag,) = found["bags"]
    assert (bag["label"], bag["parameter_files"]) == ("recorded", ["recorded.yaml"])
    assert bag["rows"] == ["x", "y", "compass_yaw"]
    assert bag["process_noise_std"] == list(beside.process_noise_std)
    rows = {(row["filter"], row["q"], row["k"]): row for row in bag["results"]}
    assert len(rows) == len(bag["results"]) == 4 * len(ALL_CELLS)
    fixed = [rows["ekf_gated", *cell] for cell in ALL_CELLS]
    reference = bag["reference"]
    best = rows[reference["filter"], reference["q"], reference["k"]]
    assert min(row["rmse_position"] for row in fixed) == reference["rmse_position"]
    assert (best["ratio"], best["rmse_theta"]) == (1.0, reference["rmse_theta"])
    assert min(row["ratio"] for row in fixed) == 1.0
    assert [row["filter"] for row in bag["summary"]] == [row["filter"] for row in found["summary"]]
    assert bag["summary"][1]["worst_ratio"] == max(row["ratio"] for row in fixed)
    assert found["summary"][2]["median_ratio"] == pytest.approx(bag["summary"][2]["median_ratio"])
    assert bag["taught_by"] == ""
    assert all(row["rmse_position_with_noise_found"] == row["rmse_position"] for row in fixed)
    wrong = rows["ekf", 25.0, 0.04]
    np.testing.assert_allclose(
        wrong["end_process_noise_std"], 5.0 * np.array(beside.process_noise_std)
    )
    assert wrong["end_measurement_noise_std"][Row.X] == pytest.approx(0.02)

    table = (out / "results.md").read_text()
    assert "`study real recorded --filters joint,r_published`" in table
    assert table.count("| FNN-EKF joint | ") == 2
    assert table.count("| q = 1/25 | ") == 4


@pytest.mark.slow
def test_the_same_numbers_as_replay_and_evaluate(
    tmp_path: Path, succeed: Succeed, recorded: Path
) -> None:
    words = [
        "-p",
        "process_noise_std:=[0.02, 0.03]",
        "-p",
        "measurement_noise_std:=[0.2, 0.2, 0.1]",
    ]
    succeed("study", "real", recorded, "--out", tmp_path / "study", *words)
    (bag,) = json.loads((tmp_path / "study" / "results.json").read_text())["bags"]
    beside = recorded.with_name("recorded.yaml")
    for name, adaptation in (("ekf", "none"), ("joint", "joint")):
        out = tmp_path / name
        succeed(
            "replay", recorded, out, "--params", beside, *words, "-p", f"adaptation:={adaptation}"
        )
        succeed("evaluate", out, "--labels", name, "--json", tmp_path / f"{name}.json")
        expected = json.loads((tmp_path / f"{name}.json").read_text())[name]
        row = next(
            row for row in bag["results"] if (row["filter"], row["q"], row["k"]) == (name, 1, 1)
        )
        assert expected["count"] == bag["scored"]
        for key in ("rmse_x", "rmse_y", "rmse_theta", "rmse_position"):
            assert row[key] == pytest.approx(expected[key], abs=1e-9)


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["--truth-topic", "/truth"], "topic /truth is missing, expected nav_msgs/msg/Odometry"),
        (["--truth-topic", "/left_ticks"], "topic /left_ticks is of type std_msgs/msg/Int32"),
        (["--filters", "ukf"], "--filters ukf: expected some of ekf_gated, joint, rq_published, "),
        (["--filters", "oracle"], "--filters oracle: expected some of ekf_gated, "),
        (["--filters", "bank"], ", joint_without_outages, joint_without_yaw_errors"),
        (["-p", "adaptation:=r"], "parameter 'adaptation': it follows from the names of"),
        (
            ["-p", "process_noise_std:=[3.0, 0.1]"],
            "Q x 25, R / 25: parameter 'process_noise_std' is [15.0, 0.5]",
        ),
        (["-p", "encoder_source:=joint_states", "-r", "joint_states:=/no"], "has no topic /no"),
        (["-p", "frame_id:=odom"], "gives no odom: expected encoders, fixes and a yaw"),
        (["--state-file", "missing.yaml"], "--state-file 'missing.yaml' does not exist"),
        (["--json", "nowhere/numbers.json"], "there is no folder 'nowhere'"),
    ],
)
def test_what_is_refused(
    tmp_path: Path, refuse: Refuse, recorded: Path, words: list[str], expected: str
) -> None:
    assert expected in refuse("study", "real", recorded, "--out", tmp_path / "out", *words)


def test_recordings_are_not_replaced(tmp_path: Path, refuse: Refuse, recorded: Path) -> None:
    victim = tmp_path / "victim"
    shutil.copytree(recorded, victim)
    words = ["study", "real", victim, "--params", recorded.with_name("recorded.yaml"), "--out"]
    assert "is a bag's folder" in refuse(*words, victim)
    assert "is a bag's folder" in refuse(*words, victim / "out")
    line = refuse(*words, tmp_path / "out", "--json", victim / "metadata.yaml")
    assert "lies inside a bag" in line


def test_bags_that_are_refused(tmp_path: Path, refuse: Refuse, recorded: Path) -> None:
    out = ("--out", tmp_path / "out")
    assert "expected bags of different names" in refuse("study", "real", recorded, recorded, *out)
    assert "missing' does not exist" in refuse("study", "real", tmp_path / "missing", *out)
    geometry = ("--params", recorded.with_name("recorded.yaml"))
    said = refuse("study", "real", tmp_path / "missing", *out, *geometry)
    assert f"bag '{tmp_path / 'missing'}' does not exist" in said
    assert "bag '/' has no metadata.yaml: expected the folder" in refuse("study", "real", "/", *out)
    topic = ("-r", "right_ticks:=left_ticks")
    said = refuse("study", "real", recorded, *out, *topic)
    assert "-r: /left_ticks would be both left_ticks and right_ticks" in said


def test_the_folder_of_a_bag_from_inside(
    tmp_path: Path, refuse: Refuse, recorded: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(recorded)
    found = []
    monkeypatch.setattr(study_real, "read_recording", lambda *given: found.append(given) or fail())

    def fail() -> None:
        raise FnnEkfError("as far as this")

    for name in (".", "../recorded/../recorded"):
        assert "as far as this" in refuse("study", "real", name, "--out", tmp_path / "out")
    for _, label, parameters, files, *_ in found:
        assert (label, files) == ("recorded", ["recorded.yaml"])
        assert parameters.wheel_radius > 0.0


@needs_recordings
@pytest.mark.slow
def test_joint_is_near_the_best_fixed_filter_from_every_start_on_brenner(
    tmp_path: Path, succeed: Succeed
) -> None:
    name = "brenner_robot4"
    succeed(
        "import-csv",
        RECORDINGS / f"{name}.csv",
        tmp_path / name,
        "--fixes",
        RECORDINGS / f"{name}_fixes.csv",
        "--geometry",
        RECORDINGS / f"{name}.json",
        "--truth-columns",
        "gt_x_aligned",
        "gt_y_aligned",
    )
    succeed("study", "real", tmp_path / name, "--out", tmp_path / "out")
    (bag,) = json.loads((tmp_path / "out" / "results.json").read_text())["bags"]
    # Fixes at 4 Hz: 0.0271 when only the last one of a period counted.
    assert bag["reference"]["rmse_position"] == pytest.approx(0.0281, abs=0.0005)
    assert bag["rows"] == ["x", "y", "lrf_yaw"]
    ratios = {
        name: [row["ratio"] for row in bag["results"] if row["filter"] == name]
        for name in ("ekf", "joint")
    }
    assert max(ratios["ekf"]) > 5.0
    assert max(ratios["joint"]) < 2.0
    assert all(row["nees_size"] == 2 for row in bag["summary"])
    assert (tmp_path / "out" / "results.md").read_text().count("| n/a | n/a | ") == 3
