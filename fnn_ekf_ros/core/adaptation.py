# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Adapting the noise covariances by the fuzzy neural network (Nguyen et al., eqs. 13-16).

    D = S - C_hat                     mismatch, row by row                      (14)
    R <- R + dR(D)                    modes `r` and `rq`                        (15)
    Q <- Q + dQ(D)                    modes `q` and `rq`                        (16)
        D_distance = D_x cos^2(theta) + D_y sin^2(theta),  D_rotation = D_theta

S is the filter's own H (A P A' + W Q W') H' + R; in the paper's (16), A P A' + Q (3x3 plus 2x2) is
read as A P A' + W Q W'. Mode `rq` is the paper's filter: dR and dQ follow from the same D in the
same step, each by a network of its own.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import NamedTuple

import numpy as np

from fnn_ekf_ros.core.arrays import (
    BoolArray,
    FloatArray,
    Row,
    against,
)
from fnn_ekf_ros.core.bounds import NoiseBounds
from fnn_ekf_ros.core.fuzzy import FuzzySets, Inference, infer, infer_centroid
from fnn_ekf_ros.core.window import InnovationWindow, mean_square

LARGEST_DECREASE = 0.75
"""Largest decrease of a variance in one step, as a part of it. The paper's rule overshoots (its
slope is 1.5): from a start that is far too large R + dR would be negative, and one step on the
smallest allowed R would collapse the filter's covariance."""

SMALLEST_WINDOW_SHARE = 1.0 / 3.0
"""Filled part of a row's window from which on the row is learned from. A third of 45 innovations
suffices to see a start that is wrong by 25 in variance; waiting for all of them doubles its
cost."""

RULE_COUNT = 3
"""Rules of the network: increase, maintain, decrease."""
_ROWS_OF_PROCESS = [Row.X, Row.COMPASS_YAW]
"""Rows in which mode `q` reports the firing strengths of distance and rotation."""


class AdaptationMode(StrEnum):
    """Choice of the noise covariances that the network adapts."""

    NONE = "none"
    R = "r"
    Q = "q"
    RQ = "rq"
    JOINT = "joint"

    @property
    def adapts_measurement_noise(self) -> bool:
        """Whether R is adapted."""
        return self in (AdaptationMode.R, AdaptationMode.RQ, AdaptationMode.JOINT)

    @property
    def adapts_process_noise(self) -> bool:
        """Whether Q is adapted."""
        return self in (AdaptationMode.Q, AdaptationMode.RQ, AdaptationMode.JOINT)


class InferenceKind(StrEnum):
    """Choice of how the consequents of the rules are combined."""

    TSUKAMOTO = "tsukamoto"
    CENTROID = "centroid"


@dataclass(frozen=True, slots=True)
class FuzzyNetwork:
    """Membership functions with the units they are given in.

    Attributes:
        sets: the membership functions.
        position_unit: the sets' unit of position variances [m^2]; 1e-6 is mm^2.
        yaw_unit: the sets' unit of yaw variances [rad^2]; 1e-6 is mrad^2.
        change_limit: half width of the universe of the consequents [the sets' unit]; for centroid
            defuzzification only.
    """

    sets: FuzzySets
    position_unit: float
    yaw_unit: float
    change_limit: float

    @property
    def row_units(self) -> FloatArray:
        """Units of the rows of R, `(4,)` (m^2, m^2, rad^2, rad^2)."""
        return np.array([self.position_unit] * 2 + [self.yaw_unit] * 2)


class Networks(NamedTuple):
    """The networks of all modes; each of the paper's is used for all axes of its covariance.

    Attributes:
        measurement: from D to dR, modes `r` and `rq`.
        process: from D to dQ, modes `q` and `rq`.
        joint: from u to the change of a log variance, mode `joint`.
    """

    measurement: FuzzyNetwork
    process: FuzzyNetwork
    joint: FuzzyNetwork


@dataclass(frozen=True, slots=True)
class Adaptation:
    """Settings of the adaptation of the noise.

    Attributes:
        mode: which covariances are adapted; mode `joint` by `joint.learn`.
        kind: inference of the paper's networks.
        networks: membership functions.
        window_length: N of eq. 13.
        bounds: limits of the adapted variances.
        learning: False keeps the noise as it is.
    """

    mode: AdaptationMode
    kind: InferenceKind
    networks: Networks
    window_length: int
    bounds: NoiseBounds
    learning: bool = True

    @property
    def moves_by_mismatch(self) -> bool:
        """Whether Q or R is adapted by D: the paper's modes."""
        return self.mode in (AdaptationMode.R, AdaptationMode.Q, AdaptationMode.RQ)

    @property
    def learns_measurement_noise(self) -> bool:
        """Whether R is adapted now."""
        return self.learning and self.mode.adapts_measurement_noise


class Adapted(NamedTuple):
    """Noise after one step of adaptation, and the reasons.

    Attributes:
        process_noise: `(2, *batch)` diagonal of Q for the nominal period (m^2, rad^2).
        measurement_noise: `(4, *batch)` diagonal of R, rows as in `Row`.
        mismatch: `(4, *batch)` D of the rows (m^2, m^2, rad^2, rad^2); 0 where there is none yet.
        firing_strength: `(3, 4, *batch)` alpha of the rules I, M, D for the rows of R; in mode `q`
            those of Q, in the rows of x and compass yaw. 0 where nothing was adapted.
        process_firing_strength: `(3, 2, *batch)` the same for Q's distance and rotation.
    """

    process_noise: FloatArray
    measurement_noise: FloatArray
    mismatch: FloatArray
    firing_strength: FloatArray
    process_firing_strength: FloatArray


class Scales(NamedTuple):
    """Change of the noise in use per change of the adapted noise.

    Attributes:
        process: of Q: the filter's period in nominal periods.
        measurement: `(4, *batch)` of R: not 1 where fixes report covariances.
    """

    process: float
    measurement: FloatArray


def adapt(
    adaptation: Adaptation,
    process_noise: FloatArray,
    measurement_noise: FloatArray,
    window: InnovationWindow,
    innovation_variance: FloatArray,
    available: BoolArray,
    heading: FloatArray,
    scales: Scales,
) -> Adapted:
    """Adapt Q, R or both by one step, from the mismatch of S and the window.

    Args:
        adaptation: mode, network and limits.
        process_noise: `(2, *batch)` diagonal of Q for the nominal period (m^2, rad^2).
        measurement_noise: `(4, *batch)` diagonal of R.
        window: the last innovations, this step's included.
        innovation_variance: `(4, *batch)` diagonal of S.
        available: `(4, *batch)` rows measured in this step; only these are learned from.
        heading: `(*batch)` direction in which the step's distance counts [rad].
        scales: the network's output, a change of the noise in use, is divided by these.
    """
    mismatch = np.where(window.counts > 0.0, innovation_variance - mean_square(window), 0.0)
    adapted = Adapted(
        process_noise,
        measurement_noise,
        mismatch,
        firing_strength=np.zeros((RULE_COUNT, *mismatch.shape)),
        process_firing_strength=np.zeros((RULE_COUNT, *process_noise.shape)),
    )
    if not (adaptation.learning and adaptation.moves_by_mismatch):
        return adapted
    ready = available & (window.counts >= SMALLEST_WINDOW_SHARE * adaptation.window_length)
    if adaptation.mode in (AdaptationMode.R, AdaptationMode.RQ):
        adapted = _adapt_measurement_noise(adaptation, adapted, ready, scales.measurement)
    if adaptation.mode in (AdaptationMode.Q, AdaptationMode.RQ):
        adapted = _adapt_process_noise(adaptation, adapted, ready, heading, scales.process)
    if adaptation.mode is AdaptationMode.Q:
        adapted.firing_strength[:, _ROWS_OF_PROCESS] = adapted.process_firing_strength
    return adapted


def _adapt_measurement_noise(
    adaptation: Adaptation, before: Adapted, ready: BoolArray, scale: FloatArray
) -> Adapted:
    network = adaptation.networks.measurement
    inference, dR = _infer(adaptation.kind, network, before.mismatch, network.row_units)
    moved = _moved(
        before.measurement_noise,
        dR / scale,
        adaptation.bounds.measurement_min,
        adaptation.bounds.measurement_max,
    )
    return before._replace(
        measurement_noise=np.where(ready, moved, before.measurement_noise),
        firing_strength=np.where(ready, inference.firing_strength, 0.0),
    )


def _adapt_process_noise(
    adaptation: Adaptation,
    before: Adapted,
    ready: BoolArray,
    heading: FloatArray,
    scale: float,
) -> Adapted:
    network = adaptation.networks.process
    D = before.mismatch
    c2 = np.cos(heading) ** 2
    distance = D[Row.X] * c2 + D[Row.Y] * (1.0 - c2)
    compass_ready, lrf_ready = ready[Row.COMPASS_YAW], ready[Row.LRF_YAW]
    rotation = np.where(compass_ready, D[Row.COMPASS_YAW], D[Row.LRF_YAW])
    known = np.stack([ready[Row.X] & ready[Row.Y], compass_ready | lrf_ready])
    inference, dQ = _infer(
        adaptation.kind,
        network,
        np.stack([distance, rotation]),
        np.array([network.position_unit, network.yaw_unit]),
    )
    moved = _moved(
        before.process_noise,
        dQ / scale,
        adaptation.bounds.process_min,
        adaptation.bounds.process_max,
    )
    return before._replace(
        process_noise=np.where(known, moved, before.process_noise),
        process_firing_strength=np.where(known, inference.firing_strength, 0.0),
    )


def _moved(
    variance: FloatArray, change: FloatArray, smallest: Sequence[float], largest: Sequence[float]
) -> FloatArray:
    moved = np.maximum(variance + change, (1.0 - LARGEST_DECREASE) * variance)
    return np.clip(moved, against(smallest, moved), against(largest, moved))


def _infer(
    kind: InferenceKind, network: FuzzyNetwork, mismatch: FloatArray, unit: FloatArray
) -> tuple[Inference, FloatArray]:
    """Return the inference from mismatches in SI units, and the change in SI units."""
    unit = against(unit, mismatch)
    if kind is InferenceKind.CENTROID:
        inference = infer_centroid(network.sets, mismatch / unit, network.change_limit)
    else:
        inference = infer(network.sets, mismatch / unit)
    return inference, inference.change * unit
