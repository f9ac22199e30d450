# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Readings of fast sensors, and that nothing but the output depends on the period."""

import math
import random
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from circle_drives import BEGIN_NS, MS, compass, in_time, pose_at, readings
from localizers import SECOND_NS, estimates, feed, joints_localizer, same_estimates, statuses

from fnn_ekf_ros.core import filter as filter_module
from fnn_ekf_ros.core import joint_learning
from fnn_ekf_ros.core.angles import wrap_angle
from fnn_ekf_ros.core.arrays import FloatArray
from fnn_ekf_ros.parameters.localizer import LocalizerParameters
from fnn_ekf_ros.timeline.epochs import Cutter, instants
from fnn_ekf_ros.timeline.events import Event, Level, PoseFix, WheelCount

SHARED_NS = 3 * SECOND_NS
"""Interval at which the periods 0.02, 0.1, 0.375 and 1 s end together [ns]."""


@pytest.mark.parametrize("sensor", ["compass", "lrf_pose"])
@pytest.mark.slow
def test_a_sensor_that_is_too_fast_is_thinned_and_told(sensor: str) -> None:
    rates = {"compass_hz": 500.0} if sensor == "compass" else {"fix_hz": 500.0}
    arrivals = in_time(readings(3.0, **rates), 3.0)
    ran = joints_localizer(adaptation="none")
    outputs = feed(ran, arrivals)
    told = [s for s in statuses(outputs, sensor) if "too fast" in s.message]
    assert len(told) >= 2
    left_out = 0
    for status in told:
        assert status.level is Level.WARN
        assert status.message == "too fast: some readings are left out"
        values = dict(status.values)
        assert values["largest rate that is used [1/s]"] == "250"
        left_out += int(values["left out since the last report"])
        assert values["left out"] == str(left_out)
    # 3 s of 1500 readings, 94 taken in each of eight periods; the last second may not be told yet.
    assert 400 <= left_out <= 1500 - 8 * 94
    other = "lrf_pose" if sensor == "compass" else "compass"
    assert not any("left out" in dict(s.values) for s in statuses(outputs, other))
    for output in estimates(outputs)[1:8]:
        assert output.estimate is not None
        assert output.estimate.result is not None
        index = 0 if sensor == "compass" else 1
        most = 94 if sensor == "compass" else 188  # rows of 94 readings
        assert output.estimate.result.sensor_degrees_of_freedom[index] == most


@pytest.mark.parametrize(
    ("rate_hz", "period"), [(100.0, 0.375), (190.0, 0.375), (250.0, 0.375), (200.0, 0.29)]
)
@pytest.mark.slow
def test_a_fast_sensor_is_not_thinned(rate_hz: float, period: float) -> None:
    """Up to 250 Hz; 0.29 s times 200 Hz is a little less than 58 in floating point."""
    arrivals = in_time(readings(2.5, compass_hz=rate_hz, offset_ns=700), 2.5)
    outputs = feed(joints_localizer(adaptation="none", period=period), arrivals)
    reports = statuses(outputs, "compass")
    assert len(reports) >= 2
    for status in reports:
        assert "left out" not in dict(status.values)
        assert "too fast" not in status.message
    full = [o.estimate for o in estimates(outputs)[1:6]]
    taken = sum(int(e.result.sensor_degrees_of_freedom[0]) for e in full if e and e.result)
    assert abs(taken - rate_hz * 5 * period) <= 1.0


@pytest.mark.parametrize("mode", ["none", "joint"])
@pytest.mark.slow
def test_a_burst_of_a_very_fast_compass_is_bounded_work(
    monkeypatch: pytest.MonkeyPatch, mode: str
) -> None:
    """A second at 1000 Hz amid an ordinary drive."""
    fuse, calls = filter_module.fuse, [0]

    def counted(*told: Any) -> Any:
        calls[0] += 1
        return fuse(*told)

    monkeypatch.setattr(filter_module, "fuse", counted)
    rng = np.random.default_rng(2)
    burst: list[Event] = [
        compass(stamp, float(pose_at(stamp)[2]) + 0.134 * rng.standard_normal())
        for stamp in range(BEGIN_NS + SECOND_NS + 1, BEGIN_NS + 2 * SECOND_NS, MS)
    ]
    arrivals = in_time([*readings(4.0), *burst], 4.0)
    outputs, most = [], 0
    ran = joints_localizer(adaptation=mode)
    for now_ns, event in arrivals:
        before = calls[0]
        closed = ran.add(event, now_ns)
        outputs += closed
        if closed:
            most = max(most, (calls[0] - before) // len(closed))
    assert 94 <= most <= 94 + 1 + 1 + 1  # the compass's, a fix or two, the period's end
    found = [o.estimate for o in estimates(outputs)]
    assert len(found) >= 10
    for estimate in found:
        assert estimate is not None
        error = estimate.state.mean - pose_at(estimate.stamp_ns)
        assert np.hypot(*error[:2]) < 0.35
        assert abs(wrap_angle(error[2])) < 0.35
        assert np.linalg.eigvalsh(estimate.state.covariance)[0] > 0.0


# Nothing depends on the period, or on when a reading comes in


@pytest.fixture
def shared() -> Callable[..., dict[int, tuple[FloatArray, FloatArray, FloatArray, FloatArray]]]:
    """What a filter finds at the instants at which periods of any length end, every `SHARED_NS`."""

    def run(period: float, mode: str, seconds: float) -> Any:
        arrivals = in_time(readings(seconds, offset_ns=10 * MS + 13), seconds)
        outputs = estimates(feed(joints_localizer(period=period, adaptation=mode), arrivals))
        assert outputs[0].stamp_ns == BEGIN_NS  # it starts with its first readings
        states = {o.stamp_ns: o.estimate.state for o in outputs if o.estimate is not None}
        return {
            stamp: (s.mean, s.covariance, s.process_noise, s.measurement_noise)
            for stamp, s in states.items()
            if stamp % SHARED_NS == 0
        }

    return run


@pytest.mark.parametrize("period", [0.02, 0.1, 1.0])
@pytest.mark.slow
def test_the_plain_filter_does_not_depend_on_the_period(shared: Any, period: float) -> None:
    """But for where steps are cut.

    A period's end cuts a step, and of the noise in its middle the rest of the way makes a little
    variance sideways (`core.motion`). Here, 11 cuts between two readings move the standard
    deviations by 0.09 % at the most (0.04 mm), and the estimates by 0.03 mm and 0.003 mrad.
    """
    found, expected = shared(period, "none", 12.0), shared(0.375, "none", 12.0)
    assert found.keys() == expected.keys()
    assert len(found) >= 5
    for stamp, (x, P, _, _) in expected.items():
        mean, covariance, _, _ = found[stamp]
        np.testing.assert_allclose(mean[:2], x[:2], atol=5e-5)
        np.testing.assert_allclose(wrap_angle(mean[2] - x[2]), 0.0, atol=1e-5)
        stds, other = np.sqrt(np.diag(covariance)), np.sqrt(np.diag(P))
        np.testing.assert_allclose(stds, other, rtol=1.5e-3)


@pytest.mark.parametrize("period", [0.02, 1.0])
@pytest.mark.slow
def test_joint_adaptation_hardly_depends_on_the_period(shared: Any, period: float) -> None:
    """As the plain filter; what is learned of it differs by 0.3 % (variance) at the most."""
    found, expected = shared(period, "joint", 12.0), shared(0.375, "joint", 12.0)
    assert found.keys() == expected.keys()
    for stamp, (x, P, Q, R) in expected.items():
        mean, covariance, process, measurement = found[stamp]
        np.testing.assert_allclose(mean[:2], x[:2], atol=2e-4)
        np.testing.assert_allclose(wrap_angle(mean[2] - x[2]), 0.0, atol=2e-4)
        np.testing.assert_allclose(np.diag(covariance), np.diag(P), rtol=5e-3)
        np.testing.assert_allclose(process, Q, rtol=0.01)
        np.testing.assert_allclose(measurement, R, rtol=5e-3)


@pytest.mark.slow
def test_short_periods_mean_no_more_learning(monkeypatch: pytest.MonkeyPatch) -> None:
    """Joint adaptation learns from readings, of which there are as many whatever the period."""
    arrivals = in_time(readings(6.0, offset_ns=10 * MS), 6.0)
    learn, calls = joint_learning.learn, [0]

    def counted(*told: Any, **more: Any) -> Any:
        calls[0] += 1
        return learn(*told, **more)

    monkeypatch.setattr(joint_learning, "learn", counted)
    learned = []
    for period in (0.02, 0.375):
        calls[0] = 0
        outputs = estimates(feed(joints_localizer(period=period, adaptation="joint"), arrivals))
        assert outputs[-1].stamp_ns >= BEGIN_NS + 6 * SECOND_NS
        learned.append(calls[0])
    assert learned[0] == learned[1]
    fixes = sum(isinstance(a.event, PoseFix) for a in arrivals)
    # Every fix and one reading of the compass after each, if it did not share the fix's instant.
    assert fixes - 1 <= learned[0] <= 2 * fixes


@pytest.mark.parametrize(("period", "mode"), [(0.1, "none"), (0.375, "rq"), (0.375, "joint")])
@pytest.mark.slow
def test_readings_that_come_late_and_in_any_order_count_as_if_they_had_come_in_time(
    period: float, mode: str
) -> None:
    """Within `history`, bit for bit."""
    prompt = in_time(readings(5.0, offset_ns=7 * MS), 6.0)
    rng = random.Random(4)
    late = [
        a._replace(now_ns=a.now_ns + rng.randrange(800 * MS))
        if not isinstance(a.event, WheelCount)
        else a
        for a in prompt
    ]
    late.sort(key=lambda a: a.now_ns)
    settings = {"period": period, "adaptation": mode, "history": 2.0}
    since = max(a.now_ns for a in late if not isinstance(a.event, WheelCount))
    assert since > BEGIN_NS + 5 * SECOND_NS
    ran = []
    for arrivals in (prompt, late):
        outputs = feed(joints_localizer(**settings), arrivals)
        ran.append([o for o in outputs if o.stamp_ns > since])
    assert ran[0]
    same_estimates(*ran)
    assert ran[0][-1].estimate is not None


def test_the_papers_adaptation_takes_one_step_a_period_from_the_last_reading_of_each_row(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    adapt, told = filter_module.adapt, []

    def recorded(*arguments: Any) -> Any:
        told.append(arguments)
        return adapt(*arguments)

    monkeypatch.setattr(filter_module, "adapt", recorded)
    arrivals = in_time(readings(6.0, 20.0, 6.0, offset_ns=3 * MS), 6.0)
    ran = joints_localizer(
        adaptation="rq", innovation_window=5, measurement_noise_std=[0.3, 0.3, 0.3]
    )
    outputs = [o.estimate for o in estimates(feed(ran, arrivals))]
    steps = [e for e in outputs if e is not None and e.result is not None]
    assert len(told) == len(steps) >= 15
    before = None
    for estimate, (_, Q, R, window, variance, teaches, _, _) in zip(steps, told, strict=True):
        result = estimate.result
        assert result is not None
        for row in range(3):
            seen = [shown for shown in result.shown if shown.available[row]]
            if seen:
                assert result.innovation[row] == seen[-1].innovation[row]
                assert variance[row] == seen[-1].innovation_variance[row]
                assert bool(teaches[row]) == bool(seen[-1].teaches[row])
                assert result.innovation[row] ** 2 in window.squares[:, row]
        if before is not None:  # in between the noise was as it had been
            np.testing.assert_array_equal(Q, before.state.process_noise)
            np.testing.assert_array_equal(R, before.state.measurement_noise)
        before = estimate
    assert any(len([s for s in e.result.shown if s.available[2]]) > 5 for e in steps if e.result)
    assert np.any(steps[-1].state.measurement_noise[:3] < 0.08)


def test_what_a_fix_reports_of_a_yaw_that_is_not_used_does_not_matter() -> None:
    """Nobody has checked it."""
    parameters = LocalizerParameters(
        wheel_radius=0.05,
        wheel_separation=0.4,
        encoder_counts_per_revolution=500.0,
        lrf_use_message_covariance=True,
    )
    covariance = np.array([[0.04, 0.01, 1e300], [0.01, 0.09, math.nan], [1e300, math.nan, 1e300]])
    reading = PoseFix(BEGIN_NS + 5, np.array([1.0, 2.0, 0.5]), covariance)
    cutter = Cutter(parameters)
    (epoch,) = cutter.epochs(
        BEGIN_NS, BEGIN_NS + 5, instants((), (reading,)), lambda _: np.zeros(2), np.zeros(2)
    )
    assert epoch.fix_covariance is not None
    np.testing.assert_array_equal(epoch.fix_covariance[:2, :2], covariance[:2, :2])
    np.testing.assert_array_equal(epoch.fix_covariance[2], [0.0, 0.0, 1.0])
