# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Members: hypotheses about how much of the sensors' errors lasts, and their filters.

A member assumes that fixes have an error of `fix_factor` times their noise that lasts, and that
yaws have one of `yaw_std`. Which assumption holds cannot be told from one prediction to the next: a
fix error that lasts looks like an error of the wheels. Simulated outages tell (`outages`): copies
of each member are not corrected by fixes for some time, and are scored by the fixes after it.

The filters, in this order: the members, the witness of the compass, its challenger and the
compass's advocate (`compass_offset`), and for each horizon and phase of the outages the copies of
all members.
"""

from typing import NamedTuple

import numpy as np

from fnn_ekf_ros.core.arrays import Constant, FloatArray


class Member(NamedTuple):
    """A hypothesis.

    Attributes:
        fix_factor: standard deviation of the lasting error of x and y over that of the fixes'
            noise, f.
        yaw_std: standard deviation of the lasting error of a yaw, and that of its constant offset,
            s [rad].
    """

    fix_factor: float
    yaw_std: float


FIX_FACTORS = (0.0, 1.0, 3.0, 10.0, 30.0)
"""f of the members: a factor of about three apart, up to GPS errors of 30 times the scatter."""
YAW_ERROR_STD = 0.1
"""s of the members whose yaw errors last [rad]: six degrees, as of a compass in a building."""
ERROR_TIME_S = 10.0
"""tau, time constant of the errors [s]. Errors that last longer are followed by larger f."""
MEMBERS = tuple(Member(f, s) for s in (0.0, YAW_ERROR_STD) for f in FIX_FACTORS)
"""The members; the first one, white, assumes that no error lasts."""
MEMBER_COUNT = len(MEMBERS)
"""Number of members."""
WHITE = 0
"""Index of the member that assumes that no error lasts."""
ROTATION_FACTOR = 2.0
"""Factor on the standard deviation of the wheels' rotation for members whose yaw errors last: what
the learner takes for a precise rotation is then partly the lasting yaw error."""
_PRIOR_PER_FACTOR = 0.4
"""Ratio of the prior weights of neighboring f: the larger a lasting error the rarer."""
_PRIOR_OF_YAW_ERRORS = 0.3
"""Prior weight of the members whose yaw errors last."""

HORIZONS_S = (10.0, 100.0)
"""Durations of the simulated outages before their copies are scored [s]: short ones tell errors of
seconds, long ones those of minutes; neither alone is right for all sensors."""
PHASES = 2
"""Copies of a member per horizon, half a cycle apart: one is scored while the other is young."""

WITNESS = MEMBER_COUNT
"""Index of the compass's witness."""
WITNESS_FIX_FACTOR = 3.0
"""f of the witness: its offset must not follow fixes whose errors last."""
WITNESS_OFFSET_STD = 1.5
"""Prior standard deviation of the offset of the witness [rad]: any mounting angle is possible."""

CHALLENGER = WITNESS + 1
"""Index of the witness's challenger, a witness that begins with another yaw (`challenger`)."""
WITNESSES = slice(WITNESS, CHALLENGER + 1)
"""The witness and its challenger, which take the compass as it comes."""
ADVOCATE = CHALLENGER + 1
"""Index of the compass's advocate, which takes the wheels for wrong where they contradict it."""
ADVOCATE_ROTATION = 25.0
"""Factor on the variance of the wheels' rotation for the advocate: five standard deviations, as for
a suspect. Its distance has no more noise, or fixes would not tell where its yaw is wrong."""

OF_MEMBERS = slice(0, MEMBER_COUNT)
"""The members among the filters."""
OF_OFFSET = slice(WITNESS, ADVOCATE + 1)
"""The filters that tell the compass's offset: witness, challenger and advocate."""
CORRECTED = slice(0, OF_OFFSET.stop)
"""The filters that fixes correct: members, witnesses and advocate."""
_CYCLES = len(HORIZONS_S) * PHASES
COPIES = slice(CORRECTED.stop, CORRECTED.stop + _CYCLES * MEMBER_COUNT)
"""The copies in outages, by horizon, phase and member."""
FILTER_COUNT = COPIES.stop
"""Number of all filters."""


def _of_all(of_members: list[float], of_witness: float, of_advocate: float) -> FloatArray:
    return np.array([*of_members, of_witness, of_witness, of_advocate, *_CYCLES * of_members])


_FACTORS = _of_all(
    [member.fix_factor for member in MEMBERS], WITNESS_FIX_FACTOR, WITNESS_FIX_FACTOR
)
_YAW_STDS = _of_all([member.yaw_std for member in MEMBERS], YAW_ERROR_STD, YAW_ERROR_STD)
_OFFSET_STDS = _of_all([member.yaw_std for member in MEMBERS], WITNESS_OFFSET_STD, 0.0)
_ROTATIONS = [ROTATION_FACTOR**2 if m.yaw_std > 0.0 else 1.0 for m in MEMBERS]
PROCESS = Constant(np.stack([np.ones(FILTER_COUNT), _of_all(_ROTATIONS, 1.0, ADVOCATE_ROTATION)]))
"""Factors of the filters on Q of distance and rotation, `(2, F)`."""
_VARIANCES = Constant(np.stack([_FACTORS, _FACTORS, _YAW_STDS, _OFFSET_STDS]) ** 2)
_PRIOR_OF_FACTORS = _PRIOR_PER_FACTOR ** np.arange(len(FIX_FACTORS))
_PRIOR = np.outer((1.0 - _PRIOR_OF_YAW_ERRORS, _PRIOR_OF_YAW_ERRORS), _PRIOR_OF_FACTORS).ravel()
PRIOR = Constant(_PRIOR / _PRIOR.sum())
"""Prior weights of the members, `(M,)`."""
FIXES_LAST: FloatArray = np.array([float(member.fix_factor > 0.0) for member in MEMBERS])
"""1 for the members whose fix errors last, `(M,)`."""
LASTING_SHARE = 0.5
"""Weight of the members whose fix errors last from which on these are believed: then they are more
likely than white errors; the prior gives them 0.09."""
SQUARED_FACTORS: FloatArray = np.array([member.fix_factor**2 for member in MEMBERS])
"""f^2 of the members, `(M,)`."""


def error_variances(fix_variance: FloatArray) -> FloatArray:
    """Return the errors' variances in the long run, `(4, F, *batch)` (m^2, m^2, rad^2, rad^2).

    Args:
        fix_variance: `(2, *batch)` R of x and y of the fixes [m^2].
    """
    batch = fix_variance.shape[1:]
    variances = np.empty((4, FILTER_COUNT, *batch))
    variances[...] = _VARIANCES.behind(len(batch))
    variances[:2] *= fix_variance[:, None]
    return variances
