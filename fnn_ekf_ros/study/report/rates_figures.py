# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Picture of `study rates`; needs matplotlib."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from fnn_ekf_ros.core.pace import NOMINAL_PERIOD_S
from fnn_ekf_ros.reports.pictures import new_figure, save
from fnn_ekf_ros.study.rates import COMPASS_RATE, FIX_RATE, LARGEST_RATIO, PHASES
from fnn_ekf_ros.study.report.rates_tables import PeriodRow, RateRow

FILE = "rates.png"
"""The picture's file."""
_COLORS = dict(zip(PHASES, ("#0072B2", "#D55E00"), strict=True))
"""Colors by phases."""
_AXES = (("position", "m"), ("yaw", "rad"))
"""Quantities of the two rows of panels, and their units."""


def draw_rates(out: Path, periods: Sequence[PeriodRow], rates: Sequence[RateRow]) -> None:
    """Draw RMSE over the period and, of joint adaptation, over the oracle's, by period and rate."""
    figure = new_figure(12.0, 6.5)
    panels = figure.subplots(2, 3)
    at_rate = [row for row in rates if _rates(row) == (FIX_RATE, COMPASS_RATE)]
    at_period = sorted(
        (
            row
            for row in rates
            if row.case.period_s == NOMINAL_PERIOD_S
            and row.case.timing.compass_rate == COMPASS_RATE
        ),
        key=lambda row: row.case.timing.fix_rate,
    )
    for axis, (name, unit) in enumerate(_AXES):
        left, middle, right = panels[axis]
        for phases, color in _COLORS.items():
            own = [row for row in periods if row.phases == phases]
            x = [row.period_s for row in own]
            left.plot(
                x, [row.rmse[axis] for row in own], "o-", color=color, label=f"none, {phases}"
            )
            left.plot(
                x, [row.plain_rmse[axis] for row in own],
                "--", color=color, label=f"independent EKF, {phases}",
            )  # fmt: skip
            by_period = [row for row in at_rate if row.case.phases == phases]
            by_rate = [row for row in at_period if row.case.phases == phases]
            style = {"color": color, "label": phases}
            middle.plot(
                [row.case.period_s for row in by_period],
                [row.worst_ratio[axis] for row in by_period],
                "o-",
                **style,
            )
            right.plot(
                [row.case.timing.fix_rate for row in by_rate],
                [row.worst_ratio[axis] for row in by_rate], "o-", **style,
            )  # fmt: skip
        left.set(
            ylabel=f"{name} RMSE [{unit}]", ylim=(0.0, 1.3 * max(row.rmse[axis] for row in periods))
        )
        for panel in (middle, right):
            panel.axhline(LARGEST_RATIO, color="#999999", ls=":", label="bar")
            panel.set(ylabel=f"{name}, ratio")
        for panel in (left, middle, right):
            panel.set_xscale("log")
            panel.grid(visible=True, alpha=0.25)
    _finish(panels)
    save(figure, out / FILE)


def _finish(panels: Any) -> None:
    titles = (
        "right noise, no adaptation",
        f"joint, worst start over the oracle; fixes {FIX_RATE:g} Hz",
        f"joint, worst start over the oracle; period {NOMINAL_PERIOD_S:g} s",
    )
    for panel, title, x in zip(
        panels[0], titles, ("period [s]", "period [s]", "fixes [Hz]"), strict=True
    ):
        panel.set_title(title, fontsize=10)
        panel.legend(fontsize=8)
        panel.set_xlabel(x)
    for panel, x in zip(panels[1], ("period [s]", "period [s]", "fixes [Hz]"), strict=True):
        panel.set_xlabel(x)


def _rates(row: RateRow) -> tuple[float, float]:
    return row.case.timing.fix_rate, row.case.timing.compass_rate
