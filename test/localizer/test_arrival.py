# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""What is published depends on the stamps, and not on when a message comes in."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
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
    time_values,
)

from fnn_ekf_ros.core.rows import LRF_POSE
from fnn_ekf_ros.timeline.events import CompassYaw, Event, PoseFix, PoseReset, Wheel, WheelCount

POSE = {"initial_pose": [0.1, -0.1, 0.2], "initial_pose_std": [0.2, 0.2, 0.1]}


def delayed_in_period(arrivals: Sequence[Any], rng: np.random.Generator) -> list[Any]:
    """Return the arrivals with delays, so that each comes before its period is closed.

    A period is closed by the first positions at or after its end; they stay in order, as on one
    topic. What is measured in it comes at any time before them, in any order.
    """
    wheels = [a for a in arrivals if isinstance(a.event, WheelCount)]
    stamps = np.array([a.event.stamp_ns for a in wheels])
    came = stamps + rng.integers(0, 300_000_001, len(stamps))
    came[1::2] = came[::2]  # both joints are in one message
    came = np.maximum.accumulate(came)
    found = [a._replace(now_ns=int(now)) for a, now in zip(wheels, came, strict=True)]
    for a in arrivals:
        if not isinstance(a.event, WheelCount):
            end = -(-a.event.stamp_ns // PERIOD_NS) * PERIOD_NS
            place = int(np.searchsorted(stamps, end))
            closing = int(came[place]) if place < len(came) else a.event.stamp_ns + 1
            now = int(rng.integers(a.event.stamp_ns, max(closing, a.event.stamp_ns + 1)))
            found.append(a._replace(now_ns=now))
    order = rng.permutation(len(found))
    mixed = [found[i] for i in order if not isinstance(found[i].event, WheelCount)]
    wheels_in_order = [a for a in found if isinstance(a.event, WheelCount)]
    return sorted([*mixed, *wheels_in_order], key=lambda a: a.now_ns)


@settings(derandomize=True, deadline=None, max_examples=15)
@given(
    seed=st.integers(0, 2**32 - 1),
    ticks_a_second=st.sampled_from([0, 3, 11, 100]),
    start=st.sampled_from([{}, POSE]),
    adaptation=st.sampled_from(["none", "r", "joint"]),
)
@pytest.mark.slow
def test_neither_delays_nor_the_ticks_of_the_clock_matter(
    seed: int, ticks_a_second: int, start: dict[str, Any], adaptation: str
) -> None:
    arrivals = simulated(12, 12.0, "joint_states").arrivals
    rng = np.random.default_rng(seed)
    changes = JOINTS | start | {"adaptation": adaptation}
    reference = estimates(feed(make_localizer(**changes), arrivals))
    localizer, outputs = make_localizer(**changes), []
    late = delayed_in_period(arrivals, rng)
    now = START_NS - int(rng.integers(0, 2 * SECOND_NS)) if ticks_a_second else late[0].now_ns
    for arrival in late:
        while ticks_a_second and now < arrival.now_ns:
            outputs += localizer.advance(now)
            now += int(rng.integers(1, 2 * SECOND_NS // ticks_a_second))
        outputs += localizer.add(arrival.event, arrival.now_ns)
    found = estimates(outputs)
    assert len(found) >= len(reference) - 2  # the last ones may still be open
    same_estimates(found, reference[: len(found)])
    assert time_values(localizer)["dropped"] == "0"


@pytest.mark.parametrize("kind", ["PoseFix", "CompassYaw", "WheelCount", "all"])
@pytest.mark.slow
def test_duplicates_are_counted_and_change_nothing(kind: str) -> None:
    """At once, a little later, and so late that their periods are closed."""
    arrivals = simulated(12, 20.0, "joint_states").arrivals
    twice, repeated = list(arrivals), 0
    for number, a in enumerate(arrivals):
        if kind in (type(a.event).__name__, "all"):
            later = a.now_ns + (0, 100_000_000, 900_000_000)[number % 3]
            if later < arrivals[-1].now_ns:
                twice.append(a._replace(now_ns=later))
                repeated += 1
    twice.sort(key=lambda a: a.now_ns)
    localizer = make_localizer(**JOINTS)
    outputs = feed(localizer, twice)
    same_estimates(outputs, feed(make_localizer(**JOINTS), arrivals))
    values = time_values(localizer)
    assert values["duplicates"] == str(repeated)
    assert (values["out of order"], values["periods run again for late inputs"]) == ("0", "0")


@settings(derandomize=True, deadline=None, max_examples=4)
@given(seed=st.integers(0, 2**32 - 1))
@pytest.mark.slow
def test_reordered_messages_count_in_their_order_once_all_are_there(seed: int) -> None:
    """Positions, too, and one wheel's base changes in between."""
    arrivals = list(simulated(12, 20.0, "joint_states").arrivals)
    for number, a in enumerate(arrivals):
        event = a.event
        if isinstance(event, WheelCount) and event.wheel is Wheel.LEFT and number > 500:
            arrivals[number] = a._replace(event=event._replace(reading=event.reading + 900.0))
    rng = np.random.default_rng(seed)
    settled_ns = START_NS + 16 * SECOND_NS
    mixed = sorted(
        (
            a._replace(now_ns=a.now_ns + int(rng.integers(0, 1_200_000_000)))
            if a.now_ns < settled_ns - 1_200_000_000 else a
            for a in arrivals
        ),
        key=lambda a: a.now_ns,
    )  # fmt: skip
    localizer = make_localizer(**JOINTS)
    outputs = [o for o in feed(localizer, mixed) if o.stamp_ns > settled_ns]
    in_order = feed(make_localizer(**JOINTS), arrivals)
    assert len(outputs) > 5
    same_estimates(outputs, [o for o in in_order if o.stamp_ns > settled_ns])
    assert int(time_values(localizer)["out of order"]) > 100


@pytest.mark.slow
def test_of_equal_stamps_it_does_not_matter_which_comes_first() -> None:
    arrivals = simulated(12, 10.0, "joint_states").arrivals

    def other(event: Event) -> Event:
        if isinstance(event, CompassYaw):
            return event._replace(yaw=event.yaw + 0.1)
        if isinstance(event, PoseFix):
            return event._replace(pose=event.pose - 0.1)
        return event

    ran = []
    for turn in (1, -1):
        pair = [b for a in arrivals for b in (a, a._replace(event=other(a.event)))[::turn]]
        ran.append(estimates(feed(make_localizer(**JOINTS), pair)))
    assert len(ran[0]) > 20
    same_estimates(*ran)


# output_delay


def late_fixes(arrivals: Sequence[Any], by_ns: int) -> list[Any]:
    moved = [
        a._replace(now_ns=a.now_ns + by_ns) if isinstance(a.event, PoseFix) else a
        for a in arrivals
    ]  # fmt: skip
    return sorted(moved, key=lambda a: a.now_ns)


@pytest.mark.parametrize("adaptation", ["none", "joint"])
@pytest.mark.slow
def test_late_fixes_are_in_time_for_an_output_that_waits(adaptation: str) -> None:
    """Fixes 150 ms late and `output_delay` 0.2: bit for bit the odom of fixes in time."""
    arrivals = simulated(12, 30.0, "joint_states").arrivals
    late = late_fixes(arrivals, 150_000_000)
    changes = JOINTS | {"adaptation": adaptation}
    in_time = estimates(feed(make_localizer(**changes), arrivals))
    localizer = make_localizer(output_delay=0.2, **changes)
    waited = estimates(feed(localizer, late))
    assert len(waited) > 70
    same_estimates(waited, in_time[: len(waited)])
    assert time_values(localizer)["periods run again for late inputs"] == "0"
    hasty = estimates(feed(make_localizer(**changes), late))
    assert hasty[-1].estimate is not None
    assert in_time[-1].estimate is not None
    assert np.any(hasty[-1].estimate.state.mean != in_time[-1].estimate.state.mean)


@pytest.mark.parametrize("delay", [0.0, 0.1, 0.5, 2.0])
@pytest.mark.parametrize("complete", [True, False])
def test_a_period_is_published_so_long_after_its_end(delay: float, complete: bool) -> None:
    """Or `encoder_timeout` after it, if the wheels are not known up to there and that is longer."""
    localizer = make_localizer(output_delay=delay, **POSE)
    begin = 10 * PERIOD_NS
    localizer.advance(begin)
    for wheel in Wheel:
        localizer.add(WheelCount(begin, wheel, 0), begin)
    localizer.advance(begin + round(max(delay, 0.5) * 1e9))
    end = begin + 10 * PERIOD_NS
    due = end + round((delay if complete else max(delay, 0.5)) * 1e9)
    localizer.advance(due - PERIOD_NS)
    if complete:
        for wheel in Wheel:
            localizer.add(WheelCount(end, wheel, 0), end)
    else:
        localizer.advance(due - 1)
    assert end not in [o.stamp_ns for o in localizer.advance(due - 1)]
    found = [o.stamp_ns for o in localizer.advance(due)]
    if not (complete and delay == 0.0):
        assert found == [end]


def test_a_pose_that_is_set_twice_at_one_stamp_is_the_last_one() -> None:
    """As in a paused simulation: of two commands the last to come counts."""
    localizer = make_localizer(adaptation="none", **POSE)
    begin = 10 * PERIOD_NS
    for wheel in Wheel:
        localizer.add(WheelCount(begin, wheel, 0), begin)
    for x in (5.0, 1.0, 5.0, 3.0):
        pose = np.array([x, 0.0, 0.0])
        localizer.add(PoseReset(begin + 7, pose, 1e-4 * np.eye(3)), begin + 8)
    end = begin + PERIOD_NS
    outputs = [o for w in Wheel for o in localizer.add(WheelCount(end, w, 0), end)]
    assert outputs[-1].estimate is not None
    assert outputs[-1].estimate.state.mean[0] == 3.0


@pytest.mark.parametrize("adaptation", ["none", "joint"])
@pytest.mark.slow
def test_frozen_fixes_that_are_late_are_found_as_those_in_time(adaptation: str) -> None:
    """Periods that are run again decide anew; when all fixes are in, the pose is the same."""
    arrivals = simulated(12, 16.0, "joint_states").arrivals
    first_ns, end_ns = (START_NS + seconds * SECOND_NS for seconds in (8, 14))
    fixes = [a.event for a in arrivals if isinstance(a.event, PoseFix)]
    (stuck, *_) = (fix for fix in fixes if fix.stamp_ns >= first_ns)
    frozen = [
        a._replace(event=stuck._replace(stamp_ns=a.event.stamp_ns))
        if isinstance(a.event, PoseFix) and a.event.stamp_ns > first_ns
        else a
        for a in arrivals
        if not (isinstance(a.event, PoseFix) and a.event.stamp_ns > end_ns)
    ]
    late_localizer = make_localizer(**JOINTS, adaptation=adaptation)
    late = estimates(feed(late_localizer, late_fixes(frozen, 900_000_000)))[-1]
    in_time = estimates(feed(make_localizer(**JOINTS, adaptation=adaptation), frozen))[-1]
    same_estimates([late], [in_time])
    assert time_values(late_localizer)["periods run again for late inputs"] != "0"
    assert late.estimate is not None
    assert in_time.estimate is not None
    assert late.estimate.state.unchanged.frozen[LRF_POSE]
    for one, other in zip(
        late.estimate.state.unchanged, in_time.estimate.state.unchanged, strict=True
    ):
        np.testing.assert_array_equal(one, other)
