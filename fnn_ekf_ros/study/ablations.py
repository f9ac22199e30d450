# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The filters of `study real`, with those that are `joint` without one of its parts.

What a part is good for shows where it is missing. The filter has no switches for this: a part is
held where it is at the start, in the state, after every period. With periods of less than 2 s it
then has no effect: an outage takes 15 s, an offset 10 s until it is believed, and 2 s until the
compass is found to have been turned.
"""

import dataclasses
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from fnn_ekf_ros.core.angles import wrap_angle
from fnn_ekf_ros.core.arrays import FloatArray
from fnn_ekf_ros.core.bank import Bank
from fnn_ekf_ros.core.lasting.augmented import Component
from fnn_ekf_ros.core.lasting.compass_offset import start_offset
from fnn_ekf_ros.core.lasting.lasting import LastingState, after_instant
from fnn_ekf_ros.core.lasting.members import MEMBERS, WITNESS
from fnn_ekf_ros.core.lasting.outages import start_outages, weights_of
from fnn_ekf_ros.core.state import FilterModel, FilterState
from fnn_ekf_ros.parameters.localizer import LocalizerParameters
from fnn_ekf_ros.study.filters import JOINT, localizer_models

WITHOUT_LASTING_ERRORS = f"{JOINT}_without_lasting_errors"
"""Name of joint that takes all errors for white: `lasting_errors: false`."""
WITHOUT_OUTAGES = f"{JOINT}_without_outages"
"""Name of joint whose hypotheses keep the weights of the prior."""
WITHOUT_YAW_ERRORS = f"{JOINT}_without_yaw_errors"
"""Name of joint that takes all errors of yaws for white, and no compass for one with an offset."""
NO_LOG_WEIGHT = -600.0
"""Log weight of a hypothesis that is left out [nats]: it changes no digit of a sum."""
_YAW_ERRORS_LAST = np.array([member.yaw_std > 0.0 for member in MEMBERS])


class RealFilter(NamedTuple):
    """A filter of `study real`.

    Attributes:
        label: what tables and figures call it.
        model: the filter.
        hold: what is held, at the start and after each period.
    """

    label: str
    model: FilterModel
    hold: Callable[[FilterState], FilterState]


def real_filters(parameters: LocalizerParameters) -> dict[str, RealFilter]:
    """Return the filters by name, the EKF first, those without a part last.

    Args:
        parameters: of every filter, except what its name decides.
    """
    models = localizer_models(parameters)
    white = localizer_models(dataclasses.replace(parameters, lasting_errors=False))
    joint, label = models[JOINT].model, models[JOINT].label
    return {
        **{name: RealFilter(*each, as_it_is) for name, each in models.items()},
        WITHOUT_LASTING_ERRORS: RealFilter(
            f"{label} without lasting errors", white[JOINT].model, as_it_is
        ),
        WITHOUT_OUTAGES: RealFilter(f"{label} without outages", joint, without_outages),
        WITHOUT_YAW_ERRORS: RealFilter(f"{label} without yaw errors", joint, without_yaw_errors),
    }


def as_it_is(state: FilterState) -> FilterState:
    """Return the state: nothing is held."""
    return state


def without_outages(state: FilterState) -> FilterState:
    """Return the state with the prior's weights, and outages that begin."""
    lasting = state.lasting
    if lasting is None:
        return state
    outages = start_outages(lasting.outlier_share.shape)
    return _with_weights_of(state, lasting._replace(outages=outages))


def without_yaw_errors(state: FilterState) -> FilterState:
    """Return the state whose members have no lasting yaw errors, and its witness no offset."""
    lasting = state.lasting
    if lasting is None:
        return state
    log_weight = lasting.outages.log_weight.copy()
    log_weight[:, _YAW_ERRORS_LAST] = NO_LOG_WEIGHT
    held = lasting._replace(
        bank=without_offset(lasting.bank),
        outages=lasting.outages._replace(log_weight=log_weight),
        offset=start_offset(lasting.outlier_share.shape),
    )
    return _with_weights_of(state, held)


def without_offset(bank: Bank) -> Bank:
    """Return the filters; the witness is told that its compass's offset is 0.

    Conditioned on b_0 = 0: K = P_:b / P_bb, x <- x - K b_0, P <- P - K P_b:.

    Args:
        bank: `(7, F, *batch)`.
    """
    k = Component.YAW_OFFSET
    variance: FloatArray = bank.covariance[k, k, WITNESS]
    if not variance.any():
        return bank
    mean, covariance = bank.mean.copy(), bank.covariance.copy()
    x, P = mean[:, WITNESS], covariance[:, :, WITNESS]
    K = P[:, k] / np.where(variance > 0.0, variance, 1.0)  # where it is 0, so is P_:b
    x -= K * x[k]
    x[Component.YAW] = wrap_angle(x[Component.YAW])
    P -= K[:, None] * P[k]
    x[k] = P[k] = P[:, k] = 0.0
    return Bank(mean, covariance)


def _with_weights_of(state: FilterState, lasting: LastingState) -> FilterState:
    """Return the state with these filters, and the estimate by their log weights."""
    none = np.zeros(lasting.outlier_share.shape, dtype=np.bool_)
    held = lasting._replace(weights=weights_of(lasting.outages.log_weight))
    return state._replace(lasting=after_instant(held, none, 0.0, none))
