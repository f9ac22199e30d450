# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Pictures of membership functions, the paper's figures 3 and 4 among them."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from fnn_ekf_ros.core.adaptation import FuzzyNetwork
from fnn_ekf_ros.core.arrays import FloatArray
from fnn_ekf_ros.core.fuzzy import FuzzySets, gaussian, sigmoid
from fnn_ekf_ros.membership.files import EXPLAINED, MISMATCH
from fnn_ekf_ros.reports.pictures import new_figure, save

MEMBERSHIP_SPAN = 120.0
"""Half width of the pictures of the paper's membership functions [their unit], which shows the
centers of all but the learned D."""
NEEDLE_SPAN = 2.0
"""Half width of the picture of the paper's narrow set M [its unit]."""
MEMBERSHIP_SPANS = {MISMATCH: MEMBERSHIP_SPAN, EXPLAINED: 1.5}
"""Half width of the pictures by the functions' argument; of mode joint [log variance]."""


class Axes(NamedTuple):
    """Axes of a picture of membership functions.

    Attributes:
        argument: label of the antecedents.
        change: label of the consequents.
        unit: returns the label of a network's unit.
    """

    argument: str
    change: str
    unit: Callable[[FuzzyNetwork], str]


def _squares(network: FuzzyNetwork) -> str:
    """Return the units of the paper's networks, position and yaw, in words."""
    sizes = (network.position_unit * 1e6, network.yaw_unit * 1e6)
    position, yaw = ("" if size == 1.0 else f"{size:.3g} " for size in sizes)
    return f"{position}mm² or {yaw}mrad²"


AXES = {
    MISMATCH: Axes(
        r"$-D = \hat{C} - S$", r"$\Delta R$",
        _squares,
    ),
    EXPLAINED: Axes("u, what the evidence asks for", r"$\Delta\theta$", lambda _: "log variance"),
}  # fmt: skip
"""Labels of the axes by the functions' argument."""
# Increase, maintain, decrease, and the sets that lead there.
BLUE, GREEN, RED, GREY = "#0072B2", "#009E73", "#D55E00", "#777777"
"""Colors that are told apart without seeing red or green (Okabe and Ito), and a gray."""
RULE_COLORS = (BLUE, GREEN, RED)
"""Colors of the rules increase, maintain, decrease, and of the sets that lead to them."""


def draw_membership(
    path: Path,
    networks: Mapping[str, FuzzyNetwork],
    span: float = MEMBERSHIP_SPAN,
    labels: Axes = AXES[MISMATCH],
) -> None:
    """Draw membership functions, a row for each network: antecedents left, consequents right.

    Args:
        path: the PNG to write.
        networks: by their titles.
        span: half width of the pictures [the sets' unit].
        labels: what the axes say.

    Raises:
        FnnEkfError: the file cannot be written.
    """
    figure = new_figure(11.0, 0.6 + 2.9 * len(networks))
    rows = figure.subplots(len(networks), 2, sharex=True, sharey=True, squeeze=False)
    for axes, (title, network) in zip(rows, networks.items(), strict=True):
        x = _universe(span, network.sets)
        _plot_sets(axes[0], x, antecedents(network.sets, x))
        _plot_consequents(axes[1], network.sets, span)
        unit = labels.unit(network)
        for ax, argument, what in (
            (axes[0], labels.argument, "antecedents"),
            (axes[1], labels.change, "consequents"),
        ):
            ax.set(xlabel=f"{argument}   [{unit}]")
            ax.set_title(f"{title}: {what}", fontsize="medium", loc="left")
            ax.tick_params(labelbottom=True)
        axes[0].set(ylabel="membership")
    save(figure, path)


def consequents_figure(networks: Mapping[str, FuzzyNetwork], span: float) -> Any:
    """Return the paper's figure 3 or 4: D, M and I of the change of R, a row for each network.

    The right column enlarges the surroundings of M, which is a needle in the paper.

    Args:
        networks: by their titles.
        span: half width of the left pictures [the sets' unit].
    """
    figure = new_figure(11.0, 0.8 + 3.0 * len(networks))
    rows = figure.subplots(len(networks), 2, sharey=True, squeeze=False, width_ratios=(2.4, 1.0))
    labels = AXES[MISMATCH]
    for axes, (title, network) in zip(rows, networks.items(), strict=True):
        middle = network.sets.maintain_center
        for ax, center, half in ((axes[0], 0.0, span), (axes[1], middle, NEEDLE_SPAN)):
            _plot_consequents(ax, network.sets, half, center)
            ax.set(xlabel=f"{labels.change}   [{labels.unit(network)}]")
        axes[0].set(ylabel="membership")
        axes[0].set_title(title, fontsize="medium", loc="left")
        axes[1].set_title("the same around M", fontsize="medium", loc="left")
        axes[1].get_legend().remove()
    return figure


def _universe(span: float, sets: FuzzySets, center: float = 0.0) -> FloatArray:
    """Return arguments `span` to each side of `center`, dense where a set may be narrow."""
    near = np.linspace(-1.0, 1.0, 401) * span / 120.0
    middles = (0.0, sets.zero_center, sets.maintain_center)
    dense = np.concatenate([middle + near for middle in middles])
    even = np.linspace(center - span, center + span, 1201)
    return np.unique(np.concatenate([even, dense[np.abs(dense - center) <= span]]))


def _plot_consequents(ax: Any, sets: FuzzySets, span: float, center: float = 0.0) -> None:
    """Plot I, M and D over changes `span` to each side of `center`; a crisp set is a line."""
    x = _universe(span, sets, center)
    _plot_sets(ax, x, consequents(sets, x))
    if sets.decrease_slope == 0.0 and abs(sets.decrease_center - center) <= span:
        ax.axvline(sets.decrease_center, color=RED, lw=1.8)
    if sets.maintain_width == 0.0:
        ax.axvline(sets.maintain_center, color=GREEN, lw=1.8)


def _plot_sets(ax: Any, x: FloatArray, functions: Mapping[str, FloatArray | None]) -> None:
    for (label, value), color in zip(functions.items(), RULE_COLORS, strict=True):
        if value is None:
            ax.plot([], [], color=color, label=label)
        else:
            ax.plot(x, value, color=color, lw=1.8, label=label)
    ax.set(xlim=(x[0], x[-1]), ylim=(-0.03, 1.05))
    ax.grid(visible=True, alpha=0.25)
    ax.legend(loc="lower right", bbox_to_anchor=(1.0, 0.1), fontsize="small")


def antecedents(sets: FuzzySets, x: FloatArray) -> dict[str, FloatArray | None]:
    """Return N, Z and P at x = C_hat - S, with their rules' order and names for a legend."""
    return {
        "N: S too small": sigmoid(x, sets.negative_slope, sets.negative_center),
        "Z: S right": gaussian(x, sets.zero_center, sets.zero_width),
        "P: S too large": sigmoid(x, sets.positive_slope, sets.positive_center),
    }


def consequents(sets: FuzzySets, x: FloatArray) -> dict[str, FloatArray | None]:
    """Return I, M and D at a change x; None where one is crisp, which is a point, no curve."""
    crisp_d, crisp_m = sets.decrease_slope == 0.0, sets.maintain_width == 0.0
    return {
        "I: increase": sigmoid(x, sets.increase_slope, sets.increase_center),
        "M: maintain" + " (crisp)" * crisp_m: None
        if crisp_m
        else gaussian(x, sets.maintain_center, sets.maintain_width),
        "D: decrease" + " (crisp)" * crisp_d: None
        if crisp_d
        else sigmoid(x, sets.decrease_slope, sets.decrease_center),
    }
