"""Pictures of learning: the paper's figures 3 and 4, the learned rule, the loss."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from fnn_ekf_ros.core.adaptation import FuzzyNetwork
from fnn_ekf_ros.core.arrays import FloatArray
from fnn_ekf_ros.core.fuzzy import FuzzySets, Inference, gaussian, infer, sigmoid
from fnn_ekf_ros.membership.files import EXPLAINED, MISMATCH
from fnn_ekf_ros.tools.pictures import new_figure, save
from fnn_ekf_ros.training.five_layers import UNITS_PER_SCALE
from fnn_ekf_ros.training.joint_set import JointTrainingSet
from fnn_ekf_ros.training.training_set import FARTHEST, STEP_SHARE, TrainingSet

MEMBERSHIP_SPAN = 120.0
"""The paper's membership functions are drawn from minus to plus this [their unit]."""
NEEDLE_SPAN = 2.0
"""Half width of the picture of the paper's narrow M [their unit]."""
MEMBERSHIP_SPANS = {MISMATCH: MEMBERSHIP_SPAN, EXPLAINED: 1.5}
"""The same by what they are functions of; mode joint's in log variance."""


class Axes(NamedTuple):
    """How membership functions are drawn.

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
"""By what the membership functions are functions of."""
JOINT_SPAN = 3.0
"""The change of mode joint's network is drawn up to this u [log variance]."""
# Increase, maintain, decrease, and the sets that lead there.
BLUE, GREEN, RED, GREY = "#0072B2", "#009E73", "#D55E00", "#777777"
_RULES = ("increase", "maintain", "decrease")
_COLORS = (BLUE, GREEN, RED)


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
    for (label, value), color in zip(functions.items(), _COLORS, strict=True):
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


def draw_change(path: Path, pairs: TrainingSet, start: FuzzyNetwork, after: FuzzyNetwork) -> None:
    """Draw what the network answers before and after learning, over the training set.

    Args:
        path: the PNG to write.
        pairs: the training set.
        start: what descent started from, in the unit of `after`.
        after: the learned network.

    Raises:
        FnnEkfError: the file cannot be written.
    """
    figure = new_figure(9.0, 7.5)
    top, bottom = figure.subplots(2, 1, sharex=True, height_ratios=(2.0, 1.0))
    D = np.sinh(np.linspace(-1.0, 1.0, 801) * np.arcsinh(FARTHEST)) * UNITS_PER_SCALE
    top.scatter(
        -pairs.mismatch * UNITS_PER_SCALE,
        pairs.wanted_change * STEP_SHARE * UNITS_PER_SCALE,
        s=7, color=GREY, alpha=0.35, linewidths=0, label="training set (at 0: R was right)",
    )  # fmt: skip
    top.plot(-D, infer(start.sets, D).change, color="black", ls="--", lw=1.4, label="before")
    learned = infer(after.sets, D)
    top.plot(-D, learned.change, color=BLUE, lw=2.0, label="after learning")
    limit = 0.6 * STEP_SHARE * FARTHEST * UNITS_PER_SCALE
    top.set_yscale("asinh", linear_width=STEP_SHARE * UNITS_PER_SCALE)
    top.set(ylim=(-3.0 * limit, limit), ylabel=r"$\Delta R$   [unit]")
    meaning = (
        r"$-D = \hat{C} - S$   [unit]; where the noise is right, D scatters by "
        f"{UNITS_PER_SCALE:g}"
    )
    ticks = (-300, -100, -30, -10, 0, 10, 30, 100, 300)
    _finish_change(top, bottom, -D, learned, meaning, UNITS_PER_SCALE, ticks)
    save(figure, path)


def draw_joint_change(
    path: Path, pairs: JointTrainingSet, start: FuzzyNetwork, after: FuzzyNetwork
) -> None:
    """Draw what mode joint's network answers before and after learning, over the training set.

    Args:
        path: the PNG to write.
        pairs: the training set.
        start: what descent started from.
        after: the learned network.

    Raises:
        FnnEkfError: the file cannot be written.
    """
    figure = new_figure(9.0, 7.5)
    top, bottom = figure.subplots(2, 1, sharex=True, height_ratios=(2.0, 1.0))
    fine = 0.05
    u = fine * np.sinh(np.linspace(-1.0, 1.0, 801) * np.arcsinh(JOINT_SPAN / fine))
    top.plot(u, u, color=GREY, lw=0.8, label="slope 1")
    top.plot(u, infer(start.sets, -u).change, color="black", ls="--", lw=1.4, label="before")
    learned = infer(after.sets, -u)
    top.plot(u, learned.change, color=BLUE, lw=2.0, label="after learning")
    top.scatter(pairs.asked, pairs.wanted_change, s=22, color=RED, zorder=3, label="training set")
    top.set_yscale("asinh", linear_width=fine)
    top.set(ylim=(-1.2, 1.2), ylabel=r"$\Delta\theta$   [log variance]")
    meaning = "u, what the evidence asks for   [log variance]"
    ticks = (-3, -1, -0.3, -0.1, 0, 0.1, 0.3, 1, 3)
    _finish_change(top, bottom, u, learned, meaning, fine, ticks)
    save(figure, path)


def _finish_change(
    top: Any,
    bottom: Any,
    x: FloatArray,
    learned: Inference,
    meaning: str,
    linear_width: float,
    ticks: Sequence[float],
) -> None:
    """Draw the rules' weights below the answers, and give both panels the same axes."""
    top.set_title("What the network answers", fontsize="medium", loc="left")
    top.legend(loc="upper left", fontsize="small")
    for weight, rule, color in zip(learned.normalized_firing, _RULES, _COLORS, strict=True):
        bottom.plot(x, weight, color=color, lw=1.8, label=rule)
    bottom.set_xscale("asinh", linear_width=linear_width)
    bottom.set(ylabel=r"weight $\beta$ of the rule", xlabel=meaning, ylim=(-0.03, 1.03))
    bottom.set_title("Which rules it comes from, after learning", fontsize="medium", loc="left")
    bottom.legend(loc="center left", fontsize="small")
    bottom.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
    top.set_yticks(ticks[1:-1], [f"{tick:g}" for tick in ticks[1:-1]])
    for ax in (top, bottom):
        ax.grid(visible=True, alpha=0.25)
        ax.minorticks_off()


def draw_loss(path: Path, losses: Sequence[float]) -> None:
    """Draw the loss before the first epoch and after each.

    Args:
        path: the PNG to write.
        losses: E of eq. 23, the mean over the training set, in scales of the training set.

    Raises:
        FnnEkfError: the file cannot be written.
    """
    figure = new_figure(7.0, 4.0)
    ax = figure.subplots()
    ax.plot(np.arange(len(losses)), losses, color=BLUE, lw=1.8)
    ax.set_xscale("symlog", linthresh=1.0)
    ax.set(yscale="log", xlabel="epoch", ylabel="mean of E (eq. 23)", xlim=(0, len(losses) - 1))
    ax.set_title(f"Loss: {losses[0]:.3g} before, {losses[-1]:.3g} after", fontsize="medium",
                 loc="left")  # fmt: skip
    ax.grid(visible=True, which="both", alpha=0.25)
    save(figure, path)
