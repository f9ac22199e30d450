# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""What is believed of errors that last, in numbers.

The standard deviations are those of the mixture of the members: with f_k and s_k of member k, and
its weight w_k,

    fixes' x and y   sqrt(sum_k w_k f_k^2 (R_x + R_y) / 2)
    yaw              sqrt(sum_k w_k s_k^2)
"""

from typing import NamedTuple

import numpy as np

from fnn_ekf_ros.core.arrays import BoolArray, FloatArray
from fnn_ekf_ros.core.lasting.compass_offset import offset_of
from fnn_ekf_ros.core.lasting.lasting import LastingState
from fnn_ekf_ros.core.lasting.members import ERROR_TIME_S, MEMBERS, SQUARED_FACTORS

_YAW_VARIANCES: FloatArray = np.array([member.yaw_std**2 for member in MEMBERS])
"""s^2 of the members, `(M,)` [rad^2]."""
_YAWS_LAST: FloatArray = np.where(_YAW_VARIANCES > 0.0, 1.0, 0.0)
"""1 for the members whose yaw errors last, `(M,)`."""


class LastingReport(NamedTuple):
    """What is believed of errors that last.

    Attributes:
        weights: `(M, *batch)` of the members; their sum is 1.
        fixes_last: `(*batch)` weight of the members whose fix errors last.
        fix_std: `(*batch)` standard deviation of the fixes' lasting errors, of each axis [m].
        time_constant_s: for which these last [s].
        yaws_last: `(*batch)` weight of the members whose yaw errors last.
        yaw_std: `(*batch)` standard deviation of a yaw's lasting errors [rad].
        offset: `(*batch)` the compass's offset, as its witness estimates it [rad].
        offset_std: `(*batch)` its standard deviation [rad].
        believed: `(*batch)` whether it is believed: readings are then corrected by it.
        likely: `(*batch)` whether an offset is likely, but not believed yet.
        doubted: `(*batch)` whether the compass was turned, and is not used.
        of_fix_yaw: `(*batch)` whether the offset is that of the fixes' yaw: there is no compass.
    """

    weights: FloatArray
    fixes_last: FloatArray
    fix_std: FloatArray
    time_constant_s: float
    yaws_last: FloatArray
    yaw_std: FloatArray
    offset: FloatArray
    offset_std: FloatArray
    believed: BoolArray
    likely: BoolArray
    doubted: BoolArray
    of_fix_yaw: BoolArray


def report_lasting(state: LastingState) -> LastingReport:
    """Return what is believed of errors that last."""
    offset, variance = offset_of(state.bank)
    fix_variance = state.fix_variance.mean(axis=0)
    return LastingReport(
        weights=state.weights,
        fixes_last=state.fixes_last,
        fix_std=np.sqrt(_weighted(SQUARED_FACTORS, state.weights) * fix_variance),
        time_constant_s=ERROR_TIME_S,
        yaws_last=_weighted(_YAWS_LAST, state.weights),
        yaw_std=np.sqrt(_weighted(_YAW_VARIANCES, state.weights)),
        offset=offset,
        offset_std=np.sqrt(variance),
        believed=state.offset.believed,
        likely=state.offset.suspected | (state.offset.doubted & ~state.offset.turned),
        doubted=state.offset.doubted & state.offset.turned,
        of_fix_yaw=~state.compass_seen,
    )


def _weighted(of_members: FloatArray, weights: FloatArray) -> FloatArray:
    """Return the mean of values `(M,)` by weights `(M, *batch)`."""
    return np.asarray((weights.T @ of_members).T)
