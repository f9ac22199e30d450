"""Suspects: which of wheels, compass and fixes does not fit the other two.

An innovation says that something is wrong, not what: wheels that slip make compass and fixes look
wrong, too. So four filters run beside the published one: one believes all three, and each of the
others has one suspect, whose noise it takes for `SUSPICION` times larger. How much better a
suspect's filter predicts what is measured than the one that suspects nobody is summed up (Page
1954, with the likelihood of `evidence`):

    lead <- max(0, lead + l_suspect - l_nobody)

Where the lead falls to 0 the suspect is cleared: its filter starts again from the one that
suspects nobody, and that one from the published filter once all are cleared. The leads are those
of a fault that begins now; how seldom a right sensor gets there falls exponentially with the lead.
If a lead exceeds its cap, all fall by as much: who leads by how much stays.

A wild reading moves these filters by a bounded way only (Huber 1964), so that the next good one is
not mistaken for wild.
"""

from typing import NamedTuple

import numpy as np

from fnn_ekf_ros.core.arrays import FloatArray
from fnn_ekf_ros.core.evidence import log_likelihood
from fnn_ekf_ros.core.gate import SENSOR_OF_ROW, nis_by_sensor
from fnn_ekf_ros.core.kalman import innovate, update
from fnn_ekf_ros.core.plant import (
    Plant,
    StepInput,
    carry_to_end,
    for_each,
    noise_matrix,
    predict,
)

SUSPECTS = ("encoders", "compass", "lrf_pose")
"""Who can be suspected, in the order of the leads."""
SUSPICION = 25.0
"""By how much larger a suspect's noise is taken for, in variance: five times in std."""
LARGEST_GAIN = 20.0
"""No period says more for or against a suspect [nats]."""
LONGEST_LEAD = 40.0
"""No lead grows further [nats]."""
LARGEST_NIS = 9.0
"""Per row: a reading with more moves a filter as if it had no more, three standard deviations."""

_FILTERS = 1 + len(SUSPECTS)
_PROCESS: FloatArray = np.array([[1.0] * 2, [SUSPICION] * 2, [1.0] * 2, [1.0] * 2])
_MEASUREMENT: FloatArray = np.array(
    [[1.0] * 4, [1.0] * 4, [1.0, 1.0, SUSPICION, 1.0], [SUSPICION, SUSPICION, 1.0, SUSPICION]]
)
"""Noise of the filters over the usual one: nobody suspected, encoders, compass, fixes."""


class SuspectState(NamedTuple):
    """What is remembered of the suspects.

    Attributes:
        lead: `(..., 3)` by how much better each suspicion has predicted of late [nats].
        mean: `(..., 4, 3)` filters: nobody suspected, and each of `SUSPECTS` (m, m, rad).
        covariance: `(..., 4, 3, 3)` their covariances.
    """

    lead: FloatArray
    mean: FloatArray
    covariance: FloatArray


def no_suspects(mean: FloatArray, covariance: FloatArray) -> SuspectState:
    """Return the state in which nobody is suspected, at a pose `(..., 3)`, `(..., 3, 3)`."""
    batch = mean.shape[:-1]
    return SuspectState(
        np.zeros((*batch, len(SUSPECTS))),
        np.broadcast_to(mean[..., None, :], (*batch, _FILTERS, 3)),
        np.broadcast_to(covariance[..., None, :, :], (*batch, _FILTERS, 3, 3)),
    )


def suspect(
    plant: Plant,
    state: SuspectState,
    noise: tuple[FloatArray, FloatArray],
    period: StepInput,
    published: tuple[FloatArray, FloatArray],
) -> SuspectState:
    """Take the suspects over one period.

    Args:
        plant: the robot.
        state: before the period; not changed.
        noise: Q `(..., 2)` and R `(..., 4)` that are usual: without an alarm's share.
        period: what it brought.
        published: mean `(..., 3)` and covariance `(..., 3, 3)` of the published filter after it.
    """
    Q = noise[0][..., None, :] * _PROCESS
    R = noise[1][..., None, :] * _MEASUREMENT
    each = for_each(period)
    mean, covariance = predict(plant, state.mean, state.covariance, Q, each.control)
    z = carry_to_end(plant, state.mean[..., 2], each)
    R_full = noise_matrix(plant, R, each)
    available = each.available
    seen = innovate(mean, covariance, z, R_full, available)

    likelihood = log_likelihood(seen)
    gained = np.clip(likelihood[..., 1:] - likelihood[..., :1], -LARGEST_GAIN, LARGEST_GAIN)
    lead = state.lead + gained
    excess = np.max(lead, axis=-1, keepdims=True) - LONGEST_LEAD
    lead = np.maximum(lead - np.maximum(excess, 0.0), 0.0)
    cleared = lead <= 0.0
    none = np.all(cleared, axis=-1)
    if np.all(none):  # as most of the time: all filters would start again from the published one
        return no_suspects(*published)

    if np.any(seen.nis > LARGEST_NIS):  # no sensor's is larger than all rows' together
        nis, rows = nis_by_sensor(seen, available)
        wild = np.sqrt(nis / (LARGEST_NIS * np.maximum(rows, 1.0)))
        widened = np.sqrt(np.maximum(wild, 1.0))[..., SENSOR_OF_ROW]
        R_full = R_full * widened[..., :, None] * widened[..., None, :]
        seen = innovate(mean, covariance, z, R_full, available)
    mean, covariance = update(mean, covariance, R_full, available, seen)

    nobody = np.where(none[..., None], published[0], mean[..., 0, :])
    nobody_P = np.where(none[..., None, None], published[1], covariance[..., 0, :, :])
    restart = np.concatenate([np.ones_like(cleared[..., :1]), cleared], axis=-1)
    return SuspectState(
        lead,
        np.where(restart[..., None], nobody[..., None, :], mean),
        np.where(restart[..., None, None], nobody_P[..., None, :, :], covariance),
    )
