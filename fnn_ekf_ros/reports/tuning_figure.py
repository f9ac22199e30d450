# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The picture of `tune`: how well recordings tell each quantity."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from fnn_ekf_ros.core.arrays import FloatArray
from fnn_ekf_ros.reports.pictures import new_figure, save

COLUMNS = 4
"""Panels side by side."""
PANEL_INCH = (2.9, 2.3)
"""Width and height of a panel [inch]."""
LOWEST_NATS = -6.0
"""Lower end of the panels [nats]: far below the end of a 95 % interval."""
INTERVAL_NATS = -1.92
"""Log likelihood at the ends of a 95 % interval, half the quantile of chi-square [nats]."""
BLUE, RED, GRAY = "#0072B2", "#D55E00", "#777777"
"""Colors that are told apart without seeing red or green (Okabe and Ito), and a gray."""


class ProfilePanel(NamedTuple):
    """A panel of the picture.

    Attributes:
        title: name and unit of the quantity.
        values: `(m,)` of the quantity.
        log_likelihood: `(m,)` less its largest value [nats].
        found: the value that was found.
        now: the value in the parameters; None if there is none.
        logarithmic: whether values span orders of magnitude.
    """

    title: str
    values: FloatArray
    log_likelihood: FloatArray
    found: float
    now: float | None
    logarithmic: bool


def draw_profiles(path: Path, title: str, panels: Sequence[ProfilePanel]) -> None:
    """Draw the profiles.

    Args:
        path: PNG to write.
        title: of the picture.
        panels: one for each quantity.

    Raises:
        FnnEkfError: matplotlib is not installed, or the file cannot be written.
    """
    rows = math.ceil(len(panels) / COLUMNS)
    width, height = PANEL_INCH
    figure = new_figure(COLUMNS * width, rows * height + 0.5)
    figure.suptitle(title)
    grid = figure.subplots(rows, COLUMNS, squeeze=False)
    for axes, panel in zip(grid.flat, panels, strict=False):
        axes.plot(panel.values, panel.log_likelihood, color=BLUE)
        axes.axhline(INTERVAL_NATS, color=GRAY, linewidth=0.8, linestyle=":")
        axes.axvline(panel.found, color=BLUE, linewidth=0.8)
        low, high = float(panel.values.min()), float(panel.values.max())
        if panel.now is not None and low <= panel.now <= high:
            axes.axvline(panel.now, color=RED, linewidth=0.8, linestyle="--")
        if panel.logarithmic:
            axes.set_xscale("log")
            axes.minorticks_off()
            ends = panel.values[[0, len(panel.values) // 2, -1]]
            axes.set_xticks(ends, [f"{value:.3g}" for value in ends])
        axes.set_ylim(LOWEST_NATS, 0.5)
        axes.set_title(panel.title, fontsize=9)
    for axes in grid.flat[len(panels) :]:
        axes.set_axis_off()
    for axes in grid[:, 0]:
        axes.set_ylabel("log likelihood [nats]", fontsize=8)
    save(figure, path)
