# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""`study rates`: its recordings, the independent EKF, the tables and the command."""

import json
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from textbook_ekf import textbook_step

from fnn_ekf_ros.core.arrays import FloatArray, Row
from fnn_ekf_ros.parameters.fake_robot import FakeRobotParameters
from fnn_ekf_ros.parameters.matching import matching_localizer
from fnn_ekf_ros.simulation.delivery import STEP_NS
from fnn_ekf_ros.study import rates
from fnn_ekf_ros.study.filters import EKF, JOINT, localizer_models
from fnn_ekf_ros.study.instants import (
    Timing,
    counts_at,
    drive_steps,
    in_periods,
    read_sensors,
    reading_times,
    run_periods,
    true_poses,
)
from fnn_ekf_ros.study.rates import CELLS, PeriodErrors, RateCase, RateErrors
from fnn_ekf_ros.study.recording import Start
from fnn_ekf_ros.study.report.rates_tables import (
    period_rows,
    period_table,
    rate_numbers,
    rate_row,
    rate_table,
    summary,
)
from fnn_ekf_ros.study.rivals import plain_ekf
from fnn_ekf_ros.study.scenarios import NOMINAL_MEASUREMENT_NOISE, Drive
from fnn_ekf_ros.study.starts import RIGHT, starts_at

ROBOT = FakeRobotParameters(path="round")
Q_TRUE = np.square(ROBOT.slip())
MS = 10**6
SHIFTED = Timing(10.0, 50.0, 0.3, 0.6)


@pytest.fixture(scope="module")
def driven() -> Drive:
    """Three robots for 6 s."""
    return drive_steps(ROBOT, 480, 3, np.random.default_rng(1))


def start_of(driven: Drive, *cells: Any) -> Start:
    rng = np.random.default_rng(3)
    return starts_at(driven.truth[0], Q_TRUE, NOMINAL_MEASUREMENT_NOISE, cells or (RIGHT,), rng)


# --- recordings ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("timing", "first_fix", "first_compass", "fixes", "compass"),
    [
        (Timing(10.0, 50.0), 100, 20, 60, 300),
        (SHIFTED, 30, 12, 60, 300),
        (Timing(2.6667, 0.0), 375, None, 16, 0),
        (Timing(1.0, 1.0, 0.3, 0.6), 300, 600, 6, 6),
    ],
)
def test_readings_come_at_their_rates_and_phases(
    driven: Drive, timing: Timing, first_fix: int, first_compass: int, fixes: int, compass: int
) -> None:
    readings = read_sensors(driven, timing, np.random.default_rng(2))
    assert np.all(np.diff(readings.time_ns) > 0)
    for row, first, count, rate in (
        (Row.X, first_fix, fixes, timing.fix_rate),
        (Row.COMPASS_YAW, first_compass, compass, timing.compass_rate),
    ):
        when = readings.time_ns[readings.available[:, row]]
        assert len(when) == count
        if count:
            assert when[0] == first * MS
            np.testing.assert_allclose(np.diff(when), 1e9 / rate, rtol=2e-5)
    assert not readings.available[:, Row.LRF_YAW].any()
    np.testing.assert_array_equal(readings.available[:, Row.X], readings.available[:, Row.Y])


@pytest.mark.parametrize("period_s", rates.PERIODS_S)
@pytest.mark.parametrize("timing", [Timing(10.0, 50.0), SHIFTED])
def test_epochs_end_at_readings_and_at_the_ends_of_periods(
    driven: Drive, timing: Timing, period_s: float
) -> None:
    readings = read_sensors(driven, timing, np.random.default_rng(2))
    recording = in_periods(ROBOT, driven, readings, period_s)
    ends = np.arange(1, round(6.0 / period_s) + 1) * round(period_s * 1e9)
    instants = np.cumsum(np.round(recording.duration_s * 1e9).astype(np.int64))
    np.testing.assert_array_equal(instants, np.union1d(readings.time_ns, ends))
    np.testing.assert_array_equal(instants[recording.ends_period], ends)
    kept = recording.available.any(axis=1)
    np.testing.assert_array_equal(instants[kept], readings.time_ns)
    np.testing.assert_array_equal(recording.measurement[kept], readings.measurement)
    np.testing.assert_array_equal(recording.truth[1:], true_poses(driven, ends))


def test_readings_after_the_last_period_are_left_out(driven: Drive) -> None:
    readings = read_sensors(driven, Timing(10.0, 50.0), np.random.default_rng(2))
    recording = in_periods(ROBOT, driven, readings, 2.5)
    assert recording.duration_s.sum() == pytest.approx(5.0)
    assert recording.available[:, Row.X].sum() == 50


def test_encoders_count_in_whole_counts(driven: Drive) -> None:
    steps = np.arange(0, 481, dtype=np.int64) * STEP_NS
    counts = counts_at(ROBOT, driven, steps)
    np.testing.assert_array_equal(counts, np.floor(counts))
    between = counts_at(ROBOT, driven, steps[:-1] + STEP_NS // 4)
    np.testing.assert_allclose(between, counts[:-1] + 0.25 * np.diff(counts, axis=0))
    way = driven.travel[-1] - driven.travel[0]
    per_count = 2.0 * math.pi * ROBOT.wheel_radius / ROBOT.encoder_counts_per_revolution
    assert np.all(np.abs(way - per_count * (counts[-1] - counts[0])) <= per_count)
    recording = in_periods(
        ROBOT, driven, read_sensors(driven, SHIFTED, np.random.default_rng(2)), 0.375
    )
    np.testing.assert_allclose(
        recording.control[:, 0].sum(axis=0), per_count * counts[-1].mean(axis=-1)
    )


def test_a_pose_between_two_steps_turns_the_short_way() -> None:
    truth = np.array([[[0.0, 2.0, 3.1]], [[1.0, 2.0, 3.2 - 2.0 * math.pi]]])
    drive = Drive(truth, np.zeros((2, 1, 2)))
    (pose,) = true_poses(drive, np.array([STEP_NS // 2], dtype=np.int64))
    np.testing.assert_allclose(pose[0], [0.5, 2.0, 3.15 - 2.0 * math.pi], atol=1e-12)


def test_readings_scatter_as_they_should_and_each_sensor_on_its_own() -> None:
    driven = drive_steps(ROBOT, 480, 50, np.random.default_rng(1))
    some, more = (
        read_sensors(driven, Timing(10.0, rate, fix_yaw=True), np.random.default_rng(2))
        for rate in (0.0, 50.0)
    )
    fixes = more.available[:, Row.X]
    np.testing.assert_array_equal(some.measurement[:, Row.X], more.measurement[fixes, Row.X])
    error = some.measurement - true_poses(driven, some.time_ns).transpose(0, 2, 1)[:, [0, 1, 2, 2]]
    rows = [Row.X, Row.Y, Row.LRF_YAW]
    std = np.sqrt(NOMINAL_MEASUREMENT_NOISE[rows])
    wrapped = np.arctan2(np.sin(error), np.cos(error))[:, rows]
    np.testing.assert_allclose(wrapped.std(axis=(0, 2)), std, rtol=0.06)  # 3000 readings


def test_there_may_be_no_readings_at_all() -> None:
    assert len(reading_times(0.0, 0.0, 10**9)) == 0


# --- filters ---------------------------------------------------------------------------------


@pytest.mark.parametrize("timing", [SHIFTED, Timing(10.0, 0.0, 0.3, fix_yaw=True)])
def test_the_independent_ekf_equals_the_textbook_filter(driven: Drive, timing: Timing) -> None:
    recording = in_periods(
        ROBOT, driven, read_sensors(driven, timing, np.random.default_rng(2)), 0.5
    )
    turn = recording.control[:, 1]  # the textbook's arc needs one that is not too small
    turn[np.abs(turn) < 1e-3] = 1e-3
    start = Start(*(array[0] for array in start_of(driven)))
    means, covariances = plain_ekf.run(recording, start)
    x, P, R = start.mean[1], start.covariance[1], np.diag(NOMINAL_MEASUREMENT_NOISE)
    found = []
    for k, duration_s in enumerate(recording.duration_s):
        u = recording.control[k, :, 1]
        rows = [int(row) for row in np.flatnonzero(recording.available[k])]
        Q = np.diag(Q_TRUE) * duration_s / 0.375
        x, P = textbook_step(False, x, P, u, Q, recording.measurement[k, :, 1], R, rows)
        if recording.ends_period[k]:
            found.append((x, P))
    np.testing.assert_allclose(means[:, 1], [x for x, _ in found], atol=1e-8)
    np.testing.assert_allclose(covariances[:, 1], [P for _, P in found], atol=1e-9)


@pytest.mark.parametrize("timing", [Timing(10.0, 50.0), SHIFTED])
def test_the_filter_is_the_independent_ekf_at_every_period(driven: Drive, timing: Timing) -> None:
    readings = read_sensors(driven, timing, np.random.default_rng(2))
    start = start_of(driven)
    plain, _ = plain_ekf.run(
        in_periods(ROBOT, driven, readings, 3.0), Start(*(array[0] for array in start))
    )
    for period_s in (0.375, 1.0):
        localizer = replace(matching_localizer(ROBOT), period=period_s)
        model = localizer_models(localizer)[EKF].model
        recording = in_periods(ROBOT, driven, readings, period_s)
        track = run_periods(model, recording, start)
        every = round(3.0 / period_s)
        np.testing.assert_allclose(track.mean[every - 1 :: every, 0], plain, atol=1e-4)
        assert track.degrees_of_freedom.sum() == 3 * recording.available.sum()


def test_joint_estimates_the_same_at_every_period(driven: Drive) -> None:
    readings = read_sensors(driven, SHIFTED, np.random.default_rng(2))
    found = []
    for period_s in (0.375, 1.0):
        localizer = replace(matching_localizer(ROBOT), period=period_s)
        model = localizer_models(localizer)[JOINT].model
        recording = in_periods(ROBOT, driven, readings, period_s)
        every = round(3.0 / period_s)
        track = run_periods(model, recording, start_of(driven, *CELLS))
        found.append(track.mean[every - 1 :: every])
    np.testing.assert_allclose(*found, atol=1e-4)


def test_blocks_of_runs_make_no_difference(driven: Drive, monkeypatch: pytest.MonkeyPatch) -> None:
    readings = read_sensors(driven, Timing(5.0, 5.0), np.random.default_rng(2))
    recording = in_periods(ROBOT, driven, readings, 0.375)
    start = start_of(driven, *CELLS)
    model = localizer_models(matching_localizer(ROBOT))[JOINT].model
    whole = run_periods(model, recording, start)
    monkeypatch.setattr("fnn_ekf_ros.study.instants.ROBOTS_AT_ONCE", len(CELLS))
    parts = run_periods(model, recording, start)
    for one, other in zip(whole, parts, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-12)


# --- tables ----------------------------------------------------------------------------------


def of_runs(*values: float) -> FloatArray:
    """Return squares `(len(values), 4)` of four runs whose root mean squares these are."""
    return np.square(values)[:, None] * np.array([0.8, 0.9, 1.1, 1.2])


def errors_of_case(worst_ratio: float, worst_nees: float) -> RateErrors:
    ratios = (1.0, 1.01, 1.02, 1.03, worst_ratio)
    return RateErrors(
        position=of_runs(*(0.05 * ratio for ratio in ratios)),
        yaw=of_runs(*[0.04] * 5),
        nees=np.tile([[3.0], [3.1], [3.0], [worst_nees], [3.0]], (1, 4)),
        oracle_position=of_runs(0.05)[0],
        oracle_yaw=of_runs(0.04)[0],
        oracle_nees=np.full(4, 3.0),
    )


@pytest.mark.parametrize(("factor", "meets"), [(1.02, True), (1.04, False)])
def test_a_period_meets_the_bar_where_it_makes_no_difference(factor: float, meets: bool) -> None:
    stds = (0.05, 0.05, 0.05 * factor, 0.05)
    errors = PeriodErrors(of_runs(*stds), of_runs(*[0.04] * 4), of_runs(0.05)[0], of_runs(0.04)[0])
    rows = period_rows("shifted", 300.0, errors)
    assert [row.meets_bar for row in rows] == [True, True, meets, True]
    text = period_table(rows)
    assert "4 runs of 300 s." in text
    end = "yes" if meets else "**no**"
    ratio = f"{factor:.3f} / 1.000"
    line = f"| 0.375 | shifted | {0.05 * factor:.4f} / 0.0400 | {ratio} | 0.0500 / 0.0400 | {ratio}"
    assert f"{line} | {end} |" in text


@pytest.mark.parametrize(
    ("ratio", "nees", "meets"),
    [(1.04, 3.2, True), (1.06, 3.2, False), (1.04, 3.9, False), (1.04, 2.4, False)],
)
def test_a_rate_meets_the_bar_where_all_starts_do(ratio: float, nees: float, meets: bool) -> None:
    case = RateCase("aligned", Timing(1.0, 50.0))
    row = rate_row(case, 801.0, 4, errors_of_case(ratio, nees))
    assert row.meets_bar == meets
    end = "yes" if meets else "**no**"
    where = "Q x 25, R x 25"
    line = f"| 1 | 50 | 0.375 | aligned | 4 x 801 | 0.0500 / 0.0400 | {ratio:.3f} / 1.000 | {where}"
    assert f"{line} | {nees:.2f} | {end} |" in rate_table([row])
    numbers = rate_numbers(row)
    assert numbers["meets_bar"] == meets
    assert [start["nees"][0] for start in numbers["starts"]] == pytest.approx([3, 3.1, 3, nees, 3])
    assert numbers["starts"][4]["ratio_position"] == pytest.approx([ratio] * 3)
    assert f"finds the noise in {int(meets)} of 1." in summary([], [row])


def test_what_is_only_reported_has_no_bar() -> None:
    case = RateCase("aligned", Timing(10.0, 0.0, fix_yaw=True), has_bar=False)
    row = rate_row(case, 81.0, 4, errors_of_case(2.0, 9.0))
    assert "| 10, with yaw | none | 0.375 |" in rate_table([row])
    assert "| 9.00 | - |" in rate_table([row])
    assert rate_numbers(row)["meets_bar"] is None
    assert "finds the noise in 0 of 0." in summary([], [row])


def test_runs_are_as_long_as_their_fixes_need() -> None:
    cases = {(case.timing.fix_rate, case.timing.compass_rate): case for case in rates.RATE_CASES}
    lengths = {rate: rates.case_length(cases[rate, 50.0], 800) for rate in (1.0, 2.6667, 10.0, 0.2)}
    assert lengths == {1.0: 801.0, 2.6667: 300.0, 10.0: 81.0, 0.2: 2001.0}
    runs = {rate: rates.case_runs(cases[rate, 50.0], 20) for rate in (0.2, 1.0, 2.6667, 10.0)}
    assert runs == {0.2: 5, 1.0: 10, 2.6667: 20, 10.0: 40}
    assert rates.case_runs(cases[0.2, 50.0], 2) == 2
    assert {case.period_s for case in rates.RATE_CASES} == set(rates.PERIODS_S)


# --- command ---------------------------------------------------------------------------------


@pytest.mark.slow
def test_the_command_writes_tables_picture_and_numbers(
    tmp_path: Path, succeed: Callable[..., str], monkeypatch: pytest.MonkeyPatch
) -> None:
    cases = (
        RateCase("aligned", Timing(10.0, 50.0)),
        RateCase("shifted", Timing(10.0, 0.0, 0.3, fix_yaw=True), has_bar=False),
    )
    monkeypatch.setattr(rates, "RATE_CASES", cases)
    out = tmp_path / "out"
    said = succeed("study", "rates", "--out", out, "--runs", 2, "--fixes", 4, "--jobs", 1)
    first, sentence, last = said.splitlines()
    assert first == f"{out}: 8 rows of periods and 2 of rates, 2 runs"
    assert sentence.startswith("The period makes no difference in 8 of 8 rows; ")
    assert last == f"{out / 'results.md'}: the tables"
    assert {path.name for path in out.iterdir()} == {
        "results.md", "results.json", "rates.png", "fake_robot_round.yaml", "localizer_round.yaml",
    }  # fmt: skip
    found = json.loads((out / "results.json").read_text())
    assert (found["study"], found["runs"], found["fixes"], found["seed"]) == ("rates", 2, 4, 1)
    assert [row["period"] for row in found["periods"]] == 2 * list(rates.PERIODS_S)
    assert all(row["runs"] == 10 and row["meets_bar"] for row in found["periods"])
    assert [len(row["starts"]) for row in found["rates"]] == [5, 5]
    text = (out / "results.md").read_text()
    assert "`study rates --runs 2 --fixes 4 --seed 1`" in text
    assert "| 10, with yaw | none | 0.375 | shifted | 2 x 3 |" in text


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (("--runs", 1), "--runs 1: expected 2 to"),
        (("--fixes", 3), "--fixes 3: expected 4 to"),
        (("--seed", -1), "--seed -1: expected 0 to"),
        (("--jobs", 0), "--jobs 0: expected 1 to"),
        (("-p", "period:=0.1"), "parameter 'period': the study sets it; expected"),
        (("--json", "nowhere/numbers.json"), "there is no folder 'nowhere'"),
    ],
)
def test_what_makes_no_sense_is_refused(
    tmp_path: Path, refuse: Callable[..., str], words: tuple[object, ...], expected: str
) -> None:
    assert expected in refuse("study", "rates", "--out", tmp_path / "out", *words)
