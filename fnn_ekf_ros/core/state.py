"""The filter as one immutable value: what it is, what it remembers, where it starts."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

import numpy as np

from fnn_ekf_ros.core.adaptation import Adaptation, AdaptationMode
from fnn_ekf_ros.core.angles import wrap_angle
from fnn_ekf_ros.core.arrays import FloatArray
from fnn_ekf_ros.core.bank import Bank, Noise
from fnn_ekf_ros.core.gate import OPEN_GATE, Gate, GateState, start_gate
from fnn_ekf_ros.core.joint import JointState, calm_noise, start_joint, without_forecasts
from fnn_ekf_ros.core.joint_filters import (
    JOINT_COUNT,
    NEWER_COUNT,
    write_noise,
)
from fnn_ekf_ros.core.motion import MotionModel
from fnn_ekf_ros.core.pace import Pace, start_pace
from fnn_ekf_ros.core.relocation import Candidate, no_candidate
from fnn_ekf_ros.core.suspects import SUSPECT_COUNT, SUSPECTS, noise_of_suspects
from fnn_ekf_ros.core.window import InnovationWindow, empty_window

PUBLISHED = slice(0, 1)
"""The published filter's place in the bank; those of joint adaptation follow, then the suspects."""
JOINT = slice(1, 1 + JOINT_COUNT)
FORECAST = slice(JOINT.start, JOINT.start + NEWER_COUNT)
"""The filters of joint adaptation that forecasts are made of."""


@dataclass(frozen=True, slots=True)
class FilterModel:
    """What a filter is told once.

    Attributes:
        motion_model: f(x, u).
        period_s: after so long the paper's modes adapt the noise [s].
        process_noise: diagonal of Q for `NOMINAL_PERIOD_S` at the start (m^2, rad^2).
        measurement_noise: diagonal of R at the start, rows as in `Row`; what covariances that a
            fix reports are scaled against.
        adaptation: how Q and R change.
        gate: which readings are too wild to be right.
        suspects: whether to follow who does not fit the others.
    """

    motion_model: MotionModel
    period_s: float
    process_noise: tuple[float, float]
    measurement_noise: tuple[float, float, float, float]
    adaptation: Adaptation
    gate: Gate = OPEN_GATE
    suspects: bool = False

    @property
    def is_joint(self) -> bool:
        """Whether the mode is joint, which has filters of its own."""
        return self.adaptation.mode is AdaptationMode.JOINT

    @property
    def layout(self) -> "Layout":
        """Where in the bank which filters are."""
        return _layout(self.is_joint, self.suspects)


class Layout(NamedTuple):
    """Where in the bank which filters are; a candidate's comes last.

    Attributes:
        compared: those that readings are compared with: the published one, those of joint
            adaptation, the suspects.
        suspects: the last of these; empty without them.
        newer_forecasts: of joint adaptation; empty in the other modes.
        steady: all of them.
        candidate: the rest, if there is one.
    """

    compared: slice
    suspects: slice
    newer_forecasts: slice
    steady: slice
    candidate: slice


@cache
def _layout(joint: bool, suspects: bool) -> Layout:
    first = JOINT.stop if joint else PUBLISHED.stop
    compared = first + (SUSPECT_COUNT if suspects else 0)
    count = compared + (NEWER_COUNT if joint else 0)
    return Layout(
        slice(0, compared),
        slice(first, compared),
        slice(compared, count),
        slice(0, count),
        slice(count, None),
    )


class FilterState(NamedTuple):
    """Everything a filter remembers.

    Attributes:
        bank: the published filter, those of joint adaptation, the suspects, and the candidate.
        noise: that they run on.
        window: the last innovations.
        joint: what joint adaptation remembers; None in the other modes.
        gate: what the gate remembers.
        candidate: where rejected readings say the robot is.
        lead: `(3, *batch)` by how much each of `SUSPECTS` has predicted better of late [nats].
        pace: how long ago what was read.
    """

    bank: Bank
    noise: Noise
    window: InnovationWindow
    joint: JointState | None
    gate: GateState
    candidate: Candidate
    lead: FloatArray
    pace: Pace

    def has_candidate(self, model: FilterModel) -> bool:
        """Return whether the bank has a candidate's filter, its last one."""
        return bool(self.bank.mean.shape[1] > model.layout.steady.stop)

    @property
    def mean(self) -> FloatArray:
        """`(3, *batch)` [x, y, theta] in the map frame (m, m, rad)."""
        return self.bank.mean[:, 0]

    @property
    def covariance(self) -> FloatArray:
        """`(3, 3, *batch)` P."""
        return self.bank.covariance[:, :, 0]

    @property
    def process_noise(self) -> FloatArray:
        """`(2, *batch)` diagonal of Q for `NOMINAL_PERIOD_S` (m^2, rad^2)."""
        return self.noise.process[:, 0]

    @property
    def measurement_noise(self) -> FloatArray:
        """`(4, *batch)` diagonal of R, rows as in `Row`."""
        return self.noise.measurement[:, 0]


def start_filter(
    model: FilterModel,
    mean: FloatArray,
    covariance: FloatArray,
    process_noise: FloatArray | None = None,
    measurement_noise: FloatArray | None = None,
) -> FilterState:
    """Return the state of a filter that has seen nothing but its start.

    Args:
        model: the filter.
        mean: `(3, *batch)` start (m, m, rad).
        covariance: `(3, 3, *batch)` covariance of the start; broadcasts, as do the others.
        process_noise: `(2, *batch)` Q to start from instead of the model's (m^2, rad^2).
        measurement_noise: `(4, *batch)` R to start from instead of the model's.
    """
    batch = mean.shape[1:]
    Q = _for_batch(model.process_noise if process_noise is None else process_noise, batch)
    R = _for_batch(
        model.measurement_noise if measurement_noise is None else measurement_noise, batch
    )
    joint = start_joint(Q, R) if model.is_joint else None
    noise = _noise_of_all(model, Q, R, joint)
    return FilterState(
        bank=_at_pose(noise.process.shape[1], mean, covariance),
        noise=noise,
        window=empty_window(model.adaptation.window_length, batch),
        joint=joint,
        gate=start_gate(batch),
        candidate=no_candidate(batch),
        lead=np.zeros((len(SUSPECTS), *batch)),
        pace=start_pace(batch),
    )


def reset_pose(
    model: FilterModel, state: FilterState, mean: FloatArray, covariance: FloatArray
) -> FilterState:
    """Return the state at another pose; the adapted noise is kept, old innovations are not.

    Args:
        model: the filter.
        state: before.
        mean: `(3, *batch)` pose (m, m, rad).
        covariance: `(3, 3, *batch)` its covariance.
    """
    batch = mean.shape[1:]
    count = model.layout.steady.stop
    return state._replace(
        bank=_at_pose(count, mean, covariance),
        noise=state.noise.filters(slice(0, count)),
        window=empty_window(len(state.window.squares), batch),
        joint=None if state.joint is None else without_forecasts(state.joint),
        gate=start_gate(batch),
        candidate=no_candidate(batch),
        lead=np.zeros_like(state.lead),
    )


def for_mode(model: FilterModel, state: FilterState) -> FilterState:
    """Return the state as the model's mode of adaptation needs it; itself where it does already.

    The noise stays when the mode changes: what an alarm of mode joint adds for a moment does not.
    Into mode joint that noise is its start, with nothing learned yet.
    """
    if model.is_joint == (state.joint is not None):
        return state
    Q, R = state.process_noise, state.measurement_noise
    if state.joint is not None:
        Q, R = lasting_noise(model, state)
    joint = start_joint(Q, R) if model.is_joint else None
    noise = _noise_of_all(model, Q, R, joint)
    return state._replace(
        bank=_at_pose(noise.process.shape[1], state.mean, state.covariance),
        noise=noise,
        joint=joint,
        candidate=no_candidate(state.mean.shape[1:]),
        lead=np.zeros_like(state.lead),
    )


def lasting_noise(model: FilterModel, state: FilterState) -> tuple[FloatArray, FloatArray]:
    """Return Q and R without what an alarm adds for a moment, and within the bounds.

    Args:
        model: has the bounds.
        state: has the noise.
    """
    return usual_noise(model, state.process_noise, state.measurement_noise, state.joint)


def with_noise(model: FilterModel, state: FilterState, Q: FloatArray, R: FloatArray) -> FilterState:
    """Return the state with other noise in use, Q `(2, *batch)` and R `(4, *batch)`.

    The other filters follow; a candidate keeps its own.
    """
    noise = _noise_of_all(model, Q, R, state.joint)
    if state.has_candidate(model):
        noise = _side_by_side([noise, state.noise.filters(model.layout.candidate)])
    return state._replace(noise=noise)


def _noise_of_all(
    model: FilterModel, Q: FloatArray, R: FloatArray, joint: JointState | None
) -> Noise:
    """Return the noise of all filters of the bank but a candidate."""
    layout, batch = model.layout, Q.shape[1:]
    noise = Noise(
        np.empty((len(Q), layout.steady.stop, *batch)),
        np.empty((len(R), layout.steady.stop, *batch)),
    )
    noise.process[:, 0], noise.measurement[:, 0] = Q, R
    if joint is not None:
        write_noise(
            noise.filters(JOINT), joint.process_noise, joint.measurement_noise, joint.log_scale
        )
        newer, first = noise.filters(layout.newer_forecasts), noise.filters(FORECAST)
        newer.process[...], newer.measurement[...] = first.process, first.measurement
    if model.suspects:
        usual = noise_of_suspects(*usual_noise(model, Q, R, joint))
        suspects = noise.filters(layout.suspects)
        suspects.process[...], suspects.measurement[...] = usual.process, usual.measurement
    return noise


def usual_noise(
    model: FilterModel, Q: FloatArray, R: FloatArray, joint: JointState | None
) -> tuple[FloatArray, FloatArray]:
    """Return Q and R in use without what an alarm adds for a moment, and within the bounds."""
    bounds = model.adaptation.bounds
    return bounds.within(Q, R) if joint is None else calm_noise(joint, bounds)


def _side_by_side(parts: Sequence[Noise]) -> Noise:
    return Noise(
        np.concatenate([part.process for part in parts], axis=1),
        np.concatenate([part.measurement for part in parts], axis=1),
    )


def _at_pose(count: int, mean: FloatArray, covariance: FloatArray) -> Bank:
    """Return so many filters at one pose."""
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
