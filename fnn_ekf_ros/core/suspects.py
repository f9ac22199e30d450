"""Suspects: which of wheels, compass and fixes does not fit the other two.

An innovation says that something is wrong, not what: wheels that slip make compass and fixes look
wrong, too. So four filters of the bank run beside the published one: one believes all three, and
each of the others has one suspect, whose noise it takes for `SUSPICION` times larger. How much
better a suspect's filter predicts what is measured than the one that suspects nobody is summed up
(Page 1954, with the likelihood of `evidence`):

    lead <- max(0, lead + l_suspect - l_nobody)

Where the lead falls to 0 the suspect is cleared: its filter starts again from the one that
suspects nobody, and that one from the published filter once all are cleared. The leads are those
of a fault that begins now; how seldom a right sensor gets there falls exponentially with the lead.
If a lead exceeds its cap, all fall by as much: who leads by how much stays.

A wild reading moves these filters by a bounded way only (Huber 1964), so that the next good one is
not mistaken for wild. They are told of the readings that are scored, a few a second (`pace`), and
of no others: errors of a fast sensor last, and whoever hears it often would believe it.
"""

import numpy as np

from fnn_ekf_ros.core.arrays import BoolArray, Constant, FloatArray
from fnn_ekf_ros.core.bank import Bank, Innovations, Noise, Readings, correct
from fnn_ekf_ros.core.rows import SENSOR_OF_ROW, rows_where

SUSPECTS = ("encoders", "compass", "lrf_pose")
"""Who can be suspected, in the order of the leads."""
SUSPICION = 25.0
"""By how much larger a suspect's noise is taken for, in variance: five times in std."""
LARGEST_GAIN = 20.0
"""No reading says more for or against a suspect [nats]."""
LONGEST_LEAD = 40.0
"""No lead grows further [nats]."""
LARGEST_NIS = 9.0
"""Per row: a reading with more moves a filter as if it had no more, three standard deviations."""

SUSPECT_COUNT = 1 + len(SUSPECTS)
"""Filters: nobody suspected, and each of `SUSPECTS`."""
_PROCESS = Constant([[1.0, SUSPICION, 1.0, 1.0]] * 2)
_MEASUREMENT = Constant(
    [[1.0, 1.0, 1.0, SUSPICION]] * 2 + [[1.0, 1.0, SUSPICION, 1.0]] + [[1.0, 1.0, 1.0, SUSPICION]]
)
"""Noise of the filters over the usual one."""


def noise_of_suspects(process: FloatArray, measurement: FloatArray) -> Noise:
    """Return the suspects' noise, of Q `(2, *batch)` and R `(4, *batch)` that are usual.

    Usual is the noise without an alarm's share.
    """
    batch = process.ndim - 1
    return Noise(
        process[:, None] * _PROCESS.behind(batch), measurement[:, None] * _MEASUREMENT.behind(batch)
    )


def lead_after(lead: FloatArray, likelihood: FloatArray, scored: BoolArray) -> FloatArray:
    """Return the leads `(3, *batch)` after readings.

    Args:
        lead: before them [nats].
        likelihood: `(4, *batch)` log likelihood of the readings, for each filter.
        scored: `(*batch)` whether the readings say anything.
    """
    gained = np.minimum(np.maximum(likelihood[1:] - likelihood[0], -LARGEST_GAIN), LARGEST_GAIN)
    led = lead + gained
    led = np.maximum(led - np.maximum(led.max(axis=0) - LONGEST_LEAD, 0.0), 0.0)
    # Where a filter left the finite numbers all are cleared, which starts them again.
    return np.where(scored, np.where(np.isfinite(led), led, 0.0), lead)


def correct_robustly(
    predicted: Bank, seen: Innovations, noise: Noise, readings: Readings, nis: FloatArray
) -> Bank:
    """Return the suspects' filters after readings, which move none of them too far.

    Args:
        predicted: before the readings.
        seen: what these say.
        noise: that the filters are run with.
        readings: themselves.
        nis: `(2, 4, *batch)` of each sensor against each filter.
    """
    rows = rows_where(readings.available).of_sensor[:, None]
    wild = np.sqrt(nis / (LARGEST_NIS * np.maximum(rows, 1.0)))
    widened = noise.measurement * np.maximum(wild, 1.0)[SENSOR_OF_ROW]
    R = noise._replace(measurement=widened)
    innovations = Innovations(seen.innovation, seen.variance + (widened - noise.measurement))
    return correct(predicted, innovations, R, readings.available).bank


def restarted(suspects: Bank, published: Bank, lead: FloatArray) -> Bank:
    """Return the filters with those that are cleared started again.

    Args:
        suspects: `(4, *batch)` filters.
        published: `(1, *batch)` the published one.
        lead: `(3, *batch)` of the suspects; 0: cleared.
    """
    cleared = lead <= 0.0
    none = np.all(cleared, axis=0)
    nobody = Bank(
        np.where(none, published.mean, suspects.mean[:, :1]),
        np.where(none, published.covariance, suspects.covariance[:, :, :1]),
    )
    restart = np.concatenate([np.ones_like(cleared[:1]), cleared])
    return Bank(
        np.where(restart, nobody.mean, suspects.mean),
        np.where(restart, nobody.covariance, suspects.covariance),
    )
