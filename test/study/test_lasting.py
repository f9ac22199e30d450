# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""`study lasting`: its errors, the EKF that knows them, the tables and the command."""

import json
import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from commands import Refuse, Succeed
from drives import TRUE_Q, TRUE_R

from fnn_ekf_ros.core.angles import wrap_angle
from fnn_ekf_ros.core.arrays import FloatArray, Row
from fnn_ekf_ros.core.motion import MotionModel, move
from fnn_ekf_ros.evaluation.intervals import chi_square_band
from fnn_ekf_ros.study import lasting, lasting_runs
from fnn_ekf_ros.study.filters import EKF_GATED, JOINT, ORACLE, study_filters
from fnn_ekf_ros.study.lasting import (
    CASES,
    CELLS,
    KNOWS,
    LABELS,
    FilterErrors,
    gauss_markov,
    run_cases,
    with_lasting_errors,
)
from fnn_ekf_ros.study.recording import Recording, Start
from fnn_ekf_ros.study.report.lasting_tables import (
    lasting_numbers,
    lasting_rows,
    lasting_tables,
    summary,
)
from fnn_ekf_ros.study.rivals import known_errors
from fnn_ekf_ros.study.rivals.known_errors import ErrorModel
from fnn_ekf_ros.study.scores import compare
from fnn_ekf_ros.study.settings import study_localizer

PATHS = tuple(lasting.SIMULATIONS)
MODEL = ErrorModel(fix_std=0.3, time_constant_s=10.0, offset_std=0.2)


def own_model(steps: int, runs: int, seed: int) -> tuple[Recording, Start]:
    """Return robots whose errors are exactly those of `MODEL`, and starts with their pose's P."""
    rng = np.random.default_rng(seed)
    turn = 0.08 * np.sin(np.arange(steps)[:, None] / 20.0 + 6.0 * rng.random(runs))
    control = np.stack([np.full(turn.shape, 0.1125), turn], axis=-1)
    truth = np.zeros((steps + 1, runs, 3))
    for k, u in enumerate(control):
        slipped = u + rng.normal(size=u.shape) * np.sqrt(TRUE_Q)
        truth[k + 1] = move(MotionModel.EXACT_ARC, truth[k].T, slipped.T).mean.T
    truth[..., 2] = wrap_angle(truth[..., 2])
    z = truth[1:][..., [0, 1, 2, 2]]
    z = z + rng.normal(size=z.shape) * np.sqrt(TRUE_R)
    z[..., :2] += gauss_markov(rng.normal(size=(steps, runs, 2)), MODEL, 0.375)
    z[..., 2] = wrap_angle(z[..., 2] + MODEL.offset_std * rng.normal(size=runs))
    recording = Recording(
        0.375, truth, control, z, np.tile([True, True, True, False], (steps, runs, 1)),
        np.tile(TRUE_Q, (steps, 1)), np.tile(TRUE_R, (steps, 1)),
    )  # fmt: skip
    P = np.diag(TRUE_R[:3])
    mean = truth[0] + rng.normal(size=(runs, 3)) * np.sqrt(TRUE_R[:3])
    return recording, Start(mean, np.tile(P, (runs, 1, 1)), TRUE_Q, TRUE_R)


# --- the EKF that knows the errors -----------------------------------------------------------


def by_differences(f: Callable[[FloatArray], FloatArray], at: FloatArray) -> FloatArray:
    """Return the Jacobian of f by central differences."""
    step = 1e-6
    return np.stack(
        [(f(at + e) - f(at - e)) / (2.0 * step) for e in step * np.eye(len(at))], axis=1
    )


def next_state(x: FloatArray, u: FloatArray) -> FloatArray:
    """Return f(x, u) of the state with lasting errors: an arc by its radius."""
    (px, py, yaw, bx, by, offset), (way, turn) = x, u
    radius, phi = way / turn, math.exp(-0.375 / 10.0)
    return np.array([
        px + radius * (math.sin(yaw + turn) - math.sin(yaw)),
        py + radius * (math.cos(yaw) - math.cos(yaw + turn)),
        yaw + turn, phi * bx, phi * by, offset,
    ])  # fmt: skip


def test_the_ekf_that_knows_equals_a_textbook_filter() -> None:
    recording, start = own_model(60, 2, 1)
    recording.truth[:, :, 2] += 3.0  # yaws on both sides of pi
    recording.measurement[..., 2] = wrap_angle(recording.measurement[..., 2] + 3.0)
    start.mean[:, 2] += 3.0
    found = known_errors.run(recording, start, MODEL)
    H = np.hstack([np.eye(3), np.eye(3)])
    grown = (1.0 - math.exp(-0.75 / 10.0)) * 0.09
    for robot in range(2):
        x = np.array([*start.mean[robot], 0.0, 0.0, 0.0])
        P = np.diag([0.01, 0.01, 0.018, 0.09, 0.09, 0.04])
        for k in range(60):
            u, z = recording.control[k, robot], recording.measurement[k, robot, :3]
            A = by_differences(lambda x, u=u: next_state(x, u), x)
            W = by_differences(lambda u, x=x: next_state(x, u), u)
            x = next_state(x, u)
            P = A @ P @ A.T + W @ np.diag(TRUE_Q) @ W.T + np.diag([0, 0, 0, grown, grown, 0])
            r = z - H @ x
            r[2] = math.remainder(r[2], 2.0 * math.pi)
            S = H @ P @ H.T + np.diag(TRUE_R[:3])
            K = P @ H.T @ np.linalg.inv(S)
            x, P = x + K @ r, P - K @ H @ P
            assert found.nis[k, robot] == pytest.approx(r @ np.linalg.inv(S) @ r, rel=1e-6)
            error = found.mean[k, robot] - x[:3]
            error[2] = math.remainder(error[2], 2.0 * math.pi)
            np.testing.assert_allclose(error, 0.0, atol=1e-8)
            np.testing.assert_allclose(found.covariance[k, robot], P[:3, :3], atol=1e-9)


def test_its_nees_and_nis_are_consistent_on_its_own_model() -> None:
    runs = 300
    recording, start = own_model(150, runs, 2)
    errors = compare(known_errors.run(recording, start, MODEL), recording.truth)
    low, high = (3.0 * end for end in chi_square_band(np.array(3.0 * runs)))
    for step in (40, 80, 149):  # 15 s, a time constant and a half, apart
        assert low < errors.nees[step].mean() < high, step
    low, high = (3.0 * end for end in chi_square_band(np.array(3.0 * errors.nis.size)))
    assert low < errors.nis.mean() < high
    # Without its model of the errors the same filter claims far too much.
    white = compare(known_errors.run(recording, start, ErrorModel()), recording.truth)
    assert white.nees[-1].mean() > 50.0


def test_without_lasting_errors_it_is_the_oracle() -> None:
    recording, start = own_model(50, 3, 3)
    oracle = study_filters(study_localizer("sim1", {}))[ORACLE].run(recording, start)
    found = known_errors.run(recording, start, ErrorModel())
    for one, other in zip(found, oracle, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-8, atol=1e-10)


def test_what_it_cannot_work_with_is_refused() -> None:
    recording, start = own_model(5, 1, 4)
    recording.available[2, 0, Row.X] = False
    with pytest.raises(ValueError, match="rows are missing"):
        known_errors.run(recording, start, MODEL)
    with pytest.raises(ValueError, match="expected standard deviations from 0"):
        ErrorModel(fix_std=-1.0)
    with pytest.raises(ValueError, match="a time above 0"):
        ErrorModel(time_constant_s=0.0)


# --- the errors ------------------------------------------------------------------------------


@pytest.mark.parametrize("time_s", lasting.TIME_CONSTANTS_S)
def test_errors_of_fixes_are_stationary_and_decay_with_their_time(time_s: float) -> None:
    model = CASES[f"fixes_{time_s:g}s"].model
    white = np.random.default_rng(5).standard_normal((60, 5000, 2))
    errors = gauss_markov(white, model, 0.375)
    np.testing.assert_allclose(errors.std(axis=(1, 2)), 0.3, rtol=0.03)  # from the first on
    for lag in (1, 8):
        correlation = np.mean(errors[lag:] * errors[:-lag]) / 0.09
        assert correlation == pytest.approx(math.exp(-0.375 * lag / time_s), abs=0.02)
    assert abs(np.corrcoef(errors[..., 0].ravel(), errors[..., 1].ravel())[0, 1]) < 0.05


def test_a_case_changes_its_readings_only() -> None:
    recording, _ = own_model(40, 3, 6)
    white = np.random.default_rng(7).standard_normal((40, 3, 2))
    same = with_lasting_errors(recording, CASES["none"], white)
    np.testing.assert_array_equal(same.measurement, recording.measurement)
    both = with_lasting_errors(recording, CASES["both"], white)
    moved = both.measurement - recording.measurement
    assert np.all(moved[..., :2] != 0.0)
    np.testing.assert_allclose(wrap_angle(moved[..., Row.COMPASS_YAW]), 0.2)
    assert np.all(moved[..., Row.LRF_YAW] == 0.0)
    fixes = with_lasting_errors(recording, CASES["fixes_30s"], white).measurement
    np.testing.assert_array_equal(fixes[..., :2], both.measurement[..., :2])
    np.testing.assert_array_equal(fixes[..., 2:], recording.measurement[..., 2:])


# --- runs and tables -------------------------------------------------------------------------


def test_runs_of_all_cases_share_drive_and_starts(monkeypatch: pytest.MonkeyPatch) -> None:
    localizer = study_localizer("sim2", {})
    whole = run_cases(localizer, "sim2", 12, 2, (3, 0))
    assert list(whole) == list(CASES)
    for by_filter in whole.values():
        assert {name: each.nees.shape for name, each in by_filter.items()} == {
            KNOWS: (2, 1, 2), ORACLE: (2, 1, 2), EKF_GATED: (2, 5, 2), JOINT: (2, 5, 2),
        }  # fmt: skip
    for one, other in zip(whole["none"][KNOWS], whole["none"][ORACLE], strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-6)
    monkeypatch.setattr(lasting, "CASES", {name: CASES[name] for name in ("none", "both")})
    again = run_cases(localizer, "sim2", 12, 2, (3, 0))
    np.testing.assert_array_equal(again["both"][JOINT].yaw, whole["both"][JOINT].yaw)


@pytest.mark.slow
def test_blocks_and_processes_make_no_difference(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(lasting_runs, "RUNS_AT_ONCE", 2)
    localizers = {path: study_localizer(path, {}) for path in lasting.SIMULATIONS}
    one, two = (lasting_runs.run_lasting(localizers, 10, 3, 4, jobs) for jobs in (1, 2))
    block = run_cases(localizers["sim2"], "sim2", 10, 1, (4, 1))
    for case in CASES:
        for name in LABELS:
            own = one["sim2"][case][name]
            for array, other in zip(own, two["sim2"][case][name], strict=True):
                np.testing.assert_array_equal(array, other)
            np.testing.assert_array_equal(own.nees[..., 2:], block[case][name].nees)


def squares(values: FloatArray, factor: float = 1.0) -> FloatArray:
    """Return `(2, cells, 4)` of four runs whose root mean squares are values `(2, cells)`."""
    return factor * np.square(values)[..., None] * np.array([0.8, 0.9, 1.1, 1.2])


def filter_errors(ratios: list[float], nees: list[float]) -> FilterErrors:
    """Return errors of starts; over the last half the ratio is 0.1 more, NEES twice as large."""
    ratio = np.array([ratios, np.add(ratios, 0.1)])
    position, yaw = 0.05 * ratio, 0.02 * ratio
    doubled = np.array([nees, np.multiply(nees, 2.0)])
    return FilterErrors(squares(position), squares(yaw), np.repeat(doubled[..., None], 4, axis=-1))


def made_up(joint: list[float], joint_nees: list[float]) -> dict[str, FilterErrors]:
    known = filter_errors([1.0], [3.0])
    known = known._replace(position=squares(np.array([[0.05], [0.05]])))
    known = known._replace(yaw=squares(np.array([[0.02], [0.02]])))
    return {
        KNOWS: known,
        ORACLE: filter_errors([1.2], [4.0]),
        EKF_GATED: filter_errors([1.3, 2.0, 3.0, 4.0, 2.5], [5.0] * 5),
        JOINT: filter_errors(joint, joint_nees),
    }


def test_tables_hold_each_filter_against_the_one_that_knows() -> None:
    case = made_up([1.1, 1.2, 1.6, 1.4, 1.3], [2.5, 0.5, 4.0, 9.0, 3.0])
    bare = made_up([1.0, 1.05, 1.0, 1.0, 1.0], [3.0] * 5)
    errors = {path: {"none": bare, "both": case} for path in lasting.SIMULATIONS}
    rows = lasting_rows(errors)
    text = lasting_tables(rows)
    for line in (
        "| both, 30 s | 0.050 / 0.050 | 0.0200 / 0.0200 | 3.00 / 6.00 |",
        "| both, 30 s | oracle EKF, white | knows the noise | 1.20 / 1.30 | 1.20 / 1.30 | "
        "4.00 / 8.00 |",
        "| both, 30 s | FNN-EKF joint | right start | 1.10 / 1.20 | 1.10 / 1.20 | 2.50 / 5.00 |",
        # The worst NEES is 0.5, a sixth of 3; over the last half, 18 and not 1.
        "| both, 30 s | FNN-EKF joint | worst: Q / 25, R x 25 | 1.60 / 1.70 | 1.60 / 1.70 | "
        "0.50 / 18.00 |",
        "| both, 30 s | EKF with gate | worst: Q x 25, R / 25 | 4.00 / 4.10 |",
    ):
        assert text.count(line) == 2, line
    assert "position RMSE 1.60 times that of the EKF that knows the errors, mean NEES 0.50" in (
        summary(rows)
    )
    assert "without lasting errors 1.05 times" in summary(rows)

    numbers = [each for row in rows for each in lasting_numbers(row)]
    assert len(numbers) == 2 * 2 * 12 * 2
    (worst,) = (
        each for each in numbers
        if (each["simulation"], each["case"], each["filter"]) == ("sim1", "both", JOINT)
        and (each["q"], each["k"], each["range"]) == (0.04, 25.0, "last half")
    )  # fmt: skip
    assert worst["ratio_position"] == pytest.approx([1.7] * 3)
    assert (worst["rmse_position"], worst["rmse_yaw"]) == pytest.approx((0.085, 0.034))
    assert worst["nees"] == [8.0, 8.0, 8.0]


def test_numbers_that_are_not_finite_are_the_worst() -> None:
    case = made_up([1.1, math.nan, 1.6, 1.4, 1.3], [2.5, math.nan, 4.0, 9.0, 3.0])
    rows = lasting_rows({path: {"none": case} for path in lasting.SIMULATIONS})
    assert "| worst: Q / 25, R / 25 | n/a / n/a | n/a / n/a | n/a / n/a |" in lasting_tables(rows)
    json.dumps([each for row in rows for each in lasting_numbers(row)], allow_nan=False)


# --- the command -----------------------------------------------------------------------------


@pytest.mark.slow
def test_the_command(tmp_path: Path, succeed: Succeed) -> None:
    out = tmp_path / "out"
    said = succeed("study", "lasting", "--out", out, "--runs", 2, "--steps", 10, "--jobs", 1)
    assert said.startswith(f"{out}: 56 rows, 2 runs of 10 periods\nMode joint from its worst")
    assert {path.name for path in out.iterdir()} == {
        "results.json", "results.md", "lasting.png",
        *(f"{node}_{path}.yaml" for node in ("localizer", "fake_robot") for path in PATHS),
    }  # fmt: skip
    assert (out / "lasting.png").read_bytes()[:4] == b"\x89PNG"
    found = json.loads((out / "results.json").read_text())
    assert (found["study"], found["runs"], found["steps"], found["seed"]) == ("lasting", 2, 10, 1)
    keys = {
        (r["simulation"], r["case"], r["filter"], r["q"], r["k"], r["range"])
        for r in found["results"]
    }
    assert len(keys) == len(found["results"]) == 2 * len(CASES) * (2 + 2 * len(CELLS)) * 2
    table = (out / "results.md").read_text()
    assert "`study lasting --runs 2 --steps 10 --seed 1`" in table
    assert [table.count(f"| {case.about} |") for case in CASES.values()] == [2 * 6] * len(CASES)


def test_what_the_command_refuses(tmp_path: Path, refuse: Refuse) -> None:
    words = ("study", "lasting", "--out", tmp_path / "out")
    assert "--runs 1: expected 2 to 10000" in refuse(*words, "--runs", 1)
    assert "--steps 9: expected 10 to 20000" in refuse(*words, "--steps", 9)
    assert "'period': the study sets it" in refuse(*words, "-p", "period:=0.1")
