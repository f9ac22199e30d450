# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Filters and trials of the studies: what they share, and how they must come out."""

from typing import Any

import numpy as np
import pytest
from localizers import make_parameters

from fnn_ekf_ros.core.arrays import Row, components_first, components_last
from fnn_ekf_ros.core.filter import step
from fnn_ekf_ros.core.results import Epoch
from fnn_ekf_ros.core.state import start_filter
from fnn_ekf_ros.membership.files import networks_for
from fnn_ekf_ros.parameters.fake_robot import FakeRobotParameters
from fnn_ekf_ros.study import dynamic, grid, paper, trials
from fnn_ekf_ros.study.filters import StudyFilter, study_filters
from fnn_ekf_ros.study.recording import Recording, Start
from fnn_ekf_ros.study.report.figures import line_style
from fnn_ekf_ros.study.scenarios import NOMINAL, NOMINAL_MEASUREMENT_NOISE, Scenario, record
from fnn_ekf_ros.study.starts import ALL_CELLS, CORNERS, FACTORS, RIGHT, Cell, starts
from fnn_ekf_ros.study.trials import (
    Outcome,
    Size,
    Trial,
    TrialPlan,
    around_event,
    blocks,
    halves,
    join_outcomes,
    make_trial,
    oracle_outcome,
    try_block,
)
from fnn_ekf_ros.timeline.filter_model import filter_model

ROBOT = FakeRobotParameters(path="sim1")
TRUE_Q = np.square(ROBOT.slip())
CELLS = (RIGHT, Cell(1.0, 1 / 25), Cell(1.0, 25.0), Cell(1 / 25, 25.0), Cell(25.0, 25.0))
SIZE = Size(steps=240, runs=30, seed=4)
NO_GATE = {"compass_gate": 0.0, "lrf_pose_gate": 0.0}
TINY = Size(steps=20, runs=3, seed=2)


@pytest.fixture(scope="module")
def filters() -> dict[str, StudyFilter]:
    return study_filters(make_parameters())


@pytest.fixture(scope="module")
def tiny() -> tuple[Recording, Start]:
    recording = record(ROBOT, NOMINAL, TINY.steps, TINY.runs, np.random.default_rng(8))
    rng = np.random.default_rng(9)
    return recording, starts(recording, TRUE_Q, NOMINAL_MEASUREMENT_NOISE, CELLS, rng)


@pytest.fixture(scope="module")
def trial(filters: dict[str, StudyFilter]) -> Trial:
    ranges = halves(SIZE.steps)
    return make_trial("sim1", ROBOT, NOMINAL, CELLS, ranges, SIZE, filters["oracle"])


def try_filter(trial: Trial, study_filter: StudyFilter) -> Outcome:
    """Run a filter from every start of a trial and score it."""
    return join_outcomes([try_block(trial, study_filter, each) for each in blocks(trial.cells)])


def worst(outcome: Outcome, cell: Cell, name: str = "last half") -> float:
    """Return the worst axis' ratio to the oracle."""
    return float(np.max(outcome.scores[name].ratio.value[outcome.cells.index(cell)]))


# --- Starts --------------------------------------------------------------------------------------


def test_starts_are_the_truth_plus_the_first_fix_error() -> None:
    recording = record(ROBOT, NOMINAL, 1, 2000, np.random.default_rng(1))
    rng = np.random.default_rng(2)
    start = starts(recording, TRUE_Q, NOMINAL_MEASUREMENT_NOISE, ALL_CELLS, rng)
    assert start.mean.shape == (25, 2000, 3)
    assert np.all(start.mean == start.mean[0])
    error = start.mean[0] - recording.truth[0]
    np.testing.assert_allclose(np.std(error, axis=0), [0.1, 0.1, 0.134], rtol=0.1)
    np.testing.assert_allclose(np.mean(error, axis=0), 0.0, atol=0.02)
    assert np.all(start.covariance == np.diag(NOMINAL_MEASUREMENT_NOISE[:3]))


def test_starts_are_wrong_by_their_cells() -> None:
    recording = record(ROBOT, NOMINAL, 1, 2, np.random.default_rng(1))
    rng = np.random.default_rng(2)
    start = starts(recording, TRUE_Q, NOMINAL_MEASUREMENT_NOISE, ALL_CELLS, rng)
    for index, (q, k) in enumerate(ALL_CELLS):
        np.testing.assert_allclose(start.process_noise[index], [q * TRUE_Q] * 2)
        np.testing.assert_allclose(
            start.measurement_noise[index], [k * NOMINAL_MEASUREMENT_NOISE] * 2
        )
    assert len(set(ALL_CELLS)) == 25
    assert set(CORNERS) == {Cell(q, k) for q in (1 / 25, 25) for k in (1 / 25, 25)}
    assert FACTORS[2] == 1.0


# --- Filters -------------------------------------------------------------------------------------


def test_every_filter_by_its_name(filters: dict[str, StudyFilter]) -> None:
    assert all(each.name == name for name, each in filters.items())
    assert len({each.label for each in filters.values()}) == len(filters)
    looks = [line_style(name, {name: ""}) for name in filters]
    assert len({(look["color"], look["ls"]) for look in looks}) == len(filters)
    assert {
        "dead_reckoning", "ekf", "ekf_gated", "oracle", "rq_published", "rq_trained", "r_published",
        "q_published", "r_trained", "q_trained", "rq_centroid", "joint", "innovation_based",
        "sage_husa", "variational_bayes", "multiple_model",
    } <= set(filters)  # fmt: skip


def test_a_batch_is_what_its_robots_are_one_by_one(
    filters: dict[str, StudyFilter], tiny: tuple[Recording, Start]
) -> None:
    recording, start = tiny
    one = Recording(
        recording.period_s, recording.truth[:, 1:2], recording.control[:, 1:2],
        recording.measurement[:, 1:2], recording.available[:, 1:2], recording.process_noise,
        recording.measurement_noise,
    )  # fmt: skip
    for name, each in filters.items():
        if name == "multiple_model":  # tested with the other rivals; too slow here
            continue
        together = each.run(recording, start)
        alone = each.run(one, Start(*(array[2, 1:2] for array in start)))
        for a, b in zip(together, alone, strict=True):
            np.testing.assert_allclose(a[:, 2, 1], b[:, 0], rtol=1e-9, atol=1e-12, err_msg=name)


@pytest.mark.parametrize(
    ("name", "changes"),
    [
        ("ekf", {"adaptation": "none"} | NO_GATE),
        ("ekf_gated", {"adaptation": "none"}),
        ("joint", {"adaptation": "joint"}),
        ("rq_published", {"adaptation": "rq", "membership_file": "published"} | NO_GATE),
        ("rq_trained", {"adaptation": "rq", "membership_file": "trained"} | NO_GATE),
        ("r_published", {"adaptation": "r", "membership_file": "published"} | NO_GATE),
        ("q_trained", {"adaptation": "q", "membership_file": "trained"} | NO_GATE),
        ("rq_centroid", {"adaptation": "rq", "inference": "centroid"} | NO_GATE),
    ],
)
def test_filters_are_the_localizers_own(
    tiny: tuple[Recording, Start], name: str, changes: dict[str, Any]
) -> None:
    """Step by step with the model that the localizer would make of its parameters."""
    shared = {"innovation_window": 6, "motion_model": "paper"}
    recording, start = tiny
    track = study_filters(make_parameters(**shared))[name].run(recording, start)
    parameters = make_parameters(**shared, **changes)
    model = filter_model(parameters, networks_for(parameters))
    mean, P, Q, R = start
    state = start_filter(
        model,
        components_first(mean),
        components_first(P, 2),
        components_first(Q),
        components_first(R),
    )
    batch = mean.shape[:-1]
    for t in range(TINY.steps):
        control, z, available = (
            components_first(np.broadcast_to(part[t], (*batch, part.shape[-1])))
            for part in (recording.control, recording.measurement, recording.available)
        )
        state, result = step(model, state, (Epoch(control, 0.375, z, available),))
        np.testing.assert_array_equal(track.mean[t], components_last(state.mean))
        np.testing.assert_array_equal(track.covariance[t], components_last(state.covariance, 2))
        np.testing.assert_array_equal(track.nis[t], result.nis)
    assert np.all(track.degrees_of_freedom == 3.0)


def test_dead_reckoning_takes_no_measurement(
    filters: dict[str, StudyFilter], tiny: tuple[Recording, Start]
) -> None:
    recording, start = tiny
    track = filters["dead_reckoning"].run(recording, start)
    other = filters["dead_reckoning"].run(
        recording._replace(measurement=0.0 * recording.measurement), start
    )
    np.testing.assert_array_equal(track.mean, other.mean)
    assert not track.degrees_of_freedom.any()
    assert not track.nis.any()


def test_the_oracle_is_told_the_noise_of_each_step(
    filters: dict[str, StudyFilter], tiny: tuple[Recording, Start]
) -> None:
    recording, start = tiny
    told = recording._replace(
        process_noise=recording.process_noise * np.where(np.arange(20) < 7, 1.0, 100.0)[:, None]
    )
    plain, knowing = (filters["oracle"].run(r, start).covariance for r in (recording, told))
    np.testing.assert_array_equal(plain[:7], knowing[:7])
    assert np.all(knowing[7:, ..., 0, 0] > plain[7:, ..., 0, 0])
    np.testing.assert_array_equal(plain, np.broadcast_to(plain[:, :1], plain.shape))


# --- Trials --------------------------------------------------------------------------------------


def test_trials_with_the_same_seed_share_what_they_can(filters: dict[str, StudyFilter]) -> None:
    def made(scenario: Scenario, seed: int) -> Trial:
        size = TINY._replace(seed=seed)
        return make_trial("x", ROBOT, scenario, CELLS, halves(20), size, filters["oracle"])

    one, same, biased, other = (
        made(scenario, seed)
        for scenario, seed in (
            (NOMINAL, 1), (NOMINAL, 1), (Scenario(compass_bias=0.1), 1), (NOMINAL, 2),
        )
    )  # fmt: skip
    for a, b in zip((*one.recording, *one.start), (*same.recording, *same.start), strict=True):
        np.testing.assert_array_equal(a, b)
    np.testing.assert_array_equal(one.recording.truth, biased.recording.truth)
    np.testing.assert_array_equal(one.start.mean, biased.start.mean)
    assert np.all(one.start.mean != other.start.mean)
    assert np.all(one.recording.truth[1:] != other.recording.truth[1:])


@pytest.mark.slow
def test_scores_do_not_depend_on_how_the_starts_are_cut_into_batches(
    monkeypatch: pytest.MonkeyPatch, trial: Trial, filters: dict[str, StudyFilter]
) -> None:
    found = []
    for cells_at_once in (2, 5):
        monkeypatch.setattr(trials, "CELLS_AT_ONCE", cells_at_once)
        found.append(try_filter(trial, filters["ekf"]))
    np.testing.assert_allclose(found[0].rms, found[1].rms, rtol=1e-9)
    assert found[0].cells == found[1].cells == CELLS
    np.testing.assert_allclose(
        found[0].scores["whole"].ratio.value, found[1].scores["whole"].ratio.value, rtol=1e-9
    )


def test_an_outcome_is_of_the_ranges_the_runs_and_the_first_run(
    trial: Trial, filters: dict[str, StudyFilter]
) -> None:
    outcome = try_filter(trial, filters["ekf"])
    assert (outcome.trial, outcome.filter) == ("sim1", "ekf")
    assert list(outcome.scores) == ["whole", "last half"]
    track = filters["ekf"].run(trial.recording, trial.start)
    np.testing.assert_allclose(outcome.first_run[..., :2], track.mean[:, :, 0, :2], atol=1e-12)
    np.testing.assert_array_equal(outcome.first_truth, trial.recording.truth[1:, 0])
    square = np.mean((track.mean - trial.recording.truth[1:, None])[120:, ..., :2] ** 2, axis=0)
    np.testing.assert_allclose(
        outcome.scores["last half"].rmse.value[:, :2], np.mean(np.sqrt(square), axis=1)
    )


def test_how_right_and_wrong_noise_come_out(trial: Trial, filters: dict[str, StudyFilter]) -> None:
    """The EKF is the oracle where all is right; wrong noise costs what theory says it costs."""
    oracle = oracle_outcome(trial, filters["oracle"])
    assert worst(oracle, RIGHT, "whole") == 1.0
    assert 2.5 < oracle.scores["whole"].nees.value[0] < 3.5
    ekf = try_filter(trial, filters["ekf"])
    assert worst(ekf, RIGHT, "whole") == 1.0
    # With Q and R wrong by the same factor the gain settles at the right one, P does not.
    same = ekf.cells.index(Cell(25.0, 25.0))
    assert worst(ekf, Cell(25.0, 25.0)) < 1.01
    assert ekf.scores["last half"].nees.value[same] == pytest.approx(3.0 / 25.0, rel=0.2)
    assert 1.5 < worst(ekf, Cell(1.0, 1 / 25)) < 2.0
    assert 1.5 < worst(ekf, Cell(1.0, 25.0)) < 2.1
    assert worst(ekf, Cell(1 / 25, 25.0)) > 3.5


def test_the_papers_filter_comes_out_alike_from_every_start(
    trial: Trial, filters: dict[str, StudyFilter]
) -> None:
    """Moving both matrices cures any wrong start, and costs as much where the start was right."""
    paper = try_filter(trial, filters["rq_published"])
    for cell in CELLS:
        assert 1.8 < worst(paper, cell) < 2.4, cell
    ekf = try_filter(trial, filters["ekf"])
    assert worst(paper, Cell(1 / 25, 25.0)) < 0.6 * worst(ekf, Cell(1 / 25, 25.0))


def test_how_the_published_sets_come_out(trial: Trial, filters: dict[str, StudyFilter]) -> None:
    """Adapting R cures a wrong R, not a wrong Q: that is put down to R."""
    adaptive = try_filter(trial, filters["r_published"])
    assert 1.0 < worst(adaptive, RIGHT) < 1.03
    assert worst(adaptive, Cell(1.0, 1 / 25)) < 1.05
    assert worst(adaptive, Cell(1.0, 25.0)) < 1.05
    assert worst(adaptive, Cell(25.0, 25.0)) > 1.5
    assert worst(adaptive, Cell(1 / 25, 25.0)) > 1.7
    lost = try_filter(trial, filters["dead_reckoning"])
    assert lost.scores["whole"].diverged[0] > 0.9


def test_the_oracle_beats_the_right_start_where_the_noise_changes(
    filters: dict[str, StudyFilter],
) -> None:
    ranges = around_event(120)
    scenario = Scenario(process_scale=100.0)
    size = SIZE._replace(steps=120, runs=20)
    slipping = make_trial("slip", ROBOT, scenario, (RIGHT,), ranges, size, filters["oracle"])
    outcome = try_filter(slipping, filters["ekf"])
    best = oracle_outcome(slipping, filters["oracle"])
    before = slice(0, slipping.ranges["during"].start)
    assert np.min(outcome.scores["during"].ratio.value) > 1.5
    np.testing.assert_array_equal(outcome.rms[before], best.rms[before])


def test_ranges() -> None:
    assert halves(800) == {"whole": slice(0, 800), "last half": slice(400, 800)}
    assert around_event(800) == {
        "whole": slice(0, 800), "during": slice(320, 480), "after": slice(480, 640),
    }  # fmt: skip


@pytest.mark.slow
def test_what_the_studies_try(filters: dict[str, StudyFilter]) -> None:
    def made(plans: list[TrialPlan]) -> list[Trial]:
        return [make_trial(*plan, filters["oracle"]) for plan in plans]

    simulations = made(grid.plans(TINY))
    assert [each.name for each in simulations] == list(grid.SIMULATIONS)
    assert all(each.cells == ALL_CELLS for each in simulations)
    true_std = [np.sqrt(each.recording.process_noise[0]) for each in simulations]
    np.testing.assert_allclose(true_std, [[0.02, np.radians(1.0)], [0.05, np.radians(3.0)]])

    cases = made(dynamic.plans(TINY))
    assert [each.name for each in cases] == list(dynamic.CASES)
    assert all(each.cells == dynamic.CASES[each.name].cells for each in cases)
    assert {each.cells for each in cases} == {(RIGHT, *CORNERS), ALL_CELLS}
    lost = {each.name: ~each.recording.available[8:12, 0] for each in cases}
    assert lost["fixes_lost"][:, [Row.X, Row.Y]].all()
    assert lost["compass_lost"][:, Row.COMPASS_YAW].all()
    assert not lost["compass_lost"][:, Row.X].any()

    drives = made(paper.plans(TINY))
    assert [each.name for each in drives] == ["sim1", "sim2", "round"]
    assert all(each.cells == paper.STARTS for each in drives)
