# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Picture of `study lasting`; needs matplotlib."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from fnn_ekf_ros.reports.pictures import new_figure, save
from fnn_ekf_ros.study.lasting import CASES, KNOWS, LABELS, SIMULATIONS
from fnn_ekf_ros.study.report.figures import line_style, logarithmic
from fnn_ekf_ros.study.report.lasting_tables import CONSISTENT_NEES, LastingRow

FILE = "lasting.png"
"""The picture's file."""
QUANTITIES = ("position RMSE, ratio", "yaw RMSE, ratio", "mean NEES")
"""Quantities of the columns of panels."""


def draw_lasting(out: Path, rows: Sequence[LastingRow]) -> None:
    """Draw ratios and NEES over the whole run, a bar from the best start to the worst."""
    figure = new_figure(14.0, 7.5)
    panels = figure.subplots(len(SIMULATIONS), len(QUANTITIES), squeeze=False)
    others = [name for name in LABELS if name != KNOWS]
    for line, (path, title) in zip(panels, SIMULATIONS.items(), strict=True):
        for place, name in enumerate(others):
            own = {row.case: row for row in rows if (row.path, row.filter) == (path, name)}
            x = np.arange(len(CASES)) + 0.22 * (place - 0.5 * (len(others) - 1))
            for panel, values in zip(line, _values([own[case] for case in CASES]), strict=True):
                _bars(panel, x, values, line_style(name, LABELS))
        for panel, quantity in zip(line, QUANTITIES, strict=True):
            panel.set(title=f"{quantity}, {title}")
            panel.set_xticks(range(len(CASES)), [case.about for case in CASES.values()])
            panel.tick_params(axis="x", labelrotation=30)
            ideal = CONSISTENT_NEES if quantity == QUANTITIES[-1] else 1.0
            panel.axhline(ideal, color="#999999", ls=":")
            logarithmic(panel)
    handles, labels = panels[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncol=len(others), fontsize=9)
    figure.suptitle(
        f"Over the {LABELS[KNOWS]}, whole run: right start (dot), from the best start to the worst",
        fontsize=11,
    )
    save(figure, out / FILE)


def _values(rows: Sequence[LastingRow]) -> list[list[np.ndarray]]:
    """Return for each quantity the values `(cells,)` of each case, over the whole run."""
    return [
        [row.position_ratio.value[0] for row in rows],
        [row.yaw_ratio.value[0] for row in rows],
        [row.nees.value[0] for row in rows],
    ]


def _bars(panel: Any, x: np.ndarray, values: Sequence[np.ndarray], style: dict[str, Any]) -> None:
    """Draw the right start, the first value of each, and the range of all."""
    look = {"color": style["color"], "lw": 2.0}
    panel.vlines(x, [np.min(v) for v in values], [np.max(v) for v in values], **look)
    panel.plot(x, [v[0] for v in values], "o", color=style["color"], ms=5, label=style["label"])
