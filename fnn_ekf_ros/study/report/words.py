# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Conclusions of a study, in words made of its numbers."""

from collections.abc import Sequence

import numpy as np

from fnn_ekf_ros.core.adaptation import FuzzyNetwork
from fnn_ekf_ros.core.fuzzy import FuzzySets
from fnn_ekf_ros.membership.files import LETTERS, read_membership
from fnn_ekf_ros.study import dynamic, grid, paper
from fnn_ekf_ros.study.filters import CENTROID, EKF, JOINT, ORACLE, PAPER, PAPER_TRAINED
from fnn_ekf_ros.study.report.tables import Labels, number, or_infinite, start_words, table
from fnn_ekf_ros.study.starts import RIGHT, Cell
from fnn_ekf_ros.study.trials import Outcome

ALIKE = 0.01
"""Largest relative difference of two ratios that are called alike."""
HEADING = "## What the numbers show\n"
"""Heading of the part of `results.md` that is made here."""
RATIO_WORDS = "RMSE over the oracle's, worst of x, y and theta, whole run"
"""Says which ratio is meant."""


def paper_words(outcomes: Sequence[Outcome], labels: Labels) -> str:
    """Return where the paper's filter wins over the EKF and where it cannot, and the learned sets.

    Ratios are RMSE over the oracle's, of the worst axis, whole run.
    """
    names = list(dict.fromkeys(o.filter for o in outcomes if o.filter != ORACLE))
    rows, lines = [], []
    for trial, title in paper.TRIALS.items():
        for cell in paper.STARTS:
            worst = {o.filter: _worst(o, cell) for o in outcomes if o.trial == trial}
            rows.append([f"{title}, {start_words(cell)}", *(number(worst[n]) for n in names)])
            lines.append(f"- {title}, {start_words(cell)}: {_duel(worst, labels)}")
    return "\n".join(
        [
            HEADING,
            f"{RATIO_WORDS}. The FNN-EKF is the paper's filter, *{labels[PAPER]}*. Where the noise "
            "is right an EKF is the best there is, and no adaptive filter can win.\n",
            *lines,
            "",
            table(["", *(labels[name] for name in names)], rows),
            *_spread_words(outcomes),
            membership_words(outcomes),
        ]
    )


def membership_words(outcomes: Sequence[Outcome]) -> str:
    """Return the paper's and the packaged learned parameters in one table, and what they cost."""
    networks = {name: read_membership(name) for name in ("initial", "published", "trained")}
    published, trained = networks["published"].sets, networks["trained"].sets
    lines = [
        [letter, key.replace("_", " "), *(f"{getattr(n.sets, key):g}" for n in networks.values())]
        for letter, key in zip(LETTERS, FuzzySets._fields, strict=True)
    ]
    lines += [
        ["", "unit of positions [mm²]", *(f"{n.position_unit * 1e6:g}" for n in networks.values())],
        ["", "unit of yaw [mrad²]", *(f"{n.yaw_unit * 1e6:g}" for n in networks.values())],
        ["a2/a4", "gain of I", *(f"{_gains(n)[0]:.2g}" for n in networks.values())],
        ["a1/a3", "gain of D", *(f"{_gains(n)[1]:.2g}" for n in networks.values())],
    ]
    low, high = sorted(_gains(networks["trained"]))
    first, last = sorted(_gains(networks["published"]))
    said = (
        "Training on simulated robots does not reach the published set: the slope of N becomes "
        f"{trained.negative_slope:.4f} where the paper prints {published.negative_slope:.4f}, and "
        f"b3 {trained.decrease_center:.1f} where it prints {published.decrease_center:.0f}, each "
        "in its own unit, so that only the gains compare directly. A gain is the change of the "
        f"variance over the mismatch where one rule fires alone: {low:.2g} to {high:.2g} of the "
        f"trained set, {first:.2g} to {last:.2g} of the published one. The wanted change given D "
        "is a mean over robots whose D is chance and robots whose R is wrong, and asks for a "
        "fraction of D. With a small gain Q and R scatter less, but D is 0 for every pair of Q and "
        "R that explains the innovations together, and they stay near the first such pair they "
        "come to."
    )
    costs = [
        f"{title}, {start_words(cell)}: {number(pair[1])} against {number(pair[0])}"
        for trial, title in paper.TRIALS.items()
        for cell in paper.STARTS
        if len(pair := _pair(outcomes, trial, cell)) == 2
    ]
    if costs:
        said += (
            " What that costs or saves, trained against published, Q and R together, in the "
            f"ratios of the table above: {'; '.join(costs)}."
        )
    heads = ["", "parameter", "initial", "published", "trained"]
    return f"### Membership functions\n\n{table(heads, lines)}\n{said}\n"


def grid_words(outcomes: Sequence[Outcome], labels: Labels) -> str:
    """Return which filter is nearest to the oracle from its worst start, in each simulation."""
    lines = []
    for trial, title in grid.SIMULATIONS.items():
        worst = {
            o.filter: max(_worst(o, cell) for cell in o.cells)
            for o in outcomes
            if o.trial == trial and o.filter != ORACLE
        }
        order = sorted(worst, key=worst.__getitem__)
        ranks = ", ".join(f"{labels[name]} {number(worst[name])}" for name in order)
        lines.append(f"- {title}: {ranks}.")
    return "\n".join(
        [
            HEADING,
            f"{RATIO_WORDS}, from each filter's worst start, the nearest to the oracle first:\n",
            *lines,
            "",
        ]
    )


def dynamic_words(outcomes: Sequence[Outcome], labels: Labels) -> str:
    """Return for each case how the localizer's filters do against an EKF from the right start."""
    lines = []
    for trial, case in dynamic.CASES.items():
        tried = {o.filter: o for o in outcomes if o.trial == trial}
        said = [
            f"{labels[name]} {number(_worst(tried[name], RIGHT))}"
            for name in (EKF, PAPER, JOINT)
            if name in tried
        ]
        if said:
            lines.append(f"- {case.about}: {', '.join(said)}.")
    about = f"{RATIO_WORDS}, from the right start:\n"
    return "\n".join([HEADING, about, *lines, ""])


def _spread_words(outcomes: Sequence[Outcome]) -> list[str]:
    """Return how much the start matters to the paper's filter, and to the plain fuzzy system."""
    said = []
    for trial, title in paper.TRIALS.items():
        found = [o for o in outcomes if (o.trial, o.filter) == (trial, PAPER)]
        worst = [_worst(o, cell) for o in found for cell in paper.STARTS]
        said.append(f"{number(min(worst))} to {number(max(worst))} in {title}")
    words = (
        f"The paper's filter forgets its start: {', '.join(said)}. C_hat, the mean of the "
        "last N squared innovations, scatters, and the published sets answer with a gain "
        "above 1: Q and R keep jumping, Q too large on average, wherever they began. So the "
        "FNN-EKF wins where the EKF's error from a wrong start is larger than this, and loses "
        "elsewhere.\n"
    )
    if not any(o.filter == CENTROID for o in outcomes):
        return [words]
    return [
        words,
        "The plain fuzzy system changes Q and R by steps of the same size. Where R starts 25 "
        "times too large, Q, which is hundreds of times smaller, is at its lower bound after some "
        "steps and R still nearly where it was: the filter follows its wheels.\n",
    ]


def _worst(outcome: Outcome, cell: Cell) -> float:
    """Return the largest ratio of x, y and theta over the whole run; infinite if one is none."""
    index = outcome.cells.index(cell) if cell in outcome.cells else 0
    return or_infinite(float(np.max(outcome.scores["whole"].ratio.value[index])))


def _pair(outcomes: Sequence[Outcome], trial: str, cell: Cell) -> list[float]:
    """Return the ratios with published and with trained sets, of those that ran."""
    of_trial = {o.filter: o for o in outcomes if o.trial == trial}
    return [_worst(of_trial[n], cell) for n in (PAPER, PAPER_TRAINED) if n in of_trial]


def _duel(worst: dict[str, float], labels: Labels) -> str:
    """Return how the paper's filter does against the EKF, and which filter does best."""
    ekf, fnn = worst[EKF], worst[PAPER]
    if fnn < (1.0 - ALIKE) * ekf:
        comparison = "the FNN-EKF wins"
    elif fnn > (1.0 + ALIKE) * ekf:
        comparison = "the FNN-EKF loses"
    else:
        comparison = "they are alike"
    best = min((name for name in worst if name != ORACLE), key=worst.__getitem__)
    return (
        f"{comparison}, {number(fnn)} against {number(ekf)} of the EKF; nearest to the oracle is "
        f"{labels[best]}, {number(worst[best])}."
    )


def _gains(network: FuzzyNetwork) -> tuple[float, float]:
    """Return d dR / d(C_hat - S) where rule I or rule D fires alone; a crisp D has none."""
    s = network.sets
    decrease = 0.0 if s.decrease_slope == 0.0 else s.positive_slope / s.decrease_slope
    return s.negative_slope / s.increase_slope, decrease
