# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Pictures of results; needs matplotlib."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from fnn_ekf_ros.core.arrays import FloatArray
from fnn_ekf_ros.core.limits import LARGEST_POSITION
from fnn_ekf_ros.recordings.run_record import Fixes
from fnn_ekf_ros.reports.pictures import new_figure, save, shown_text
from fnn_ekf_ros.timeline.trajectory import Trajectory, interpolate, pose_errors

SIGMAS = 2.0
"""Half width of the bands, in the filter's standard deviations."""
CLAIMS = (1e-9, LARGEST_POSITION)
"""Smallest and largest standard deviation that is drawn as a band (m, rad): others are not those of
a pose."""
PLAIN_EXPONENTS = (-5, 8)
"""Powers of ten between which numbers on the axes are written without an exponent."""
DIRECTIONS = 24
"""Number of corners of the polygons that approximate ellipses: the error is below 1 %."""
MOST_ELLIPSES = 3000
"""Largest number of poses around which a band is drawn: more take long and look the same."""
TRUTH_COLOR, FIX_COLOR, HIGHLIGHT_COLOR = "0.2", "0.62", "tab:red"
"""Colors of ground truth, fixes and the highlighted run."""
COLORS = ("tab:blue", "tab:orange", "tab:green", "tab:purple", "tab:brown", "tab:cyan")
"""Colors of the runs that are not highlighted."""
QUIET = {"lw": 1.0, "alpha": 0.65, "zorder": 2.5}
"""Line style of runs beside a highlighted one."""
EQUAL = {"lw": 1.2, "alpha": 1.0, "zorder": 3.0}
"""Line style of runs among which none is highlighted."""
HIGHLIGHTED = {"lw": 1.4, "alpha": 1.0, "zorder": 4.0}
"""Line style of the highlighted run."""
ERROR_QUANTILE, ERROR_ROOM = 0.98, 3.0
"""The error axes reach to so many times this quantile of the errors and claims of the run that
is highlighted, or that is best."""
LEGEND_WIDTH = 150
"""Width of a row of the legend [characters]; a line or marker counts five."""
PANELS = ("x [m]", "y [m]", "heading [rad]")
"""Labels of the error panels."""


class Run(NamedTuple):
    """Run as it is drawn.

    Attributes:
        estimate: its poses.
        truth: the ground truth.
        fixes: `(n, 2)` measured positions [m].
    """

    estimate: Trajectory
    truth: Trajectory
    fixes: FloatArray


def positions(fixes: Fixes | None) -> FloatArray:
    """Return the positions `(n, 2)` of fixes [m]; none where there are none."""
    return np.zeros((0, 2)) if fixes is None else fixes.pose[:, :2]


def plot_tracks(path: Path, runs: Mapping[str, Run], highlight: str | None = None) -> None:
    """Draw tracks and errors as a PNG.

    Args:
        path: the picture's file.
        runs: by name; drawn in the order given.
        highlight: name of the run that is drawn above the others, with the uncertainty it claims.

    Raises:
        FnnEkfError: matplotlib is not installed, or the file cannot be written.
    """
    save(draw_tracks(runs, highlight), path)


def draw_tracks(runs: Mapping[str, Run], highlight: str | None = None) -> Any:
    """Return the figure that `plot_tracks` writes.

    Raises:
        FnnEkfError: matplotlib is not installed.
    """
    errors = {name: _errors(run) for name, run in runs.items()}
    with_yaw = any(np.any(np.isfinite(error[:, 2])) for error in errors.values())
    panel_count = 3 if with_yaw else 2
    figure = new_figure(13.0, 7.5)
    grid = figure.add_gridspec(panel_count, 2, width_ratios=(1.15, 1.0))
    tracks = figure.add_subplot(grid[:, 0])
    panels = [figure.add_subplot(grid[row, 1]) for row in range(panel_count)]
    _draw_tracks(tracks, runs, highlight)
    for axis, axes in enumerate(panels):
        _draw_errors(axes, axis, runs, errors, highlight)
        axes.sharex(panels[0])
        axes.tick_params(labelbottom=axes is panels[-1])
    panels[0].set_title("Error (estimate minus ground truth)")
    panels[-1].set_xlabel("time [s]")
    for axes in (tracks, *panels):
        axes.ticklabel_format(scilimits=PLAIN_EXPONENTS, useOffset=False)
        axes.grid(visible=True, alpha=0.25)
        axes.set_axisbelow(True)
    handles, labels = tracks.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=_columns(labels))
    return figure


def _draw_tracks(axes: Any, runs: Mapping[str, Run], highlight: str | None) -> None:
    """Draw where the robot was, was measured, and was thought to be."""
    shown = [runs[highlight]] if highlight is not None else list(runs.values())
    truths = list({id(run.truth): run for run in runs.values()}.values())
    for index, run in enumerate(truths):
        xy = run.truth.pose[:, :2]
        axes.plot(*xy.T, color=TRUTH_COLOR, lw=3.5, zorder=2.0, label=_once("ground truth", index))
    for index, run in enumerate(run for run in truths if len(run.fixes)):
        axes.plot(
            *run.fixes.T, color=FIX_COLOR, marker=".", ms=3.5, ls="", zorder=1.5,
            label=_once("position fixes", index),
        )  # fmt: skip
    for name, run in runs.items():
        xy = run.estimate.pose[:, :2]
        axes.plot(*xy.T, label=_text(name), **_style(name, runs, highlight))
    if highlight is not None:
        _draw_band(axes, runs[highlight].estimate, highlight)
    for index, run in enumerate(truths):
        for place, marker, word in ((0, "o", "start"), (-1, "s", "end")):
            axes.plot(
                *run.truth.pose[place, :2], color="white", marker=marker, ms=9, mec="black",
                mew=1.8, ls="", zorder=5.0, label=_once(word, index),
            )  # fmt: skip
    low, high = _view(shown, truths, runs)
    axes.set(
        xlabel="x [m]", ylabel="y [m]", xlim=(low[0], high[0]), ylim=(low[1], high[1]),
        aspect="equal", title="Tracks",
    )  # fmt: skip


def _draw_band(axes: Any, estimate: Trajectory, name: str) -> None:
    """Draw the union of the ellipses that a run claims to be in."""
    from matplotlib.patches import PathPatch
    from matplotlib.path import Path as Outline

    polygons = band_polygons(estimate)
    if not len(polygons):
        return
    # One path, filled where any of its polygons is: they all have the same orientation.
    closed = np.concatenate([polygons, polygons[:, :1]], axis=1)
    codes = np.full(closed.shape[:2], Outline.LINETO, dtype=Outline.code_type)
    codes[:, 0], codes[:, -1] = Outline.MOVETO, Outline.CLOSEPOLY
    outline = Outline(closed.reshape(-1, 2), codes.ravel())
    axes.add_patch(
        PathPatch(
            outline, facecolor=HIGHLIGHT_COLOR, alpha=0.25, lw=0.0, zorder=3.5, label=_claim(name)
        )
    )


def band_polygons(estimate: Trajectory) -> FloatArray:
    """Return polygons `(n, corners, 2)` [m] whose union is the band around a track.

    Each is the convex hull of two successive ellipses, counter-clockwise: for every direction d
    the corner of that ellipse which reaches further, c + s P d / sqrt(d' P d).
    """
    stride = -(-len(estimate.time_ns) // MOST_ELLIPSES)
    center, P = estimate.pose[::stride, :2], estimate.covariance[::stride, :2, :2]
    angle = np.linspace(0.0, 2.0 * np.pi, DIRECTIONS, endpoint=False)
    d = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    with np.errstate(all="ignore"):
        spread = credible(np.einsum("ki,nij,kj->nk", d, P, d))
    known = np.all(np.isfinite(spread), axis=1) & np.all(np.isfinite(center), axis=1)
    center, P, std = center[known], P[known], np.sqrt(spread[known])
    corner = center[:, None] + SIGMAS * np.einsum("nij,kj->nki", P, d) / std[..., None]
    reach = center @ d.T + SIGMAS * std
    further = reach[:-1] >= reach[1:]
    successive = np.diff(np.flatnonzero(known)) == 1
    polygons: FloatArray = np.where(further[..., None], corner[:-1], corner[1:])[successive]
    return polygons


def _draw_errors(
    axes: Any,
    axis: int,
    runs: Mapping[str, Run],
    errors: Mapping[str, FloatArray],
    highlight: str | None,
) -> None:
    """Draw one coordinate's errors over time, and the claim of the highlighted run."""
    usual, most = {}, 0.0
    for name, run in runs.items():
        seconds = (run.estimate.time_ns - run.truth.time_ns[0]) * 1e-9
        error = errors[name][:, axis]
        axes.plot(seconds, error, label=_text(name), **_style(name, runs, highlight))
        claim = claimed(run.estimate.covariance, axis)
        if name == highlight:
            axes.fill_between(
                seconds, -claim, claim, color=HIGHLIGHT_COLOR, alpha=0.25, lw=0.0, zorder=3.5,
                label=_claim(name),
            )  # fmt: skip
        usual[name] = _quantile(np.concatenate([np.abs(error), claim]))
        most = max(
            most,
            1.3 * usual[name],
            1.1 * np.max(np.abs(error), initial=0.0, where=np.isfinite(error)),
        )
    axes.axhline(0.0, color=TRUTH_COLOR, lw=1.0, zorder=2.0)
    axes.set_ylabel(PANELS[axis])
    best = usual[highlight] if highlight is not None else np.min(list(usual.values()))
    if np.isfinite(best) and best > CLAIMS[0]:
        limit = min(ERROR_ROOM * best, most)
        axes.set_ylim(-limit, limit)


def _errors(run: Run) -> FloatArray:
    """Return estimate minus truth `(n, 3)`; NaN where truth is not known."""
    return pose_errors(run.estimate.pose, interpolate(run.truth, run.estimate.time_ns))


def claimed(covariance: FloatArray, axis: int) -> FloatArray:
    """Return the half width of a coordinate's band `(n,)`; NaN where nothing is claimed."""
    return SIGMAS * np.sqrt(credible(covariance[:, axis, axis]))


def credible(variance: FloatArray) -> FloatArray:
    """Return variances, NaN in place of those that are outside of `CLAIMS`."""
    low, high = np.square(CLAIMS)
    found: FloatArray = np.where((variance >= low) & (variance <= high), variance, np.nan)
    return found


def _quantile(values: FloatArray) -> float:
    known = values[np.isfinite(values)]
    return float(np.quantile(known, ERROR_QUANTILE)) if len(known) else np.inf


def _view(
    shown: list[Run], truths: list[Run], runs: Mapping[str, Run]
) -> tuple[FloatArray, FloatArray]:
    """Return the corners of the picture: truth, and what does not leave it for good."""
    span = np.concatenate([run.truth.pose[:, :2] for run in truths])
    size, center = np.max(np.ptp(span, axis=0)), np.mean(span, axis=0)
    for run in shown:
        xy = run.estimate.pose[:, :2]
        xy = xy[np.all(np.isfinite(xy), axis=1)]
        if np.all(np.abs(xy - center) < 1.5 * size) or len(runs) == 1:
            span = np.concatenate([span, xy])
    low, high = np.min(span, axis=0), np.max(span, axis=0)
    margin = 0.1 * max(float(np.max(high - low)), 0.1)
    return low - margin, high + margin


def _columns(labels: list[str]) -> int:
    """Return the columns of a legend: as many as have room, in rows of similar length."""
    room = max(1, LEGEND_WIDTH // (max(map(len, labels)) + 5))
    rows = -(-len(labels) // room)
    return -(-len(labels) // rows)


def _style(name: str, runs: Mapping[str, Run], highlight: str | None) -> dict[str, Any]:
    if name == highlight:
        return {"color": HIGHLIGHT_COLOR, **HIGHLIGHTED}
    index = [other for other in runs if other != highlight].index(name)
    color = COLORS[index % len(COLORS)]
    if highlight is not None:
        return {"color": color, **QUIET}
    return {"color": color, "ls": ("-", "--")[index % 2], **EQUAL}  # both of two alike are seen


def _text(name: str) -> str:
    """Return a name as a legend shows it: matplotlib hides those that begin with `_`."""
    escaped = shown_text(name)
    return f" {escaped}" if escaped.startswith("_") else escaped


def _claim(name: str) -> str:
    return _text(f"{SIGMAS:g} sigma claimed by {name}")


def _once(label: str, index: int) -> str:
    """Return a label that only the first of several has in the legend."""
    return f"_{label}" if index else label
