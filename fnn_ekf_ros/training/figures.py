# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Figures of learning: the learned change and the loss."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from fnn_ekf_ros.core.adaptation import FuzzyNetwork
from fnn_ekf_ros.core.arrays import FloatArray
from fnn_ekf_ros.core.fuzzy import Inference, infer
from fnn_ekf_ros.reports.membership_figure import BLUE, GREY, RED, RULE_COLORS
from fnn_ekf_ros.reports.pictures import new_figure, save
from fnn_ekf_ros.training.five_layers import UNITS_PER_SCALE
from fnn_ekf_ros.training.joint_set import JointTrainingSet
from fnn_ekf_ros.training.training_set import FARTHEST, STEP_SHARE, TrainingSet

JOINT_SPAN = 3.0
"""Largest u for which the change of mode joint's network is drawn [log variance]."""
_RULES = ("increase", "maintain", "decrease")
"""Names of the rules, in the order of `Inference`."""


def draw_change(path: Path, pairs: TrainingSet, start: FuzzyNetwork, after: FuzzyNetwork) -> None:
    """Draw the network's output before and after learning, over the training set.

    Args:
        path: the PNG to write.
        pairs: the training set.
        start: the network before learning, in the unit of `after`.
        after: the learned network.

    Raises:
        FnnEkfError: the file cannot be written.
    """
    figure, top, bottom = _two_panels()
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
    """Draw the output of mode joint's network before and after learning, over the training set.

    Args:
        path: the PNG to write.
        pairs: the training set.
        start: the network before learning.
        after: the learned network.

    Raises:
        FnnEkfError: the file cannot be written.
    """
    figure, top, bottom = _two_panels()
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


def _two_panels() -> tuple[Any, Any, Any]:
    """Return a figure of a change: itself, the panel of the change, the panel of the weights."""
    figure = new_figure(9.0, 7.5)
    top, bottom = figure.subplots(2, 1, sharex=True, height_ratios=(2.0, 1.0))
    return figure, top, bottom


def _finish_change(
    top: Any,
    bottom: Any,
    x: FloatArray,
    learned: Inference,
    meaning: str,
    linear_width: float,
    ticks: Sequence[float],
) -> None:
    """Draw the rules' weights in the lower panel, and give both panels the same axes."""
    top.set_title("What the network answers", fontsize="medium", loc="left")
    top.legend(loc="upper left", fontsize="small")
    for weight, rule, color in zip(learned.normalized_firing, _RULES, RULE_COLORS, strict=True):
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
