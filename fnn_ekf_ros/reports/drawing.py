# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""What the pictures of the report are drawn with: clock, curves, dots, axes, legends."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fnn_ekf_ros.core.arrays import FloatArray
from fnn_ekf_ros.reports.plots import CLAIMS
from fnn_ekf_ros.reports.svg import COLORS, svg_text
from fnn_ekf_ros.reports.thinning import extremes, spread_series
from fnn_ekf_ros.timeline.trajectory import Trajectory

LONG_S = 900.0
"""Length of a run from which time is shown in minutes [s]."""
ROOM = 1.6
"""Height of the error axes in multiples of the 99.5 % quantile of errors and bands: single larger
ones are cut off, and the caption has the largest."""


class Clock(NamedTuple):
    """Time of the pictures: from the first odom on, in seconds or minutes.

    Attributes:
        start_ns: of the first odom [ns].
        unit_s: length of a unit [s].
    """

    start_ns: int
    unit_s: float

    @classmethod
    def of(cls, track: Trajectory) -> "Clock":
        """Return the clock of a track."""
        duration_s = (track.time_ns[-1] - track.time_ns[0]) * 1e-9
        return cls(int(track.time_ns[0]), 60.0 if duration_s > LONG_S else 1.0)

    def __call__(self, time_ns: NDArray[np.int64]) -> FloatArray:
        """Return times [ns] in units since the first odom."""
        return np.asarray((time_ns - self.start_ns) * 1e-9 / self.unit_s, dtype=np.float64)

    @property
    def label(self) -> str:
        """Label of the time axis."""
        return "time [min]" if self.unit_s > 1.0 else "time [s]"


def curve(axes: Any, time: FloatArray, values: FloatArray, color: str, name: str) -> None:
    """Draw values over time in a color of the page."""
    kept = extremes(values)
    axes.plot(time[kept], values[kept], color=COLORS[color], lw=1.2, label=name)


def track_line(axes: Any, x: FloatArray, y: FloatArray, **style: Any) -> None:
    """Draw a track: the extremes of both coordinates and of both diagonals."""
    kept = extremes(x, y, x + y, x - y)
    axes.plot(x[kept], y[kept], **style)


def dots(axes: Any, x: FloatArray, y: FloatArray, color: str, name: str) -> None:
    """Draw dots as one path of points, a third of what markers take."""
    kept = spread_series(x, y)
    if len(kept):
        points(axes, x[kept], y[kept], COLORS[color], 2.4, label=name)


def points(axes: Any, x: FloatArray, y: FloatArray, color: str, size: float, **style: Any) -> None:
    """Draw round points: lines of no length with round ends."""
    from matplotlib.patches import PathPatch
    from matplotlib.path import Path

    ends = np.repeat(np.stack([x, y], axis=1), 2, axis=0)
    codes = np.tile([Path.MOVETO, Path.LINETO], len(x))
    path = Path(ends, codes)
    path.should_simplify = False
    zorder = style.pop("zorder", 2.0)
    axes.add_patch(PathPatch(path, fc="none", ec=color, lw=size, capstyle="round", zorder=zorder))
    axes.plot([], [], marker="o", ms=1.6 * size, mew=0.0, ls="", color=color, **style)
    axes.update_datalim(ends)
    axes.autoscale_view()


def plain_log(axes: Any) -> None:
    """Write the numbers of a logarithmic axis without exponents."""
    from matplotlib.ticker import FuncFormatter, LogLocator

    low, high = axes.get_ylim()
    decades = np.log10(high / low)
    subs: Sequence[float] = (
        (1.0, 2.0, 5.0) if decades < 1.8 else (1.0, 3.0) if decades < 3.0 else (1.0,)
    )
    axes.yaxis.set_major_locator(LogLocator(subs=subs))
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.yaxis.set_minor_formatter(FuncFormatter(lambda *_: ""))


def limit_to_usual(axes: Any, *curves: FloatArray) -> None:
    """Make room for what is usual, so that a single wild value does not flatten the rest."""
    values = np.abs(np.concatenate(curves))
    values = values[np.isfinite(values)]
    if not len(values):
        return
    reach = min(ROOM * float(np.quantile(values, 0.995)), 1.1 * float(np.max(values)))
    if reach > CLAIMS[0]:
        axes.set_ylim(-reach, reach)


def legend_above(axes: Any) -> None:
    """Put the legend of a panel above it, where it hides no curve."""
    axes.legend(loc="lower right", bbox_to_anchor=(1.0, 0.97), ncols=3, borderaxespad=0.0,
                handlelength=1.4, columnspacing=1.2)  # fmt: skip


def legend_below(figure: Any, axes: Any) -> None:
    """Put the legend of some axes below the whole figure."""
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=3)


def finished(figure: Any, all_axes: list[Any], clock: Clock, title: str) -> str:
    """Return a figure of panels with one legend and one time axis."""
    all_axes[-1].set_xlabel(clock.label)
    legend_below(figure, all_axes[0])
    return svg_text(figure, title)
