# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Lasting errors in the filter's step: between the wheels, the gate and the other filters."""

from typing import NamedTuple

import numpy as np

from fnn_ekf_ros.core.arrays import BoolArray, Constant, FloatArray, Row, select
from fnn_ekf_ros.core.bank import Noise, Readings, noise_of_readings
from fnn_ekf_ros.core.evidence import Scale
from fnn_ekf_ros.core.gate import rows_of
from fnn_ekf_ros.core.gated import Gated
from fnn_ekf_ros.core.joint import STANDSTILL
from fnn_ekf_ros.core.joint_filters import SETTLED
from fnn_ekf_ros.core.joint_state import noise_with_part_of_alarms, noise_without_alarms
from fnn_ekf_ros.core.lasting.comparison import Comparison
from fnn_ekf_ros.core.lasting.lasting import (
    after_instant,
    after_readings,
    compare_with_members,
    moved_to_witness,
    predict_lasting,
    with_compass,
    without_offset,
    witness_pose,
)
from fnn_ekf_ros.core.lasting.outages import MEMORY_NEEDED
from fnn_ekf_ros.core.pace import NOMINAL_PERIOD_S
from fnn_ekf_ros.core.results import Epoch
from fnn_ekf_ros.core.state import WHITE, FilterModel, FilterState, reset_pose

_STANDSTILL = Constant(STANDSTILL)


class MembersAtInstant(NamedTuple):
    """The members at an instant with readings.

    Attributes:
        noise: R of the readings without lasting errors, of one filter.
        seen: the readings against the members.
    """

    noise: Noise
    seen: Comparison


def lasting_at_instant(
    model: FilterModel, state: FilterState, epoch: Epoch
) -> tuple[FilterState, Noise | None]:
    """Return the state with the filters of lasting errors at the end of an epoch, and their noise.

    The noise is that without lasting errors, of one filter; None where they are not followed.
    """
    if state.lasting is None or state.joint is None:
        return state, None
    noise = persistent = _noise_in_use(state)
    if (state.joint.lead > 0.0).any():
        bounds = model.adaptation.bounds
        # Alarms count as far as errors are believed to be white, as what raises them assumes.
        part = 1.0 - state.lasting.fixes_last
        noise = _of_one_filter(*noise_with_part_of_alarms(state.joint, bounds, part))
        persistent = _of_one_filter(*noise_without_alarms(state.joint, bounds))
    elapsed = epoch.duration_s / NOMINAL_PERIOD_S
    lasting = predict_lasting(
        model.motion_model,
        state.lasting,
        epoch.control,
        elapsed * noise.process[:, 0],
        elapsed * persistent.process[:, 0],
        epoch.duration_s,
    )
    readings = Readings(epoch.measurement, epoch.available)
    return state._replace(lasting=with_compass(lasting, readings, noise)), noise


def members_at_instant(
    model: FilterModel, state: FilterState, epoch: Epoch, noise: Noise | None
) -> MembersAtInstant | None:
    """Compare readings with the members; None where lasting errors are not followed.

    Args:
        model: the filter.
        state: before the readings.
        epoch: has them.
        noise: Q and R of the members, as `lasting_at_instant` returns it.
    """
    if state.lasting is None or noise is None:
        return None
    noise = noise_of_readings(noise, model.measurement_noise, epoch.fix_covariance, epoch.available)
    readings = Readings(epoch.measurement, epoch.available)
    return MembersAtInstant(noise, compare_with_members(state.lasting, readings, noise))


def as_white_filters_see(state: FilterState, epoch: Epoch, noise: Noise) -> tuple[Readings, Noise]:
    """Return readings and their noise without the offset that is believed.

    Args:
        state: before the readings.
        epoch: has them.
        noise: Q and R with which filters take the readings.
    """
    z = epoch.measurement
    lasting = state.lasting
    if lasting is not None and (lasting.offset.believed | lasting.offset.unknown).any():
        z = without_offset(lasting, z)
        R = noise.measurement.copy()
        R[Row.COMPASS_YAW] += lasting.correcting.variance
        noise = noise._replace(measurement=R)
    return Readings(z, epoch.available), noise


def lasting_after(
    state: FilterState, epoch: Epoch, members: MembersAtInstant | None, gated: Gated | None
) -> tuple[FilterState, BoolArray | None]:
    """Return the state after an instant, and which robots start again from the witness's pose.

    Args:
        state: before its readings.
        epoch: ends with the instant.
        members: at the instant; None without readings.
        gated: the readings after the gate; None without readings.
    """
    lasting, joint, restart = state.lasting, state.joint, None
    if lasting is None or joint is None:
        return state, None
    still = _STANDSTILL.behind(epoch.control.ndim - 1) * (epoch.duration_s / NOMINAL_PERIOD_S)
    moves = np.asarray((np.abs(epoch.control) >= still).any(axis=0))  # also at the same instant
    if members is not None and gated is not None:
        accepted = epoch.available & ~rows_of(gated.decision.rejected)
        read, duration_s = epoch.available, epoch.duration_s
        used = after_readings(
            lasting, members.seen, members.noise, accepted, read, moves, duration_s
        )
        lasting, restart = used
    weighs = joint.memory[Scale.POSITION, SETTLED] >= MEMORY_NEEDED
    lasting = after_instant(lasting, moves, epoch.duration_s, weighs)
    return state._replace(lasting=lasting), restart


def restarted_from_witness(
    model: FilterModel, state: FilterState, restart: BoolArray | None
) -> FilterState:
    """Return the state; all filters start again from the witness's pose where `restart`."""
    if restart is None or state.lasting is None or not restart.any():
        return state
    again = reset_pose(model, state, *witness_pose(state.lasting))
    again = again._replace(lasting=moved_to_witness(state.lasting))
    if state.has_relocation_hypothesis(model):
        steady = model.layout.steady
        state = state._replace(
            bank=state.bank.filters(steady),
            noise=state.noise.filters(steady),
            relocation_hypothesis=again.relocation_hypothesis,
        )
    chosen: FilterState = select(restart, again, state)
    return chosen


def _noise_in_use(state: FilterState) -> Noise:
    """Return Q and R of the white filter, whose noise includes alarms."""
    return Noise(state.noise.process[:, WHITE], state.noise.measurement[:, WHITE])


def _of_one_filter(process: FloatArray, measurement: FloatArray) -> Noise:
    """Return Q `(2, *batch)` and R `(4, *batch)` as the noise of one filter."""
    return Noise(process[:, None], measurement[:, None])
