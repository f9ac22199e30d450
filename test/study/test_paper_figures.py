# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""What is drawn in each of the paper's figures, and over which range; not how it looks."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pytest

from fnn_ekf_ros.core.pace import NOMINAL_PERIOD_S
from fnn_ekf_ros.membership.files import read_membership
from fnn_ekf_ros.reports.membership_figure import consequents
from fnn_ekf_ros.study import paper
from fnn_ekf_ros.study.report.paper_figures import paper_figures, steps_of_lap
from fnn_ekf_ros.study.starts import RIGHT, Cell
from fnn_ekf_ros.study.trials import Outcome

pytest.importorskip("matplotlib")
STEPS = 400
LABELS = {
    "oracle": "oracle EKF", "dead_reckoning": "dead reckoning", "ekf": "EKF",
    "rq_published": "FNN-EKF", "joint": "joint", "sage_husa": "Sage-Husa",
}  # fmt: skip
STARTS = ("right start", "R x 25", "Q / 25, R x 25")
SIMULATIONS = (("sim1", 7), ("sim2", 11))
EXPERIMENT = {17: None, 18: (6.0, 0.0), 19: (3.0, 0.0), 20: (4.5, 4.0)}
"""What has to be in the middle half of the picture [m]."""


def outcome(trial: str, name: str, rng: np.random.Generator) -> Outcome:
    """Return an outcome of random tracks and errors."""
    cells = (RIGHT,) if name == "oracle" else paper.STARTS
    shape = (STEPS, len(cells), 3)
    return Outcome(
        trial, name, cells, {}, rng.random(shape), rng.random(shape), rng.random((STEPS, 3))
    )


@pytest.fixture(scope="module")
def outcomes() -> list[Outcome]:
    rng = np.random.default_rng(5)
    return [outcome(trial, name, rng) for trial in paper.TRIALS for name in LABELS]


@pytest.fixture(scope="module")
def figures(outcomes: list[Outcome]) -> dict[str, Any]:
    """Return the figures by their number, the rivals' by their trial."""
    made = {}
    for each in paper_figures():
        key = each.file.removesuffix(".png").removeprefix("rivals_")
        made[each.number if each.number != "-" else key] = each.make(outcomes, LABELS)
    return made


def of(outcomes: Sequence[Outcome], trial: str, name: str) -> Outcome:
    (found,) = (o for o in outcomes if (o.trial, o.filter) == (trial, name))
    return found


def lines(panel: Any) -> dict[str, np.ndarray]:
    """Return what a panel's named lines go through, `(n, 2)` each."""
    return {
        line.get_label(): np.asarray(line.get_xydata())
        for line in panel.get_lines()
        if not line.get_label().startswith("_")
    }


def assert_lines(panel: Any, expected: Mapping[str, np.ndarray]) -> None:
    found = lines(panel)
    assert found.keys() == expected.keys()
    for name, points in expected.items():
        np.testing.assert_allclose(found[name], points, rtol=1e-12, err_msg=name)


def test_the_starts_are_those_that_the_figures_compare() -> None:
    assert (Cell(1.0, 1.0), Cell(1.0, 25.0), Cell(1.0 / 25.0, 25.0)) == paper.STARTS


@pytest.mark.slow
def test_each_figure_of_the_paper_that_is_no_block_diagram_is_there(figures: Any) -> None:
    numbers = [*range(3, 15), *range(17, 21)]
    assert list(figures) == [*map(str, numbers), "sim1", "sim2", "round"]


@pytest.mark.parametrize(("number", "names"), [("3", ["initial"]), ("4", ["published", "trained"])])
def test_figures_3_and_4_show_d_m_and_i(figures: Any, number: str, names: list[str]) -> None:
    panels = figures[number].axes
    for (wide, near), name in zip(zip(panels[::2], panels[1::2], strict=True), names, strict=True):
        sets = read_membership(name).sets
        assert f"'{name}'" in wide.get_title(loc="left")
        assert wide.get_xlim() == (-220.0, 220.0)
        assert np.mean(near.get_xlim()) == pytest.approx(sets.maintain_center, abs=1e-9)
        drawn = lines(wide)
        assert [label[0] for label in drawn] == ["I", "M", "D"]
        for label, points in drawn.items():
            if "crisp" in label:
                assert len(points) == 0
            else:
                np.testing.assert_allclose(points[:, 1], consequents(sets, points[:, 0])[label])
        crisp = sorted(float(line.get_xdata()[0]) for line in wide.get_lines()
                       if line.get_label().startswith("_"))  # fmt: skip
        expected = [sets.decrease_center] * (sets.decrease_slope == 0.0)
        expected += [sets.maintain_center] * (sets.maintain_width == 0.0)
        assert crisp == sorted(expected)
    assert "mm² or mrad²" in panels[0].get_xlabel()


@pytest.mark.parametrize(("number", "trial"), [("5", "sim1"), ("6", "sim2")])
def test_figures_5_and_6_show_the_robots_first_lap_alone(
    figures: Any, outcomes: list[Outcome], number: str, trial: str
) -> None:
    (panel,) = figures[number].axes
    truth = of(outcomes, trial, "ekf").first_truth[: steps_of_lap(trial), :2]
    assert_lines(
        panel,
        {"robot's trajectory": truth, "start": truth[:1], "end of the lap": truth[-1:]},
    )
    assert (panel.get_xlabel(), panel.get_ylabel()) == ("x [m]", "y [m]")


@pytest.mark.parametrize(("trial", "number"), SIMULATIONS)
def test_figures_7_and_11_show_the_first_100_sample_points(
    figures: Any, outcomes: list[Outcome], trial: str, number: int
) -> None:
    assert_tracks(figures[str(number)], outcomes, trial, slice(0, 100))


@pytest.mark.parametrize(("number", "center"), EXPERIMENT.items())
def test_figures_17_to_20_show_one_lap_of_the_experiment(
    figures: Any, outcomes: list[Outcome], number: int, center: tuple[float, float] | None
) -> None:
    lap = steps_of_lap("round")
    assert lap == 188  # 21.1 m at 0.3 m/s
    figure = figures[str(number)]
    assert_tracks(figure, outcomes, "round", slice(STEPS - lap, STEPS))
    for panel in figure.axes if center is not None else ():
        for limits, place in zip((panel.get_xlim(), panel.get_ylim()), center, strict=True):
            assert abs(np.mean(limits) - place) <= 0.25 * np.ptp(limits)
        assert np.ptp(panel.get_ylim()) <= 1.6


def assert_tracks(figure: Any, outcomes: list[Outcome], trial: str, steps: slice) -> None:
    """Truth, EKF and the paper's filter on top, from each start; every axis with its unit."""
    assert [panel.get_title() for panel in figure.axes] == [*STARTS]
    ekf, fnn = (of(outcomes, trial, name) for name in ("ekf", "rq_published"))
    for index, panel in enumerate(figure.axes):
        expected = {
            "true path": ekf.first_truth[steps, :2],
            "EKF": ekf.first_run[steps, index, :2],
            "FNN-EKF": fnn.first_run[steps, index, :2],
        }
        assert_lines(panel, expected)
        assert list(lines(panel)) == list(expected)  # the FNN-EKF is drawn last
        assert panel.get_aspect() == 1.0
    assert {panel.get_xlabel() for panel in figure.axes} <= {"x [m]", ""}
    assert figure.axes[0].get_ylabel() == "y [m]"
    assert figure.axes[-1].get_xlabel() == "x [m]"
    assert f"steps {steps.start + 1} to {steps.stop}" in figure.get_suptitle()


@pytest.mark.parametrize(("trial", "tracks"), SIMULATIONS)
@pytest.mark.parametrize(("axis", "unit"), [("x", "m"), ("y", "m"), ("theta", "rad")])
def test_figures_8_to_10_and_12_to_14_show_the_rmse_of_each_step(
    figures: Any, outcomes: list[Outcome], trial: str, tracks: int, axis: str, unit: str
) -> None:
    index = ("x", "y", "theta").index(axis)
    figure = figures[str(tracks + 1 + index)]
    assert [panel.get_title() for panel in figure.axes] == [*STARTS]
    time = NOMINAL_PERIOD_S * np.arange(1, STEPS + 1)
    for start, panel in enumerate(figure.axes):
        assert_lines(
            panel,
            {
                label: np.column_stack([time, of(outcomes, trial, name).rms[:, start, index]])
                for name, label in (("ekf", "EKF"), ("rq_published", "FNN-EKF"))
            },
        )
        assert panel.get_ylabel() == f"RMSE in {axis} [{unit}]"
        assert panel.get_ylim()[0] == 0.0
        assert panel.get_yscale() == "linear"
    assert figure.axes[-1].get_xlabel() == "time [s]"
    assert figure.axes[-1].get_xlim() == (0.0, time[-1])
    assert "not smoothed" in figure.get_suptitle()


@pytest.mark.parametrize("trial", paper.TRIALS)
def test_rivals_have_figures_of_their_own(
    figures: Any, outcomes: list[Outcome], trial: str
) -> None:
    """A row for each start, a column for each axis; dead reckoning would hide the rest."""
    panels = figures[trial].axes
    assert len(panels) == 9
    for panel in panels:
        assert set(lines(panel)) == set(LABELS.values()) - {"dead reckoning"}
    joint = of(outcomes, trial, "joint").rms[:, 2, 1]
    drawn = lines(panels[2 * 3 + 1])["joint"][:, 1]  # y, third start
    np.testing.assert_allclose(drawn[20], np.sqrt(np.mean(joint[13:21] ** 2)), rtol=1e-12)
    assert "root mean square of 8 steps" in figures[trial].get_suptitle()
