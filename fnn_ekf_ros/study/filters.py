# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The filters of the studies, by name; all see the same recordings and the same starts."""

import dataclasses
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from fnn_ekf_ros.core.arrays import MEASUREMENT_SIZE, against
from fnn_ekf_ros.core.filter import step
from fnn_ekf_ros.core.motion import MotionModel
from fnn_ekf_ros.core.results import Epoch
from fnn_ekf_ros.core.state import FilterModel, start_filter, with_noise
from fnn_ekf_ros.membership.files import networks_for
from fnn_ekf_ros.parameters.localizer import LocalizerParameters
from fnn_ekf_ros.study.blocks import NUMBERS_OF_A_FILTER, BlockStart, StepEstimate, run_in_blocks
from fnn_ekf_ros.study.recording import Estimates, Recording, Start
from fnn_ekf_ros.study.rivals import (
    innovation_based,
    multiple_model,
    sage_husa,
    variational_bayes,
)
from fnn_ekf_ros.study.rivals.innovation_based import InnovationBasedSettings
from fnn_ekf_ros.study.rivals.multiple_model import MultipleModelSettings
from fnn_ekf_ros.study.rivals.sage_husa import SageHusaSettings
from fnn_ekf_ros.study.rivals.variational_bayes import VariationalBayesSettings
from fnn_ekf_ros.timeline.filter_model import filter_model

ORACLE = "oracle"
"""Name of the EKF that knows the true noise of each step."""
EKF = "ekf"
"""Name of the EKF without a gate."""
EKF_GATED = "ekf_gated"
"""Name of the EKF with the localizer's gate."""
JOINT = "joint"
"""Name of the filter in mode joint."""
DEAD_RECKONING = "dead_reckoning"
"""Name of the filter that takes no readings."""
FIXED = (EKF, EKF_GATED)
"""Names of the EKFs whose noise stays as it is."""
BANK = "multiple_model"
"""Name of the bank of 81 EKFs."""
SLOWEST = (BANK, JOINT, "rq_centroid")
"""Names of the filters that take several times as long as the others, the slowest first: their work
begins first."""
SMALLEST_WINDOW = 2
"""Smallest `innovation_window`: a filter that adapts nothing needs no innovations."""
PLAIN: dict[str, Any] = {"adaptation": "none", "innovation_window": SMALLEST_WINDOW}
"""Parameters of an EKF that adapts nothing."""
NO_GATE: dict[str, Any] = {"compass_gate": 0.0, "lrf_pose_gate": 0.0}
"""Parameters of a filter that takes every reading, as the paper's does."""
SET_BY_NAMES = frozenset({"adaptation", "membership_file", "process_membership_file", "inference"})
"""Parameters that the filters' names decide."""
PAPER, PAPER_TRAINED, CENTROID = "rq_published", "rq_trained", "rq_centroid"
"""Names of the paper's filter with its published and with learned sets, and of its fuzzy EKF."""


class LocalizerFilter(NamedTuple):
    """A filter that the localizer can be configured to be.

    Attributes:
        name: what `--filters` calls it.
        label: what tables and figures call it.
        changes: its parameters that differ from the study's.
    """

    name: str
    label: str
    changes: dict[str, Any]


def _of_the_paper(mode: str, sets: str) -> LocalizerFilter:
    label = f"FNN-EKF {' and '.join(mode.upper())}, {sets}"
    changes = {"adaptation": mode, "membership_file": sets, "process_membership_file": sets}
    return LocalizerFilter(f"{mode}_{sets}", label, changes | NO_GATE)


LOCALIZER_FILTERS = (
    LocalizerFilter(EKF, "EKF", PLAIN | NO_GATE),
    LocalizerFilter(EKF_GATED, "EKF with gate", PLAIN),
    LocalizerFilter(JOINT, "FNN-EKF joint", {"adaptation": "joint"}),
    *(_of_the_paper(mode, sets) for mode in ("rq", "r", "q") for sets in ("published", "trained")),
    LocalizerFilter(
        CENTROID,
        "fuzzy EKF R and Q, centroid",
        {"adaptation": "rq", "membership_file": "published", "inference": "centroid"} | NO_GATE,
    ),
)
"""The localizer's own filters; joint and ekf_gated have its gate, the paper's have none."""


@dataclass(frozen=True, slots=True)
class StudyFilter:
    """A filter of the studies; it can be pickled.

    Attributes:
        name: what `--filters` calls it.
        label: what tables and figures call it.
        run: takes a recording and starts `(..., n)`; returns the estimates `(T, ..., n)`.
    """

    name: str
    label: str
    run: Callable[[Recording, Start], Estimates]


class LocalizerModel(NamedTuple):
    """A filter that the localizer itself can be configured to be.

    Attributes:
        label: what tables and figures call it.
        model: the filter.
    """

    label: str
    model: FilterModel


def localizer_models(parameters: LocalizerParameters) -> dict[str, LocalizerModel]:
    """Return the localizer's own filters by name, the EKF first: plain, without a gate.

    Args:
        parameters: of every filter, except what its name decides.
    """
    return {
        each.name: LocalizerModel(each.label, _model(parameters, **each.changes))
        for each in LOCALIZER_FILTERS
    }


def study_filters(parameters: LocalizerParameters) -> dict[str, StudyFilter]:
    """Return all filters by name.

    Args:
        parameters: of every filter, except what its name decides and the noise it starts with.
    """
    models = localizer_models(parameters)
    fixed = models[EKF].model
    filters = [
        StudyFilter(
            DEAD_RECKONING,
            "dead reckoning",
            partial(_run_blind, fixed),
        ),
        StudyFilter(EKF, models[EKF].label, partial(run, fixed)),
        StudyFilter(ORACLE, "oracle EKF", partial(run, fixed, knows_noise=True)),
    ]
    filters += [
        StudyFilter(name, label, partial(run, model))
        for name, (label, model) in models.items()
        if name != EKF
    ]
    f = MotionModel(parameters.motion_model)
    filters += [
        StudyFilter(
            "innovation_based", "IAE",
            partial(innovation_based.run, f, settings=InnovationBasedSettings()),
        ),
        StudyFilter(
            "sage_husa", "Sage-Husa", partial(sage_husa.run, f, settings=SageHusaSettings())
        ),
        StudyFilter(
            "variational_bayes", "VB-AKF",
            partial(variational_bayes.run, f, settings=VariationalBayesSettings()),
        ),
        StudyFilter(
            BANK, "bank of 81 EKFs",
            partial(multiple_model.run, f, settings=MultipleModelSettings()),
        ),
    ]  # fmt: skip
    return {each.name: each for each in filters}


def run(
    model: FilterModel, recording: Recording, start: Start, *, knows_noise: bool = False
) -> Estimates:
    """Run the localizer's own filter over a recording.

    Args:
        model: the filter.
        recording: of n robots.
        start: `(..., n)` starts.
        knows_noise: whether it has each step's true Q and R instead of the start's.
    """
    # The filters of lasting errors are not counted. With them, too, 200 to 300 robots side by side
    # are fastest (40 us a step and robot); the 45 that would fill the cache take 68 us, 450 49 us.
    window = MEASUREMENT_SIZE * model.adaptation.window_length
    numbers = NUMBERS_OF_A_FILTER * model.layout.steady.stop + window
    return run_in_blocks(recording, start, partial(_filter, model, recording, knows_noise), numbers)


def _filter(
    model: FilterModel,
    recording: Recording,
    knows_noise: bool,
    start: BlockStart,
    epochs: Iterator[Epoch],
) -> Iterator[StepEstimate]:
    """Take some robots over all steps; the recording is there for its true noise."""
    state = start_filter(
        model, start.mean, start.covariance, start.process_noise, start.measurement_noise
    )
    for Q, R, epoch in zip(
        recording.process_noise, recording.measurement_noise, epochs, strict=True
    ):
        if knows_noise:
            state = with_noise(
                model,
                state,
                np.broadcast_to(against(Q, start.process_noise), start.process_noise.shape),
                np.broadcast_to(against(R, start.measurement_noise), start.measurement_noise.shape),
            )
        state, result = step(model, state, (epoch,))
        yield StepEstimate(mean=state.mean, covariance=state.covariance, nis=result.nis)


def _model(parameters: LocalizerParameters, **changes: Any) -> FilterModel:
    changed = dataclasses.replace(parameters, **changes)
    return filter_model(changed, networks_for(changed))


def _run_blind(model: FilterModel, recording: Recording, start: Start) -> Estimates:
    blind = recording._replace(available=np.zeros_like(recording.available))
    return run(model, blind, start)
