# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The paper's figures 3-14 and 17-20, redrawn, and figures of the rivals; needs matplotlib.

Each shows what the paper's figure of its number shows: the paper's filter against the EKF, and
nothing else. The rivals have figures of their own. The paper's figures 1, 2, 15 and 16 show block
diagrams and hardware.
"""

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from fnn_ekf_ros.core.arrays import FloatArray
from fnn_ekf_ros.core.pace import NOMINAL_PERIOD_S
from fnn_ekf_ros.membership.files import read_membership
from fnn_ekf_ros.parameters.fake_robot import FakeRobotParameters
from fnn_ekf_ros.reports.membership_figure import consequents_figure
from fnn_ekf_ros.reports.pictures import new_figure, save
from fnn_ekf_ros.simulation.paths import SPACING, scripted_path
from fnn_ekf_ros.study import paper
from fnn_ekf_ros.study.filters import DEAD_RECKONING, EKF, PAPER
from fnn_ekf_ros.study.report.figures import (
    ERROR_UNITS,
    SMOOTHED_STEPS,
    axis_error,
    line_style,
    logarithmic,
    smoothed,
)
from fnn_ekf_ros.study.report.tables import Labels, start_words
from fnn_ekf_ros.study.starts import Cell
from fnn_ekf_ros.study.trials import Outcome

SAMPLE_POINTS = 100
"""Number of sample points in the paper's figures 7 and 11."""
MEMBERSHIP_SPAN = 220.0
"""Half width of the universe on which membership functions are drawn [their unit]."""
RMSE_AXES = ("x", "y", "theta")
"""Axes of the pictures of RMSE."""
TRUTH_STYLE = {"color": "#000000", "lw": 3.5, "alpha": 0.35, "label": "true path"}
"""Line style of the true path: wide and pale, so that a filter's path on top of it is seen."""
_FILTER_WIDTHS = {EKF: 1.3, PAPER: 1.8}
"""Widths of the curves [points]."""


class View(NamedTuple):
    """Part of a run that is shown, and its place.

    Attributes:
        steps: takes the number of steps of a run; returns those that are drawn.
        center: middle of the picture [m]; None: all that is drawn.
        half_size: half width and half height of the picture [m].
    """

    steps: Callable[[int], slice]
    center: tuple[float, float] | None = None
    half_size: tuple[float, float] = (0.8, 0.8)


class PaperFigure(NamedTuple):
    """One of the paper's figures, or one of the rivals'.

    Attributes:
        file: its name here.
        shows: in words.
        make: makes it of the outcomes.
    """

    file: str
    shows: str
    make: Callable[[Sequence[Outcome], Labels], Any]

    @property
    def number(self) -> str:
        """The paper's number; a dash for the rivals' figures."""
        return str(int(self.file[3:5])) if self.file.startswith("fig") else "-"


def paper_figures() -> list[PaperFigure]:
    """Return the figures in the paper's order, then the rivals'."""
    return [
        PaperFigure(
            file="fig03_membership_initial.png",
            shows="membership functions D, M, I of the change of R, initial",
            make=partial(_membership, ("initial",)),
        ),
        PaperFigure(
            file="fig04_membership_learned.png",
            shows="the same, learned: as published, and as `train` learns them on simulated robots",
            make=partial(_membership, ("published", "trained")),
        ),
        *_trajectories(),
        *_simulation_figures("sim1", 7),
        *_simulation_figures("sim2", 11),
        *_experiment_figures(),
        *_rivals_figures(),
    ]


def figure_table() -> str:
    """Return which of the paper's figures is which file, in Markdown."""
    lines = [f"| {each.number} | {each.file} | {each.shows} |" for each in paper_figures()]
    return "\n".join(["| figure | file | shows |", "| --- | --- | --- |", *lines]) + "\n"


def draw_paper(out: Path, outcomes: Sequence[Outcome], labels: Labels) -> None:
    """Write all of them into a folder."""
    for figure in paper_figures():
        save(figure.make(outcomes, labels), out / figure.file)


def steps_of_lap(trial: str) -> int:
    """Return how many steps one lap of a trial's path takes."""
    length = SPACING * len(scripted_path(trial).points)
    return round(length / FakeRobotParameters(path=trial).speed / NOMINAL_PERIOD_S)


def _trajectories() -> Iterator[PaperFigure]:
    for number, trial in ((5, "sim1"), (6, "sim2")):
        yield PaperFigure(
            file=f"fig{number:02d}_{trial}_trajectory.png",
            shows=f"{paper.TRIALS[trial]}: the robot's trajectory, its first lap",
            make=partial(_trajectory, trial),
        )


def _simulation_figures(trial: str, first: int) -> Iterator[PaperFigure]:
    title = paper.TRIALS[trial]
    yield PaperFigure(
        file=f"fig{first:02d}_{trial}_tracks.png",
        shows=f"{title}: EKF, FNN-EKF and true path over the first {SAMPLE_POINTS} sample points",
        make=partial(_tracks, trial, View(lambda _: slice(0, SAMPLE_POINTS))),
    )
    for number, axis in enumerate(RMSE_AXES, start=first + 1):
        yield PaperFigure(
            file=f"fig{number:02d}_{trial}_rmse_{axis}.png",
            shows=f"{title}: RMSE in {axis} over the runs at each step, EKF and FNN-EKF",
            make=partial(_rmse, trial, axis),
        )


def _experiment_figures() -> Iterator[PaperFigure]:
    lap = steps_of_lap("round")

    def last_lap(steps: int) -> slice:
        return slice(max(steps - lap, 0), steps)

    for number, word, shows, view in (
        (17, "whole", "the whole round path", View(last_lap)),
        (18, "first_corner", "its first corner", View(last_lap, paper.FIRST_CORNER)),
        (
            19,
            "line",
            "a straight line",
            View(steps=last_lap, center=paper.LINE, half_size=(1.2, 0.4)),
        ),
        (20, "third_corner", "its third corner", View(last_lap, paper.THIRD_CORNER)),
    ):
        yield PaperFigure(
            file=f"fig{number}_experiment_{word}.png",
            shows=f"experiment (simulated): {shows}, the last lap",
            make=partial(_tracks, "round", view),
        )


def _rivals_figures() -> Iterator[PaperFigure]:
    for trial, title in paper.TRIALS.items():
        yield PaperFigure(
            file=f"rivals_{trial}.png",
            shows=f"{title}: RMSE of every filter that ran, of {SMOOTHED_STEPS} steps",
            make=partial(_rivals, trial),
        )


def _membership(names: Sequence[str], *_: object) -> Any:
    networks = {f"'{name}'": read_membership(name) for name in names}
    return consequents_figure(networks, MEMBERSHIP_SPAN)


def _trajectory(trial: str, outcomes: Sequence[Outcome], _: Labels) -> Any:
    """Make a figure of where the robot of the first run was."""
    truth = _outcome(outcomes, trial, EKF).first_truth[: steps_of_lap(trial)]
    figure = new_figure(6.4, 6.2, fixed_aspect=True)
    panel = figure.subplots()
    panel.plot(truth[:, 0], truth[:, 1], color="#000000", lw=1.6, label="robot's trajectory")
    panel.plot(*truth[0, :2], "o", color="#009E73", ms=8, label="start")
    panel.plot(*truth[-1, :2], "s", color="#D55E00", ms=8, label="end of the lap")
    _map(panel)
    panel.set_ylabel("y [m]")
    panel.legend(loc="center", frameon=False)
    panel.set_title(f"{paper.TRIALS[trial].capitalize()}: trajectory of the robot", fontsize=11)
    return figure


def _tracks(trial: str, view: View, outcomes: Sequence[Outcome], labels: Labels) -> Any:
    """Make a figure of the first run's tracks from each start: truth, EKF, FNN-EKF on top."""
    drawn = [_outcome(outcomes, trial, name) for name in (EKF, PAPER)]
    truth = drawn[0].first_truth
    steps = view.steps(len(truth))
    size = np.ptp(truth[steps, :2], axis=0) if view.center is None else view.half_size
    width, height = (float(side) for side in size)
    flat = width > 2.0 * height
    figure = new_figure(12.0, 9.0 if flat else 1.25 + 3.75 * height / width, fixed_aspect=True)
    count = len(paper.STARTS)
    panels = figure.subplots(
        *((count, 1) if flat else (1, count)), sharex=True, sharey=True, squeeze=False
    ).flat
    for panel, cell in zip(panels, paper.STARTS, strict=True):
        panel.plot(truth[steps, 0], truth[steps, 1], **TRUTH_STYLE)
        for outcome in drawn:
            track = outcome.first_run[steps, outcome.cells.index(cell)]
            style = line_style(outcome.filter, labels)
            style["lw"] = _FILTER_WIDTHS[outcome.filter]
            marker = "" if view.center is None else "."
            panel.plot(track[:, 0], track[:, 1], marker=marker, ms=5, **style)
        _map(panel)
        panel.set_title(start_words(cell), fontsize=11)
        panel.label_outer()
        if view.center is not None:
            for set_limits, middle, half in zip(
                (panel.set_xlim, panel.set_ylim), view.center, view.half_size, strict=True
            ):
                set_limits(middle - half, middle + half)
    for panel in figure.axes if flat else figure.axes[:1]:
        panel.set_ylabel("y [m]")
    _legend_below(figure)
    first, last = steps.start + 1, min(steps.stop, len(truth))
    figure.suptitle(
        f"{paper.TRIALS[trial].capitalize()}: one run, steps {first} to {last}", fontsize=11
    )
    return figure


def _rmse(trial: str, axis: str, outcomes: Sequence[Outcome], labels: Labels) -> Any:
    """Make a figure of an axis's RMSE over the runs by time, a row for each start."""
    figure = new_figure(10.0, 8.4)
    panels = figure.subplots(len(paper.STARTS), 1, sharex=True)
    for panel, cell in zip(panels, paper.STARTS, strict=True):
        for name in (EKF, PAPER):
            outcome = _outcome(outcomes, trial, name)
            style = line_style(name, labels)
            style["lw"] = _FILTER_WIDTHS[name]
            panel.plot(*_error_over_time(outcome, cell, axis), **style)
        panel.set_title(start_words(cell), fontsize=11)
        panel.set(ylim=(0.0, None), ylabel=f"RMSE in {axis} [{ERROR_UNITS[axis]}]")
        panel.grid(visible=True, alpha=0.25)
    panels[-1].set_xlabel("time [s]")
    panels[-1].set_xlim(0.0, NOMINAL_PERIOD_S * len(_outcome(outcomes, trial, EKF).rms))
    _legend_below(figure)
    runs = "RMSE over the runs at each step, not smoothed"
    figure.suptitle(f"{paper.TRIALS[trial].capitalize()}: {runs}", fontsize=11)
    return figure


def _rivals(trial: str, outcomes: Sequence[Outcome], labels: Labels) -> Any:
    """Make a figure of all filters' RMSE: a row for each start, a column for each axis."""
    figure = new_figure(14.0, 10.5)
    panels = figure.subplots(len(paper.STARTS), len(RMSE_AXES), sharex=True, sharey="col")
    for row, cell in zip(panels, paper.STARTS, strict=True):
        for panel, axis in zip(row, RMSE_AXES, strict=True):
            for outcome in outcomes:
                if outcome.trial != trial or outcome.filter == DEAD_RECKONING:
                    continue
                time, rms = _error_over_time(outcome, cell, axis)
                panel.plot(time, smoothed(rms), **line_style(outcome.filter, labels))
            panel.set_title(f"{axis} [{ERROR_UNITS[axis]}], {start_words(cell)}", fontsize=10)
            logarithmic(panel)
    for panel in panels[-1]:
        panel.set_xlabel("time [s]")
    _legend_below(figure)
    span = f"RMSE over the runs, root mean square of {SMOOTHED_STEPS} steps"
    figure.suptitle(f"{paper.TRIALS[trial].capitalize()}, all filters: {span}", fontsize=11)
    return figure


def _error_over_time(outcome: Outcome, cell: Cell, axis: str) -> tuple[FloatArray, FloatArray]:
    """Return time [s] and RMSE over the runs, `(T,)` both; the oracle's from any start."""
    index = outcome.cells.index(cell) if cell in outcome.cells else 0
    time = NOMINAL_PERIOD_S * np.arange(1, len(outcome.rms) + 1)
    return np.asarray(time), axis_error(outcome.rms[:, index], axis)


def _outcome(outcomes: Sequence[Outcome], trial: str, name: str) -> Outcome:
    return next(o for o in outcomes if (o.trial, o.filter) == (trial, name))


def _map(panel: Any) -> None:
    panel.set(xlabel="x [m]", aspect="equal")
    panel.grid(visible=True, alpha=0.25)


def _legend_below(figure: Any) -> None:
    handles, words = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, words, loc="outside lower center", ncols=5, frameon=False, fontsize=10)
