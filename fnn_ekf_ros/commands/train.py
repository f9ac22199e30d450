# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""`train --out FILE`: learns the membership functions and writes a file `localizer` can load."""

import argparse
from pathlib import Path
from typing import Any

import numpy as np

from fnn_ekf_ros.commands.arguments import (
    Range,
    add_force_argument,
    add_text_argument,
    check_command_results,
    check_ranges,
)
from fnn_ekf_ros.core.adaptation import FuzzyNetwork
from fnn_ekf_ros.errors import FnnEkfError
from fnn_ekf_ros.files.text_files import write_json
from fnn_ekf_ros.membership.files import PACKAGED, read_membership, render_membership
from fnn_ekf_ros.parameters.localizer import LocalizerParameters
from fnn_ekf_ros.parameters.schema import default_of
from fnn_ekf_ros.reports import membership_figure
from fnn_ekf_ros.reports.pictures import require_matplotlib
from fnn_ekf_ros.reports.results import check_result_folder, result_folder
from fnn_ekf_ros.training import figures
from fnn_ekf_ros.training.lessons import SUBJECTS, Lesson, Subject, learn

EPOCHS = 4000
"""Default number of epochs, with which the packaged sets were learned."""
WINDOW = int(default_of(LocalizerParameters, "innovation_window"))
"""Default of `--innovation-window`, N of eq. 13: the localizer's own."""
RANGES = {
    "epochs": Range(1, 1_000_000),
    "seed": Range(0, 2**31 - 1),
    "innovation_window": Range(2, 200),  # the simulated robots make no more steps than 240
    "rate": Range(0.0, 10.0, excludes_least=True),
}
"""Ranges of the options."""
PLOTS = ("membership.png", "change.png", "loss.png", "training.json")
"""Files in the folder of `--plots`."""


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
    add_text_argument(parser, "--out", "write the membership functions", required=True)
    parser.add_argument(
        "--network", choices=tuple(SUBJECTS), default="paper",
        help="the network to train: that of modes r, q and rq, or that of mode joint (paper)",
    )  # fmt: skip
    parser.add_argument(
        "--initial", metavar="NAME",
        help=f"membership functions to start from: {', '.join(PACKAGED)} or a file ({starts}); the "
        "units of the paper's are learned again",
    )  # fmt: skip
    parser.add_argument(
        "--epochs", metavar="N", type=int, default=EPOCHS,
        help=f"steps of steepest descent, each over the whole training set ({EPOCHS})",
    )  # fmt: skip
    parser.add_argument("--rate", metavar="ETA", type=float, help=f"learning rate ({rates})")
    parser.add_argument(
        "--seed", metavar="S", type=int, default=1, help="seed of the training set (1)"
    )
    parser.add_argument(
        "--innovation-window", metavar="N", type=int,
        help=f"innovation_window of the localizer that will use the file ({WINDOW}); the network "
        "of mode joint has none",
    )  # fmt: skip
    parser.add_argument(
        "--plots", metavar="DIR", type=Path,
        help="folder for membership.png, change.png, loss.png and training.json",
    )  # fmt: skip
    add_force_argument(parser)


def run(arguments: argparse.Namespace) -> int:
    """Run the command."""
    subject = SUBJECTS[arguments.network]
    facts = _facts(arguments, subject)
    _check(arguments, facts)
    before = read_membership(facts["initial"])
    rng = np.random.default_rng(facts["seed"])
    lesson = subject.prepare(before, facts.get("innovation_window", WINDOW), rng)
    sets, losses = learn(lesson, facts["epochs"], facts["rate"])
    after = lesson.finish(sets)
    options = " ".join(f"--{key.replace('_', '-')} {value}" for key, value in facts.items())
    count = len(lesson.inputs)
    summary = f"{count} pairs {subject.pairs}; loss {losses[0]:.6g} before, {losses[-1]:.6g} after"
    notes = [f"Learned by: train {options}", f"{summary} {facts['epochs']} epochs."]
    arguments.out.write(render_membership(after, notes, subject.argument))
    if arguments.plots is not None:
        with result_folder(arguments.plots, "--plots") as folder:
            _draw(folder, subject, lesson, facts["initial"], before, after, losses)
            written = facts | {"pairs": count, "loss": losses}
            write_json(folder / "training.json", written, indent=2)
    print(summary)
    print(
        f"{arguments.out}: membership functions; use it with {subject.parameter}:={arguments.out} "
        f"and adaptation:={subject.mode}"
    )
    return 0


def _draw(
    folder: Path,
    subject: Subject,
    lesson: Lesson,
    initial: str,
    before: FuzzyNetwork,
    after: FuzzyNetwork,
    losses: list[float],
) -> None:
    membership_figure.draw_membership(
        folder / "membership.png",
        {f"before learning ({initial})": before, "after learning": after},
        membership_figure.MEMBERSHIP_SPANS[subject.argument],
        membership_figure.AXES[subject.argument],
    )
    lesson.draw(folder / "change.png", before, after)
    figures.draw_loss(folder / "loss.png", losses)


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
    check_ranges(facts, RANGES)
    others = [] if facts["initial"] in PACKAGED else [Path(facts["initial"])]
    if arguments.plots is not None:
        pictures = [arguments.plots / name for name in PLOTS]
        others += [*pictures, arguments.plots, *arguments.plots.absolute().parents]
    check_command_results(arguments, ["--out"], others)
    if arguments.plots is not None:
        require_matplotlib()
        check_result_folder("--plots", arguments.plots, replaces=arguments.force, names=PLOTS)
