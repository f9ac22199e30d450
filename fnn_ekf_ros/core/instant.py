"""An instant at which something is measured, as the filters of a bank see it."""

from typing import NamedTuple

from fnn_ekf_ros.core.arrays import BoolArray, FloatArray
from fnn_ekf_ros.core.bank import Bank, Correction, Innovations, Noise, Readings, correct


class Instant(NamedTuple):
    """An instant with readings, before any filter is corrected.

    Attributes:
        predicted: all filters.
        readings: what is measured.
        noise: that the readings are taken with.
        seen: what they say against each prediction.
        taken: all filters as if each row that was measured were right.
        sensor_rows: `(2, *batch)` how many rows each sensor measured.
        fix_covariance: as the fix reported it, if it did.
    """

    predicted: Bank
    readings: Readings
    noise: Noise
    seen: Innovations
    taken: Correction
    sensor_rows: FloatArray
    fix_covariance: FloatArray | None

    def corrected_by(self, rows: BoolArray, which: slice) -> Correction:
        """Return some filters corrected by some rows `(4, *batch)` only."""
        seen = self.seen.filters(which)
        return correct(self.predicted.filters(which), seen, self.noise.filters(which), rows)
