# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The health of a run, counted from the outputs of localizers."""

import functools
import itertools
import math
import pickle
from typing import Any

import numpy as np
import pytest
from localizers import START_NS, Arrival, feed, make_localizer, make_parameters, simulated

from fnn_ekf_ros.diagnostics.health import (
    HONEST_FACTOR,
    MOST_ROWS,
    SUSPICIOUS_FACTOR,
    UNHEALTHY_SHARE,
    FoundNoise,
    HealthSummary,
    SensorHealth,
    SensorNis,
    StatusHealth,
    Verdict,
    honest_band,
)
from fnn_ekf_ros.diagnostics.health_monitor import HealthMonitor
from fnn_ekf_ros.diagnostics.messages import fitting_value
from fnn_ekf_ros.localizer.localizer import Localizer
from fnn_ekf_ros.timeline.events import CompassYaw, Level, Move, Output, PoseFix, Sensor, Status

SECONDS = 20.0
RIGHT = {"process_noise_std": (0.02, 0.0175)}
"""Noise of the simulated wheels (m, rad)."""


def followed(outputs: list[Output], **changes: Any) -> HealthSummary:
    """Return the summary of a run's outputs."""
    monitor = HealthMonitor(make_parameters(**changes))
    for output in outputs:
        monitor.saw(output)
    summary = monitor.summary()
    assert summary is not None
    return summary


@functools.cache
def drive(**changes: Any) -> tuple[Localizer, list[Output]]:
    """Return a localizer after a simulated drive, and what it gave; kept."""
    localizer = make_localizer(**changes)
    return localizer, feed(localizer, simulated(3, SECONDS).arrivals)


@pytest.fixture(scope="module")
def estimated() -> Output:
    """An output with an estimate, and without a report."""
    _, outputs = drive()
    return next(o for o in outputs if o.estimate is not None)._replace(statuses=None)


def reported(estimated: Output, *reports: tuple[Level, str]) -> HealthSummary:
    """Return the summary of a run whose status `filter` was reported so."""
    outputs = [estimated]
    outputs += [
        Output(START_NS, None, (Status("filter", level, message, (("key", str(number)),)),))
        for number, (level, message) in enumerate(reports)
    ]
    return followed(outputs)


def test_before_the_filter_starts_there_is_no_summary_and_nothing_counts(
    estimated: Output,
) -> None:
    monitor = HealthMonitor(make_parameters())
    waiting = Status("filter", Level.WARN, "waiting for the first yaw", ())
    assert estimated.estimate is not None
    monitor.saw(Output(START_NS, None, (waiting,)))
    assert monitor.summary() is None
    monitor.saw(estimated)
    summary = monitor.summary()
    assert summary is not None
    assert summary.statuses == ()
    assert summary.awaited == "waiting for the first yaw"
    assert summary.started_ns == estimated.estimate.stamp_ns
    assert summary.healthy


def test_reports_are_counted_by_level_and_message(estimated: Output) -> None:
    (found,) = reported(
        estimated, (Level.OK, "fine"), (Level.WARN, "a"), (Level.ERROR, "b; a"), (Level.OK, "fine")
    ).statuses
    assert found == StatusHealth("filter", 4, 1, 1, Level.OK, "a", 2, (("key", "2"),))
    assert (found.worst, found.share) == (Level.ERROR, 0.5)


@pytest.mark.parametrize(
    ("warnings", "at_end", "healthy"),
    [(0, False, True), (5, False, True), (6, False, False), (1, True, False)],
)
def test_a_status_above_ok_for_a_while_or_at_the_end_is_not_healthy(
    estimated: Output, warnings: int, at_end: bool, healthy: bool
) -> None:
    assert UNHEALTHY_SHARE == 0.05
    reports = [(Level.WARN, "a")] * warnings + [(Level.OK, "fine")] * (100 - warnings)
    summary = reported(estimated, *(reports[::-1] if at_end else reports))
    assert summary.healthy is healthy


@pytest.mark.slow
def test_nis_is_the_mean_of_the_accepted_readings() -> None:
    """Compared with the sum over what each instant showed; two wild fixes are rejected."""
    arrivals = list(simulated(3, SECONDS).arrivals)
    fixes = [n for n, arrival in enumerate(arrivals) if isinstance(arrival.event, PoseFix)]
    for n in (fixes[20], fixes[30]):
        event = arrivals[n].event
        assert isinstance(event, PoseFix)
        arrivals[n] = Arrival(arrivals[n].now_ns, event._replace(pose=event.pose + 20.0))
    outputs = feed(make_localizer(), arrivals)
    shown = [
        each
        for output in outputs
        if output.estimate is not None and output.estimate.result is not None
        for each in output.estimate.result.shown
    ]
    summary = followed(outputs)
    for nis, index in zip(summary.nis, (0, 1), strict=True):
        rows = [s.sensor_degrees_of_freedom[index] * ~s.rejected[index] for s in shown]
        values = [s.sensor_nis[index] * ~s.rejected[index] for s in shown]
        assert nis.rows == sum(rows)
        assert nis.mean == pytest.approx(sum(values) / sum(rows), rel=1e-12)
    sensors = {each.sensor: each for each in summary.sensors}
    assert sensors[Sensor.LRF_POSE].rejected == 2
    assert sensors[Sensor.LRF_POSE].in_time == sum(
        s.sensor_degrees_of_freedom[1] > 0 for s in shown
    )
    assert sensors[Sensor.COMPASS].rejected == 0


@pytest.mark.slow
def test_messages_are_counted_by_what_became_of_them() -> None:
    """One compass reading is far too late; messages before the start count, too."""
    arrivals = list(simulated(3, SECONDS).arrivals)
    late = CompassYaw(START_NS + 5 * 10**9, 0.0)
    arrivals.append(Arrival(arrivals[-1].now_ns, late))
    localizer = make_localizer()
    outputs = feed(localizer, arrivals)
    end_ns = arrivals[-1].now_ns + 2 * 10**9
    outputs += localizer.advance(end_ns)
    found = {each.sensor: each for each in followed(outputs).sensors}
    compass = sum(isinstance(each.event, CompassYaw) for each in arrivals) - 1
    assert found[Sensor.COMPASS].received == compass
    assert found[Sensor.COMPASS].dropped == 1
    assert found[Sensor.LRF_POSE].dropped == 0
    assert found[Sensor.ENCODERS] == SensorHealth(
        Sensor.ENCODERS, sum(not isinstance(e.event, CompassYaw | PoseFix) for e in arrivals),
        0, 0, 0, 0, 0, 0,
    )  # fmt: skip


@pytest.mark.slow
def test_late_readings_are_there_but_not_in_time() -> None:
    """Fixes come 0.8 s late, two periods after they were taken."""
    arrivals = [
        Arrival(now_ns, event._replace(stamp_ns=event.stamp_ns - 800_000_000))
        if isinstance(event, PoseFix)
        else Arrival(now_ns, event)
        for now_ns, event in simulated(3, SECONDS).arrivals
    ]
    summary = followed(feed(make_localizer(), arrivals))
    _, compass, fixes = summary.sensors
    assert not compass.mostly_late
    assert compass.late <= 2
    assert fixes.mostly_late
    assert fixes.received >= fixes.late > 40
    assert "fixes' x" in [each.name for each in summary.noise]


@pytest.mark.parametrize("mode", ["joint", "rq", "none"])
@pytest.mark.slow
def test_the_noise_that_was_found_is_what_the_localizer_would_save(mode: str) -> None:
    changes: dict[str, Any] = {"adaptation": mode, "lrf_use_yaw": True}
    localizer, outputs = drive(**changes)
    saved = localizer.saved()
    assert saved is not None
    summary = followed(outputs, **changes)
    variances = [*saved.process_noise, *saved.measurement_noise]
    assert [each.found for each in summary.noise] == pytest.approx(np.sqrt(variances), rel=1e-12)
    assert [each.configured for each in summary.noise] == pytest.approx(
        [0.05, 0.0524, 0.1, 0.1, 0.1342, 0.1342], rel=1e-3
    )
    if mode == "none":
        assert all(each.factor == pytest.approx(1.0, rel=1e-12) for each in summary.noise)


def test_noise_of_a_sensor_that_is_not_there_is_left_out() -> None:
    no_compass = [a for a in simulated(3, SECONDS).arrivals if not isinstance(a.event, CompassYaw)]
    changes = {"lrf_use_yaw": True}
    summary = followed(feed(make_localizer(**changes), no_compass), **changes)
    names = [each.name for each in summary.noise]
    assert names == ["distance", "rotation", "fixes' x", "fixes' y", "fixes' yaw"]
    assert [each.sensor for each in summary.nis] == [Sensor.LRF_POSE]


def test_noise_far_above_the_configured_one_is_not_healthy(estimated: Output) -> None:
    summary = followed([estimated])
    for factor, healthy in (
        (0.97 * SUSPICIOUS_FACTOR, True), (1.03 * SUSPICIOUS_FACTOR, False), (0.01, True),
    ):  # fmt: skip
        noise = (FoundNoise("distance", "m", 0.1, 0.1 * factor, 0.1),)
        assert summary._replace(noise=noise).healthy is healthy
    tuned = (FoundNoise("distance", "m", 0.001, 0.02, 0.05),)
    assert summary._replace(noise=tuned).healthy


@pytest.mark.parametrize(
    ("mean", "verdict"),
    [(0.6, Verdict.TOO_CAUTIOUS), (0.7, Verdict.HONEST), (1.4, Verdict.HONEST),
     (1.6, Verdict.TOO_SURE)],
)  # fmt: skip
def test_a_filter_that_is_too_sure_is_not_healthy(
    estimated: Output, mean: float, verdict: Verdict
) -> None:
    nis = SensorNis(Sensor.COMPASS, mean, 1000, honest_band(1000))
    assert nis.verdict is verdict
    assert followed([estimated])._replace(nis=(nis,)).healthy is (verdict is not Verdict.TOO_SURE)


def test_the_band_is_wide_for_few_rows_and_that_of_the_factor_for_many() -> None:
    """Two rows: a chi-square variable exceeds -2 ln p with probability p."""
    few = honest_band(2)
    assert few.low == pytest.approx(-math.log(1.0 - 0.0005), rel=1e-9)
    assert few.high == pytest.approx(-math.log(0.0005), rel=1e-9)
    widths = [honest_band(rows) for rows in (1, 2, 5, 20, 60, 150, MOST_ROWS - 1, MOST_ROWS)]
    assert all(a.low <= b.low and a.high >= b.high for a, b in itertools.pairwise(widths))
    assert widths[-2] == widths[-1] == (1.0 / HONEST_FACTOR, HONEST_FACTOR)


def test_right_readings_are_inside_their_band() -> None:
    rng = np.random.default_rng(4)
    for rows in (2, 10, 60):
        low, high = honest_band(rows)
        means = rng.chisquare(rows, 20_000) / rows
        assert np.mean((means < low) | (means > high)) < 2e-3


def test_parameters_that_would_fit_are_those_of_the_last_report(estimated: Output) -> None:
    off = Status("compass", Level.WARN, "off", (fitting_value("compass_offset", -0.8),))
    late = Status("lrf_pose", Level.WARN, "late", (fitting_value("lrf_pose_delay", 0.3),))
    outputs = [Output(START_NS, None, found) for found in ((off, late), (late,))]
    assert followed([estimated, outputs[0]]).fitting == (
        ("compass_offset", -0.8), ("lrf_pose_delay", 0.3),
    )  # fmt: skip
    assert followed([estimated, *outputs]).fitting == (("lrf_pose_delay", 0.3),)


def test_moves_are_counted(estimated: Output) -> None:
    moves = [Move(START_NS + n, 1.0 + n, 0.1) for n in range(2)]
    summary = followed([estimated, *(Output(START_NS, None, None, move) for move in moves)])
    assert (summary.moves, summary.last_move) == (2, moves[1])


def test_a_long_run_takes_no_more_memory_than_a_short_one() -> None:
    """The sizes are of everything that the monitor holds; numbers grow by their digits only."""
    _, outputs = drive()
    sizes = []
    for times in (2, 20):
        monitor = HealthMonitor(make_parameters())
        for _ in range(times):
            for output in outputs:
                monitor.saw(output)
        sizes.append(len(pickle.dumps(monitor)))
    assert sizes[1] < sizes[0] + 100


@pytest.mark.slow
def test_a_run_as_configured_is_healthy_and_one_with_wrong_wheels_is_not() -> None:
    _, outputs = drive(**RIGHT)
    assert followed(outputs, **RIGHT).healthy
    wrong = RIGHT | {"left_inverted": True}
    _, outputs = drive(**wrong)
    summary = followed(outputs, **wrong)
    assert not summary.healthy
