"""Adapting the noise covariances by the fuzzy neural network (Nguyen et al., eqs. 13-16).

    D = S - C_hat                     mismatch, row by row                      (14)
    R <- R + dR(D)                    mode `r`                                  (15)
    Q <- Q + dQ(D)                    mode `q`                                  (16)
        D_forward = D_x cos^2(theta) + D_y sin^2(theta),  D_heading = D_theta

S is the filter's own H (A P A' + W Q W') H' + R, which is what the paper's (16) becomes when its
A P A' + Q (3x3 plus 2x2) is read as it must be.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import NamedTuple

import numpy as np

from fnn_ekf_ros.core.arrays import MEASUREMENT_SIZE, BoolArray, FloatArray, Row
from fnn_ekf_ros.core.bounds import NoiseBounds
from fnn_ekf_ros.core.fuzzy import FuzzySets, Inference, infer, infer_centroid
from fnn_ekf_ros.core.window import InnovationWindow, mean_square

LARGEST_DECREASE = 0.75
"""Part of a variance one step may take away. The paper's rule overshoots (its slope is 1.5): from
a start that is far too large R + dR would be negative, and a filter that runs even one step on
the smallest allowed R throws its covariance away."""

SMALLEST_WINDOW_SHARE = 1.0 / 3.0
"""Part of the window a row must have filled before it teaches: a third of 45 innovations shows a
start that is wrong by 25 well enough, and waiting for all of them costs twice as much."""

POSITION_ROWS = slice(Row.X, Row.COMPASS_YAW)
YAW_ROWS = slice(Row.COMPASS_YAW, MEASUREMENT_SIZE)


class AdaptationMode(StrEnum):
    """Which noise covariance the network moves."""

    NONE = "none"
    R = "r"
    Q = "q"
    JOINT = "joint"


class InferenceKind(StrEnum):
    """How the rules' consequents become one number."""

    TSUKAMOTO = "tsukamoto"
    CENTROID = "centroid"


@dataclass(frozen=True, slots=True)
class FuzzyNetwork:
    """Membership functions with the units they are given in.

    Attributes:
        sets: the membership functions.
        position_unit: size of the sets' unit for position variances [m^2]; 1e-6 is mm^2.
        yaw_unit: size of the sets' unit for yaw variances [rad^2]; 1e-6 is mrad^2.
        change_limit: half width of the universe of the consequents [the sets' unit]; used by
            centroid defuzzification only.
    """

    sets: FuzzySets
    position_unit: float
    yaw_unit: float
    change_limit: float


@dataclass(frozen=True, slots=True)
class Adaptation:
    """How the noise is adapted.

    Attributes:
        mode: which covariance; `joint` is run by `joint.adapt_jointly`.
        kind: inference of the network.
        network: membership functions; the paper's two modes use one set for all axes.
        window_length: N of eq. 13; a row teaches once `SMALLEST_WINDOW_SHARE` of it is filled.
        bounds: limits of the adapted variances.
        learning: False holds the noise where it is.
    """

    mode: AdaptationMode
    kind: InferenceKind
    network: FuzzyNetwork
    window_length: int
    bounds: NoiseBounds
    learning: bool = True

    @property
    def learns_measurement_noise(self) -> bool:
        """Whether R moves."""
        return self.learning and self.mode in (AdaptationMode.R, AdaptationMode.JOINT)


class Adapted(NamedTuple):
    """Noise after one step of adaptation, and why.

    Attributes:
        process_noise: `(..., 2)` diagonal of Q for the nominal period (m^2, rad^2).
        measurement_noise: `(..., 4)` diagonal of R, rows as in `Row`.
        mismatch: `(..., 4)` D of the rows (m^2, m^2, rad^2, rad^2); 0 where there is none yet.
        firing_strength: `(..., 4, 3)` alpha of the rules I, M, D; mode `q` uses rows 0
            (forward) and 2 (heading). 0 where nothing was adapted.
    """

    process_noise: FloatArray
    measurement_noise: FloatArray
    mismatch: FloatArray
    firing_strength: FloatArray


class Scales(NamedTuple):
    """By how much the noise in use moves when the noise that is adapted moves by one.

    Attributes:
        process: of Q, whose nominal period may not be the filter's.
        measurement: `(..., 4)` of R, where sensors report covariances of their own.
    """

    process: float
    measurement: FloatArray


UNIT_SCALES = Scales(1.0, np.ones(MEASUREMENT_SIZE))


def adapt(
    adaptation: Adaptation,
    process_noise: FloatArray,
    measurement_noise: FloatArray,
    window: InnovationWindow,
    innovation_variance: FloatArray,
    available: BoolArray,
    heading: FloatArray,
    scales: Scales = UNIT_SCALES,
) -> Adapted:
    """Move Q or R one step by what the window says about S.

    Args:
        adaptation: mode, network and limits.
        process_noise: `(..., 2)` diagonal of Q for the nominal period (m^2, rad^2).
        measurement_noise: `(..., 4)` diagonal of R.
        window: the last innovations, this step's included.
        innovation_variance: `(..., 4)` diagonal of S.
        available: `(..., 4)` rows measured in this step; only they teach anything.
        heading: `(...)` heading the step's way is projected on [rad].
        scales: the network's output is a change of the noise in use; it is divided by these.
    """
    ready = available & (window.counts >= SMALLEST_WINDOW_SHARE * adaptation.window_length)
    mismatch = np.where(window.counts > 0.0, innovation_variance - mean_square(window), 0.0)
    unchanged = Adapted(process_noise, measurement_noise, mismatch, np.zeros((*mismatch.shape, 3)))
    if not adaptation.learning:
        return unchanged
    if adaptation.mode is AdaptationMode.R:
        return _adapt_measurement_noise(adaptation, unchanged, ready, scales.measurement)
    if adaptation.mode is AdaptationMode.Q:
        return _adapt_process_noise(adaptation, unchanged, ready, heading, scales.process)
    return unchanged


def _adapt_measurement_noise(
    adaptation: Adaptation, before: Adapted, ready: BoolArray, scale: FloatArray
) -> Adapted:
    inference, change = _infer(adaptation, before.mismatch)
    R = np.where(
        ready,
        _moved(
            before.measurement_noise,
            change / scale,
            adaptation.bounds.measurement_min,
            adaptation.bounds.measurement_max,
        ),
        before.measurement_noise,
    )
    return before._replace(
        measurement_noise=R,
        firing_strength=np.where(ready[..., None], inference.firing_strength, 0.0),
    )


def _adapt_process_noise(
    adaptation: Adaptation,
    before: Adapted,
    ready: BoolArray,
    heading: FloatArray,
    scale: float,
) -> Adapted:
    D = before.mismatch
    c2 = np.cos(heading) ** 2
    forward = D[..., Row.X] * c2 + D[..., Row.Y] * (1.0 - c2)
    forward_ready = ready[..., Row.X] & ready[..., Row.Y]
    compass_ready, lrf_ready = ready[..., Row.COMPASS_YAW], ready[..., Row.LRF_YAW]
    yaw = np.where(compass_ready, D[..., Row.COMPASS_YAW], D[..., Row.LRF_YAW])
    rows = np.stack([forward, np.zeros_like(forward), yaw, np.zeros_like(yaw)], axis=-1)
    row_ready = np.stack(
        [
            forward_ready,
            np.zeros_like(forward_ready),
            compass_ready | lrf_ready,
            np.zeros_like(forward_ready),
        ],
        axis=-1,
    )
    inference, change = _infer(adaptation, rows)
    used = [Row.X, Row.COMPASS_YAW]
    Q = np.where(
        row_ready[..., used],
        _moved(
            before.process_noise,
            change[..., used] / scale,
            adaptation.bounds.process_min,
            adaptation.bounds.process_max,
        ),
        before.process_noise,
    )
    return before._replace(
        process_noise=Q,
        firing_strength=np.where(row_ready[..., None], inference.firing_strength, 0.0),
    )


def _moved(
    variance: FloatArray, change: FloatArray, smallest: Sequence[float], largest: Sequence[float]
) -> FloatArray:
    moved = np.maximum(variance + change, (1.0 - LARGEST_DECREASE) * variance)
    return np.clip(moved, smallest, largest)


def _infer(adaptation: Adaptation, mismatch: FloatArray) -> tuple[Inference, FloatArray]:
    """Run the network on rows in SI units; returns its output and the change in SI units."""
    network = adaptation.network
    unit = np.empty(MEASUREMENT_SIZE)
    unit[POSITION_ROWS] = network.position_unit
    unit[YAW_ROWS] = network.yaw_unit
    if adaptation.kind is InferenceKind.CENTROID:
        inference = infer_centroid(network.sets, mismatch / unit, network.change_limit)
    else:
        inference = infer(network.sets, mismatch / unit)
    return inference, inference.change * unit
