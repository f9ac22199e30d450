# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The map of the report: the track with what it claims, the fixes and the truth."""

from typing import Any

import numpy as np

from fnn_ekf_ros.core.arrays import BoolArray, FloatArray
from fnn_ekf_ros.evaluation.alignment import aligned_track
from fnn_ekf_ros.evaluation.evaluation import Evaluation
from fnn_ekf_ros.recordings.run_record import Fixes, Noise, RunRecord
from fnn_ekf_ros.reports.drawing import legend_below, points, track_line
from fnn_ekf_ros.reports.pictures import new_figure
from fnn_ekf_ros.reports.plots import DIRECTIONS, SIGMAS, credible
from fnn_ekf_ros.reports.svg import COLORS, WIDTH, styled, svg_text
from fnn_ekf_ros.reports.thinning import spread_dots
from fnn_ekf_ros.timeline.trajectory import Trajectory

ELLIPSES = 40
"""Number of ellipses along a track: more of them hide it."""
SMALLEST_ELLIPSE = 0.004
"""Smallest axis of an ellipse that is drawn, as a part of the picture: others are dots."""


def map_figure(run: RunRecord, truth: Trajectory | None, found: Evaluation) -> str:
    """Draw the track with what it claims, the fixes and the truth."""
    track = run.track if found.truth is None else aligned_track(run.track, found.truth.motion)
    with styled():
        low, high = _view(track, truth)
        tall = float(np.clip((high - low)[1] / (high - low)[0], 0.35, 1.15))
        figure = new_figure(WIDTH, 0.9 + (WIDTH - 0.8) * tall)
        axes = figure.subplots()
        if run.fixes is not None:
            _draw_fixes(axes, run.fixes, _rejected_fixes(run.fixes, run.noise))
        if truth is not None:
            track_line(axes, truth.pose[:, 0], truth.pose[:, 1], color=COLORS["truth"], lw=4.0,
                  alpha=0.55, label="ground truth", solid_capstyle="round")  # fmt: skip
        track_line(axes, track.pose[:, 0], track.pose[:, 1], color=COLORS["estimate"], lw=1.2,
              label="odom")  # fmt: skip
        _draw_ellipses(axes, track, float(np.max(high - low)))
        for place, marker, word in ((0, "o", "start"), (-1, "s", "end")):
            axes.plot(*track.pose[place, :2], marker=marker, ms=6, mfc="none", mew=1.6, ls="",
                      color=COLORS["ink"], label=word)  # fmt: skip
        axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal",
                 xlabel="x [m]", ylabel="y [m]")  # fmt: skip
        axes.grid(visible=True)
        axes.set_axisbelow(True)
        legend_below(figure, axes)
        return svg_text(figure, "map")


def _draw_fixes(axes: Any, fixes: Fixes, rejected: BoolArray) -> None:
    for part, color, size, name in (
        (~rejected, "fix", 2.6, "fixes"), (rejected, "bad", 3.4, "rejected fixes"),
    ):  # fmt: skip
        x, y = fixes.pose[part, 0], fixes.pose[part, 1]
        kept = spread_dots(x, y)
        if len(kept):
            points(axes, x[kept], y[kept], COLORS[color], size, label=name, zorder=1.5)


def _rejected_fixes(fixes: Fixes, noise: Noise | None) -> BoolArray:
    """Return which fixes came in a period in which the gate rejected one `(n,)`."""
    if noise is None or not len(noise.time_ns):
        return np.zeros(len(fixes.time_ns), dtype=bool)
    place = np.searchsorted(noise.time_ns, fixes.time_ns, side="left")
    inside = place < len(noise.time_ns)
    flags = noise.get("rejected_lrf_pose")[np.minimum(place, len(noise.time_ns) - 1)] > 0.0
    return np.asarray(inside & flags)


def _draw_ellipses(axes: Any, track: Trajectory, size: float) -> None:
    """Draw ellipses of two standard deviations, evenly along the track."""
    from matplotlib.patches import Polygon

    xy, P = track.pose[:, :2], track.covariance[:, :2, :2]
    driven = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(xy, axis=0).T))])
    places = np.unique(np.searchsorted(driven, np.linspace(0.0, driven[-1], ELLIPSES)))
    angle = np.linspace(0.0, 2.0 * np.pi, DIRECTIONS, endpoint=False)
    circle = np.stack([np.cos(angle), np.sin(angle)])
    label = "2 sigma claimed"
    for place in places:
        variance = np.linalg.eigvalsh(P[place]) if np.all(np.isfinite(P[place])) else np.zeros(2)
        if (
            not np.all(np.isfinite(credible(variance)))
            or SIGMAS * variance[1] ** 0.5 < SMALLEST_ELLIPSE * size
        ):
            continue
        corners = xy[place] + SIGMAS * (np.linalg.cholesky(P[place]) @ circle).T
        axes.add_patch(
            Polygon(corners, fc=COLORS["estimate"], ec=COLORS["estimate"], alpha=0.22, lw=0.6,
                    zorder=1.8, label=label)
        )  # fmt: skip
        label = "_"


def _view(track: Trajectory, truth: Trajectory | None) -> tuple[FloatArray, FloatArray]:
    """Return the corners of the map: all of odom and truth, with a margin."""
    xy = track.pose[:, :2] if truth is None else np.vstack([track.pose[:, :2], truth.pose[:, :2]])
    low, high = np.min(xy, axis=0), np.max(xy, axis=0)
    size = max(float(np.max(high - low)), 0.1)
    center, half = 0.5 * (low + high), np.maximum(0.5 * (high - low), 0.2 * size) + 0.06 * size
    return center - half, center + half
