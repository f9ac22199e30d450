# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""What the picture of `evaluate` shows: artists, ranges and labels."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fnn_ekf_ros.timeline.trajectory import Trajectory

pytest.importorskip("matplotlib")
from fnn_ekf_ros.reports.plots import HIGHLIGHT_COLOR, Run, band_polygons, draw_tracks, plot_tracks

STD = 0.05
CLAIM = "2 sigma claimed by hero"


def square_drive(error: float = 0.0, std: float = STD, number: int = 101) -> Trajectory:
    """Return a drive of 50 s around a square of 5 m, off by an error in x [m]."""
    time_s = np.linspace(0.0, 50.0, number)
    side, part = np.divmod(time_s / 10.0, 1.0)
    corners = np.array([[0.0, 0.0], [5.0, 0.0], [5.0, 5.0], [0.0, 5.0]])[side.astype(int) % 4]
    ways = 5.0 * np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]])[side.astype(int) % 4]
    xy = corners + part[:, None] * ways + np.array([error, 0.0])
    pose = np.column_stack([xy, np.zeros(number)])
    covariance = np.tile(std**2 * np.eye(3), (number, 1, 1))
    return Trajectory(np.round(time_s * 1e9).astype(np.int64), pose, covariance)


TRUTH = square_drive()
FIXES = TRUTH.pose[::4, :2] + 0.1
NO_FIXES = np.zeros((0, 2))


def run(estimate: Trajectory, truth: Trajectory = TRUTH, fixes: Any = FIXES) -> Run:
    return Run(estimate, truth, fixes)


def lines(axes: Any) -> dict[str, Any]:
    return {line.get_label(): line for line in axes.get_lines()}


def legend(figure: Any) -> list[str]:
    (found,) = figure.legends
    return [text.get_text() for text in found.get_texts()]


def test_the_highlighted_run_is_above_the_others_with_its_band() -> None:
    runs = {"lost": run(square_drive(9.0)), "hero": run(square_drive(0.03)),
            "EKF": run(square_drive(0.2))}  # fmt: skip
    figure = draw_tracks(runs, "hero")
    tracks, *panels = figure.axes
    assert [axes.get_ylabel() for axes in panels] == ["x [m]", "y [m]", "heading [rad]"]
    assert legend(figure) == [
        "ground truth", "position fixes", "lost", "hero", "EKF", CLAIM, "start", "end",
    ]  # fmt: skip
    for axes in figure.axes:
        hero = lines(axes)["hero"]
        others = [line for name, line in lines(axes).items() if name in ("lost", "EKF")]
        assert len(others) == 2
        for other in others:
            assert hero.get_zorder() > other.get_zorder()
            assert hero.get_linewidth() > other.get_linewidth()
            assert hero.get_color() == HIGHLIGHT_COLOR != other.get_color()
    assert [patch.get_label() for patch in tracks.patches] == [CLAIM]
    for axes in panels:
        (band,) = axes.collections
        heights = band.get_paths()[0].vertices[:, 1]
        assert (heights.min(), heights.max()) == pytest.approx((-2.0 * STD, 2.0 * STD))
    np.testing.assert_allclose(lines(panels[0])["hero"].get_ydata(), 0.03, atol=1e-12)


def test_start_and_end_are_those_of_the_truth() -> None:
    (tracks, *_) = draw_tracks({"hero": run(square_drive(0.1))}).axes
    for word, place in (("start", 0), ("end", -1)):
        assert np.ravel(lines(tracks)[word].get_xydata()) == pytest.approx(TRUTH.pose[place, :2])


def test_nothing_but_truth_and_the_highlighted_run_sets_the_scale() -> None:
    runs = {"hero": run(square_drive(0.03)), "lost": run(square_drive(9.0))}
    tracks, x_error, *_ = draw_tracks(runs, "hero").axes
    assert -1.0 < tracks.get_xlim()[0] < 0.0
    assert 5.0 < tracks.get_xlim()[1] < 6.0
    assert 0.1 < x_error.get_ylim()[1] < 1.0
    assert x_error.get_ylim()[0] == -x_error.get_ylim()[1]


def test_without_a_highlight_runs_are_alike_and_one_that_is_lost_does_not_shrink_the_rest() -> None:
    runs = {name: run(square_drive(error)) for name, error in (("a", 0.05), ("b", 1.0), ("c", 90))}
    figure = draw_tracks(runs)
    tracks, x_error, *_ = figure.axes
    assert len({line.get_linewidth() for n, line in lines(tracks).items() if n in runs}) == 1
    assert len({line.get_color() for n, line in lines(tracks).items() if n in runs}) == 3
    assert not tracks.patches
    assert not x_error.collections
    assert legend(figure) == ["ground truth", "position fixes", "a", "b", "c", "start", "end"]
    assert 6.0 < tracks.get_xlim()[1] < 8.0  # a run that is off is in the picture
    assert 0.1 < x_error.get_ylim()[1] < 1.0


def test_a_single_run_is_in_the_picture_wherever_it_is() -> None:
    tracks, x_error, *_ = draw_tracks({"lost": run(square_drive(90.0))}, "lost").axes
    assert tracks.get_xlim()[1] > 95.0
    assert x_error.get_ylim()[1] > 90.0


def test_truth_that_several_runs_share_is_drawn_once_and_others_each() -> None:
    other = square_drive(1.0)
    runs = {"a": run(square_drive(0.1)), "b": run(square_drive(0.2)),
            "c": run(square_drive(1.1), other, NO_FIXES)}  # fmt: skip
    figure = draw_tracks(runs)
    labels = [line.get_label() for line in figure.axes[0].get_lines()]
    assert labels.count("ground truth") == labels.count("_ground truth") == 1
    assert [label for label in labels if "fixes" in label] == ["position fixes"]
    assert legend(figure).count("ground truth") == 1


def test_without_yaw_in_the_truth_there_is_no_heading() -> None:
    pose = TRUTH.pose.copy()
    pose[:, 2] = math.nan
    truth = Trajectory(TRUTH.time_ns, pose, TRUTH.covariance)
    _, *panels = draw_tracks({"hero": run(square_drive(0.1), truth)}, "hero").axes
    assert [axes.get_ylabel() for axes in panels] == ["x [m]", "y [m]"]
    assert panels[-1].get_xlabel() == "time [s]"


def test_without_fixes_none_are_in_the_legend() -> None:
    figure = draw_tracks({"hero": run(square_drive(0.1), fixes=NO_FIXES)}, "hero")
    assert "position fixes" not in legend(figure)


@pytest.mark.parametrize("variance", [0.0, math.nan, -1.0, math.inf, 1e308, 1e300, 1e-320])
@pytest.mark.slow
def test_a_run_that_claims_nothing_has_no_band(variance: float, tmp_path: Path) -> None:
    silent = square_drive(0.1)
    silent = silent.__class__(silent.time_ns, silent.pose, np.full((101, 3, 3), variance))
    figure = draw_tracks({"hero": run(silent)}, "hero")
    assert not figure.axes[0].patches
    assert 0.1 < figure.axes[1].get_ylim()[1] < 0.5
    plot_tracks(tmp_path / "p.png", {"hero": run(silent)}, "hero")
    assert (tmp_path / "p.png").stat().st_size > 10000


def test_there_is_no_band_where_a_claim_is_far_from_the_errors() -> None:
    claims = square_drive(0.1)
    claims.covariance[40:60] = 1e300 * np.eye(3)
    figure = draw_tracks({"hero": run(claims)}, "hero")
    assert figure.axes[1].get_ylim()[1] < 0.5
    assert len(band_polygons(claims)) == 39 + 40
    assert np.max(np.abs(band_polygons(claims))) < 6.0


@pytest.mark.slow
def test_errors_of_extreme_size_have_short_labels(tmp_path: Path) -> None:
    far = square_drive(9e7)
    figure = draw_tracks({"hero": run(far)}, "hero")
    figure.canvas.draw()
    assert max(len(label.get_text()) for label in figure.axes[1].get_yticklabels()) < 12
    tiny = square_drive()
    tiny.pose[:, 0] += 1e-12
    plot_tracks(tmp_path / "p.png", {"hero": run(tiny)}, "hero")


def test_gaps_and_values_that_are_no_numbers_are_left_out(tmp_path: Path) -> None:
    estimate, pose = square_drive(0.1), TRUTH.pose.copy()
    estimate.pose[10:20] = math.nan
    keep = np.r_[0:40, 60:101]
    truth = Trajectory(TRUTH.time_ns[keep], pose[keep], TRUTH.covariance[keep])
    runs = {"hero": run(estimate, truth, np.array([[math.nan, 1.0], [1.0, 1.0]]))}
    figure = draw_tracks(runs, "hero")
    error = lines(figure.axes[1])["hero"].get_ydata()
    assert set(np.flatnonzero(np.isnan(error))) == {*range(10, 20), *range(40, 61)}
    assert np.all(np.isfinite([axes.get_ylim() for axes in figure.axes]))
    plot_tracks(tmp_path / "p.png", runs, "hero")


def test_a_robot_that_stands_has_a_picture(tmp_path: Path) -> None:
    stands = Trajectory(TRUTH.time_ns, np.zeros((101, 3)), np.zeros((101, 3, 3)))
    (tracks, *_) = draw_tracks({"hero": run(stands, stands, NO_FIXES)}, "hero").axes
    assert tracks.get_xlim()[0] < 0.0 < tracks.get_xlim()[1]
    plot_tracks(tmp_path / "p.png", {"hero": run(stands, stands, NO_FIXES)}, "hero")


def test_names_are_shown_as_they_are() -> None:
    figure = draw_tracks({"_a": run(square_drive(0.1)), "$x": run(square_drive(0.2))})
    assert " _a" in legend(figure)
    assert r"\$x" in legend(figure)


def test_names_that_are_no_text_and_have_no_glyphs(tmp_path: Path) -> None:
    runs = {"\udcff": run(square_drive(0.1)), "\U0001f916": run(square_drive(0.2))}
    plot_tracks(tmp_path / "p.png", runs, "\udcff")
    assert (tmp_path / "p.png").stat().st_size > 10000
    assert "\ufffd" in legend(draw_tracks(runs))


@pytest.mark.parametrize("size", [1e-4, 1.0, 1e6])
@pytest.mark.slow
def test_numbers_on_the_axes_are_plain(size: float) -> None:
    truth = square_drive()
    scaled = [
        Trajectory(t.time_ns, t.pose * size + 1e5, t.covariance) for t in (truth, square_drive())
    ]
    figure = draw_tracks({"hero": run(*scaled, NO_FIXES)}, "hero")
    figure.canvas.draw()
    for axes in figure.axes:
        for axis in (axes.xaxis, axes.yaxis):
            assert axis.get_offset_text().get_text() == ""
            for label in axis.get_ticklabels():
                float(label.get_text().replace("\N{MINUS SIGN}", "-"))


def test_the_band_is_the_union_of_the_ellipses() -> None:
    """Along a line with a known covariance: 2 sigma to each side, and beyond both ends."""
    P = np.array([[0.04, 0.01, 0.0], [0.01, 0.09, 0.0], [0.0, 0.0, 1.0]])
    pose = np.column_stack([np.linspace(0.0, 9.0, 10), np.zeros(10), np.zeros(10)])
    polygons = band_polygons(Trajectory(np.arange(10), pose, np.tile(P, (10, 1, 1))))
    assert polygons.shape == (9, 24, 2)
    assert np.min(polygons[..., 0]) == pytest.approx(-0.4)
    assert np.max(polygons[..., 0]) == pytest.approx(9.4)
    assert np.max(np.abs(polygons[..., 1])) == pytest.approx(0.6)
    x, y = polygons[..., 0], polygons[..., 1]
    area = 0.5 * np.sum(x * np.roll(y, -1, axis=1) - np.roll(x, -1, axis=1) * y, axis=1)
    assert np.all(area > 0.0)  # counter-clockwise
    for first, second, hull in zip(pose, pose[1:], polygons, strict=False):
        for center in (first, second):  # inside of each of its edges
            edge = np.roll(hull, -1, axis=0) - hull
            to_center = center[:2] - hull
            assert np.all(edge[:, 0] * to_center[:, 1] - edge[:, 1] * to_center[:, 0] >= -1e-12)
