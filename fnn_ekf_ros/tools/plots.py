"""Pictures of results; needs matplotlib."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from fnn_ekf_ros.core.angles import wrap_angle
from fnn_ekf_ros.errors import FnnEkfError
from fnn_ekf_ros.tools.scoring import Track, interpolate


def plot_tracks(path: Path, truth: Track, estimates: Mapping[str, Track]) -> None:
    """Draw the tracks, and position and heading errors over time, as a PNG.

    Args:
        path: the picture's file.
        truth: drawn in black.
        estimates: by name, drawn in the order given.

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

    span = np.concatenate([truth.pose[:, :2], *(e.pose[:, :2] for e in _near(truth, estimates))])
    begin_ns = truth.time_ns[0]
    tracks.plot(truth.pose[:, 0], truth.pose[:, 1], color="black", lw=2.0, label="ground truth")
    for index, (name, estimate) in enumerate(estimates.items()):
        style: dict[str, Any] = {"color": f"C{index}", "lw": 1.0, "label": name}
        tracks.plot(estimate.pose[:, 0], estimate.pose[:, 1], **style)
        error = estimate.pose - interpolate(truth, estimate.time_ns)
        seconds = (estimate.time_ns - begin_ns) * 1e-9
        position.plot(seconds, np.hypot(error[:, 0], error[:, 1]), **style)
        heading.plot(seconds, np.degrees(np.abs(wrap_angle(error[:, 2]))), **style)
    margin = 0.08 * np.max(np.ptp(span, axis=0))
    low, high = np.min(span, axis=0) - margin, np.max(span, axis=0) + margin
    tracks.set(
        xlabel="x [m]", ylabel="y [m]", xlim=(low[0], high[0]), ylim=(low[1], high[1]),
        aspect="equal", title="Tracks",
    )  # fmt: skip
    tracks.legend(loc="best", fontsize="small")
    position.set(ylabel="position error [m]", yscale="log", title="Errors (logarithmic)")
    heading.set(xlabel="time [s]", ylabel="heading error [deg]", yscale="log")
    for axes in (tracks, position, heading):
        axes.grid(visible=True, alpha=0.3)
    try:
        figure.savefig(path, dpi=110, metadata={"Software": None})
    except OSError as error:
        raise FnnEkfError(f"'{path}' cannot be written: {error.strerror}") from None


def _near(truth: Track, estimates: Mapping[str, Track]) -> list[Track]:
    """Return the estimates that do not run so far away that they would shrink the rest."""
    size = np.max(np.ptp(truth.pose[:, :2], axis=0))
    centre = np.mean(truth.pose[:, :2], axis=0)
    return [e for e in estimates.values() if np.all(np.abs(e.pose[:, :2] - centre) < 1.5 * size)]
