# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Periods whose numbers fail, and drives without any measurement."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from localizers import (
    JOINTS,
    PERIOD_NS,
    SECOND_NS,
    START_NS,
    estimates,
    feed,
    make_localizer,
    same_estimates,
    simulated,
    status_at_end,
    statuses,
    time_values,
)

from fnn_ekf_ros.localizer import history
from fnn_ekf_ros.timeline.events import Level, PoseFix, WheelCount
from fnn_ekf_ros.timeline.inputs import InputBuffer, PeriodInputs
from fnn_ekf_ros.timeline.period import without_measurements


def breaking(
    monkeypatch: pytest.MonkeyPatch, fails: Callable[[Any, Any], bool], error: type[Exception]
) -> None:
    """Have periods fail for which `fails(before, inputs)`."""
    run_period = history.run_period

    def run(model: Any, before: Any, inputs: Any) -> Any:
        if fails(before, inputs):
            raise error("the test's numbers")
        return run_period(model, before, inputs)

    monkeypatch.setattr(history, "run_period", run)


@pytest.mark.parametrize("error", [FloatingPointError, np.linalg.LinAlgError])
@pytest.mark.slow
def test_a_period_that_fails_is_predicted_by_the_wheels(
    monkeypatch: pytest.MonkeyPatch, error: type[Exception]
) -> None:
    """The same as if nothing had been measured in it.

    Bit for bit as if its readings said nothing; without them the period is not cut at their
    instants, which on a path that is bent changes the pose by less than a millimeter.
    """
    arrivals = simulated(12, 30.0, "joint_states").arrivals
    bad = START_NS + 20 * SECOND_NS + 250_000_000  # its end is a multiple of the period
    bad -= bad % PERIOD_NS
    without = [
        a for a in arrivals
        if isinstance(a.event, WheelCount) or not bad - PERIOD_NS < a.event.stamp_ns <= bad
    ]  # fmt: skip
    expected = feed(make_localizer(**JOINTS), without)
    fixes = [a.event for a in arrivals if isinstance(a.event, PoseFix) and a.event.stamp_ns == bad]
    x = fixes[0].pose[0]

    def fails(_: Any, inputs: Any) -> bool:
        return any(e.available[0] and e.measurement[0] == x for e in inputs.epochs)

    period = InputBuffer.period

    def blind(*asked: Any) -> PeriodInputs:
        inputs = period(*asked)
        return without_measurements(inputs) if fails(None, inputs) else inputs

    with monkeypatch.context() as patch:
        patch.setattr(InputBuffer, "period", blind)
        blinded = feed(make_localizer(**JOINTS), arrivals)
    breaking(monkeypatch, fails, error)
    localizer = make_localizer(**JOINTS)
    outputs = feed(localizer, arrivals)
    same_estimates(outputs, blinded)
    same_estimates(*([o for o in each if o.stamp_ns < bad] for each in (outputs, expected)))
    assert len(outputs) == len(expected)
    for one, other in zip(estimates(outputs), estimates(expected), strict=True):
        assert one.estimate is not None
        assert other.estimate is not None
        np.testing.assert_allclose(one.estimate.state.mean, other.estimate.state.mean, atol=1e-3)
    said = [s for s in statuses(outputs, "filter") if "failed" in s.message]
    assert [status.level for status in said] == [Level.WARN]
    assert said[0].message == "a period failed: its measurements are left out"
    values = dict(status_at_end(localizer, "filter").values)
    assert values["periods that failed"] == "1"
    assert values["reason of the last failure"] == "the test's numbers"
    assert values["end of the last period that failed [s]"] == f"{bad * 1e-9:.3f}"
    assert time_values(localizer)["restarts"] == "0"


def test_a_filter_that_fails_on_the_wheels_alone_starts_anew_with_its_noise(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    arrivals = simulated(12, 30.0, "joint_states").arrivals
    localizer = make_localizer(adaptation="r", measurement_noise_std=[0.4, 0.4, 0.5], **JOINTS)
    half = len(arrivals) // 2
    before = feed(localizer, arrivals[:half])[-1].estimate
    assert before is not None
    failing = [True]
    breaking(monkeypatch, lambda *_: bool(failing[0]), FloatingPointError)
    rest = list(arrivals[half:])
    lost = []
    while not lost:
        a = rest.pop(0)
        lost = localizer.add(a.event, a.now_ns)
    assert [output.estimate for output in lost] == [None]
    said = [*statuses(lost, "filter"), status_at_end(localizer, "filter")]
    assert said[0].level is Level.WARN
    assert "starts anew" in said[0].message
    failing[0] = False
    found = estimates(feed(localizer, rest))
    assert len(found) > 30
    assert found[0].estimate is not None
    np.testing.assert_array_equal(
        found[0].estimate.state.measurement_noise, before.state.measurement_noise
    )
    assert status_at_end(localizer, "filter").level is Level.OK


@pytest.mark.slow
def test_a_state_that_is_no_longer_finite_is_not_gone_on_with(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    run_period = history.run_period

    def run(model: Any, before: Any, inputs: Any) -> Any:
        after, result = run_period(model, before, inputs)
        if result is not None and result.degrees_of_freedom and number[0] == 0:
            covariance = after.bank.covariance * np.nan
            after = after._replace(bank=after.bank._replace(covariance=covariance))
        number[0] -= 1
        return after, result

    number = [40]
    monkeypatch.setattr(history, "run_period", run)
    outputs = estimates(
        feed(make_localizer(**JOINTS), simulated(12, 30.0, "joint_states").arrivals)
    )
    assert number[0] < -20
    for output in outputs:
        assert output.estimate is not None
        assert np.all(np.isfinite(output.estimate.state.mean))
        assert np.linalg.eigvalsh(output.estimate.state.covariance)[0] > 0.0
    stamps = [output.stamp_ns for output in outputs]
    assert np.all(np.diff(stamps) == PERIOD_NS)


@pytest.mark.parametrize(
    ("adaptation", "lasting_errors"),
    [("none", False), ("r", False), ("q", False), ("rq", False), ("joint", False), ("joint", True)],
)
@pytest.mark.slow
def test_without_any_measurement_the_covariance_grows(
    adaptation: str, lasting_errors: bool
) -> None:
    arrivals = simulated(12, 60.0, "joint_states").arrivals
    since = START_NS + 20 * SECOND_NS
    blind = [a for a in arrivals if isinstance(a.event, WheelCount) or a.now_ns < since]
    localizer = make_localizer(adaptation=adaptation, lasting_errors=lasting_errors, **JOINTS)
    outputs = estimates(feed(localizer, blind))
    late = [o.estimate.state for o in outputs if o.estimate and o.stamp_ns > since]
    assert len(late) > 100
    assert np.all(np.diff([np.linalg.det(state.covariance) for state in late]) > 0.0)
    growth = np.diff([state.covariance[2, 2] for state in late])
    if lasting_errors:  # alarms count in part, and members differ in their noise
        assert np.all(growth > 0.0)
    else:
        Q = [state.process_noise[1] for state in late[:-1]]
        np.testing.assert_allclose(growth, Q, rtol=1e-9)


@pytest.mark.parametrize("adaptation", ["none", "joint"])
@pytest.mark.parametrize("source", ["ticks", "joint_states"])
@pytest.mark.slow
def test_what_fixes_have_measured_while_the_wheels_were_silent_is_not_counted_again(
    adaptation: str, source: str
) -> None:
    """Twenty seconds: the robot drove on, fixes and compass followed it, then the wheels speak."""
    run = simulated(21, 60.0, source)
    silent = [
        each
        for each in run.arrivals
        if not (
            isinstance(each.event, WheelCount) and 20.0 < (each.now_ns - START_NS) * 1e-9 < 40.0
        )
    ]
    localizer = make_localizer(encoder_source=source, adaptation=adaptation)
    errors = [
        np.hypot(*(output.estimate.state.mean - run.truth[output.stamp_ns])[:2])
        for output in estimates(feed(localizer, silent))
        if output.stamp_ns in run.truth and output.stamp_ns > START_NS + 39 * SECOND_NS
    ]
    assert len(errors) > 40
    assert max(errors) < 1.0


@pytest.mark.slow
def test_without_fixes_the_way_of_silent_wheels_is_counted_when_they_speak_again() -> None:
    """A compass alone: the way is not known otherwise, the turn is."""
    run = simulated(22, 60.0, path="square")
    before = START_NS + 18 * SECOND_NS
    blind = [
        each
        for each in run.arrivals
        if each.now_ns <= before
        or not isinstance(each.event, PoseFix | WheelCount)
        or (isinstance(each.event, WheelCount) and each.now_ns > before + 5 * SECOND_NS)
    ]
    outputs = estimates(feed(make_localizer(adaptation="none"), blind))
    at = {output.stamp_ns: output.estimate.state.mean for output in outputs}
    after = before + 6 * SECOND_NS
    moved = (at[after] - at[before])[:2]
    true = (run.truth[after] - run.truth[before])[:2]
    assert np.hypot(*true) > 1.0
    assert np.hypot(*(moved - true)) < 0.5 * np.hypot(*true)


def test_a_clock_that_jumps_ahead_is_told() -> None:
    run = simulated(23, 20.0)
    localizer = make_localizer()
    late = START_NS + 10 * SECOND_NS
    jumped = [
        each._replace(
            now_ns=each.now_ns + 30 * SECOND_NS,
            event=each.event._replace(stamp_ns=each.event.stamp_ns + 30 * SECOND_NS),
        )
        if each.now_ns > late
        else each
        for each in run.arrivals
    ]
    said = [s.message for s in statuses(feed(localizer, jumped), "time") if s.level is Level.WARN]
    assert "the clock jumped ahead, or no message arrived for a while" in said
    assert time_values(localizer)["restarts"] == "0"
