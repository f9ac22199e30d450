"""Who is to blame: symptoms of the sensors and the suspects' leads, put together to one name.

A wheel that slips makes the compass and the fixes look wrong as well, and a compass that is turned
makes the filter mistrust the fixes. So a symptom alone (readings rejected, a scatter that is not
the expected one) blames a sensor only while no other one is suspected.
"""

import math
from enum import Enum
from functools import cache
from typing import NamedTuple

from fnn_ekf_ros.core.chi_square import exceeded_with
from fnn_ekf_ros.core.suspects import SUSPECTS
from fnn_ekf_ros.pipeline.events import Sensor
from fnn_ekf_ros.pipeline.watch import LASTING, READINGS, Readings, Watch

MANY_REJECTIONS = 3
"""So many of the last `READINGS` readings rejected are more than wild ones now and then."""
BAND_CHANCE = 1e-3
"""Chance that the scatter of right readings lies outside of its band."""
SUSPECTED_LEAD = 12.0
"""From this lead on something is wrong [nats]: a right sensor gets there once in hours."""
CLEAR_LEAD = 6.0
"""By so much the first suspect has to lead the second to be named [nats]."""
CLEARED_LEAD = 3.0
"""A suspect with less has nothing to do with another one's symptoms [nats]; right sensors seldom
have more."""
AGREEING = 2
"""So many rejected fixes that agree with each other and the wheels are a jump, it seems; the wheels
are not blamed for it until it is clear."""


class Scatter(Enum):
    """How the readings scatter against what is believed."""

    AS_BELIEVED = 0
    MORE = 1
    LESS = -1


class Symptoms(NamedTuple):
    """What can be seen of a sensor's last readings.

    Attributes:
        rejected: how many of them the gate rejected.
        seen: of how many.
        nis: mean of the last that were accepted, per degree of freedom; NaN without any.
        band: in which it lies for right readings but for `BAND_CHANCE`.
        scatter: where it lies, now and `LASTING` readings ago.
    """

    rejected: int
    seen: int
    nis: float
    band: tuple[float, float]
    scatter: Scatter

    @property
    def wild(self) -> bool:
        """Whether too many were rejected or they scatter too much."""
        return self.rejected >= MANY_REJECTIONS or self.scatter is Scatter.MORE


class Blame(NamedTuple):
    """What does not fit.

    Attributes:
        culprit: the sensor that does not fit the others; None: none, or not clear which.
        suspects: all that may be to blame; several where it is not clear yet, or none.
        leads: of `SUSPECTS` [nats].
    """

    culprit: Sensor | None
    suspects: tuple[Sensor, ...]
    leads: tuple[float, ...]


NOBODY = Blame(None, (), (0.0,) * len(SUSPECTS))


def symptoms_of(readings: Readings) -> Symptoms:
    """Return what the last readings of a sensor show; a scatter only if it lasts."""
    rejected, seen = sum(readings.rejected), len(readings.rejected)
    nis, band = _mean_and_band(readings, slice(-READINGS, None))
    if len(readings.nis) < READINGS + LASTING:
        return Symptoms(rejected, seen, nis, band, Scatter.AS_BELIEVED)
    earlier, band_then = _mean_and_band(readings, slice(None, READINGS))
    scatter = Scatter.AS_BELIEVED
    if nis > band[1] and earlier > band_then[1]:
        scatter = Scatter.MORE
    elif nis < band[0] and earlier < band_then[0]:
        scatter = Scatter.LESS
    return Symptoms(rejected, seen, nis, band, scatter)


def _mean_and_band(readings: Readings, which: slice) -> tuple[float, tuple[float, float]]:
    """Return the mean of NIS per degree of freedom, and its band for right readings."""
    rows = sum(readings.rows[which])
    if not rows:
        return math.nan, (0.0, math.inf)
    low, high = _band(rows)
    return sum(readings.nis[which]) / rows, (low / rows, high / rows)


def blame(watch: Watch) -> Blame:
    """Return who does not fit the others, by the leads and by the symptoms."""
    leads = tuple(float(lead) for lead in watch.suspects.lead)
    by_lead = sorted(zip(leads, map(Sensor, SUSPECTS), strict=True), reverse=True)
    first, second = by_lead[0], by_lead[1]
    if first[0] >= SUSPECTED_LEAD:
        if first[1] is Sensor.ENCODERS and watch.agreeing >= AGREEING:
            return Blame(None, (Sensor.ENCODERS, Sensor.LRF_POSE), leads)
        if first[0] - second[0] >= CLEAR_LEAD:
            return Blame(first[1], (first[1],), leads)
        unclear = tuple(sensor for lead, sensor in by_lead if first[0] - lead < CLEAR_LEAD)
        return Blame(None, unclear, leads)
    wild = tuple(
        sensor
        for sensor, readings in zip((Sensor.COMPASS, Sensor.LRF_POSE), watch.readings, strict=True)
        if symptoms_of(readings).wild
    )
    others = tuple(s for lead, s in by_lead if lead >= CLEARED_LEAD and s not in wild)
    if len(wild) == 1 and not others:
        return Blame(wild[0], wild, leads)
    return Blame(None, (*wild, *others) if wild else (), leads)


@cache
def _band(rows: int) -> tuple[float, float]:
    """Return between what the sum of NIS lies for so many rows, but for `BAND_CHANCE`."""
    half = 0.5 * BAND_CHANCE
    return exceeded_with(1.0 - half, rows), exceeded_with(half, rows)
