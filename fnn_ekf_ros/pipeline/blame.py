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
from fnn_ekf_ros.pipeline.wheel_sizes import Sizes, seen_sizes

MANY_REJECTIONS = 3
"""So many of the last `READINGS` readings rejected are more than wild ones now and then."""
BAND_CHANCE = 1e-3
"""Chance that the scatter of right readings lies outside of its band."""
SUSPECTED_LEAD = 12.0
"""From this lead on something is wrong [nats]: a right sensor gets there once in hours."""
CLEAR_LEAD = 6.0
"""By so much the first suspect has to lead the second to be named, for `LEAD_LASTS_NS` [nats]."""
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
        sizes: of the wheels, if these are what does not fit.
    """

    culprit: Sensor | None
    suspects: tuple[Sensor, ...]
    leads: tuple[float, ...]
    sizes: Sizes | None = None


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


def blame(watch: Watch, wheel_separation: float) -> Blame:
    """Return who does not fit the others, by the leads, the wheels' sizes and the symptoms.

    Args:
        watch: what is remembered of the last periods.
        wheel_separation: distance between the wheels [m].
    """
    leads = watch.leads[-1].leads
    by_lead = sorted(zip(leads, map(Sensor, SUSPECTS), strict=True), reverse=True)
    first = by_lead[0]
    if first[0] >= SUSPECTED_LEAD:
        if first[1] is Sensor.ENCODERS and watch.agreeing >= AGREEING:
            return Blame(None, (Sensor.ENCODERS, Sensor.LRF_POSE), leads)
        if all(_leader(each) is first[1] for each in (leads, *(old.leads for old in watch.leads))):
            return Blame(first[1], (first[1],), leads)
        close = tuple(sensor for lead, sensor in by_lead if first[0] - lead < CLEAR_LEAD)
        unclear = close if len(close) > 1 else (first[1], by_lead[1][1])
        return Blame(None, unclear, leads)
    others = tuple(s for lead, s in by_lead if lead >= CLEARED_LEAD)
    if set(others) <= {Sensor.ENCODERS}:
        sizes = seen_sizes(watch.steps, wheel_separation)
        if sizes is not None and sizes.wrong:
            return Blame(Sensor.ENCODERS, (Sensor.ENCODERS,), leads, sizes)
    wild = tuple(
        sensor
        for sensor, readings in zip((Sensor.COMPASS, Sensor.LRF_POSE), watch.readings, strict=True)
        if symptoms_of(readings).wild
    )
    others = tuple(sensor for sensor in others if sensor not in wild)
    if len(wild) == 1 and not others:
        return Blame(wild[0], wild, leads)
    return Blame(None, (*wild, *others) if wild else (), leads)


def _leader(leads: tuple[float, ...]) -> Sensor | None:
    """Return who is suspected by a clear lead, if anybody."""
    first, second = sorted(leads, reverse=True)[:2]
    if first < SUSPECTED_LEAD or first - second < CLEAR_LEAD:
        return None
    return Sensor(SUSPECTS[leads.index(first)])


@cache
def _band(rows: int) -> tuple[float, float]:
    """Return between what the sum of NIS lies for so many rows, but for `BAND_CHANCE`."""
    half = 0.5 * BAND_CHANCE
    return exceeded_with(1.0 - half, rows), exceeded_with(half, rows)
