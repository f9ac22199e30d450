# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The command evaluate, as from a shell, and the three commands in a row."""

import json
import math
import shutil
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import Refuse, Succeed, parameters_of, table_rows

from fnn_ekf_ros import messages
from fnn_ekf_ros.cli import run_command
from fnn_ekf_ros.recordings.bag_files import BagReader
from fnn_ekf_ros.recordings.bag_writer import BagWriter


@pytest.mark.slow
def test_simulate_replay_evaluate(tmp_path: Path, recorded: Path, succeed: Succeed) -> None:
    words = ["--params", parameters_of(recorded)]
    succeed("replay", recorded, tmp_path / "ekf", *words)
    succeed("replay", recorded, tmp_path / "wheels", *words, "--dead-reckoning")
    said = succeed(
        "evaluate", tmp_path / "ekf", tmp_path / "wheels", "--labels", "EKF", "wheels",
        "--json", tmp_path / "scores.json",
    )  # fmt: skip
    scores = json.loads((tmp_path / "scores.json").read_text())
    assert list(scores) == ["EKF", "wheels"]
    rows = table_rows(said)
    assert rows["EKF"][0] == str(scores["EKF"]["count"])
    for column, key in enumerate(("rmse_x", "rmse_y", "rmse_theta", "rmse_position"), start=1):
        assert float(rows["EKF"][column]) == pytest.approx(scores["EKF"][key], abs=6e-5)
    ekf = scores["EKF"]
    assert ekf["count"] > 35
    assert 0.01 < ekf["rmse_position"] < 0.14
    assert ekf["rmse_position"] == pytest.approx(math.hypot(ekf["rmse_x"], ekf["rmse_y"]))
    assert 0.01 < ekf["rmse_theta"] < 0.12
    assert 1.0 < ekf["mean_nees"] < 6.0
    assert scores["wheels"]["rmse_position"] > 2.0 * ekf["rmse_position"]


@pytest.mark.slow
def test_evaluate_agrees_with_a_score_by_hand(
    tmp_path: Path, recorded: Path, succeed: Succeed
) -> None:
    out = tmp_path / "out"
    succeed("replay", recorded, out, "--params", parameters_of(recorded))
    succeed("evaluate", out, "--json", tmp_path / "scores.json")
    (found,) = json.loads((tmp_path / "scores.json").read_text()).values()
    with BagReader(out) as bag:
        truth = {messages.stamp_ns(m): messages.planar_pose(m)
                 for m in map(bag.message, bag.records({"/ground_truth"}))}  # fmt: skip
        odoms = [bag.message(record) for record in bag.records({"/odom"})]
    errors, nees = [], []
    for odom in odoms:  # truth is known at every boundary
        error = messages.planar_pose(odom) - truth[messages.stamp_ns(odom)]
        error[2] = math.remainder(error[2], 2.0 * math.pi)
        errors.append(error)
        P = messages.planar_block(odom.pose.covariance)
        nees.append(error @ np.linalg.inv(P) @ error)
    rmse = np.sqrt(np.mean(np.square(errors), axis=0))
    assert found["count"] == len(odoms)
    for key, value in zip(("rmse_x", "rmse_y", "rmse_theta"), rmse, strict=True):
        assert found[key] == pytest.approx(value, rel=1e-9)
    assert found["mean_nees"] == pytest.approx(np.mean(nees), rel=1e-6)


def test_evaluate_refuses(recorded: Path, refuse: Refuse) -> None:
    line = refuse("evaluate", recorded)
    assert "topic /odom is missing, expected nav_msgs/msg/Odometry; it has /compass, " in line
    line = refuse("evaluate", recorded, "--odom-topic", "/compass")
    assert "topic /compass is of type sensor_msgs/msg/Imu" in line
    words = ["--truth-topic", "/nothing", "--odom-topic", "/ground_truth"]
    line = refuse("evaluate", recorded, *words)
    assert "topic /nothing is missing" in line
    assert "--labels: 2 labels, expected 1" in refuse("evaluate", recorded, "--labels", "a", "b")


def test_evaluate_truth_against_itself_is_without_error(recorded: Path, succeed: Succeed) -> None:
    said = succeed("evaluate", recorded, "--odom-topic", "/ground_truth", "--labels", "truth")
    assert table_rows(said)["truth"][1:] == ["0.0000", "0.0000", "0.0000", "0.0000", "n/a"]


def test_evaluate_of_bags_without_common_time(tmp_path: Path, refuse: Refuse) -> None:
    zeros = np.zeros((6, 6))
    with BagWriter(tmp_path / "bag") as bag:
        for topic, start in (("/odom", 0), ("/ground_truth", 10**12)):
            for number in range(3):
                stamp = start + number * 10**9
                message = messages.odometry_message(
                    stamp, "map", "base_link", np.zeros(3), np.zeros(2), zeros, zeros
                )
                bag.write(topic, message, stamp)
    assert "have no time in common" in refuse("evaluate", tmp_path / "bag")


def test_runs_of_the_same_name_are_all_shown(recorded: Path, run: Callable[..., Any]) -> None:
    words = ["--odom-topic", "/ground_truth"]
    ran = run("evaluate", recorded, recorded, *words)
    assert ran.code == 1 or len(ran.out.splitlines()) == 4


def test_an_odom_that_is_no_number_is_not_passed_over(
    tmp_path: Path, run: Callable[..., Any]
) -> None:
    zeros = np.zeros((6, 6))
    with BagWriter(tmp_path / "bag") as bag:
        for number in range(5):
            for topic, x in (("/odom", math.nan), ("/ground_truth", 1.0)):
                message = messages.odometry_message(
                    number * 10**9, "map", "base_link", np.array([x, 0.0, 0.0]), np.zeros(2),
                    zeros, zeros,
                )  # fmt: skip
                bag.write(topic, message, number * 10**9)
    ran = run("evaluate", tmp_path / "bag")
    assert ran.code == 1 or "nan" in ran.out


@pytest.mark.slow
def test_evaluate_draws(tmp_path: Path, recorded: Path, succeed: Succeed) -> None:
    pytest.importorskip("matplotlib")
    succeed("replay", recorded, tmp_path / "out", "--params", parameters_of(recorded))
    for name in ("one.png", "two.png"):
        succeed("evaluate", tmp_path / "out", "--plot", tmp_path / name)
    assert (tmp_path / "one.png").read_bytes().startswith(b"\x89PNG")
    assert (tmp_path / "one.png").read_bytes() == (tmp_path / "two.png").read_bytes()


def test_evaluate_says_that_matplotlib_is_missing_before_it_writes_anything(
    tmp_path: Path, recorded: Path, refuse: Refuse, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    words = ["--json", tmp_path / "numbers.json", "--plot", tmp_path / "p.png"]
    assert "pictures need matplotlib" in refuse("evaluate", recorded, *words)


@pytest.mark.slow
def test_evaluate_draws_what_is_asked_for(
    tmp_path: Path, recorded: Path, succeed: Succeed, refuse: Refuse, monkeypatch: Any
) -> None:
    pytest.importorskip("matplotlib")
    drawn: list[Any] = []
    monkeypatch.setattr("fnn_ekf_ros.reports.plots.plot_tracks", lambda *given: drawn.append(given))
    words = ["--odom-topic", "/ground_truth", "--truth-bag", recorded, "--labels", "a", "b"]
    words = ["evaluate", recorded, recorded, *words, "--plot", tmp_path / "p.png"]
    said = succeed(*words, "--draw", "b")
    assert set(table_rows(said)) == {"a", "b"}
    succeed(*words)
    succeed(*words, "--highlight", "b", "--fixes-topic", "lrf_pose")
    assert [(list(runs), highlight) for _, runs, highlight in drawn] == [
        (["b"], "b"), (["a", "b"], None), (["a", "b"], "b"),
    ]  # fmt: skip
    with BagReader(recorded) as bag:
        number = bag.topics["/lrf_pose"].message_count
    assert [len(runs["b"].fixes) for _, runs, _ in drawn] == [number, number, number]
    assert "--draw c: expected one of a, b" in refuse(*words, "--draw", "c")
    assert "--highlight a: expected one of b" in refuse(*words, "--draw", "b", "--highlight", "a")


def test_evaluate_refuses_results_before_it_reads_anything(
    tmp_path: Path, recorded: Path, refuse: Refuse
) -> None:
    words = ["evaluate", recorded, "--odom-topic", "/ground_truth"]
    ok, picture = tmp_path / "ok.json", tmp_path / "same.png"
    assert "there is no folder" in refuse(*words, "--json", tmp_path / "no" / "x.json")
    line = refuse(*words, "--plot", tmp_path / "no" / "p.png", "--json", ok)
    assert "--plot" in line
    assert "there is no folder" in line
    line = refuse(*words, "--json", picture, "--plot", picture)
    assert f"--plot '{picture}': is an input or another result" in line
    assert "is a folder" in refuse(*words, "--json", "")
    assert "File name too long" in refuse(*words, "--json", tmp_path / ("x" * 300))


def test_evaluate_replaces_no_recording(tmp_path: Path, recorded: Path, refuse: Refuse) -> None:
    victim = tmp_path / "victim"
    shutil.copytree(recorded, victim)
    words = ["evaluate", victim, "--odom-topic", "/ground_truth"]
    assert "lies inside a bag" in refuse(*words, "--json", victim / "metadata.yaml")
    assert "lies inside a bag" in refuse(*words, "--plot", victim / "new.png")
    (stored,) = victim.glob("*.mcap")
    single = tmp_path / "single.mcap"
    single.write_bytes(stored.read_bytes())
    words = ["--odom-topic", "/ground_truth", "--json", single]
    assert "is an input" in refuse("evaluate", single, *words)
    assert "is an input" in refuse("evaluate", victim, "--truth-bag", single, *words)


def test_fixes_that_are_asked_for_have_to_be_there(
    tmp_path: Path, recorded: Path, refuse: Refuse
) -> None:
    pytest.importorskip("matplotlib")
    words = ["evaluate", recorded, "--odom-topic", "ground_truth", "--json", tmp_path / "x.json"]
    words += ["--plot", tmp_path / "p.png", "--fixes-topic"]
    line = refuse(*words, "nothing")
    assert "topic /nothing is missing, expected geometry_msgs/msg/PoseWithCovarianceSta" in line
    assert "topic /compass is of type sensor_msgs/msg/Imu, expected geo" in refuse(
        *words, "compass"
    )


@pytest.mark.slow
def test_a_recording_without_fixes_has_a_picture(tmp_path: Path, succeed: Succeed) -> None:
    pytest.importorskip("matplotlib")
    claims_of(tmp_path / "bag", [0.1])
    succeed("evaluate", tmp_path / "bag", "--plot", tmp_path / "p.png")
    assert (tmp_path / "p.png").stat().st_size > 10000


def claims_of(path: Path, variances: list[float]) -> None:
    """Write a bag whose odom is 0.1 m beside the truth and claims variances in turn."""
    with BagWriter(path) as bag:
        for number in range(20):
            covariance = np.diag(np.full(6, variances[number % len(variances)]))
            for topic, y in (("/odom", 0.1), ("/ground_truth", 0.0)):
                message = messages.odometry_message(
                    number * 10**9, "map", "base_link", np.array([0.1 * number, y, 0.0]),
                    np.zeros(2), covariance, covariance,
                )  # fmt: skip
                bag.write(topic, message, number * 10**9)


@pytest.mark.parametrize("variance", [math.nan, math.inf, -1.0, 1e300, 1e-320, 1e308])
@pytest.mark.slow
def test_claims_that_make_no_sense_are_no_trouble(
    tmp_path: Path, succeed: Succeed, variance: float
) -> None:
    """Pictures of such claims are tested in `test/reports/test_plots.py`."""
    claims_of(tmp_path / "bag", [0.01, variance])
    words = ["--json", tmp_path / "x.json"]
    said = succeed("evaluate", tmp_path / "bag", "--labels", "run", *words)
    positive = math.isfinite(variance) and variance > 1e-300
    assert table_rows(said)["run"][-1] == ("0.50" if positive else "n/a")


@pytest.mark.slow
def test_labels_in_any_script_and_in_none(tmp_path: Path, succeed: Succeed) -> None:
    pytest.importorskip("matplotlib")
    claims_of(tmp_path / "bag", [0.01])
    words = ["--json", tmp_path / "x.json", "--plot", tmp_path / "p.png", "--highlight", "\udcff"]
    labels = ["\udcff", "\U0001f916 \u8d70"]
    succeed("evaluate", tmp_path / "bag", tmp_path / "bag", *words, "--labels", *labels)
    assert list(json.loads((tmp_path / "x.json").read_text())) == ["\ufffd", labels[1]]
    assert (tmp_path / "p.png").stat().st_size > 10000


@pytest.fixture(scope="module")
def replayed(recorded: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A replay of the recording, with its ground truth."""
    out = tmp_path_factory.mktemp("replayed") / "out"
    words = ["replay", recorded, out, "--params", parameters_of(recorded)]
    assert run_command(words[0], [str(word) for word in words[1:]]) == 0
    return out


@pytest.fixture(scope="module")
def without_truth(replayed: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same without the ground truth."""
    out = tmp_path_factory.mktemp("without_truth") / "out"
    with BagReader(replayed) as bag, BagWriter(out, notes=bag.notes) as copy:
        for record in bag.records(set(bag.topics) - {"/ground_truth"}):
            copy.write_raw(record)
    return out


@pytest.mark.slow
def test_verdicts_are_printed_and_in_the_json(
    tmp_path: Path, replayed: Path, succeed: Succeed
) -> None:
    said = succeed("evaluate", replayed, "--labels", "run", "--json", tmp_path / "x.json")
    found = json.loads((tmp_path / "x.json").read_text())["run"]
    for key, name in (("nees", "NEES"), ("nees_position", "NEES of position"), ("nis", "NIS")):
        (line,) = [line for line in said.splitlines() if line.startswith(f"run: {name}: ")]
        assert found[key]["verdict"] in line
        assert f"{found[key]['mean']:.2f}" in line
        low, high = found[key]["band"]
        assert low < found[key]["expected"] < high
    assert set(found["sensors"]) == {"fixes", "compass"}
    assert found["nees"]["mean"] == pytest.approx(found["mean_nees"])
    assert found["ate"]["rmse"] == found["rmse_position"]
    assert found["rpe"]["delta"] == "1 m"
    assert found["warnings"] == []
    assert found["odom"] == found["count"] > 35
    assert found["corrections"]["max"] >= found["corrections"]["rms"] > 0.0
    assert found["worst_status"]["level"] == 1


@pytest.mark.slow
def test_alignment_undoes_a_motion_and_the_warning_stays(
    tmp_path: Path, replayed: Path, succeed: Succeed
) -> None:
    moved = tmp_path / "moved"
    with BagReader(replayed) as bag, BagWriter(moved) as out:
        for record in bag.records({"/odom", "/ground_truth"}):
            if record.topic == "/odom":
                out.write_raw(record)
                continue
            x, y, yaw = messages.planar_pose(bag.message(record))
            pose = np.array([5.0 - y, 3.0 + x, yaw + 0.5 * math.pi])
            truth = messages.odometry_message(
                messages.stamp_ns(bag.message(record)), "map", "base_link", pose, np.zeros(2),
                np.zeros((6, 6)), np.zeros((6, 6)),
            )  # fmt: skip
            out.write("/ground_truth", truth, record.time_ns)
    plain = table_rows(succeed("evaluate", replayed, "--labels", "run"))["run"]
    said = succeed("evaluate", moved, "--labels", "run")
    assert "another frame or map: odom turned by 1.5" in said
    assert float(table_rows(said)["run"][4]) > 1.0
    aligned = succeed("evaluate", moved, "--labels", "run", "--align", "se2")
    assert float(table_rows(aligned)["run"][4]) <= float(plain[4]) + 1e-4
    assert "another frame or map" in aligned
    origin = table_rows(succeed("evaluate", moved, "--labels", "run", "--align", "origin"))
    assert float(origin["run"][4]) < 1.0


@pytest.mark.slow
def test_tracks_are_written_for_others(tmp_path: Path, replayed: Path, succeed: Succeed) -> None:
    words = ["--labels", "a/b c", "--tum", tmp_path / "tum", "--kitti", tmp_path / "kitti"]
    said = succeed("evaluate", replayed, *words)
    (row,) = [line for line in said.splitlines() if line.startswith("a/b c  ")][:1]
    count = int(row.split()[2])
    tum = (tmp_path / "tum" / "a_b_c_odom.tum").read_text().splitlines()
    with BagReader(replayed) as bag:
        assert len(tum) == bag.topics["/odom"].message_count
        first = bag.message(next(bag.records({"/odom"})))
    assert float(tum[0].split()[0]) == pytest.approx(messages.stamp_ns(first) * 1e-9)
    kitti = [(tmp_path / "kitti" / f"a_b_c_{name}.kitti").read_text() for name in ("odom", "truth")]
    assert [text.count("\n") for text in kitti] == [count, count]
    assert all(len(line.split()) == 12 for text in kitti for line in text.splitlines())


@pytest.mark.slow
def test_a_report_without_a_ground_truth(
    tmp_path: Path, without_truth: Path, succeed: Succeed, refuse: Refuse
) -> None:
    """With one: `test/reports/test_page.py`."""
    pytest.importorskip("matplotlib")
    pytest.importorskip("jinja2")
    assert "topic /ground_truth is missing" in refuse("evaluate", without_truth)
    (tmp_path / "found.json").write_text('["the left wheel is 3 % larger"]')
    words = ["--report", tmp_path / "x.html", "--findings", tmp_path / "found.json"]
    said = succeed("evaluate", without_truth, *words)
    assert "no ground truth (/ground_truth), so no errors" in said
    assert "NIS of fixes" in said
    assert "NEES" not in said
    page = (tmp_path / "x.html").read_text()
    assert "<h2>Uncertainty</h2>" in page
    assert "<td>wheel_separation</td>" in page  # from the bag's metadata
    assert "the left wheel is 3 % larger" in page


def test_reports_that_cannot_be_made_are_refused(
    tmp_path: Path, recorded: Path, refuse: Refuse, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("matplotlib")
    page = tmp_path / "x.html"
    words = ["--odom-topic", "/ground_truth"]
    line = refuse("evaluate", recorded, *words, "--report", tmp_path / "x.txt")
    assert "a name that ends in .html" in line
    line = refuse("evaluate", recorded, recorded, *words, "--labels", "a", "b", "--report", page)
    assert "2 bags, expected one" in line
    assert "expected --report" in refuse("evaluate", recorded, *words, "--findings", "x.json")
    line = refuse("evaluate", recorded, "--report", page, "--truth-topic", "/no")
    assert "topic /odom is missing" in line or "topic /no is missing" in line
    line = refuse("evaluate", recorded, *words, "--tum", recorded / "files")
    assert "is a bag's folder" in line
    assert "--rpe 3k: expected a length" in refuse("evaluate", recorded, *words, "--rpe", "3k")
    same = ["--labels", "a b", "a_b", "--tum", tmp_path / "t"]
    assert "different file names" in refuse("evaluate", recorded, recorded, *words, *same)
    monkeypatch.setitem(sys.modules, "jinja2", None)
    assert "reports need jinja2" in refuse("evaluate", recorded, *words, "--report", page)


def test_a_track_that_stands_still_cannot_be_aligned(tmp_path: Path, refuse: Refuse) -> None:
    with BagWriter(tmp_path / "bag") as bag:
        for number in range(20):
            for topic in ("/odom", "/ground_truth"):
                message = messages.odometry_message(
                    number * 10**9, "map", "base_link", np.zeros(3), np.zeros(2), np.eye(6),
                    np.eye(6),
                )  # fmt: skip
                bag.write(topic, message, number * 10**9)
    assert "stands still" in refuse("evaluate", tmp_path / "bag", "--align", "se2")
