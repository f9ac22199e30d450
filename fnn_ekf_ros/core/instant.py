"""An instant at which something is measured, as the filters of a bank see it."""

from typing import NamedTuple

from fnn_ekf_ros.core.arrays import BoolArray, FloatArray
from fnn_ekf_ros.core.bank import Bank, Correction, Innovations, Noise, Readings, correct
from fnn_ekf_ros.core.rows import Rows


class Instant(NamedTuple):
    """An instant with readings, before any filter is corrected.

    Attributes:
        predicted: all filters.
        readings: what is measured.
        rows: which rows that is.
        noise: that the readings are taken with.
        seen: what they say against each prediction.
        taken: all filters as if each row that was measured were right.
        fix_covariance: as the fix reported it, if it did.
    """

    predicted: Bank
    readings: Readings
    rows: Rows
    noise: Noise
    seen: Innovations
    taken: Correction
    fix_covariance: FloatArray | None

    def corrected_by(self, rows: BoolArray, which: slice) -> Correction:
        """Return some filters corrected by some rows `(4, *batch)` only."""
        seen = self.seen.filters(which)
        return correct(self.predicted.filters(which), seen, self.noise.filters(which), rows)
