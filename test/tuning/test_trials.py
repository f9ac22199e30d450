# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""`study tune`: the true values that tuning is compared with, and what the command writes."""

import dataclasses
import json
import math
from pathlib import Path

import numpy as np
import pytest
from commands import Refuse, Succeed

from fnn_ekf_ros.commands import study_tune
from fnn_ekf_ros.core.arrays import Row
from fnn_ekf_ros.tuning import trials
from fnn_ekf_ros.tuning.fit import FULL
from fnn_ekf_ros.tuning.objective import term_values
from fnn_ekf_ros.tuning.quantities import Quantity
from fnn_ekf_ros.tuning.trial_tables import summary, trial_table
from fnn_ekf_ros.tuning.trials import (
    KINDS,
    Found,
    Trial,
    compare_halves,
    halves,
    simulated,
    tune_robot,
)
from fnn_ekf_ros.tuning.tune import configured

QUICK_S = 100.0


def test_the_true_values_explain_a_calibrated_robot_better_than_the_given_ones() -> None:
    """Signs of offsets and factors: each quantity that is put back to what was given costs."""
    recording, true = simulated(KINDS["calibration"], 1, QUICK_S)
    given = configured(recording.parameters)
    wrong = (Quantity.RADIUS, Quantity.SEPARATION, Quantity.OFFSET, Quantity.POSITION)
    models = [true]
    for quantity in wrong:
        model = true.copy()
        model[quantity] = given[quantity]
        models.append(model)
    values = FULL.each() @ term_values([recording], np.stack(models, axis=1))
    assert np.all(values[1:] < values[0] - 1.0), values


def test_true_errors_that_last_explain_fixes_that_have_them() -> None:
    recording, true = simulated(KINDS["lasting"], 1, QUICK_S)
    white = true.copy()
    white[Quantity.FIX_ERROR] = 0.0
    lasting, none = FULL.each() @ term_values([recording], np.stack([true, white], axis=1))
    assert lasting > none + 10.0


def test_halves_are_all_of_a_recording() -> None:
    recording, _ = simulated(KINDS["sim2"], 1, QUICK_S)
    first, second = halves(recording)
    for name in ("control", "duration_s", "measurement", "available", "reported"):
        parts = [getattr(first, name), getattr(second, name)]
        np.testing.assert_array_equal(np.concatenate(parts, axis=-1), getattr(recording, name))
    assert np.linalg.norm(second.mean[:2] - recording.mean[:2]) > 0.5
    assert np.all(np.linalg.eigvalsh(second.covariance) > 0.0)


def test_what_was_found_is_compared_with_the_truth(monkeypatch: pytest.MonkeyPatch) -> None:
    """A robot whose tuning finds exactly what it has is off by nothing; offsets are differences."""
    recording, true = simulated(KINDS["sim2"], 1, QUICK_S)
    found = tune_robot("sim2", 1, QUICK_S).found
    assert {each.quantity for each in found} == {"distance", "rotation", "position", "compass"}
    assert all(0.0 < each.std < 1.0 for each in found)
    off = dataclasses.replace(recording.parameters, compass_offset=0.0)
    assert configured(off)[Quantity.POSITION] * trials.START_FACTOR == pytest.approx(
        true[Quantity.POSITION]
    )
    shifted = true.copy()
    shifted[Quantity.POSITION] *= 2.0
    monkeypatch.setattr(trials, "simulated", lambda *_: (recording, shifted))
    doubled = tune_robot("sim2", 1, QUICK_S).found
    position = next(each for each in doubled if each.quantity == "position")
    assert position.error == pytest.approx(-0.5, abs=0.1)
    assert not position.covered


def test_tables_count_what_is_covered() -> None:
    told = [
        Trial("sim2", 1, False, (Found("position", 0.3, 0.2, True),)),
        Trial("sim2", 2, True, (Found("position", -0.4, 0.2, False),)),
    ]
    assert "| sim2 | 1 of 2 | position | 0.3536 | 0.4000 | 0.2000 | 1 of 2 |" in trial_table(
        ["sim2"], told
    )
    assert summary(told) == "2 robots, 1 of 2 intervals have the true value in them"
    told.append(Trial("sim2", 3, False, (Found("position", 0.0, math.inf, True),)))
    assert "| 0.4000 | 0.2000 | 2 of 3 |" in trial_table(["sim2"], told)
    written = json.dumps([study_tune._plain(trial) for trial in told], allow_nan=False)
    assert json.loads(written)[2]["found"][0]["std"] is None


def test_the_command_takes_robots_and_recordings(
    tmp_path: Path, succeed: Succeed, refuse: Refuse
) -> None:
    out, bag = tmp_path / "out", tmp_path / "drive"
    words = ("--kinds", "sim2", "--runs", 1, "--seconds", 100, "--jobs", 1)
    said = succeed("study", "tune", "--out", out, *words)
    assert said.startswith(f"{out}: 1 robots, ")
    (robot,) = json.loads((out / "results.json").read_text())["results"]
    assert (robot["kind"], robot["halves"]) == ("sim2", None)
    line = refuse("study", "tune", "--out", tmp_path / "no", "-p", "period:=1.0")
    assert "expected at least one BAG" in line

    succeed("simulate", bag, "--duration", 60)
    succeed("study", "tune", bag, "--halves", "--out", tmp_path / "recorded")
    (row,) = json.loads((tmp_path / "recorded" / "results.json").read_text())["results"]
    assert row["halves"]["most_different"] in ("distance", "rotation", "position", "compass")
    assert "| drive | " in (tmp_path / "recorded" / "results.md").read_text()
    assert 0.8 < row["plain"] < 1.3
    assert 0.8 < row["lasting"] < 1.3


def test_halves_of_a_drive_whose_noise_stays_differ_by_chance_alone(
    tmp_path: Path, succeed: Succeed
) -> None:
    """And the noise of the first fits the second."""
    out = tmp_path / "out"
    words = ("--kinds", "sim2", "--runs", 1, "--seconds", 100, "--jobs", 1, "--halves")
    succeed("study", "tune", "--out", out, *words)
    (row,) = json.loads((out / "results.json").read_text())["results"]
    beside = row["halves"]
    assert 0.0 <= beside["loss_nats"] < 8.0
    assert 0.0 <= beside["loss"] < 0.02
    assert beside["most_different"] in ("distance", "rotation", "position", "compass")
    assert 0.0 < beside["standard_errors"] < 3.0
    text = (out / "results.md").read_text()
    assert "--kinds sim2 --halves`" in text
    assert f"| sim2, seed 1 | {beside['loss_nats']:.1f} | {beside['loss']:+.2%} |" in text


def test_halves_whose_noise_differs_say_so() -> None:
    """Fixes of the second half with three times the noise, and no compass in it."""
    recording, _ = simulated(KINDS["sim2"], 1, QUICK_S)
    middle = len(recording.duration_s) // 2
    measurement, available = recording.measurement.copy(), recording.available.copy()
    rng = np.random.default_rng(1)
    measurement[:2, middle:] += 0.3 * rng.standard_normal(measurement[:2, middle:].shape)
    available[Row.COMPASS_YAW, middle:] = False
    changed = recording._replace(measurement=measurement, available=available)
    beside = compare_halves(changed, lambda _: None)
    assert beside is not None
    assert beside.most_different == "position"
    assert beside.standard_errors > 5.0
    assert beside.loss_nats > 50.0


def test_halves_with_few_fixes_are_not_compared() -> None:
    recording, _ = simulated(KINDS["sim2"], 1, QUICK_S)
    few = recording.available.copy()
    few[[Row.X, Row.Y], 20:] = False
    assert compare_halves(recording._replace(available=few), lambda _: None) is None
