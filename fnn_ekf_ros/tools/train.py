"""`train --out FILE`: learns the membership functions and writes a file `localizer` can load."""

import argparse
import itertools
import json
from pathlib import Path
from typing import Any

import numpy as np

from fnn_ekf_ros.core.fuzzy import FuzzySets
from fnn_ekf_ros.errors import FnnEkfError
from fnn_ekf_ros.membership.files import PACKAGED, read_membership, write_membership
from fnn_ekf_ros.parameters.localizer import LocalizerParameters
from fnn_ekf_ros.parameters.schema import default_of
from fnn_ekf_ros.text_files import write_text
from fnn_ekf_ros.tools.progress import with_progress
from fnn_ekf_ros.training.descent import descend
from fnn_ekf_ros.training.five_layers import as_sets, first_sets, five_layers, learned_network
from fnn_ekf_ros.training.training_set import STEP_SHARE, TrainingSet, make_training_set

EPOCHS = 4000
RATE = 0.01
WINDOW = int(default_of(LocalizerParameters, "innovation_window"))
RANGES = {
    "epochs": (1, 1_000_000),
    "seed": (0, 2**31 - 1),
    "innovation_window": (2, 200),  # the simulated robots make no more steps than 240
}
LARGEST_RATE = 10.0
LARGEST_GROWTH = 10.0
"""A loss that has grown so far does not come back."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.description = (
        "Learns the membership functions by steepest descent on simulated robots whose noise is "
        "known (eqs. 23 and 24), and writes them for the localizer's membership_file."
    )
    parser.add_argument("--out", metavar="FILE", type=Path, required=True, help="file to write")
    parser.add_argument(
        "--initial", metavar="NAME", default="initial",
        help=f"numbers to start from: {', '.join(PACKAGED)} or a file (initial); what unit they "
        "count in is learned anew",
    )  # fmt: skip
    parser.add_argument(
        "--epochs", metavar="N", type=int, default=EPOCHS,
        help=f"steps of descent, each over all pairs ({EPOCHS})",
    )  # fmt: skip
    parser.add_argument(
        "--rate", metavar="ETA", type=float, default=RATE, help=f"learning rate ({RATE:g})"
    )
    parser.add_argument("--seed", metavar="S", type=int, default=1, help="of the training set (1)")
    parser.add_argument(
        "--innovation-window", metavar="N", type=int, default=WINDOW,
        help=f"innovation_window of the localizer that will use the file ({WINDOW})",
    )  # fmt: skip
    parser.add_argument(
        "--plots", metavar="DIR", type=Path,
        help="folder for membership.png, change.png, loss.png and training.json",
    )  # fmt: skip


def run(arguments: argparse.Namespace) -> int:
    """Run the command."""
    _check(arguments)
    before = read_membership(arguments.initial)
    rng = np.random.default_rng(arguments.seed)
    pairs = make_training_set(arguments.innovation_window, rng)
    sets, losses = _learn(first_sets(before), pairs, arguments.epochs, arguments.rate)
    after = learned_network(
        sets, pairs.position_scale, pairs.yaw_scale, STEP_SHARE, before.change_limit
    )
    facts: dict[str, Any] = {
        "initial": arguments.initial,
        "epochs": arguments.epochs,
        "rate": arguments.rate,
        "seed": arguments.seed,
        "innovation_window": arguments.innovation_window,
        "pairs": len(pairs.mismatch),
    }
    options = " ".join(
        f"--{key.replace('_', '-')} {value}" for key, value in facts.items() if key != "pairs"
    )
    summary = f"{facts['pairs']} pairs (D, dR); loss {losses[0]:.6g} before, {losses[-1]:.6g} after"
    notes = [f"Learned by: train {options}", f"{summary} {arguments.epochs} epochs."]
    write_membership(arguments.out, after, notes)
    if arguments.plots is not None:
        from fnn_ekf_ros.tools import train_figures

        networks = {f"before learning ({arguments.initial})": before, "after learning": after}
        train_figures.draw_membership(arguments.plots / "membership.png", networks)
        start = learned_network(
            first_sets(before), pairs.position_scale, pairs.yaw_scale, STEP_SHARE, 1.0
        )
        train_figures.draw_change(arguments.plots / "change.png", pairs, start, after)
        train_figures.draw_loss(arguments.plots / "loss.png", losses)
        text = json.dumps(facts | {"loss": losses}, indent=2, allow_nan=False)
        write_text(arguments.plots / "training.json", f"{text}\n")
    print(summary)
    print(f"{arguments.out}: membership functions; use it with membership_file:={arguments.out}")
    return 0


def _check(arguments: argparse.Namespace) -> None:
    for name, (low, high) in RANGES.items():
        value = getattr(arguments, name)
        if not low <= value <= high:
            raise FnnEkfError(f"--{name.replace('_', '-')} {value}: expected {low} to {high}")
    if not 0.0 < arguments.rate <= LARGEST_RATE:
        raise FnnEkfError(
            f"--rate {arguments.rate:g}: expected more than 0, at most {LARGEST_RATE:g}"
        )
    if not arguments.out.parent.is_dir():
        raise FnnEkfError(f"--out {arguments.out}: there is no folder '{arguments.out.parent}'")
    if arguments.out.is_dir():
        raise FnnEkfError(f"--out {arguments.out}: is a folder, expected the name of a file")
    if arguments.plots is not None:
        from fnn_ekf_ros.tools.train_figures import require_matplotlib

        require_matplotlib()
        try:
            arguments.plots.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise FnnEkfError(f"--plots {arguments.plots}: {error.strerror}") from None


def _learn(
    start: FuzzySets, pairs: TrainingSet, epochs: int, rate: float
) -> tuple[FuzzySets, list[float]]:
    """Return the sets after so many epochs, and the loss before the first and after each.

    Raises:
        FnnEkfError: the loss grows to more than `LARGEST_GROWTH` of what it was.
    """
    steps = descend(five_layers(start), np.array(start), pairs.mismatch, pairs.wanted_change, rate)
    losses: list[float] = []
    learned = start
    for epoch in with_progress(itertools.islice(steps, epochs + 1), epochs + 1, "train"):
        if losses and not epoch.loss <= LARGEST_GROWTH * losses[0]:
            raise FnnEkfError(
                f"--rate {rate:g}: the loss grew from {losses[0]:.3g} to {epoch.loss:.3g} within "
                f"{len(losses)} epochs; expected a smaller rate"
            )
        losses.append(epoch.loss)
        learned = as_sets(epoch.parameters)
    return learned, losses
