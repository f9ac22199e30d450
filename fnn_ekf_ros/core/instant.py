# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""An instant with readings, and the innovations of the filters of a bank."""

from typing import NamedTuple

from fnn_ekf_ros.core.arrays import BoolArray, FloatArray
from fnn_ekf_ros.core.bank import Bank, Correction, Innovations, Noise, Readings, correct
from fnn_ekf_ros.core.rows import Rows


class Instant(NamedTuple):
    """An instant with readings, before the gate.

    Attributes:
        predicted: all filters, predicted to the instant.
        readings: z and which rows are measured.
        rows: the measured rows.
        noise: Q and R with which the readings are taken.
        seen: innovations of the readings against the filters that they are compared with.
        taken: all filters corrected by all measured rows.
        fix_covariance: `(3, 3, *batch)` R of `FIX_ROWS` as the fix reported it; None without.
    """

    predicted: Bank
    readings: Readings
    rows: Rows
    noise: Noise
    seen: Innovations
    taken: Correction
    fix_covariance: FloatArray | None

    def corrected_by(self, rows: BoolArray, which: slice) -> Correction:
        """Return some of the filters, corrected only by some of the rows `(4, *batch)`."""
        seen = self.seen.filters(which)
        return correct(self.predicted.filters(which), seen, self.noise.filters(which), rows)
