# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""How healthy a whole run was, as a value; `health_monitor.py` makes it."""

from enum import StrEnum
from typing import NamedTuple

from fnn_ekf_ros.core.chi_square import exceeded_with
from fnn_ekf_ros.diagnostics.fault_isolation import BAND_CHANCE, Band
from fnn_ekf_ros.diagnostics.travel import TravelRatios
from fnn_ekf_ros.parameters.localizer import LocalizerParameters
from fnn_ekf_ros.timeline.events import Level, Move, Sensor

HONEST_FACTOR = 1.5
"""Largest mean NIS per degree of freedom of an honest filter, and the inverse of the smallest one:
assumed standard deviations are then right within 22 %, which is as good as errors of real sensors,
which are not quite white, allow to say."""
MOST_ROWS = 250
"""Number of rows from which on chance moves a mean NIS by less than `HONEST_FACTOR` does: its
chi-square band is not computed any more."""


UNHEALTHY_SHARE = 0.05
"""Share of the reports of a status above OK up to which a run is healthy: what happens once, such
as a robot that is carried, stays below it within a few minutes of driving."""
SUSPICIOUS_FACTOR = 10.0
"""Found standard deviation over the configured one from which on the configuration does not fit:
twice as far off as the starts that adaptation is made for, it rather is another mistake that is
taken for noise, such as another unit."""


LATE_READINGS = 10
"""Number of late readings up to which they are not worth a word: those at the start are among
them."""


class Verdict(StrEnum):
    """What the NIS of a sensor says of the uncertainty that the filter claims."""

    HONEST = "honest"
    TOO_SURE = "too sure"
    TOO_CAUTIOUS = "too cautious"


class StatusHealth(NamedTuple):
    """The reports of one status.

    Attributes:
        name: of the status.
        reports: their number.
        warnings: number of those at level WARN.
        errors: number of those at level ERROR.
        last: level of the last one.
        message: the one that lasted longest at a level above OK; empty if there was none.
        message_reports: number of its reports.
        values: keys and values of the last report that had it.
    """

    name: str
    reports: int
    warnings: int
    errors: int
    last: Level
    message: str
    message_reports: int
    values: tuple[tuple[str, str], ...]

    @property
    def worst(self) -> Level:
        """The worst level."""
        if self.errors:
            return Level.ERROR
        return Level.WARN if self.warnings else Level.OK

    @property
    def share(self) -> float:
        """Share of the reports above OK."""
        return (self.warnings + self.errors) / self.reports if self.reports else 0.0

    @property
    def healthy(self) -> bool:
        """Whether it was above OK for a short while only, and not at the end."""
        return self.last is Level.OK and self.share <= UNHEALTHY_SHARE


class FoundNoise(NamedTuple):
    """A standard deviation, configured and found.

    Attributes:
        name: as diagnostics have it.
        unit: of both.
        configured: by the parameters.
        found: at the end of the run, without what an alarm adds.
        usual: the parameter's default.
    """

    name: str
    unit: str
    configured: float
    found: float
    usual: float

    @property
    def factor(self) -> float:
        """The found one over the configured one."""
        return self.found / self.configured

    @property
    def suspicious(self) -> bool:
        """Whether it is so large that the configuration cannot be right.

        A noise below the usual one is no sign of it, however small the configured one is.
        """
        return self.factor >= SUSPICIOUS_FACTOR and self.found >= self.usual


class SensorHealth(NamedTuple):
    """What became of the messages of a sensor.

    Attributes:
        sensor: which one.
        received: number of messages that were taken in.
        refused: number that could not be used.
        dropped: number whose stamp was too old, or ahead of the clock.
        left_out: number of readings that were too many.
        in_time: number of readings that the filter saw before their period was closed; 0 for the
            encoders, as the next two.
        late: number of later ones from the last report before the start on; the filter takes them
            in as well, but the outputs do not tell what came of them.
        rejected: number of readings in time that the gate rejected.
    """

    sensor: Sensor
    received: int
    refused: int
    dropped: int
    left_out: int
    in_time: int
    late: int
    rejected: int

    @property
    def mostly_late(self) -> bool:
        """Whether few of the readings came in time."""
        return self.late > max(LATE_READINGS, self.in_time)


class SensorNis(NamedTuple):
    """The NIS of the accepted readings of a sensor, per degree of freedom.

    Attributes:
        sensor: which one.
        mean: of all readings.
        rows: number of degrees of freedom.
        band: of the mean, where the filter is honest.
    """

    sensor: Sensor
    mean: float
    rows: int
    band: Band

    @property
    def verdict(self) -> Verdict:
        """Whether the filter is as sure as it may be."""
        if self.mean > self.band.high:
            return Verdict.TOO_SURE
        return Verdict.TOO_CAUTIOUS if self.mean < self.band.low else Verdict.HONEST


class HealthSummary(NamedTuple):
    """How healthy a run was.

    Attributes:
        parameters: of the localizer.
        started_ns: stamp of the first estimate [ns].
        estimates: number of estimates.
        awaited: message of the status `filter` in the last report before the first estimate.
        statuses: of diagnostics, in their order.
        noise: process noise, then measurement noise of the sensors that are used.
        nis: of the sensors with readings.
        travel: of the pose, over that of the wheels.
        sensors: what became of the messages of each.
        lasting: what was believed of lasting errors at the end; empty where they are not followed.
        fitting: parameters that would fit by the last report, and their values.
        moves: number of relocations.
        last_move: the last one.
    """

    parameters: LocalizerParameters
    started_ns: int
    estimates: int
    awaited: str
    statuses: tuple[StatusHealth, ...]
    noise: tuple[FoundNoise, ...]
    nis: tuple[SensorNis, ...]
    travel: TravelRatios
    sensors: tuple[SensorHealth, ...]
    lasting: str
    fitting: tuple[tuple[str, bool | float | str], ...]
    moves: int
    last_move: Move | None

    @property
    def healthy(self) -> bool:
        """Whether statuses, NIS, noise and wheels are as they should be.

        A filter that is too cautious, as one that follows lasting errors is, does no harm.
        """
        return (
            all(status.healthy for status in self.statuses)
            and not any(nis.verdict is Verdict.TOO_SURE for nis in self.nis)
            and not any(noise.suspicious for noise in self.noise)
            and not any(ratio is not None and ratio.wrong for ratio in self.travel)
        )


def honest_band(rows: int) -> Band:
    """Return the band of the mean NIS per degree of freedom of a number of rows, if it is honest.

    It is that of `HONEST_FACTOR`, wider where there are so few rows that chance may leave it.
    """
    low, high = 1.0 / HONEST_FACTOR, HONEST_FACTOR
    if rows < MOST_ROWS:
        half = 0.5 * BAND_CHANCE
        low = min(low, exceeded_with(1.0 - half, rows) / rows)
        high = max(high, exceeded_with(half, rows) / rows)
    return Band(low, high)
