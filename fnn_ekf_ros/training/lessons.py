# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The networks that `train` can learn: their training sets, and what becomes of the result."""

import itertools
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from fnn_ekf_ros.core.adaptation import AdaptationMode, FuzzyNetwork
from fnn_ekf_ros.core.arrays import FloatArray
from fnn_ekf_ros.core.fuzzy import FuzzySets
from fnn_ekf_ros.errors import FnnEkfError
from fnn_ekf_ros.membership.files import EXPLAINED, MISMATCH
from fnn_ekf_ros.reports.progress import with_progress
from fnn_ekf_ros.training import figures
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

LARGEST_GROWTH = 10.0
"""Largest loss, as a multiple of the first one: descent that has gone so far wrong does not
return."""


class Lesson(NamedTuple):
    """Inputs of descent, and the use of its result.

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
        figures.draw_change(path, pairs, learned_network(start, *scales, 1.0), after)

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
        figures.draw_joint_change(path, pairs, first, after)

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
        initial="initial",
        rate=0.01,
        pairs="(D, dR)",
        argument=MISMATCH,
        parameter="membership_file",
        mode=AdaptationMode.R,
        prepare=_paper,
    ),
    "joint": Subject(
        initial="joint_initial",
        rate=0.1,
        pairs="(u, dtheta)",
        argument=EXPLAINED,
        parameter="joint_membership_file",
        mode=AdaptationMode.JOINT,
        prepare=_joint,
    ),
}
"""`--network`: the paper's network for modes r, q and rq, and the one of mode joint."""


def learn(lesson: Lesson, epochs: int, rate: float) -> tuple[FuzzySets, list[float]]:
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
