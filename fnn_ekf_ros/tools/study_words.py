"""What the numbers of a study show, in words made of them."""

from collections.abc import Sequence

import numpy as np

from fnn_ekf_ros.core.adaptation import FuzzyNetwork
from fnn_ekf_ros.core.fuzzy import FuzzySets
from fnn_ekf_ros.membership.files import LETTERS, read_membership
from fnn_ekf_ros.study import dynamic, grid, paper
from fnn_ekf_ros.study.filters import EKF, JOINT, ORACLE, PAPER, PAPER_TRAINED
from fnn_ekf_ros.study.starts import RIGHT, Cell
from fnn_ekf_ros.study.trials import Outcome
from fnn_ekf_ros.tools.study_tables import Labels, start_words, table

ALIKE = 0.01
"""Two ratios that differ by less than this part are called alike."""
HEADING = "## What the numbers show\n"


def paper_words(outcomes: Sequence[Outcome], labels: Labels) -> str:
    """Return where the paper's filter wins over the EKF and where it cannot, and the learned sets.

    Ratios are RMSE over the oracle's, of the worst axis, whole run.
    """
    names = list(dict.fromkeys(o.filter for o in outcomes if o.filter != ORACLE))
    rows, lines = [], []
    for trial, title in paper.TRIALS.items():
        for cell in paper.STARTS:
            worst = {o.filter: _worst(o, cell) for o in outcomes if o.trial == trial}
            rows.append([f"{title}, {start_words(cell)}", *(_number(worst[n]) for n in names)])
            lines.append(f"- {title}, {start_words(cell)}: {_duel(worst, labels)}")
    return "\n".join(
        [
            HEADING,
            "RMSE over the oracle's, worst of x, y and theta, whole run. The FNN-EKF is the "
            f"paper's filter, *{labels[PAPER]}*. It makes up for wrong noise, at a price that it "
            "pays with right noise too: what it adapts to scatters, so that Q and R never rest "
            "where they should. Where the noise is right an EKF is the best there is, and no "
            "adaptive filter can win.\n",
            *lines,
            "",
            table(["", *(labels[name] for name in names)], rows),
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
        ["a2/a4", "gain of I", *(_number(_gains(n)[0]) for n in networks.values())],
        ["a1/a3", "gain of D", *(_number(_gains(n)[1]) for n in networks.values())],
    ]
    low, high = sorted(_gains(networks["trained"]))
    first, last = sorted(_gains(networks["published"]))
    said = (
        "Training on simulated robots does not reach the published set: the slope of N becomes "
        f"{trained.negative_slope:.4f} where the paper prints {published.negative_slope:.4f}, b3 "
        f"{trained.decrease_center:.1f} where it prints {published.decrease_center:.0f}, and the "
        f"gain, the change of R over the mismatch beyond the sets' middle, {low:.2f} to {high:.2f} "
        f"where it is {first:.2f} to {last:.2f}. The wanted change given D is a mean over robots "
        "whose D is chance and robots whose R is wrong, and asks for a fraction of D; a gain above "
        "1 overshoots."
    )
    costs = [
        f"{title}, {start_words(cell)}: {_number(pair[1])} against {_number(pair[0])}"
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
        ranks = ", ".join(f"{labels[name]} {_number(worst[name])}" for name in order)
        lines.append(f"- {title}: {ranks}.")
    return "\n".join(
        [
            HEADING,
            "From the worst of its starts each filter has this RMSE over the oracle's, worst of "
            "x, y and theta, whole run, the nearest one first:\n",
            *lines,
            "",
            "From the right start none is below the EKF but by chance: it knows the noise.\n",
        ]
    )


def dynamic_words(outcomes: Sequence[Outcome], labels: Labels) -> str:
    """Return for each case how the localizer's filters do against an EKF from the right start."""
    lines = []
    for trial, case in dynamic.CASES.items():
        tried = {o.filter: o for o in outcomes if o.trial == trial}
        said = [
            f"{labels[name]} {_number(_worst(tried[name], RIGHT))}"
            for name in (EKF, PAPER, JOINT)
            if name in tried
        ]
        if said:
            lines.append(f"- {case.about}: {', '.join(said)}.")
    about = "RMSE over the oracle's from the right start, worst of x, y and theta, whole run:\n"
    return "\n".join([HEADING, about, *lines, ""])


def _worst(outcome: Outcome, cell: Cell) -> float:
    """Return the largest ratio of x, y and theta over the whole run; the oracle's is 1."""
    index = outcome.cells.index(cell) if cell in outcome.cells else 0
    return float(np.max(outcome.scores["whole"].ratio.value[index]))


def _pair(outcomes: Sequence[Outcome], trial: str, cell: Cell) -> list[float]:
    """Return the ratios with published and with trained sets, of those that ran."""
    of_trial = {o.filter: o for o in outcomes if o.trial == trial}
    return [_worst(of_trial[n], cell) for n in (PAPER, PAPER_TRAINED) if n in of_trial]


def _duel(worst: dict[str, float], labels: Labels) -> str:
    """Return how the paper's filter does against the EKF, and which filter does best."""
    ekf, fnn = worst[EKF], worst[PAPER]
    if fnn < (1.0 - ALIKE) * ekf:
        verdict = "the FNN-EKF wins"
    elif fnn > (1.0 + ALIKE) * ekf:
        verdict = "the FNN-EKF loses"
    else:
        verdict = "they are alike"
    best = min((name for name in worst if name != ORACLE), key=worst.__getitem__)
    return (
        f"{verdict}, {_number(fnn)} against {_number(ekf)} of the EKF; nearest to the oracle is "
        f"{labels[best]}, {_number(worst[best])}."
    )


def _gains(network: FuzzyNetwork) -> tuple[float, float]:
    """Return d dR / d(C_hat - S) where rule I or rule D fires alone; a crisp D has none."""
    s = network.sets
    decrease = 0.0 if s.decrease_slope == 0.0 else s.positive_slope / s.decrease_slope
    return s.negative_slope / s.increase_slope, decrease


def _number(value: float) -> str:
    return f"{value:.2f}" if value < 99.5 else f"{value:.3g}"
