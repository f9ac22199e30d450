"""`train --out FILE`: learns the membership functions and writes a file `localizer` can load."""

import argparse
import itertools
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from fnn_ekf_ros.core.adaptation import AdaptationMode, FuzzyNetwork
from fnn_ekf_ros.core.arrays import FloatArray
from fnn_ekf_ros.core.fuzzy import FuzzySets
from fnn_ekf_ros.errors import FnnEkfError
from fnn_ekf_ros.membership.files import (
    EXPLAINED,
    MISMATCH,
    PACKAGED,
    read_membership,
    write_membership,
)
from fnn_ekf_ros.parameters.localizer import LocalizerParameters
from fnn_ekf_ros.parameters.schema import default_of
from fnn_ekf_ros.text_files import write_text
from fnn_ekf_ros.tools.progress import with_progress
from fnn_ekf_ros.tools.result_folder import check_result_file, make_folder
from fnn_ekf_ros.training.descent import LearningNetwork, descend
from fnn_ekf_ros.training.five_layers import (
    JOINT_SCALE,
    as_sets,
    first_sets,
    five_layers,
    in_unit,
    joint_network,
    learned_network,
    mirrored,
    odd_layers,
)
from fnn_ekf_ros.training.joint_set import make_joint_set
from fnn_ekf_ros.training.training_set import STEP_SHARE, make_training_set

EPOCHS = 4000
WINDOW = int(default_of(LocalizerParameters, "innovation_window"))
RANGES = {
    "epochs": (1, 1_000_000),
    "seed": (0, 2**31 - 1),
    "innovation_window": (2, 200),  # the simulated robots make no more steps than 240
}
PLOTS = ("membership.png", "change.png", "loss.png", "training.json")
"""Files in the folder of `--plots`."""
LARGEST_RATE = 10.0
LARGEST_GROWTH = 10.0
"""A loss that has grown so far does not come back."""


class Lesson(NamedTuple):
    """What descent is given, and what becomes of its result.

    Attributes:
        network: what learns.
        start: the sets that it starts from, in the scale of the pairs.
        inputs: `(k,)` of the training set.
        targets: `(k,)` wanted outputs.
        weight: `(k,)` of the pairs; None for equal ones.
        finish: takes sets in the scale of the pairs, returns what a file holds of them.
        draw: takes the path of a picture, and the networks before and after.
    """

    network: LearningNetwork
    start: FuzzySets
    inputs: FloatArray
    targets: FloatArray
    weight: FloatArray | None
    finish: Callable[[FuzzySets], FuzzyNetwork]
    draw: Callable[[Path, FuzzyNetwork, FuzzyNetwork], None]


class Subject(NamedTuple):
    """A network that can be learned.

    Attributes:
        initial: membership functions it starts from.
        rate: learning rate.
        pairs: what its training set is made of.
        argument: what its membership functions are functions of.
        parameter: the localizer's that takes the file.
        mode: the adaptation that uses it.
        prepare: takes the network to start from, N of eq. 13 and a source of randomness.
    """

    initial: str
    rate: float
    pairs: str
    argument: str
    parameter: str
    mode: AdaptationMode
    prepare: Callable[[FuzzyNetwork, int, np.random.Generator], Lesson]


def _paper(before: FuzzyNetwork, window: int, rng: np.random.Generator) -> Lesson:
    pairs = make_training_set(window, rng)
    scales = (pairs.position_scale, pairs.yaw_scale, STEP_SHARE)
    start = first_sets(before)

    def draw(path: Path, _: FuzzyNetwork, after: FuzzyNetwork) -> None:
        from fnn_ekf_ros.tools import train_figures

        train_figures.draw_change(path, pairs, learned_network(start, *scales, 1.0), after)

    return Lesson(
        network=five_layers(start),
        start=start,
        inputs=pairs.mismatch,
        targets=pairs.wanted_change,
        weight=None,
        finish=lambda sets: learned_network(sets, *scales, before.change_limit),
        draw=draw,
    )


def _joint(before: FuzzyNetwork, _: int, rng: np.random.Generator) -> Lesson:
    pairs = make_joint_set(before, rng)
    start = mirrored(in_unit(before.sets, JOINT_SCALE))

    def draw(path: Path, first: FuzzyNetwork, after: FuzzyNetwork) -> None:
        from fnn_ekf_ros.tools import train_figures

        train_figures.draw_joint_change(path, pairs, first, after)

    return Lesson(
        network=odd_layers(start),
        start=start,
        inputs=-pairs.asked / JOINT_SCALE,  # the sets' argument is the opposite of a mismatch
        targets=pairs.wanted_change / JOINT_SCALE,
        weight=pairs.weight,
        finish=lambda sets: joint_network(sets, before.change_limit),
        draw=draw,
    )


SUBJECTS = {
    "paper": Subject(
        "initial", 0.01, "(D, dR)", MISMATCH, "membership_file", AdaptationMode.R, _paper
    ),
    "joint": Subject(
        "joint_initial",
        0.1,
        "(u, dtheta)",
        EXPLAINED,
        "joint_membership_file",
        AdaptationMode.JOINT,
        _joint,
    ),
}
"""`--network`: the paper's network for modes r, q and rq, and the one of mode joint."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.description = (
        "Learns the membership functions by steepest descent on simulated robots whose noise is "
        "known (eqs. 23 and 24), and writes them for the localizer's membership_file or "
        "joint_membership_file."
    )
    starts, rates = (
        ", ".join(f"{name}: {value}" for name, value in values.items())
        for values in (
            {name: subject.initial for name, subject in SUBJECTS.items()},
            {name: f"{subject.rate:g}" for name, subject in SUBJECTS.items()},
        )
    )
    parser.add_argument("--out", metavar="FILE", type=Path, required=True, help="file to write")
    parser.add_argument(
        "--network", choices=tuple(SUBJECTS), default="paper",
        help="what learns: the network of modes r, q and rq, or that of mode joint (paper)",
    )  # fmt: skip
    parser.add_argument(
        "--initial", metavar="NAME",
        help=f"numbers to start from: {', '.join(PACKAGED)} or a file ({starts}); what unit the "
        "paper's count in is learned anew",
    )  # fmt: skip
    parser.add_argument(
        "--epochs", metavar="N", type=int, default=EPOCHS,
        help=f"steps of descent, each over all pairs ({EPOCHS})",
    )  # fmt: skip
    parser.add_argument("--rate", metavar="ETA", type=float, help=f"learning rate ({rates})")
    parser.add_argument("--seed", metavar="S", type=int, default=1, help="of the training set (1)")
    parser.add_argument(
        "--innovation-window", metavar="N", type=int,
        help=f"innovation_window of the localizer that will use the file ({WINDOW}); the network "
        "of mode joint has none",
    )  # fmt: skip
    parser.add_argument(
        "--plots", metavar="DIR", type=Path,
        help="folder for membership.png, change.png, loss.png and training.json",
    )  # fmt: skip


def run(arguments: argparse.Namespace) -> int:
    """Run the command."""
    subject = SUBJECTS[arguments.network]
    facts = _facts(arguments, subject)
    _check(arguments, facts)
    before = read_membership(facts["initial"])
    rng = np.random.default_rng(facts["seed"])
    lesson = subject.prepare(before, facts.get("innovation_window", WINDOW), rng)
    sets, losses = _learn(lesson, facts["epochs"], facts["rate"])
    after = lesson.finish(sets)
    options = " ".join(f"--{key.replace('_', '-')} {value}" for key, value in facts.items())
    count = len(lesson.inputs)
    summary = f"{count} pairs {subject.pairs}; loss {losses[0]:.6g} before, {losses[-1]:.6g} after"
    notes = [f"Learned by: train {options}", f"{summary} {facts['epochs']} epochs."]
    write_membership(arguments.out, after, notes, subject.argument)
    if arguments.plots is not None:
        from fnn_ekf_ros.tools import train_figures

        networks = {f"before learning ({facts['initial']})": before, "after learning": after}
        train_figures.draw_membership(
            arguments.plots / "membership.png",
            networks,
            train_figures.MEMBERSHIP_SPANS[subject.argument],
            train_figures.AXES[subject.argument],
        )
        lesson.draw(arguments.plots / "change.png", before, after)
        train_figures.draw_loss(arguments.plots / "loss.png", losses)
        written = facts | {"pairs": count, "loss": losses}
        text = json.dumps(written, indent=2, allow_nan=False)
        write_text(arguments.plots / "training.json", f"{text}\n")
    print(summary)
    print(
        f"{arguments.out}: membership functions; use it with {subject.parameter}:={arguments.out} "
        f"and adaptation:={subject.mode}"
    )
    return 0


def _facts(arguments: argparse.Namespace, subject: Subject) -> dict[str, Any]:
    """Return the options that decide what is learned, as they are to be written down.

    Raises:
        FnnEkfError: an option that the network does not have.
    """
    facts: dict[str, Any] = {} if arguments.network == "paper" else {"network": arguments.network}
    facts |= {
        "initial": subject.initial if arguments.initial is None else arguments.initial,
        "epochs": arguments.epochs,
        "rate": subject.rate if arguments.rate is None else arguments.rate,
        "seed": arguments.seed,
    }
    window = arguments.innovation_window
    if arguments.network == "paper":
        return facts | {"innovation_window": WINDOW if window is None else window}
    if window is not None:
        raise FnnEkfError(
            f"--innovation-window {window}: the network of mode {arguments.network} has none"
        )
    return facts


def _check(arguments: argparse.Namespace, facts: dict[str, Any]) -> None:
    for name, (low, high) in RANGES.items():
        value = facts.get(name, low)
        if not low <= value <= high:
            raise FnnEkfError(f"--{name.replace('_', '-')} {value}: expected {low} to {high}")
    if not 0.0 < facts["rate"] <= LARGEST_RATE:
        raise FnnEkfError(
            f"--rate {facts['rate']:g}: expected more than 0, at most {LARGEST_RATE:g}"
        )
    others = []
    if arguments.plots is not None:
        pictures = [arguments.plots / name for name in PLOTS]
        others = [*pictures, arguments.plots, *arguments.plots.absolute().parents]
    check_result_file("--out", arguments.out, others)
    if arguments.plots is not None:
        from fnn_ekf_ros.tools.pictures import require_matplotlib

        require_matplotlib()
        make_folder(arguments.plots, "--plots")
        for path in pictures:
            check_result_file("--plots", path)


def _learn(lesson: Lesson, epochs: int, rate: float) -> tuple[FuzzySets, list[float]]:
    """Return the sets after so many epochs, and the loss before the first and after each.

    Raises:
        FnnEkfError: the loss grows to more than `LARGEST_GROWTH` of what it was.
    """
    steps = descend(
        lesson.network, np.array(lesson.start), lesson.inputs, lesson.targets, rate, lesson.weight
    )
    losses: list[float] = []
    learned = lesson.start
    for epoch in with_progress(itertools.islice(steps, epochs + 1), epochs + 1, "train"):
        if losses and not epoch.loss <= LARGEST_GROWTH * losses[0]:
            raise FnnEkfError(
                f"--rate {rate:g}: the loss grew from {losses[0]:.3g} to {epoch.loss:.3g} within "
                f"{len(losses)} epochs; expected a smaller rate"
            )
        losses.append(epoch.loss)
        learned = as_sets(epoch.parameters)
    return learned, losses
