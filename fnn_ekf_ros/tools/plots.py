"""Pictures of results; needs matplotlib."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from fnn_ekf_ros.core.angles import wrap_angle
from fnn_ekf_ros.core.arrays import FloatArray
from fnn_ekf_ros.errors import FnnEkfError
from fnn_ekf_ros.tools.scoring import Track, interpolate

RMS_WINDOW_S = 20.0
"""Errors are drawn as their root mean square over so much time before [s]."""


def plot_tracks(path: Path, runs: Mapping[str, tuple[Track, Track]]) -> None:
    """Draw the tracks, and the running RMS of position and heading errors, as a PNG.

    Args:
        path: the picture's file.
        runs: estimate and truth by name, drawn in the order given; truths in black.

    Raises:
        FnnEkfError: matplotlib is not installed, or the file cannot be written.
    """
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError:
        raise FnnEkfError("pictures need matplotlib: install it, or fnn_ekf_ros[tools]") from None
    figure = Figure(figsize=(13, 7), layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.add_gridspec(2, 2, width_ratios=(1.25, 1.0))
    tracks = figure.add_subplot(grid[:, 0])
    position = figure.add_subplot(grid[0, 1])
    heading = figure.add_subplot(grid[1, 1], sharex=position)

    truths = {id(truth): truth for _, truth in runs.values()}
    for index, truth in enumerate(truths.values()):
        label = "_ground truth" if index else "ground truth"  # one entry in the legend
        tracks.plot(truth.pose[:, 0], truth.pose[:, 1], color="black", lw=2.5, label=label)
    span = np.concatenate([truth.pose[:, :2] for truth in truths.values()])
    size, centre = np.max(np.ptp(span, axis=0)), np.mean(span, axis=0)
    for index, (name, (estimate, truth)) in enumerate(runs.items()):
        style: dict[str, Any] = {
            "color": f"C{index}",
            "ls": ("-", "--")[index % 2],  # runs that lie on each other can both be seen
            "lw": 1.3,
            "label": name.replace("$", r"\$"),
        }
        tracks.plot(estimate.pose[:, 0], estimate.pose[:, 1], **style)
        error = estimate.pose - interpolate(truth, estimate.time_ns)
        seconds = (estimate.time_ns - truth.time_ns[0]) * 1e-9
        distance = np.hypot(error[:, 0], error[:, 1])
        position.plot(seconds, _running_rms(distance, seconds), **style)
        turn = np.degrees(wrap_angle(error[:, 2]))
        heading.plot(seconds, _running_rms(turn, seconds), **style)
        # A run that leaves the picture for good must not shrink the rest.
        if np.all(np.abs(estimate.pose[:, :2] - centre) < 1.5 * size):
            span = np.concatenate([span, estimate.pose[:, :2]])
    margin = 0.08 * np.max(np.ptp(span, axis=0))
    low, high = np.min(span, axis=0) - margin, np.max(span, axis=0) + margin
    tracks.set(
        xlabel="x [m]", ylabel="y [m]", xlim=(low[0], high[0]), ylim=(low[1], high[1]),
        aspect="equal", title="Tracks",
    )  # fmt: skip
    tracks.legend(loc="best", fontsize="small")
    title = f"RMS error of the last {RMS_WINDOW_S:g} s"
    position.set(ylabel="position [m]", yscale="log", title=title)
    heading.set(xlabel="time [s]", ylabel="heading [deg]", yscale="log")
    for axes in (tracks, position, heading):
        axes.grid(visible=True, which="both", alpha=0.25)
    try:
        figure.savefig(path, dpi=110, metadata={"Software": None})
    except (OSError, ValueError) as error:
        raise FnnEkfError(f"'{path}' cannot be written: {error}") from None


def _running_rms(error: FloatArray, seconds: FloatArray) -> FloatArray:
    """Return the root mean square of the errors in the window before each; gaps are left out."""
    known = np.isfinite(error)
    sums = np.concatenate([[0.0], np.cumsum(np.where(known, error, 0.0) ** 2)])
    counts = np.concatenate([[0], np.cumsum(known)])
    first = np.searchsorted(seconds, seconds - RMS_WINDOW_S)
    after = np.arange(1, len(error) + 1)
    number = counts[after] - counts[first]
    mean = (sums[after] - sums[first]) / np.maximum(number, 1)
    return np.where(number > 0, np.sqrt(mean), np.nan)
