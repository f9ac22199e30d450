# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Fault isolation: the one sensor that fits the symptoms of all and the suspects' leads.

Wheel slip makes the compass and the fixes look wrong as well, and a compass that is turned lets the
filter reject the fixes. A symptom alone (rejected readings, a scatter that differs from the assumed
noise) thus names a sensor only while no other one is suspected.
"""

import math
from collections.abc import Iterator
from enum import Enum
from functools import cache
from typing import NamedTuple

from fnn_ekf_ros.core.chi_square import exceeded_with
from fnn_ekf_ros.core.suspects import SUSPECTS
from fnn_ekf_ros.diagnostics.recent_periods import LASTING, READINGS, Readings, RecentPeriods
from fnn_ekf_ros.diagnostics.wheel_sizes import WheelSizes, estimate_sizes
from fnn_ekf_ros.timeline.events import Sensor

MANY_REJECTIONS = 3
"""Rejected readings among the last `READINGS` from which on they are no occasional outliers."""
BAND_CHANCE = 1e-3
"""Probability that the scatter of right readings lies outside of its band: a WARN is rare then."""
SUSPECTED_LEAD = 12.0
"""Lead from which on something is wrong [nats]: a right sensor reaches it once in hours."""
CLEAR_LEAD = 6.0
"""Least difference of the first and the second lead for the first suspect to be named, if it lasts
for `LEAD_LASTS_NS` [nats]: a likelihood ratio of 400."""
CLEARED_LEAD = 3.0
"""Lead under which a suspect does not explain another sensor's symptoms [nats]: right sensors
seldom have more."""
LEARNING_NS = 30 * 10**9
"""Time from the start of a filter that learns its noise until leads, scatter or wheel sizes name a
sensor [ns]: before, the assumed noise may be what is wrong, by 25 in variance and of several
sensors."""
AGREEING = 2
"""Rejected fixes that agree with each other and the wheels from which on the fixes seem to have
jumped; the wheels are not named until that is decided."""


class Scatter(Enum):
    """Scatter of the readings against the assumed noise."""

    AS_ASSUMED = 0
    MORE = 1
    LESS = -1


class Band(NamedTuple):
    """Values between which a number lies, but for a probability of `BAND_CHANCE`."""

    low: float
    high: float


class Symptoms(NamedTuple):
    """Symptoms in a sensor's last readings.

    Attributes:
        rejected: number of them that the gate rejected.
        seen: their number.
        nis: mean of the last accepted ones, per degree of freedom; NaN without any.
        band: in which it lies for right readings.
        scatter: whether it lies in its band, now and `LASTING` readings ago.
    """

    rejected: int
    seen: int
    nis: float
    band: Band
    scatter: Scatter

    @property
    def abnormal(self) -> bool:
        """Whether too many were rejected or they scatter too much."""
        return self.rejected >= MANY_REJECTIONS or self.scatter is Scatter.MORE


class FaultIsolation(NamedTuple):
    """The sensor that does not fit the others.

    Attributes:
        named: this sensor; None: none, or it is not clear which.
        suspects: all that may be the cause, in the order of `Sensor`; none if all fit.
        leads: of `SUSPECTS` [nats].
        sizes: of the wheels, if these are the cause.
    """

    named: Sensor | None
    suspects: tuple[Sensor, ...]
    leads: tuple[float, ...]
    sizes: WheelSizes | None = None


NO_FAULT = FaultIsolation(named=None, suspects=(), leads=(0.0,) * len(SUSPECTS))
"""Result before the first period: no sensor is named or suspected, no lead [nats]."""


def symptoms_of(readings: Readings) -> Symptoms:
    """Return what the last readings of a sensor show; a scatter only if it lasts."""
    rejected, seen = sum(readings.rejected), len(readings.rejected)
    nis, band = _mean_and_band(readings, slice(-READINGS, None))
    if len(readings.nis) < READINGS + LASTING:
        return Symptoms(
            rejected=rejected, seen=seen, nis=nis, band=band, scatter=Scatter.AS_ASSUMED
        )
    earlier, earlier_band = _mean_and_band(readings, slice(None, READINGS))
    scatter = Scatter.AS_ASSUMED
    if nis > band.high and earlier > earlier_band.high:
        scatter = Scatter.MORE
    elif nis < band.low and earlier < earlier_band.low:
        scatter = Scatter.LESS
    return Symptoms(rejected=rejected, seen=seen, nis=nis, band=band, scatter=scatter)


def _mean_and_band(readings: Readings, which: slice) -> tuple[float, Band]:
    """Return the mean of NIS per degree of freedom, and its band for right readings."""
    rows = sum(readings.rows[which])
    if not rows:
        return math.nan, Band(0.0, math.inf)
    low, high = _band(rows)
    return sum(readings.nis[which]) / rows, Band(low / rows, high / rows)


def isolate_fault(
    recent: RecentPeriods, wheel_separation: float, *, learning: bool = False
) -> FaultIsolation:
    """Return the sensor that does not fit the others, by leads, wheel sizes and symptoms.

    Args:
        recent: the last periods.
        wheel_separation: distance between the wheels [m].
        learning: whether the noise is still being learned for the first time; then only readings
            that are rejected again and again name a sensor.
    """
    leads = recent.leads[-1].leads
    if max(leads) >= SUSPECTED_LEAD and not learning:
        return _by_leads(recent)
    suspected = {sensor for sensor, lead in _by_sensor(leads) if lead >= CLEARED_LEAD}
    if suspected <= {Sensor.ENCODERS} and not learning:
        sizes = estimate_sizes(recent.corrections, wheel_separation)
        if sizes is not None and sizes.wrong:
            return FaultIsolation(
                named=Sensor.ENCODERS, suspects=(Sensor.ENCODERS,), leads=leads, sizes=sizes
            )
    abnormal = {
        sensor
        for sensor, readings in (
            (Sensor.COMPASS, recent.readings.compass),
            (Sensor.LRF_POSE, recent.readings.lrf_pose),
        )
        if _is_abnormal(symptoms_of(readings), learning=learning)
    }
    if not abnormal:
        return NO_FAULT._replace(leads=leads)
    suspects = _in_order(abnormal | suspected)
    return FaultIsolation(
        named=suspects[0] if len(suspects) == 1 else None, suspects=suspects, leads=leads
    )


def _is_abnormal(symptoms: Symptoms, *, learning: bool) -> bool:
    return symptoms.rejected >= MANY_REJECTIONS if learning else symptoms.abnormal


def with_doubtful_yaw(found: FaultIsolation, sensor: Sensor, *, turned: bool) -> FaultIsolation:
    """Return the result where a sensor's yaw is off or may be, which shows in the others, too.

    Args:
        found: by leads and symptoms.
        sensor: whose yaw it is.
        turned: whether it was turned: the fixes have decided between it and the wheels.
    """
    if turned:
        return FaultIsolation(named=sensor, suspects=(sensor,), leads=found.leads)
    if not found.suspects or found.named is sensor:
        return found
    return found._replace(named=None, suspects=_in_order({sensor, *found.suspects}), sizes=None)


def without_unused(found: FaultIsolation, unused: set[Sensor]) -> FaultIsolation:
    """Return the result without sensors of which there is no reading: they cannot be the cause."""
    suspects = tuple(sensor for sensor in found.suspects if sensor not in unused)
    if suspects == found.suspects:
        return found
    named = suspects[0] if len(suspects) == 1 else None
    return found._replace(named=named, suspects=suspects)


def _by_leads(recent: RecentPeriods) -> FaultIsolation:
    """Return the first suspect if its lead is clear and lasts, otherwise all that are close."""
    leads = recent.leads[-1].leads
    by_lead = sorted(((lead, sensor) for sensor, lead in _by_sensor(leads)), reverse=True)
    (largest, first), (_, second) = by_lead[:2]
    if first is Sensor.ENCODERS and recent.agreeing >= AGREEING:
        return FaultIsolation(named=None, suspects=(Sensor.ENCODERS, Sensor.LRF_POSE), leads=leads)
    if all(_leader(each) is first for each in (leads, *(old.leads for old in recent.leads))):
        return FaultIsolation(named=first, suspects=(first,), leads=leads)
    close = {sensor for lead, sensor in by_lead if largest - lead < CLEAR_LEAD}
    return FaultIsolation(named=None, suspects=_in_order({first, second} | close), leads=leads)


def _by_sensor(leads: tuple[float, ...]) -> Iterator[tuple[Sensor, float]]:
    """Yield each suspect with its lead [nats]."""
    return zip(map(Sensor, SUSPECTS), leads, strict=True)


def _in_order(sensors: set[Sensor]) -> tuple[Sensor, ...]:
    return tuple(sensor for sensor in Sensor if sensor in sensors)


def _leader(leads: tuple[float, ...]) -> Sensor | None:
    """Return the suspect with a clear lead, if there is one."""
    first, second = sorted(leads, reverse=True)[:2]
    if first < SUSPECTED_LEAD or first - second < CLEAR_LEAD:
        return None
    return Sensor(SUSPECTS[leads.index(first)])


@cache
def _band(rows: int) -> Band:
    """Return the band of the sum of NIS of a number of rows."""
    half = 0.5 * BAND_CHANCE
    return Band(exceeded_with(1.0 - half, rows), exceeded_with(half, rows))
