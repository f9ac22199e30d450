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
    Run,
    estimates,
    feed,
    joints_localizer,
    make_localizer,
    same_estimates,
    simulated,
    status_at_end,
    time_values,
)

from fnn_ekf_ros.localizer.localizer import SMALLEST_STEP_NS, Localizer
from fnn_ekf_ros.simulation.delivery import STEP_NS
from fnn_ekf_ros.timeline.events import PoseFix, WheelCount

SET_NS = START_NS + 20 * SECOND_NS
"""True time at which the clock is set back [ns]."""
LATER_NS = 200 * SECOND_NS
"""What the clock shows more than true time before that [ns]."""


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


def set_back(run: Run, step_s: float) -> list[Arrival]:
    """Return the arrivals by a clock that is set back in the middle, far from its beginning."""
    step_ns = round(step_s * 1e9)
    return [
        a._replace(now_ns=a.now_ns + by, event=a.event._replace(stamp_ns=a.event.stamp_ns + by))
        for a in run.arrivals
        for by in [LATER_NS if a.now_ns < SET_NS else LATER_NS - step_ns]
    ]


def errors_after(run: Run, step_s: float, source: str) -> tuple[list[float], list[int], Localizer]:
    """Return errors of odom [m] after the clock was set, the true times between odom [ns]."""
    localizer = make_localizer(encoder_source=source)
    errors, published = [], []
    for true, arrival in zip(run.arrivals, set_back(run, step_s), strict=True):
        by_ns = arrival.now_ns - true.now_ns
        for output in estimates(localizer.add(arrival.event, arrival.now_ns)):
            assert output.estimate is not None
            assert output.stamp_ns % PERIOD_NS == 0
            published.append(true.now_ns)
            if true.now_ns >= SET_NS:
                pose = run.truth[min(run.truth, key=lambda s: abs(s + by_ns - output.stamp_ns))]
                errors.append(float(np.linalg.norm(output.estimate.state.mean[:2] - pose[:2])))
    return errors, np.diff(published).tolist(), localizer


@pytest.mark.parametrize("source", ["ticks", "joint_states"])
@pytest.mark.parametrize("step_s", [0.2, 0.5, 1.0, 1.9])
@pytest.mark.slow
def test_a_clock_that_is_set_back_costs_nothing(step_s: float, source: str) -> None:
    """All that is kept moves with it: no odom is missing, and none is where the robot was not."""
    run = simulated(12, 40.0, source)
    errors, intervals_ns, localizer = errors_after(run, step_s, source)
    expected, expected_ns, _ = errors_after(run, 0.0, source)
    assert max(intervals_ns) <= max(expected_ns) + STEP_NS
    assert max(errors) <= 1.2 * max(expected)
    assert np.sqrt(np.mean(np.square(errors))) <= 1.2 * np.sqrt(np.mean(np.square(expected)))
    assert time_values(localizer)["steps back"] == "1"
    assert time_values(localizer)["restarts"] == "0"


@pytest.mark.parametrize("source", ["ticks", "joint_states"])
@pytest.mark.parametrize("step_s", [2.1, 100.0])
@pytest.mark.slow
def test_a_clock_that_is_set_back_by_much_does_not_lose_the_robot(
    step_s: float, source: str
) -> None:
    errors, _, localizer = errors_after(simulated(12, 40.0, source), step_s, source)
    assert time_values(localizer)["restarts"] == "1"
    assert len(errors) > 40
    assert errors[-1] < 0.5


def test_what_was_stamped_before_the_clock_was_set_back_is_read_by_the_old_clock() -> None:
    """A fix on its way is fused at the time it was taken, as if the clock had been right."""
    run = simulated(12, 24.0, "joint_states")
    late = [a for a in run.arrivals if isinstance(a.event, PoseFix) and a.now_ns < SET_NS][-1]
    fix_ns = late.event.stamp_ns
    found = []
    for ahead_ns in (0, 1_500_000_000):  # by the right clock, and by the one before it was set
        localizer = joints_localizer(adaptation="none")
        moved = [a for a in set_back(run, 1.5) if a.event.stamp_ns != fix_ns + LATER_NS]
        at = next(i for i, a in enumerate(moved) if i and a.now_ns < moved[i - 1].now_ns)
        stamp_ns = fix_ns + LATER_NS - 1_500_000_000 + ahead_ns
        moved.insert(at + 2, Arrival(moved[at + 1].now_ns, late.event._replace(stamp_ns=stamp_ns)))
        outputs = estimates(feed(localizer, moved))
        found.append([o.estimate.state.mean for o in outputs if o.estimate is not None])
        assert time_values(localizer)["dropped"] == "0"
    # The step is known to the time between two messages, in which the robot moves a centimeter.
    np.testing.assert_allclose(*found, atol=0.02)


def test_small_differences_of_the_clock_are_none() -> None:
    run = simulated(12, 10.0, "joint_states")
    localizer = joints_localizer(adaptation="none")
    for place, arrival in enumerate(run.arrivals):
        localizer.add(arrival.event, arrival.now_ns - (place % 2) * SMALLEST_STEP_NS // 2)
    assert time_values(localizer)["steps back"] == "0"


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
