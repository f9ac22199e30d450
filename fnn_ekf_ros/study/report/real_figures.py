# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The picture of `study real`: position RMSE from all 25 starts, a heat map for each filter."""

from pathlib import Path

import numpy as np

from fnn_ekf_ros.reports.pictures import new_figure, save, shown_text
from fnn_ekf_ros.study.real_bags import BagResult
from fnn_ekf_ros.study.report.figures import color_bar, heat_map
from fnn_ekf_ros.study.starts import FACTORS

COLORS = "YlOrBr"
"""Name of the color map."""
TICKS = (1.0, 1.2, 1.5, 2.0, 3.0, 4.0)
"""Ticks of the logarithmic color bar of the ratio, which goes from the first to the last."""
MOST_COLUMNS = 3
"""Largest number of heat maps side by side: more are too small to read."""


def draw_real(path: Path, result: BagResult) -> None:
    """Draw a recording's heat maps.

    Args:
        path: the PNG to write.
        result: what the filters came to.
    """
    from matplotlib.colors import LogNorm

    lines = -(-len(result.filters) // MOST_COLUMNS)
    columns = -(-len(result.filters) // lines)
    figure = new_figure(1.6 + 3.8 * columns, 0.8 + 3.9 * lines, fixed_aspect=True)
    panels = figure.subplots(lines, columns, squeeze=False)
    norm = LogNorm(TICKS[0], TICKS[-1])
    best, image = result.reference.position, None
    for panel, each in zip(panels.flat, result.filters, strict=False):
        ratio = each.score.position.reshape(len(FACTORS), len(FACTORS)) / best
        image = heat_map(panel, ratio, COLORS, norm, lambda ratio: _words(ratio, best))
        median, worst = np.median(ratio), np.max(ratio)
        panel.set_title(f"{each.label}: median {median:.2f}, worst {worst:.2f}", fontsize=10)
        panel.set_xlabel("k: variance of R at the start")
    for panel in panels[:, 0]:
        panel.set_ylabel("q: variance of Q at the start")
    for panel in panels.flat[len(result.filters) :]:
        panel.set_visible(False)
    figure.suptitle(
        f"{shown_text(result.label)}: position RMSE [m] from {len(FACTORS) ** 2} starts\n"
        f"(ratio to the best EKF with gate, {_meters(best)} m); q = k = 1: noise of the parameters",
        fontsize=11,
    )
    color_bar(figure, image, panels, TICKS, "ratio")
    save(figure, path)


def _words(ratio: float, best: float) -> str:
    if not np.isfinite(ratio):
        return "lost"
    return f"{_meters(ratio * best)}\n({ratio:.2f})" if ratio < 100.0 else _meters(ratio * best)


def _meters(value: float) -> str:
    """Return a length with three significant digits."""
    return f"{value:.3f}" if value < 1.0 else f"{value:.2f}" if value < 10.0 else f"{value:.1f}"
