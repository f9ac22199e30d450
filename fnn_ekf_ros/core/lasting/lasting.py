# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Errors that last: filters with hypotheses about them, and the estimate that follows.

Errors of fixes and compasses keep their sign for seconds to minutes. A filter that takes them for
white is confirmed by each fix in the error of the one before. Here ten members assume lasting
errors of different size (`members`), are corrected by what one gate accepts (`comparison`,
`correction`), and are weighed by simulated outages (`outages`); a witness finds a compass that is
off by a constant (`compass_offset`). The estimate is the mixture of the members,

    x = sum_k w_k x_k,    P = sum_k w_k (P_k + (x_k - x) (x_k - x)')

Q and R are those that joint adaptation learns; they describe what of the errors is white.
"""

from typing import NamedTuple

import numpy as np

from fnn_ekf_ros.core.angles import wrap_angle
from fnn_ekf_ros.core.arrays import STATE_SIZE, BoolArray, FloatArray, Row
from fnn_ekf_ros.core.bank import Bank, Noise, Readings
from fnn_ekf_ros.core.evidence import log_likelihood
from fnn_ekf_ros.core.lasting.augmented import (
    AUGMENTED_SIZE,
    POSE,
    Component,
    at_pose,
    kept_by_errors,
    predict_augmented,
)
from fnn_ekf_ros.core.lasting.challenger import opposite_of_witness
from fnn_ekf_ros.core.lasting.comparison import Comparison, Correcting, compare
from fnn_ekf_ros.core.lasting.compass_offset import (
    CompassOffset,
    after_compass,
    after_fix,
    later,
    offset_of,
    reconsidered,
    start_offset,
    suspected_with,
)
from fnn_ekf_ros.core.lasting.correction import correct_robustly, outlier_share_after
from fnn_ekf_ros.core.lasting.members import (
    COPIES,
    ERROR_TIME_S,
    FIXES_LAST,
    HORIZONS_S,
    LASTING_SHARE,
    MEMBER_COUNT,
    OF_MEMBERS,
    OF_OFFSET,
    PHASES,
    PROCESS,
    SQUARED_FACTORS,
    WITNESS,
    WITNESSES,
    error_variances,
)
from fnn_ekf_ros.core.lasting.outages import (
    Outages,
    advanced,
    scored,
    start_outages,
    weights_of,
)
from fnn_ekf_ros.core.motion import MotionModel
from fnn_ekf_ros.core.pace import NOMINAL_PERIOD_S

UNKNOWN_VARIANCE = 1e4
"""Variance of a yaw offset that is not known, as good as no reading [rad^2]."""
_CYCLES = (len(HORIZONS_S), PHASES, MEMBER_COUNT)
_UNKNOWN_SHARE = float(weights_of(start_outages(()).log_weight) @ FIXES_LAST)
"""Weight of the members whose fix errors last before anything is known, 0.09."""
_POSITION_ROWS = np.array(2.0)


class LastingState(NamedTuple):
    """The filters of lasting errors and what they have learned.

    Attributes:
        bank: the filters, as in `members`; `(7, F, *batch)`, state as in `augmented`.
        fix_variance: `(2, *batch)` R of x and y of the last fix, which the errors scale with [m^2].
        outages: clocks, scores and log weights.
        weights: `(M, *batch)` of the members.
        outlier_share: `(*batch)` share of outliers among the fixes.
        offset: what is believed of the compass's offset.
        compass_seen: `(*batch)` whether a compass has been read.
        mean: `(3, *batch)` estimate (m, m, rad).
        covariance: `(3, 3, *batch)` its covariance.
    """

    bank: Bank
    fix_variance: FloatArray
    outages: Outages
    weights: FloatArray
    outlier_share: FloatArray
    offset: CompassOffset
    compass_seen: BoolArray
    mean: FloatArray
    covariance: FloatArray

    @property
    def fixes_last(self) -> FloatArray:
        """`(*batch)` weight of the members whose fix errors last."""
        return np.asarray((self.weights.T @ FIXES_LAST).T)

    @property
    def rejections_agree(self) -> FloatArray:
        """`(*batch)` how much rejected fixes that agree may have one cause: 0 to 1.

        0 up to the weight that lasting fix errors have before anything is known of them; it grows
        with it to 1.
        """
        excess = (self.fixes_last - _UNKNOWN_SHARE) / (1.0 - _UNKNOWN_SHARE)
        return np.asarray(np.maximum(excess, 0.0))

    @property
    def believed_fix_variance(self) -> FloatArray:
        """`(2, *batch)` variance of the lasting errors of x and y [m^2].

        0 unless lasting errors have most of the weight: the prior alone makes none believed.
        """
        factor = np.asarray((self.weights.T @ SQUARED_FACTORS).T)
        return np.where(self.fixes_last > LASTING_SHARE, factor, 0.0) * self.fix_variance

    @property
    def correcting(self) -> Correcting:
        """The offset that readings are taken without."""
        believed, fix_yaw = self.offset.believed, np.where(self.compass_seen, 0.0, 1.0)
        unknown = self.offset.unknown
        if not (believed | unknown).any():
            none = np.zeros(believed.shape)
            return Correcting(none, none, fix_yaw)
        offset, variance = offset_of(self.bank)
        known = np.where(believed, variance, 0.0)
        return Correcting(
            offset=np.where(believed, offset, 0.0),
            variance=np.where(unknown, UNKNOWN_VARIANCE, known),
            fix_yaw=fix_yaw,
        )


class Used(NamedTuple):
    """Lasting errors after readings.

    Attributes:
        state: after them.
        restart: `(*batch)` whether all other filters start again from the witness's pose.
    """

    state: LastingState
    restart: BoolArray


def start_lasting(
    pose: Bank,
    measurement_noise: FloatArray,
    *,
    from_readings: bool,
    log_weight: FloatArray | None = None,
) -> LastingState:
    """Return the state at the start.

    Args:
        pose: `(3, 1, *batch)`.
        measurement_noise: `(4, *batch)` R, rows as in `Row`.
        from_readings: whether the pose is of a fix and a yaw, whose errors are then in it.
        log_weight: `(H, M, *batch)` log weights of the members; None: the prior's.
    """
    batch = measurement_noise.shape[1:]
    fix_variance = measurement_noise[: STATE_SIZE - 1]
    outages = start_outages(batch, log_weight)
    no = np.zeros(batch, dtype=np.bool_)
    state = LastingState(
        bank=opposite_of_witness(
            at_pose(pose, error_variances(fix_variance), from_readings=from_readings)
        ),
        fix_variance=fix_variance,
        outages=outages,
        weights=weights_of(outages.log_weight),
        outlier_share=np.zeros(batch),
        offset=start_offset(batch, from_readings=from_readings),
        compass_seen=no,
        mean=pose.mean[:, 0],
        covariance=pose.covariance[:, :, 0],
    )
    return _estimated(state, state.bank)


def moved(state: LastingState, pose: Bank) -> LastingState:
    """Return the state at another pose `(3, 1, *batch)`, with what was learned.

    The errors are as uncertain as in the long run, but for the compass's offset, which is kept.
    """
    bank = at_pose(pose, error_variances(state.fix_variance), from_readings=False)
    k = Component.YAW_OFFSET
    bank.mean[k, WITNESS], bank.covariance[k, k, WITNESS] = offset_of(state.bank)
    lead = np.minimum(state.offset.challenger, 0.0)  # of another challenger than the one to come
    state = state._replace(offset=state.offset._replace(challenger=lead))
    return _at_new_pose(state, opposite_of_witness(bank))


def moved_to_witness(state: LastingState) -> LastingState:
    """Return the state with all filters at the witness's pose; it and its challenger are kept."""
    pose, covariance = witness_pose(state)
    at_witness = Bank(pose[:, None], covariance[:, :, None])
    bank = at_pose(at_witness, error_variances(state.fix_variance), from_readings=False)
    bank.mean[:, WITNESSES] = state.bank.mean[:, WITNESSES]
    bank.covariance[:, :, WITNESSES] = state.bank.covariance[:, :, WITNESSES]
    return _at_new_pose(state, bank)


def witness_pose(state: LastingState) -> tuple[FloatArray, FloatArray]:
    """Return mean `(3, *batch)` and covariance `(3, 3, *batch)` of the witness's pose."""
    return state.bank.mean[POSE, WITNESS], state.bank.covariance[POSE, POSE, WITNESS]


def _at_new_pose(state: LastingState, bank: Bank) -> LastingState:
    outages = start_outages(state.outlier_share.shape, state.outages.log_weight)
    return _estimated(state._replace(outages=outages), bank)


def predict_lasting(
    model: MotionModel,
    state: LastingState,
    control: FloatArray,
    process_noise: FloatArray,
    persistent_noise: FloatArray,
    duration_s: float,
) -> LastingState:
    """Return the state after a step of the wheels; the estimate is that of before.

    Args:
        model: f(x, u).
        state: before the step.
        control: `(2, *batch)` [dS, dtheta] (m, rad).
        process_noise: `(2, *batch)` diagonal of Q for this step (m^2, rad^2).
        persistent_noise: `(2, *batch)` the same without alarms. Alarms do not count for the filters
            that tell the offset: a wrong yaw raises them, and they would then follow the compass.
        duration_s: its duration [s].
    """
    kept = kept_by_errors(duration_s, ERROR_TIME_S).behind(process_noise.ndim)
    added = (1.0 - kept * kept) * error_variances(state.fix_variance)
    factors = PROCESS.behind(process_noise.ndim - 1)
    Q = process_noise[:, None] * factors
    Q[:, OF_OFFSET] = persistent_noise[:, None] * factors[:, OF_OFFSET]
    bank = predict_augmented(model, state.bank, control, Q, kept, added)
    return state._replace(bank=bank, offset=later(state.offset, duration_s))


def with_compass(state: LastingState, readings: Readings, noise: Noise) -> LastingState:
    """Return the state that knows of readings to come: whether there is a compass, or one is off.

    Without a compass the yaw of fixes takes its place.

    Args:
        state: before them.
        readings: z, as the sensors sent it.
        noise: R of the readings without lasting errors, of one filter.
    """
    z, available, R = readings.values, readings.available, noise.measurement[:, 0]
    seen = state.compass_seen | available[Row.COMPASS_YAW]
    yaw, yaw_noise, read = (
        np.where(seen, each[Row.COMPASS_YAW], each[Row.LRF_YAW]) for each in (z, R, available)
    )
    offset, bank = suspected_with(state.offset, state.bank, yaw, yaw_noise, read)
    return state._replace(bank=bank, compass_seen=seen, offset=offset)


def compare_with_members(state: LastingState, readings: Readings, noise: Noise) -> Comparison:
    """Compare readings with the filters; noise: R without lasting errors, of one filter."""
    return compare(state.bank, state.weights, state.correcting, readings, noise)


def without_offset(state: LastingState, measurement: FloatArray) -> FloatArray:
    """Return z `(4, *batch)` as filters that know no offset expect it."""
    correcting = state.correcting
    if not correcting.offset.any():
        return measurement
    z = measurement.copy()
    z[Row.COMPASS_YAW] = wrap_angle(z[Row.COMPASS_YAW] - correcting.offset)
    z[Row.LRF_YAW] = wrap_angle(z[Row.LRF_YAW] - correcting.fix_yaw * correcting.offset)
    return z


def after_readings(
    state: LastingState,
    seen: Comparison,
    noise: Noise,
    accepted: BoolArray,
    read: BoolArray,
    moves: BoolArray,
    duration_s: float,
) -> Used:
    """Correct the filters by readings, and learn from them how much of the errors lasts.

    Args:
        state: before them.
        seen: the readings.
        noise: R without lasting errors, of one filter.
        accepted: `(4, *batch)` rows that the gate accepts.
        read: `(4, *batch)` rows that were measured.
        moves: `(*batch)` whether the wheels move. While they do not they may be silent: then what
            does not fit is no outlier, and no compass was turned.
        duration_s: since the instant before [s].
    """
    fixed = accepted[Row.X]
    share = outlier_share_after(state.outlier_share, seen, fixed & moves)
    rejected_yaw = (read & ~accepted)[Row.COMPASS_YAW]
    bank = correct_robustly(state.bank, seen, noise, accepted, moves, share, rejected_yaw)
    outages, offset = state.outages, state.offset
    if read[Row.X].any():
        nis, determinant = seen.position_nis[OF_OFFSET], seen.position_determinant[OF_OFFSET]
        offset, bank = after_fix(offset, bank, nis, determinant, read[Row.X] & moves)
    if fixed.any():
        nis, determinant = seen.position_nis[COPIES], seen.position_determinant[COPIES]
        likelihood = log_likelihood(nis, determinant, _POSITION_ROWS)
        outages = scored(outages, likelihood.reshape(*_CYCLES, *fixed.shape), fixed)
    offset, bank = after_compass(
        offset,
        bank,
        seen.witness_innovation[0],
        np.sqrt(seen.witness_variance[0]),
        read[Row.COMPASS_YAW] & moves,
        duration_s / NOMINAL_PERIOD_S,
        state.fixes_last,
    )
    offset, restart = reconsidered(offset, bank, duration_s)
    state = state._replace(
        bank=bank,
        fix_variance=np.where(fixed, noise.measurement[: STATE_SIZE - 1, 0], state.fix_variance),
        outages=outages,
        outlier_share=share,
        offset=offset,
    )
    return Used(state, restart)


def after_instant(
    state: LastingState, moves: BoolArray, duration_s: float, weighs: BoolArray
) -> LastingState:
    """Return the state after an instant, with its estimate.

    Args:
        state: after the readings, if there are any.
        moves: `(*batch)` whether the robot moves; outages last only while it does.
        duration_s: since the instant before [s].
        weighs: `(*batch)` whether outages change the weights.
    """
    outages, renewed, weighed = advanced(state.outages, np.where(moves, duration_s, 0.0), weighs)
    bank = _with_new_copies(state.bank, renewed) if renewed.any() else state.bank
    weights = weights_of(outages.log_weight) if weighed else state.weights
    return _estimated(state._replace(outages=outages, weights=weights), bank)


def _with_new_copies(bank: Bank, renewed: BoolArray) -> Bank:
    """Return the filters; copies are made anew from their members where `(H, P, *batch)`."""
    batch = renewed.shape[2:]
    mean, covariance = bank.mean.copy(), bank.covariance.copy()
    # Copies are one block of memory along their axis; the new shape is of the same numbers.
    copies = mean[:, COPIES].reshape(AUGMENTED_SIZE, *_CYCLES, *batch)
    of_members = bank.mean[:, None, None, OF_MEMBERS]
    mean[:, COPIES] = np.where(renewed[:, :, None], of_members, copies).reshape(
        AUGMENTED_SIZE, -1, *batch
    )
    copies = covariance[:, :, COPIES].reshape(AUGMENTED_SIZE, AUGMENTED_SIZE, *_CYCLES, *batch)
    of_members = bank.covariance[:, :, None, None, OF_MEMBERS]
    covariance[:, :, COPIES] = np.where(renewed[:, :, None], of_members, copies).reshape(
        AUGMENTED_SIZE, AUGMENTED_SIZE, -1, *batch
    )
    return Bank(mean, covariance)


def _estimated(state: LastingState, bank: Bank) -> LastingState:
    """Return the state with these filters and the estimate of their mixture."""
    w, first = state.weights, bank.mean[POSE, :1]
    apart = bank.mean[POSE, OF_MEMBERS] - first
    apart[Component.YAW] = wrap_angle(apart[Component.YAW])
    shift = (w * apart).sum(axis=1)
    apart -= shift[:, None]
    spread = bank.covariance[POSE, POSE, OF_MEMBERS] + apart[:, None] * apart[None]
    mean = first[:, 0] + shift
    mean[Component.YAW] = wrap_angle(mean[Component.YAW])
    return state._replace(bank=bank, mean=mean, covariance=(w * spread).sum(axis=2))
