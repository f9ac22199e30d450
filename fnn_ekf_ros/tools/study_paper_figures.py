"""The paper's figures 3-14 and 17-20, redrawn; needs matplotlib.

Each of its simulations has five figures, the experiment four, its corners enlarged. The paper's 1,
2, 15 and 16 show blocks and hardware.
"""

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from fnn_ekf_ros.core.filter import NOMINAL_PERIOD_S
from fnn_ekf_ros.membership.files import read_membership
from fnn_ekf_ros.parameters.fake_robot import FakeRobotParameters
from fnn_ekf_ros.simulation.paths import SPACING, scripted_path
from fnn_ekf_ros.study import paper
from fnn_ekf_ros.study.filters import DEAD_RECKONING
from fnn_ekf_ros.study.trials import Outcome
from fnn_ekf_ros.tools.study_figures import (
    START_NOTE,
    axis_error,
    line_style,
    logarithmic,
    new_figure,
    save,
    smoothed,
)
from fnn_ekf_ros.tools.study_tables import Labels, start_words
from fnn_ekf_ros.tools.train_figures import draw_membership

ON_TRACKS = ("ekf", "r_published", "joint")
"""Filters whose tracks are drawn, if they ran: more cannot be told apart."""
ENLARGED_M = 0.7
"""Half the side of an enlarged part [m]."""
LOBE = (4.4, 0.0)
"""The simulations' sharpest turn [m]."""
CORNERS = {
    18: ("first corner", (5.5, 0.5)),
    19: ("notch", (3.0, 3.5)),
    20: ("last corner", (0.5, 3.5)),
}
"""Figures of the experiment's corners: what is shown, and its middle [m]."""
MEMBERSHIP_SPAN = 220.0
"""Membership functions are drawn from minus to plus this [their unit]."""
ERROR_AXES = {"x": ("x", "m"), "y": ("y", "m"), "theta": ("heading", "deg")}


class PaperFigure(NamedTuple):
    """One of the paper's figures.

    Attributes:
        file: its name here.
        shows: in words.
        draw: writes it, made of the outcomes.
    """

    file: str
    shows: str
    draw: Callable[[Path, Sequence[Outcome], Labels], None]


def paper_figures() -> list[PaperFigure]:
    """Return the figures in the paper's order."""
    figures = [
        PaperFigure(
            "fig03_membership_initial.png", "membership functions before learning",
            partial(_membership, ("initial",)),
        ),
        PaperFigure(
            "fig04_membership_learned.png", "membership functions after learning",
            partial(_membership, ("published", "trained")),
        ),
        *_simulation_figures("sim1", 5),
        *_simulation_figures("sim2", 10),
        PaperFigure(
            "fig17_experiment_tracks.png", "experiment: one run's last lap",
            partial(_tracks, "round", None),
        ),
    ]  # fmt: skip
    for number, (words, middle) in CORNERS.items():
        file = f"fig{number}_experiment_{words.replace(' ', '_')}.png"
        draw = partial(_tracks, "round", middle)
        figures.append(PaperFigure(file, f"experiment: its {words}, enlarged", draw))
    return figures


def figure_table() -> str:
    """Return which of the paper's figures is which file, in Markdown."""
    lines = [f"| {each.file[3:5]} | {each.file} | {each.shows} |" for each in paper_figures()]
    return "\n".join(["| figure | file | shows |", "| --- | --- | --- |", *lines]) + "\n"


def draw_paper(out: Path, outcomes: Sequence[Outcome], labels: Labels) -> None:
    """Draw all of them."""
    for figure in paper_figures():
        figure.draw(out / figure.file, outcomes, labels)


def _simulation_figures(trial: str, first: int) -> list[PaperFigure]:
    title = paper.TRIALS[trial]
    figures = [
        PaperFigure(
            f"fig{first:02d}_{trial}_tracks.png", f"{title}: one run's last lap",
            partial(_tracks, trial, None),
        ),
        PaperFigure(
            f"fig{first + 1:02d}_{trial}_tracks_enlarged.png", f"{title}: a part of it, enlarged",
            partial(_tracks, trial, LOBE),
        ),
    ]  # fmt: skip
    for number, axis in enumerate(ERROR_AXES, start=first + 2):
        file, shows = f"fig{number:02d}_{trial}_rmse_{axis}.png", f"{title}: RMSE in {axis}"
        figures.append(PaperFigure(file, shows, partial(_rmse, trial, axis)))
    return figures


def _membership(names: Sequence[str], path: Path, *_: object) -> None:
    draw_membership(path, {f"'{name}'": read_membership(name) for name in names}, MEMBERSHIP_SPAN)


def _tracks(
    trial: str,
    middle: tuple[float, float] | None,
    path: Path,
    outcomes: Sequence[Outcome],
    labels: Labels,
) -> None:
    """Draw the last lap of the first run, all of it or around a point."""
    tried = [o for o in outcomes if o.trial == trial and len(o.cells) > 1]
    drawn = [outcome for outcome in tried if outcome.filter in ON_TRACKS] or tried[:3]
    figure = new_figure(12.0, _height(trial) if middle is None else 6.4, fixed_aspect=True)
    panels = figure.subplots(1, len(paper.STARTS), sharex=True, sharey=True)
    lap = _steps_of_lap(trial)
    for panel, cell in zip(panels, paper.STARTS, strict=True):
        truth = tried[0].first_truth[-lap:]
        panel.plot(truth[:, 0], truth[:, 1], color="#000000", lw=2.4, label="true path")
        for outcome in drawn:
            track = outcome.first_run[-lap:, outcome.cells.index(cell)]
            marker = "." if middle else ""
            panel.plot(
                track[:, 0], track[:, 1], marker=marker, ms=5, **line_style(outcome.filter, labels)
            )
        panel.set(title=start_words(cell), xlabel="x [m]", aspect="equal")
        panel.grid(visible=True, alpha=0.25)
        if middle is not None:
            panel.set_xlim(middle[0] - ENLARGED_M, middle[0] + ENLARGED_M)
            panel.set_ylim(middle[1] - ENLARGED_M, middle[1] + ENLARGED_M)
    panels[0].set_ylabel("y [m]")
    _legend_below(figure, panels[0])
    figure.suptitle(f"{paper.TRIALS[trial]}, last lap of one run\n{START_NOTE}", fontsize=11)
    save(figure, path)


def _rmse(trial: str, axis: str, path: Path, outcomes: Sequence[Outcome], labels: Labels) -> None:
    """Draw an axis's RMSE over all runs by time; a panel for each start."""
    word, unit = ERROR_AXES[axis]
    figure = new_figure(12.0, 5.6)
    panels = figure.subplots(1, len(paper.STARTS), sharex=True, sharey=True)
    for panel, cell in zip(panels, paper.STARTS, strict=True):
        for outcome in outcomes:
            if outcome.trial != trial or outcome.filter == DEAD_RECKONING:
                continue
            index = outcome.cells.index(cell) if cell in outcome.cells else 0
            time = NOMINAL_PERIOD_S * np.arange(1, len(outcome.rms) + 1)
            rms = smoothed(axis_error(outcome.rms[:, index], word))
            panel.plot(time, rms, **line_style(outcome.filter, labels))
        panel.set(title=start_words(cell), xlabel="time [s]")
        logarithmic(panel)
    panels[0].set_ylabel(f"RMSE in {axis} [{unit}]")
    _legend_below(figure, panels[0])
    heading = f"{paper.TRIALS[trial]}: RMSE in {axis} over the runs"
    figure.suptitle(f"{heading}\n{START_NOTE}", fontsize=11)
    save(figure, path)


def _legend_below(figure: Any, panel: Any) -> None:
    handles, words = panel.get_legend_handles_labels()
    figure.legend(handles, words, loc="outside lower center", ncols=5, frameon=False, fontsize=9)


def _height(trial: str) -> float:
    """Return how high a figure of two panels next to each other must be [inch]."""
    width, height = np.ptp(scripted_path(trial).points, axis=0)
    return 1.7 + 5.4 * float(height / width)


def _steps_of_lap(trial: str) -> int:
    way = SPACING * len(scripted_path(trial).points)
    return round(way / FakeRobotParameters(path=trial).speed / NOMINAL_PERIOD_S)
