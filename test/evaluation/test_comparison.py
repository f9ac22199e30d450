# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Runs are told apart where the data can tell, and only there."""

import numpy as np
import pytest
from numpy.typing import NDArray
from tracks import noisy, wiggling

from fnn_ekf_ros.evaluation.alignment import Alignment, Similarity
from fnn_ekf_ros.evaluation.comparison import (
    Compared,
    Measure,
    Series,
    conclusion,
    difference,
    judge,
    judge_consistency,
    judgment_in_words,
    measures,
)
from fnn_ekf_ros.evaluation.evaluation import evaluate
from fnn_ekf_ros.recordings.run_record import RunRecord

TIMES = 375_000_000 * np.arange(1500)


def correlated(seed: int, runs: int, phi: float) -> NDArray[np.float64]:
    white = np.random.default_rng(seed).standard_normal((len(TIMES), runs))
    errors = np.empty_like(white)
    errors[0] = white[0]
    for k in range(1, len(white)):
        errors[k] = phi * errors[k - 1] + (1.0 - phi**2) ** 0.5 * white[k]
    return errors


@pytest.mark.parametrize("phi", [0.0, 0.9])
def test_runs_that_are_equally_good_are_told_apart_in_about_5_of_100_cases(phi: float) -> None:
    errors = np.abs(correlated(3, 400, phi))
    found = [
        difference(Series(TIMES, errors[:, i]), Series(TIMES, errors[:, i + 1]))
        for i in range(0, 400, 2)
    ]
    assert 0.0 <= np.mean([each.told_apart for each in found]) <= 0.09
    covered = np.mean([each.low <= 1.0 <= each.high for each in found])
    assert covered >= 0.91


def test_what_two_runs_have_in_common_cancels() -> None:
    """A run that is worse by 5 % everywhere is told from the other, however errors scatter."""
    error = np.abs(correlated(5, 1, 0.9)[:, 0])
    found = difference(Series(TIMES, 1.05 * error), Series(TIMES, error))
    assert found.ratio == pytest.approx(1.05)
    assert found.told_apart
    assert found.high - found.low < 1e-6


def test_a_run_that_is_worse_is_found() -> None:
    a, b = np.abs(correlated(7, 2, 0.5)).T
    found = difference(Series(TIMES, 2.0 * a), Series(TIMES, b))
    assert found.told_apart
    assert found.low < 2.0 < found.high


def test_wild_fixes_hide_a_difference_less_in_the_mean_than_in_the_square() -> None:
    """Both runs see the same few wild fixes; the one is worse by a fifth at all others."""
    a, b = np.abs(correlated(13, 2, 0.0)).T
    wild = np.zeros(len(TIMES))
    wild[::40] = 60.0
    mean, square = (
        difference(Series(TIMES, 1.2 * a + wild, power), Series(TIMES, b + wild, power))
        for power in (1, 2)
    )
    assert mean.told_apart
    assert mean.ratio > 1.05
    assert square.ratio < 1.01


def test_runs_are_compared_at_their_common_times() -> None:
    error = np.abs(correlated(9, 1, 0.0)[:, 0])
    one, other = Series(TIMES[:1000], error[:1000]), Series(TIMES[500:], error[500:])
    assert difference(one, other).ratio == pytest.approx(1.0)
    elsewhere = Series(TIMES + 10**15, error)
    assert not difference(one, elsewhere).told_apart
    said = judgment_in_words(judge(Measure("position error", "m", {"a": one, "b": elsewhere})))
    assert said in [f"position error: {x} have no times in common" for x in ("a and b", "b and a")]


def test_sentences() -> None:
    a, b = np.abs(correlated(7, 2, 0.5)).T
    series = {"a": Series(TIMES, a), "b": Series(TIMES, 2.0 * a), "c": Series(TIMES, b)}
    judgment = judge(Measure("position error", "m", series))
    said = judgment_in_words(judgment)
    assert said.startswith("position error: ")
    assert " is best, " in said
    assert "b 2.0" in said or "b 1.9" in said
    assert "the data cannot tell" in said
    assert conclusion([judgment]) == "in all: no run is told from all others by position error"
    assert conclusion([]) == "in all: there is nothing to compare by"


def test_an_aligned_run_forecasts_the_truth_as_the_run_that_needs_no_alignment() -> None:
    truth = wiggling()
    track, motion = noisy(truth), Similarity(1.2, 30.0, -4.0)
    found = []
    for pose in (track.pose, motion.poses(track.pose)):
        record = RunRecord(
            track.__class__(track.time_ns, pose, track.covariance), track.pose[:, :2]
        )
        each = Compared(record, truth, evaluate(record, truth, Alignment.SE2))
        found.append({m.name: m.series["it"].size() for m in measures({"it": each})})
    assert found[0] == pytest.approx(found[1])


def test_truth_and_forecasts_are_compared_where_all_runs_have_them() -> None:
    truth = wiggling()
    runs = {}
    for name, seed, factor in (("good", 1, 1.0), ("bad", 2, 3.0)):
        track = noisy(truth, seed)
        pose = truth.pose + factor * (track.pose - truth.pose)
        worse = track.__class__(track.time_ns, pose, track.covariance)
        record = RunRecord(worse, np.zeros((len(pose), 2)))
        runs[name] = Compared(record, truth, evaluate(record, truth))
    found = measures(runs)
    assert [each.name for each in found] == [
        "position error", "yaw error", "forecast of truth 10 s ahead",
        "forecast of truth 100 s ahead",
    ]  # fmt: skip
    assert judgment_in_words(judge(found[0])).startswith("position error: good is best")
    assert conclusion([judge(found[0])]) == "in all: good is best by position error"
    assert judge_consistency(runs)[0] == "NEES: good is honest, bad is not"
    alone = {name: each._replace(truth=None, found=evaluate(each.run, None))
             for name, each in runs.items()}  # fmt: skip
    assert measures(alone) == []
