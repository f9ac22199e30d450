# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Pictures of the studies; needs matplotlib. Colors are those of Okabe and Ito."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from fnn_ekf_ros.core.arrays import FloatArray
from fnn_ekf_ros.core.pace import NOMINAL_PERIOD_S
from fnn_ekf_ros.reports.pictures import new_figure, save
from fnn_ekf_ros.study import dynamic, grid
from fnn_ekf_ros.study.filters import ORACLE
from fnn_ekf_ros.study.report.tables import AXES, Labels, factor_words, range_words, start_words
from fnn_ekf_ros.study.scenarios import event_steps
from fnn_ekf_ros.study.starts import FACTORS, Cell
from fnn_ekf_ros.study.trials import Outcome

SMOOTHED_STEPS = 8
"""Number of steps over which RMS errors over time are averaged, 3 s."""
START_NOTE = "Q, R x 25: the filter starts with a variance of Q, R 25 times the true one"
"""Explains the names of the starts."""
ERROR_UNITS = {"position": "m", "x": "m", "y": "m", "theta": "rad"}
"""Units of the axes of an error, as tables and figures call them."""
_LUMINANCE = (0.2126, 0.7152, 0.0722)
"""Weights of red, green and blue in the relative luminance (ITU-R BT.709)."""
_STYLES: dict[str, tuple[str, str]] = {
    ORACLE: ("#000000", ":"),
    "dead_reckoning": ("#999999", "-."),
    "ekf": ("#E69F00", "-"),
    "ekf_gated": ("#E69F00", "--"),
    "rq_published": ("#0072B2", "-"),
    "r_published": ("#0072B2", "--"),
    "q_published": ("#0072B2", ":"),
    "rq_trained": ("#56B4E9", "-"),
    "r_trained": ("#56B4E9", "--"),
    "q_trained": ("#56B4E9", ":"),
    "rq_centroid": ("#0072B2", "-."),
    "joint": ("#D55E00", "-"),
    "innovation_based": ("#009E73", "-"),
    "sage_husa": ("#009E73", "--"),
    "variational_bayes": ("#CC79A7", "-"),
    "multiple_model": ("#CC79A7", "--"),
}
"""Color and dashes of each filter's curves."""


def line_style(name: str, labels: Labels) -> dict[str, Any]:
    """Return how a filter's curves look, the same in every figure."""
    color, dashes = _STYLES[name]
    width = 2.2 if name == ORACLE else 1.4
    return {"color": color, "ls": dashes, "lw": width, "label": labels[name]}


def logarithmic(panel: Any) -> None:
    """Give a panel a logarithmic y axis with numbers that can be read."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    panel.set_yscale("log")
    panel.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    panel.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    panel.yaxis.set_minor_formatter(NullFormatter())
    panel.grid(visible=True, which="major", alpha=0.25)


class _HeatMap(NamedTuple):
    """A quantity of the 25 starts.

    Attributes:
        word: for the file's name.
        title: for the reader.
        colors: name of the color map.
        ticks: of the logarithmic color bar, which goes from the first to the last.
    """

    word: str
    title: str
    colors: str
    ticks: tuple[float, ...]

    def values(self, outcome: Outcome, name: str) -> FloatArray:
        """Return the values `(5, 5)`, q by k."""
        score = outcome.scores[name]
        found = np.max(score.ratio.value, axis=-1) if self.word == "ratio" else score.nees.value
        where = outcome.cells.index
        return np.array([[found[where(Cell(q, k))] for k in FACTORS] for q in FACTORS])


_HEAT_MAPS = (
    _HeatMap(
        word="ratio",
        title="RMSE as a ratio to the oracle's, worst of x, y, theta",
        colors="YlOrBr",
        ticks=(1.0, 1.2, 1.5, 2.0, 3.0, 4.0),
    ),
    _HeatMap(
        word="nees",
        title="mean NEES; 3 where the covariance is consistent, more where it is too small",
        colors="PuOr_r",
        ticks=(0.3, 1.0, 3.0, 9.0, 30.0),
    ),
)
"""The quantities that are drawn as heat maps."""


def draw_grid(out: Path, outcomes: Sequence[Outcome], labels: Labels) -> None:
    """Draw heat maps of ratio and NEES: a picture for each simulation and range."""
    for trial, title in grid.SIMULATIONS.items():
        tried = [o for o in outcomes if o.trial == trial and o.filter != ORACLE]
        for name in tried[0].scores:
            for kind in _HEAT_MAPS:
                file = f"grid_{trial}_{name.replace(' ', '_')}_{kind.word}.png"
                heading = f"{kind.title}\n{title}, {range_words(name)}"
                save(_heat_maps(kind, heading, tried, name, labels), out / file)


def _heat_maps(
    kind: _HeatMap, heading: str, tried: Sequence[Outcome], name: str, labels: Labels
) -> Any:
    from matplotlib.colors import LogNorm

    columns = min(len(tried), 4)
    lines = -(-len(tried) // columns)
    figure = new_figure(1.5 + 2.9 * columns, 1.4 + 2.9 * lines, fixed_aspect=True)
    panels = figure.subplots(lines, columns, squeeze=False)
    norm = LogNorm(kind.ticks[0], kind.ticks[-1])
    image = None
    for panel, outcome in zip(panels.flat, tried, strict=False):
        values = kind.values(outcome, name)
        image = heat_map(panel, values, kind.colors, norm, _short)
        panel.set_title(labels[outcome.filter], fontsize=10)
    for panel in panels.flat[len(tried) :]:
        panel.set_visible(False)
    figure.supxlabel("k: assumed / true variance of R")
    figure.supylabel("q: assumed / true variance of Q")
    figure.suptitle(heading, fontsize=11)
    color_bar(figure, image, panels, kind.ticks)
    return figure


def color_bar(
    figure: Any, image: Any, panels: Any, ticks: Sequence[float], label: str = ""
) -> None:
    """Draw the color bar of heat maps, with numbers at the ticks only.

    Args:
        figure: to draw on.
        image: one of the heat maps.
        panels: the panels that it is of.
        ticks: values with a number.
        label: of the bar.
    """
    bar = figure.colorbar(image, ax=panels, shrink=0.8, extend="both", label=label)
    bar.set_ticks(ticks, labels=[f"{tick:g}" for tick in ticks])
    bar.minorticks_off()


def heat_map(
    panel: Any, values: FloatArray, colors: str, norm: Any, text: Callable[[float], str]
) -> Any:
    """Draw what the 25 starts come to; returns the image.

    Args:
        panel: to draw on.
        values: `(5, 5)`, q by k.
        colors: name of the color map.
        norm: from values to colors.
        text: what to write for a value.
    """
    image = panel.imshow(values, origin="lower", cmap=colors, norm=norm)
    for (row, column), value in np.ndenumerate(values):
        dark = np.dot(image.cmap(norm(value))[:3], _LUMINANCE) < 0.5
        panel.text(
            column, row, text(value),
            ha="center", va="center", fontsize=8, color="white" if dark else "black",
        )  # fmt: skip
    words = [factor_words(factor) for factor in FACTORS]
    panel.set_xticks(range(len(FACTORS)), words)
    panel.set_yticks(range(len(FACTORS)), words)
    return image


def _short(value: float) -> str:
    """Return a number as it fits a cell."""
    if not value < 999.5:
        return ">999" if value >= 999.5 else "n/a"
    return f"{value:.2f}" if value < 9.995 else f"{value:.1f}" if value < 99.95 else f"{value:.0f}"


def draw_dynamic(out: Path, outcomes: Sequence[Outcome], labels: Labels) -> None:
    """Draw position and heading errors over time, for each case one picture with all starts."""
    for trial, case in dynamic.CASES.items():
        tried = [outcome for outcome in outcomes if outcome.trial == trial]
        for axis, word in (("position", "position"), ("theta", "heading")):
            heading = f"RMS {word} error over the runs: {case.about}\n{START_NOTE}"
            figure = _errors_over_time(tried, axis, labels, case.has_event)
            figure.suptitle(heading, fontsize=12)
            save(figure, out / f"dynamic_{trial}_{word}.png")


def _errors_over_time(tried: Sequence[Outcome], axis: str, labels: Labels, has_event: bool) -> Any:
    figure = new_figure(13.0, 7.5)
    panels = figure.subplots(2, 3, sharex=True, sharey=True)
    legend = panels.flat[5]
    steps = len(tried[0].rms)
    time = NOMINAL_PERIOD_S * np.arange(1, steps + 1)
    event = event_steps(steps)
    for panel, cell in zip(panels.flat, dynamic.STARTS, strict=False):
        for outcome in tried:
            index = outcome.cells.index(cell) if cell in outcome.cells else 0
            rms = smoothed(axis_error(outcome.rms[:, index], axis))
            panel.plot(time, rms, **line_style(outcome.filter, labels))
        if has_event:
            begin, end = (NOMINAL_PERIOD_S * step for step in (event.start, event.stop))
            panel.axvspan(begin, end, color="#000000", alpha=0.08, lw=0)
        panel.set(title=start_words(cell))
        logarithmic(panel)
    for panel in panels[:, 0]:
        panel.set_ylabel(f"{axis} [{ERROR_UNITS[axis]}]")
    for panel in (*panels[1, :2], panels[0, 2]):
        panel.set_xlabel("time [s]")
        panel.tick_params(labelbottom=True)
    legend.axis("off")
    legend.legend(*panels.flat[0].get_legend_handles_labels(), loc="center", frameon=False)
    return figure


def axis_error(rms: FloatArray, axis: str) -> FloatArray:
    """Return the RMS error `(T,)` of `(T, 3)` in one of `ERROR_UNITS` (m, rad)."""
    if axis == "position":
        return np.asarray(np.hypot(rms[:, 0], rms[:, 1]))
    return rms[:, AXES.index(axis)]


def smoothed(rms: FloatArray) -> FloatArray:
    """Return the RMS of the last `SMOOTHED_STEPS`, of fewer at the begin; `(T,)` of `(T,)`."""
    sums = np.concatenate([[0.0], np.cumsum(rms**2)])
    after = np.arange(1, len(sums))
    first = np.maximum(after - SMOOTHED_STEPS, 0)
    return np.asarray(np.sqrt((sums[after] - sums[first]) / (after - first)))
