# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Clocks that are set, that begin at 0, and stamps from the future."""

import numpy as np
import pytest
from localizers import (
    JOINTS,
    PERIOD_NS,
    SECOND_NS,
    START_NS,
    Arrival,
    estimates,
    feed,
    make_localizer,
    same_estimates,
    simulated,
    status_at_end,
    time_values,
)

from fnn_ekf_ros.timeline.events import WheelCount


@pytest.mark.parametrize("step_s", [0.3, 1.5, 30.0, 300.0])
@pytest.mark.slow
def test_a_clock_that_is_set_forward_costs_certainty_only(step_s: float) -> None:
    """The time between is filled; the way since is counted, and the fixes find it again."""
    run = simulated(12, 40.0, "joint_states")
    set_ns, step_ns = START_NS + 20 * SECOND_NS, round(step_s * 1e9)
    moved = [
        a if a.now_ns < set_ns
        else a._replace(
            now_ns=a.now_ns + step_ns,
            event=a.event._replace(stamp_ns=a.event.stamp_ns + step_ns),
        )
        for a in run.arrivals
    ]  # fmt: skip
    localizer = make_localizer(adaptation="none", **JOINTS)
    outputs = estimates(feed(localizer, moved))
    stamps = [output.stamp_ns for output in outputs]
    assert np.all(np.diff(stamps) == PERIOD_NS)
    assert time_values(localizer)["restarts"] == "0"
    assert dict(status_at_end(localizer, "encoders").values)["jumps"] == "0"
    last = outputs[-1].estimate
    assert last is not None
    truth_ns = min(run.truth, key=lambda s: abs(s - (last.stamp_ns - step_ns)))
    assert np.linalg.norm(last.state.mean[:2] - run.truth[truth_ns][:2]) < 0.5


@pytest.mark.parametrize("source", ["ticks", "joint_states"])
@pytest.mark.parametrize("step_s", [-0.2, -1.0, -1.9, -2.1, -100.0])
@pytest.mark.slow
def test_a_clock_that_is_set_back_does_not_lose_the_robot(step_s: float, source: str) -> None:
    run = simulated(12, 40.0, source)
    set_ns, step_ns = START_NS + 20 * SECOND_NS, round(step_s * 1e9)
    later = 200 * SECOND_NS
    moved = [
        a._replace(now_ns=a.now_ns + by, event=a.event._replace(stamp_ns=a.event.stamp_ns + by))
        for a in run.arrivals
        for by in [later if a.now_ns < set_ns else later + step_ns]
    ]
    localizer = make_localizer(encoder_source=source, adaptation="none")
    outputs = estimates(feed(localizer, moved))
    assert time_values(localizer)["restarts"] == str(int(step_s < -2.0))
    assert len(outputs) > 85
    last = outputs[-1].estimate
    assert last is not None
    truth_ns = min(run.truth, key=lambda s: abs(s + later + step_ns - last.stamp_ns))
    assert np.linalg.norm(last.state.mean[:2] - run.truth[truth_ns][:2]) < 0.5
    assert np.all(np.isfinite(last.state.covariance))


@pytest.mark.slow
def test_simulated_time_may_begin_at_0() -> None:
    arrivals = simulated(12, 15.0, "joint_states").arrivals
    moved = [
        a._replace(
            now_ns=a.now_ns - START_NS, event=a.event._replace(stamp_ns=a.event.stamp_ns - START_NS)
        )
        for a in arrivals
    ]
    localizer = make_localizer(**JOINTS)
    outputs = feed(localizer, moved)
    assert min(output.stamp_ns for output in outputs) >= 0
    shifted = [
        output._replace(stamp_ns=output.stamp_ns + START_NS) for output in estimates(outputs)
    ]
    same_estimates(shifted, estimates(feed(make_localizer(**JOINTS), arrivals)))


@pytest.mark.parametrize(("ahead_s", "kept"), [(0.9, True), (1.1, False)])
@pytest.mark.slow
def test_a_position_from_the_future_does_not_close_what_is_open(ahead_s: float, kept: bool) -> None:
    """One message whose stamp is wrong: it is dropped, or used only when its time has come."""
    run = simulated(12, 20.0, "joint_states")
    now = START_NS + 10 * SECOND_NS + 1
    before = [a for a in run.arrivals if a.now_ns < now]
    wrong = [
        Arrival(now, a.event._replace(stamp_ns=now + round(ahead_s * 1e9)))
        for a in before[-12:] if isinstance(a.event, WheelCount)
    ][-2:]  # fmt: skip
    localizer = make_localizer(adaptation="none", **JOINTS)
    outputs = feed(localizer, [*before, *wrong, *(a for a in run.arrivals if a.now_ns > now)])
    assert [o.stamp_ns for o in feed(make_localizer(**JOINTS), run.arrivals)] == [
        o.stamp_ns for o in outputs
    ]
    assert time_values(localizer)["dropped"] == ("0" if kept else "2")
    for output in estimates(outputs):
        assert output.estimate is not None
        error = output.estimate.state.mean[:2] - run.truth[output.stamp_ns][:2]
        assert np.linalg.norm(error) < 0.5
