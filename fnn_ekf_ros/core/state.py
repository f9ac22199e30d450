# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The filter as one immutable value: its model, its state, and where it starts."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

import numpy as np

from fnn_ekf_ros.core.adaptation import Adaptation, AdaptationMode
from fnn_ekf_ros.core.angles import wrap_angle
from fnn_ekf_ros.core.arrays import FloatArray
from fnn_ekf_ros.core.bank import Bank, Noise
from fnn_ekf_ros.core.frozen import Unchanged, start_unchanged
from fnn_ekf_ros.core.gate import OPEN_GATE, Gate, GateState, start_gate
from fnn_ekf_ros.core.joint_filters import (
    JOINT_COUNT,
    NEWER_COUNT,
    write_noise,
)
from fnn_ekf_ros.core.joint_state import (
    JointState,
    noise_without_alarms,
    start_joint,
    without_forecasts,
)
from fnn_ekf_ros.core.lasting.lasting import LastingState, moved, start_lasting
from fnn_ekf_ros.core.motion import MotionModel
from fnn_ekf_ros.core.pace import Pace, start_pace
from fnn_ekf_ros.core.relocation import RelocationHypothesis, no_hypothesis
from fnn_ekf_ros.core.rows import POSITION_ROWS
from fnn_ekf_ros.core.suspects import SUSPECT_COUNT, SUSPECTS, noise_of_suspects
from fnn_ekf_ros.core.window import InnovationWindow, empty_window

WHITE_INDEX = 0
"""Index in the bank of the filter that takes all errors for white: the published one where lasting
errors are not followed."""
WHITE = slice(WHITE_INDEX, WHITE_INDEX + 1)
"""This filter alone; those of joint adaptation follow in the bank, then the suspects."""
JOINT = slice(WHITE.stop, WHITE.stop + JOINT_COUNT)
"""The filters of joint adaptation that readings are compared with."""
FORECAST = slice(JOINT.start, JOINT.start + NEWER_COUNT)
"""The filters of joint adaptation that the forecasts start from."""


@dataclass(frozen=True, slots=True)
class FilterModel:
    """The configuration of a filter.

    Attributes:
        motion_model: f(x, u).
        period_s: interval at which the paper's modes adapt the noise [s].
        process_noise: configured diagonal of Q (distance, rotation) for `NOMINAL_PERIOD_S`
            (m^2, rad^2).
        measurement_noise: configured diagonal of R, rows as in `Row` (m^2, m^2, rad^2, rad^2);
            covariances that a fix reports are scaled by the ratio of R in use to it.
        adaptation: how Q and R change.
        gate: which readings are rejected as outliers.
        suspects: whether to run the filters that find which of wheels, compass and fixes does not
            fit the others.
        lasting_errors: whether mode joint follows errors that last.
    """

    motion_model: MotionModel
    period_s: float
    process_noise: tuple[float, float]
    measurement_noise: tuple[float, float, float, float]
    adaptation: Adaptation
    gate: Gate = OPEN_GATE
    suspects: bool = False
    lasting_errors: bool = False

    @property
    def follows_lasting_errors(self) -> bool:
        """Whether the bank of mode joint is accompanied by filters of lasting errors."""
        return self.is_joint and self.lasting_errors

    @property
    def is_joint(self) -> bool:
        """Whether the mode is joint, which has filters of its own in the bank."""
        return self.adaptation.mode is AdaptationMode.JOINT

    @property
    def layout(self) -> "Layout":
        """Places of the filters in the bank."""
        return _layout(self.is_joint, self.suspects)


class Layout(NamedTuple):
    """Places of the filters in the bank; the relocation hypothesis's is the last one.

    Attributes:
        compared: those that readings are compared with: the white filter, those of joint
            adaptation, the suspects.
        suspects: the suspects, the last of these; empty without them.
        newer_forecasts: the newer forecasts of joint adaptation; empty in the other modes.
        steady: all filters but the relocation hypothesis's.
        relocation_hypothesis: the relocation hypothesis's filter; empty without one.
    """

    compared: slice
    suspects: slice
    newer_forecasts: slice
    steady: slice
    relocation_hypothesis: slice


@cache
def _layout(joint: bool, suspects: bool) -> Layout:
    first = JOINT.stop if joint else WHITE.stop
    compared = first + (SUSPECT_COUNT if suspects else 0)
    count = compared + (NEWER_COUNT if joint else 0)
    return Layout(
        compared=slice(0, compared),
        suspects=slice(first, compared),
        newer_forecasts=slice(compared, count),
        steady=slice(0, count),
        relocation_hypothesis=slice(count, None),
    )


class FilterState(NamedTuple):
    """The complete state of a filter.

    Attributes:
        bank: all filters, as `Layout` says.
        noise: Q and R of these.
        window: the last innovations.
        joint: the state of joint adaptation; None in the other modes.
        gate: the gate's memory.
        relocation_hypothesis: where rejected readings show the robot.
        lead: `(3, *batch)` recent log likelihood ratio of each of `SUSPECTS` [nats].
        pace: times since the last readings.
        unchanged: the last readings that did not change, by which frozen sensors are found.
        lasting: the filters of lasting errors, whose mixture is then the estimate; None without.
    """

    bank: Bank
    noise: Noise
    window: InnovationWindow
    joint: JointState | None
    gate: GateState
    relocation_hypothesis: RelocationHypothesis
    lead: FloatArray
    pace: Pace
    unchanged: Unchanged
    lasting: LastingState | None = None

    def has_relocation_hypothesis(self, model: FilterModel) -> bool:
        """Return whether the bank has the relocation hypothesis's filter, its last one."""
        return bool(self.bank.mean.shape[1] > model.layout.steady.stop)

    @property
    def mean(self) -> FloatArray:
        """`(3, *batch)` [x, y, theta] in the map frame (m, m, rad)."""
        return self.bank.mean[:, WHITE_INDEX] if self.lasting is None else self.lasting.mean

    @property
    def covariance(self) -> FloatArray:
        """`(3, 3, *batch)` P."""
        if self.lasting is not None:
            return self.lasting.covariance
        return self.bank.covariance[:, :, WHITE_INDEX]

    @property
    def process_noise(self) -> FloatArray:
        """`(2, *batch)` diagonal of Q for `NOMINAL_PERIOD_S` (m^2, rad^2)."""
        return self.noise.process[:, WHITE_INDEX]

    @property
    def measurement_noise(self) -> FloatArray:
        """`(4, *batch)` diagonal of R, rows as in `Row`."""
        return self.noise.measurement[:, WHITE_INDEX]


def start_filter(
    model: FilterModel,
    mean: FloatArray,
    covariance: FloatArray,
    process_noise: FloatArray | None = None,
    measurement_noise: FloatArray | None = None,
    *,
    from_readings: bool = False,
    log_weight: FloatArray | None = None,
) -> FilterState:
    """Return the state of a filter before the first reading.

    Args:
        model: the filter.
        mean: `(3, *batch)` pose at the start (m, m, rad).
        covariance: `(3, 3, *batch)` its covariance; broadcasts, as do the following.
        process_noise: `(2, *batch)` Q at the start; None: the model's (m^2, rad^2).
        measurement_noise: `(4, *batch)` R at the start; None: the model's.
        from_readings: whether the pose is of a fix and a yaw, whose lasting errors are then in it.
        log_weight: `(H, M, *batch)` of the members of lasting errors; None: the prior's.
    """
    batch = mean.shape[1:]
    Q = _for_batch(model.process_noise if process_noise is None else process_noise, batch)
    R = _for_batch(
        model.measurement_noise if measurement_noise is None else measurement_noise, batch
    )
    joint = start_joint(Q, R) if model.is_joint else None
    lasting = _start_lasting(model, mean, covariance, R, from_readings, log_weight)
    noise = _noise_of_all(model, Q, R, joint, lasting)
    return FilterState(
        bank=_at_pose(noise.process.shape[1], mean, covariance),
        noise=noise,
        window=empty_window(model.adaptation.window_length, batch),
        joint=joint,
        gate=start_gate(batch),
        relocation_hypothesis=no_hypothesis(batch),
        lead=np.zeros((len(SUSPECTS), *batch)),
        pace=start_pace(batch),
        unchanged=start_unchanged(batch),
        lasting=lasting,
    )


def reset_pose(
    model: FilterModel, state: FilterState, mean: FloatArray, covariance: FloatArray
) -> FilterState:
    """Return the state at another pose, with the adapted noise and without old innovations.

    Args:
        model: the filter.
        state: before.
        mean: `(3, *batch)` pose (m, m, rad).
        covariance: `(3, 3, *batch)` its covariance.
    """
    batch = mean.shape[1:]
    count = model.layout.steady.stop
    bank, lasting = _at_pose(count, mean, covariance), state.lasting
    return state._replace(
        bank=bank,
        noise=state.noise.filters(slice(0, count)),
        window=empty_window(len(state.window.squares), batch),
        joint=None if state.joint is None else without_forecasts(state.joint),
        gate=start_gate(batch),
        relocation_hypothesis=no_hypothesis(batch),
        lead=np.zeros_like(state.lead),
        lasting=None if lasting is None else moved(lasting, bank.filters(WHITE)),
    )


def for_mode(model: FilterModel, state: FilterState) -> FilterState:
    """Return the state for the model's mode of adaptation; the same state if it is of that mode.

    When the mode changes, the adapted noise is kept, without the temporary increase by alarms of
    mode joint. Mode joint starts from that noise, with nothing learned yet.
    """
    if model.is_joint == (state.joint is not None):
        return state
    Q, R = state.process_noise, state.measurement_noise
    if state.joint is not None:
        Q, R = noise_without_alarms(state.joint, model.adaptation.bounds)
    joint = start_joint(Q, R) if model.is_joint else None
    lasting = _start_lasting(model, state.mean, state.covariance, R)
    noise = _noise_of_all(model, Q, R, joint, lasting)
    return state._replace(
        bank=_at_pose(noise.process.shape[1], state.mean, state.covariance),
        noise=noise,
        joint=joint,
        relocation_hypothesis=no_hypothesis(state.mean.shape[1:]),
        lead=np.zeros_like(state.lead),
        lasting=lasting,
    )


def _start_lasting(
    model: FilterModel,
    mean: FloatArray,
    covariance: FloatArray,
    R: FloatArray,
    from_readings: bool = False,
    log_weight: FloatArray | None = None,
) -> LastingState | None:
    """Return the filters of lasting errors at a pose; None where these are not followed."""
    if not model.follows_lasting_errors:
        return None
    return start_lasting(
        _at_pose(1, mean, covariance), R, from_readings=from_readings, log_weight=log_weight
    )


def with_noise(model: FilterModel, state: FilterState, Q: FloatArray, R: FloatArray) -> FilterState:
    """Return the state with other noise in use, Q `(2, *batch)` and R `(4, *batch)`.

    The noise of the other filters follows from it; the relocation hypothesis keeps its own.
    """
    noise = _noise_of_all(model, Q, R, state.joint, state.lasting)
    if state.has_relocation_hypothesis(model):
        noise = _side_by_side([noise, state.noise.filters(model.layout.relocation_hypothesis)])
    return state._replace(noise=noise)


def _noise_of_all(
    model: FilterModel,
    Q: FloatArray,
    R: FloatArray,
    joint: JointState | None,
    lasting: LastingState | None,
) -> Noise:
    """Return the noise of all filters of the bank but the relocation hypothesis's.

    The suspects take fix errors that are believed to last for noise, which accuses nobody.
    """
    layout, batch = model.layout, Q.shape[1:]
    noise = Noise(
        np.empty((len(Q), layout.steady.stop, *batch)),
        np.empty((len(R), layout.steady.stop, *batch)),
    )
    noise.process[:, WHITE_INDEX], noise.measurement[:, WHITE_INDEX] = Q, R
    if joint is not None:
        write_noise(
            noise.filters(JOINT), joint.process_noise, joint.measurement_noise, joint.log_scale
        )
        newer, first = noise.filters(layout.newer_forecasts), noise.filters(FORECAST)
        newer.process[...], newer.measurement[...] = first.process, first.measurement
    if model.suspects:
        process, measurement = persistent_noise(model, Q, R, joint)
        if lasting is not None:
            measurement = measurement.copy()
            measurement[list(POSITION_ROWS)] += lasting.believed_fix_variance
        of_suspects = noise_of_suspects(process, measurement)
        suspects = noise.filters(layout.suspects)
        suspects.process[...] = of_suspects.process
        suspects.measurement[...] = of_suspects.measurement
    return noise


def persistent_noise(
    model: FilterModel, Q: FloatArray, R: FloatArray, joint: JointState | None
) -> tuple[FloatArray, FloatArray]:
    """Return Q and R without the temporary increase by alarms of mode joint, within the bounds.

    Args:
        model: has the bounds.
        Q: `(2, *batch)` in use (m^2, rad^2).
        R: `(4, *batch)` in use (m^2, m^2, rad^2, rad^2).
        joint: the state of joint adaptation; None in the other modes, which have no alarms.
    """
    bounds = model.adaptation.bounds
    return bounds.within(Q, R) if joint is None else noise_without_alarms(joint, bounds)


def _side_by_side(parts: Sequence[Noise]) -> Noise:
    return Noise(
        np.concatenate([part.process for part in parts], axis=1),
        np.concatenate([part.measurement for part in parts], axis=1),
    )


def _at_pose(count: int, mean: FloatArray, covariance: FloatArray) -> Bank:
    """Return a number of filters at one pose."""
    batch = mean.shape[1:]
    P = covariance.reshape(3, 3, *(1,) * (mean.ndim + 1 - covariance.ndim), *covariance.shape[2:])
    mean = np.concatenate([mean[:2], wrap_angle(mean[2:])])
    return Bank(
        np.broadcast_to(mean[:, None], (3, count, *batch)),
        np.broadcast_to(P[:, :, None], (3, 3, count, *batch)),
    )


def _for_batch(values: Sequence[float] | FloatArray, batch: tuple[int, ...]) -> FloatArray:
    """Return values `(n,)` or `(n, *batch)` for each of a batch."""
    array = np.asarray(values, dtype=np.float64)
    array = array.reshape(len(array), *(1,) * (len(batch) + 1 - array.ndim), *array.shape[1:])
    return np.broadcast_to(array, (len(array), *batch))
