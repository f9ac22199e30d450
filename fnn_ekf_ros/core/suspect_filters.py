# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The suspects' filters in the bank."""

import numpy as np

from fnn_ekf_ros.core.arrays import FloatArray
from fnn_ekf_ros.core.bank import Bank
from fnn_ekf_ros.core.evidence import log_likelihood
from fnn_ekf_ros.core.instant import Instant
from fnn_ekf_ros.core.relocation import nis_by_sensor
from fnn_ekf_ros.core.rows import Rows
from fnn_ekf_ros.core.state import FilterModel, FilterState
from fnn_ekf_ros.core.suspects import LARGEST_NIS, correct_robustly, lead_after, restarted


def suspects_after(
    model: FilterModel, state: FilterState, instant: Instant, published: Bank, scored: Rows
) -> tuple[Bank, FloatArray]:
    """Return the suspects' filters after readings, and their leads.

    Args:
        model: the filter.
        state: before the readings.
        instant: the readings.
        published: the published filter after them.
        scored: rows that are scored.
    """
    which, taken = model.layout.suspects, instant.taken
    predicted, counts = instant.predicted.filters(which), scored.some
    if not counts.any():
        return predicted, state.lead
    likelihood = log_likelihood(taken.nis[which], taken.determinant[which], instant.rows.total)
    lead = lead_after(state.lead, likelihood, counts)
    if counts.all() and not lead.any():  # the usual case: all start again
        return published, lead
    suspects = taken.bank.filters(which)
    if (taken.nis[which] > LARGEST_NIS).any():  # all rows' NIS is no less than a sensor's
        nis = [nis_by_sensor(instant.seen, taken, k) for k in range(which.start, which.stop)]
        suspects = correct_robustly(
            predicted,
            instant.seen.filters(which),
            instant.noise.filters(which),
            instant.readings,
            np.stack(nis, axis=1),
        )
    suspects = restarted(suspects, published, lead)
    return Bank(
        np.where(counts, suspects.mean, predicted.mean),
        np.where(counts, suspects.covariance, predicted.covariance),
    ), lead
