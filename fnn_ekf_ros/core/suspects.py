# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Suspects: which of wheels, compass and fixes does not fit the other two.

An innovation shows that something is wrong, but not what: slipping wheels also make the compass
and the fixes look wrong. Four filters of the bank run beside the published one: one without a
suspect, and one for each suspect, whose noise it assumes to be larger by a factor of `SUSPICION`.
The log likelihood ratio of a suspect's filter to the one without is accumulated (CUSUM, Page 1954,
with the likelihood of `evidence`):

    lead <- max(0, lead + l_suspect - l_none)

Where the lead falls to 0 the suspect is cleared: its filter starts again from the one without a
suspect, and that one from the published filter once all suspects are cleared. The probability that
a correct sensor reaches a lead falls exponentially with the lead. If a lead exceeds its limit, all
leads are reduced by the excess, so that their differences stay.

The influence of an outlier on these filters is bounded (Huber 1964), so that the next correct
reading does not look like an outlier. The filters are corrected only by the readings that are
scored, a few a second (`pace`): errors of a fast sensor last for many readings, and filters that
take all of them would follow the errors.
"""

import numpy as np

from fnn_ekf_ros.core.arrays import BoolArray, Constant, FloatArray
from fnn_ekf_ros.core.bank import Bank, Innovations, Noise, Readings, correct
from fnn_ekf_ros.core.rows import SENSOR_OF_ROW, rows_where

SUSPECTS = ("encoders", "compass", "lrf_pose")
"""Names of the suspects, in the order of the leads."""
SUSPICION = 25.0
"""Factor on the variances of a suspect's noise: five standard deviations of its assumed noise look
normal to its filter."""
LARGEST_SUSPECT_GAIN = 20.0
"""Largest log likelihood ratio of a suspect per reading [nats]: a single outlier does not bring a
lead to its limit."""
LARGEST_SUSPECT_LEAD = 40.0
"""Upper limit of a lead [nats]: it bounds the time in which leads fall after a fault has ended."""
LARGEST_NIS = 9.0
"""NIS per row from which on a reading's influence is bounded: three standard deviations."""

SUSPECT_COUNT = 1 + len(SUSPECTS)
"""Filters: the one without a suspect, and one for each of `SUSPECTS`."""
_PROCESS = Constant([[1.0, SUSPICION, 1.0, 1.0]] * 2)
_MEASUREMENT = Constant(
    [[1.0, 1.0, 1.0, SUSPICION]] * 2 + [[1.0, 1.0, SUSPICION, 1.0]] + [[1.0, 1.0, 1.0, SUSPICION]]
)
"""Factors of the filters on Q and on R: no suspect, encoders, compass, fixes."""


def noise_of_suspects(process: FloatArray, measurement: FloatArray) -> Noise:
    """Return the noise of the suspects' filters.

    Args:
        process: `(2, *batch)` diagonal of Q without the increase by alarms (m^2, rad^2).
        measurement: `(4, *batch)` diagonal of R, likewise (m^2, m^2, rad^2, rad^2).
    """
    batch = process.ndim - 1
    return Noise(
        process[:, None] * _PROCESS.behind(batch), measurement[:, None] * _MEASUREMENT.behind(batch)
    )


def lead_after(lead: FloatArray, likelihood: FloatArray, scored: BoolArray) -> FloatArray:
    """Return the leads `(3, *batch)` after readings.

    Args:
        lead: `(3, *batch)` before them [nats].
        likelihood: `(4, *batch)` log likelihood of the readings, for each filter.
        scored: `(*batch)` whether any reading is scored.
    """
    gained = np.minimum(
        np.maximum(likelihood[1:] - likelihood[0], -LARGEST_SUSPECT_GAIN), LARGEST_SUSPECT_GAIN
    )
    led = lead + gained
    led = np.maximum(led - np.maximum(led.max(axis=0) - LARGEST_SUSPECT_LEAD, 0.0), 0.0)
    # Non-finite leads clear all suspects, which starts the filters again.
    return np.where(scored, np.where(np.isfinite(led), led, 0.0), lead)


def correct_robustly(
    predicted: Bank, seen: Innovations, noise: Noise, readings: Readings, nis: FloatArray
) -> Bank:
    """Return the suspects' filters after readings with bounded influence.

    Where a sensor's NIS exceeds `LARGEST_NIS` per row, its R is multiplied by the square root of
    the ratio (Huber 1964).

    Args:
        predicted: the filters before the readings.
        seen: innovations of the readings.
        noise: Q and R of the filters.
        readings: of the instant.
        nis: `(2, 4, *batch)` NIS of each sensor against each filter.
    """
    rows = rows_where(readings.available).of_sensor[:, None]
    excess = np.sqrt(nis / (LARGEST_NIS * np.maximum(rows, 1.0)))
    widened = noise.measurement * np.maximum(excess, 1.0)[SENSOR_OF_ROW]
    R = noise._replace(measurement=widened)
    innovations = Innovations(seen.innovation, seen.variance + (widened - noise.measurement))
    return correct(predicted, innovations, R, readings.available).bank


def restarted(suspects: Bank, published: Bank, lead: FloatArray) -> Bank:
    """Return the filters, those of cleared suspects started again.

    Args:
        suspects: the four filters.
        published: the published filter alone.
        lead: `(3, *batch)` of the suspects [nats]; 0: cleared.
    """
    cleared = lead <= 0.0
    all_cleared = np.all(cleared, axis=0)
    without = Bank(
        np.where(all_cleared, published.mean, suspects.mean[:, :1]),
        np.where(all_cleared, published.covariance, suspects.covariance[:, :, :1]),
    )
    restart = np.concatenate([np.ones_like(cleared[:1]), cleared])
    return Bank(
        np.where(restart, without.mean, suspects.mean),
        np.where(restart, without.covariance, suspects.covariance),
    )
