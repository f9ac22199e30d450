# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The command train, and the packaged set that it made."""

import dataclasses
import itertools
import json
from importlib import resources
from pathlib import Path

import numpy as np
import pytest
from commands import Refuse, Succeed
from localizers import make_parameters

from fnn_ekf_ros.commands.train import EPOCHS
from fnn_ekf_ros.core.angles import wrap_angle
from fnn_ekf_ros.core.fuzzy import infer
from fnn_ekf_ros.membership.files import networks_for, read_membership, render_membership
from fnn_ekf_ros.parameters.fake_robot import FakeRobotParameters
from fnn_ekf_ros.study.filters import run as run_filter
from fnn_ekf_ros.study.recording import Start
from fnn_ekf_ros.study.scenarios import NOMINAL, record
from fnn_ekf_ros.timeline.filter_model import filter_model
from fnn_ekf_ros.training import joint_set, training_set
from fnn_ekf_ros.training.descent import descend
from fnn_ekf_ros.training.five_layers import as_sets
from fnn_ekf_ros.training.lessons import SUBJECTS


@pytest.fixture
def few_robots(monkeypatch: pytest.MonkeyPatch) -> None:
    """Makes the training set small."""
    monkeypatch.setattr(training_set, "RUNS", 6)
    monkeypatch.setattr(training_set, "STEPS", 60)
    monkeypatch.setattr(joint_set, "RUNS", {"constant": 6, "slip": 1, "noisy sensors": 1})
    monkeypatch.setattr(joint_set, "STEPS", 20)
    monkeypatch.setattr(joint_set, "FEWEST_STEPS", 15)


@pytest.mark.slow
def test_the_packaged_set_is_what_the_command_writes(tmp_path: Path, succeed: Succeed) -> None:
    pytest.importorskip("matplotlib")
    plots = tmp_path / "new" / "plots"
    said = succeed("train", "--out", tmp_path / "made.yaml", "--plots", plots)
    made, packaged = read_membership(str(tmp_path / "made.yaml")), read_membership("trained")
    np.testing.assert_allclose(made.sets, packaged.sets, rtol=1e-4)
    np.testing.assert_allclose(
        [made.position_unit, made.yaw_unit, made.change_limit],
        [packaged.position_unit, packaged.yaw_unit, packaged.change_limit],
        rtol=1e-4,
    )
    assert made.sets != read_membership("initial").sets
    assert sorted(path.name for path in plots.iterdir()) == [
        "change.png", "loss.png", "membership.png", "training.json",
    ]  # fmt: skip
    for path in plots.glob("*.png"):
        assert path.read_bytes().startswith(b"\x89PNG")
    facts = json.loads((plots / "training.json").read_text())
    assert (facts["seed"], facts["epochs"], facts["initial"]) == (1, 4000, "initial")
    losses = np.array(facts["loss"])
    assert losses.shape == (4001,)
    assert np.all(np.diff(losses) <= 0.0)
    assert losses[-1] < 0.03 * losses[0]
    assert f"loss {losses[0]:.6g} before, {losses[-1]:.6g} after" in said
    text = (tmp_path / "made.yaml").read_text()
    assert "--initial initial --epochs 4000 --rate 0.01 --seed 1 --innovation-window 45" in text


@pytest.mark.slow
def test_the_packaged_set_beats_the_papers() -> None:
    """RMSE over the oracle's, mean of x, y, theta, from a right and from two wrong starts."""
    rng = np.random.default_rng(31)
    recording = record(FakeRobotParameters(path="sim1"), NOMINAL, 200, 60, rng)
    R = recording.measurement_noise[0]
    P = np.diag(R[:3])
    mean = recording.truth[0] + np.sqrt(R[:3]) * rng.standard_normal((60, 3))

    def errors(mode: str, name: str, factor: float) -> np.ndarray:
        parameters = make_parameters(adaptation=mode, membership_file=name)
        start = Start(mean, P, np.tile(recording.process_noise[0], (60, 1)), R * factor)
        model = filter_model(parameters, networks_for(parameters))
        error = run_filter(model, recording, start).mean - recording.truth[1:]
        error[..., 2] = wrap_angle(error[..., 2])
        return np.sqrt(np.mean(error**2, axis=(0, 1)))

    oracle = errors("none", "initial", 1.0)
    ratio = {
        (name, factor): float(np.mean(errors("r", name, factor) / oracle))
        for name in ("published", "trained")
        for factor in (1.0, 1.0 / 25.0, 25.0)
    }
    assert ratio["trained", 1.0] < 1.01
    for factor in (1.0, 1.0 / 25.0, 25.0):
        assert ratio["trained", factor] < ratio["published", factor], ratio


@pytest.mark.slow
def test_the_packaged_set_of_mode_joint_is_where_other_robots_lead(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The command takes half a minute: a smaller training set, from another seed."""
    text = (resources.files("fnn_ekf_ros.membership") / "joint.yaml").read_text("utf-8")
    rate = SUBJECTS["joint"].rate
    assert (
        f"train --network joint --initial joint_initial --epochs {EPOCHS} --rate {rate:g} --seed 1"
    ) in text
    monkeypatch.setattr(joint_set, "RUNS", {"constant": 128, "slip": 16, "noisy sensors": 16})
    monkeypatch.setattr(joint_set, "STEPS", 60)
    monkeypatch.setattr(joint_set, "FEWEST_STEPS", 60)
    initial, packaged = read_membership("joint_initial"), read_membership("joint")
    lesson = SUBJECTS["joint"].prepare(initial, 0, np.random.default_rng(2))
    p, *data = np.array(lesson.start), lesson.inputs, lesson.targets, rate, lesson.weight
    *_, learned = itertools.islice(descend(lesson.network, p, *data), EPOCHS + 1)
    other = lesson.finish(as_sets(learned.parameters)).sets
    u = np.linspace(-2.5, 2.5, 201)
    before, there, here = (infer(sets, -u).change for sets in (initial.sets, other, packaged.sets))
    np.testing.assert_allclose(here, -here[::-1], atol=1e-14)
    assert np.max(np.abs(here)) < joint_set.LARGEST_CHANGE
    assert np.max(np.abs(there - here)) < 0.25
    assert np.max(np.abs(there - here)[np.abs(u) < 0.3]) < 0.06
    assert np.max(np.abs(before - here)) > 0.1


@pytest.mark.slow
def test_mode_joint_learns_draws_and_replays_what_it_learned(
    tmp_path: Path, succeed: Succeed, recorded: Path, few_robots: None
) -> None:
    pytest.importorskip("matplotlib")
    for name, seed in (("one", 3), ("two", 3), ("three", 4)):
        plots = ["--plots", tmp_path / "plots"] if name == "one" else []
        said = succeed("train", "--network", "joint", "--out", tmp_path / name,
                       "--epochs", 50, "--seed", seed, *plots)  # fmt: skip
        assert f"use it with joint_membership_file:={tmp_path / name}" in said
    one, two, three = ((tmp_path / name).read_bytes() for name in ("one", "two", "three"))
    assert one == two
    assert read_membership(str(tmp_path / "one")) != read_membership(str(tmp_path / "three"))
    assert one != three
    facts = json.loads((tmp_path / "plots" / "training.json").read_text())
    assert (facts["network"], facts["initial"], facts["epochs"]) == ("joint", "joint_initial", 50)
    assert np.all(np.diff(facts["loss"]) <= 0.0)
    assert facts["loss"][-1] < facts["loss"][0]
    for picture in ("membership", "change", "loss"):
        assert (tmp_path / "plots" / f"{picture}.png").read_bytes().startswith(b"\x89PNG")
    words = ["--params", recorded.with_name(f"{recorded.name}.yaml")]
    succeed("replay", recorded, tmp_path / "out", *words,
            "-p", f"joint_membership_file:={tmp_path / 'one'}")  # fmt: skip


@pytest.mark.slow
def test_the_same_seed_writes_the_same_bytes(
    tmp_path: Path, succeed: Succeed, few_robots: None
) -> None:
    for name, seed in (("one", 3), ("two", 3), ("three", 4)):
        succeed("train", "--out", tmp_path / name, "--epochs", 5, "--seed", seed)
    one, two, three = ((tmp_path / name).read_bytes() for name in ("one", "two", "three"))
    assert one == two
    assert one != three
    assert read_membership(str(tmp_path / "one")) != read_membership(str(tmp_path / "three"))


@pytest.mark.slow
def test_training_starts_from_a_file_and_replay_takes_the_result(
    tmp_path: Path, succeed: Succeed, recorded: Path, few_robots: None
) -> None:
    initial, copied, other = (tmp_path / name for name in ("initial", "copied", "other"))
    (tmp_path / "copy").write_text(render_membership(read_membership("initial"), []))
    for out, start in ((initial, "initial"), (copied, tmp_path / "copy"), (other, "published")):
        succeed("train", "--out", out, "--epochs", 10, "--initial", start)
    of_initial, of_copy, of_published = map(read_membership, map(str, (initial, copied, other)))
    assert of_initial == of_copy
    assert of_initial != of_published
    words = ["--params", recorded.with_name(f"{recorded.name}.yaml"), "-p", "adaptation:=r"]
    succeed("replay", recorded, tmp_path / "out", *words, "-p", f"membership_file:={other}")


@pytest.mark.slow
def test_a_short_window_makes_a_larger_unit(
    tmp_path: Path, succeed: Succeed, few_robots: None
) -> None:
    for window in (10, 40):
        succeed("train", "--out", tmp_path / str(window), "--epochs", 1,
                "--innovation-window", window)  # fmt: skip
    ten, forty = (read_membership(str(tmp_path / str(window))) for window in (10, 40))
    assert ten.position_unit / forty.position_unit == pytest.approx(2.0, rel=0.3)


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["--epochs", "0"], "--epochs 0: expected 1 to 1000000"),
        (["--rate", "0"], "--rate 0: expected more than 0"),
        (["--rate", "nan"], "--rate nan: expected more than 0"),
        (["--rate", "inf"], "--rate inf: expected more than 0"),
        (["--seed", "-1"], "--seed -1: expected 0 to"),
        (["--innovation-window", "1"], "--innovation-window 1: expected 2 to"),
        (["--network", "joint", "--innovation-window", "45"], "mode joint has none"),
        (["--network", "joint", "--rate", "0"], "--rate 0: expected more than 0"),
        (["--initial", "final"], "membership_file 'final' does not exist"),
    ],
)
def test_train_refuses(tmp_path: Path, refuse: Refuse, words: list[str], expected: str) -> None:
    assert expected in refuse("train", "--out", tmp_path / "out.yaml", *words)


def test_train_refuses_places_it_cannot_write_to(tmp_path: Path, refuse: Refuse) -> None:
    missing = tmp_path / "missing" / "out.yaml"
    assert "there is no folder" in refuse("train", "--out", missing)
    assert "is a folder" in refuse("train", "--out", tmp_path)
    (tmp_path / "file").write_text("mine")
    line = refuse("train", "--out", tmp_path / "out.yaml", "--plots", tmp_path / "file")
    assert "--plots" in line
    plots, picture = tmp_path / "plots", tmp_path / "plots" / "loss.png"
    assert "or another result" in refuse("train", "--out", plots, "--plots", plots)
    plots.mkdir()
    assert "or another result" in refuse("train", "--out", picture, "--plots", plots)
    picture.mkdir()
    line = refuse("train", "--out", tmp_path / "out.yaml", "--plots", plots)
    assert f"--plots '{picture}': is a folder" in line
    (tmp_path / "metadata.yaml").write_text("of a bag")
    assert "lies inside a bag" in refuse("train", "--out", tmp_path / "metadata.yaml")
    line = refuse("train", "--out", plots / "out.yaml", "--plots", tmp_path)
    assert "--plots" in line
    assert "is a bag's folder" in line


@pytest.mark.slow
def test_a_rate_that_is_too_large_is_refused(
    tmp_path: Path, refuse: Refuse, few_robots: None
) -> None:
    line = refuse("train", "--out", tmp_path / "out.yaml", "--rate", 3)
    assert "--rate 3: the loss grew from" in line
    assert line.endswith("expected a smaller rate")


@pytest.mark.slow
def test_pictures_of_sets_are_the_same_every_time(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    from fnn_ekf_ros.reports.membership_figure import draw_membership

    networks = {name: read_membership(name) for name in ("initial", "published")}
    wider = dataclasses.replace(networks["published"], position_unit=1e-3)
    draw_membership(tmp_path / "one.png", networks)
    draw_membership(tmp_path / "two.png", networks)
    draw_membership(tmp_path / "three.png", networks | {"published": wider})
    one, two, three = ((tmp_path / f"{n}.png").read_bytes() for n in ("one", "two", "three"))
    assert one == two
    assert one != three
